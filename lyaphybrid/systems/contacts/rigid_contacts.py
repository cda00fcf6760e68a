"""Rigid contacts: the jump of the velocities of a mechanical system at an impact."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..._arguments import is_number, numbers
from ..._jax.tracing import traced

__all__ = ["impact"]


def impact(mass_matrix: Any, gap: Callable, restitution: Any) -> Callable:
    """The reset of a rigid contact without friction: the momentum jumps along ∇gap, by Newton's law of restitution.

    The state is x = (q, v), m coordinates and their velocities v = dq/dt. Where the gap closes,

        v⁺ = v⁻ − (1 + r) M⁻¹n (n·v⁻ + ∂ₜgap) / (n·M⁻¹n),     n = ∂gap/∂q,

    so that M (v⁺ − v⁻) is parallel to n and the rate of the gap, n·v + ∂ₜgap, is multiplied by −r. The coordinates do
    not change. The functions take ``(t, x, args)`` with the whole state, as everywhere, so that `gap` is also the
    guard: ``lh.Transition(gap, lh.impact(mass_matrix, gap, restitution))``.

    Args:
        mass_matrix: M: ``(t, x, args) -> (m, m)``, symmetric and positive definite; or a constant matrix; or a number,
            the same mass for all coordinates.
        gap: ``(t, x, args) -> scalar``, the distance in the coordinates, positive where there is no contact; a
            function of t and q = x[:m] alone, in any unit, with ∂gap/∂q ≠ 0 where it is zero. Or ``-> (c,)`` for c
            contacts.
        restitution: r, from 0 to 1 (elastic): a number, or ``args -> number``. With r = 0 the contact stays closed
            until a force opens it, which needs a mode of its own.

    Returns:
        The reset, ``(t, x, args) -> x⁺``; with c contacts ``(t, x, args, which) -> x⁺``, as `lh.Transition` needs it.

    Raises:
        ValueError: on a mass matrix that is not symmetric and positive definite, a gap that is no function, a
            restitution outside [0, 1]; and, when the reset is traced, on a state of odd length, or a mass matrix or a
            gap of the wrong shape. If a function returns a mass matrix that is not positive definite, the run ends
            with the status `nonfinite`.

    Source:
        B. Brogliato, Nonsmooth Mechanics, Springer 2016, doi:10.1007/978-3-319-28664-8.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> def wall(t, x, args):  # a rod with its mass at the end, angle q, hangs at the distance 0.5 from a wall
        ...     return 0.5 - jnp.sin(x[0])
        >>> reset = lh.impact(1.0, wall, restitution=lambda args: args["r"])
        >>> rod = lh.Hybrid(lambda t, x, args: jnp.array([x[1], -jnp.sin(x[0])]), lh.Transition(wall, reset))
        >>> swing = lh.trajectory(rod, [0.0, 1.2], {"r": 0.5}, t1=1.0)
        >>> before, after = swing.events.x_before[0], swing.events.x_after[0]
        >>> round(float(after[1] / before[1]), 9)
        -0.5
    """
    if not callable(gap):
        raise ValueError(f"gap must be a function (t, x, args) -> scalar or (c,); got {gap!r}.")
    mass_of = mass_matrix if callable(mass_matrix) else _constant_mass(mass_matrix)
    restitution_of = restitution if callable(restitution) else _constant_restitution(restitution)

    def reset(t, x, args, which=None):
        if x.ndim != 1 or x.shape[0] % 2:
            raise ValueError(
                f"lh.impact wants the state (q, v), as many velocities as coordinates; got shape {x.shape}."
            )
        m = x.shape[0] // 2
        moving, gradient = jax.grad(_one_contact(gap, args, which), argnums=(0, 1))(t, x)
        normal = gradient[:m]
        per_force = _solved(mass_of(t, x, args), normal)
        rate = jnp.sum(normal * x[m:]) + moving
        r = jnp.asarray(restitution_of(args), x.dtype)
        impulse = (1 + r) * rate / jnp.sum(normal * per_force)
        return jnp.concatenate([x[:m], x[m:] - impulse * per_force])

    return reset


def _one_contact(gap: Callable, args, which) -> Callable:
    """The gap as a scalar function of (t, x)."""

    def chosen(t, x):
        distance = jnp.asarray(gap(t, x, args))
        if distance.shape == ():
            return distance
        if distance.ndim != 1:
            raise ValueError(f"The gap of an impact must return a scalar or (c,); got shape {distance.shape}.")
        if which is None:
            raise ValueError(
                f"This impact's gap has {distance.shape[0]} contacts: its reset is called with (t, x, args, which). "
                "The guard of its Transition must be the same gap."
            )
        return distance[which]

    return chosen


def _solved(mass, normal: Array) -> Array:
    """The vector M⁻¹n (m,)."""
    mass, m = jnp.asarray(mass, normal.dtype), normal.shape[0]
    if mass.shape == ():
        return normal / mass
    if mass.shape != (m, m):
        raise ValueError(
            f"The mass matrix must have shape (m, m) = ({m}, {m}), as many rows as coordinates; got {mass.shape}."
        )
    return jax.scipy.linalg.solve(mass, normal, assume_a="pos")


def _constant_mass(mass) -> Callable:
    if not traced(mass):
        _check_mass(mass)
    return lambda t, x, args: mass


def _check_mass(mass) -> None:
    wanted = "mass_matrix must be a function (t, x, args) -> (m, m), a symmetric positive definite matrix or a number"
    values = numbers("mass_matrix", mass)
    square = values.ndim == 0 or (values.ndim == 2 and values.shape[0] == values.shape[1])
    finite = bool(np.all(np.isfinite(values)))
    values = values.astype(float)
    symmetric = square and finite and np.allclose(values, values.T, rtol=1e-12, atol=0)
    if not (symmetric and np.all(np.linalg.eigvalsh(np.atleast_2d(values)) > 0)):
        raise ValueError(f"{wanted}; got {mass!r}.")


def _constant_restitution(restitution) -> Callable:
    if not traced(restitution) and not (is_number(restitution) and 0 <= restitution <= 1):
        raise ValueError(f"restitution must be between 0 and 1, or a function args -> number; got {restitution!r}.")
    return lambda args: restitution
