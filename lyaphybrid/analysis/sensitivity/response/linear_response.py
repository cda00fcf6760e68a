"""Derivatives of chaotic exponents by linear response: smooth motion with one unstable direction.

The effect of a parameter on a point is split into a part along the unstable direction, a u, and the rest, v, which
stays bounded (`jets`). v is propagated; partial integration turns the part along u into a correlation:

    dE[J]/dθ = E[∂_θJ + DJ v] + Σ_k E[D(J∘Φᵏ) a u] = E[∂_θJ + DJ v] − Σ_k E[b J∘Φᵏ],    b = ∂_u a + a g,

D. Ruelle, Commun. Math. Phys. 187 (1997) 227, doi:10.1007/s002200050134, in the form of N. Chandramoorthy & Q. Wang,
SIAM J. Appl. Dyn. Syst. 21 (2022) 735, doi:10.1137/21M1405599. For exponents J = ln R_ii, a function of points and
frames. A part c F along a flow shifts time: the sum of the D(J∘Φᵏ) F telescopes, so that c adds E[c] E[J]/h −
E[c dJ/dh].

In a flow with one unstable direction λ₂ = 0 for all parameters, so that dλ₁ = d(λ₁ + λ₂). That is the growth of an area
that contains the flow direction; it fluctuates less than that of a length: on the Lorenz attractor its error is a
fifth.
"""

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ...._arguments import require
from ...._jax.jaxprs import needed
from ....integrators import RungeKutta
from ....statuses import STATUS
from ....systems.smooth import Flow, Map
from ...spectra import lyapunov_spectrum, starts
from ..estimates import Estimate, ExponentFunction
from .continuity import PAIR_DISTANCE
from .responses import MEMORIES, TOP, ResponseSums, responses

__all__ = ["by_linear_response"]

RUNS = 32  # independent runs; their scatter gives the error
SHORTEST_MEMORY = 16  # least length of the first memory in steps; a shorter taper would be as abrupt as a cut
TAIL = 200  # the tail is the largest 1/TAIL of the values
HEAVY = 2.0  # tail index up to which the square has no mean
NO_TAIL = 100.0  # tail index that stands for no tail
MEMORIES_AGREE = 3.0  # largest deviation between memories, and from zero, in standard errors
SIGN_ERRORS = 4.0  # standard errors by which an exponent must be negative or positive
LEAST_GROWTH = 20.0  # least λ₁t₁ of chaos: tangents of regular motion grow as a power of time, without scatter
RARE = 0.03  # largest share of detected breaks, relative to that of one surface across the attractor
NEGLIGIBLE = 0.1  # fraction of an error that is negligible
LEAST_STDERR = 1e-12  # least standard error


class Pilot(NamedTuple):
    """Runs without jets: the exponents, and points on the attractor."""

    exponents: np.ndarray
    stderr: np.ndarray
    points: np.ndarray  # (RUNS, n)
    frames: np.ndarray  # (RUNS, n, k)


def by_linear_response(case: ExponentFunction, *, key, progress: Any = None) -> Estimate:
    """Exponents and their derivatives, from 32 runs of length t1.

    Args:
        case: with the options of `lyapunov_spectrum`.
        key: for the starts of the runs.
        progress: None, True for a bar, or a function of the fraction done.
    """
    _check(case)
    pilot, unfit = _pilot(case, key)
    flows = isinstance(case.system, Flow)
    unfit = unfit or _not_one_unstable(pilot, flows, float(case.options["t1"]))
    if unfit:
        nothing = np.full((case.k, len(case.theta)), np.nan)
        value, error = pilot.exponents[: case.k], pilot.stderr[: case.k]
        return Estimate(value, error, nothing, nothing, trust=False, reasons=(unfit,), cost=RUNS)
    h = float(case.options["method"].dt) if flows else 1.0
    unit = max(SHORTEST_MEMORY / MEMORIES[0], 1 / (pilot.exponents[0] * h))  # steps
    k = min(pilot.points.shape[1], max(case.k, 1 + flows))
    sums, largest, steps = responses(case, pilot.points, pilot.frames[..., :k], h=h, unit=unit, progress=progress)
    followed, correlated = _slopes(sums, h, flows)
    slopes = followed[:, None] + correlated  # (runs, memories, p, k)
    of_zero, slopes = _with_zero(slopes) if flows else (None, slopes)
    level, *plateau = _plateau(slopes, unit * h)
    verdicts = [
        plateau,
        _tail(case, largest, steps, _matters(correlated[:, level], slopes[:, level])),
        _unbroken(sums, steps),
        _zero(of_zero, level),
    ]
    gradient, stderr = np.mean(slopes[:, level], axis=0).T[: case.k], _error(slopes[:, level]).T[: case.k]
    return Estimate(
        value=np.mean(sums.growth, axis=0)[: case.k] / h,
        value_stderr=_error(sums.growth)[: case.k] / h,
        gradient=gradient,
        stderr=stderr,
        trust=all(good for good, _ in verdicts) and bool(np.all(np.isfinite(gradient))),
        reasons=tuple(reason for _, reason in verdicts if reason),
        cost=2 * RUNS,
    )


def _check(case: ExponentFunction) -> None:
    """Raise a ValueError for a system that this method cannot treat."""
    system, args, t0 = case.system, case.args_of(jnp.asarray(case.theta)), jnp.asarray(case.options["t0"], float)
    require(
        type(system) in (Flow, Map),
        "linear_response cannot see how jumps or constraints move, nor keep to a conserved energy: it takes an lh.Flow "
        f"or lh.Map, not an lh.{type(system).__name__}. algorithm='regression' can.",
    )
    require(case.options["clock"] == "time", f"linear_response counts time; got clock={case.options['clock']!r}.")
    function = system.field if isinstance(system, Flow) else system.rule
    closed = jax.make_jaxpr(lambda t, x: function(t, x, args))(t0, jnp.asarray(case.start(args)))
    require(
        closed.jaxpr.invars[0] not in needed(closed),
        "linear_response needs a system that does not depend on time: make the phase a component of the state, φ' = ω, "
        "or take algorithm='regression'.",
    )
    method = case.options["method"]
    require(
        isinstance(system, Map) or (isinstance(method, RungeKutta) and not method.adaptive),
        "linear_response differentiates the step of a method, which must be fixed: method=lh.RungeKutta('rk4', dt=…).",
    )


def _pilot(case: ExponentFunction, key) -> tuple[Pilot, str]:
    """Runs without jets, and the reason why they cannot be used; empty if they can."""
    args, options = case.args_of(jnp.asarray(case.theta)), case.options
    x0 = jnp.asarray(case.start(args))
    k = min(x0.shape[-1], max(case.k, 2 + isinstance(case.system, Flow)))
    x0 = starts(case.system, options["t0"], x0, args, RUNS, key)
    found = lyapunov_spectrum(case.system, x0, args, k=k, blocks=2, throw=False, **options)
    pilot = Pilot(*map(np.asarray, (found.exponents, found.stderr, found.x, found.frame)))
    if found.status != STATUS.ok:
        return pilot, f"the runs failed: {found.status}"
    return pilot, "" if np.all(np.isfinite(pilot.exponents)) else "an exponent that is −∞ has no derivative"


def _not_one_unstable(pilot: Pilot, flows: bool, t1: float) -> str:
    """Why the motion does not have exactly one unstable direction; empty if it has."""
    value, error, second = pilot.exponents, pilot.stderr, 1 + flows
    if value[0] <= SIGN_ERRORS * error[0]:
        return f"λ1 = {value[0]:.3g} ± {error[0]:.1g} is not positive: the motion is not chaotic"
    if value[0] * t1 <= LEAST_GROWTH:
        return (
            f"λ1 t1 = {value[0] * t1:.3g}: tangents grow no more than those of regular motion do; if the motion is "
            f"chaotic, t1 of {1.5 * LEAST_GROWTH / value[0]:.3g} would show it"
        )
    if len(value) <= second or value[second] < -SIGN_ERRORS * error[second]:
        return ""
    beside = " beside the flow" if flows else ""
    return (
        f"λ{second + 1} = {value[second]:.3g} ± {error[second]:.1g} is not negative: there is more than one unstable "
        f"direction, or a neutral one{beside}"
    )


def _slopes(sums: ResponseSums, h: float, flows: bool) -> tuple[np.ndarray, np.ndarray]:
    """dλ/dθ of each run: the part from v (runs, p, k), and the correlations (runs, memories, p, k)."""
    mean = np.mean(np.asarray(sums.growth), axis=0)
    correlation = sums.response - sums.memory[..., None] * mean
    if not flows:
        return np.asarray(sums.direct), -correlation
    # E[c] E[J], linearised in the deviations of each run: its scatter gives the error of the product of means.
    apart = sums.growth[:, None] - mean
    product = sums.dilation[..., None] * mean + np.mean(sums.dilation, axis=0)[:, None] * apart
    return np.asarray(sums.direct + product / h - sums.dilated) / h, -correlation / h


def _with_zero(slopes) -> tuple[np.ndarray, np.ndarray]:
    """The slopes of the zero exponent, and all slopes corrected by dλ₂ = 0, dλ₁ = d(λ₁ + λ₂)."""
    of_zero, area = slopes[..., 1], slopes[..., 0] + slopes[..., 1]
    return of_zero, np.concatenate([np.stack([area, 0 * area], axis=-1), slopes[..., 2:]], axis=-1)


def _error(values) -> np.ndarray:
    """Standard errors of means over runs."""
    return np.std(values, axis=0, ddof=1) / math.sqrt(len(values))


def _worst(values) -> float:
    """The largest deviation from zero, in standard errors."""
    return float(np.max(np.abs(np.mean(values, axis=0)) / (_error(values) + LEAST_STDERR)))


def _plateau(slopes, unit: float) -> tuple[int, bool, str]:
    """The index of a memory that is long enough, whether there is one, and the reason.

    It is twice the first memory that agrees with all longer ones; the neglected correlations are then below the error.
    """
    last = slopes.shape[1] - 1
    apart = [max(_worst(slopes[:, i] - slopes[:, j]) for j in range(i + 1, last + 1)) for i in range(last)]
    first = next((i for i, most in enumerate(apart) if most <= MEMORIES_AGREE), None)
    if first is None:
        return last, False, f"no lag plateau: memories of {unit * MEMORIES[-2]:.3g} and twice that do not agree"
    agree = f"memories of {unit * MEMORIES[first]:.3g} and more differ by {apart[first]:.2g} standard errors"
    return first + 1, True, f"lag plateau: {agree}"


def _matters(part, whole) -> np.ndarray:
    """Mask (p,) of parameters for which the error of a part of the slopes is not negligible."""
    return np.max(_error(part), axis=-1) > NEGLIGIBLE * np.max(_error(whole) + LEAST_STDERR, axis=-1)


def _tail(case: ExponentFunction, largest: np.ndarray, steps: int, matters: np.ndarray) -> tuple[bool, str]:
    """Whether the squares of the density gradient, and of b where it is not negligible, have means (Hill's estimator).

    B. M. Hill, Ann. Statist. 3 (1975) 1163, doi:10.1214/aos/1176343247.
    """
    tails = -np.sort(-largest, axis=1)[:, : max(TOP, steps // TAIL) + 1]
    excess = np.mean(np.log(np.maximum(tails[:, :-1], LEAST_STDERR) / np.maximum(tails[:, -1:], LEAST_STDERR)), axis=1)
    indices = np.where(np.append(matters, True), 1 / np.maximum(excess, 1 / NO_TAIL), NO_TAIL)
    names = (*(f"b of {name}" for name in case.names), "the density gradient")
    least = len(names) - 1 if indices[-1] <= HEAVY else int(np.argmin(indices))
    reason = f"Hill index {indices[-1]:.2g} of the tail of the density gradient, {np.min(indices[:-1]):.2g} of b"
    if indices[least] > HEAVY:
        return True, reason
    return False, f"{reason}: the square of {names[least]} has no mean, and error bars mean nothing"


def _unbroken(sums: ResponseSums, steps: int) -> tuple[bool, str]:
    """Whether discontinuities of the rule or the field were rare enough to be neglected."""
    share = float(np.mean(sums.broken))
    if share <= RARE * PAIR_DISTANCE:
        return True, f"no break between {steps:.2g} pairs of points {PAIR_DISTANCE:g} of the attractor apart"
    return False, (
        f"values or derivatives jump between {share:.1g} of all pairs of points {PAIR_DISTANCE:g} of the attractor "
        "apart: linear response does not see how a discontinuity moves; use regression"
    )


def _zero(slopes, level: int) -> tuple[bool, str]:
    """Whether the derivative of the exponent along a flow is zero within its error."""
    if slopes is None:
        return True, ""
    worst = _worst(slopes[:, level])
    return worst <= MEMORIES_AGREE, f"the zero exponent along the flow has a slope of {worst:.2g} standard errors"
