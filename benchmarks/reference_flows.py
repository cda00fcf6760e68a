"""Reference spectra of the published flows, by two methods each: `python -m benchmarks.reference_flows [NAME …]`.

A first run shows where the start leads to. From there the flow runs by discrete QR in an explicit method of order 8,
and from the end of that by continuous QR in a method of order 5, each until its errors are small or its time is
spent; where motions leave the attractor in the end, each takes the best of several starts. Other starts show what else
attracts. Rows go into the data file of the package as they come.
"""

import argparse
import json
import time
from pathlib import Path

import jax
import numpy as np

import lyaphybrid as lh
from lyaphybrid.zoo.published import spectra
from lyaphybrid.zoo.published.table import entry_of, flow_names

FILE = Path(spectra.__file__).with_name(spectra.FILE)
SEED, STARTS = 20261127, 12
SETTLING, FIRST, TRANSIENT = 3000.0, 300.0, 200.0  # in turns: the first run, the first piece of the others, before them
WANTED = 2e-3  # the relative error of the largest exponent at which a run ends; absolute where none is positive
LONGEST = 1e7  # turns
FINITE_TIME = 1.0  # a run of length T knows an exponent to this over T, whatever its blocks say
ESCAPED, SAME, SURE = 1e3, 5.0, 4.0  # spreads of the attractor; errors: the same exponents, an exponent that is not 0
LATE = 0.25  # chaos that ends: the part of λ₁ that is left in the last eighth of the first run
MAX_STEPS = 4_000_000
STEPS = 2000  # in a turn: those of fixed steps; more than others take
HALTED = ("step_underflow", "nonfinite")  # as continuous QR does at kinks of the field, where Q' jumps
QUICK = lh.RungeKutta("dopri5", rtol=1e-7, atol=1e-10)


def error_of(found):
    """Standard errors from the blocks, and what a run of this length cannot know."""
    return np.hypot(np.nan_to_num(np.asarray(found.stderr, float)), FINITE_TIME / float(found.time))


def exponents_of(found):
    return np.asarray(found.exponents, float)


def late(found):
    """λ₁ over the last eighth of a run."""
    growth, times = np.asarray(found.history.growth)[:, 0], np.asarray(found.history.time)
    count = max(2, len(times) // 8)
    return float(np.sum(growth[-count:]) / (times[-1] - times[-count - 1]))


def run(entry, x0, method, seconds):
    """The longest spectrum that ended well within the CPU time, or until exact enough; the status of the last piece."""
    problem, turn = entry.problem(), entry.turn
    found = problem.spectrum(
        x0=x0, method=method, transient=TRANSIENT * turn, t1=FIRST * turn, throw=False, max_steps=MAX_STEPS
    )
    reached, rate, begun = FIRST, 0.0, time.process_time()
    while found.status.name == "ok" and reached < LONGEST:
        values = exponents_of(found)
        size = values[0] if values[0] > SURE * error_of(found)[0] else min(1.0, np.max(np.abs(values)))
        needed = reached * (np.max(error_of(found)[:2]) / (WANTED * size)) ** 2 - reached
        left = (seconds - (time.process_time() - begun)) / rate if rate else reached
        more = min(needed, left, LONGEST - reached, 7 * reached)
        if more < 0.2 * reached:
            break
        longer, more, spent = further(found, more, reached, turn)
        if longer.status.name != "ok":
            return found, longer.status.name
        found, rate, reached = longer, spent / more, reached + more
    return found, found.status.name


def further(found, more, reached, turn):
    """A run gone on, by less where it ends on the way, and by how many turns and in what time."""
    while True:
        piece = time.process_time()
        most = int(MAX_STEPS + STEPS * more)  # who leaves takes ever smaller ones
        longer = found.resume((reached + more) * turn, throw=False, max_steps=most)
        if longer.status.name == "ok" or more < 0.4 * reached:
            return longer, more, time.process_time() - piece
        more /= 2


def longest_run(entry, x0, method, seconds):
    """`run` and its start; where motions leave their attractor at last, the one of several with the least error."""
    begun = time.process_time()
    found, status = run(entry, x0, method, seconds)
    if status == "ok" or float(found.time) == 0:
        return found, status, x0
    path = entry.problem().trajectory(x0=x0, method=QUICK, t1=float(found.time) / 2, n=STARTS, throw=False)
    for start in np.asarray(path.x):
        left = seconds - (time.process_time() - begun)
        if error_of(found)[0] <= WANTED * exponents_of(found)[0] or left < 0:
            break
        other, ended = run(entry, start, method, left)
        if float(other.time) and error_of(other)[0] < error_of(found)[0]:
            found, status, x0 = other, ended, start
    return found, status, x0


def row_of(found, method, x0):
    """What is kept of a run."""
    return {
        "method": method,
        "start": shortened(x0, 6),
        "time": shortened([float(found.time)], 6)[0],
        "exponents": exponents_of(found),
        "stderr": error_of(found),
        "sum_rule": shortened([float(np.asarray(found.residual))], 2)[0],
        "notes": sorted(found.notes),
    }


def other_starts(entry, reference, errors, x_end, seconds):
    """What random starts around the attractor lead to: [how many, what, λ₁ of the first]."""
    problem, turn, begun, found = entry.problem(), entry.turn, time.process_time(), {}
    path = np.asarray(problem.trajectory(x0=x_end, method=QUICK, t1=20 * turn, n=400, throw=False).x)
    centre, spread, positive = path.mean(axis=0), path.std(axis=0), path.min(axis=0) > 0
    rng = np.random.default_rng(SEED)
    for _ in range(STARTS):
        x0 = centre + 2 * spread * rng.standard_normal(len(centre))
        one = problem.spectrum(
            x0=np.where(positive, np.abs(x0), x0),
            method=QUICK, transient=FIRST * turn, t1=FIRST * turn, throw=False, max_steps=MAX_STEPS // 8,
        )  # fmt: skip
        what, value = verdict(one, reference, errors, centre, spread)
        count, first = found.get(what, (0, value))
        found[what] = (count + 1, first)
        if time.process_time() - begun > seconds:
            break
    return [[count, what, first] for what, (count, first) in sorted(found.items())]


def verdict(one, reference, errors, centre, spread):
    """Whether a start escapes, does not end within the steps, or leads to the same exponents within their errors."""
    away = np.abs(np.asarray(one.x, float) - centre) > ESCAPED * (spread + 1e-9 * np.max(spread))
    if one.status.name == "nonfinite" or np.any(away):
        return "escaped", None
    if one.status.name != "ok":
        return "undecided", None
    values = exponents_of(one)
    near = SAME * np.hypot(errors, error_of(one)) + 0.03 * np.abs(reference)
    return ("the same", None) if np.all(np.abs(values - reference) <= near) else ("other", shortened(values, 3)[0])


def kind_of(values, errors, entry):
    """What the exponents say: chaos, hyperchaos, a torus, a cycle, rest."""
    positive, zero = int(np.sum(values > SURE * errors)), int(np.sum(np.abs(values) <= SURE * errors))
    if entry.conservative:
        return "chaotic sea" if positive else "regular"
    if positive:
        return "chaos" if positive == 1 else "hyperchaos"
    return ("cycle", "torus")[min(zero, 1)] if entry.driven else ("rest", "cycle", "torus")[min(zero, 2)]


def methods_of(entry):
    """Names and methods of the two runs."""
    first, second = entry.method() if entry.method else lh.RungeKutta("dopri8", rtol=1e-10), QUICK
    if entry.method:
        second = first.loosened(1e-7)
    names = [f"{getattr(one, 'tableau', type(one).__name__)}, rtol {one.rtol:.0e}" for one in (first, second)]
    return (f"discrete QR, {names[0]}", first), (f"continuous QR, {names[1]}", lh.ContinuousQR(second))


def not_continuous(entry):
    """The second method of a flow that continuous QR does not take; of fixed steps where the first is of order 5."""
    if entry.method:
        return f"discrete QR, rk4, {STEPS} steps in a turn", lh.RungeKutta("rk4", dt=entry.turn / STEPS)
    return "discrete QR, dopri5, rtol 1e-07", QUICK


def spectrum_of(name, seconds):
    """The row of a flow in the data file."""
    begun, entry = time.process_time(), entry_of(name)
    problem, (first, second) = entry.problem(), methods_of(entry)
    quick = entry.method() if entry.method else QUICK
    before = problem.spectrum(
        method=quick, t1=SETTLING * entry.turn, transient=0.0, throw=False, max_steps=4 * MAX_STEPS
    )
    transient = None
    x0, settled = problem.x0, before.status.name == "ok"
    if (
        settled
        and exponents_of(before)[0] > 0
        and late(before) < LATE * exponents_of(before)[0]
        and not entry.conservative
    ):
        transient, x0 = {"until": float(before.time), "largest": exponents_of(before)[0]}, before.x
    one, status, x0 = longest_run(entry, x0, first[1], 0.3 * seconds)
    if status == "ok":
        after = one.x
        two, status2 = run(entry, after, second[1], 0.5 * seconds)
        if float(two.time) == 0 or status2 in HALTED:
            second = not_continuous(entry)
            two, status2 = run(entry, after, second[1], 0.5 * seconds)
    else:  # its end is near the way out
        two, status2, after = longest_run(entry, x0, second[1], 0.5 * seconds)
    rows = [row_of(one, first[0], x0), row_of(two, second[0], after)]
    weights = [1 / np.square(row["stderr"]) for row in rows]
    value = sum(w * row["exponents"] for w, row in zip(weights, rows, strict=True)) / sum(weights)
    error = 1 / np.sqrt(sum(weights))
    order = np.argsort(-value)  # two that are nearly equal may have changed places
    value, error = value[order], error[order]
    others = [] if entry.conservative else other_starts(entry, value, error, one.x, 0.2 * seconds)
    kind = kind_of(value, error, entry)
    for row in rows:
        row["exponents"], row["stderr"] = rounded(row["exponents"], row["stderr"])
    values, errors = rounded(value, error)
    return {
        "kind": kind,
        "exponents": values,
        "stderr": errors,
        "runs": rows,
        "starts": others,
        "transient": transient,
        "ends": sorted({before.status.name, status, status2} - {"ok", "max_steps"}),
        "seconds": round(time.process_time() - begun, 1),
        "version": lh.__version__,
    }


def shortened(values, digits):
    return [float(f"{float(v):.{digits}g}") for v in np.asarray(values)]


def rounded(values, errors):
    """Values to two digits of their errors."""
    digits = [1 - int(np.floor(np.log10(error))) for error in errors]
    return [round(float(v), d) + 0.0 for v, d in zip(values, digits, strict=True)], shortened(errors, 2)


def merge(file, name, row):
    """Put a row into the data file."""
    rows = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}
    rows[name] = row
    lines = [f"{json.dumps(key)}: {json.dumps(rows[key], ensure_ascii=False)}" for key in sorted(rows)]
    file.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


def main():
    jax.config.update("jax_enable_x64", True)
    parser = argparse.ArgumentParser(prog="python -m benchmarks.reference_flows", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help="flows (default: all)")
    parser.add_argument("--out", type=Path, default=FILE, help="the data file (default: that of the package)")
    parser.add_argument("--seconds", type=float, default=8.0, help="CPU time for each flow, about (default: 8)")
    options = parser.parse_args()
    for name in options.names or flow_names():
        row = spectrum_of(name, options.seconds)
        merge(options.out, name, row)
        print(
            name, row["kind"], row["exponents"], row["stderr"], row["starts"], row["ends"], row["seconds"], flush=True
        )


if __name__ == "__main__":
    main()
