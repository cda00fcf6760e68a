"""A block that rocks and a gear that rattles: exact orbits, the sum of the exponents, toppling and rest."""

import math

import jax
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import lyaphybrid as lh
from lyaphybrid import zoo

PRECISE = lh.RungeKutta("dopri5", rtol=1e-11, atol=1e-13)
STABLE = [
    ("rocking_block", {}),
    ("rocking_block", {"restitution": 0.9, "amplitude": 1.5, "omega": 3.0}),
    ("gear_rattle", {}),
    ("gear_rattle", {"restitution": 0.6, "amplitude": 1.0, "omega": 3.0}),
    ("gear_rattle", {"zeta": 0.0, "restitution": 0.8, "amplitude": 3.0, "omega": 4.0}),
]


def later(problem, start, length):
    """The state after that time, by SciPy, with impacts written anew; and their number."""
    a = problem.args
    rocks, side = problem.name == "rocking_block", math.copysign(1, start[0])
    t, x, impacts = 0.0, np.asarray(start), 0
    while t < length:

        def field(t, x, side=side):
            drive = a["amplitude"] * math.cos(a["omega"] * t)
            return [x[1], drive + (x[0] - side if rocks else -2 * a["zeta"] * x[1])]

        def hit(t, x, side=side):
            return side * x[0] if rocks else a["gap"] - abs(x[0])

        hit.terminal, hit.direction = True, -1
        run = solve_ivp(field, (t, length), x, "DOP853", events=hit, rtol=1e-12, atol=1e-13)
        t, x = run.t[-1], run.y[:, -1]
        if run.t_events[0].size:
            x = np.array([0.0, a["restitution"] * x[1]]) if rocks else np.array([x[0], -a["restitution"] * x[1]])
            x[0] -= 0.0 if rocks else math.copysign(1e-15, x[0])
            side, impacts = -side, impacts + 1
            x[0] = -0.0 if rocks and side < 0 else x[0]
    return x, impacts


@pytest.mark.slow_cases("rocking_block-parameters0", "rocking_block-parameters1")
@pytest.mark.parametrize(("name", "parameters"), STABLE)
def test_it_starts_on_the_symmetric_orbit_and_has_its_multipliers(name, parameters):
    problem = zoo.get(name)(**parameters)
    period = 2 * math.pi / problem.args["omega"]
    found = lh.tangent_map(problem.system, problem.x0, problem.args, t1=period, mode=problem.mode, method=PRECISE)
    np.testing.assert_allclose(found.x, problem.x0, atol=1e-9)
    multipliers = np.sort(np.abs(np.linalg.eigvals(np.asarray(found.matrix))))[::-1]
    np.testing.assert_allclose(np.log(multipliers) / period, problem.reference.exponents, atol=1e-7)


@pytest.mark.parametrize("name", ["rocking_block", "gear_rattle"])
def test_the_motion_and_its_derivative_are_those_of_another_program(name):
    problem = zoo.get(name)()
    start, length = np.asarray(problem.x0) * [0.9, 1.2], 10.0
    found = lh.tangent_map(problem.system, start, problem.args, t1=length, mode=problem.mode, method=PRECISE)
    end, impacts = later(problem, start, length)
    assert impacts > 5
    np.testing.assert_allclose(found.x, end, atol=1e-8)
    step = 1e-6
    columns = [
        (later(problem, start + step * e, length)[0] - later(problem, start - step * e, length)[0]) / (2 * step)
        for e in np.eye(2)
    ]
    np.testing.assert_allclose(found.matrix, np.transpose(columns), atol=1e-5 * np.max(np.abs(found.matrix)))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["rocking_block", "gear_rattle"])
def test_the_exponents_are_the_exact_ones(name):
    problem = zoo.get(name)()
    result = problem.spectrum(t1=problem.t1 / 10)  # 64 periods in 64 blocks
    assert np.all(result.stderr < 1e-9)
    np.testing.assert_allclose(result.exponents, problem.reference.exponents, atol=1e-9)


def test_a_chaotic_gear_obeys_the_sum_rule():
    problem = zoo.gear_rattle(amplitude=3.0, restitution=0.9, zeta=0.05)
    assert problem.reference is None
    result = problem.spectrum(t1=800.0)
    assert result.stderr[0] < 0.03
    assert result.exponents[0] > 5 * result.stderr[0]
    expected = -2 * 0.05 + 2 * math.log(0.9) * float(result.jumps) / 800.0
    assert float(np.sum(result.exponents)) == pytest.approx(expected, abs=1e-9)


@pytest.mark.slow
def test_blocks_topple_or_come_to_rest():
    toppled = zoo.rocking_block(amplitude=6.0, restitution=0.8)
    motion = lh.trajectory(toppled.system, toppled.x0, toppled.args, t1=100.0, n=1, mode=toppled.mode)
    assert motion.status == lh.STATUS.terminated
    assert abs(motion.events.x_after[-1, 0]) == pytest.approx(7.0)
    assert motion.events.x_after[-1, 0] * motion.events.x_after[-1, 1] > 0
    quiet = zoo.rocking_block(amplitude=0.5)
    motion = lh.trajectory(quiet.system, [0.1, 0.0], quiet.args, t1=100.0, n=1, mode="right", throw=False)
    assert motion.status == lh.STATUS.zeno


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: zoo.rocking_block(restitution=1), r"restitution must be between 0 and 1"),
        (lambda: zoo.rocking_block(omega=0), r"omega must be positive"),
        (lambda: zoo.gear_rattle(zeta=-0.1), r"zeta must be 0 or positive"),
        (lambda: zoo.gear_rattle(gap=0), r"gap must be positive"),
    ],
)
def test_bad_parameters(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_traced_parameters_reach_args():
    for build in (zoo.rocking_block, zoo.gear_rattle):
        problem = jax.eval_shape(lambda a, build=build: build(amplitude=a).args["amplitude"] * 2, 1.0)
        assert problem.shape == ()
        assert jax.jit(lambda a, build=build: build(amplitude=a).x0)(1.0).shape == (2,)
