"""What a step takes from time alone, and what it takes from a point, computed once.

XLA counts sin, cos and tan as cheap and repeats them wherever a fusion uses them: a Runge–Kutta step of a forced
oscillator that needs two cosines computes more, each as costly as the rest of a stage. So the part of a field
that depends on time alone is found in its jaxpr, evaluated at all times of the step at once, in vector registers,
and kept behind a conditional, which XLA does not repeat. A field that needs such functions of the state is evaluated
behind one itself: each stage enters all later ones (a pendulum with dry friction took two thirds of the time). And the
tangent of a step does not repeat what its trial has done: the trial leaves the points where it evaluated the field, and
what Df takes from them is computed for all at once (the same pendulum: two thirds again).
"""

from collections.abc import Callable, Iterable, Sequence

import jax
import jax.numpy as jnp
from jaxtyping import Array

from .._jaxprs import divided, needed, part_of
from ..columns import each_column
from .base import Field
from .conditionals import LANES, behind_a_conditional, in_lanes

__all__ = ["at_times", "linear_along", "takes_sines"]

FEW, LONG = 4, 30  # components of a small Df; equations in dx that are more work than to multiply by it
REPEATED = {"sin", "cos", "tan"}  # XLA takes them for cheap; it does not repeat exp, log, pow, …


def at_times(field: Field, t, x, h, fractions: Iterable[float], little: bool = False) -> dict[float, Callable]:
    """The field at the times t + c h as a function of x (n,), for each of the fractions c.

    With `little` to do in a step even the calls for single sines are too much: they are written out (RK4 in the plane:
    a twentieth of the time). With more stages nothing is gained, and the loop takes a third longer to compile.
    """
    times = {float(c): t + c * h for c in fractions}
    closed = jax.make_jaxpr(field)(t, x)
    time, point = closed.jaxpr.invars
    early, late, kept = divided(closed, [time])
    dear = any(_is_repeated(eqn) for eqn in late)

    def once(rest):
        return (in_lanes if little else behind_a_conditional)(rest) if dear else rest

    if not kept or not any(_is_repeated(eqn) for eqn in early):
        return {c: lambda x, at=at: once(field)(at, x) for c, at in times.items()}
    forcing = part_of(closed, early, [time], kept)
    whole = part_of(closed, late, [time, *kept, point], closed.jaxpr.outvars)
    rest = once(lambda *operands: whole(*operands)[0])

    shares = [*times, *[1.0] * (-len(times) % LANES)]  # full registers

    def present(t, h):
        return jax.vmap(forcing)(t + jnp.asarray(shares, x.dtype) * h)

    values = in_lanes(present)(jnp.asarray(t, x.dtype), jnp.asarray(h, x.dtype))
    values = dict(zip(times, zip(*values, strict=True), strict=False))
    return {c: lambda x, at=at, now=values[c]: rest(at, *now, x) for c, at in times.items()}


def linear_along(field: Field, times: Sequence, points: Sequence[Array]) -> list[Callable[[Array], Array]]:
    """Frames (n, k) ↦ Df frame at points that are known; what Df takes from all of these is computed at once.

    Where what is left would be much (a sliding field: 50 equations in dx), Df itself is computed so: stages enter all
    later ones, and XLA would write these equations out for each way from one to another.
    """
    t, x = jnp.asarray(times[0], points[0].dtype), points[0]
    closed = jax.make_jaxpr(lambda t, x, dx: jax.jvp(lambda x: field(t, x), (x,), (dx,))[1])(t, x, x)
    if x.shape[0] <= FEW and len(divided(closed, closed.jaxpr.invars[:2])[1]) > LONG:
        closed = jax.make_jaxpr(lambda t, x, dx: jnp.sum(jax.jacfwd(field, 1)(t, x) * dx[None, :], axis=1))(t, x, x)
    time, point, along = closed.jaxpr.invars
    early, late, kept = divided(closed, [time, point])
    wanted = needed(closed)
    early, kept = [eqn for eqn in early if wanted.intersection(eqn.outvars)], [v for v in kept if v in wanted]
    residuals = part_of(closed, early, [time, point], kept)
    whole = part_of(closed, late, [time, point, *kept, along], closed.jaxpr.outvars)
    room = len(times) + -len(times) % LANES

    def present(times, points):
        return jax.vmap(residuals)(_side_by_side(times, room), _side_by_side(points, room))

    values = in_lanes(present)([jnp.asarray(t, x.dtype) for t in times], list(points))

    def linear(t, x, *known):
        return lambda frame: each_column(lambda dx: whole(t, x, *known, dx)[0], frame)

    return [linear(*at) for at in zip(times, points, *values, strict=False)]


def takes_sines(fields: Iterable[Field], t, x) -> bool:
    """Whether one of the fields needs functions of the state that are dear: its values are then worth keeping."""

    def of_state(field: Field) -> bool:
        closed = jax.make_jaxpr(field)(t, x)
        return any(_is_repeated(eqn) for eqn in divided(closed, [closed.jaxpr.invars[0]])[1])

    return any(of_state(field) for field in fields)


def _side_by_side(values: Sequence[Array], room: int) -> Array:
    """The values as rows, with the first again below them until `room` rows are full.

    In one register this does without memory. With more, each row would be written into all registers, and thrown away
    in all but one: stacking is less work.
    """
    if room > LANES:
        return jnp.stack([*values, *[values[0]] * (room - len(values))])
    lane, rows = jnp.arange(room).reshape(room, *[1] * values[0].ndim), values[0][None]
    for i, value in enumerate(values[1:], 1):
        rows = jnp.where(lane == i, value, rows)
    return rows


def _is_repeated(eqn) -> bool:
    """Whether an equation is, or holds, a function that XLA would repeat."""
    inner = [getattr(value, "jaxpr", value) for value in eqn.params.values()]
    nested = [one for jaxpr in inner for one in getattr(jaxpr, "eqns", [])]
    return eqn.primitive.name in REPEATED or any(_is_repeated(one) for one in nested)
