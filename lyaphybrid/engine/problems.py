"""What is computed and how: the problem and the plan of a run, and what is collected at the ends of blocks."""

from collections.abc import Callable
from types import ModuleType
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from ..systems.hybrid import Hybrid
from .states import LoopState, Observer, QRSchedule

__all__ = [
    "Plan",
    "Problem",
    "first_losses",
    "in_rows",
    "mode_names",
    "mode_of",
    "nothing",
    "point",
    "summary_of",
    "time_of",
]


class Problem(NamedTuple):
    """What is computed: traced where it is an array, static where it is a function."""

    system: Any
    method: Any
    args: Any
    shape: tuple[int, ...]  # of a state, which is flat within a run


def nothing(t, carry):
    """Collect nothing at the ends of blocks."""
    del t, carry


NEVER = QRSchedule("never", False)  # the frame is carried, and not orthonormalised


class Plan(NamedTuple):
    """How it is computed: all static. As it stands: the frame is carried along, and nothing is collected."""

    qr_schedule: QRSchedule = NEVER
    kind: str = "mgs"  # of orthonormalisation: "mgs", or one of `frames`
    sum_rule: bool = False  # ∫ tr Df and Σ ln|det S| are collected
    log: int = 0  # room for so many events in one call
    count_jumps: bool = False  # a block may end by its number of jumps
    batched: bool = False  # several runs at once, x0 (m, n)
    collect: Callable = nothing  # (t, carry) -> what is recorded at the end of a block
    observer: Observer | None = None


def first_losses(t, carry):
    """Collect when each column was first lost; None where nothing can be."""
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
    """The time where a loop's state stands."""
    return loop_state.base[..., 0] + (loop_state.base[..., 1] + loop_state.carry.s)


def mode_names(system) -> tuple[str, ...]:
    """The names of a system's modes."""
    return system.mode_names if isinstance(system, Hybrid) else ("flow",)


def in_rows(problem: Problem, x):
    """States of a run, flat there, in the shape in which the user gave them."""
    return x.reshape(*x.shape[:-1], *problem.shape)


def summary_of(loop_state: LoopState, xp: ModuleType = jnp):
    """(transversality, grazing, simultaneous, accumulation, doubtful) of a loop's state, whatever its evolver."""
    memory = getattr(loop_state.carry.solver_state, "memory", None)
    if memory is None:
        zero = xp.zeros_like(loop_state.carry.s)
        return zero + np.inf, zero, zero, zero + np.nan, zero
    return tuple(memory[..., i] for i in (4, 5, 6, 7, 9))
