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


def random_sinusoids(draw: np.random.Generator, count: int) -> dict:
    """Sums of two sinusoids with 2 to 6 extrema between the start and the end; each leaf has `count` rows."""
    kept, missing = [], count
    while missing > 0:
        args = _drawn_sinusoids(draw.random((min(missing, 1000), 6)))
        rows, extrema = zeros(lambda rows, t, args=args: -_sum(args, rows, t, np.sin, args["omega"]), len(args["mean"]))
        numbers = np.bincount(rows, minlength=len(args["mean"]))
        shallow = np.bincount(rows, np.abs(_value(args, rows, extrema)) <= DEPTH, len(args["mean"])) > 0
        right = (numbers >= 2) & (numbers <= 6) & ~shallow
        kept.append(jax.tree.map(lambda leaf, right=right: leaf[right], args))
        missing -= np.sum(right)
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *kept)


def _drawn_sinusoids(u: np.ndarray) -> dict:
    """From (count, 6) numbers between 0 and 1."""
    fast = (0.5 + 6 * u[:, 0]) * np.pi / (END - START)
    return {
        "mean": 1.6 * u[:, 1] - 0.8, "size": np.stack([np.ones(len(u)), 0.5 * u[:, 2]], axis=1),
        "omega": np.stack([fast, fast * (0.1 + 1.9 * u[:, 3])], axis=1), "phase": 2 * np.pi * u[:, 4:],
    }  # fmt: skip


def _sum(args: dict, rows, t, of, weight=None) -> np.ndarray:
    """The sum of a member's sinusoids (or their slopes) at times whose first axis is that of `rows`."""
    size = (args["size"] if weight is None else args["size"] * weight)[rows]
    angles = [args["omega"][rows, i].reshape(_as(t)) * t + args["phase"][rows, i].reshape(_as(t)) for i in range(2)]
    return sum(size[:, i].reshape(_as(t)) * of(angles[i]) for i in range(2))


def _as(t) -> tuple[int, ...]:
    return (-1,) + (1,) * (np.ndim(t) - 1)


def _value(args: dict, rows, t) -> np.ndarray:
    return args["mean"][rows].reshape(_as(t)) + _sum(args, rows, t, np.cos)


def zeros(of, count: int, most: int = 1000) -> tuple[np.ndarray, np.ndarray]:
    """The zeros of smooth functions between the start and the end, by signs on a fine grid and bisection.

    Returns:
        The rows of the zeros, ascending, and where they are, ascending in each row.
    """
    grid = np.linspace(START, END, most)
    values = of(np.arange(count), np.broadcast_to(grid, (count, most)))
    rows, places = np.nonzero(values[:, :-1] * values[:, 1:] < 0)
    return rows, bisected(of, rows, grid[places], grid[places + 1])


def bisected(of, rows, left, right) -> np.ndarray:
    """The zeros of the functions `rows` between left and right, where the signs differ."""
    sign = np.sign(of(rows, left))
    for _ in range(60):
        middle = 0.5 * (left + right)
        same = np.sign(of(rows, middle)) == sign
        left, right = np.where(same, middle, left), np.where(same, right, middle)
    return 0.5 * (left + right)


def roots_of(kind: str, args: dict) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of stacked members: rows of the roots, ascending; the roots, ascending in each row; the slopes there."""
    if kind == "polynomials":
        rows, places = np.nonzero(args["used"])
        return rows, args["roots"][rows, places], np.asarray(_slopes(args, args["roots"]))[rows, places]
    count = len(args["mean"])
    at, extrema = zeros(lambda rows, t: -_sum(args, rows, t, np.sin, args["omega"]), count)
    # The ends of the stretches on which a member is monotonic.
    rows = np.concatenate([at, np.arange(count), np.arange(count)])
    ends = np.concatenate([extrema, np.full(count, START), np.full(count, END)])
    order = np.lexsort([ends, rows])
    rows, ends = rows[order], ends[order]
    signs = np.sign(_value(args, rows, ends))
    kept = (rows[:-1] == rows[1:]) & (signs[:-1] != signs[1:])
    rows, left, right = rows[:-1][kept], ends[:-1][kept], ends[1:][kept]
    roots = bisected(lambda rows, t: _value(args, rows, t), rows, left, right)
    return rows, roots, -_sum(args, rows, roots, np.sin, args["omega"])


@jax.jit
def _slopes(args, roots):
    return jax.vmap(lambda args, roots: jax.vmap(jax.grad(lambda t: polynomial(t, args)))(roots))(args, roots)


@functools.partial(jax.jit, static_argnums=(0, 1, 2))
def _events(kind: str, way: str, method, batch):
    """(members, rows) the instants of the events; (members,) their numbers, and the statuses."""

    def one(args):
        first = GUARDS[kind](jnp.asarray(START), args) if way == "path" else 0.0
        x0 = jnp.stack([first, 0.0])
        path = lh.trajectory(system(kind, way), x0, args, t0=START, t1=END - START, n=1, method=method, throw=False)
        return path.events.t[:16], path.j[-1], path.status_code

    return jax.lax.map(one, batch)


def run(kind: str, way: str, guards: tuple, method=None) -> dict[str, int]:
    """How many events were missed, invented or out of order, how many runs failed, and the number of roots."""
    batch, (rows, roots, slopes) = guards
    times, counts, statuses = jax.device_get(_events(kind, way, method, batch))
    numbers, column = np.bincount(rows, minlength=len(counts)), np.arange(times.shape[1])
    place = np.arange(len(rows)) - np.searchsorted(rows, rows)  # of a root among those of its member
    far = np.abs(times[rows, place] - roots) > TOLERANCE * np.maximum(1, 1 / np.abs(slopes))
    return {
        "roots": len(roots),
        "missed": int(np.sum(np.maximum(numbers - counts, 0))),
        "spurious": int(np.sum(np.maximum(counts - numbers, 0))),
        "disordered": int(np.sum(np.any((np.diff(times) <= 0) & (column[1:] < counts[:, None]), axis=1))),
        "inexact": int(np.sum((np.bincount(rows, far, len(counts)) > 0) & (counts == numbers))),
        "failed": int(np.sum(statuses != lh.STATUS.ok)),
    }


@functools.cache
def guards_of(kind: str, count: int, seed: int = 0) -> tuple[dict, tuple]:
    """Random guards of a kind, stacked; and their roots."""
    draw = np.random.default_rng(seed)
    if kind == "polynomials":
        batch = jax.tree.map(lambda *leaves: np.stack(leaves), *(random_polynomial(draw) for _ in range(count)))
    else:
        batch = random_sinusoids(draw, count)
    return jax.tree.map(jnp.asarray, batch), roots_of(kind, batch)


def main(count: int = 10_000, seed: int = 0) -> int:
    """Run `count` guards of each kind in both ways; the number of wrong ones."""
    jax.config.update("jax_enable_x64", True)
    wrong = 0
    for kind in GUARDS:
        for way in ("path", "time"):
            clock = time.time()
            found = run(kind, way, guards_of(kind, count, seed))
            wrong += sum(number for name, number in found.items() if name != "roots")
            print(f"{count} {kind}, {way}: {found}, {time.time() - clock:.0f} s", flush=True)
    return wrong


if __name__ == "__main__":
    sys.exit(bool(main(*map(int, sys.argv[1:]))))
