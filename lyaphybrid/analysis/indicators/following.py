"""One run with an `Observer`: what all indicators have in common."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from ..._arguments import attempts, require, whole
from ..._jax.tracing import array, traced
from ..._linalg import frames
from ...engine import preparation, problems
from ...engine.blocks import each_step_of, ends_of_blocks, is_zero, qr_schedule_for, targets_for
from ...engine.host import driver
from ...engine.host.places import Place, account, place_of
from ...engine.states import Observer
from ...errors import RunFailedError
from ...integrators import ContinuousQR
from ...statuses import STATUS, gravest
from ...systems.consistency import onto_constraints
from ...systems.daes.semi_linear import DAE, degrees_of_freedom
from ...systems.kinds import iterates

__all__ = ["Followed", "discrete", "follow", "generic_frame", "start_frame", "unit_columns", "verdict_of"]


class Followed(NamedTuple):
    """What a run leaves: the leading axes are ([m,] blocks)."""

    time: Any  # at the ends of the blocks, since the start of the part that counts; nan where not reached
    collected: Any
    status: Any
    interrupted: bool
    loop_state: Any
    system: Any
    why: str

    @property
    def place(self) -> Place:
        """Where it stands."""
        return place_of(self.loop_state, self.system)


def follow(
    observer: Observer | None,
    collect,
    system,
    x0,
    args,
    *,
    k: int,
    t1,
    t0,
    transient,
    times,
    blocks,
    mode,
    frame,
    method,
    max_steps,
    progress,
    every=None,
    each_step: bool = False,
) -> Followed:
    """Run a system with k deviation vectors, and let `observer` see every orthonormalisation (k = 0: there are none).

    `collect` says what is recorded at the ends of the blocks; `frame` None: orthonormal vectors of no special
    direction; `each_step`: orthonormalise after each step, or each flight between events. The rest as for
    `lyapunov_spectrum`.
    """
    whole("blocks", blocks, least=2)
    attempts(max_steps)
    problem, x0, t0, mode = preparation.prepare(system, x0, args, t0, method, mode)
    n = x0.shape[-1]
    most = degrees_of_freedom(system, n)
    require(k <= most, f"{k} deviation vectors were asked for, in a space of {most} dimensions.")
    frame = generic_frame(n, k, x0.dtype) if frame is None else unit_columns(frame, n, k, x0.dtype)
    qr_schedule, interval = each_step_of(problem) if each_step else qr_schedule_for(problem, every)
    qr_schedule = qr_schedule if k else problems.NEVER
    plan = problems.Plan(
        qr_schedule=qr_schedule, kind=frames.kind_for(k), batched=x0.ndim == 2, collect=collect, observer=observer
    )
    limits = ends_of_blocks(t1, blocks, times, "t1")
    discrete, interrupted, why = iterates(problem.system), False, ""
    loop_state = driver.start(problem, plan, t0, x0, frame, mode, array(interval, x0.dtype))
    if not is_zero(transient):
        quiet = targets_for(ends_of_blocks(transient, 2, None, "transient"), "time", discrete, x0.dtype)
        before = driver.drive(problem, plan, loop_state, *quiet, max_steps)
        why = before.why
        loop_state, interrupted = driver.restart(driver.sealed(before), observer, plan.batched), before.interrupted
    outcome = driver.drive(
        problem, plan, loop_state, *targets_for(limits, "time", discrete, x0.dtype), max_steps, progress, interrupted
    )
    valid, durations = outcome.records.valid, outcome.records.duration
    xp = jnp if traced(durations) else np
    time = xp.where(valid, xp.cumsum(xp.where(valid, durations, 0.0), axis=-1), xp.nan)
    collected, why = outcome.records.collected, why or outcome.why
    return Followed(time, collected, outcome.status, outcome.interrupted, outcome.loop_state, problem.system, why)


def discrete(name: str, method):
    """The method, which must leave the growth of the frame to orthonormalisations: these are what is followed."""
    require(
        not isinstance(method, ContinuousQR),
        f"{name} reads the growth off orthonormalisations, and lh.ContinuousQR leaves none: give the method within it.",
    )
    return method


def generic_frame(n: int, k: int, dtype) -> np.ndarray:
    """K orthonormal vectors of n components, always the same, in no special direction."""
    q, r = np.linalg.qr(np.random.default_rng(20101).standard_normal((n, k)))
    return (q * np.sign(np.diag(r))).astype(dtype)


def start_frame(system, t0, x0, args, k: int):
    """That frame for a start x0 (n,); of a DAE an orthonormal one of its tangent space."""
    x = jnp.asarray(x0, float)
    frame = generic_frame(x.shape[0], k, x.dtype)
    if not isinstance(system, DAE):
        return frame
    return np.linalg.qr(np.asarray(onto_constraints(system, jnp.asarray(t0, x.dtype), x, args, jnp.asarray(frame))))[0]


def unit_columns(frame, n, k, dtype):
    """The user's vectors, each of length 1: indicators are volumes of unit vectors."""
    frame = jnp.asarray(frame, dtype)
    require(frame.shape == (n, k), f"frame must have shape (n, k) = ({n}, {k}); got {frame.shape}.")
    return frame / jnp.linalg.norm(frame, axis=0, keepdims=True)


def verdict_of(followed: Followed, result, throw: bool):
    """The result; or an error where the run failed, the values are known and `throw`."""
    if throw and not traced(followed.status):
        status = STATUS(int(gravest(np.asarray(followed.status))))
        if status.failed:
            raise RunFailedError(status, account(followed.status, followed.place, why=followed.why), result)
    return result
