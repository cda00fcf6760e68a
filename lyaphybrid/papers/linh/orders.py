"""Observed orders with equal steps: of the half-explicit method with and without (9), and of exponents."""

import functools

import jax
import jax.numpy as jnp
import numpy as np

from ..._jax.engines import compiled
from ..._linalg.frames import orthonormalise
from ...integrators import ESDIRK, ContinuousQR, HalfExplicit, RadauIIA
from ...integrators.base import Method
from ...integrators.runge_kutta import TABLEAUX
from ...systems.bound import Bound
from ...systems.daes.points import landed
from ...systems.daes.semi_linear import Constrained
from .rectangle import RightRectangle
from .tables import frame_at_start, problem_of

__all__ = [
    "COUNTS", "EXPONENT_ORDERS", "ORDERS", "end", "errors_at_end", "errors_of_exponents", "exponents_at_end",
    "unreformulated",
]  # fmt: skip

COUNTS = (8, 16, 32, 64, 128)  # numbers of equal steps over a unit of time
NEWTON_ITERATIONS = 6  # Newton iterations of the method without the reformulation
ENOUGH = 2000  # steps of order 8, for the reference end


def _advance(example: str, kind: str):
    """One step, (t, x, h) -> x."""
    system, _, args = problem_of(example)
    field, dae = Bound(system.field, args), system.field
    if kind == "unreformulated":
        return functools.partial(unreformulated, dae, args)
    method = (
        HalfExplicit(rtol=1e-14, tableau="dopri8", atol=1e-14)
        if kind == "exact"
        else HalfExplicit(rtol=1e-13, atol=1e-13)
    )

    def advance(t, x, h):
        done = method.step(field, t, x, field(t, x), h)
        return landed(dae, args, t + h, done.x - done.error[0]) if kind == "embedded" else done.x

    return advance


def unreformulated(dae: Constrained, args, t, x, h):
    """Dormand and Prince's step for E x' = f as it stands: E₁(T_i) K_i = f₁(T_i, U_i), and f₂ = 0 in the next stage."""
    table, d, count = TABLEAUX["dopri5"], dae.n_differential, len(TABLEAUX["dopri5"].a)
    weights = np.zeros((count, count))
    for i, row in enumerate(table.a):
        weights[i, : i + 1] = row
    nodes = np.array([0.0, *table.c])

    def stage(state, given):
        point, slopes, guess = state
        i, row, share, now, ahead = given
        slope, rows = dae.residual(t + now * h, point, args)[:d], dae.leading(t + now * h, args)[:d]
        base, share = x + h * (row @ slopes), h * share

        def left(k):
            return jnp.concatenate([rows @ k - slope, dae.constraint(t + ahead * h, base + share * k, args) / share])

        k = jax.lax.fori_loop(
            0, NEWTON_ITERATIONS, lambda _, k: k - jnp.linalg.solve(jax.jacfwd(left)(k), left(k)), guess
        )
        return (base + share * k, slopes.at[i].set(k), k), None

    given = np.arange(count), np.tril(weights, -1), np.diag(weights), nodes[:-1], nodes[1:]
    start = x, jnp.zeros((count, *x.shape), x.dtype), jnp.zeros_like(x)
    return jax.lax.scan(stage, start, jax.tree.map(jnp.asarray, given))[0][0]


def end(example: str, kind: str, counts) -> np.ndarray:
    """The state x(1) by equal steps, for each of the counts."""
    _, x0, _ = problem_of(example)
    advance = _advance(example, kind)

    @jax.jit
    def run(count):
        h = 1.0 / count.astype(x0.dtype)
        return jax.lax.fori_loop(0, count, lambda i, x: advance(i.astype(x0.dtype) * h, x, h), x0)

    return np.stack([np.asarray(run(jnp.asarray(count, jnp.int32))) for count in counts])


ORDERS = {
    "propagated": ("5.2", "propagated"),
    "embedded": ("5.2", "embedded"),
    "without (9)": ("5.2", "unreformulated"),
    "without (9), constant E": ("5.1", "unreformulated"),
}


def errors_at_end(name: str) -> np.ndarray:
    """Error of x(1), largest component, for each of `COUNTS`; `name`: one of `ORDERS`."""
    example, kind = ORDERS[name]
    return np.max(np.abs(end(example, kind, COUNTS) - end(example, "exact", (ENOUGH,))), axis=1)


# Exponents.

FINE = 1e-13  # tolerance of Newton's iterations
# In Example 5.2 the errors of the continuous algorithm change their sign between these steps.
EXPONENT_ORDERS: dict[str, tuple[str, Method, int]] = {
    "discrete": ("5.2", HalfExplicit(rtol=FINE, atol=FINE), 5),
    "discrete, ESDIRK34": ("5.2", ESDIRK("esdirk34", rtol=FINE, atol=FINE), 4),
    "discrete, ESDIRK54b": ("5.2", ESDIRK("esdirk54b", rtol=FINE, atol=FINE), 5),
    "discrete, Radau IIA": ("5.2", RadauIIA(rtol=FINE, atol=FINE), 5),
    "continuous": ("5.1", ContinuousQR(HalfExplicit(rtol=FINE, atol=FINE)), 5),
    "continuous, ESDIRK54b": ("5.1", ContinuousQR(ESDIRK("esdirk54b", rtol=FINE, atol=FINE)), 5),
    "continuous, right rectangle": ("5.1", RightRectangle(HalfExplicit(rtol=FINE, atol=FINE)), 1),
}


@compiled()
def _at_end(example: str, method: Method, x0, frame, args, count):
    field, h = Bound(problem_of(example)[0].field, args), 1.0 / count.astype(x0.dtype)

    def step(i, state):
        x, frame, total = state
        t = i.astype(x0.dtype) * h
        done = method.step(field, t, x, field(t, x), h)
        moved = method.tangent(field, t, x, h, frame, done.stage_points)
        frame, logs, _ = orthonormalise(moved.frame)
        return done.x, frame, total + (logs if moved.growth is None else moved.growth)

    return jax.lax.fori_loop(0, count, step, (x0, frame, jnp.zeros(2, x0.dtype)))[2]


def exponents_at_end(example: str, method: Method, counts) -> np.ndarray:
    """λ_i(1) (counts, 2) by so many equal steps, ln R(t₀) not counted."""
    _, x0, args = problem_of(example)
    frame = frame_at_start(example)[0]
    return np.stack([np.asarray(_at_end(example, method, x0, frame, args, np.asarray(n, np.int32))) for n in counts])


def errors_of_exponents(name: str) -> np.ndarray:
    """The larger error of λ_i(1) for each of `COUNTS`; `name`: one of `EXPONENT_ORDERS`."""
    example, method, _ = EXPONENT_ORDERS[name]
    exact = exponents_at_end(example, HalfExplicit(rtol=1e-14, tableau="dopri8", atol=1e-14), (ENOUGH,))
    return np.max(np.abs(exponents_at_end(example, method, COUNTS) - exact), axis=1)
