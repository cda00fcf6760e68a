"""Runs of jets, and the sums from which linear responses follow."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ...._arguments import require
from ....engine.host.lanes import run_chains
from ....systems.smooth import Flow
from ..estimates import Case
from .continuity import breaks
from .jets import Jet, Motion, jet_at, onward

__all__ = ["MEMORIES", "STEPS", "TOP", "Sums", "responses"]

STEPS = 1024  # of a piece of a run
STAGES = 8  # of what forgets
MEMORIES = (8, 16, 32, 64)  # in units that the caller gives
SPIN_UP = 1  # times the longest memory, before anything counts
TOP = 16  # of each piece the largest are kept for the tail


class Sums(NamedTuple):
    """What the steps of a piece of a run add up to."""

    growth: Array  # (k,) J
    direct: Array  # (p, k) ∂_θJ + DJ v
    dilation: Array  # (p,) c
    dilated: Array  # (p, k) c dJ/dh
    memory: Array  # (memories, p) B: the b before, as far as they are remembered
    response: Array  # (memories, p, k) B J
    broken: Array  # how often the rule or the field broke


class Running(NamedTuple):
    """What a run hands on from piece to piece."""

    jet: Jet
    stages: Array  # (STAGES, memories, p)


class Shared(NamedTuple):
    """What all runs see."""

    system: Any
    args_of: Callable
    method: Any
    t: Array  # any: the system does not depend on it
    theta: Array  # (p,)
    h: Array
    retained: Array  # (memories,) part of what a stage holds that stays there in a step
    size: Array  # of the attractor


class Piece(eqx.Module):
    """A piece of a run: so many steps."""

    flows: bool = eqx.field(static=True)

    def __call__(self, shared: Shared, running: Running, lane):
        """The run after it, with the sums and the largest of |b| and |g| (p + 1, TOP)."""
        del lane
        motion = Motion(_rule_of(shared), shared.theta, shared.h, self.flows)

        def step(carry, _):
            running, sums = carry
            running, new, tails = _step(motion, shared, running)
            return (running, jax.tree.map(jnp.add, sums, new)), tails

        nothing = jax.tree.map(jnp.zeros_like, jax.eval_shape(lambda: _step(motion, shared, running)[1]))
        (running, sums), tails = jax.lax.scan(step, (running, nothing), None, length=STEPS)
        return running, (sums, jax.lax.top_k(tails.T, TOP)[0])


def _step(motion: Motion, shared: Shared, running: Running) -> tuple[Running, Sums, Array]:
    z = running.jet.z
    broken = breaks(lambda x: _function(shared, motion.theta, x), z.x, z.frame[:, 0], shared.size, not motion.flows)
    jet, seen = onward(motion, running.jet)
    memory = jnp.sum(running.stages, axis=0)
    sums = Sums(
        growth=seen.growth,
        direct=seen.direct,
        dilation=seen.dilation,
        dilated=jnp.multiply.outer(seen.dilation, seen.rate),
        memory=memory,
        response=jnp.multiply.outer(memory, seen.growth),
        broken=broken.astype(memory.dtype),
    )
    tails = jnp.abs(jnp.append(seen.b, jet.g))
    return Running(jet, remembered(running.stages, seen.b, shared.retained)), sums, tails


def _function(shared: Shared, theta, x):
    """The field of a flow, or the rule of a map."""
    function = shared.system.field if isinstance(shared.system, Flow) else shared.system.rule
    return function(shared.t, x, shared.args_of(theta))


def _rule_of(shared: Shared) -> Callable:
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
    """The stages (STAGES, memories, p) of what is remembered, after a b (p,) has come in.

    Each b stays in a stage for a random time, and after the last it is forgotten: of one that came k steps ago their
    sum holds the probability that STAGES geometric times together are longer than k. That is a smooth taper, flat where
    it begins; a sudden end of the sum over lags is badly wrong, with small error bars.
    """
    retained = jnp.broadcast_to(retained[None, :, None], stages.shape)
    first = jnp.broadcast_to(b[None, None, :], stages[:1].shape)
    return retained * stages + jnp.concatenate([first, ((1 - retained) * stages)[:-1]])


def responses(case: Case, points, framed, *, h: float, unit: float, progress: Any) -> tuple[Sums, np.ndarray, int]:
    """Runs of length t1 from points (runs, n) of an attractor with frames (runs, n, k).

    Args:
        case: what runs.
        points: where.
        framed: with which frames.
        h: length of a step.
        unit: of the memories, in steps.
        progress: None, True for a bar, or a function of the fraction done.

    Returns:
        Sums (runs, …) over the number of steps; the largest of |b| and |g| (p + 1, many); and from how many steps.
    """
    theta, options = jnp.asarray(case.theta), case.options
    retained = 1 - STAGES / (unit * np.array(MEMORIES, float))
    size = np.linalg.norm(np.std(points, axis=0))
    shared = Shared(
        case.system, case.args_of, options["method"], *(jnp.asarray(one, theta.dtype) for one in (
            options["t0"], theta, h, retained, size))
    )  # fmt: skip
    spin, pieces = (math.ceil(steps / STEPS) for steps in (SPIN_UP * unit * MEMORIES[-1], options["t1"] / h))
    stages = jnp.zeros((STAGES, len(MEMORIES), len(theta)), theta.dtype)
    chains = [
        (Running(jet_at(jnp.asarray(x), jnp.asarray(frame), len(theta)), stages), np.zeros(spin + pieces))
        for x, frame in zip(points, framed, strict=True)
    ]
    results, done = run_chains(Piece(isinstance(case.system, Flow)), shared, chains, progress=progress)
    whole = [result for result, computed in zip(results, done, strict=True) if np.all(computed)]
    require(len(whole) > 1, "interrupted before two runs were done: there is nothing to tell the error from.")
    sums, largest = jax.tree.map(lambda *leaves: np.stack(leaves)[:, spin:], *whole)
    largest = np.moveaxis(largest, 2, 0).reshape(len(theta) + 1, -1)
    return jax.tree.map(lambda leaf: leaf.mean(axis=1) / STEPS, sums), largest, pieces * len(whole) * STEPS
