"""Runs of jets, and the sums from which linear responses follow."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ....engine.host.abreast import run_abreast
from ....systems.smooth import Flow
from ..estimates import ExponentFunction, UntrustedError
from .continuity import breaks
from .jets import Jet, JetMap, jet_at, onward

__all__ = ["MEMORIES", "STEPS_PER_PIECE", "TOP", "ResponseSums", "responses"]

STEPS_PER_PIECE = 1024  # steps of a piece of a run
MEMORY_STAGES = 8  # stages of a memory
MEMORIES = (8, 16, 32, 64)  # lengths of the memories, in the caller's unit
SPIN_UP = 1  # spin-up before sums are taken, in units of the longest memory
TOP = 16  # largest values of each piece that are kept for the tail


class ResponseSums(NamedTuple):
    """Sums over the steps of a piece of a run."""

    growth: Array  # (k,) J
    direct: Array  # (p, k) ∂_θJ + DJ v
    dilation: Array  # (p,) c
    dilated: Array  # (p, k) c dJ/dh
    memory: Array  # (memories, p) B: earlier b, weighted by each memory
    response: Array  # (memories, p, k) B J
    broken: Array  # number of detected discontinuities


class ResponseState(NamedTuple):
    """The state of a run between pieces."""

    jet: Jet
    stages: Array  # (MEMORY_STAGES, memories, p)


class SharedInputs(NamedTuple):
    """The inputs that all runs share."""

    system: Any
    args_of: Callable
    method: Any
    t: Array  # arbitrary, as the system does not depend on time
    theta: Array  # (p,)
    h: Array
    retained: Array  # (memories,) fraction of a stage that stays there in a step
    size: Array  # of the attractor


class RunPiece(eqx.Module):
    """A piece of a run: STEPS_PER_PIECE steps."""

    flows: bool = eqx.field(static=True)

    def __call__(self, shared: SharedInputs, running: ResponseState, lane):
        """The state after the piece, with the sums and the largest of |b| and |g| (p + 1, TOP)."""
        del lane
        motion = JetMap(_rule_of(shared), shared.theta, shared.h, self.flows)
        next_step = jax.jit(lambda running: _step(motion, shared, running))  # traced once, for shapes and loop

        def step(carry, _):
            running, sums = carry
            running, new, tails = next_step(running)
            return (running, jax.tree.map(jnp.add, sums, new)), tails

        nothing = jax.tree.map(jnp.zeros_like, jax.eval_shape(next_step, running)[1])
        (running, sums), tails = jax.lax.scan(step, (running, nothing), None, length=STEPS_PER_PIECE)
        return running, (sums, jax.lax.top_k(tails.T, TOP)[0])


def _step(motion: JetMap, shared: SharedInputs, running: ResponseState) -> tuple[ResponseState, ResponseSums, Array]:
    z = running.jet.z
    broken = breaks(lambda x: _function(shared, motion.theta, x), z.x, z.frame[:, 0], shared.size, not motion.flows)
    jet, seen = onward(motion, running.jet)
    memory = jnp.sum(running.stages, axis=0)
    sums = ResponseSums(
        growth=seen.growth,
        direct=seen.direct,
        dilation=seen.dilation,
        dilated=jnp.multiply.outer(seen.dilation, seen.rate),
        memory=memory,
        response=jnp.multiply.outer(memory, seen.growth),
        broken=broken.astype(memory.dtype),
    )
    tails = jnp.abs(jnp.append(seen.b, jet.g))
    return ResponseState(jet, remembered(running.stages, seen.b, shared.retained)), sums, tails


def _function(shared: SharedInputs, theta, x):
    """The field of a flow, or the rule of a map."""
    function = shared.system.field if isinstance(shared.system, Flow) else shared.system.rule
    return function(shared.t, x, shared.args_of(theta))


def _rule_of(shared: SharedInputs) -> Callable:
    """φ as (θ, h, x) -> x': a step of the method, or the rule of a map."""

    def of_map(theta, h, x):
        del h
        return _function(shared, theta, x)

    def of_flow(theta, h, x):
        def field(t, x):
            del t
            return _function(shared, theta, x)

        return shared.method.step(field, shared.t, x, field(shared.t, x), h).x

    return of_flow if isinstance(shared.system, Flow) else of_map


def remembered(stages, b, retained):
    """Update the stages (MEMORY_STAGES, memories, p) of the memories with a new b (p,).

    A chain of MEMORY_STAGES leaky stages: a b of k steps ago has, summed over the stages, as weight the probability
    that the sum of MEMORY_STAGES geometric waiting times exceeds k. This is a smooth taper of the sum over lags, flat
    at lag 0; a sharp cut would give wrong sums with small error bars.
    """
    retained = jnp.broadcast_to(retained[None, :, None], stages.shape)
    first = jnp.broadcast_to(b[None, None, :], stages[:1].shape)
    return retained * stages + jnp.concatenate([first, ((1 - retained) * stages)[:-1]])


def responses(
    case: ExponentFunction, points, framed, *, h: float, unit: float, progress: Any
) -> tuple[ResponseSums, np.ndarray, int]:
    """Runs of length t1 from points (runs, n) of an attractor with frames (runs, n, k).

    Args:
        case: system and parameters.
        points: starts.
        framed: frames at the starts.
        h: length of a step.
        unit: unit of the memories' lengths, in steps.
        progress: None, True for a bar, or a function of the fraction done.

    Returns:
        Sums (runs, …) over the number of steps; the largest of |b| and |g| (p + 1, many); and from how many steps.
    """
    theta, options = jnp.asarray(case.theta), case.options
    retained = 1 - MEMORY_STAGES / (unit * np.array(MEMORIES, float))
    size = np.linalg.norm(np.std(points, axis=0))
    shared = SharedInputs(
        case.system, case.args_of, options["method"], *(jnp.asarray(one, theta.dtype) for one in (
            options["t0"], theta, h, retained, size))
    )  # fmt: skip
    spin, pieces = (math.ceil(steps / STEPS_PER_PIECE) for steps in (SPIN_UP * unit * MEMORIES[-1], options["t1"] / h))
    stages = jnp.zeros((MEMORY_STAGES, len(MEMORIES), len(theta)), theta.dtype)
    sequences = [
        (ResponseState(jet_at(jnp.asarray(x), jnp.asarray(frame), len(theta)), stages), np.zeros(spin + pieces))
        for x, frame in zip(points, framed, strict=True)
    ]
    results, done = run_abreast(RunPiece(isinstance(case.system, Flow)), shared, sequences, progress=progress)
    whole = [result for result, computed in zip(results, done, strict=True) if np.all(computed)]
    if len(whole) < 2:
        raise UntrustedError("interrupted before two runs were done: there is nothing to tell the error from.")
    sums, largest = jax.tree.map(lambda *leaves: np.stack(leaves)[:, spin:], *whole)
    largest = np.moveaxis(largest, 2, 0).reshape(len(theta) + 1, -1)
    return (
        jax.tree.map(lambda leaf: leaf.mean(axis=1) / STEPS_PER_PIECE, sums),
        largest,
        pieces * len(whole) * STEPS_PER_PIECE,
    )
