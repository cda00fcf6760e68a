"""A second implementation that shares no code with ours: diffrax finds the events, the formulas are written out.

A hybrid system with one mode: x' = field(t, x, args) until guard(t, x, args) falls through zero, then
x⁺ = reset(t, x, args). The variational equation Y' = Df Y is integrated with the state, its Jacobian by
`jax.jacfwd` of the field; at an event Y⁺ = S Y with S = Dg + (f⁺ - Dg f⁻ - ∂ₜg) ∇h / (∂ₜh + ∇h·f⁻), the matrix
formed; then QR. An outer `lax.scan` makes one `diffrax.diffeqsolve` per event. What diffrax leaves to the user
(facts of diffrax 0.7): it compares the signs of a guard at the ends of steps only, so that two crossings
within one step are not seen, and a guard that starts at zero or below cannot fire in the first step: `dt0`,
the first step after an event, has to be short against the shortest flight.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import optimistix

SOLVER = diffrax.Dopri5()
# At coarse tolerances Newton's steps on the dense output may not end: then bisection.
NEWTON, BISECTION = optimistix.Newton(1e-12, 1e-12), optimistix.Bisection(1e-12, 1e-12)


class Options(NamedTuple):
    """How a segment between two events is integrated; hashable, so that it can be static."""

    rtol: float = 1e-9
    atol: float = 1e-12
    dt0: float = 1e-3
    root_finder: optimistix.AbstractRootFinder = NEWTON
    orthonormalise: bool = True
    segments_per_call: int = 256


class Found(NamedTuple):
    """What a run found."""

    exponents: np.ndarray  # (k,) in the order of the columns
    growth: np.ndarray  # (k,) Σ ln R_ii
    t: np.ndarray  # (events,)
    x_before: np.ndarray  # (events, n)
    x_after: np.ndarray  # (events, n)
    x: np.ndarray  # (n,) at the end
    columns: np.ndarray  # (n, k) at the end: the tangent map where nothing was orthonormalised


def diffrax_spectrum(
    field: Callable,
    guard: Callable,
    reset: Callable,
    x0,
    args: Any = None,
    *,
    t1: float,
    t0: float = 0.0,
    columns=None,
    longest: float = 10.0,
    solver: diffrax.AbstractSolver = SOLVER,
    options: Options = Options(),  # noqa: B008  immutable
) -> Found:
    """Exponents, events and tangent map from t0 to t0 + t1; compiled once for the same functions and options.

    Args:
        field, guard, reset: of ``(t, x, args)``; the guard is a scalar and fires where it falls through zero.
        x0: (n,) start.
        args: pytree of parameters.
        t1: length.
        t0: time at the start.
        columns: (n, k) to begin with; None: the identity.
        longest: time without an event after which the columns are orthonormalised anyhow.
        solver: of diffrax.
        options: tolerances and the rest.
    """
    x = jnp.asarray(x0, float)
    columns = jnp.eye(x.shape[0]) if columns is None else jnp.asarray(columns, float)
    functions = (field, guard, reset)
    state = (jnp.asarray(t0, float), x, columns, jnp.zeros(columns.shape[1]))
    end, longest = jnp.asarray(t0 + t1, float), jnp.asarray(longest, float)
    orthonormalise_and_accumulate = []
    while float(state[0]) < float(end):
        state, events = _segments(functions, solver, options, args, state, end, longest)
        orthonormalise_and_accumulate.append(events)
    fired, *events = (np.concatenate(part) for part in zip(*orthonormalise_and_accumulate, strict=True))
    growth = np.asarray(state[3])
    found = (part[fired] for part in events)
    return Found(growth / t1, growth, *found, np.asarray(state[1]), np.asarray(state[2]))


@functools.partial(jax.jit, static_argnums=(0, 1, 2))
def _segments(functions, solver, options: Options, args, state, end, longest):
    """So many segments, each up to an event, `longest` or the end."""

    def one(state, _):
        t, x, columns, growth = state
        t, x, columns, fired = _fly(functions, solver, options, args, t, x, columns, jnp.minimum(t + longest, end))
        after, matrix = _saltation(functions, args, t, x)
        crossed = jnp.where(fired, after, x)
        columns = jnp.where(fired, matrix @ columns, columns)
        if options.orthonormalise:
            columns, r = jnp.linalg.qr(columns)
            diagonal = jnp.diagonal(r)
            columns = columns * jnp.sign(diagonal)[None, :]
            growth = growth + jnp.log(jnp.abs(diagonal))
        return (t, crossed, columns, growth), (fired, t, x, crossed)

    return jax.lax.scan(one, state, None, length=options.segments_per_call)


def _fly(functions, solver, options: Options, args, base, x, columns, end):
    """State and columns together to the event or the end; whether it was an event.

    In time local to the segment: a root finder that compares its residual with 1e-12 fails at t = 4000 else.
    """
    field, guard, _ = functions

    def variational(s, y, args):
        x, columns = y
        return field(base + s, x, args), jax.jacfwd(field, argnums=1)(base + s, x, args) @ columns

    def condition(t, y, args, **_):
        return guard(base + t, y[0], args)

    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(variational),
        solver,
        jnp.zeros_like(base),
        end - base,
        options.dt0,
        (x, columns),
        args,
        stepsize_controller=diffrax.PIDController(options.rtol, options.atol),
        event=diffrax.Event(condition, options.root_finder, direction=False),
        adjoint=diffrax.ForwardMode(),
        max_steps=None,
    )
    x, columns = jax.tree.map(lambda leaf: leaf[-1], solution.ys)
    return base + solution.ts[-1], x, columns, solution.event_mask


def _saltation(functions, args, t, x):
    """The reset and the saltation matrix, formed."""
    field, guard, reset = functions
    after = reset(t, x, args)
    before = field(t, x, args)
    dg = jax.jacfwd(reset, argnums=1)(t, x, args)
    dg_dt = jax.jacfwd(reset, argnums=0)(t, x, args)
    dh = jax.jacfwd(guard, argnums=1)(t, x, args)
    dh_dt = jax.jacfwd(guard, argnums=0)(t, x, args)
    jump = field(t, after, args) - dg @ before - dg_dt
    return after, dg + jnp.outer(jump, dh) / (dh_dt + dh @ before)
