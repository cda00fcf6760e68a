"""Guards with known roots, many inside one step: none may be missed, none invented, all in order.

``python tests/roots.py`` runs 10 000 polynomials of degree 3 to 8 and 10 000 sums of two sinusoids with 2 to 6 extrema.
Each is met twice: as a component of the state whose derivative the field is, and as a function of the time alone beside
a state that moves evenly. In both ways nothing but the guard itself limits the step: the error estimate is zero, and
the free step is as long as the whole run. ``python tests/roots.py COUNT SEED`` runs fewer, or others.
"""

import functools
import sys
import time

import jax
import jax.numpy as jnp
import numpy as np

import lyaphybrid as lh

START, END = -10.0, 10.0
MOST = 8  # factors of a polynomial; its degree is at most this
APART = 1e-3  # roots closer than this are drawn again: between them the guard hardly differs from zero
DEPTH = 1e-6  # an extremum of a sinusoid closer to zero is drawn again
TOLERANCE = 1e-7  # of the instants, times the amplification 1/|slope| of an error of the guard


def polynomial(t, args):
    """The product of the factors (t - root)/5, where `used`, and of ((t - a)² + b²)/50, where `paired`."""
    lines = jnp.where(args["used"], (t - args["roots"]) / 5.0, 1.0)
    pairs = jnp.where(args["paired"], ((t - args["a"]) ** 2 + args["b"] ** 2) / 50.0, 1.0)
    return args["size"] * jnp.prod(lines) * jnp.prod(pairs)


def sinusoids(t, args):
    """A constant and two sinusoids."""
    return args["mean"] + jnp.sum(args["size"] * jnp.cos(args["omega"] * t + args["phase"]))


GUARDS = {"polynomials": polynomial, "sinusoids": sinusoids}


def counted(t, x, args):
    """A reset that leaves the guard as it is and counts."""
    return x.at[1].add(1.0)


@functools.cache
def system(kind: str, way: str) -> lh.Hybrid:
    """The guard is the component 0 of the state ("path"), or a function of the time ("time")."""
    value = GUARDS[kind]

    def slope(t, args):
        return jax.jvp(lambda t: value(t, args), (t,), (jnp.ones_like(t),))[1]

    if way == "path":
        return lh.Hybrid(
            lambda t, x, args: jnp.stack([slope(t, args), jnp.zeros_like(t)]),
            lh.Transition(lambda t, x, args: x[0], counted, direction=0),
        )
    return lh.Hybrid(
        lambda t, x, args: jnp.array([1.0, 0.0]),
        lh.Transition(lambda t, x, args: value(t, args), counted, direction=0),
    )


def random_polynomial(draw: np.random.Generator) -> dict:
    """One of degree 3 to 8 with its real roots in [-8, 8], and some pairs of complex ones."""
    degree = int(draw.integers(3, MOST + 1))
    pairs = int(draw.integers(0, (degree - 1) // 2 + 1)) if draw.random() < 0.5 else 0
    real = degree - 2 * pairs
    while True:
        roots = np.sort(draw.uniform(-8, 8, real))
        if np.all(np.diff(roots) > APART):
            break
    room = np.arange(MOST)
    return {
        "used": room < real, "roots": np.pad(roots, (0, MOST - real)), "paired": room[: MOST // 2] < pairs,
        "a": draw.uniform(-8, 8, MOST // 2), "b": draw.uniform(0.3, 3, MOST // 2), "size": 10 ** draw.uniform(-1, 1),
    }  # fmt: skip


def random_sinusoids(draw: np.random.Generator) -> dict:
    """A sum of two sinusoids with 2 to 6 extrema between the start and the end."""
    while True:
        fast = draw.uniform(0.5, 6.5) * np.pi / (END - START)
        args = {
            "mean": draw.uniform(-0.8, 0.8), "size": np.array([1.0, draw.uniform(0, 0.5)]),
            "omega": np.array([fast, fast * draw.uniform(0.1, 2)]), "phase": draw.uniform(0, 2 * np.pi, 2),
        }  # fmt: skip
        extrema = zeros(lambda t, args=args: -_sum(args, t, np.sin, args["omega"]))
        if 2 <= len(extrema) <= 6 and np.all(np.abs(_value(args, extrema)) > DEPTH):
            return args


def _sum(args: dict, t, of, weight=1.0) -> np.ndarray:
    return np.sum(weight * args["size"] * of(args["omega"] * np.asarray(t)[..., None] + args["phase"]), axis=-1)


def _value(args: dict, t) -> np.ndarray:
    return args["mean"] + _sum(args, t, np.cos)


def zeros(of, most: int = 1000) -> np.ndarray:
    """The zeros of a smooth function between the start and the end, by signs on a fine grid and bisection."""
    grid = np.linspace(START, END, most)
    values = of(grid)
    left = grid[:-1][values[:-1] * values[1:] < 0]
    right, sign = left + (grid[1] - grid[0]), np.sign(of(left))
    for _ in range(60):
        middle = 0.5 * (left + right)
        same = np.sign(of(middle)) == sign
        left, right = np.where(same, middle, left), np.where(same, right, middle)
    return 0.5 * (left + right)


def roots_of(kind: str, args: dict) -> tuple[np.ndarray, np.ndarray]:
    """The roots, and the slopes there."""
    if kind == "polynomials":
        roots = args["roots"][args["used"]]
        slopes = jax.device_get(_slopes(args, jnp.asarray(args["roots"])))[args["used"]]
        return roots, slopes
    extrema = zeros(lambda t: -_sum(args, t, np.sin, args["omega"]))
    ends = np.array([START, *extrema, END])
    signs = np.sign(_value(args, ends))
    left, right, sign = ends[:-1], ends[1:], signs[:-1]
    kept = signs[:-1] != signs[1:]
    left, right, sign = left[kept], right[kept], sign[kept]
    for _ in range(60):
        middle = 0.5 * (left + right)
        same = np.sign(_value(args, middle)) == sign
        left, right = np.where(same, middle, left), np.where(same, right, middle)
    roots = 0.5 * (left + right)
    return roots, -_sum(args, roots, np.sin, args["omega"])


@jax.jit
def _slopes(args, roots):
    return jax.vmap(jax.grad(lambda t: polynomial(t, args)))(roots)


@functools.partial(jax.jit, static_argnums=(0, 1, 2))
def _events(kind: str, way: str, method, batch):
    """(members, rows) the instants of the events; (members,) their numbers, and the statuses."""

    def one(args):
        first = GUARDS[kind](jnp.asarray(START), args) if way == "path" else 0.0
        x0 = jnp.stack([first, 0.0])
        path = lh.trajectory(system(kind, way), x0, args, t0=START, t1=END - START, n=1, method=method, throw=False)
        return path.events.t[:16], path.j[-1], path.status_code

    return jax.lax.map(one, batch)


def run(kind: str, way: str, members: list[dict], method=None) -> dict[str, int]:
    """How many events were missed, invented or out of order, how many runs failed, and the number of roots."""
    batch = jax.tree.map(lambda *leaves: jnp.asarray(np.stack(leaves)), *members)
    times, counts, statuses = jax.device_get(_events(kind, way, method, batch))
    found = {"roots": 0, "missed": 0, "spurious": 0, "disordered": 0, "inexact": 0, "failed": 0}
    for args, ours, count, status in zip(members, times, counts, statuses, strict=True):
        roots, slopes = roots_of(kind, args)
        ours = ours[: int(count)]
        found["roots"] += len(roots)
        found["failed"] += int(status != lh.STATUS.ok)
        found["missed"] += max(len(roots) - int(count), 0)
        found["spurious"] += max(int(count) - len(roots), 0)
        found["disordered"] += int(np.any(np.diff(ours) <= 0))
        if len(ours) == len(roots):
            found["inexact"] += int(np.any(np.abs(ours - roots) > TOLERANCE * np.maximum(1, 1 / np.abs(slopes))))
    return found


def members_of(kind: str, count: int, seed: int = 0) -> list[dict]:
    """Random guards of a kind."""
    draw = np.random.default_rng(seed)
    return [(random_polynomial if kind == "polynomials" else random_sinusoids)(draw) for _ in range(count)]


def main(count: int = 10_000, seed: int = 0) -> int:
    """Run `count` guards of each kind in both ways; the number of wrong ones."""
    jax.config.update("jax_enable_x64", True)
    wrong = 0
    for kind in GUARDS:
        members = members_of(kind, count, seed)
        for way in ("path", "time"):
            clock = time.time()
            found = run(kind, way, members)
            wrong += sum(number for name, number in found.items() if name != "roots")
            print(f"{count} {kind}, {way}: {found}, {time.time() - clock:.0f} s", flush=True)
    return wrong


if __name__ == "__main__":
    sys.exit(bool(main(*map(int, sys.argv[1:]))))
