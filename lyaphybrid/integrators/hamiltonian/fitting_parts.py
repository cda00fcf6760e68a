"""Whether the flows of an `lh.Splitting` are those of the field: a run by others would look as good as any."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..._arguments import require
from ..._jax.engines import compiled
from ..._jax.precision import eps
from ..._jax.tracing import traced, transforming
from ...systems.bound import Bound

__all__ = ["MOVES_TIME", "require_flows_of"]

MOVES_TIME = 0  # index of the flow with which the time goes on
AGREES = 1e-6  # largest difference of the field and of its parts' sum, relative to both in each component
ROUNDED_PARTS = 1e3  # units of rounding: of what the values change by as the state does by its own size
SHORT_OF_STEP = 1 / 16  # of a step, for differences
TOLD_APART = 1e-3  # a change with time is one of a flow if it differs by less than this part


class PartsAt(NamedTuple):
    """The field and its parts at a point."""

    t: Any
    x: Any  # (n,)
    moved: Any  # (parts, n) the states after dt = 0
    field: Any  # (n,)
    velocities: Any  # (parts, n) d/d(dt) of the flows at dt = 0
    quotient: Any  # (n,) their sum by differences, for the derivative may miss what an iteration converges to
    changes: Any  # (n,) of the field and of all velocities by changes of the state as large as itself
    own: Any  # (parts, n) what the second derivatives by dt have beyond those of flows at a time held fixed
    by_time: Any  # (parts, n) ∂/∂t of the velocities: the same, of flows that move with the time


def require_flows_of(field: Any, method: Any, t, x, args) -> None:
    """Raise a ValueError where flows are seen not to be those of the field: at (t, x), or a step later.

    The velocities of the parts must add up to the field. The flow with which the time goes on must feel that, and the
    others must not. Nothing is said under a transformation, nor where something is not finite or has no derivative.
    """
    if transforming() or traced((method, t, x, args)):
        return
    try:
        places = _looked_at(method, field, t, x, args)
    except Exception:  # for example a callback, which has no derivative; what is wrong otherwise shows in the run
        return
    rounding = eps(x)
    for here in places:
        here = jax.tree.map(np.asarray, here)
        if all(np.all(np.isfinite(one)) for one in here):
            _require_rest(here, rounding)
            _require_sum(here, rounding)
            _require_times(here, rounding)


@compiled(hands_on=True)
def _looked_at(method, field, t, x, args) -> list[PartsAt]:
    bound = Bound(field, args)
    later = method.step(bound, t, x, bound(t, x), method.dt).x
    places, short = ((t, x), (t + method.dt, later)), SHORT_OF_STEP * method.dt
    return [_parts_at(method.flows, bound, *place, short) for place in places]


def _parts_at(flows, field: Bound, t, x, short) -> PartsAt:
    zero, one, args = jnp.zeros_like(t), jnp.ones_like(t), field.args
    # As large as the state, and not along it.
    across = x * (1 + 0.5 * jnp.cos(jnp.arange(1, x.shape[0] + 1).astype(x.dtype)))

    def velocity_of(flow):
        return lambda t, x, dt=zero: jax.jvp(lambda dt: flow(dt, t, x, args), (dt,), (one,))[1]

    each = [velocity_of(flow) for flow in flows]
    velocities = [velocity(t, x) for velocity in each]
    changes = [jnp.abs(jax.jvp(lambda x, f=f: f(t, x), (x,), (across,))[1]) for f in (field, *each)]
    own, by_time = [], []
    for velocity, v in zip(each, velocities, strict=True):
        bend = jax.jvp(lambda dt, velocity=velocity: velocity(t, x, dt), (zero,), (one,))[1]
        own.append(bend - jax.jvp(lambda x, velocity=velocity: velocity(t, x), (x,), (v,))[1])
        by_time.append(jax.jvp(lambda t, velocity=velocity: velocity(t, x), (t,), (one,))[1])
    moved = jnp.stack([flow(zero, t, x, args) for flow in flows])
    quotients = [(4 * flow(short / 2, t, x, args) - flow(short, t, x, args) - 3 * x) / short for flow in flows]
    of_parts = jnp.stack(velocities), sum(quotients), sum(changes), jnp.stack(own), jnp.stack(by_time)
    return PartsAt(t, x, moved, field(t, x), *of_parts)


def _require_rest(here: PartsAt, rounding: float) -> None:
    allowed = AGREES * np.abs(here.x) + ROUNDED_PARTS * rounding * np.max(np.abs(here.x))
    for k, moved in enumerate(here.moved):
        require(
            bool(np.all(np.abs(moved - here.x) <= allowed)),
            f"Flow {k} of lh.Splitting moves the state in no time, from {here.x} to {moved}: a flow (dt, t, x, args) "
            "must return the state after dt.",
        )


def _require_sum(here: PartsAt, rounding: float) -> None:
    together, field = np.sum(here.velocities, axis=0), here.field
    sizes = np.abs(field) + np.sum(np.abs(here.velocities), axis=0)
    allowed = max(AGREES, ROUNDED_PARTS * rounding) * sizes + ROUNDED_PARTS * rounding * here.changes
    difference = np.abs(together - field)
    apart = np.flatnonzero((difference > allowed) & (np.abs(here.quotient - field) > 0.5 * difference))
    if len(apart):
        i = int(apart[0])
        raise ValueError(
            f"The flows of lh.Splitting are not those of parts of this field: at t = {here.t:.6g} their velocities, "
            f"the derivatives by dt at dt = 0, add up to {together[i]:.9g} in x[{i}], and the field is {field[i]:.9g}. "
            "A part is missing, doubled or another."
        )


def _require_times(here: PartsAt, rounding: float) -> None:
    for k, (own, by_time, velocity) in enumerate(zip(here.own, here.by_time, here.velocities, strict=True)):
        noise = ROUNDED_PARTS * rounding * (np.abs(own) + np.abs(velocity) + here.changes)
        seen = np.abs(by_time) > 1e3 * noise
        if not np.any(seen):
            continue
        allowed = TOLD_APART * np.abs(by_time[seen])
        moves, rests = np.all(np.abs(own - by_time)[seen] < allowed), np.all(np.abs(own)[seen] < allowed)
        require(
            k == MOVES_TIME or not moves,
            f"Flow {k} of lh.Splitting moves with the time, from t to t + dt; only flow {MOVES_TIME} may. The others "
            "return the state after dt with t held fixed, as x + dt b(t, x). Or put this one first.",
        )
        require(
            k != MOVES_TIME or not rests,
            f"Flow {k} of lh.Splitting holds the time fixed, and it is the one that moves with it: it must return the "
            "state at t + dt. Or put another first.",
        )
