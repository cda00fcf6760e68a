"""The pace of a run: whether it will reach its end, or makes many tiny steps without progress.

The host checks from time to time. A run is stopped if the time did not move, or if the rest would need far too many
attempts and the steps are not those of a smooth motion. Steps of a smooth motion are about as long as 1/‖Df‖, for all
tolerances; at a discontinuity of the vector field they are shorter by many orders of magnitude. If the user gives
`max_steps`, nothing is checked.
"""

import time
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ...integrators.runge_kutta import RungeKutta
from ...statuses import RUNNING, STATUS, STIFF_REMEDY
from ..states import LoopState

__all__ = [
    "ATTEMPTS_BETWEEN_CHECKS",
    "Pace",
    "Rates",
    "StiffnessVotes",
    "at_stability_limit",
    "given_up",
    "may_be_stiff",
    "rates_of",
    "why_stalled",
]

ATTEMPTS_BETWEEN_CHECKS = 1_000_000  # attempts between two checks
ATTEMPTS_IF_SLOW, SECONDS_IF_SLOW = 10_000, 5.0  # a check is made earlier after this many attempts and seconds
ATTEMPTS_EXAMINED = 3e9  # remaining attempts from which a run is examined …
ATTEMPTS_STOPPED = 1e12  # … and from which it is stopped
SMOOTH = 1e-5  # steps of a smooth motion are longer than this times 1/‖Df‖
STIFF = 1e-4  # a motion slower than this times ‖Df‖ is stiff
ATTEMPTS_UNTIL_STIFF = 50_000  # shorter runs are quick all the same
ATTEMPTS_UNTIL_ASKED = 400_000  # a longer run is asked on the way as well, not at its end alone
AT_STABILITY = 1.0, 20.0  # between these over the fastest rate of decay steps are at the limit of stability …
SLOW = 1e-2  # … if they are also shorter than this times the time in which the motion changes
DECAY_PER_STEP = 0.02  # all columns: steps follow a decay that is faster than this over the step …
FAR_FASTER = 1e3  # … and than this times the motion
MOST_FOR_EIGENVALUES = 500  # components of a state


class Rates(NamedTuple):
    """Rates of change (1/time) at the present state of a run."""

    field: float  # ‖Df‖, or |∂f/∂t|/|f| where that is larger
    motion: float  # |df/dt| / |f| along the motion
    decay: float = 0.0  # the fastest of perturbations, -min Re of the eigenvalues of Df

    @classmethod
    def of(cls, field, motion, jacobian) -> "Rates":
        """From the arrays of `rates_of`."""
        jacobian = np.asarray(jacobian)
        known = len(jacobian) <= MOST_FOR_EIGENVALUES and np.all(np.isfinite(jacobian))
        decay = -float(np.min(np.linalg.eigvals(jacobian).real)) if known else 0.0
        return cls(float(field), float(motion), decay)


class Progress(NamedTuple):
    """Time and number of jumps that the runs have reached, (m,) each."""

    time: np.ndarray
    jumps: np.ndarray


class Pace:
    """Compares the progress of one run or several from one check to the next."""

    def __init__(self, loop_state: LoopState, given: int, end, last_jump, count_jumps: bool):
        self.end, self.last_jump, self.count_jumps = float(end), float(last_jump), count_jumps
        self.before, self.given = _reading(loop_state), given
        self.attempts, self.since = 0, time.perf_counter()  # since the last check

    def look(self, loop_state: LoopState, given: int, rates) -> dict[int, str]:
        """The runs that have stalled, with the reason; `rates(run)` returns `Rates`, or None if unknown."""
        self.attempts = given - self.given
        slow = self.attempts >= ATTEMPTS_IF_SLOW and time.perf_counter() - self.since >= SECONDS_IF_SLOW
        if self.attempts < ATTEMPTS_BETWEEN_CHECKS and not slow:
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
        ahead = self.attempts * (self.end - reached) / moved if moved > 0 else np.inf
        if self.count_jumps:
            ahead = min(ahead, self.attempts * (self.last_jump - jumps) / jumped if jumped else np.inf)
        return why_stalled(self.attempts, moved, ahead, rates)


def may_be_stiff(method: Any) -> bool:
    """Whether steps are free, and of an explicit method."""
    return isinstance(method, RungeKutta) and method.adaptive and method.longest_step is None


def at_stability_limit(rates: Rates, step: float) -> bool:
    """Whether a step is as long as an explicit method stays stable, and far shorter than the motion would need."""
    shortest, longest = AT_STABILITY
    return shortest < rates.decay * step < longest and rates.motion * step < SLOW


def resolves_decay(rates: Rates, step: float) -> bool:
    """Whether steps follow the fastest decay, that of the last of n columns, and are far shorter than the motion needs.

    Error control of all columns demands it of implicit methods, too, but for lh.ContinuousQR, which divides it out.
    """
    longest = AT_STABILITY[1]
    slow = rates.motion * step < SLOW and FAR_FASTER * rates.motion < rates.decay
    return DECAY_PER_STEP < rates.decay * step < longest and slow


class StiffnessVotes:
    """Whether a long run takes steps as stability or a decay allows, not as its motion would: asked now and then.

    The questions come after fixed numbers of attempts, so that the answer does not depend on the speed of the machine.
    """

    def __init__(self, method: Any):
        self.asks, self.next, self.votes = may_be_stiff(method), ATTEMPTS_UNTIL_ASKED, []

    def left(self, given: int) -> int:
        """The most attempts until the next question on the way."""
        return max(1, self.next - given)

    def on_the_way(self, loop_state: LoopState, given: int, rates) -> None:
        """Ask the first run after so many attempts, and then each time that their number has doubled."""
        if given >= self.next:
            self.next = 2 * given
            self._ask(loop_state, rates)

    def at_the_end(self, loop_state: LoopState, given: int, rates) -> None:
        """Ask the first run at its end, unless it was short or failed, for then its attempts are not known."""
        if given >= ATTEMPTS_UNTIL_STIFF and np.ravel(loop_state.carry.status)[0] == RUNNING:
            self._ask(loop_state, rates)

    def _ask(self, loop_state: LoopState, rates) -> None:
        if not self.asks:
            return
        there, h = rates(0), getattr(loop_state.carry.solver_state, "h", None)
        if there is not None and h is not None:
            step, (n, k) = float(np.ravel(h)[0]), loop_state.carry.frame.shape[-2:]
            self.votes.append(at_stability_limit(there, step) or (1 < k == n and resolves_decay(there, step)))

    @property
    def stiff(self) -> bool:
        """Whether most answers were yes."""
        return sum(self.votes) * 2 > len(self.votes)


def why_stalled(attempts, moved, ahead, rates) -> str:
    """The reason, in words, why a run is stopped as stalled; empty if it is not.

    Args:
        attempts: step attempts since the last check.
        moved: the time that passed in them.
        ahead: estimated number of attempts for the rest of the run; inf if unknown.
        rates: () -> `Rates` at the present state, or None if unknown.
    """
    if moved == 0 and np.isinf(ahead):
        return "the time stands still. Is the field, or a guard, undefined or discontinuous just beyond?"
    if ahead <= ATTEMPTS_EXAMINED or np.isinf(ahead):  # a run that waits for a jump ends by itself (`waiting`)
        return ""
    there, left = rates(), f"the rest would take {ahead:.1e} more"
    if there is not None and moved / attempts * there.field < SMOOTH:
        return (
            f"{left}. Such short steps are those of a field or a guard that is not smooth here (where, sign, mod, "
            "floor, an impure function), or of jumps that follow each other: give each smooth piece a mode."
        )
    if there is not None and 0 < there.motion < STIFF * there.field:
        return f"{left}. The flow is stiff here, ‖Df‖ = {there.field:.2g}: use {STIFF_REMEDY}."
    if ahead > ATTEMPTS_STOPPED:
        return f"{left}. Is t1 in the unit of the system's time? max_steps=… goes on all the same."
    return ""


def _reading(loop_state: LoopState) -> Progress:
    elapsed = np.asarray(loop_state.elapsed) + np.asarray(loop_state.carry.s)
    return Progress(np.atleast_1d(elapsed), np.atleast_1d(np.array(loop_state.carry.jumps)))


def given_up(loop_state: LoopState, stalled: dict[int, str], undefined: set[int]) -> tuple[LoopState, str]:
    """The loop's state in which stalled runs have ended, and the reason for the first of them.

    Those of them that come to where something is `undefined` end as ``nonfinite``.
    """
    if not stalled:
        return loop_state, ""
    status = np.array(loop_state.carry.status)
    ended = [STATUS.nonfinite if run in undefined else STATUS.stalled for run in stalled]
    np.atleast_1d(status)[list(stalled)] = ended  # a view of it
    return loop_state._replace(carry=loop_state.carry._replace(status=status)), next(iter(stalled.values()))


def rates_of(field, t, x) -> tuple[Any, Any, Any]:
    """The rates of the field and of the motion, and Df (n, n), for a vector field (t, x) -> dx/dt."""
    f, acceleration = jax.jvp(field, (t, x), (jnp.ones_like(t), field(t, x)))
    _, along = jax.jvp(lambda t: field(t, x), (t,), (jnp.ones_like(t),))
    speed = jnp.max(jnp.abs(f))
    speed = jnp.where(speed > 0, speed, jnp.inf)
    jacobian = jax.jacfwd(lambda x: field(t, x))(x)
    largest = jnp.maximum(jnp.max(jnp.sum(jnp.abs(jacobian), axis=1)), jnp.max(jnp.abs(along)) / speed)
    return largest, jnp.max(jnp.abs(acceleration)) / speed, jacobian
