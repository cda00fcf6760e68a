"""The parts of a Filippov system: what its modes, guards, resets and starts are made of.

With v± = ∂ₜh + ∇h·f±, the rates of a surface's function h along the two fields; see `filippov`.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from ..._jax.precision import BLUR, digits

__all__ = ["Along", "Arrival", "Departure", "HasASide", "Margins", "Onto", "Side", "Sliding", "Start"]

TWO_FOLD = 1e-8  # both fields are tangent to the surface where both rates are below this, relative to |∇h| |f|

Function = Callable[..., Any]

# Modules instead of closures: two systems made of the same functions are then the same to JAX, and compile once.


class Side(eqx.Module):
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

    def jet(self, field: Function, t, x, args):
        """The rate v of the surface along a field, and how fast that changes along it."""
        rate, f = self.rate(field, t, x, args)
        change = jax.jvp(lambda t, x: self.rate(field, t, x, args)[0], (t, x), (jnp.ones_like(t), f))[1]
        return rate, change

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


class Sliding(eqx.Module):
    """The field of the sliding mode."""

    side: Side

    def __call__(self, t, x, args):
        """fₛ, or what the user gave."""
        if self.side.sliding is not None:
            return self.side.sliding(t, x, args)
        v_plus, f_plus = self.side.rate(self.side.plus, t, x, args)
        v_minus, f_minus = self.side.rate(self.side.minus, t, x, args)
        return f_minus + v_minus / _or_one(v_minus - v_plus) * (f_plus - f_minus)


class Along(eqx.Module):
    """The projection onto the tangent space of a surface: dx less its part along ∇h."""

    surface: Function

    def __call__(self, t, x, args, dx):
        """Dx without its part along ∇h."""
        normal = jax.grad(self.surface, argnums=1)(t, x, args)
        return dx - normal * (jnp.sum(normal * dx) / _or_one(jnp.sum(normal**2)))


class Onto(eqx.Module):
    """The reset of all transitions."""

    side: Side

    def __call__(self, t, x, args, *which):
        """The state on the surface."""
        return self.side.onto(t, x, args)


class Arrival(eqx.Module):
    """The mode after the surface was reached: that on the other side, or sliding."""

    side: Side
    beyond: int = eqx.field(static=True)
    slides: int = eqx.field(static=True)

    def __call__(self, t, x, args):
        """The mode after the surface was reached."""
        return jnp.where(self.side.holds(t, x, args), self.slides, self.beyond)


class Margins(eqx.Module):
    """What falls through zero where sliding ends."""

    side: Side

    def __call__(self, t, x, args):
        """(m,): one falls through zero where sliding ends."""
        if self.side.stick is not None:
            return self.side.margins(t, x, args)
        v_plus, v_minus = self.side.rates(t, x, args)
        return jnp.stack([-v_plus, v_minus])


class Departure(eqx.Module):
    """The mode after sliding: on the side to which the fields point, of which one is tangent to the surface."""

    side: Side
    above: int = eqx.field(static=True)
    below: int = eqx.field(static=True)

    def __call__(self, t, x, args, *which):
        """The mode after sliding."""
        v_plus, v_minus = self.side.rates(t, x, args)
        return jnp.where(v_plus + v_minus > 0, self.above, self.below)


class HasASide(eqx.Module):
    """Whether sliding ends on one side: not where both fields are tangent to the surface (a two-fold)."""

    side: Side

    def __call__(self, t, x, args):
        """Whether one of the fields crosses the surface."""
        return has_a_side(self.side, t, x, args)


def has_a_side(side: Side, t, x, args):
    """Whether one of the two fields crosses the surface, beyond rounding."""
    v_plus, f_plus = side.rate(side.plus, t, x, args)
    v_minus, f_minus = side.rate(side.minus, t, x, args)
    normal = jax.grad(side.surface, argnums=1)(t, x, args)
    size = jnp.sum(jnp.abs(normal) * (jnp.abs(f_plus) + jnp.abs(f_minus)))
    return jnp.abs(v_plus) + jnp.abs(v_minus) > digits(TWO_FOLD, size) * size


class Start(eqx.Module):
    """The mode to which a state belongs; −1 where it can neither leave the surface nor stay."""

    sides: tuple[Side, ...]
    where: tuple[tuple[int, int], ...] = eqx.field(static=True)
    regions: int = eqx.field(static=True)

    def __call__(self, t, x, args):
        """The mode of a state, or −1."""
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

    def on_surface(self, i: int, t, x, args, mode):
        """Whether a state of a mode is on the surface i: sliding on it, or by its value."""
        here = _is_zero(self.sides[i], self.sides[i].surface(t, x, args), t, x, args)
        return jnp.where(mode < self.regions, here, mode == self.regions + i)

    def continuations(self, t, x, args, mode):
        """Modes (modes,) in which a motion may go on from a state where it is not decided: a surface that repels.

        By v± to either side and along the surface. At a two-fold, where both vanish, by their rates of change along
        the fields, to either side only: along the surface fₛ is 0/0 there. And whether this is so.
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
        """On the surface i: by the two fields."""
        side, (above, below) = self.sides[i], self.where[i]
        v_plus, v_minus = side.rates(t, x, args)
        leaves = jnp.where((v_plus > 0) & (v_minus < 0), -1, jnp.where(v_plus + v_minus < 0, below, above))
        return jnp.where(side.holds(t, x, args), self.regions + i, leaves)


def _is_zero(side: Side, value, t, x, args):
    """Whether a start is on the surface, up to the rounding of what makes up the surface's value."""
    moving, gradient = jax.grad(side.surface, argnums=(0, 1))(t, x, args)
    terms = jnp.sqrt(jnp.sum(gradient**2) * jnp.sum(x**2)) + jnp.abs(moving * t)
    return jnp.abs(value) <= digits(BLUR, x) * terms


def _or_one(value):
    return jnp.where(value == 0, 1.0, value)
