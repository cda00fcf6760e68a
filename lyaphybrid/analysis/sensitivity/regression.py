"""Derivatives of exponents by regression over an ensemble of parameters, for any motion.

The exponent λ(θ) of chaotic motion may be smooth although no trajectory's derivative converges to dλ/dθ. Runs at
points of a window of parameters give λ itself, with noise that replicates measure, and a fitted polynomial gives the
slope. Two degrees must agree, and χ² must fit the noise, which it does not where λ jumps between periodic windows.

D. J. Lea, M. R. Allen & T. W. N. Haine, Tellus A 52 (2000) 523, doi:10.3402/tellusa.v52i5.12283, on why
derivatives of trajectories cannot be used.
"""

import itertools
import math
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy  # its submodules load on first use, which takes a tenth of a second

from ..._arguments import numbers, require, whole
from ...engine.host.lanes import map_lanes
from ...results.spectrum import doubtful
from ...statuses import STATUS
from ...systems.kinds import iterates
from ..spectra import lyapunov_spectrum, starts
from .estimates import Estimate, ExponentFunction, UntrustedError, with_arrays

__all__ = ["by_regression"]

POINTS_PER_TERM, FEWEST_POINTS = 2, 24  # points for each coefficient of the higher degree, and least number of points
FURTHER = 2  # difference of the compared degrees: in a symmetric design the next degree has the same slope
TOLD_FROM_ZERO = 3.0  # a run of length T tells an exponent from zero if it is larger than this over T
LEAST_NOISE = 1e-9  # least noise, relative to 1 + |λ|: regular motion has almost none, and fits are not exact
UNLIKELY = 1e-4  # least probability of a χ² that counts as noise
DEGREES_AGREE = 3.0  # largest difference of the slopes of both degrees, in standard errors
NOTHING = 4.0  # largest slope of a zero exponent, in standard errors
MOST_FAILED = 0.05  # fraction of the runs that may fail, or be doubtful


class EnsembleResults(NamedTuple):
    """Results of the ensemble, (points, replicates, …)."""

    exponents: np.ndarray  # (points, replicates, k); nan where the run failed
    time_per_jump: np.ndarray  # (points, replicates); inf where nothing jumped
    failed: int
    doubtful: int  # of those that did not fail


class PolynomialFit(NamedTuple):
    """A polynomial fit of one exponent."""

    value: float
    slope: np.ndarray  # (p,) slopes in units of the half window
    covariance: np.ndarray  # (1 + p, 1 + p) of value and slopes
    chi2: float
    freedom: int

    @property
    def excess(self) -> float:
        """χ² per degree of freedom."""
        return self.chi2 / self.freedom


class WindowEstimate(NamedTuple):
    """Value and slopes of one mean from both fits, in units of the half window."""

    value: float
    error: float
    slope: np.ndarray  # (p,)
    errors: np.ndarray  # (p,)
    good: bool
    reasons: list[str]


def by_regression(
    case: ExponentFunction, *, key, window: Any = 0.1, points: int | None = None, replicates: int = 4, degree: int = 3,
    threads: int | None = None, progress: Any = None,
) -> Estimate:  # fmt: skip
    """Exponents and their derivatives in the middle of a window of parameters.

    Args:
        case: with the options of `lyapunov_spectrum`.
        key: for the points and for the starts of the runs.
        window: half width, relative to each parameter; or an array (p,) of absolute half widths.
        points: of the window; None: two for each coefficient of the higher degree, at least 24.
        replicates: runs at each point, from starts that differ.
        degree: of the polynomial in all parameters; it is compared with that of two degrees more.
        threads: None: one for each processor.
        progress: None, True for a bar, or a function of the fraction done.
    """
    whole("replicates", replicates, least=2, each=1)
    whole("degree", degree, least=1)
    half, terms = _half_widths(case, window), math.comb(len(case.theta) + degree + FURTHER, len(case.theta))
    points = max(FEWEST_POINTS, POINTS_PER_TERM * terms) if points is None else points
    whole("points", points, least=terms + 2)
    at = _points(key, points, len(half))
    runs = _ensemble(case, key, case.theta + half * at, replicates, threads, progress)
    floor = TOLD_FROM_ZERO / float(case.options["t1"])
    judged = [_judged(f"λ{i + 1}", runs.exponents[..., i], at, degree, floor) for i in range(case.k)]
    lost = (runs.failed + runs.doubtful) / runs.time_per_jump.size
    noted = "have the note step_too_long, unresolved or beyond_guard"
    reasons = [
        f"{count} of {runs.time_per_jump.size} runs {what}"
        for count, what in ((runs.failed, "failed"), (runs.doubtful, noted))
        if count
    ]
    cost = len(at) * replicates
    found = _estimate_of_all(judged, half, lost, reasons, cost)
    if iterates(case.system) or np.any(np.isinf(runs.time_per_jump)):
        return found
    rare = _judged("time per jump", runs.time_per_jump, at, degree)
    return found._replace(time_per_jump=_estimate_of_all([rare], half, lost, reasons, cost))


def _estimate_of_all(judged: list["WindowEstimate"], half, lost: float, reasons: list[str], cost: int) -> Estimate:
    """The estimate for all columns, in units of the parameters."""
    return Estimate(
        value=np.array([one.value for one in judged]),
        value_stderr=np.array([one.error for one in judged]),
        gradient=np.array([one.slope for one in judged]) / half,
        stderr=np.array([one.errors for one in judged]) / half,
        trust=bool(all(one.good for one in judged) and lost <= MOST_FAILED),
        reasons=(*reasons, *itertools.chain.from_iterable(one.reasons for one in judged)),
        cost=cost,
    )


def _half_widths(case: ExponentFunction, window) -> np.ndarray:
    """The half widths (p,) of the window."""
    given = numbers("window", window, float)
    require(bool(np.all(np.isfinite(given)) and np.all(given > 0)), f"window must be positive; got {window!r}.")
    if given.ndim:
        require(
            given.shape == case.theta.shape,
            f"window must be one number, or one for each parameter, shape {case.theta.shape}; got {np.shape(window)}.",
        )
        return given
    zero = [name for name, value in zip(case.names, case.theta, strict=True) if value == 0]
    names = ", ".join(zero)
    require(not zero, f"A relative window has no width where {names} = 0: give half widths, window=array (p,).")
    return given * np.abs(case.theta)


def _points(key, count: int, p: int) -> np.ndarray:
    """Points (count, p) of [−1, 1]^p with their mirror images, so that even terms of λ do not change the slope."""
    most = (count + 1) // 2
    if p == 1:
        half = np.sin(0.5 * np.pi * (np.arange(most) + 0.5) / most)[:, None]
    else:
        random = np.random.default_rng(np.asarray(jax.random.bits(key, (4,), "uint32")))
        half = 2 * (random.permuted(np.tile(np.arange(most), (p, 1)), axis=1).T + random.random((most, p))) / most - 1
    return np.concatenate([half, -half])


class EnsembleRun(eqx.Module):
    """A run of the ensemble."""

    k: int = eqx.field(static=True)
    clock: str = eqx.field(static=True)
    mode: Any = eqx.field(static=True)

    def __call__(self, shared, lane):
        system, args_of, method, times = shared
        theta, x0 = lane
        found = lyapunov_spectrum(
            system, x0, args_of(theta), k=self.k, clock=self.clock, mode=self.mode, method=method, blocks=2,
            throw=False, **times,
        )  # fmt: skip
        return found.exponents, found.time / found.jumps, found.status_code, doubtful(found)


def _ensemble(case: ExponentFunction, key, thetas: np.ndarray, replicates: int, threads, progress) -> EnsembleResults:
    options = with_arrays(case.options, case.theta.dtype)
    lane = EnsembleRun(case.k, options.pop("clock", "time"), options.pop("mode", None))
    method = options.pop("method", None)
    shape = (len(thetas), replicates)
    lanes = np.repeat(thetas, replicates, axis=0), _starts(case, key, thetas, replicates)
    shared = case.system, case.args_of, method, options
    (exponents, apart, status, doubted), done = map_lanes(lane, shared, lanes, threads=threads, progress=progress)
    # After Ctrl-C the other lanes hold zeros, which is also the code of status ok.
    good = done & (status == int(STATUS.ok)) & ~np.any(np.isnan(exponents), axis=1)
    if not np.any(good):
        raise UntrustedError(f"All runs of the ensemble failed: {STATUS(int(status[0]))}.", failed=True)
    return EnsembleResults(
        exponents=np.where(good[:, None], exponents, np.nan).reshape(*shape, case.k),
        time_per_jump=np.where(good, apart, np.nan).reshape(shape),
        failed=int(np.sum(~good)),
        doubtful=int(np.sum(good & doubted)),
    )


def _starts(case: ExponentFunction, key, thetas: np.ndarray, replicates: int) -> np.ndarray:
    """Starts (points · replicates, n)."""
    t0, found = case.options.get("t0", 0.0), []
    for args, own in zip(map(case.args_of, thetas), jax.random.split(key, len(thetas)), strict=True):
        found.append(np.asarray(starts(case.system, t0, jnp.asarray(case.start(args)), args, replicates, own)))
    return np.concatenate(found)


def _fits_of_both_degrees(
    at: np.ndarray, exponents: np.ndarray, degree: int
) -> tuple[PolynomialFit, PolynomialFit] | None:
    """Fits of both degrees to one exponent (points, replicates); None where too few points are left."""
    counts = np.sum(np.isfinite(exponents), axis=1)
    kept = counts > 0
    if np.sum(kept) <= math.comb(at.shape[1] + degree + FURTHER, at.shape[1]):
        return None
    means = np.nanmean(exponents[kept], axis=1)
    left = exponents[kept] - means[:, None]
    spare = max(1, int(np.sum(counts[kept] - 1)))
    noise = np.sqrt(np.nansum(left**2) / spare / counts[kept] + (LEAST_NOISE * (1 + np.abs(means))) ** 2)
    return _fit(at[kept], means, noise, degree), _fit(at[kept], means, noise, degree + FURTHER)


def _fit(at, means, noise, degree: int) -> PolynomialFit:
    """Least squares with all monomials up to a total degree; the first are 1 and the coordinates."""
    p = at.shape[1]
    powers = [which for d in range(degree + 1) for which in itertools.combinations_with_replacement(range(p), d)]
    matrix = np.stack([np.prod(at[:, which], axis=1) for which in map(list, powers)], axis=1) / noise[:, None]
    solution = np.linalg.lstsq(matrix, means / noise, rcond=None)[0]
    chi2 = float(np.sum((matrix @ solution - means / noise) ** 2))
    covariance = np.linalg.pinv(matrix.T @ matrix)[: p + 1, : p + 1]
    return PolynomialFit(float(solution[0]), solution[1 : p + 1], covariance, chi2, len(means) - len(powers))


def _judged(name: str, runs: np.ndarray, at: np.ndarray, degree: int, floor: float = 0.0) -> WindowEstimate:
    """The mean (of an exponent, say) in the middle of the window, from runs (points, replicates), and its slope.

    A mean below `floor` cannot be told from zero. On a cycle what a finite run leaves of a zero exponent is smooth, and
    far beyond the noise.
    """
    nothing = np.full(at.shape[1], np.nan)
    destroyed, known = int(np.sum(np.isinf(runs))), int(np.sum(~np.isnan(runs)))
    if destroyed:
        everywhere = destroyed == known
        where = "has no derivative" if everywhere else f"in {destroyed} of {known} runs, not in all of the window"
        value = -np.inf if everywhere else np.nan
        return WindowEstimate(value, np.nan, nothing, nothing, everywhere, [f"{name}: −∞ {where}"])
    both = _fits_of_both_degrees(at, runs, degree)
    if both is None:
        return WindowEstimate(
            np.nan, np.nan, nothing, nothing, False, [f"{name}: too few points are left for the degree"]
        )
    low, high = both
    errors = np.sqrt(np.diag(low.covariance) * max(1.0, low.excess))
    apart = np.abs(high.slope - low.slope)
    smooth, reason = _smooth(low)
    worst = float(np.max(apart / _of_difference(low, high)))
    reasons = [f"{name}: {reason}", f"{name}: slopes of two degrees differ by {worst:.2g} standard errors"]
    good = smooth and worst <= DEGREES_AGREE
    if abs(low.value) <= 5 * errors[0] + LEAST_NOISE + floor:
        slope = float(np.max(np.abs(low.slope) / errors[1:]))
        reasons.append(f"{name}: a zero exponent, its slope is {slope:.2g} standard errors")
        good = good and slope <= NOTHING
    return WindowEstimate(low.value, errors[0], low.slope, errors[1:], good, reasons)


def _smooth(fit: PolynomialFit) -> tuple[bool, str]:
    """Whether the exponent looks like a smooth function, and why.

    The noise is estimated from few replicates; the tail is that of χ² all the same, not of Fisher's F: F refuses fewer
    sound cases (0.2 % instead of 1.1 % with two replicates) but only half as many of the Hénon map's.
    """
    reason = f"χ² = {fit.excess:.3g} per degree of freedom"
    if scipy.special.chdtrc(fit.freedom, fit.chi2) > UNLIKELY:
        return True, reason
    return False, f"{reason}: more than noise, it is no smooth function in this window; take a smaller one"


def _of_difference(low: PolynomialFit, high: PolynomialFit):
    """Standard errors (p,) of the difference of the slopes.

    Both fits use the same data, and the lower one is efficient in its model; then the variance of the difference is the
    difference of the variances.
    """
    gained = np.diag(high.covariance)[1:] - np.diag(low.covariance)[1:]
    return np.sqrt(np.maximum(gained, 1e-300) * max(1.0, high.excess))
