"""The random automata of the reference as `lh.Hybrid`: one system per shape, every number in `args`.

``python tests/automata.py`` runs all 400 with the default settings, one compiled function per shape, prints the
number missed by family, and fails if anything is missed. Its members run one after the other (`jax.lax.map`, real
branches); with ``--batch vmap`` all at once, which compiles three times as long. ``--figure PATH`` draws what
fixed steps miss instead.
"""

import argparse
import functools
import sys
import time
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg

import lyaphybrid as lh

ARRAYS = ("A", "b", "mask", "c", "d", "a", "w", "p", "dir", "R", "r", "s", "u", "tgt")
SIZES = {  # systems of each shape: dimension, modes, most transitions of a mode
    "2_1_1": 39, "2_1_2": 27, "2_2_1": 35, "2_2_2": 15, "2_3_1": 23, "3_1_1": 37, "3_1_3": 12, "3_2_2": 46,
    "3_3_2": 20, "3_3_3": 12, "4_1_2": 28, "4_2_2": 36, "4_2_3": 12, "4_3_1": 15, "5_1_1": 18, "5_2_2": 14,
    "5_3_3": 11,
}  # fmt: skip
FAMILIES = ("gen", "a", "b", "c", "d", "e", "f", "g", "h", "i")
TIMES, STATES, MATRICES, EXPONENTS = 1e-9, 1e-8, 1e-7, 1e-8  # what is asked for, before the condition numbers


@functools.cache
def automaton(modes: int, transitions: int) -> lh.Hybrid:
    """The hybrid system of a shape; direction and target are data, so each mode has two vector guards."""
    names = [f"q{q}" for q in range(modes)]
    fields = {name: functools.partial(_field, q) for q, name in enumerate(names)}
    jumps = []
    for q, name in enumerate(names):
        for both in (False, True):
            jumps.append(
                lh.Transition(
                    functools.partial(_guard, q, both),
                    functools.partial(_reset, q),
                    source=name,
                    target=functools.partial(_target, q),
                    direction=0 if both else -1,
                )
            )
    return lh.Hybrid(fields, jumps)


def arguments(group: dict, row: int | slice | list) -> dict:
    """The arrays of one member (or several) of a group."""
    return {name: jnp.asarray(group[name][row]) for name in ARRAYS}


def _field(q, t, x, args):
    return jnp.sum(args["A"][q] * x[None, :], axis=1) + args["b"][q]


def _guard(q, both, t, x, args):
    """Falling where the transition is directed; where it is not of this kind the guard is 1 for ever."""
    h = jnp.sum(args["c"][q] * x[None, :], axis=1) + args["d"][q]
    h = h + args["a"][q] * jnp.sin(args["w"][q] * t + args["p"][q])
    chosen = args["mask"][q] & ((args["dir"][q] == 0) == both)
    return jnp.where(chosen, h if both else -args["dir"][q] * h, 1.0)


def _reset(q, t, x, args, which):
    matrix, shift = args["R"][q][which], args["r"][q][which]
    return jnp.sum(matrix * x[None, :], axis=1) + shift + args["s"][q][which] * jnp.cos(args["u"][q][which] * t)


def _target(q, t, x, args, which):
    return args["tgt"][q][which]


# Running the members of a shape: one compiled function.


def members(data: dict, shape: str, families: str | tuple[str, ...] = FAMILIES) -> list[dict]:
    """The systems of a shape "n_m_K" that belong to some families."""
    return [s for s in data["systems"] if s["group"] == shape and s["family"] in families]


def _batch(data: dict, systems: list[dict]) -> dict:
    shape = systems[0]["group"]
    column = {name: jnp.asarray([s[name] for s in systems]) for name in ("x0", "mode0")}
    column |= {name: jnp.asarray([s[name] for s in systems], float) for name in ("t0", "T")}
    column["args"] = arguments(data["groups"][shape], [s["pos"] for s in systems])
    return column


def _system(shape: str) -> lh.Hybrid:
    _, modes, transitions = map(int, shape.split("_"))
    return automaton(modes, transitions)


def _over(function, batch: str):
    """The function over the members, all lanes at once ("vmap") or one after the other ("map")."""
    return jax.vmap(function) if batch == "vmap" else functools.partial(jax.lax.map, function)


@eqx.filter_jit
def _motions(system, method, column, batch, max_steps=None):
    """Trajectories with their events; and M at two lengths."""

    def one(c):
        where = {"t0": c["t0"], "mode": c["mode0"], "method": method, "max_steps": max_steps, "throw": False}
        path = lh.trajectory(system, c["x0"], c["args"], t1=c["T"] - c["t0"], n=1, **where)
        if "until" not in c:
            return path, None
        return path, jax.lax.map(
            lambda t1: lh.tangent_map(system, c["x0"], c["args"], t1=t1, **where), c["until"] - c["t0"]
        )

    return _over(one, batch)(column)


def _second_instant(system: dict) -> float:
    """Where M is looked at besides T: a little after event 19 of family g, elsewhere early."""
    if "M20" not in system:
        return system["t0"] + 0.01 * (system["T"] - system["t0"])
    return system["M20"]["t"] + 0.5 * min(1e-3, system["ev"]["sep_post"][1])


def motions_of(system: lh.Hybrid, cases: list[dict]) -> tuple[list, list]:
    """Of cases with x0, mode0, t0, T and args: trajectories with their events, and tangent maps to T."""
    column = {name: jnp.asarray(np.stack([case[name] for case in cases])) for name in ("x0", "mode0", "t0", "T")}
    column["args"] = jax.tree.map(lambda *leaves: jnp.asarray(np.stack(leaves)), *(case["args"] for case in cases))
    found = jax.device_get(_motions(system, None, column | {"until": column["T"][:, None]}, "map"))
    return tuple([jax.tree.map(lambda leaf, i=i: leaf[i], part) for i in range(len(cases))] for part in found)


def _matrix_20(data: dict, system: dict) -> np.ndarray:
    """M a little after event 19: what is stored, carried on by the closed-form flow."""
    index = system["ev_idx"].index(system["M20"]["event"])
    field = data["groups"][system["group"]]["A"][system["pos"]][system["ev"]["mode"][index]]
    return scipy.linalg.expm(field * (_second_instant(system) - system["M20"]["t"])) @ system["M20"]["M"]


def run(data: dict, systems: list[dict], *, method=None, batch: str = "map") -> list[dict]:
    """What became of each of the systems (all of one shape) with the default settings, or another method.

    Returns:
        For each system: id, family, `order` (whether all events came, in the right order) and the worst errors
        over what is asked for: `times`, `states`, `matrices` (1 is the limit).
    """
    column = _batch(data, systems)
    column["until"] = jnp.asarray([[s["T"], _second_instant(s)] for s in systems])
    paths, maps = jax.device_get(_motions(_system(systems[0]["group"]), method, column, batch))
    found = []
    for i, system in enumerate(systems):
        path, matrices = jax.tree.map(lambda leaf, i=i: leaf[i], (paths, maps))
        order, errors = _compare(system, path)
        known = [system["M"]] + ([_matrix_20(data, system)] if "M20" in system else [])
        amplification = max(1.0, system["amp"])
        errors["matrices"] = max(
            np.max(np.abs(ours - exact)) / (MATRICES * amplification * np.max(np.abs(exact)))
            for ours, exact in zip(matrices.matrix, known, strict=False)
        )
        ended = bool(np.all(matrices.status_code == lh.STATUS.ok)) and matrices.mode[0] == system["modeT"]
        found.append({"id": system["id"], "family": system["family"], "order": order and ended} | errors)
    return found


def _compare(system: dict, path) -> tuple[bool, dict[str, float]]:
    """Whether all events came in the right order; errors of times and states over what is asked for."""
    known, log = system["ev"], path.events
    kept = np.asarray(system.get("ev_idx", range(system["n_events"])), int)
    same = path.status_code == lh.STATUS.ok and path.j[-1] == system["n_events"]
    same = same and path.mode[-1] == system["modeT"]
    pairs = [(log.mode_before, "q"), (log.which, "j"), (log.mode_after, "mode")]
    same = same and all(np.array_equal(ours[kept], known[name]) for ours, name in pairs)
    if not same:
        return False, {"times": np.nan, "states": np.nan}
    amplification = max(1.0, system["amp"])
    allowed = TIMES * np.maximum(1.0, amplification / np.abs(known["trans"]))
    states = [(log.x_before[kept], known["xm"]), (log.x_after[kept], known["xp"]), (path.x[-1], system["xT"])]
    worst = max(np.max(np.abs(ours - exact), initial=0.0) for ours, exact in states if np.size(exact))
    times = np.max(np.abs(log.t[kept] - known["t"]) / allowed, initial=0.0)
    return True, {"times": times, "states": worst / (STATES * amplification)}


# Exponents: family h (an attracting cycle), and the directions that family i loses.


@eqx.filter_jit
def _spectra(system, column, blocks):
    def one(c):
        where = {"t0": c["t0"], "mode": c["mode0"], "blocks": blocks, "throw": False}
        spectrum = lh.lyapunov_spectrum(system, c["x0"], c["args"], t1=c["length"], **where)
        return spectrum.exponents, spectrum.history.growth, spectrum.losses, spectrum.status_code

    return jax.lax.map(one, column)


def exponents(data: dict, systems: list[dict]) -> list[dict]:
    """Of members of the families h and i (all of one shape): error over what is asked for, lost directions.

    On a cycle of period P the growth of each block of one period tends to λP, as fast as neighbouring
    multipliers differ in modulus; complex pairs make it oscillate. So the first half of the blocks is left
    out, and the smooth weights exp(-1/(s(1-s))) average the second.

    Returns:
        For each system: id, family, `exponents` (the worst error over what is asked for; nan in family i),
        `lost` (whether exactly the right number of exponents was lost).
    """
    column, blocks = _batch(data, systems), max(_periods(s) for s in systems)
    lengths = [blocks * s["extra"]["period"] if s["family"] == "h" else s["T"] - s["t0"] for s in systems]
    column["length"] = jnp.asarray(lengths)
    results = jax.device_get(_spectra(_system(systems[0]["group"]), column, blocks))
    found = []
    for system, values, growth, losses, status in zip(systems, *results, strict=True):
        dead = np.isneginf(values)
        right = status == lh.STATUS.ok and np.sum(losses > 0) == np.sum(dead) == system["extra"]["lost"]
        error = np.nan
        if system["family"] == "h":
            known = system["extra"]["exponents"]
            alive = np.isfinite(known)
            rates = _smooth_mean(growth[len(growth) // 2 :]) / system["extra"]["period"]
            ours = np.sort(np.where(dead, -np.inf, rates))[::-1]
            right = right and np.array_equal(np.isfinite(ours), alive)
            error = np.max(np.abs(ours[alive] - known[alive])) / EXPONENTS if right else np.nan
        found.append({"id": system["id"], "family": system["family"], "lost": bool(right), "exponents": error})
    return found


def _periods(system: dict) -> int:
    """So many periods that multipliers of different modulus are told apart to 1e-10 in half of them."""
    if system["family"] != "h":
        return 64
    sizes = np.sort([np.hypot(*m) for m in system["extra"]["multipliers"]])[::-1]
    ratios = sizes[1:] / sizes[:-1]
    pairs = np.any(ratios >= 1 - 1e-9)  # these turn for ever
    slowest = np.max(ratios[ratios < 1 - 1e-9])
    return max(20_000 if pairs else 128, int(2 * np.log(1e-10) / np.log(slowest)))


def _smooth_mean(values: np.ndarray) -> np.ndarray:
    s = (np.arange(len(values)) + 0.5) / len(values)
    weights = np.exp(-1 / (s * (1 - s)))
    return weights @ values / np.sum(weights)


# What fixed steps miss.


def misses_of_fixed_steps(data: dict, tableau: str, steps, *, systems=None) -> dict[str, np.ndarray]:
    """The fraction of each family whose events come in the wrong order, or not at all, by the size of a step."""
    wrong = {family: np.zeros(len(steps)) for family in FAMILIES}
    chosen = data["systems"] if systems is None else systems
    for shape in data["groups"]:
        group = [s for s in chosen if s["group"] == shape]
        if not group:
            continue
        column = _batch(data, group)
        for k, h in enumerate(steps):
            # Traced, the step is no part of what is compiled.
            method = lh.RungeKutta(tableau, dt=jnp.asarray(float(h)))
            limit = jnp.asarray(10_000 + int(400 / min(steps)), jnp.int32)
            paths, _ = jax.device_get(_motions(_system(shape), method, column, "map", limit))
            for i, system in enumerate(group):
                order, _ = _compare(system, jax.tree.map(lambda leaf, i=i: leaf[i], paths))
                wrong[system["family"]][k] += not order
    return {f: wrong[f] / max(1, sum(s["family"] == f for s in chosen)) for f in FAMILIES}


def draw(data: dict, path, tableaus=("rk4", "dopri8"), steps=None, systems=None) -> dict:
    """A figure of `misses_of_fixed_steps`, one panel a tableau."""
    import matplotlib.pyplot as plt

    steps = np.geomspace(1e-3, 1.0, 19) if steps is None else np.asarray(steps)
    size = (1 + 5 * len(tableaus), 4.6)
    figure, axes = plt.subplots(1, len(tableaus), figsize=size, sharey=True, squeeze=False, layout="constrained")
    axes = axes[0]
    rates = {}
    for ax, tableau in zip(axes, tableaus, strict=True):
        rates[tableau] = misses_of_fixed_steps(data, tableau, steps, systems=systems)
        for number, (family, rate) in enumerate(rates[tableau].items()):
            ax.plot(steps, 100 * rate, marker="os^vD<>pPX"[number], ms=4, lw=1.2, label=family)
        ax.set(xscale="log", xlabel="fixed step h (time)", title=f"{tableau}, dt = h")
        ax.grid(alpha=0.3)
    axes[0].set_ylabel("systems with a missed event (%)")
    axes[-1].legend(title="family", ncols=2, fontsize=8)
    figure.suptitle("Random automata: events missed by fixed steps (adaptive steps: none)")
    figure.savefig(path, dpi=130)
    plt.close(figure)
    return rates


# The command.


KINDS = ("times", "states", "matrices", "exponents")


def table(found: list[dict]) -> tuple[str, int]:
    """The number missed by family, as text and in total; a system that occurs twice is counted once."""
    lines = [
        "                   missed by          worst error over what is asked for",
        "family  systems   order  accuracy      times    states         M  exponents",
    ]
    total = 0
    for family in FAMILIES:
        rows = [row for row in found if row["family"] == family]
        if not rows:
            continue
        order = {row["id"] for row in rows if not (row.get("order", True) and row.get("lost", True))}
        accuracy = {row["id"] for row in rows if any(row.get(kind, 0.0) > 1 for kind in KINDS)} - order
        seen = [[row[kind] for row in rows if np.isfinite(row.get(kind, np.nan))] for kind in KINDS]
        worst = "".join(f"{max(errors):10.1e}" if errors else f"{'-':>10s}" for errors in seen)
        count = len({row["id"] for row in rows})
        lines.append(f"{family:6s} {count:8d} {len(order):7d} {len(accuracy):9d} {worst}")
        lines += [f"       {name} missed by order, or by lost directions" for name in sorted(order)]
        lines += [f"       {name} missed by accuracy" for name in sorted(accuracy)]
        total += len(order | accuracy)
    lines.append(f"missed: {total} of {len({row['id'] for row in found})}")
    return "\n".join(lines), total


def main(argv=None) -> int:
    """Run the automata; the exit status is 1 where anything was missed."""
    sys.path.append(str(Path(__file__).parent / "support"))
    import references

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--batch", choices=("map", "vmap"), default="map", help="one lane after the other, or all at once"
    )
    parser.add_argument("--shapes", nargs="*", help="only these shapes, n_m_K")
    parser.add_argument("--figure", metavar="PATH", help="draw what fixed steps miss instead (PNG)")
    options = parser.parse_args(argv)
    jax.config.update("jax_enable_x64", True)
    data = references.load_automata()
    if options.figure:
        rates = draw(data, options.figure)
        for tableau, families in rates.items():
            print(tableau, {f: [round(float(r), 3) for r in rate] for f, rate in families.items()})
        return 0
    found, start = [], time.perf_counter()
    for shape in options.shapes or data["groups"]:
        found += run(data, members(data, shape), batch=options.batch)
        cyclic = members(data, shape, ("h", "i"))
        found += exponents(data, cyclic) if cyclic else []
        print(f"{shape}: done after {time.perf_counter() - start:.0f} s", file=sys.stderr, flush=True)
    text, missed = table(found)
    print(text)
    return int(missed > 0)


if __name__ == "__main__":
    sys.exit(main())
