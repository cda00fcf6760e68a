"""What a step takes from time alone, and what it takes from a point, computed once.

XLA counts sin, cos and tan as cheap and repeats them wherever a fusion uses them: a Runge–Kutta step of a forced
oscillator that needs two cosines computes more, each as costly as the rest of a stage. So the part of a field
that depends on time alone is found in its jaxpr, evaluated at all times of the step at once, in vector registers,
and kept behind a conditional, which XLA does not repeat. A field that needs such functions of the state is evaluated
behind one itself: each stage enters all later ones (a pendulum with dry friction took two thirds of the time).
"""

from collections.abc import Callable, Iterable

import jax
import jax.numpy as jnp
from jaxtyping import Array

from .._jaxprs import divided, part_of
from .base import Field
from .circular import LANES, in_lanes

__all__ = ["at_times"]

REPEATED = {"sin", "cos", "tan"}  # XLA takes them for cheap; it does not repeat exp, log, pow, …


def at_times(field: Field, t, x, h, fractions: Iterable[float]) -> dict[float, Callable[[Array], Array]]:
    """The field at the times t + c h as a function of x, for each of the fractions c."""
    times = {float(c): t + c * h for c in fractions}
    closed = jax.make_jaxpr(field)(t, x)
    time, point = closed.jaxpr.invars
    early, late, kept = divided(closed, [time])
    once = _behind_a_conditional if any(_is_repeated(eqn) for eqn in late) else lambda rest: rest
    if not kept or not any(_is_repeated(eqn) for eqn in early):
        return {c: lambda x, at=at: once(field)(at, x) for c, at in times.items()}
    forcing = part_of(closed, early, [time], kept)
    whole = part_of(closed, late, [time, *kept, point], closed.jaxpr.outvars)
    rest = once(lambda *operands: whole(*operands)[0])

    shares = [*times, *[1.0] * (-len(times) % LANES)]  # full registers

    def present(t, h):
        # Times made here, as a vector: stacked from numbers they would have to reach memory before they are read.
        return in_lanes(jax.vmap(forcing))(t + jnp.asarray(shares, x.dtype) * h)

    def nothing(t, h):
        return [jnp.zeros((len(shares), *v.aval.shape), v.aval.dtype) for v in kept]

    values = jax.lax.cond(h == h, present, nothing, jnp.asarray(t, x.dtype), jnp.asarray(h, x.dtype))
    values = dict(zip(times, zip(*values, strict=True), strict=False))
    return {c: lambda x, at=at, now=values[c]: rest(at, *now, x) for c, at in times.items()}


def _behind_a_conditional(rest: Callable[..., Array]) -> Callable[..., Array]:
    """The function of a time, other things, and last a point; XLA does not know that time is always a number."""

    def nothing(t, *operands):
        return jnp.zeros_like(operands[-1])

    return lambda t, *operands: jax.lax.cond(t == t, rest, nothing, t, *operands)


def _is_repeated(eqn) -> bool:
    """Whether an equation is, or holds, a function that XLA would repeat."""
    inner = [getattr(value, "jaxpr", value) for value in eqn.params.values()]
    nested = [one for jaxpr in inner for one in getattr(jaxpr, "eqns", [])]
    return eqn.primitive.name in REPEATED or any(_is_repeated(one) for one in nested)
