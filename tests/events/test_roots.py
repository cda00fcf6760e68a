"""Guards that cross zero several times in one step of the method: each crossing is found, in order."""

import jax
import numpy as np
import pytest

import lyaphybrid as lh
import roots
from lyaphybrid.events import turns

METHODS = [lh.RungeKutta(name) for name in ("dopri8", "dopri5", "tsit5", "dop853")]
NOTHING_WRONG = {"missed": 0, "spurious": 0, "disordered": 0, "inexact": 0, "failed": 0}


def wrong(kind, way, count, method=None, seed=0) -> dict:
    """What was wrong with these guards; that there were roots at all is asserted here."""
    found = roots.run(kind, way, roots.guards_of(kind, count, seed), method)
    assert found.pop("roots") > 2 * count
    return found


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["polynomials", "sinusoids"])
@pytest.mark.parametrize("way", ["path", "time"])
def test_all_crossings_in_one_step(kind, way):
    assert wrong(kind, way, 300) == NOTHING_WRONG


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["polynomials", "sinusoids"])
@pytest.mark.parametrize("way", ["path", "time"])
def test_ten_thousand_guards(kind, way):
    assert wrong(kind, way, 10_000) == NOTHING_WRONG


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS[1:], ids=lambda method: method.tableau)
@pytest.mark.parametrize("kind", ["polynomials", "sinusoids"])
@pytest.mark.parametrize("way", ["path", "time"])
def test_other_methods(kind, way, method):
    assert wrong(kind, way, 1000, method, seed=7) == NOTHING_WRONG


# The two tests of a step against polynomials whose zeros and extrema are known.


def of_polynomials(method, degree, count, seed=0):
    """Random polynomials (count, degree + 1) on a step of length 1, and what a step knows of them."""
    draw = np.random.default_rng(seed)
    coefficients = draw.normal(size=(count, degree + 1)) * 10 ** draw.uniform(-2, 1, (count, 1))
    coefficients[:, 0] += draw.normal(size=count)
    # A third with close double roots or extrema, where it is decided late.
    close = draw.uniform(0, 1, count // 3)
    for i, place in enumerate(close):
        pair = np.polynomial.polynomial.polyfromroots([place, place + draw.uniform(0, 0.05)])
        coefficients[i] = np.polynomial.polynomial.polymul(pair, coefficients[i, : degree - 1])[: degree + 1]
    powers = np.arange(degree + 1)
    places = np.array([0.0, *method.sample_fractions, 1.0])
    with np.errstate(divide="ignore", invalid="ignore"):
        slopes = coefficients[:, 1:] @ (powers[1:, None] * places[None] ** (powers[1:, None] - 1))
    return coefficients, coefficients[:, 0], coefficients.sum(axis=1), slopes.T


def inside(coefficients) -> np.ndarray:
    """(count,) how many zeros each polynomial has strictly inside the step."""
    numbers = []
    for row in coefficients:
        found = np.polynomial.polynomial.polyroots(np.trim_zeros(row, "b"))
        real = found[np.abs(found.imag) < 1e-9].real
        numbers.append(np.sum((real > 0) & (real < 1)))
    return np.array(numbers)


@pytest.mark.parametrize("method", METHODS, ids=lambda method: method.tableau)
def test_a_clear_step_shows_all_zeros_at_its_ends(method):
    degree = len(method.sample_fractions) + 2
    coefficients, g0, g1, slopes = of_polynomials(method, degree, 3000)
    clear = np.asarray(turns.clear(method.sample_fractions, np.sign(g0), g0, list(jax.numpy.asarray(slopes)), 1.0))
    assert 0.02 < np.mean(clear) < 0.98
    zeros = inside(coefficients)
    assert np.all(zeros[clear] == (np.sign(g0) != np.sign(g1))[clear])


@pytest.mark.slow_cases("dopri8", "dopri5", "tsit5")
@pytest.mark.parametrize("method", METHODS, ids=lambda method: method.tableau)
def test_a_step_with_nothing_hidden_turns_at_most_once_near_zero(method):
    degree = len(method.sample_fractions) + 3
    coefficients, g0, g1, slopes = of_polynomials(method, degree, 3000, seed=1)
    least = np.full(len(g0), 1e-12)
    rates = list(jax.numpy.asarray(slopes))
    hidden = np.asarray(turns.hidden(method.sample_fractions, np.sign(g0), g0, g1, rates, 1.0, least))
    assert 0.02 < np.mean(hidden) < 0.98
    zeros, extrema = inside(coefficients), inside(coefficients[:, 1:] * np.arange(1, degree + 1))
    assert np.all((extrema <= 1) | (zeros == 0), where=~hidden)
