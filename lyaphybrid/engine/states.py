"""The state of the loop and its compile-time settings, with shapes and meanings."""

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
from jaxtyping import Array

from .._jax.precision import share
from ..statuses import RUNNING
from .waiting import Waiting

__all__ = [
    "QRSchedule",
    "StepState",
    "Clock",
    "ErrorObserver",
    "EventLog",
    "LoopState",
    "Compensation",
    "BlockRecord",
    "Orthonormalisation",
    "Settings",
    "Observer",
    "added",
    "log_event",
    "most_at_once",
    "restart",
    "select",
    "stop",
    "stretched",
]

LONGEST_BLIND = 4.0  # most jumps between two orthonormalisations where each jump may destroy a direction
STRETCHED = 100.0  # a larger frame entry forces an orthonormalisation: a grazing jump must not look like a lost column
MOST_AT_ONCE = 64  # most jumps at one instant: an event log must have room for them


class QRSchedule(NamedTuple):
    """When an orthonormalisation is due: after an interval, counted in a unit, since the last one."""

    unit: str  # "steps" | "time" | "jumps" | "never"
    automatic: bool  # adapt the interval to the observed growth
    each: bool = False  # after every step; without events or rejected steps a span is then one step and needs no loop


class Orthonormalisation(NamedTuple):
    """One orthonormalisation, as an `Observer` gets it."""

    t: Array  # time
    before: Array  # (n, k) the frame before
    frame: Array  # (n, k) after it; zero where lost
    log_r: Array  # (k,) ln R_ii; zero where lost
    lost: Array  # (k,) bool: columns that were lost
    velocity: Callable  # () -> (n,) the vector field at the state, for evolvers that have one


class Observer(Protocol):
    """What an indicator computes along a run; its state is a pytree of arrays, updated at each orthonormalisation."""

    def init(self, t, frame) -> Any:
        """The state at the start of a run, or at the end of its transient."""
        ...

    def update(self, state: Any, seen: Orthonormalisation) -> Any:
        """The state after an orthonormalisation."""
        ...

    def moved(self, state: Any, source) -> Any:
        """The state after a permutation of the frame's columns: column i now was column source[i] before."""
        ...

    def next_block(self, state: Any) -> Any:
        """The state at the start of the next block."""
        ...


@runtime_checkable
class ErrorObserver(Observer, Protocol):
    """An observer that also gets the error estimates of the steps."""

    def stepped(self, state: Any, errors: Array) -> Any:
        """The state after a step; errors (estimates, n, k) are the method's error estimates of the frame."""
        ...


class Settings(NamedTuple):
    """What is fixed at compile time."""

    evolver: Any  # an `AbstractEvolver`
    qr_schedule: QRSchedule
    kind: str  # algorithm of orthonormalisation
    sum_rule: bool  # accumulate ∫ tr Df dt and Σ ln|det S|
    log: int  # capacity of the event log; 0: no log
    count_jumps: bool  # a block may end by its number of jumps
    collect: Callable  # (t, carry) -> what is recorded at the end of a block
    observer: Any = None  # an `Observer`
    moving_end: bool = False  # as in `RunPlan`
    awaited: int | None = None  # the same
    reverse: bool = False  # loops keep checkpoints for reverse-mode derivatives


class EventLog(NamedTuple):
    """The event log: buffers with one row per event, of which the first `count` are filled; t is the global time."""

    count: Any
    t: Array
    transition: Array
    which: Any
    mode_before: Array
    mode_after: Array
    x_before: Array
    x_after: Array


class Compensation(NamedTuple):
    """Compensation terms of Kahan summation for the sums of a block, used in float32, where rounding accumulates."""

    s: Array
    growth: Array
    log_volume: Any


class StepState(NamedTuple):
    """The state of the innermost loop. Fields that a run does not need are None and cost nothing."""

    s: Array  # time since the start of the block
    x: Array  # (n,)
    frame: Array  # (n, k)
    since: Array  # steps, time or jumps since the last orthonormalisation
    budget: Array  # step attempts left before control returns to the host; 0 also once the run has ended
    status: Array  # `RUNNING`, or the code of a STATUS
    jumps: Array  # since the run began
    growth: Array  # (k,) Σ ln R_ii of the block
    log_volume: Any  # ∫ tr Df dt + Σ ln|det S| of the block
    losses: Any  # (k,) how often each column was lost
    first_loss: Any  # (k,) time of the first loss of each column; nan if never lost
    order: Any  # (k,) index of each column at the start of the block
    foreign: Any  # (k, k) of `foreign_shares`: what of each column may be rounding along those that replace lost ones
    solver_state: Any  # the evolver's own state
    log: EventLog | None
    observer: Any = None  # the state of an `Observer`
    left: Compensation | None = None  # None in float64
    waiting: Waiting | None = None  # None unless a number of jumps ends a block


class LoopState(NamedTuple):
    """The state between blocks: the innermost state and quantities that change only from block to block."""

    carry: StepState
    base: Array  # (2,) time at the start of the block as an unevaluated sum: rounded value and remainder
    elapsed: Array  # time since the run began
    block: Array  # number of finished blocks
    interval: Array  # between orthonormalisations, in the unit of the QRSchedule
    spread: Array  # largest ln(R_11 / R_kk) of one orthonormalisation so far


class BlockRecord(NamedTuple):
    """The result of one block; `valid` is False if the block was not finished in this call."""

    valid: Array
    duration: Array
    jumps: Array
    growth: Array
    log_volume: Any
    losses: Any
    order: Any
    collected: Any


class Clock(NamedTuple):
    """The block's time base, its length and its last jump, as the evolver needs them."""

    base: Array  # time at the start of the block, rounded
    rest: Array  # remainder: the exact start is base + rest
    length: Array  # of the block, in time; inf where only jumps end it
    last_jump: Array  # number of jumps, since the run began, that ends the block
    interval: Any = None  # time between orthonormalisations; None where they are not scheduled by time

    def limit(self, carry: StepState):
        """The time where a flight without an event ends: the block's end or the next scheduled orthonormalisation."""
        if self.interval is None:
            return self.length
        due = carry.s + jnp.where(self.interval > carry.since, self.interval - carry.since, 0.0)
        return jnp.where(due < self.length, due, self.length)  # `minimum` would halve derivatives where both are equal

    def over(self, carry: StepState):
        """Whether the block has come to its end in time, by an event there or by a step, and the run goes on."""
        return (carry.s >= self.length) & (carry.status == RUNNING)

    def flown(self, carry: StepState, end):
        """`StepState.since` after such a flight; exactly `interval` where an orthonormalisation is due."""
        return jnp.where(end < self.length, self.interval, carry.since + (end - carry.s))

    def afresh(self, carry: StepState) -> StepState:
        """The carry as it will be after the orthonormalisation, if one is due: there the next flight begins."""
        if self.interval is None:
            return carry
        return carry._replace(since=jnp.where(carry.since >= self.interval, 0.0, carry.since))


def select(condition, yes, no):
    """The tree `yes` where the condition holds, else the tree `no`; what is the same in both is not copied."""
    return jax.tree.map(lambda a, b: a if a is b else jnp.where(condition, a, b), yes, no)


def stretched(carry: StepState):
    """Whether jumps have stretched a column so much that the frame must be orthonormalised now."""
    return jnp.max(jnp.abs(carry.frame)) > STRETCHED ** share(carry.frame)


def without_room(carry: StepState, t) -> StepState:
    """At the start of a run at t ([m]): columns for which the mode has no room are lost, not among its losses."""
    lost = ~jnp.any(carry.frame != 0, axis=-2)  # ([m,] k), of one run or of several
    first = jnp.where(lost, t[..., None], jnp.nan)
    return carry._replace(first_loss=first.astype(carry.first_loss.dtype))


def restart(loop_state: LoopState, observer: Observer | None = None) -> LoopState:
    """Start a new run from the present state: time, jumps and losses are counted from zero.

    The status is kept: a run that has ended stays ended.
    """
    carry = loop_state.carry._replace(jumps=jnp.zeros_like(loop_state.carry.jumps))
    t = jnp.sum(loop_state.base, axis=-1)
    if carry.losses is not None:
        carry = without_room(carry._replace(losses=jnp.zeros_like(carry.losses)), t)
    if observer is not None:
        carry = carry._replace(observer=observer.init(t, carry.frame))
    nothing = jnp.zeros_like(loop_state.elapsed)
    return LoopState(carry, loop_state.base, nothing, jnp.zeros_like(loop_state.block), loop_state.interval, nothing)


def log_event(log: EventLog | None, entry: EventLog, real: Any = True) -> EventLog | None:
    """Append one event (its `count` is ignored) if `real`; the caller has made sure that there is room."""
    if log is None:
        return None

    def put(buffer, value):
        return buffer.at[log.count].set(value)

    filled = jax.tree.map(put, log._replace(count=None), entry._replace(count=None))
    return filled._replace(count=log.count + jnp.asarray(real, jnp.int32))


def before_events(carry: StepState, after: StepState) -> StepState:
    """The carry before events that have been logged since, with the buffers of the log after them.

    Rows beyond `count` do not count; to choose between two logs in the same buffers nothing has to be copied.
    """
    if carry.log is None or after.log is None:
        return carry
    return carry._replace(log=after.log._replace(count=carry.log.count))


def empty_log(log: EventLog | None, rows: int) -> EventLog | None:
    """A log of the same kind with so many rows."""
    return log and jax.tree.map(lambda one: jnp.zeros((rows, *one.shape[1:])[: one.ndim], one.dtype), log)


def log_events(log: EventLog | None, entries: EventLog | None) -> EventLog | None:
    """Append all events of another log; the caller has made sure that there is room."""
    if log is None or entries is None:
        return log
    place = jnp.arange(entries.t.shape[0], dtype=jnp.int32)
    place = jnp.where(place < entries.count, log.count + place, log.t.shape[0])  # beyond the end nothing is set

    def put(buffer, values):
        return buffer.at[place].set(values, mode="drop")

    filled = jax.tree.map(put, log._replace(count=None), entries._replace(count=None))
    return filled._replace(count=log.count + entries.count)


def most_at_once(x, log: EventLog | None) -> int:
    """Most jumps at one instant, for which a log must have room: each component may have one of its own."""
    most = max(MOST_AT_ONCE, x.shape[0])
    return most if log is None else min(most, max(MOST_AT_ONCE, log.t.shape[0] // 2))


def added(carry: StepState, **terms) -> StepState:
    """The carry with terms added to its sums `s`, `growth` and `log_volume`; what is None is skipped."""
    terms = {name: term for name, term in terms.items() if term is not None and getattr(carry, name) is not None}
    if carry.left is None:
        return carry._replace(**{name: getattr(carry, name) + term for name, term in terms.items()})
    terms = {name: term + getattr(carry.left, name) for name, term in terms.items()}
    sums = {name: getattr(carry, name) + term for name, term in terms.items()}
    # Kahan summation: keep the difference between the term and the change of the rounded sum.
    left = {name: term - (sums[name] - getattr(carry, name)) for name, term in terms.items()}
    return carry._replace(**sums, left=carry.left._replace(**left))


def stop(carry: StepState, status, when: Any = True) -> StepState:
    """End the run with a status where `when` holds."""
    ends = jnp.asarray(when) & (carry.status == RUNNING)
    return carry._replace(
        status=jnp.where(ends, jnp.asarray(status, jnp.int32), carry.status),
        budget=jnp.where(ends, 0, carry.budget),
    )
