"""Whether a guard may turn more than once inside a step, so that its ends do not show all its zeros.

Known are the rates of a guard at both ends of a step and at some points inside, from the stages of the method, and its
change over the step. First bounds are tried, for every step: a step is `clear` if the polynomial rate through these
points keeps its sign, or the guard stays away from zero. For the others a polynomial of lower degree is fitted, in the
basis of Bernstein: a polynomial has at most as many zeros in the step as its coefficients change their sign. A guard is
`hidden` if the fit misses the data, or if the slope may have two zeros; then the step must be cut. So no crossing is
missed, however many there are in a step, if the guard along the step is a polynomial of degree at most two more than
the number of points inside, and more surely so the better such a polynomial follows it.

Slopes are per step here: derivatives with respect to the fraction theta of the step.

Source: G. Farin, Curves and Surfaces for CAGD (2002), doi:10.1016/B978-1-55860-737-8.X5000-5 (variation diminishing).
"""

import functools
import math
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

__all__ = ["clear", "hidden"]

UNKNOWN = 4.0  # the error of a fit per misfit, where the points do not tell it
GRID = np.linspace(0, 1, 1001)
MISFIT = 0.04  # a fit follows the guard if its error is at most this part of the largest slope


class Bounds(NamedTuple):
    """For a polynomial slope, per largest difference of its given values from that at the start of the step."""

    slope: float  # the largest difference within the step
    value: float  # the largest distance of the guard from its tangent at the start


class Fit(NamedTuple):
    """A polynomial for the slope, fitted to its values at points of a step and to its mean."""

    mean: np.ndarray  # (slopes,) weights of the mean slope where the change of the guard is not known
    coefficients: np.ndarray  # (degree + 1, data) Bernstein coefficients of the fit
    misfits: np.ndarray  # (data, data) what the fit misses
    slope: float  # the largest error of the slope, per largest of these misfits …
    value: float  # … and of the guard


@functools.lru_cache
def bounds(fractions: tuple[float, ...]) -> Bounds:
    """Those of the polynomial through the slopes at both ends and at these fractions inside a step."""
    points = np.array([0.0, *fractions, 1.0])
    degree = len(points) - 1
    each = (_bernstein(degree, GRID) @ np.linalg.inv(_bernstein(degree, points)))[:, 1:]
    return Bounds(*(float(np.max(np.sum(np.abs(one), axis=1))) for one in (each, _integrals(each))))


@functools.lru_cache
def fit(fractions: tuple[float, ...]) -> Fit:
    """The fit to slopes at both ends and at these fractions inside a step, of a degree that leaves up to two checks."""
    points, checks = np.array([0.0, *fractions, 1.0]), min((len(fractions) + 1) // 2, 2)
    degree = len(points) - checks
    system = _rows(degree, points)
    solution = np.linalg.pinv(system)
    mean = np.mean(np.linalg.pinv(system[:-1]), axis=0)
    misfits = system @ solution - np.eye(len(system))
    return Fit(mean, solution, misfits, *_errors(degree, points, misfits))


def _errors(degree: int, points: np.ndarray, misfits: np.ndarray) -> tuple[float, float]:
    """The largest errors of the slope and of its integral, per misfit, over polynomials that the data determine."""
    most = len(points)
    while np.linalg.matrix_rank(_rows(most, points), 1e-10) <= most:
        most -= 1
    if most == degree:  # the checks see only what the data do not determine
        return UNKNOWN, UNKNOWN
    system = _rows(most, points)
    error = _bernstein(most, GRID) - _bernstein(degree, GRID) @ np.linalg.pinv(_rows(degree, points)) @ system
    seen = misfits @ system
    # Higher terms are the polynomials that the fit misses: one or two directions, and all their mixtures.
    _, sizes, directions = np.linalg.svd(seen)
    higher = directions[: np.sum(sizes > 1e-9 * sizes[0])]
    angles = np.linspace(0, np.pi, 721)
    mixtures = np.stack([np.cos(angles), np.sin(angles)])[: len(higher)].T @ higher
    misfit = np.max(np.abs(mixtures @ seen.T), axis=1)
    slopes = error @ mixtures.T
    of_slope, of_value = (np.max(np.abs(one), axis=0) / misfit for one in (slopes, _integrals(slopes)))
    return float(np.max(of_slope)), float(np.max(of_value))


def _integrals(slopes: np.ndarray) -> np.ndarray:
    """The integrals of functions given on the grid (its first axis), from 0 on."""
    return np.cumsum((slopes[1:] + slopes[:-1]) / 2, axis=0) / (len(GRID) - 1)


def _rows(degree: int, points: np.ndarray) -> np.ndarray:
    """(data, degree + 1) the slopes at the points and the mean slope, from the Bernstein coefficients of the slope."""
    return np.vstack([_bernstein(degree, points), np.full(degree + 1, 1 / (degree + 1))])


def _bernstein(degree: int, theta: np.ndarray) -> np.ndarray:
    """(points, degree + 1) the Bernstein polynomials."""
    i, theta = np.arange(degree + 1), theta[:, None]
    return np.array([math.comb(degree, k) for k in i]) * theta**i * (1 - theta) ** (degree - i)


def clear(fractions: tuple[float, ...], side, g0, rates, h):
    """(slots,) whether the ends show all zeros: the guard is far from zero all along, or it is monotonic.

    Args:
        fractions: where in the step the slopes inside are known.
        side: (slots,) the sign of each guard.
        g0: (slots,) the guards at the start.
        rates: the time derivatives (slots,) at the start, at the fractions, and at the end.
        h: the length of the step.
    """
    by, (first, *later) = bounds(fractions), rates
    bend = functools.reduce(jnp.maximum, [jnp.abs(rate - first) for rate in later])
    room = side * g0 + h * jnp.minimum(side * first, 0.0)  # the smaller distance from zero of the tangent's ends
    return (room >= (by.value * h) * bend) | (jnp.abs(first) > by.slope * bend)


def hidden(fractions: tuple[float, ...], side, g0, g1, rates, h, least):
    """(slots,) whether a guard may have zeros that its ends do not show.

    Args:
        fractions: where in the step the slopes inside are known.
        side: (slots,) the sign of each guard.
        g0: (slots,) the guards at the start.
        g1: (slots,) the guards at the end.
        rates: the time derivatives (slots,) at the start, at the fractions, and at the end.
        h: the length of the step.
        least: (slots,) slopes up to this are rounding.
    """
    by, kind, slopes = fit(fractions), g0.dtype, [h * rate for rate in rates]
    # A guard that starts at zero does so up to the error of its root: then only the slopes tell its change.
    told = sum(float(weight) * slope for weight, slope in zip(by.mean, slopes, strict=True))
    data = jnp.stack([*slopes, jnp.where(g0 == 0, told, g1 - g0)])
    coefficients = jnp.asarray(by.coefficients, kind) @ data
    misfit = jnp.max(jnp.abs(jnp.asarray(by.misfits, kind) @ data), axis=0)
    slope_error, value_error = by.slope * misfit, by.value * misfit
    values = g0[None] + jnp.cumsum(coefficients, axis=0) / len(coefficients)  # Bernstein coefficients of the guard
    away = (side * g0 > value_error) & jnp.all(side[None] * values > value_error[None], axis=0)
    follows = slope_error <= MISFIT * jnp.max(jnp.abs(data), axis=0) + least
    return ~(follows & (away | (most_sign_changes(coefficients, slope_error, least) <= 1)))


def most_sign_changes(coefficients, error, least):
    """(slots,) how often the signs of the coefficients (many, slots) may change, if each is known up to `error`.

    Those up to `least` do not count.
    """
    positive = negative = jnp.full_like(least, -1.0)  # most changes so far, if the last sign is + or -; at first none
    for one in coefficients:
        up = jnp.where(one >= -error, jnp.maximum(positive, negative + 1), -jnp.inf)
        down = jnp.where(one <= error, jnp.maximum(negative, positive + 1), -jnp.inf)
        counts = jnp.abs(one) > least
        positive, negative = jnp.where(counts, up, positive), jnp.where(counts, down, negative)
    return jnp.maximum(positive, negative)
