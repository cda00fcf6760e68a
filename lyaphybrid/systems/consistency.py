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
from .._linalg.linear_systems import condition
from ..errors import NoConsistentPointError
from .daes.bands import places_away
from .daes.implicit_fields import ImplicitField, in_few_words
from .daes.points import landed, solved, to_rounding
from .daes.semi_linear import DAE, ILL, RANK, Banded, Constrained, fields_of
from .validation import check_functions

__all__ = [
    "check_constraints",
    "check_fixed_parts",
    "consistent_start",
    "onto_constraints",
    "put_on_constraints",
    "tangent_frame",
]

CONSISTENT = 1e-6  # distance from the constraints, in the units of their check, up to which a point is found


def consistent_start(dae: DAE, x0: State, args: Any = None, *, t0: Any = 0.0) -> Float[Array, " n"]:
    """The point that satisfies the constraints and has the differential part E₁ x₀ of a guess.

    Args:
        dae: an `lh.DAE`.
        x0: (n,) guess; for semi-explicit equations the differential components are kept and the others solved for. For
            an `lh.implicit_dae`, the whole state [x, v], or x alone, to which v comes from the slope given there.
        args: pytree of parameters.
        t0: time.

    Returns:
        x (n,) with E₁ x = E₁ x₀ and f₂(t0, x) = 0. Under jit, vmap or grad, where nothing can be raised, nan if no such
        point is found.

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
    known = traced(x0) or bool(np.all(np.isfinite(x0)))
    require(x0.ndim == 1 and known, f"x0 must be a finite state (n,); got {x0!r}.")
    check_functions(dae, jax.ShapeDtypeStruct(x0.shape, x0.dtype), args)
    x, off = _consistent(dae.field, x0, as_arrays(args, x0.dtype), jnp.asarray(t0, x0.dtype))
    if traced(x):
        return jnp.where(off < CONSISTENT, x, jnp.nan)
    found = bool(np.all(np.isfinite(x))) and float(off) < CONSISTENT
    lost = _checked_slopes(dae, x if found else x0, t0, args)
    if not found:
        raise NoConsistentPointError(
            f"No consistent point with the differential part E₁ x of {x0} was found: the constraints are off by "
            f"{float(off):.3g}. Start nearer to one, and check that [E₁; ∂f₂/∂x] is nonsingular there.{lost}",
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
    for field, (leading, condition_number, fixed) in zip(fields, matrices, strict=True):
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
        _check_fixed(field, fixed, x, t0, args)
        if isinstance(system, DAE):
            require(
                bool(condition_number < ILL),
                "[E₁; ∂f₂/∂x] must be nonsingular at the start: either constraints depend on each other there, or the "
                "differentiation index is above one; differentiate the constraints until it is one."
                + _lost_slopes(field, fixed, args),
            )


def check_fixed_parts(system: Any, number: int, x, t, args: Any) -> None:
    """Check at a state of one mode of a DAE what was fixed before: its bandwidth, the kernel of ∂F/∂x'.

    Raises:
        ValueError: if a coupling is outside the band, or F(t, x, x') = 0 contains more of x'.
    """
    fields = fields_of(system)
    which = sum(isinstance(one, Constrained) for one in fields[:number])
    *_, fixed = _matrices(system, t, x, args)[which]
    _check_fixed(fields[number], jax.tree.map(np.asarray, fixed), x, t, args)


def _checked_slopes(dae: DAE, x, t0, args: Any) -> str:
    """Refuse args with which F(t, x, x') = 0 contains more of x'; returns what to say if it contains less."""
    if not isinstance(dae.field, ImplicitField):
        return ""
    t, args = jnp.asarray(t0, x.dtype), as_arrays(args, x.dtype)
    *_, fixed = jax.tree.map(np.asarray, _matrices(dae, t, x, args)[0])
    _check_fixed(dae.field, fixed, x, t, args)
    return _lost_slopes(dae.field, fixed, args)


def _check_fixed(field: Constrained, fixed: Any, x, t, args) -> None:
    """Raise a ValueError where a field has other `_fixed_parts` than its bandwidth, or its construction, says."""
    if isinstance(field, Banded):
        require(
            fixed <= field.bandwidth,
            f"bandwidth = {field.bandwidth}, but a constraint depends on the algebraic component {int(fixed)} places "
            "away, here or at other states: order both alike, so that neighbours are near each other, or give the "
            "larger bandwidth.",
        )
    if isinstance(field, ImplicitField):
        _, outside = fixed
        more = np.flatnonzero(np.any((outside != 0) & np.isfinite(outside), axis=0))
        names = " and ".join(f"x{i}'" for i in more[:4]) + (" and more" if len(more) > 4 else "")
        require(
            len(more) == 0,
            f"The kernel of ∂F/∂x' has changed since lh.implicit_dae looked at it: with args = {in_few_words(args)} at "
            f"t = {float(t):.6g}, x = {np.asarray(x)[: field.n]} F contains {names}, which would be dropped; it was "
            f"built with args = {field.built_with}. Build it with the args of the run; if they are these, take what is "
            "differentiated as variables.",
        )


def _lost_slopes(field: Constrained, fixed: Any, args) -> str:
    """What to say of a singular Ē, if F contains fewer components of x' than when it was built."""
    if not isinstance(field, ImplicitField) or not np.all(np.isfinite(fixed[0])):
        return ""
    inside = fixed[0] / np.maximum(np.max(np.abs(fixed[0]), axis=1, keepdims=True), 1e-300)
    rank = int(np.linalg.matrix_rank(inside, tol=RANK))
    if rank == field.n_differential:
        return ""
    return (
        f" Here ∂F/∂x' has rank {rank} with args = {in_few_words(args)}, and lh.implicit_dae was built with args = "
        f"{field.built_with}, where it has rank {field.n_differential}: build it with the args of the run."
    )


@compiled(hands_on=True)
def _matrices(system: Any, t, x, args) -> list[tuple]:
    """The matrix E (n, n) of each DAE, the condition number of Ē, and its `_fixed_parts`."""
    check_functions(system, jax.ShapeDtypeStruct(x.shape, x.dtype), args)
    fields = [field for field in fields_of(system) if isinstance(field, Constrained)]
    return [
        (field.leading(t, args), condition(field.whole(t, x, args)), _fixed_parts(field, t, x, args))
        for field in fields
    ]


def _fixed_parts(field: Constrained, t, x, args) -> Any:
    """What a field has fixed, as it is here: the width of its band, or parts of ∂F/∂x'."""
    if isinstance(field, ImplicitField):
        return field.slope_matrices(t, x, args)
    return places_away(field, t, x, args) if isinstance(field, Banded) else ()


@compiled()
def _consistent(dae: Constrained, x0, args, t0):
    """The consistent point and its distance: a dogleg search from far away, then Newton to rounding."""
    differential_part = dae.differential_part(t0, x0, args)
    # The root has the derivative of the equations' solution, wherever its iteration began.
    guess = _rough(dae, *jax.lax.stop_gradient((x0, args, t0)))
    x, _ = solved(dae, args, t0, differential_part, guess, to_rounding(x0))
    return x, dae.distance(t0, x, args, to_rounding(x0).atol)


def _rough(dae: Constrained, x0, args, t0):
    """A point near the consistent one, by a dogleg search.

    It is in units of the largest component, which is its size of what counts as near.
    """
    wanted = dae.differential_part(t0, x0, args)
    largest = jnp.max(jnp.abs(x0))
    unit = jnp.where(largest > 0, largest, 1.0)

    def off(scaled, _):
        x = unit * scaled
        away = [dae.differential_part(t0, x, args) - wanted, dae.constraint(t0, x, args)]
        return jnp.concatenate(away) / unit

    return unit * optimistix.root_find(off, optimistix.Dogleg(1e-6, 1e-6), x0 / unit, max_steps=256, throw=False).value


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
