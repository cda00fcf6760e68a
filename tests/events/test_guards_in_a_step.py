"""What `events/roots.py` computes of guards in a step, against whole numbers and known roots."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from lyaphybrid._jax.precision import GUARD_ROUNDING
from lyaphybrid.events import roots

T, X = jnp.array(3.0), jnp.array([2.0, -5.0])


def guards(t, x):
    return jnp.stack([t * t + x[0], x[0] * x[1] - 4 * t])


def field(t, x):
    return jnp.stack([x[1], t - x[0]])  # (-5, 1) at (T, X)


def test_rates_and_jets():
    """g = (t² + x, x y - 4 t) with x' = y, y' = t - x."""
    g, rate = roots.rates(guards, T, X, jnp.array([-5.0, 1.0]))
    assert_array_equal(g, [11, -22])
    assert_array_equal(rate, [2 * 3 - 5, -5 * -5 + 2 * 1 - 4])
    g, rate, second = roots.jets(guards, field, T, X)
    assert_array_equal(g, [11, -22])
    assert_array_equal(rate, [1, 23])
    # x'' = t - x = 1, y'' = 1 - y = 6
    assert_array_equal(second, [2 + 1, 1 * -5 + 2 * -5 * 1 + 2 * 6])


@pytest.mark.slow
def test_rounding_of_guards():
    unit = GUARD_ROUNDING
    assert_allclose(roots.rounding(guards, T, X), [unit * (18 + 2), unit * (12 + 10 + 10)], rtol=1e-14)
    assert_allclose(roots.errors_by(guards, T, X, jnp.abs(X)), [2, 20], rtol=1e-14)
    h = jnp.array(0.5)
    *jets, tolerance, of_step = roots.to_arm(guards, field, T, X, h)
    assert_array_equal(jets, [[11, -22], [1, 23], [3, -3]])
    assert_allclose(tolerance, [unit * 20, unit * 32], rtol=1e-14)
    moved = np.array([5, 1]) * 0.5 + 0.5 * np.array([1, 6]) * 0.25  # |f| h + |f'| h²/2
    assert_allclose(of_step, [unit * (6 * 0.5 + moved[0]), unit * (4 * 0.5 + 5 * moved[0] + 2 * moved[1])], rtol=1e-14)


def test_algebraic_unknowns_are_less_sure(monkeypatch):
    """1e-12 of what a state moves in a step, where a field has algebraic equations."""
    monkeypatch.setattr(roots, "is_constrained", lambda _: True)
    *_, tolerance, of_step = roots.to_arm(guards, field, T, X, jnp.array(0.5))
    assert_allclose(tolerance, [GUARD_ROUNDING * 20, GUARD_ROUNDING * 32], rtol=1e-14)
    assert_allclose(of_step, [1e-12 * 5.625, 1e-12 * (2 + 5 * 2.625 + 2 * 1.25)], rtol=1e-14)


# g, rate, second, guard_tolerance, step_rounding, h, t, fired -> guard_sign, guard, rate, flat
ARMED = {
    "positive": ([2.0, -3.0, 1.0, 0.0, 0.0, 1.0, 0.0, False], [1, 2.0, -3.0, False]),
    "negative": ([-2.0, 3.0, 1.0, 0.0, 0.0, 1.0, 0.0, False], [-1, -2.0, 3.0, False]),
    "zero, falling": ([0.0, -3.0, 1.0, 0.0, 0.0, 1.0, 0.0, False], [-1, 0.0, -3.0, False]),
    "at its rounding": ([-2e-9, 3.0, 0.0, 2e-9, 0.0, 1.0, 0.0, False], [1, 0.0, 3.0, False]),
    "within its rounding": ([-1.99e-9, 3.0, 0.0, 1e-9, 1e-9, 1.0, 0.0, False], [1, 0.0, 3.0, False]),
    "beyond its rounding": ([-2.01e-9, 3.0, 0.0, 1e-9, 1e-9, 1.0, 0.0, False], [-1, -2.01e-9, 3.0, False]),
    "just fired": ([-0.99e-9, 4.0, 0.0, 0.0, 0.0, 0.25, 0.0, True], [1, 0.0, 4.0, False]),
    "just fired, fast": ([-1.99e-9, 8.0, 0.0, 0.0, 0.0, 0.25, 0.0, True], [1, 0.0, 8.0, False]),
    "fired before": ([-1.01e-9, 4.0, 0.0, 0.0, 0.0, 0.25, 0.0, True], [-1, -1.01e-9, 4.0, False]),
    "fired, step rounding": ([-0.99e-9, 4.0, 0.0, 0.0, 1e-3, 0.25, 0.0, True], [1, 0.0, 4.0, False]),
    "fired, beyond": ([-1.01e-9, 4.0, 0.0, 0.0, 1e-3, 0.25, 0.0, True], [-1, -1.01e-9, 4.0, False]),
    "fired, bending": ([-0.99e-9, 0.1, -8.0, 0.0, 0.0, 0.5, 0.0, True], [1, 0.0, 0.1, False]),
    "fired, bending, beyond": ([-1.01e-9, 0.1, -8.0, 0.0, 0.0, 0.5, 0.0, True], [-1, -1.01e-9, 0.1, False]),
    "flat": ([0.0, 0.0, -3.0, 0.0, 0.0, 1.0, 0.0, False], [-1, 0.0, 0.0, True]),
    "not at zero": ([1.0, 0.0, -3.0, 0.0, 0.0, 1.0, 0.0, False], [1, 1.0, 0.0, False]),
    "nearly flat": ([0.0, 1.99e-8, -8.0, 0.0, 0.0, 0.5, 0.0, False], [-1, 0.0, 0.0, True]),
    "not quite flat": ([0.0, 2.01e-8, -8.0, 0.0, 0.0, 0.5, 0.0, False], [1, 0.0, 2.01e-8, False]),
    "nothing": ([0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, False], [0, 0.0, 0.0, True]),
}  # fmt: skip


@pytest.mark.parametrize("case", ARMED)
def test_which_side_of_zero(case):
    given, wanted = ARMED[case]
    found = roots.arm(*(jnp.asarray(one) for one in given))
    assert [one.item() for one in found] == wanted


@pytest.mark.parametrize(("part", "flat"), [(0.99, True), (1.01, False)])
def test_late_times_make_a_rate_rounding(part, flat):
    """1e-8 of the bend, and the rounding of the time: at t = 1e9 a rate is known to 64 eps t times its derivative."""
    h, second, t = 0.5, -8.0, -1e9
    rate = part * (1e-8 * 0.5 * 8 * h * h + GUARD_ROUNDING * 1e9 * 8 * h) / h
    assert roots.arm(*(jnp.asarray(one) for one in (0.0, rate, second, 0.0, 0.0, h, t, False)))[3] == flat


def ends(coefficients):
    """g0, d0, g1, d1 of the polynomial with these coefficients, the constant one first."""
    p = np.polynomial.Polynomial(coefficients)
    return [jnp.asarray(one) for one in (p(0.0), p.deriv()(0.0), p(1.0), p.deriv()(1.0))]


def test_a_cubic_by_its_ends():
    p = np.polynomial.Polynomial([1.0, 2.0, -3.0, 4.0])
    for theta in (0.0, 0.25, 0.5, 1.0):
        value, slope = roots.cubic(theta, *ends(p.coef))
        assert (value, slope) == (p(theta), p.deriv()(theta))


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("inside", [0.0625, 0.5, 0.875])
@pytest.mark.parametrize("other", [-3.0, -0.25, 1.25, 4.0, None])
def test_where_a_cubic_turns(sign, inside, other):
    """None: a parabola."""
    slope = sign * np.polynomial.Polynomial.fromroots([inside] if other is None else [inside, other])
    assert_allclose(roots.turning_point(*ends(slope.integ(k=7.0).coef)), inside, rtol=1e-14)


@pytest.mark.parametrize("other", [-1e8, 1e8])
def test_where_a_cubic_turns_that_hardly_bends(other):
    """Of its two extrema one is far away: there is no cancellation."""
    slope = 1e-9 * np.polynomial.Polynomial.fromroots([0.3, other])
    assert_allclose(roots.turning_point(*ends(slope.integ().coef)), 0.3, rtol=1e-13)


def test_a_turning_point_stays_in_the_step():
    """Also where rounding, or slopes of one sign, leave none: nothing is infinite or undefined."""
    for slope in ([1.0, 0.0, 1.0], [1.0, -2.0, 4.0], [0.0], [1.0], [-1.0, -1.0]):
        found = roots.turning_point(*ends(np.polynomial.Polynomial(slope).integ().coef))
        assert 0 <= found <= 1
    assert jax.grad(lambda d: roots.turning_point(0.0, d, 1.0, 1.0))(1.0) == jnp.array(0.0)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(
    "others", [[], [3.0], [-0.5], [1.5, 2.0], [-3.0, 2.0], [-1e-3, 1.001], [0.5 + 0.1j, 0.5 - 0.1j]], ids=str
)
@pytest.mark.parametrize("root", [1e-9, 0.125, 0.3, 0.5, 0.9, 1 - 1e-9])
def test_the_root_of_a_cubic(root, others, sign):
    polynomial = sign * np.polynomial.Polynomial.fromroots([root, *others])
    found = roots.hermite_root(jnp.array(0.0), *ends(np.real(polynomial.coef)))
    assert_allclose(found, root, rtol=1e-13, atol=1e-15)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("places", [(0.04, 1.18, 1.53), (0.54, -0.04, -0.28), (0.69, -0.19, 1.38)], ids=str)
def test_where_newton_would_leave_the_bracket(places, sign):
    """Then the bracket is halved."""
    found = roots.hermite_root(jnp.array(0.0), *ends(sign * np.polynomial.Polynomial.fromroots(places).coef))
    assert_allclose(found, places[0], rtol=1e-13)


@pytest.mark.parametrize("others", [[], [3.0], [1.5, -2.0]], ids=str)
def test_a_root_at_the_end_of_the_step(others):
    p = np.polynomial.Polynomial.fromroots([1.0, *others])
    g0, d0, _, d1 = ends(p.coef)
    assert_allclose(roots.hermite_root(jnp.array(0.0), g0, d0, jnp.array(0.0), d1), 1.0, rtol=1e-15)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_root_after_a_point(sign):
    """A guard that starts at zero, and one that crossed before `lo`: the root between there and the end."""
    for first, root in ((0.0, 0.75), (0.125, 0.625)):
        found = roots.hermite_root(
            jnp.array(0.25), *ends(sign * np.polynomial.Polynomial.fromroots([first, root, 5.0]).coef)
        )
        assert_allclose(found, root, rtol=1e-14)
    soon = sign * np.polynomial.Polynomial.fromroots([0.0, 0.75, 1.1])  # a root soon after the step is another one
    assert_allclose(roots.hermite_root(jnp.array(0.25), *ends(soon.coef)), 0.75, rtol=1e-13)
    same = roots.hermite_root(jnp.array(0.5), *ends(sign * np.polynomial.Polynomial.fromroots([0.0, 0.75, 2.5]).coef))
    assert_allclose(same, 0.75, rtol=1e-14)
