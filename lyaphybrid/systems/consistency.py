"""Consistent points of differential–algebraic equations: found from guesses, and checked at the start of runs."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optimistix
from jaxtyping import Array, Float

from .._arguments import State, numbers, parameters, real, require, shape
from .._jax.engines import compiled
from .._jax.precision import require_double
from .._jax.tracing import as_arrays, traced
from .._linalg.linear_systems import condition, split
from ..errors import NoConsistentPointError
from .daes.points import landed, solved, to_rounding
from .daes.semi_linear import DAE, ILL, RANK, Banded, Constrained, fields_of
from .validation import check_functions

__all__ = ["check_constraints", "consistent_start", "onto_constraints", "put_on_constraints", "tangent_frame"]


def consistent_start(dae: DAE, x0: State, args: Any = None, *, t0: Any = 0.0) -> Float[Array, " n"]:
    """The point that satisfies the constraints and has the differential part E₁ x₀ of a guess.

    Args:
        dae: an `lh.DAE`.
        x0: (n,) guess; for semi-explicit equations the differential components are kept and the others solved for. For
            an `lh.implicit_dae`, x alone or the whole state [x, v].
        args: pytree of parameters.
        t0: time.

    Returns:
        x (n,) with E₁ x = E₁ x₀ and f₂(t0, x) = 0.

    Raises:
        ValueError: on arguments that do not fit.
        NoConsistentPointError: if no such point is found from this guess; ``.result`` is the last iterate.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> circle = lh.DAE(
        ...     lambda t, args: jnp.diag(jnp.array([1.0, 0.0])),
        ...     lambda t, x, args: jnp.array([x[1], x[0] ** 2 + x[1] ** 2 - 1]),
        ...     n_differential=1,
        ... )
        >>> [round(float(value), 12) for value in lh.consistent_start(circle, [0.6, 1.0])]
        [0.6, 0.8]
    """
    require(isinstance(dae, DAE), f"consistent_start needs an lh.DAE; got {type(dae).__name__}.")
    real("t0", t0)
    args = jax.tree.map(lambda leaf: parameters("args", leaf), args)
    shape("x0", x0)
    x0 = dae.field.whole_guess(jnp.asarray(numbers("x0", x0, float)))
    require_double("x0", x0, "consistent_start")
    require(x0.ndim == 1 and bool(np.all(np.isfinite(x0))), f"x0 must be a finite state (n,); got {x0!r}.")
    check_functions(dae, jax.ShapeDtypeStruct(x0.shape, x0.dtype), args)
    x, off = _consistent(dae.field, x0, as_arrays(args, x0.dtype), jnp.asarray(t0, x0.dtype))
    if not traced(x):
        found = bool(np.all(np.isfinite(x))) and float(off) < 1e-6
        if not found:
            raise NoConsistentPointError(
                f"No consistent point with the differential part E₁ x of {x0} was found: the constraints are off by "
                f"{float(off):.3g}. Start nearer to one, and check that [E₁; ∂f₂/∂x] is nonsingular there.",
                x,
            )
    return x


def check_constraints(system: Any, x, t0, args: Any) -> None:
    """Check E against n_differential, and that a DAE is strangeness-free at its start x (n,); not for traced values.

    Raises:
        ValueError: on a row of E that should be zero and is not, on E₁ of lower rank, on a singular [E₁; ∂f₂/∂x].
    """
    fields = [field for field in fields_of(system) if isinstance(field, Constrained)]
    if not fields or traced((x, t0, args)):
        return
    with jax.ensure_compile_time_eval():  # constants are evaluated under jit, too
        matrices = _matrices(system, t0, x, args)
    if traced(matrices):  # the user's functions may close over traced values
        return
    matrices = jax.tree.map(np.asarray, matrices)  # under jit what JAX does with its arrays is traced
    for field, (leading, whole, condition_number) in zip(fields, matrices, strict=True):
        d, size = field.n_differential, max(float(np.max(np.abs(leading))), 1e-300)
        below = np.flatnonzero(np.max(np.abs(leading[d:]), axis=1, initial=0.0) > RANK * size)
        require(
            len(below) == 0,
            f"n_differential = {d}, but row {d + 1 + below[:1].sum()} of leading(t0, args) is not zero: put the "
            "differential equations first; lh.DAE.reduced does it for any E of constant rank.",
        )
        rank = int(np.linalg.matrix_rank(leading[:d], tol=RANK * size))
        require(
            rank == d,
            f"n_differential = {d}, but leading(t0, args) has rank {rank}. lh.DAE.reduced brings any E of constant "
            "rank into the form that is wanted.",
        )
        _check_band(field, leading[:d], whole[d:])
        if isinstance(system, DAE):
            require(
                bool(condition_number < ILL),
                "[E₁; ∂f₂/∂x] must be nonsingular at the start: either constraints depend on each other there, or the "
                "differentiation index is above one; differentiate the constraints until it is one.",
            )


def _check_band(field: Constrained, rows: np.ndarray, below: np.ndarray) -> None:
    """Raise a ValueError if a constraint depends on an algebraic component outside the band."""
    if not isinstance(field, Banded):
        return
    _, kernel = split(rows)
    size = np.abs(below @ kernel)
    i, j = np.nonzero(size > RANK * np.max(size))
    wide = int(np.max(np.abs(i - j), initial=0))
    require(
        wide <= field.bandwidth,
        f"bandwidth = {field.bandwidth}, but a constraint depends on the algebraic component {wide} places away: order "
        "both alike, so that neighbours are near each other, or give the larger bandwidth.",
    )


@compiled(hands_on=True)
def _matrices(system: Any, t, x, args) -> list[tuple]:
    """The matrices E and Ē (n, n) of each DAE, and the condition number of Ē."""
    check_functions(system, jax.ShapeDtypeStruct(x.shape, x.dtype), args)
    fields = [field for field in fields_of(system) if isinstance(field, Constrained)]
    wholes = [field.whole(t, x, args) for field in fields]
    return [(field.leading(t, args), whole, condition(whole)) for field, whole in zip(fields, wholes, strict=True)]


@compiled()
def _consistent(dae: Constrained, x0, args, t0):
    """The consistent point and its distance: a dogleg search from far away, then Newton to rounding.

    The search is in units of the largest component, which is its size of what counts as near; Newton's method has none.
    """
    differential_part = dae.differential_part(t0, x0, args)
    largest = jnp.max(jnp.abs(x0))
    unit = jnp.where(largest > 0, largest, 1.0)

    def off(scaled, _):
        x = unit * scaled
        away = [dae.differential_part(t0, x, args) - differential_part, dae.constraint(t0, x, args)]
        return jnp.concatenate(away) / unit

    rough = optimistix.root_find(off, optimistix.Dogleg(1e-6, 1e-6), x0 / unit, max_steps=256, throw=False).value
    x, _ = solved(dae, args, t0, differential_part, unit * rough, to_rounding(x0))
    return x, dae.distance(t0, x, args, to_rounding(x0).atol)


@compiled()
def tangent_frame(dae: DAE, t0, x0, args) -> Float[Array, "n d"]:
    """Perturbations that change one component of E₁ x each: the first d columns of Ē⁻¹."""
    return dae.field.inverse_blocks(t0, x0, args).differential_part


@compiled()
def onto_constraints(dae: DAE, t0, x0, args, frame: Float[Array, "n k"]) -> Float[Array, "n k"]:
    """The columns of a frame, projected onto the tangent space of the constraints at x0 (n,)."""
    return dae.field.onto(t0, x0, args, frame)


@compiled()
def put_on_constraints(field: Constrained, t, x, args) -> Float[Array, " n"]:
    """The point on the constraints with the differential part E₁ x of x (n,)."""
    return landed(field, args, t, x)
