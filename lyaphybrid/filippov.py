"""Filippov systems: two fields and a switching surface become a `Hybrid` that slips, crosses and slides.

With v± = ∂ₜh + ∇h·f±, the rates of the surface's function h along the two fields, on h = 0:

    v₊ < 0, v₋ < 0     from plus the motion crosses to minus             S = I + (f₋ − f₊) ∇h / v₊
    v₊ < 0 < v₋        both fields point at the surface: it slides,      S = I + (fₛ − f₊) ∇h / v₊, of rank n − 1
    v₊ > 0 > v₋        both point away: it cannot be continued in one way, `deadlock`

fₛ = (v₋ f₊ − v₊ f₋) / (v₋ − v₊) is the convex combination of both that stays on the surface. It is left where v₊ or
v₋ reaches zero, tangentially: there fₛ is f₊ or f₋, and S = I. Where stiction exceeds kinetic friction the motion stays
on the surface longer, in a *stick* set that is larger, and fₛ is no combination of the two: both can be given.

A. F. Filippov, Differential Equations with Discontinuous Righthand Sides (Kluwer 1988), doi:10.1007/978-94-015-7793-9.
"""

from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from .events import BLUR
from .precision import digits
from .systems import Flow, Hybrid, Transition

__all__ = ["filippov"]

TWO_FOLD = 1e-8  # both fields are tangent to the surface where both rates are below this, relative to |∇h| |f|

Function = Callable[..., Any]


def filippov(plus: Any, minus: Any, surface: Any, *, sliding: Any = None, stick: Any = None) -> Hybrid:
    """A system with the field `plus` where surface > 0 and `minus` where surface < 0, sliding on surface = 0 included.

    The modes are "plus", "minus" and "sliding". No saltation matrix is written anywhere: all come from guards,
    resets and fields. On entering the sliding mode a direction is lost (exponents of −inf).

    Args:
        plus: ``(t, x, args) -> dx/dt``, or an `lh.Flow`: one smooth field.
        minus: the same for the other side.
        surface: ``(t, x, args) -> scalar``, continuously differentiable, ∇h ≠ 0 where it is zero.
        sliding: ``(t, x, args) -> dx/dt`` on the surface; None: Filippov's convex combination.
        stick: ``(t, x, args) -> scalar`` or ``(m,)``, smooth: margins that are positive while the motion sticks to the
            surface, and of which one falls through zero where it breaks away, to the side to which v₊ + v₋ points.
            The set where all are positive contains that where both fields point at the surface. With the forces F
            along the surface's normal and F_s of stiction: ``jnp.stack([F_s - F, F_s + F])``. None: the set where
            both fields point at the surface.

    Several surfaces that do not meet: sequences of one entry a surface, for `surface`, `plus` and `minus`, and for
    `sliding` and `stick` where they are given (None in places). Fields that are the same function belong to the same
    region. The modes are then "region0", "region1", … in the order in which the fields are named (plus[0], minus[0],
    plus[1], …) and "sliding0", "sliding1", … by surface.

    Returns:
        An `lh.Hybrid`. Without `mode` a run starts in the mode to which its start belongs: by the sign of the surface;
        on the surface by the two fields, and with ``deadlock`` where both point away from it.

    Raises:
        ValueError: if one of them is no function, or the sequences have different lengths.

    Source:
        A. F. Filippov, Differential Equations with Discontinuous Righthand Sides (Kluwer 1988),
        doi:10.1007/978-94-015-7793-9; R. I. Leine & H. Nijmeijer, Dynamics and Bifurcations of Non-Smooth Mechanical
        Systems (Springer 2004), doi:10.1007/978-3-540-44398-8.

    Example:
        A block (x, v) on a rough table, pulled to and fro:

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
    sides = [_Side(*(_plain(name, named[name][i]) for name in named)) for i in range(len(named["surface"]))]
    regions: list[Function] = []
    for side in sides:
        regions += [field for field in (side.plus, side.minus) if all(field is not other for other in regions)]
    if not several:
        regions = [sides[0].plus, sides[0].minus]
    where = [(_place(side.plus, regions), _place(side.minus, regions)) for side in sides]
    where = where if several else [(0, 1)]
    names = [f"region{i}" for i in range(len(regions))] if several else ["plus", "minus"]
    names += [f"sliding{i}" for i in range(len(sides))] if several else ["sliding"]
    transitions = []
    for i, (side, (above, below)) in enumerate(zip(sides, where, strict=True)):
        transitions += _transitions(side, names, above, below, len(regions) + i)
    slides = names[len(regions) :]
    return Hybrid(
        dict(zip(names, [*regions, *(_Sliding(side) for side in sides)], strict=True)),
        transitions,
        tangent={name: _Along(side.surface) for name, side in zip(slides, sides, strict=True)},
        initial_mode=_Start(tuple(sides), tuple(where), len(regions)),
    )


def _one_each(name: str, value: Any, surface: Any) -> Sequence:
    """One entry a surface."""
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


def _plain(name: str, function: Any) -> Any:
    """A user's function; of a `Flow` its field."""
    function = function.field if isinstance(function, Flow) else function
    if function is None and name in ("sliding", "stick"):
        return None
    if not callable(function):
        raise ValueError(f"{name} must be a function of (t, x, args); got {function!r}.")
    return function


def _place(field: Function, regions: list[Function]) -> int:
    return next(i for i, other in enumerate(regions) if other is field)


# Modules instead of closures: two systems made of the same functions are then the same to JAX, and compile once.


class _Side(eqx.Module):
    """A surface and what is known about its two sides."""

    surface: Function
    plus: Function
    minus: Function
    sliding: Function | None
    stick: Function | None

    def rate(self, field: Function, t, x, args):
        """∂ₜh + ∇h·f, and f."""
        f = field(t, x, args)
        return jax.jvp(lambda t, x: self.surface(t, x, args), (t, x), (jnp.ones_like(t), f))[1], f

    def rates(self, t, x, args):
        """v₊ and v₋."""
        return self.rate(self.plus, t, x, args)[0], self.rate(self.minus, t, x, args)[0]

    def holds(self, t, x, args):
        """Whether a motion on the surface stays on it."""
        v_plus, v_minus = self.rates(t, x, args)
        attracts = (v_plus < 0) & (v_minus > 0)
        return attracts if self.stick is None else attracts | jnp.all(self.margins(t, x, args) > 0)

    def margins(self, t, x, args):
        """What the user's stick set leaves before it is left."""
        assert self.stick is not None
        margins = jnp.asarray(self.stick(t, x, args))
        if not jnp.issubdtype(margins.dtype, jnp.floating):
            raise ValueError(
                "stick must return margins, smooth numbers that are positive while the motion sticks and fall through "
                f"zero where it breaks away; it returned {margins.dtype}. For |F| <= F_s write "
                "jnp.stack([F_s - F, F_s + F])."
            )
        return margins

    def onto(self, t, x, args):
        """The state moved onto the surface along ∇h: only rounding is taken away, so dx⁺ = dx."""
        value, gradient = jax.value_and_grad(self.surface, argnums=1)(t, x, args)
        return x - jax.lax.stop_gradient(gradient * (value / _or_one(jnp.sum(gradient**2))))


class _Sliding(eqx.Module):
    """The field of the sliding mode."""

    side: _Side

    def __call__(self, t, x, args):
        if self.side.sliding is not None:
            return self.side.sliding(t, x, args)
        v_plus, f_plus = self.side.rate(self.side.plus, t, x, args)
        v_minus, f_minus = self.side.rate(self.side.minus, t, x, args)
        return f_minus + v_minus / _or_one(v_minus - v_plus) * (f_plus - f_minus)


class _Along(eqx.Module):
    """The projection onto the tangent space of a surface: dx less its part along ∇h."""

    surface: Function

    def __call__(self, t, x, args, dx):
        normal = jax.grad(self.surface, argnums=1)(t, x, args)
        return dx - normal * (jnp.sum(normal * dx) / _or_one(jnp.sum(normal**2)))


class _Onto(eqx.Module):
    """The reset of all transitions."""

    side: _Side

    def __call__(self, t, x, args, *which):
        return self.side.onto(t, x, args)


class _Arrival(eqx.Module):
    """The mode after the surface was reached: that on the other side, or sliding."""

    side: _Side
    beyond: int = eqx.field(static=True)
    slides: int = eqx.field(static=True)

    def __call__(self, t, x, args):
        return jnp.where(self.side.holds(t, x, args), self.slides, self.beyond)


class _Margins(eqx.Module):
    """What falls through zero where sliding ends."""

    side: _Side

    def __call__(self, t, x, args):
        if self.side.stick is not None:
            return self.side.margins(t, x, args)
        v_plus, v_minus = self.side.rates(t, x, args)
        return jnp.stack([-v_plus, v_minus])


class _Departure(eqx.Module):
    """The mode after sliding: on the side to which the fields point, of which one is tangent to the surface."""

    side: _Side
    above: int = eqx.field(static=True)
    below: int = eqx.field(static=True)

    def __call__(self, t, x, args, *which):
        v_plus, v_minus = self.side.rates(t, x, args)
        return jnp.where(v_plus + v_minus > 0, self.above, self.below)


class _HasASide(eqx.Module):
    """Whether sliding ends on one side: not where both fields are tangent to the surface (a two-fold)."""

    side: _Side

    def __call__(self, t, x, args):
        v_plus, f_plus = self.side.rate(self.side.plus, t, x, args)
        v_minus, f_minus = self.side.rate(self.side.minus, t, x, args)
        normal = jax.grad(self.side.surface, argnums=1)(t, x, args)
        size = jnp.sum(jnp.abs(normal) * (jnp.abs(f_plus) + jnp.abs(f_minus)))
        return jnp.abs(v_plus) + jnp.abs(v_minus) > digits(TWO_FOLD, size) * size


def _transitions(side: _Side, names: list[str], above: int, below: int, slides: int) -> list[Transition]:
    """From plus, from minus, and from the surface."""
    onto, surface = _Onto(side), side.surface
    leave = _HasASide(side) if side.sliding is None and side.stick is None else None
    return [
        Transition(surface, onto, source=names[above], target=_Arrival(side, below, slides), direction=-1),
        Transition(surface, onto, source=names[below], target=_Arrival(side, above, slides), direction=+1),
        Transition(_Margins(side), onto, source=names[slides], target=_Departure(side, above, below), when=leave),
    ]


class _Start(eqx.Module):
    """The mode to which a state belongs; −1 where it can neither leave the surface nor stay."""

    sides: tuple[_Side, ...]
    where: tuple[tuple[int, int], ...] = eqx.field(static=True)
    regions: int = eqx.field(static=True)

    def __call__(self, t, x, args):
        values = [side.surface(t, x, args) for side in self.sides]
        mode = jnp.asarray(0)
        for region in reversed(range(self.regions)):
            # It lies on its own side of each of the surfaces around it.
            inside = [value > 0 for value, (above, _) in zip(values, self.where, strict=True) if above == region]
            inside += [value < 0 for value, (_, below) in zip(values, self.where, strict=True) if below == region]
            mode = jnp.where(jnp.all(jnp.stack(inside)), region, mode)
        for i, (side, value) in enumerate(zip(self.sides, values, strict=True)):
            mode = jnp.where(_is_zero(side, value, t, x, args), self._on(i, t, x, args), mode)
        return mode

    def _on(self, i: int, t, x, args):
        """On the surface i: by the two fields."""
        side, (above, below) = self.sides[i], self.where[i]
        v_plus, v_minus = side.rates(t, x, args)
        leaves = jnp.where((v_plus > 0) & (v_minus < 0), -1, jnp.where(v_plus + v_minus < 0, below, above))
        return jnp.where(side.holds(t, x, args), self.regions + i, leaves)


def _is_zero(side: _Side, value, t, x, args):
    """Whether a start is on the surface, up to the rounding of what makes up the surface's value."""
    moving, gradient = jax.grad(side.surface, argnums=(0, 1))(t, x, args)
    terms = jnp.sqrt(jnp.sum(gradient**2) * jnp.sum(x**2)) + jnp.abs(moving * t)
    return jnp.abs(value) <= digits(BLUR, x) * terms


def _or_one(value):
    return jnp.where(value == 0, 1.0, value)
