"""DAEs and implicit methods in any units: closed forms in units from 1 down to 1e-9."""

import functools

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
from numpy.testing import assert_allclose

import lyaphybrid as lh
from lyaphybrid._linalg.linear_systems import condition

OMEGA, CURRENT, DRIVE, RESET_AT = 50.0, 1.3, 20.0, 0.9
METHODS = (lh.HalfExplicit, lh.ESDIRK, lh.RadauIIA)
FIRST = jnp.diag(jnp.array([1.0, 0.0]))


def driven(unit):
    """x' = −x + z, z = unit (I + D cos ωt)."""

    def residual(t, x, args):
        return jnp.stack([-x[0] + x[1], x[1] - unit * (CURRENT + DRIVE * jnp.cos(OMEGA * t))])

    return lh.DAE(lambda t, args: FIRST, residual, n_differential=1)


def driven_flow(unit):
    return lh.Flow(lambda t, x, args: -x + unit * (CURRENT + DRIVE * jnp.cos(OMEGA * t)))


def solution(t, start=0.0):
    """The solution of both, over the unit, that is 0 at the start."""

    def forced(t):
        return CURRENT + DRIVE * (np.cos(OMEGA * t) + OMEGA * np.sin(OMEGA * t)) / (1 + OMEGA**2)

    return forced(t) - forced(start) * np.exp(start - t)


def firing(t1):
    """The exponent and the number of events up to t1, where x is set to 0 at 0.9 units."""
    time, logs, count = 0.0, 0.0, 0
    while True:
        grid = np.arange(time + 1e-4, time + 6, 1e-3)
        first = int(np.argmax(solution(grid, time) > RESET_AT))
        low, high = grid[first] - 1e-3, grid[first]
        found = scipy.optimize.root_scalar(
            lambda t, start=time: solution(t, start) - RESET_AT, bracket=(low, high), xtol=1e-14
        )
        time = float(found.root)
        if time > t1:
            return -1 + logs / t1, count
        current = CURRENT + DRIVE * np.cos(OMEGA * time)
        logs, count = logs + np.log(abs(current / (current - RESET_AT))), count + 1


def in_unit(method, unit):
    """The method with its usual absolute tolerance; below 1e-6 with one in that unit."""
    return method() if unit > 1e-8 else method(atol=1e-12 * unit)


@pytest.mark.slow_cases(all_but=("1e-09-HalfExplicit",))
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("unit", [1e-6, 1e-9])
def test_a_driven_dae_follows_its_closed_form_in_any_unit(method, unit):
    times = np.linspace(0.0, 4.0, 5)
    path = lh.trajectory(driven(unit), [0.0, unit * (CURRENT + DRIVE)], t1=4.0, n=4, method=in_unit(method, unit))
    assert_allclose(path.x[:, 0] / unit, solution(times[-len(path.x) :]), atol=2e-5)


@pytest.mark.parametrize("method", [lh.ESDIRK, lh.RadauIIA])
@pytest.mark.parametrize("unit", [1e-6, 1e-9])
def test_a_driven_flow_follows_its_closed_form_in_any_unit(method, unit):
    path = lh.trajectory(driven_flow(unit), [0.0], t1=4.0, n=4, method=in_unit(method, unit))
    assert_allclose(path.x[:, 0] / unit, solution(np.linspace(0.0, 4.0, 5)[-len(path.x) :]), atol=2e-5)


@functools.cache
def _fired():
    return firing(20.0)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    "unit", [1e-6, pytest.param(1.0, marks=pytest.mark.slow), pytest.param(1e-9, marks=pytest.mark.slow)]
)
def test_exponents_and_events_of_a_dae_do_not_depend_on_the_unit(method, unit):
    fires = lh.Transition(lambda t, x, args: RESET_AT * unit - x[0], lambda t, x, args: x.at[0].set(0.0))
    neuron = lh.Hybrid({"integrates": driven(unit)}, fires)
    s = lh.lyapunov_spectrum(neuron, [0.0, unit * (CURRENT + DRIVE)], t1=20.0, method=in_unit(method, unit))
    exponent, count = _fired()
    assert int(s.jumps) == count
    assert_allclose(s.exponents, [exponent], atol=1e-3)


def capacitor(unit, row):
    """Charge q = C v behind a resistor, C = unit; the constraint as C v = q or as v = q/C."""

    def residual(t, x, args):
        current = unit * (-x[1] + OMEGA * jnp.cos(OMEGA * t))
        return jnp.stack([current, row * (unit * x[1] - x[0])])

    return lh.DAE(lambda t, args: FIRST, residual, n_differential=1)


@pytest.mark.slow_cases("RadauIIA-False-1e-06", "RadauIIA-True-1e-06", "ESDIRK-False-1e-06", "ESDIRK-True-1e-06")
@pytest.mark.parametrize("unit", [1e-6, pytest.param(1e-9, marks=pytest.mark.slow)])
@pytest.mark.parametrize("divided", [False, True])
@pytest.mark.parametrize("method", METHODS)
def test_a_charge_in_small_units_and_its_voltage(method, unit, divided):
    dae = capacitor(unit, 1 / unit if divided else 1.0)
    path = lh.trajectory(dae, [0.0, 0.0], t1=4.0, n=1, method=in_unit(method, unit))
    exact = OMEGA * (np.cos(4 * OMEGA) + OMEGA * np.sin(4 * OMEGA) - np.exp(-4.0)) / (1 + OMEGA**2)
    assert_allclose(path.x[-1], [unit * exact, exact], rtol=1e-4)
    s = lh.lyapunov_spectrum(dae, [0.0, 0.0], t1=10.0, method=in_unit(method, unit))
    assert_allclose(s.exponents, [-1.0], atol=1e-6)


def cubic(unit):
    """x' = −z, z (1 + (z/unit)²) = 2 x: z = unit at x = unit."""
    return lh.DAE(
        lambda t, args: FIRST,
        lambda t, x, args: jnp.stack([-x[1], x[1] * (1 + (x[1] / unit) ** 2) - 2 * x[0]]),
        n_differential=1,
    )


@pytest.mark.slow
@pytest.mark.parametrize("unit", [1.0, 1e-6, 1e-9, 1e-12])
def test_consistent_points_and_starts_in_small_units(unit):
    assert_allclose(lh.consistent_start(cubic(unit), [unit, 0.3 * unit]) / unit, [1.0, 1.0], rtol=1e-9)
    assert_allclose(lh.consistent_start(cubic(unit), [unit, 0.0]) / unit, [1.0, 1.0], rtol=1e-9)
    if unit >= 1e-9:
        off = lh.trajectory(cubic(unit), [unit, 1.18 * unit], t1=1.0, n=1, throw=False)
        assert off.status is lh.STATUS.inconsistent_start


@pytest.mark.parametrize("unit", [1.0, 1e-6, 1e-9])
def test_what_is_singular_is_so_in_any_unit(unit):
    def twice(t, x, args):
        both = unit * x[1] + x[2] - x[0]
        return jnp.stack([-x[0], both, 3 * both])

    singular = lh.DAE(lambda t, args: jnp.diag(jnp.array([1.0, 0.0, 0.0])), twice, n_differential=1)
    with pytest.raises(ValueError, match="nonsingular"):
        lh.trajectory(singular, [unit, 0.0, unit], t1=1.0, n=1)
    index_two = lh.DAE(lambda t, args: FIRST, lambda t, x, args: jnp.stack([x[1], x[0] - unit]), n_differential=1)
    with pytest.raises(ValueError, match="nonsingular"):
        lh.trajectory(index_two, [unit, 0.0], t1=1.0, n=1)


@pytest.mark.slow
def test_conditions_do_not_depend_on_units():
    matrix = np.random.default_rng(7).standard_normal((5, 5))
    exact = np.max(np.abs(np.linalg.eigvals(np.abs(np.linalg.inv(matrix)) @ np.abs(matrix))))
    rows, columns = 10.0 ** np.array([0, -6, 3, 0, 5]), 10.0 ** np.array([0, -3, 2, -4, 3])
    for scaled in (matrix, rows[:, None] * matrix * columns):
        assert exact / 2 < float(condition(jnp.asarray(scaled))) < 2 * exact
    assert not condition(jnp.array([[1.0, 0.0], [1.0, 1e-17]])) < 1e6
    assert not condition(jnp.array([[1.0, 1.0], [1.0, 1.0 + 1e-14]])) < 1e6


def test_the_absolute_tolerance_is_checked():
    for method in METHODS:
        assert method(atol=1e-9).atol == 1e-9
        with pytest.raises(ValueError, match="atol"):
            method(atol=0.0)
