"""What one iteration or one event makes very short is not lost, and what it destroys is: maps and closed-form flows."""

import math
from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import lyaphybrid as lh
from lyaphybrid._jax import double_double
from lyaphybrid._jax.double_double import DoubleDouble
from lyaphybrid._jax.engines import compiled
from lyaphybrid._linalg import lost_directions

ENGINES = pytest.mark.parametrize("engine", [jax.jit, compiled()], ids=["xla", "native"])
TURN = np.array([[math.cos(0.7), -math.sin(0.7)], [math.sin(0.7), math.cos(0.7)]])
LEFT = 5e-32  # what pairs round off
RNG = np.random.default_rng(7)
MATRIX, VECTOR = RNG.normal(size=(3, 3)), RNG.normal(size=3)
CUBE = RNG.normal(size=(2, 3, 3))


def exact(array):
    return np.vectorize(Fraction, otypes=[object])(np.asarray(array))


@ENGINES
@pytest.mark.parametrize(
    ("function", "wanted"),
    [
        (lambda dx: jnp.asarray(MATRIX) @ dx, lambda dx: exact(MATRIX) @ dx),
        (lambda dx: jnp.einsum("bij,j->bi", jnp.asarray(CUBE), dx).ravel(), lambda dx: (exact(CUBE) @ dx).ravel()),
        (lambda dx: jnp.einsum("bij,bj->ib", jnp.asarray(CUBE), jnp.stack([dx, dx[::-1]])).ravel(),
         lambda dx: np.stack([exact(CUBE[0]) @ dx, exact(CUBE[1]) @ dx[::-1]], 1).ravel()),
        (lambda dx: jnp.stack([jnp.sum(dx * jnp.asarray(VECTOR))]), lambda dx: np.array([dx @ exact(VECTOR)])),
        (lambda dx: (dx / 3.0 - dx[::-1]) + dx[:1], lambda dx: dx / 3 - dx[::-1] + dx[:1]),
        (lambda dx: jax.lax.cond(jnp.asarray(VECTOR[0]) < 9, lambda: 3.0 * dx, lambda: dx),
         lambda dx: 3 * dx),
        (lambda dx: jnp.where(jnp.arange(3) < 2, -dx, jnp.zeros(3)), lambda dx: np.array([-dx[0], -dx[1], 0])),
    ],
    ids=["matrix", "batch", "batches", "sum", "quotient", "cond", "where"],
)  # fmt: skip
def test_pairs_have_twice_the_digits(engine, function, wanted):
    high, low = RNG.normal(size=3), 1e-17 * RNG.normal(size=3)
    found = engine(lambda dx: double_double.precise(function)(dx, jnp.array(0.0)))(
        DoubleDouble(jnp.asarray(high), jnp.asarray(low))
    )
    right = wanted(exact(high) + exact(low))
    off = [abs(float(error)) for error in exact(found.high) + exact(found.low) - right]
    assert max(off) < 1e-30 * max(abs(float(one)) for one in right)


def test_what_pairs_cannot_follow_is_known_before():
    assert lost_directions.is_precise(lambda dx: dx * 2.0, jnp.zeros(3))
    assert not lost_directions.is_precise(jnp.cumsum, jnp.zeros(3))
    assert not lost_directions.is_precise(lambda dx: dx * 2.0, jnp.zeros(17))


@pytest.mark.slow_cases("1e-14-xla", "1e-20-xla", "1e-26-xla")
@ENGINES
@pytest.mark.parametrize("small", [1e-14, 1e-20, 1e-26])
def test_a_product_of_matrices_keeps_its_small_direction(engine, small):
    def tangent(dx):
        return jnp.asarray(TURN) @ (jnp.array([2.0, small]) * (jnp.asarray(TURN).T @ dx))

    _, log_r, lost, sure = engine(lambda frame: lost_directions.orthonormalised(tangent, frame))(jnp.eye(2))
    assert not np.any(lost)
    assert sure
    assert_allclose(np.sum(log_r), math.log(2 * small), rtol=1e-14, atol=LEFT / small)
    assert_allclose(
        engine(lambda: lost_directions.log_volume(tangent, 2, jnp.float64))(),
        math.log(2 * small),
        rtol=1e-14,
        atol=LEFT / small,
    )


def linear(*factors):
    """x ↦ A B C x."""

    def rule(n, x, args):
        for factor in reversed(factors):
            x = jnp.asarray(factor) @ x
        return x

    return lh.Map(rule)


def spectrum_of(system, **keywords):
    return lh.lyapunov_spectrum(system, [0.0, 0.0], **{"t1": 400, "transient": 10} | keywords)


@pytest.mark.slow
@pytest.mark.parametrize("small", [1e-13, 1e-14, 1e-20, 1e-25])
def test_a_map_that_contracts_beyond_double_precision(small):
    spectrum = spectrum_of(linear(TURN, np.diag([2.0, small]), TURN.T))
    assert spectrum.status is lh.STATUS.ok
    assert_allclose(spectrum.exponents, [math.log(2), math.log(small)], rtol=1e-13)
    assert spectrum.sum_rule_residual < 1e-12 + LEFT / small
    assert not spectrum.notes
    assert not np.any(spectrum.losses)


def test_a_matrix_that_is_nearly_singular_has_the_exponents_of_its_entries():
    """Their rounding decides what they are: that is said."""
    matrix = TURN @ np.diag([2.0, 1e-14]) @ TURN.T
    (a, b), (c, d) = exact(matrix)
    spectrum = spectrum_of(linear(matrix))
    assert_allclose(np.sum(spectrum.exponents), math.log(abs(float(a * d - b * c))), rtol=1e-13)
    assert_allclose(spectrum.exponents[1], math.log(1e-14), atol=0.05)
    assert spectrum.notes == {"unresolved"}


@pytest.mark.slow_cases(all_but=("rounded",))
@pytest.mark.parametrize(
    ("rule", "notes"),
    [
        (lambda n, x, args: jnp.stack([jnp.sin(2 * (x[0] + x[1])), jnp.cos(3 * (x[0] + x[1]))]), {"rank_lost"}),
        (lambda n, x, args: jnp.asarray(TURN) @ (jnp.array([2.0, 0.0]) * (jnp.asarray(TURN).T @ x)), {"rank_lost"}),
        (lambda n, x, args: jnp.asarray(TURN @ np.diag([2.0, 0.0]) @ TURN.T) @ x, {"rank_lost", "unresolved"}),
        (lambda n, x, args: jnp.stack([jnp.sin(3 * x[0] + x[1]), 0.1 * x[1] * 0]), {"rank_lost"}),
    ],
    ids=["of one variable", "projected", "rounded", "constant"],
)
def test_a_singular_map_loses_a_direction_at_each_iteration(rule, notes):
    spectrum = spectrum_of(lh.Map(rule))
    assert np.isfinite(spectrum.exponents[0])
    assert spectrum.exponents[1] == -np.inf
    assert spectrum.notes == notes
    assert np.asarray(spectrum.losses).tolist() == [0, 400]
    assert spectrum.sum_rule_residual is None


@pytest.mark.slow
def test_a_singular_map_whose_derivatives_are_rounded():
    """(p², p³) of p = x y, multiplied out: rows that are parallel but for rounding."""

    def rule(n, x, args):
        return jnp.stack([1 - 1.7 * x[0] ** 2 * x[1] ** 2, 0.5 + x[0] ** 3 * x[1] ** 3])

    spectrum = lh.lyapunov_spectrum(lh.Map(rule), [0.3, 0.4], t1=500)
    assert spectrum.exponents[1] == -np.inf
    assert "rank_lost" in spectrum.notes


@pytest.mark.slow
def test_derivatives_of_what_is_very_short():
    def smallest(log_small):
        small = jnp.exp(log_small)
        system = lh.Map(lambda n, x, a: jnp.asarray(TURN) @ (jnp.stack([2 + 0 * a, a]) * (jnp.asarray(TURN).T @ x)))
        return lh.lyapunov_spectrum(system, [0.0, 0.0], small, t1=40, transient=10).exponents[1]

    value, slope = jax.jvp(smallest, [jnp.array(-40.0)], [jnp.array(1.0)])
    assert_allclose(value, -40.0, rtol=1e-13)
    assert_allclose(slope, 1.0, rtol=1e-10)


def ball(floor=0.0):
    """It bounces on a floor: gravity 1, dv⁺ = -r dv⁻; where it bounces is forgotten, or never known."""
    resting = jnp.zeros_like if floor == 0 else (lambda x: x)
    return lh.EventDriven(
        lambda dt, t, x, r: jnp.stack([x[0] + x[1] * dt - 0.5 * dt**2, x[1] - dt]),
        lambda t, x, r: (x[1] + jnp.sqrt(x[1] ** 2 + 2 * (x[0] - floor)), 0),
        lambda t, x, r, which: jnp.stack([resting(x[0]), -r * x[1]]),
        lambda t, x, r, which: x[0] - floor,
    )


FRAME = jnp.array([[1.0, 0.0], [-1.0, 1.0]])


@pytest.mark.slow
@pytest.mark.parametrize(("restitution", "reached"), [(0.9, 3000), (0.5, 450), (0.01, 65)])
@pytest.mark.parametrize("clock", ["jumps", "hybrid"])
def test_bounces_in_closed_form_go_on_to_the_end_of_double_precision(restitution, reached, clock):
    """From the floor with v = 1: the first column turns once from (1, −1) to the field; then 0 and 2 ln r a bounce."""

    def run(t1, **keywords):
        return lh.lyapunov_spectrum(
            ball(), [0.0, 1.0], restitution, t1=t1, clock=clock, frame=FRAME, throw=False, **keywords
        )

    known, turned = np.array([0, 2 * math.log(restitution)]), math.log(2) / 2 * np.array([-1, 1])
    spectrum = run(reached)
    assert spectrum.status is lh.STATUS.ok
    assert spectrum.jumps == reached
    assert_allclose(spectrum.exponents, known + turned / reached, atol=1e-10)
    assert_allclose(spectrum.x[1], restitution**reached, rtol=1e-9)
    assert spectrum.sum_rule_residual < 1e-12
    assert not spectrum.notes
    end = run(10 * reached)
    assert end.status is lh.STATUS.zeno
    assert end.jumps >= reached
    assert_allclose(end.exponents, known + turned / int(end.jumps), atol=1e-10)


@pytest.mark.slow
@pytest.mark.parametrize("restitution", [0.5, 0.9])
def test_bounces_on_a_floor_that_rounding_blurs_end_before_they_are_wrong(restitution):
    spectrum = lh.lyapunov_spectrum(
        ball(5.0), [5.0, 1.0], restitution, t1=2000, clock="jumps", frame=FRAME, throw=False, blocks=2
    )
    assert spectrum.status in (lh.STATUS.zeno, lh.STATUS.nonfinite)
    jumps = int(spectrum.jumps)
    assert math.log(1e-6) / math.log(restitution) < jumps < math.log(1e-9) / math.log(restitution)
    turned = math.log(2) / 2 * np.array([-1, 1])
    assert_allclose(jumps * np.asarray(spectrum.exponents), [0, 2 * jumps * math.log(restitution)] + turned, atol=0.1)


@pytest.mark.slow
def test_in_time_bounces_in_closed_form_accumulate():
    spectrum = lh.lyapunov_spectrum(ball(), [0.0, 1.0], 0.5, t1=5.0, throw=False)
    assert spectrum.status is lh.STATUS.zeno


@pytest.mark.slow
def test_an_event_that_destroys_a_direction_and_a_flight_that_shortens_one():
    """Turns of length 1: the phase is neutral; 40 turns of decay are no loss, a reset to nothing is one."""
    turns = lh.EventDriven(
        lambda dt, t, x, r: jnp.stack([x[0] - dt, x[1] * jnp.exp(0.1 * dt), x[2] * jnp.exp(-40 * dt)]),
        lambda t, x, r: (x[0], 0),
        lambda t, x, r, which: jnp.stack([jnp.ones_like(t), r * x[1], x[2]]),
        lambda t, x, r, which: x[0],
    )

    def run(r):
        return lh.lyapunov_spectrum(turns, [1.0, 0.0, 0.0], r, t1=50, clock="jumps")

    regular, singular = run(0.5), run(0.0)
    assert_allclose(regular.exponents, [0.0, 0.1 + math.log(0.5), -40.0], rtol=1e-12, atol=1e-12)
    assert "rank_lost" not in regular.notes
    assert_allclose(singular.exponents, [0.0, -40.0, -np.inf], rtol=1e-12, atol=1e-12)
    assert "rank_lost" in singular.notes
    assert np.asarray(singular.losses).tolist() == [0, 0, 50]
