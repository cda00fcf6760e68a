"""The pace of a run: whether it will reach its end, or makes many tiny steps and gets nowhere.

The host asks now and then. A run is given up where nothing moved, or where the rest would take far
too many attempts and the steps are no steps of a smooth motion: these are about as long as 1/‖Df‖, whatever the
tolerances; across a jump of the field they are a million times shorter. Who gives `max_steps` decides alone.
"""

import time
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ...statuses import STATUS
from ..states import LoopState

__all__ = ["WINDOW", "Pace", "Rates", "given_up", "rates_of"]

WINDOW = 1_000_000  # attempts between two looks …
SLOW, SECONDS = 10_000, 5.0  # … or where they are slow, so many at least, and so long
LONG, ENDLESS = 3e9, 1e12  # attempts: of minutes to an hour, and of days to weeks
SMOOTH = 1e-5  # steps shorter than this part of 1/‖Df‖ are no steps of a smooth motion
STIFF = 1e-4  # a motion slower than this part of ‖Df‖ is held by something much faster


class Rates(NamedTuple):
    """How fast things change where a run stands."""

    field: float  # ‖Df‖, or |∂f/∂t|/|f| where that is larger
    motion: float  # |df/dt| / |f| along the motion


class Reading(NamedTuple):
    """What a run has reached: (m,) each, or scalars."""

    time: np.ndarray
    jumps: np.ndarray


class Pace:
    """Follows a run, or several, from window to window."""

    def __init__(self, loop_state: LoopState, given: int, end, last_jump, count_jumps: bool):
        self.end, self.last_jump, self.count_jumps = float(end), float(last_jump), count_jumps
        self.before, self.given = _reading(loop_state), given
        self.attempts, self.since = 0, time.perf_counter()  # since the last look

    def look(self, loop_state: LoopState, given: int, rates) -> dict[int, str]:
        """The runs that have stalled, and why; `rates(run)` gives `Rates`, or None where there are none."""
        self.attempts = given - self.given
        slow = self.attempts >= SLOW and time.perf_counter() - self.since >= SECONDS
        if self.attempts < WINDOW and not slow:
            return {}
        self.since = time.perf_counter()
        now, before = _reading(loop_state), self.before
        self.before, self.given = now, given
        running = np.atleast_1d(np.asarray(loop_state.carry.status) == 0)
        h = getattr(loop_state.carry.solver_state, "h", None)
        found = {}
        for run in np.flatnonzero(running):
            moved, jumped = now.time[run] - before.time[run], int(now.jumps[run] - before.jumps[run])
            step = "" if h is None else f", at the end with h = {np.atleast_1d(np.asarray(h))[run]:.3g}"
            seen = f"{self.attempts:.1e} attempts moved the time by {moved:.3g}{step}"
            why = self._why(moved, jumped, now.time[run], now.jumps[run], lambda run=run: rates(run))
            if why:
                found[int(run)] = f"{seen}: {why}"
        return found

    def _why(self, moved, jumped, reached, jumps, rates) -> str:
        if moved == 0 and (jumped == 0 or not self.count_jumps):
            return "the time stands still. Is the field, or a guard, undefined or discontinuous just beyond?"
        ahead = self.attempts * (self.end - reached) / moved if moved > 0 else np.inf
        if self.count_jumps:
            ahead = min(ahead, self.attempts * (self.last_jump - jumps) / jumped if jumped else np.inf)
        if ahead <= LONG or np.isinf(ahead):  # a run that waits for a jump ends by itself (`waiting`)
            return ""
        there, left = rates(), f"the rest would take {ahead:.1e} more"
        if there is not None and moved / self.attempts * there.field < SMOOTH:
            return (
                f"{left}. Such short steps are those of a field or a guard that is not smooth here (where, sign, mod, "
                "floor, an impure function), or of jumps that follow each other: give each smooth piece a mode."
            )
        if there is not None and 0 < there.motion < STIFF * there.field:
            return f"{left}. The flow is stiff here, ‖Df‖ = {there.field:.2g}: use lh.Diffrax(diffrax.Kvaerno5())."
        if ahead > ENDLESS:
            return f"{left}. Is t1 in the unit of the system's time? max_steps=… goes on all the same."
        return ""


def _reading(loop_state: LoopState) -> Reading:
    elapsed = np.asarray(loop_state.elapsed) + np.asarray(loop_state.carry.s)
    return Reading(np.atleast_1d(elapsed), np.atleast_1d(np.array(loop_state.carry.jumps)))


def given_up(loop_state: LoopState, stalled: dict[int, str]) -> tuple[LoopState, str]:
    """The loop's state with the runs ended that have stalled; and why the first of them did."""
    if not stalled:
        return loop_state, ""
    status = np.array(loop_state.carry.status)
    np.atleast_1d(status)[list(stalled)] = STATUS.stalled  # a view of it
    return loop_state._replace(carry=loop_state.carry._replace(status=status)), next(iter(stalled.values()))


def rates_of(field, t, x) -> tuple[Any, Any]:
    """`Rates`, as arrays, of a field (t, x) -> dx/dt."""
    f, acceleration = jax.jvp(field, (t, x), (jnp.ones_like(t), field(t, x)))
    _, along = jax.jvp(lambda t: field(t, x), (t,), (jnp.ones_like(t),))
    speed = jnp.max(jnp.abs(f))
    speed = jnp.where(speed > 0, speed, jnp.inf)
    largest = jnp.max(jnp.sum(jnp.abs(jax.jacfwd(lambda x: field(t, x))(x)), axis=1))
    return jnp.maximum(largest, jnp.max(jnp.abs(along)) / speed), jnp.max(jnp.abs(acceleration)) / speed
