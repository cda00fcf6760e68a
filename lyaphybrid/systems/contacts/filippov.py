"""Filippov systems: two fields and a switching surface become a `Hybrid` that crosses the surface and slides on it.

With v± = ∂ₜh + ∇h·f±, the rates of the surface's function h along the two fields, on h = 0:

    v₊ < 0, v₋ < 0     the motion crosses from plus to minus             S = I + (f₋ − f₊) ∇h / v₊
    v₊ < 0 < v₋        both fields point at the surface: sliding,        S = I + (fₛ − f₊) ∇h / v₊, of rank n − 1
    v₊ > 0 > v₋        both point away: the continuation is not unique, `deadlock`

fₛ = (v₋ f₊ − v₊ f₋) / (v₋ − v₊) is the convex combination of both that stays on the surface. Sliding ends where v₊ or
v₋ reaches zero, tangentially: there fₛ is f₊ or f₋, and S = I. If stiction exceeds kinetic friction the motion stays
on the surface longer, within a larger *stick* set, and fₛ is no combination of the two: both can be given.

A. F. Filippov, Differential Equations with Discontinuous Righthand Sides (Kluwer 1988), doi:10.1007/978-94-015-7793-9.
"""

from collections.abc import Callable, Sequence
from typing import Any

from ..hybrid import Hybrid, Transition, never
from ..smooth import Flow
from .surfaces import (
    BeforeCrossing,
    InitialMode,
    LeavesToOneSide,
    ModeAfterArrival,
    ModeAfterSliding,
    SlidingField,
    SlidingMargins,
    SurfaceProjection,
    SurfaceReset,
    TwoSidedSurface,
)

__all__ = ["filippov"]

Function = Callable[..., Any]


def filippov(
    plus: Any,
    minus: Any,
    surface: Any,
    *,
    sliding: Any = None,
    stick: Any = None,
    names: Sequence[str] | None = None,
    units: Sequence[str] | None = None,
    time_unit: str | None = None,
) -> Hybrid:
    """A system with the field `plus` where surface > 0 and `minus` where surface < 0, sliding on surface = 0 included.

    The modes are "plus", "minus" and "sliding". The saltation matrices follow from guards, resets and fields, as for
    any `lh.Hybrid`. On entering the sliding mode a direction is lost (exponents of −inf).

    Args:
        plus: ``(t, x, args) -> dx/dt``, or an `lh.Flow`: one smooth field.
        minus: the same for the other side.
        surface: ``(t, x, args) -> scalar``, continuously differentiable, ∇h ≠ 0 where it is zero.
        sliding: ``(t, x, args) -> dx/dt`` on the surface; None: Filippov's convex combination.
        stick: ``(t, x, args) -> scalar`` or ``(m,)``, smooth margins: all are positive while the motion sticks to the
            surface; when one falls through zero it leaves to the side to which v₊ + v₋ points. The set where all are
            positive must contain the set where both fields point at the surface. With the force F along the surface's
            normal and the largest force F_s of stiction: ``jnp.stack([F_s - F, F_s + F])``. None: the set where both
            fields point at the surface.
        names: what the components of x are called, as for `lh.Flow`.
        units: in which they are measured, likewise.
        time_unit: in which time is measured, as for `lh.Flow`.

    For several surfaces that do not intersect, give sequences with one entry per surface: `surface`, `plus`, `minus`,
    and `sliding` and `stick` where they are wanted (an entry may be None). Fields that are the same function belong to
    the same region. The modes are then "region0", "region1", … in the order in which the fields first occur (plus[0],
    minus[0], plus[1], …) and "sliding0", "sliding1", … by surface. A slide that meets another surface of its regions
    all the same ends as ``deadlock``.

    Returns:
        An `lh.Hybrid`. Without `mode` a run starts in the mode to which its start belongs: by the sign of the surface,
        or on the surface by the two fields, with ``deadlock`` if both point away from it.

    Raises:
        ValueError: if an argument is not a function, or the sequences have different lengths.

    Source:
        A. F. Filippov, Differential Equations with Discontinuous Righthand Sides (Kluwer 1988),
        doi:10.1007/978-94-015-7793-9; R. I. Leine & H. Nijmeijer, Dynamics and Bifurcations of Non-Smooth Mechanical
        Systems (Springer 2004), doi:10.1007/978-3-540-44398-8.

    Example:
        A block (x, v) on a rough table under a periodic force:

        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> def rubbed(sign):
        ...     return lambda t, x, args: jnp.stack([x[1], jnp.sin(t) - 0.6 * sign])
        >>> block = lh.filippov(rubbed(1), rubbed(-1), lambda t, x, args: x[1])
        >>> block.mode_names
        ('plus', 'minus', 'sliding')
        >>> run = lh.trajectory(block, [0.0, 0.0], t1=3.0)  # at rest until sin t = 0.6
        >>> round(float(run.events.t[0]), 9)
        0.643501109
    """
    several = isinstance(surface, Sequence)
    given = {"surface": surface, "plus": plus, "minus": minus, "sliding": sliding, "stick": stick}
    named = {name: _one_each(name, value, surface) for name, value in given.items()}
    sides = [
        TwoSidedSurface(*(_field_function(name, named[name][i]) for name in named))
        for i in range(len(named["surface"]))
    ]
    regions: list[Function] = []
    for side in sides:
        regions += [field for field in (side.plus, side.minus) if all(field is not other for other in regions)]
    if not several:
        regions = [sides[0].plus, sides[0].minus]
    where = [(_place(side.plus, regions), _place(side.minus, regions)) for side in sides]
    where = where if several else [(0, 1)]
    modes = [f"region{i}" for i in range(len(regions))] if several else ["plus", "minus"]
    modes += [f"sliding{i}" for i in range(len(sides))] if several else ["sliding"]
    transitions = []
    for i, (side, (above, below)) in enumerate(zip(sides, where, strict=True)):
        transitions += _transitions(side, modes, above, below, len(regions) + i)
    transitions += _crossings(sides, where, modes, len(regions))
    slides = modes[len(regions) :]
    return Hybrid(
        dict(zip(modes, [*regions, *(SlidingField(side) for side in sides)], strict=True)),
        transitions,
        tangent={name: SurfaceProjection(side.surface) for name, side in zip(slides, sides, strict=True)},
        initial_mode=InitialMode(tuple(sides), tuple(where), len(regions)),
        names=names,
        units=units,
        time_unit=time_unit,
    )


def _one_each(name: str, value: Any, surface: Any) -> Sequence:
    """The argument as a sequence with one entry per surface."""
    if not isinstance(surface, Sequence):
        return (value,)
    if value is None:
        return (None,) * len(surface)
    if not isinstance(value, Sequence) or len(value) != len(surface) or not len(surface):
        raise ValueError(
            f"With several surfaces {name} must be a sequence with one entry for each of the {len(surface)}; "
            f"got {value!r}."
        )
    return value


def _field_function(name: str, function: Any) -> Any:
    """The user's function; the field if a `Flow` is given."""
    function = function.field if isinstance(function, Flow) else function
    if function is None and name in ("sliding", "stick"):
        return None
    if not callable(function):
        raise ValueError(f"{name} must be a function of (t, x, args); got {function!r}.")
    return function


def _place(field: Function, regions: list[Function]) -> int:
    return next(i for i, other in enumerate(regions) if other is field)


def _transitions(side: TwoSidedSurface, modes: list[str], above: int, below: int, slides: int) -> list[Transition]:
    """The three transitions of a surface: from plus, from minus, and from sliding."""
    onto, surface = SurfaceReset(side), side.surface
    leave = LeavesToOneSide(side) if side.sliding is None and side.stick is None else None
    return [
        Transition(surface, onto, source=modes[above], target=ModeAfterArrival(side, below, slides), direction=-1),
        Transition(surface, onto, source=modes[below], target=ModeAfterArrival(side, above, slides), direction=+1),
        Transition(
            SlidingMargins(side), onto, source=modes[slides], target=ModeAfterSliding(side, above, below), when=leave
        ),
    ]


def _crossings(sides: list[TwoSidedSurface], where: list[tuple[int, int]], modes: list[str], regions: int) -> list:
    """Where the slide along a surface leaves one of its two regions through another surface: no mode goes on there."""
    found = []
    for i, own in enumerate(where):
        for j, other in enumerate(where):
            signs = [sign for region, sign in zip(other, (-1, 1), strict=True) if region in own and i != j]
            source = modes[regions + i]
            found += [Transition(BeforeCrossing(sides[j], -sign), when=never, source=source) for sign in signs]
    return found
