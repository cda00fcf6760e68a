"""The bounds of `events/turns.py` against other ways to the same numbers, and its decisions on either side of each."""

import itertools
import math

import jax.numpy as jnp
import numpy as np
import pytest
from numpy.polynomial import Polynomial
from numpy.testing import assert_allclose, assert_array_equal

import lyaphybrid as lh
from lyaphybrid.events import turns

INSIDE = {name: lh.RungeKutta(name).sample_fractions for name in ("dopri8", "dopri5", "tsit5", "dop853")}
UNKNOWN, MISFIT = 4.0, 0.04  # as they are chosen
GIVEN = {"middle": (0.5,), "quarter": (0.25,), "two": (0.25, 0.5), **INSIDE}
FINE = np.linspace(0, 1, 20001)
all_fractions = pytest.mark.parametrize("fractions", GIVEN.values(), ids=GIVEN)


def lagrange(points) -> list[Polynomial]:
    """The polynomials that are 1 at one of the points and 0 at the others."""
    found = []
    for i, point in enumerate(points):
        product = Polynomial.fromroots(np.delete(points, i))
        found.append(product / product(point))
    return found


@all_fractions
def test_bounds_are_those_of_lagrange(fractions):
    each = lagrange(np.array([0.0, *fractions, 1.0]))[1:]
    slope = sum(abs(one(FINE)) for one in each)
    value = sum(abs(one.integ()(FINE)) for one in each)
    found = turns.bounds(fractions)
    assert_allclose(found.slope, slope.max(), rtol=1e-5)
    assert_allclose(found.value, value.max(), rtol=1e-5)


def test_bounds_of_parabolas():
    """Through slopes at 0, 1/2 and 1: 9/8 at 3/4, and 5/6 at 1."""
    assert_allclose(turns.bounds((0.5,)), (9 / 8, 5 / 6), rtol=1e-6)


def data_of(points, polynomial) -> np.ndarray:
    """Slopes at the points and the change over the step, of a slope."""
    return np.array([*polynomial(points), polynomial.integ()(1.0)])


@all_fractions
def test_fits_are_least_squares(fractions):
    """By polynomials in powers of theta; up to two checks are left."""
    points = np.array([0.0, *fractions, 1.0])
    degree = {1: 2, 2: 3}.get(len(fractions), len(points) - 2)
    system = np.stack([data_of(points, Polynomial.basis(i)) for i in range(degree + 1)], axis=1)
    found = turns.fit(fractions)
    assert found.coefficients.shape == (degree + 1, len(points) + 1)
    for i in range(len(points) + 1):
        unit = np.eye(len(points) + 1)[i]
        best = np.linalg.lstsq(system, unit, rcond=None)[0]
        assert_allclose(found.misfits[:, i], system @ best - unit, atol=1e-9)
        assert_allclose(bernstein(found.coefficients[:, i])(FINE[::100]), Polynomial(best)(FINE[::100]), atol=1e-8)
    best = np.linalg.lstsq(system[:-1], np.eye(len(points)), rcond=None)[0]
    assert_allclose(found.mean, [Polynomial(column).integ()(1.0) for column in best.T], atol=1e-9)


def bernstein(coefficients) -> Polynomial:
    degree, theta = len(coefficients) - 1, Polynomial([0.0, 1.0])
    terms = [math.comb(degree, k) * theta**k * (1 - theta) ** (degree - k) for k in range(degree + 1)]
    return sum((c * term for c, term in zip(coefficients, terms, strict=True)), Polynomial([0.0]))


@all_fractions
def test_errors_of_fits(fractions):
    """The worst of many mixtures of the terms that the data show and the fit has not."""
    points, by = np.array([0.0, *fractions, 1.0]), turns.fit(fractions)
    degree = len(by.coefficients) - 1
    fitted = np.stack([data_of(points, Polynomial.basis(i)) for i in range(degree + 1)], axis=1)
    rests, misses = [], []  # of the terms after the last of the fit: what it leaves of them, and the data of that
    for i in range(degree + 1, len(points) + 1):
        term = Polynomial.basis(i)
        rest = term - Polynomial(np.linalg.lstsq(fitted, data_of(points, term), rcond=None)[0])
        rests.append(rest)
        misses.append(data_of(points, rest))
    if fractions == (0.5,):  # a cubic that is 0 at 0, 1/2 and 1 has the mean 0: the data do not show it
        assert_allclose(misses, 0, atol=1e-12)
        assert (by.slope, by.value) == (UNKNOWN, UNKNOWN)
        return
    if len(rests) == 2:  # made orthogonal and equally large, so that the mixtures are spread evenly
        share = misses[0] @ misses[1] / (misses[0] @ misses[0])
        rests[1], misses[1] = rests[1] - share * rests[0], misses[1] - share * misses[0]
    sizes = np.linalg.norm(misses, axis=1)[:, None]
    angles = np.linspace(0, np.pi, 3000)
    mixtures = np.stack([np.cos(angles), np.sin(angles)], axis=1)[:, : len(rests)] / sizes.T
    misfit = np.max(np.abs(mixtures @ np.stack(misses)), axis=1)
    for found, values in (by.slope, rests), (by.value, [rest.integ() for rest in rests]):
        errors = np.max(np.abs(mixtures @ np.stack([value(FINE[::40]) for value in values])), axis=1)
        assert_allclose(found, np.max(errors / misfit), rtol=5e-3)


# --- decisions -------------------------------------------------------------------------------------------------------

MIDDLE, H = (0.5,), 0.25  # by.slope = 9/8, by.value = 5/6
# Simpson's rule, 6 times the change less 1, 4 and 1 times the slopes, has the squared norm 54: of an error of 1 in the
# change the fit misses (-6, -24, -6, 36)/54.
WORST = 36 / 54


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(
    ("g0", "rates", "wanted"),
    [
        (0.0, (8.0, 8.0, 8.0), True),  # monotonic
        (0.0, (9.0, 9.0, 1.01), True),  # 9 and a little more than 9/8 · 8 …
        (0.0, (9.0, 0.99, 9.0), False),  # … or less
        (0.0, (9.0, 9.0, 17.01), False),
        (0.0, (-9.0, -9.0, -1.01), True),
        (0.0, (0.0, 0.0, 0.0), True),  # it does not move
        (-1e-9, (0.0, 0.0, 0.0), False),  # on the other side
        (1.67, (0.0, 8.0, -8.0), True),  # away from zero by 5/6 · 8 · 1/4 = 1.6667
        (1.66, (0.0, 8.0, -8.0), False),
        (1.67, (8.0, 16.0, 0.0), True),  # what rises at first does not come nearer …
        (3.67, (-8.0, 0.0, -16.0), True),  # … what falls does, by 8 · 1/4
        (3.66, (-8.0, 0.0, -16.0), False),
    ],
)  # fmt: skip
def test_clear_up_to_a_bound(side, g0, rates, wanted):
    """Monotonic: if the rate at the start is more than 9/8 of the largest difference from it."""
    found = turns.clear(MIDDLE, side, side * jnp.array([g0]), [side * jnp.array([rate]) for rate in rates], H)
    assert found.item() == wanted


def step_of(coefficients, g0=0.0):
    """g0, g1, rates for a step of length H of a guard whose slope has these Bernstein coefficients, and MIDDLE."""
    slope = bernstein(np.array(coefficients, float))
    rates = [jnp.array([slope(theta) / H]) for theta in (0.0, 0.5, 1.0)]
    return jnp.array([g0]), jnp.array([g0 + slope.integ()(1.0)]), rates


@pytest.mark.slow_cases("coefficients0-0.0-False-1.0")
@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(
    ("coefficients", "g0", "wanted"),
    [
        ((3.0, 1.0, -2.0), 0.0, False),  # one change of sign
        ((3.0, -1.0, 2.0), 0.0, True),  # two …
        ((3.0, -1.0, 2.0), 0.1, False),  # … of a guard with the coefficients 0.1, 1.1, 0.767, 1.433
        ((-3.0, 1.0, -2.0), 1.34, False),  # 1.34, 0.34, 0.673, 0.007
        ((-3.0, 1.0, -2.0), 1.33, True),  # … -0.003
        ((-3.0, 1.0, -2.0), -1.34, True),  # it starts beyond zero
        ((-3.0, 9.0, -2.0), 0.99, True),  # 0.99, -0.01, 2.99, 2.323
        ((3.0, -1e-13, 2.0), 0.0, False),  # the change is rounding
        ((3.0, -3e-12, 2.0), 0.0, True),
    ],
)
def test_hidden_where_the_fit_is_exact(coefficients, g0, wanted, side):
    g0, g1, rates = step_of(side * np.array(coefficients), side * g0)
    assert turns.hidden(MIDDLE, jnp.array([side]), g0, g1, rates, H, jnp.array([1e-12])).item() == wanted


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(("part", "least"), [(0.99, 0.0), (1.01, 0.0), (0.99, 2e-3), (1.01, 2e-3)])
def test_a_fit_that_misses_the_data(part, least, side):
    """Of a monotonic guard with slopes 2, 3 and 2, up to 0.04 of the largest slope and up to rounding."""
    g0, g1, rates = step_of(side * np.array([2.0, 4.0, 2.0]), side * 0.01)
    off = side * part * (MISFIT * 3 + least) / (UNKNOWN * WORST)
    least, sides = jnp.array([least]), jnp.array([side])
    assert turns.hidden(MIDDLE, sides, g0, g1 + off, rates, H, least).item() == (part > 1)
    # What starts at zero has its change from the slopes alone.
    assert not turns.hidden(MIDDLE, sides, 0 * g0, g1 + off, rates, H, least).item()


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("coefficients", [(3.0, -1.0, 2.0), (-3.0, 1.0, -0.3)], ids=["at the start", "later"])
@pytest.mark.parametrize("part", [0.99, 1.01])
def test_away_from_zero_by_more_than_the_error(part, coefficients, side):
    """A guard that may turn twice, and whose change is not known better than by 1e-3."""
    off = 1e-3
    error = UNKNOWN * WORST * off
    fitted = np.array(coefficients) + np.array([6, 42, 6]) / 54 * off
    lowest = min(0.0, *(np.cumsum(fitted) / 3))
    _, change, rates = step_of(side * np.array(coefficients))
    g0 = side * jnp.array([part * error - lowest])
    hidden = turns.hidden(MIDDLE, jnp.array([side]), g0, g0 + change + side * off, rates, H, jnp.zeros(1))
    assert hidden.item() == (part < 1)


def changes(signs) -> int:
    return sum(one != other for one, other in itertools.pairwise(signs))


def test_a_guard_that_stands_still_hides_nothing():
    one, zero = jnp.ones(1), jnp.zeros(1)
    assert not turns.hidden(MIDDLE, one, one, one, [zero] * 3, H, zero).item()


def test_most_changes_of_sign():
    """All signs tried that the coefficients may have; what is up to `least` has none."""
    error, least = 0.5, 0.125
    values = np.array([-2.0, -0.5, -0.25, -0.125, 0.0, 0.125, 0.25, 0.5, 2.0])
    rows = np.array(list(itertools.product(values, repeat=4)))
    wanted = []
    for row in rows:
        may = [[sign for sign in (1, -1) if sign * one >= -error] for one in row if abs(one) > least]
        wanted.append(max(map(changes, itertools.product(*may))) if may else -1)
    found = turns.most_sign_changes(jnp.asarray(rows.T), jnp.full(len(rows), error), jnp.full(len(rows), least))
    assert_array_equal(found, wanted)
