"""The functions of a Filippov system: fields of its modes, guards, resets, and the initial mode.

With v± = ∂ₜh + ∇h·f±, the rates of a surface's function h along the two fields; see `filippov`.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from ..._jax.precision import GUARD_ROUNDING, digits

__all__ = [
    "SurfaceProjection",
    "ModeAfterArrival",
    "ModeAfterSliding",
    "LeavesToOneSide",
    "SlidingMargins",
    "SurfaceReset",
    "TwoSidedSurface",
    "SlidingField",
    "InitialMode",
]

TWO_FOLD = 1e-8  # both fields are tangent to the surface where both rates are below this, relative to |∇h| |f|
CROSSED = 1e-10  # a slide has crossed another surface if h is beyond this, relative to |∇h| (1 + |x|)
OFF_SURFACE = 1e-6  # a state is off a surface if |h| is above this, relative to |∇h| (1 + |x|)

Function = Callable[..., Any]

# Modules instead of closures: systems made of the same functions are then equal for JAX, which compiles them once.


class TwoSidedSurface(eqx.Module):
    """A surface h = 0 with the fields of its two sides, and the user's sliding field and stick margins (or None)."""

    surface: Function
    plus: Function
    minus: Function
    sliding: Function | None
    stick: Function | None

    def rate(self, field: Function, t, x, args):
        """The rate ∂ₜh + ∇h·f, and f (n,)."""
        f = field(t, x, args)
        return jax.jvp(lambda t, x: self.surface(t, x, args), (t, x), (jnp.ones_like(t), f))[1], f

    def jet(self, field: Function, t, x, args):
        """The rate v of h along a field, and the rate of change of v along the same field."""
        rate, f = self.rate(field, t, x, args)
        change = jax.jvp(lambda t, x: self.rate(field, t, x, args)[0], (t, x), (jnp.ones_like(t), f))[1]
        return rate, change

    def rates(self, t, x, args):
        """The rates v₊ and v₋ of h along the two fields."""
        return self.rate(self.plus, t, x, args)[0], self.rate(self.minus, t, x, args)[0]

    def holds(self, t, x, args):
        """Whether a motion on the surface stays on it."""
        v_plus, v_minus = self.rates(t, x, args)
        attracts = (v_plus < 0) & (v_minus > 0)
        return attracts if self.stick is None else attracts | jnp.all(self.margins(t, x, args) > 0)

    def margins(self, t, x, args):
        """The user's stick margins: one falls through zero where the motion leaves the surface."""
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
        """The state moved onto the surface along ∇h. This removes only rounding errors: its derivative is dx⁺ = dx."""
        value, gradient = jax.value_and_grad(self.surface, argnums=1)(t, x, args)
        return x - jax.lax.stop_gradient(gradient * (value / _or_one(jnp.sum(gradient**2))))


class SlidingField(eqx.Module):
    """The field of the sliding mode."""

    side: TwoSidedSurface

    def __call__(self, t, x, args):
        """The field fₛ, or the user's sliding field."""
        if self.side.sliding is not None:
            return self.side.sliding(t, x, args)
        v_plus, f_plus = self.side.rate(self.side.plus, t, x, args)
        v_minus, f_minus = self.side.rate(self.side.minus, t, x, args)
        return f_minus + v_minus / _or_one(v_minus - v_plus) * (f_plus - f_minus)


class SurfaceProjection(eqx.Module):
    """The projection onto the tangent space of a surface: dx minus its component along ∇h."""

    surface: Function

    def __call__(self, t, x, args, dx):
        """The projected perturbation dx (n,)."""
        normal = jax.grad(self.surface, argnums=1)(t, x, args)
        return dx - normal * (jnp.sum(normal * dx) / _or_one(jnp.sum(normal**2)))


class SurfaceReset(eqx.Module):
    """The reset of all transitions: the projection onto the surface."""

    side: TwoSidedSurface

    def __call__(self, t, x, args, *which):
        """The state on the surface."""
        return self.side.onto(t, x, args)


class ModeAfterArrival(eqx.Module):
    """The mode after reaching the surface: the other side, or sliding."""

    side: TwoSidedSurface
    beyond: int = eqx.field(static=True)
    slides: int = eqx.field(static=True)

    def __call__(self, t, x, args):
        """The index of that mode."""
        return jnp.where(self.side.holds(t, x, args), self.slides, self.beyond)


class SlidingMargins(eqx.Module):
    """The guards at which sliding ends."""

    side: TwoSidedSurface

    def __call__(self, t, x, args):
        """The guards (m,): one falls through zero where sliding ends."""
        if self.side.stick is not None:
            return self.side.margins(t, x, args)
        v_plus, v_minus = self.side.rates(t, x, args)
        return jnp.stack([-v_plus, v_minus])


class ModeAfterSliding(eqx.Module):
    """The mode after sliding: the side to which v₊ + v₋ points; the other field is tangent to the surface there."""

    side: TwoSidedSurface
    above: int = eqx.field(static=True)
    below: int = eqx.field(static=True)

    def __call__(self, t, x, args, *which):
        """The index of that mode."""
        v_plus, v_minus = self.side.rates(t, x, args)
        return jnp.where(v_plus + v_minus > 0, self.above, self.below)


class BeforeCrossing(eqx.Module):
    """The guard that falls through zero where a motion has crossed a surface, by more than rounding."""

    side: TwoSidedSurface
    sign: int = eqx.field(static=True)  # of h before

    def __call__(self, t, x, args):
        """The guard: sign · h, and what counts as zero."""
        value, gradient = jax.value_and_grad(self.side.surface, argnums=1)(t, x, args)
        return self.sign * value + CROSSED * jnp.sqrt(jnp.sum(gradient**2)) * (1 + jnp.sqrt(jnp.sum(x**2)))


class LeavesToOneSide(eqx.Module):
    """Whether the motion leaves sliding to a definite side: not at a two-fold, where both fields are tangent."""

    side: TwoSidedSurface

    def __call__(self, t, x, args):
        """Whether one of the fields crosses the surface."""
        return has_a_side(self.side, t, x, args)


def has_a_side(side: TwoSidedSurface, t, x, args):
    """Whether one of the two fields crosses the surface, beyond rounding."""
    v_plus, f_plus = side.rate(side.plus, t, x, args)
    v_minus, f_minus = side.rate(side.minus, t, x, args)
    normal = jax.grad(side.surface, argnums=1)(t, x, args)
    size = jnp.sum(jnp.abs(normal) * (jnp.abs(f_plus) + jnp.abs(f_minus)))
    return jnp.abs(v_plus) + jnp.abs(v_minus) > digits(TWO_FOLD, size) * size


class InitialMode(eqx.Module):
    """The initial mode of a state; −1 if it lies on a repelling surface, where the continuation is not unique."""

    sides: tuple[TwoSidedSurface, ...]
    where: tuple[tuple[int, int], ...] = eqx.field(static=True)
    regions: int = eqx.field(static=True)

    def __call__(self, t, x, args):
        """The mode of a state, or −1."""
        values = [side.surface(t, x, args) for side in self.sides]
        mode = jnp.asarray(0)
        for region in reversed(range(self.regions)):
            # A state is in a region if it lies on the region's side of each of its surfaces.
            inside = [value > 0 for value, (above, _) in zip(values, self.where, strict=True) if above == region]
            inside += [value < 0 for value, (_, below) in zip(values, self.where, strict=True) if below == region]
            mode = jnp.where(jnp.all(jnp.stack(inside)), region, mode)
        for i, (side, value) in enumerate(zip(self.sides, values, strict=True)):
            mode = jnp.where(_is_zero(side, value, t, x, args), self._on(i, t, x, args), mode)
        return mode

    def outside(self, t, x, args):
        """(modes,) by how much h has the wrong sign for each mode, or is not zero; 0 for what rounding leaves."""
        values, off = [], [jnp.zeros_like(t)] * self.regions
        for side, (above, below) in zip(self.sides, self.where, strict=True):
            value, gradient = jax.value_and_grad(side.surface, argnums=1)(t, x, args)
            size = jnp.sqrt(jnp.sum(gradient**2)) * (1 + jnp.sqrt(jnp.sum(x**2)))
            value = jnp.where(jnp.abs(value) > OFF_SURFACE * size, value, 0.0)
            off[above], off[below] = jnp.maximum(off[above], -value), jnp.maximum(off[below], value)
            values.append(jnp.abs(value))
        return jnp.stack([*off, *values])

    def on_surface(self, i: int, t, x, args, mode):
        """Whether a state of this mode is on the surface i: in its sliding mode, or with h = 0 up to rounding."""
        here = _is_zero(self.sides[i], self.sides[i].surface(t, x, args), t, x, args)
        return jnp.where(mode < self.regions, here, mode == self.regions + i)

    def continuations(self, t, x, args, mode):
        """Whether each mode (modes,) is a possible continuation from a point where the motion is not unique.

        On a repelling surface these are both sides and sliding. At a two-fold, where v₊ = v₋ = 0, each side is decided
        by the rate of change of v± along its field; sliding is excluded, because fₛ is 0/0 there. The second result
        says whether the point is a two-fold.
        """
        found, undecided = jnp.zeros(self.regions + len(self.sides), bool), jnp.asarray(False)
        for i, (side, (above, below)) in enumerate(zip(self.sides, self.where, strict=True)):
            (v_plus, rate_plus), (v_minus, rate_minus) = (
                side.jet(side.plus, t, x, args),
                side.jet(side.minus, t, x, args),
            )
            here, fold = self.on_surface(i, t, x, args, mode), ~has_a_side(side, t, x, args)
            repels = here & ~fold & (v_plus > 0) & (v_minus < 0)
            found = found.at[above].set(found[above] | repels | (here & fold & (rate_plus > 0)))
            found = found.at[below].set(found[below] | repels | (here & fold & (rate_minus < 0)))
            found = found.at[self.regions + i].set(repels)
            undecided = undecided | (here & fold)
        return found, undecided

    def normal(self, t, x, args, mode):
        """∇h (n,) of the surface that a motion slides on."""
        gradients = [jax.grad(side.surface, argnums=1)(t, x, args) for side in self.sides]
        return jnp.stack(gradients)[jnp.maximum(mode - self.regions, 0)]

    def repels(self, t, x, args, mode):
        """Whether the motion slides along a surface that repels."""
        rates = [side.rates(t, x, args) for side in self.sides]
        away = jnp.stack([(v_plus > 0) & (v_minus < 0) for v_plus, v_minus in rates])
        return (mode >= self.regions) & away[jnp.maximum(mode - self.regions, 0)]

    def _on(self, i: int, t, x, args):
        """The initial mode on the surface i, by the two fields."""
        side, (above, below) = self.sides[i], self.where[i]
        (v_plus, rate_plus), (v_minus, rate_minus) = (side.jet(field, t, x, args) for field in (side.plus, side.minus))
        leaves = jnp.where((v_plus > 0) & (v_minus < 0), -1, jnp.where(v_plus + v_minus < 0, below, above))
        # At a two-fold both are tangent: a field leaves the surface if it curves away from it.
        up, down = rate_plus > 0, rate_minus < 0
        curves = jnp.where(up & down, -1, jnp.where(up, above, jnp.where(down, below, self.regions + i)))
        leaves = jnp.where(has_a_side(side, t, x, args), leaves, curves)
        return jnp.where(side.holds(t, x, args), self.regions + i, leaves)


def _is_zero(side: TwoSidedSurface, value, t, x, args):
    """Whether a state is on the surface, up to rounding of the terms of h."""
    moving, gradient = jax.grad(side.surface, argnums=(0, 1))(t, x, args)
    terms = jnp.sqrt(jnp.sum(gradient**2) * jnp.sum(x**2)) + jnp.abs(moving * t)
    return jnp.abs(value) <= digits(GUARD_ROUNDING, x) * terms


def _or_one(value):
    return jnp.where(value == 0, 1.0, value)
