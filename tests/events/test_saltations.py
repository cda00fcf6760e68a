"""The parts of a saltation matrix, in whole numbers: what is right is known exactly."""

import jax.numpy as jnp
import numpy as np
from numpy.testing import assert_allclose, assert_array_equal

from lyaphybrid.events import saltations

T, X, F = jnp.array(3.0), jnp.array([2.0, 5.0]), jnp.array([7.0, 11.0])
COLUMNS = jnp.array([[1.0, -2.0, 0.0], [3.0, 4.0, -5.0]])


def guard(t, x):
    return t**2 + x[0] * x[1]


def reset(t, x):
    return jnp.stack([x[0] * x[1] - 4 * t, t * t - 3 * x[0] + x[1]])


JACOBIAN, IN_TIME = np.array([[5.0, 2.0], [-3.0, 1.0]]), np.array([-4.0, 6.0])  # of `reset` at (T, X)


def test_a_guard_on_the_way():
    gradient, moving, rate = saltations.instant(guard, T, X, F)
    assert_array_equal(gradient, [5, 2])
    assert moving == 6
    assert rate == 6 + 5 * 7 + 2 * 11


def test_shifts_of_the_event_time():
    assert_array_equal(saltations.event_time_shifts(jnp.array([6.0, -3.0]), jnp.array(3.0)), [-2, 1])
    assert_array_equal(saltations.event_time_shifts(jnp.array([6.0, -3.0]), jnp.array(1.0)), [-6, 3])
    assert_array_equal(saltations.event_time_shifts(jnp.array([6.0, -3.0]), jnp.array(0.0)), [-6, 3])  # no division


def test_through_the_reset():
    new, columns, direction = saltations.pushforward(reset, T, X, COLUMNS, F)
    assert_array_equal(new, [2 * 5 - 4 * 3, 3 * 3 - 3 * 2 + 5])
    assert_array_equal(columns, JACOBIAN @ COLUMNS)
    assert_array_equal(direction, JACOBIAN @ F + IN_TIME)


def test_all_of_it_is_the_saltation_matrix():
    """By the formula of di Bernardo et al.: S = Dg + (f⁺ - Dg f⁻ - ∂ₜg) ∇hᵀ / ḣ."""
    after = jnp.array([-1.0, 8.0])
    gradient, _, rate = saltations.instant(guard, T, X, F)
    shifts = saltations.event_time_shifts(gradient @ COLUMNS, rate)
    _, columns, direction = saltations.pushforward(reset, T, X, COLUMNS, F)
    found = saltations.to_reference_time(columns, direction, after, shifts)
    matrix = JACOBIAN + np.outer(after - JACOBIAN @ F - IN_TIME, [5.0, 2.0]) / 63
    assert_allclose(found, matrix @ COLUMNS, rtol=1e-15, atol=1e-14)


def test_sizes_on_the_guard():
    """∇h·dx / ḣ with ḣ = 2 as what is left of 5·7 - 2·11 - 11: the terms are 34 times as large."""
    gradient, f = jnp.array([5.0, -2.0]), jnp.array([7.0, 11.0])
    sizes = saltations.sizes_at(COLUMNS, -f, gradient, jnp.array(-11.0), jnp.array(-2.0))
    assert_array_equal(sizes.columns, np.abs(COLUMNS))
    assert_array_equal(sizes.direction, f)
    terms = np.array([5.0, 2.0]) @ np.abs(COLUMNS)
    assert_array_equal(sizes.event_time_shift, terms / 2 * ((35 + 22 + 11) / 2))
    still = saltations.sizes_at(COLUMNS, f, gradient, jnp.array(11.0), jnp.array(0.0))
    assert_array_equal(still.event_time_shift, terms * (35 + 22 + 11))  # no division


def test_sizes_through_the_reset_and_back():
    """What cancels, counts: all terms of Dg dx in magnitude."""
    sizes = saltations.Sizes(jnp.abs(COLUMNS), jnp.abs(F), jnp.array([1.0, 2.0, 3.0]))
    pushed = saltations.sizes_pushed(reset, T, X, sizes, jnp.array([-100.0, 200.0]))
    assert_array_equal(pushed.columns, np.abs(JACOBIAN) @ np.abs(COLUMNS))
    assert_array_equal(pushed.direction, np.abs(JACOBIAN) @ np.asarray(F) + np.array([100.0, 200.0]))
    assert_array_equal(pushed.event_time_shift, [1, 2, 3])
    back = saltations.sizes_returned(pushed, jnp.array([-1.0, 8.0]))
    wanted = np.abs(JACOBIAN) @ np.abs(COLUMNS) + np.outer(
        np.abs(JACOBIAN) @ np.asarray(F) + np.array([101.0, 208.0]), [1, 2, 3]
    )
    assert_array_equal(back, wanted)
