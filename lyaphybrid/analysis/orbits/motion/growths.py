"""The multipliers of an orbit from columns that are orthonormalised on the way, however small they are."""

from typing import NamedTuple

import numpy as np

from ...._jax.tracing import array, as_jax
from ...._linalg import frames
from ....engine import problems
from ....engine.blocks import qr_schedule_for
from ....engine.host import driver
from ....results.spectrum import unresolved
from ....statuses import STATUS
from .motions import Motion, Node

__all__ = ["Growths", "growths_of"]

TURNS_TO_SETTLE, MOST_TO_SETTLE = 2, 24  # after which columns are those of the multipliers, in the order of their sizes
MOST_STEPS_OF_DECAYS = 200_000  # in a turn
SAME_DIRECTION = 1 - 1e-6  # cosine between a column and what it becomes in a turn; it is less for a complex pair


class Growths(NamedTuple):
    """What one turn does to orthonormal columns that have settled."""

    logs: np.ndarray  # (n,) ln|·| of the multipliers, the largest first; −inf where a jump destroys the direction
    signs: np.ndarray  # (n,) of real multipliers; 0 where it is not known
    unsure: bool  # whether a direction that counts as destroyed may only be short, or columns have not settled


class _Turn(NamedTuple):
    frame: np.ndarray  # (n, k)
    logs: np.ndarray  # (k,)
    volume: float  # ∫ tr Df dt
    unsure: bool


def growths_of(flow: Motion, start: Node, period: float, smooth: bool) -> Growths | None:
    """The growths of an orbit through `start`; None where it takes too many steps.

    Where the orbit is smooth and destroys nothing, the fastest decay follows from the divergence, so that no step has
    to resolve it.
    """
    n = len(start.x)
    turn = _Turn(np.eye(n, n - smooth, dtype=start.x.dtype), np.zeros(0), 0.0, False)
    signs = np.zeros(turn.frame.shape[1])
    for number in range(MOST_TO_SETTLE):
        before = turn.frame
        turn = _turned(flow, start, period, before)
        if turn is None:
            return None
        cosines = np.sum(before * turn.frame, axis=0)
        signs = np.where(np.abs(cosines) > SAME_DIRECTION, np.sign(cosines), 0.0)
        if number >= TURNS_TO_SETTLE and np.all((signs != 0) | np.isinf(turn.logs)):
            break
    logs = turn.logs
    if smooth:
        last = turn.volume - np.sum(logs)
        # A flow keeps its orientation, and so does a pair that turns.
        logs, signs = np.append(logs, last), np.append(signs, np.prod(signs[signs != 0]))
    order = np.argsort(-logs, kind="stable")
    logs, signs = logs[order], signs[order]
    turning = (signs == 0) & np.isfinite(logs)
    return Growths(_in_pairs(logs, turning), signs, turn.unsure or int(np.sum(turning)) % 2 == 1)


def _turned(flow: Motion, start: Node, period: float, frame: np.ndarray) -> _Turn | None:
    """One turn from the start with the frame (n, k); None where it does not come to its end."""
    x0, problem = as_jax(np.asarray(start.x)), flow.problem_from(start)
    schedule, interval = qr_schedule_for(problem, None)
    plan = problems.RunPlan(qr_schedule=schedule, kind=frames.kind_for(frame.shape[1]), sum_rule=True)
    end = array([period], x0.dtype)
    loop_state = driver.start(problem, plan, array(start.t, x0.dtype), x0, frame, start.mode, interval)
    outcome = driver.drive(problem, plan, loop_state, end, end, MOST_STEPS_OF_DECAYS)
    if outcome.interrupted:
        raise KeyboardInterrupt
    if int(outcome.status) != STATUS.ok:
        return None
    carry, growth = outcome.loop_state.carry, np.sum(outcome.records.growth, axis=0)
    logs = growth if carry.losses is None else np.where(np.asarray(carry.losses) > 0, -np.inf, growth)
    unsure = bool(unresolved(np.asarray(outcome.loop_state.spread)))
    return _Turn(np.asarray(carry.frame), logs, float(np.sum(outcome.records.log_volume)), unsure)


def _in_pairs(logs: np.ndarray, turning: np.ndarray) -> np.ndarray:
    """The logs, of two columns that turn into each other their mean: a complex pair has one modulus."""
    logs, pairs = logs.copy(), np.flatnonzero(turning)
    for i, j in zip(pairs[::2], pairs[1::2], strict=False):
        logs[i] = logs[j] = (logs[i] + logs[j]) / 2
    return logs
