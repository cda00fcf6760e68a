"""The state of the loop, and what is fixed while it runs: shapes and meanings in one place."""

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
    "Events",
    "LoopState",
    "Left",
    "BlockRecord",
    "Orthonormalisation",
    "Settings",
    "Observer",
    "added",
    "log_event",
    "restart",
    "select",
    "stop",
    "stretched",
]

LONGEST_BLIND = 4.0  # jumps between two orthonormalisations, where each may destroy a direction
STRETCHED = 100.0  # a larger entry of a frame ends the interval there: a grazing jump must not look like a loss
MOST_AT_ONCE = 64  # jumps at one instant that an event log must have room for


class QRSchedule(NamedTuple):
    """When an orthonormalisation is due: after so much of a unit since the last one."""

    unit: str  # "steps" | "time" | "jumps" | "never"
    automatic: bool  # lengthen and shorten the interval from the growth that is seen
    each: bool = False  # after each step: where nothing is rare, a span is then one step, and needs no loop


class Orthonormalisation(NamedTuple):
    """One orthonormalisation."""

    t: Array
    before: Array  # (n, k) the frame before
    frame: Array  # (n, k) after it; zero where lost
    log_r: Array  # (k,) ln R_ii; zero where lost
    lost: Array  # (k,)
    velocity: Callable  # () -> (n,) the flow's, where there is one


class Observer(Protocol):
    """What indicators follow from one orthonormalisation to the next, as a state of arrays."""

    def begin(self, t, frame) -> Any:
        """The state at the start of a run, or of its part that counts."""
        ...

    def update(self, state: Any, seen: Orthonormalisation) -> Any:
        """The state after an orthonormalisation."""
        ...

    def moved(self, state: Any, source) -> Any:
        """The state after the columns of the frame have changed places: new[i] came from old[source[i]]."""
        ...

    def next_block(self, state: Any) -> Any:
        """The state at the start of the next block."""
        ...


@runtime_checkable
class ErrorObserver(Observer, Protocol):
    """A watch that also looks at the error estimates of the steps."""

    def stepped(self, state: Any, errors: Array) -> Any:
        """The state after a step of the method with these estimates (estimates, n, k) of the frame's errors."""
        ...


class Settings(NamedTuple):
    """What is fixed at compile time."""

    evolver: Any  # an `AbstractEvolver`
    qr_schedule: QRSchedule
    kind: str  # of orthonormalisation
    sum_rule: bool  # ∫ tr Df and Σ ln|det S| are collected
    log: int  # room for so many events; 0: none are kept
    count_jumps: bool  # a block may end by its number of jumps
    collect: Callable  # (t, carry) -> what is recorded at the end of a block
    observer: Any = None  # an `Observer`: what follows the orthonormalisations
    reverse: bool = False  # loops keep checkpoints, for a reverse pass


class Events(NamedTuple):
    """The log of events, `count` of which are filled; time is local until the block's end."""

    count: Any
    t: Array
    transition: Array
    which: Any
    mode_before: Array
    mode_after: Array
    x_before: Array
    x_after: Array


class Left(NamedTuple):
    """What rounding left over of the sums of a block: sums of thousands of terms cost float32 its digits."""

    s: Array
    growth: Array
    log_volume: Any


class StepState(NamedTuple):
    """The state of the innermost loop. What a run does not need is None, and costs nothing."""

    s: Array  # time since the start of the block
    x: Array  # (n,)
    frame: Array  # (n, k)
    since: Array  # steps, time or jumps since the last orthonormalisation
    budget: Array  # attempts left before control returns to the host; 0 also where the run has ended
    status: Array
    jumps: Array
    growth: Array  # (k,) Σ ln R_ii of the block
    log_volume: Any  # ∫ tr Df + Σ ln|det S| of the block
    losses: Any  # (k,)
    first_loss: Any  # (k,), time of the first loss of each column, nan before
    order: Any  # (k,) where each column stood at the start of the block
    solver_state: Any  # the evolver's
    log: Events | None
    observer: Any = None  # the state of an `Observer`
    left: Left | None = None  # None in float64
    waiting: Waiting | None = None  # None where jumps end no block


class LoopState(NamedTuple):
    """What changes only from block to block."""

    carry: StepState
    base: Array  # (2,) time at the start of the block: rounded, and what rounding left over
    elapsed: Array  # time since the run began
    block: Array  # number of blocks done
    interval: Array  # between orthonormalisations
    spread: Array  # largest ln(R_11 / R_kk) of one orthonormalisation


class BlockRecord(NamedTuple):
    """One block's harvest; `valid` is False where the block was not finished in this call."""

    valid: Array
    duration: Array
    jumps: Array
    growth: Array
    log_volume: Any
    losses: Any
    order: Any
    collected: Any


class Clock(NamedTuple):
    """What the evolver sees of time: the base of the block, its length, and its last jump."""

    base: Array
    rest: Array  # what rounding the base left over
    length: Array
    last_jump: Array
    interval: Any = None  # between orthonormalisations, where these come by time

    def limit(self, carry: StepState):
        """Where a flight ends that meets no event: with the block, or at the next orthonormalisation by time."""
        if self.interval is None:
            return self.length
        return jnp.minimum(self.length, carry.s + jnp.maximum(self.interval - carry.since, 0.0))

    def flown(self, carry: StepState, end):
        """`Carry.since` after such a flight: at an orthonormalisation by time the whole interval, without rounding."""
        return jnp.where(end < self.length, self.interval, carry.since + (end - carry.s))

    def afresh(self, carry: StepState) -> StepState:
        """The carry as it goes on after an orthonormalisation by time, if one is due."""
        return carry._replace(since=jnp.where(carry.since >= self.interval, 0.0, carry.since))


def select(condition, yes, no):
    """One tree where the condition holds, else the other."""
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), yes, no)


def stretched(carry: StepState):
    """Whether jumps have stretched a column so much that it must be orthonormalised at once."""
    return jnp.max(jnp.abs(carry.frame)) > STRETCHED ** share(carry.frame)


def restart(loop_state: LoopState, observer: Observer | None = None) -> LoopState:
    """Forget what was counted so far (time, jumps, losses): a new run begins where this one stands.

    The status stays: what has ended stays ended.
    """
    carry = loop_state.carry._replace(jumps=jnp.zeros_like(loop_state.carry.jumps))
    if carry.losses is not None:
        carry = carry._replace(losses=jnp.zeros_like(carry.losses), first_loss=jnp.full_like(carry.first_loss, jnp.nan))
    if observer is not None:
        carry = carry._replace(observer=observer.begin(loop_state.base[0] + loop_state.base[1], carry.frame))
    nothing = jnp.zeros_like(loop_state.elapsed)
    return LoopState(carry, loop_state.base, nothing, jnp.zeros_like(loop_state.block), loop_state.interval, nothing)


def log_event(log: Events | None, entry: Events, real: Any = True) -> Events | None:
    """Append one event (its `count` is ignored), if it is real; there is room for it."""
    if log is None:
        return None

    def put(buffer, value):
        return buffer.at[log.count].set(value)

    filled = jax.tree.map(put, log._replace(count=None), entry._replace(count=None))
    return filled._replace(count=log.count + jnp.asarray(real, jnp.int32))


def added(carry: StepState, **terms) -> StepState:
    """The carry with terms added to its sums `s`, `growth` and `volume`; what is None has no sum."""
    terms = {name: term for name, term in terms.items() if term is not None and getattr(carry, name) is not None}
    if carry.left is None:
        return carry._replace(**{name: getattr(carry, name) + term for name, term in terms.items()})
    terms = {name: term + getattr(carry.left, name) for name, term in terms.items()}
    sums = {name: getattr(carry, name) + term for name, term in terms.items()}
    # Kahan's: the sum takes in less, or more, than the term.
    left = {name: term - (sums[name] - getattr(carry, name)) for name, term in terms.items()}
    return carry._replace(**sums, left=carry.left._replace(**left))


def stop(carry: StepState, status, when: Any = True) -> StepState:
    """End the run with a status where `when` holds."""
    ends = jnp.asarray(when) & (carry.status == RUNNING)
    return carry._replace(
        status=jnp.where(ends, jnp.asarray(status, jnp.int32), carry.status),
        budget=jnp.where(ends, 0, carry.budget),
    )
