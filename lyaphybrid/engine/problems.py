"""The problem (what is computed) and the plan (how), and functions that collect data at the ends of blocks."""

from collections.abc import Callable
from types import ModuleType
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from ..events.bits import in_bits
from ..systems.hybrid import Hybrid
from .states import LoopState, Observer, QRSchedule

__all__ = [
    "RunPlan",
    "RunProblem",
    "first_losses",
    "in_rows",
    "mode_names",
    "mode_of",
    "nothing",
    "point",
    "summary_of",
    "time_of",
]


class RunProblem(NamedTuple):
    """What is computed; arrays are traced, functions are static."""

    system: Any
    method: Any
    args: Any
    shape: tuple[int, ...]  # shape of the user's state; within a run states are flat


def nothing(t, carry):
    """Collect nothing at the ends of blocks."""
    del t, carry


NO_ORTHONORMALISATION = QRSchedule("never", False)  # the frame is propagated without orthonormalisation


class RunPlan(NamedTuple):
    """How it is computed; all fields are static. By default the frame is propagated and nothing is collected."""

    qr_schedule: QRSchedule = NO_ORTHONORMALISATION
    kind: str = "mgs"  # algorithm of orthonormalisation, one of `frames.QR_ALGORITHMS`
    sum_rule: bool = False  # accumulate ∫ tr Df dt and Σ ln|det S|
    log: int = 0  # capacity of the event log, per call
    count_jumps: bool = False  # a block may end by its number of jumps
    batched: bool = False  # several runs at once, x0 (m, n)
    collect: Callable = nothing  # (t, carry) -> what is recorded at the end of a block
    observer: Observer | None = None
    moving_end: bool = False  # columns of a run that a terminal transition ends: of its end, each at its own time
    awaited: int | None = None  # transition whose jumps alone end a wait, told by the log; None: any jump does


def first_losses(t, carry):
    """Collect the time (k,) of the first loss of each column; None where columns cannot be lost."""
    del t
    return carry.first_loss


def point(t, carry):
    """Collect the time, the state, the mode and the number of jumps at the ends of blocks."""
    return t, carry.x, mode_of(carry), carry.jumps


def mode_of(carry, xp: ModuleType = jnp):
    """The index of the present mode."""
    mode = getattr(carry.solver_state, "mode", None)
    return xp.zeros((), np.int32) if mode is None else mode


def time_of(loop_state: LoopState):
    """The time of a loop's state."""
    return loop_state.base[..., 0] + (loop_state.base[..., 1] + loop_state.carry.s)


def mode_names(system) -> tuple[str, ...]:
    """The names of a system's modes."""
    return system.mode_names if isinstance(system, Hybrid) else ("flow",)


def in_rows(problem: RunProblem, x):
    """Flat states (…, n) in the shape in which the user gave them."""
    return x.reshape(*x.shape[:-1], *problem.shape)


def beyond_guard(loop_state: LoopState, xp: ModuleType = jnp):
    """Whether the motion was beyond a guard at the start and is still, so that it never fired, for any evolver."""
    solver = loop_state.carry.solver_state
    if getattr(solver, "memory", None) is None:
        return xp.zeros_like(loop_state.carry.s)
    waiting = in_bits(solver.memory[..., 11], solver.guard_sign.shape[-1], xp)
    return xp.any(waiting & (solver.guard_sign < 0), axis=-1).astype(loop_state.carry.s.dtype)


def summary_of(loop_state: LoopState, xp: ModuleType = jnp):
    """(transversality, grazing, simultaneous, accumulation, doubtful) of a loop's state, for any evolver."""
    memory = getattr(loop_state.carry.solver_state, "memory", None)
    if memory is None:
        zero = xp.zeros_like(loop_state.carry.s)
        return zero + np.inf, zero, zero, zero + np.nan, zero
    return tuple(memory[..., i] for i in (4, 5, 6, 7, 9))
