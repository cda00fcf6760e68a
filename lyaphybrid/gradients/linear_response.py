"""Derivatives of chaotic exponents by linear response: smooth motion with one unstable direction.

What a parameter does to a point is split into a part along the unstable direction, a u, and the rest, v, which stays
bounded (`jets`). The rest is followed; of the part along u, partial integration leaves a correlation:

    dE[J]/dθ = E[∂_θJ + DJ v] + Σ_k E[D(J∘Φᵏ) a u] = E[∂_θJ + DJ v] − Σ_k E[b J∘Φᵏ],    b = ∂_u a + a g,

D. Ruelle, Commun. Math. Phys. 187 (1997) 227, doi:10.1007/s002200050134, in the form of N. Chandramoorthy & Q. Wang, SIAM
J. Appl. Dyn. Syst. 21 (2022) 735, doi:10.1137/21M1405599. For exponents J = ln R_ii is a function of points and frames.
A part c F along a flow shifts time: D(J∘Φᵏ) F sums to dJ/dh far away less dJ/dh here, and so adds E[c] E[J]/h − E[c dJ/dh].

Of a flow with one unstable direction λ₂ is zero whatever the parameters are, so that dλ₁ = d(λ₁ + λ₂). That is the growth
of an area which holds the flow, and much smoother than that of a length: on Lorenz' attractor its error is a fifth.
"""

import math
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._jaxprs import needed
from ..checks import require
from ..lanes import run_chains
from ..methods import RungeKutta
from ..spectra import lyapunov_spectrum, starts
from ..statuses import STATUS
from ..systems import Flow, Map
from .continuity import REACH, breaks
from .estimates import Case, Estimate
from .jets import Jet, Motion, jet_at, onward

__all__ = ["by_linear_response"]

RUNS = 16  # independent: their scatter is the error
STEPS = 1024  # of a piece of a run
STAGES = 8  # of what forgets
MEMORIES = (8, 16, 32, 64)  # Lyapunov times
SHORTEST = 16  # steps that the first memory has at least: a shorter one ends as suddenly as a cut
SPIN_UP = 2  # times the longest memory, before anything counts
TOP = 16  # of each piece the largest are kept for the tail
TAIL = 200  # one in so many belongs to the tail
HEAVY = 2.0  # tail index below which squares have no mean
AGREE = 3.0  # standard errors: between memories, and of what is zero
SURE = 4.0  # standard errors by which an exponent is negative
RARE = 0.03  # breaks over those that one surface across the attractor would show


class Sums(NamedTuple):
    """What the steps of a piece of a run add up to."""

    growth: Array  # (k,) J
    direct: Array  # (p, k) ∂_θJ + DJ v
    dilation: Array  # (p,) c
    dilated: Array  # (p, k) c dJ/dh
    memory: Array  # (memories, p) B, the sum of the b before, each as far as it is remembered
    response: Array  # (memories, p, k) J B
    broken: Array  # how often the rule or field broke


class Running(NamedTuple):
    """What a run hands on from piece to piece."""

    jet: Jet
    stages: Array  # (STAGES, memories, p)


class Pilot(NamedTuple):
    """Plain runs: the exponents, and points all over the attractor."""

    exponents: np.ndarray
    stderr: np.ndarray
    points: np.ndarray  # (RUNS, n)
    frames: np.ndarray  # (RUNS, n, k)
    failed: str  # why the runs failed; empty: they did not


def by_linear_response(case: Case, *, key, progress: Any = None) -> Estimate:
    """Exponents and their derivatives, from sixteen runs of length t1.

    Args:
        case: with the options of `lyapunov_spectrum`.
        key: for where the runs start.
        progress: None, True for a bar, or a function of the fraction done.
    """
    flows = _checked(case)
    pilot = _pilot(case, key)
    unfit = pilot.failed or _not_one_unstable(pilot, flows)
    if unfit:
        return _refused(case, pilot, unfit)
    h = float(case.options["method"].dt) if flows else 1.0
    unit = max(SHORTEST / MEMORIES[0], 1 / (pilot.exponents[0] * h))  # steps
    k = min(pilot.points.shape[1], max(case.k, 1 + flows))
    sums, top = _run(case, pilot, h, flows, k, unit, progress)
    return _estimate(case, sums, top, h, flows, unit)


def _checked(case: Case) -> bool:
    """Whether the system is a flow; a ValueError where it is nothing that this method can do."""
    system, args, t0 = case.system, case.args_of(jnp.asarray(case.theta)), jnp.asarray(case.options["t0"], float)
    other = "method='regression' can."
    smooth = type(system) in (Flow, Map)
    require(smooth, f"linear_response cannot see how jumps or constraints move, nor follow a conserved energy: it takes "
            f"an lh.Flow or lh.Map, not an lh.{type(system).__name__}; {other}")  # fmt: skip
    require(case.options["clock"] == "time", f"linear_response counts time; got clock={case.options['clock']!r}.")
    function = system.field if isinstance(system, Flow) else system.rule
    closed = jax.make_jaxpr(lambda t, x: function(t, x, args))(t0, jnp.asarray(case.start(args)))
    require(closed.jaxpr.invars[0] not in needed(closed), "linear_response needs a system that does not depend on time: "
            f"make the phase a component of the state, φ' = ω; {other}")  # fmt: skip
    method = case.options["method"]
    fixed = isinstance(method, RungeKutta) and not method.adaptive
    require(fixed or not isinstance(system, Flow), "linear_response differentiates the step of a method, which must be "
            "fixed: integrator=lh.RungeKutta('rk4', dt=…).")  # fmt: skip
    return isinstance(system, Flow)


def _pilot(case: Case, key) -> Pilot:
    args, options = case.args_of(jnp.asarray(case.theta)), dict(case.options)
    x0 = jnp.asarray(case.start(args))
    enough = min(x0.shape[-1], max(case.k, 2 + isinstance(case.system, Flow)))
    x0 = starts(case.system, options["t0"], x0, args, RUNS, key)
    found = lyapunov_spectrum(case.system, x0, args, k=enough, blocks=2, throw=False, **options)
    exponents, points = np.asarray(found.exponents), np.asarray(found.x)
    well = found.status == STATUS.ok and bool(np.all(np.isfinite(exponents)))
    failed = "" if well else f"The runs failed: {found.status}."
    return Pilot(exponents, np.asarray(found.stderr), points, np.asarray(found.frame), failed)


def _not_one_unstable(pilot: Pilot, flows: bool) -> str:
    """Why the motion has not one unstable direction with stable ones beside it; empty where it has."""
    value, error, first = pilot.exponents, SURE * pilot.stderr, 1 + flows
    if value[0] <= error[0]:
        return f"λ1 = {value[0]:.3g} ± {pilot.stderr[0]:.1g} is not positive: the motion is not chaotic"
    if len(value) > first and value[first] >= -error[first]:
        beside = " beside the flow" if flows else ""
        return (f"λ{first + 1} = {value[first]:.3g} ± {pilot.stderr[first]:.1g} is not negative: there is more than one "
                f"unstable direction, or a neutral one{beside}")  # fmt: skip
    return ""


def _refused(case: Case, pilot: Pilot, reason: str) -> Estimate:
    nothing = np.full((case.k, len(case.theta)), np.nan)
    value, error = pilot.exponents[: case.k], pilot.stderr[: case.k]
    return Estimate(value, error, nothing, nothing, trust=False, reasons=(reason,), cost=RUNS)


class Piece(eqx.Module):
    """A piece of a run: so many steps."""

    flows: bool = eqx.field(static=True)

    def __call__(self, shared, running: Running, lane):
        del lane
        system, args_of, method, t, motion, retained, size = shared
        if self.flows:

            def function(theta, x):
                return system.field(t, x, args_of(theta))

            def rule(theta, h, x):
                def field(t, x):
                    return system.field(t, x, args_of(theta))

                return method.step(field, t, x, field(t, x), h).x
        else:

            def function(theta, x):
                return system.rule(t, x, args_of(theta))

            def rule(theta, h, x):
                del h
                return function(theta, x)

        motion = Motion(rule, *motion, self.flows)

        def step(carry, _):
            running, sums = carry
            z = running.jet.z
            broken = breaks(lambda x: function(motion.theta, x), z.x, z.frame[:, 0], size, charts=not self.flows)
            jet, seen = onward(motion, running.jet)
            before = jnp.sum(running.stages, axis=0)
            new = Sums(
                growth=seen.growth,
                direct=seen.direct,
                dilation=seen.dilation,
                dilated=jnp.multiply.outer(seen.dilation, seen.rate),
                memory=before,
                response=jnp.multiply.outer(before, seen.growth),
                broken=broken.astype(before.dtype),
            )
            running = Running(jet, remembered(running.stages, seen.b, retained))
            return (running, jax.tree.map(jnp.add, sums, new)), jnp.append(seen.b, jet.g)

        k, p = running.jet.z.frame.shape[1], motion.theta.shape[0]
        levels = retained.shape[0]
        shapes = (k,), (p, k), (p,), (p, k), (levels, p), (levels, p, k), ()
        nothing = Sums(*(jnp.zeros(shape, retained.dtype) for shape in shapes))
        (running, sums), tails = jax.lax.scan(step, (running, nothing), None, length=STEPS)
        return running, (sums, jax.lax.top_k(jnp.abs(tails).T, TOP)[0])


def remembered(stages, b, retained):
    """The stages (STAGES, memories, p) of what is remembered, after a b (p,) has come in.

    Each b stays in a stage for a random time, and after the last it is forgotten: of one that came k steps ago, their sum
    holds the probability that as many geometric times take longer than k. That is a smooth taper, flat where it
    begins; a sudden end of the sum over lags is badly wrong, with small error bars.
    """
    retained = jnp.broadcast_to(retained[None, :, None], stages.shape)
    entering = jnp.concatenate([jnp.broadcast_to(b[None, None, :], stages[:1].shape), ((1 - retained) * stages)[:-1]])
    return retained * stages + entering


def _run(case: Case, pilot: Pilot, h: float, flows: bool, k: int, unit: float, progress):
    """Sums (runs, …), means over steps; and the largest of |b| and |g| (p + 1, runs · pieces · TOP)."""
    theta, options = jnp.asarray(case.theta), case.options
    size = np.linalg.norm(np.std(pilot.points, axis=0))
    retained = 1 - STAGES / (unit * np.array(MEMORIES, float))
    shared = (case.system, case.args_of, options["method"], jnp.asarray(options["t0"], theta.dtype),
              (theta, jnp.asarray(h)), jnp.asarray(retained), jnp.asarray(size))  # fmt: skip
    spin = math.ceil(SPIN_UP * unit * MEMORIES[-1] / STEPS)
    pieces = math.ceil(options["t1"] / h / STEPS)
    stages = jnp.zeros((STAGES, len(retained), len(theta)))
    chains = [
        (Running(jet_at(jnp.asarray(x), jnp.asarray(frame[:, :k]), len(theta)), stages), np.zeros(spin + pieces))
        for x, frame in zip(pilot.points, pilot.frames, strict=True)
    ]
    results, done = run_chains(Piece(flows), shared, chains, progress=progress)
    whole = [result for result, computed in zip(results, done, strict=True) if np.all(computed)]
    require(len(whole) > 1, "interrupted before two runs were done: there is nothing to tell the error from.")
    sums, top = jax.tree.map(lambda *leaves: np.stack(leaves)[:, spin:], *whole)
    top = np.moveaxis(top, 2, 0)
    return jax.tree.map(lambda leaf: leaf.mean(axis=1) / STEPS, sums), (top.reshape(len(top), -1), pieces * len(whole))


def _estimate(case: Case, sums: Sums, tails, h: float, flows: bool, unit: float) -> Estimate:
    count = len(sums.growth)

    def error(values):
        return np.std(values, axis=0, ddof=1) / math.sqrt(count)

    rates, zero = sums.growth / h, None
    slopes = _slopes(sums, h, flows)  # (runs, memories, p, k)
    if flows:
        zero, slopes[..., 0] = slopes[..., 1].copy(), slopes[..., 0] + slopes[..., 1]
        slopes[..., 1] = 0
    level, plateau, flat = _plateau(slopes, error, unit * h)
    chosen = slopes[:, level]
    good, reasons = [flat], [plateau]
    top, pieces = tails
    for verdict, reason in (_tail(case, top, pieces), _unbroken(sums, pieces), _zero(zero, level, error)):
        good.append(verdict)
        reasons.append(reason)
    gradient, stderr = np.mean(chosen, axis=0).T[: case.k], error(chosen).T[: case.k]
    good.append(bool(np.all(np.isfinite(gradient))))
    return Estimate(
        value=np.mean(rates, axis=0)[: case.k],
        value_stderr=error(rates)[: case.k],
        gradient=gradient,
        stderr=stderr,
        trust=all(good),
        reasons=tuple(reason for reason in reasons if reason),
        cost=2 * RUNS,
    )


def _slopes(sums: Sums, h: float, flows: bool) -> np.ndarray:
    """dλ/dθ (runs, memories, p, k) of each run."""
    mean = np.mean(sums.growth, axis=0)
    correlation = sums.response - sums.memory[..., None] * mean
    shifted = sums.dilation[..., None] * mean / h - sums.dilated if flows else 0.0
    return ((sums.direct + shifted)[:, None] - correlation) / h


def _plateau(slopes, error, unit: float) -> tuple[int, str, bool]:
    """Which memory is long enough, why, and whether there is one.

    It is twice the first that agrees with all longer ones: what is left of the correlations is then below its error.
    """
    last = slopes.shape[1] - 1

    def apart(i: int, j: int) -> float:
        change = slopes[:, i] - slopes[:, j]
        return float(np.max(np.abs(np.mean(change, axis=0)) / (error(change) + 1e-12)))

    worst = [max(apart(i, j) for j in range(i + 1, last + 1)) for i in range(last)]
    first = next((i for i, most in enumerate(worst) if most <= AGREE), None)
    if first is None:
        return last, f"no lag plateau: memories of {unit * MEMORIES[-2]:.3g} and twice that do not agree", False
    reason = (
        f"lag plateau: memories of {unit * MEMORIES[first]:.3g} and more differ by {worst[first]:.2g} standard errors"
    )
    return first + 1, reason, True


def _tail(case: Case, top, pieces: int) -> tuple[bool, str]:
    """Whether the squares of b and of the density gradient have means, by Hill's estimator of their tails.

    B. M. Hill, Ann. Statist. 3 (1975) 1163, doi:10.1214/aos/1176343247.
    """
    count = max(20, pieces * STEPS // TAIL)
    tails = -np.sort(-top, axis=1)[:, : count + 1]
    tails = np.maximum(tails, 1e-300)
    indices = 1 / np.maximum(np.mean(np.log(tails[:, :-1] / tails[:, -1:]), axis=1), 1e-12)
    density, worst = indices[-1], float(np.min(indices))
    if worst > HEAVY:
        return (
            True,
            f"Hill index {density:.2g} of the density gradient's tail; the least of what is averaged {worst:.2g}",
        )
    of = "the density gradient" if density <= HEAVY else f"b of {case.names[int(np.argmin(indices[:-1]))]}"
    return False, f"Hill index {worst:.2g} of {of}: its square has no mean, and error bars mean nothing"


def _unbroken(sums: Sums, pieces: int) -> tuple[bool, str]:
    """Whether the function broke no more often than by chance."""
    pairs = pieces * STEPS
    share = float(np.mean(sums.broken))
    if share <= RARE * REACH:
        return True, f"no break between {pairs:.2g} pairs of points {REACH:g} of the attractor apart"
    return False, (f"the function or its derivative jumps between {share:.1g} of all pairs of points {REACH:g} of the "
                   "attractor apart: linear response does not see how a discontinuity moves; use regression")  # fmt: skip


def _zero(slopes, level: int, error) -> tuple[bool, str]:
    """Whether the exponent along a flow has no derivative."""
    if slopes is None:
        return True, ""
    slope, spread = np.mean(slopes[:, level], axis=0), error(slopes[:, level])
    worst = float(np.max(np.abs(slope) / (spread + 1e-12)))
    return worst <= AGREE, f"the zero exponent along the flow has a slope of {worst:.2g} standard errors"
