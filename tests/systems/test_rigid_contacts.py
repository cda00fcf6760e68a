"""`lh.impact`: laws of the impact, resets written by hand, finite differences of the real flow, bad arguments."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import lyaphybrid as lh
from lyaphybrid import zoo

# --- a double pendulum (masses and rods 1, gravity 1) beside a wall: a full mass matrix that depends on q -----------


def masses(t, x, args):
    coupling = jnp.cos(x[0] - x[1])
    return jnp.stack([jnp.stack([0 * coupling + 2.0, coupling]), jnp.stack([coupling, 0 * coupling + 1.0])])


def distance(t, x, args):
    return args["wall"] - jnp.sin(x[0]) - jnp.sin(x[1])


def swing(t, x, args):
    a, b, va, vb = x
    force = jnp.stack([-jnp.sin(a - b) * vb**2 - 2 * jnp.sin(a), jnp.sin(a - b) * va**2 - jnp.sin(b)])
    c = jnp.cos(a - b)
    acceleration = jnp.stack([force[0] - c * force[1], 2 * force[1] - c * force[0]]) / (2 - c * c)
    return jnp.concatenate([x[2:], acceleration])


STRIKE = lh.impact(masses, distance, lambda args: args["restitution"])
PENDULUM = lh.Hybrid(swing, lh.Transition(distance, STRIKE))
ARGS = {"wall": 0.2, "restitution": 0.7}
AT_WALL = np.array([0.5, np.arcsin(0.2 - np.sin(0.5)), 0.3, 0.9])


def kinetic_energy(x, m):
    v = np.asarray(x)[2:]
    return 0.5 * v @ m @ v


def by_hand(x, wall, restitution):
    """The impact in numbers: impulse P at the bob along the wall's normal, M Δv = J P."""
    a, b, va, vb = x
    j = np.array([np.cos(a), np.cos(b)])  # velocity of the bob towards the wall is j·v
    m = np.array([[2.0, np.cos(a - b)], [np.cos(a - b), 1.0]])
    mobility = j @ np.linalg.inv(m) @ j
    push = -(1 + restitution) * (j @ [va, vb]) / mobility
    return np.array([a, b, *(np.array([va, vb]) + np.linalg.inv(m) @ j * push)])


def test_the_reset_of_a_double_pendulum_is_the_one_by_hand():
    np.testing.assert_allclose(STRIKE(0.0, jnp.asarray(AT_WALL), ARGS), by_hand(AT_WALL, **ARGS), rtol=1e-14)


@pytest.mark.parametrize("restitution", [0.0, 0.4, 1.0])
def test_the_momentum_jumps_along_the_normal_and_newtons_law_holds(restitution):
    x, args = jnp.asarray(AT_WALL), ARGS | {"restitution": restitution}
    after, m = STRIKE(0.0, x, args), np.asarray(masses(0.0, x, args))
    normal = np.asarray(jax.grad(distance, argnums=1)(0.0, x, args))[:2]
    tangent = np.array([-normal[1], normal[0]])
    np.testing.assert_array_equal(after[:2], x[:2])
    assert abs(tangent @ m @ (after - x)[2:]) < 1e-15
    np.testing.assert_allclose(normal @ after[2:], -restitution * normal @ x[2:], atol=1e-15)
    lost = kinetic_energy(x, m) - kinetic_energy(after, m)
    mobility = normal @ np.linalg.solve(m, normal)
    np.testing.assert_allclose(lost, (1 - restitution**2) * (normal @ x[2:]) ** 2 / (2 * mobility), atol=1e-15)


@pytest.mark.slow
def test_a_ball_on_a_moving_table_is_that_of_the_zoo():
    problem = zoo.kicked_ball()
    guard, reset = problem.system.transitions[0].guard, problem.system.transitions[0].reset
    ours = lh.impact(1.0, guard, lambda args: args["restitution"])
    for t, x in [(0.3, [0.2, -1.0]), (4.0, [-0.7, -2.5])]:
        x = jnp.asarray(x)
        np.testing.assert_allclose(ours(t, x, problem.args), reset(t, x, problem.args), rtol=1e-14)
        np.testing.assert_allclose(
            jax.jacfwd(ours, argnums=(0, 1))(t, x, problem.args)[0],
            jax.jacfwd(reset, argnums=(0, 1))(t, x, problem.args)[0],
            rtol=1e-13,
            atol=1e-14,
        )


@pytest.mark.parametrize("mass", [2.0, np.float32(2), np.diag([2.0, 2.0]), lambda t, x, args: 2.0 * jnp.eye(2)])
def test_equal_masses_do_not_matter_in_whatever_form(mass):
    reset = lh.impact(mass, lambda t, x, args: x[0] + 2 * x[1], 0.5)
    expected = lh.impact(1, lambda t, x, args: x[0] + 2 * x[1], np.float32(0.5))
    x = jnp.asarray([0.2, -0.1, 0.3, -2.0])
    np.testing.assert_allclose(reset(0.0, x, None), expected(0.0, x, None), rtol=1e-14)


@pytest.mark.slow
def test_several_contacts():
    def gaps(t, x, args):
        return jnp.stack([x[0], 1 - x[1], x[1] - 0.4 * x[0] + 0.3])

    reset = lh.impact(1.0, gaps, 1.0)
    x = jnp.asarray([0.3, 0.4, -1.0, 2.1])
    for which, normal in enumerate(([1.0, 0.0], [0.0, -1.0], [-0.4, 1.0])):
        mirrored = x[2:] - 2 * jnp.dot(x[2:], jnp.asarray(normal)) * jnp.asarray(normal) / np.dot(normal, normal)
        np.testing.assert_allclose(reset(0.0, x, None, jnp.asarray(which))[2:], mirrored, atol=1e-15)
    box = lh.Hybrid(lambda t, x, args: jnp.concatenate([x[2:], 0 * x[2:]]), lh.Transition(gaps, reset))
    motion = lh.trajectory(box, x, t1=5.0, n=1)
    assert set(np.asarray(motion.events.which)) == {0, 1, 2}
    assert bool(jnp.all(gaps(0.0, motion.x[-1], None) > 0))
    np.testing.assert_allclose(jnp.sum(motion.x[-1, 2:] ** 2), 1 + 2.1**2, rtol=1e-12)


def test_constant_mass_matrix_and_float32():
    m = np.array([[2.0, 0.5], [0.5, 1.0]])
    reset = lh.impact(m, lambda t, x, args: x[1], 0.25)
    x = np.array([0.0, 0.0, 1.0, -1.0])
    after = reset(0.0, jnp.asarray(x), None)
    np.testing.assert_allclose((m @ (np.asarray(after) - x)[2:])[0], 0, atol=1e-15)
    assert float(after[3]) == 0.25
    assert reset(jnp.float32(0), jnp.asarray(x, jnp.float32), None).dtype == jnp.float32


# --- derivatives ---------------------------------------------------------------------------------------------------


def flown(x, t1):
    """The real flow through impacts, by SciPy and the reset by hand."""

    def field(t, x):
        a, b, va, vb = x
        c, s = np.cos(a - b), np.sin(a - b)
        force = np.array([-s * vb**2 - 2 * np.sin(a), s * va**2 - np.sin(b)])
        return [va, vb, *np.linalg.solve([[2.0, c], [c, 1.0]], force)]

    def wall(t, x):
        return ARGS["wall"] - np.sin(x[0]) - np.sin(x[1])

    wall.terminal, wall.direction = True, -1
    t, jumps = 0.0, 0
    while t < t1:
        run = solve_ivp(field, (t, t1), x, "DOP853", events=wall, rtol=1e-13, atol=1e-13)
        t, x = run.t[-1], run.y[:, -1]
        if run.t_events[0].size:
            x, jumps = by_hand(x, **ARGS), jumps + 1
    return x, jumps


START, LENGTH = np.array([-0.5, 0.5, 0.0, 1.0]), 6.0
METHOD = lh.RungeKutta("dopri5", rtol=1e-11, atol=1e-13)


@pytest.mark.slow
def test_the_tangent_is_that_of_finite_differences_of_the_real_flow():
    found = lh.tangent_map(PENDULUM, START, ARGS, t1=LENGTH, method=METHOD)
    end, jumps = flown(START, LENGTH)
    assert jumps >= 2
    np.testing.assert_allclose(found.x, end, atol=1e-9)
    step = 1e-5
    columns = [
        (flown(START + step * e, LENGTH)[0] - flown(START - step * e, LENGTH)[0]) / (2 * step) for e in np.eye(4)
    ]
    np.testing.assert_allclose(found.matrix, np.transpose(columns), atol=3e-6 * np.max(np.abs(found.matrix)))


def test_the_derivative_by_a_parameter_is_finite_and_right():
    def after(r):
        return STRIKE(0.0, jnp.asarray(AT_WALL), ARGS | {"restitution": r})

    slope = jax.jvp(after, (0.7,), (1.0,))[1]
    np.testing.assert_allclose(slope, (after(0.7 + 1e-4) - after(0.7 - 1e-4)) / 2e-4, atol=1e-10)
    assert bool(jnp.all(jnp.isfinite(jax.grad(lambda r: jnp.sum(after(r)))(0.0))))


@pytest.mark.slow
def test_the_derivative_of_a_run_with_impacts():
    def end(r):
        return lh.trajectory(PENDULUM, START, ARGS | {"restitution": r}, t1=LENGTH, n=1, method=METHOD).x[-1]

    slope = jax.jvp(end, (0.7,), (1.0,))[1]
    np.testing.assert_allclose(slope, (end(0.7 + 1e-5) - end(0.7 - 1e-5)) / 2e-5, rtol=1e-5)


@pytest.mark.slow
def test_volumes_of_momenta_shrink_by_the_impacts_alone():
    """det M times the volume in (q, v) is that in (q, p), which only impacts change: by r² each."""
    length, r = 30.0, 0.9
    result = lh.lyapunov_spectrum(
        PENDULUM, START, ARGS | {"restitution": r}, t1=length, method=lh.RungeKutta("rk4", dt=0.01)
    )
    assert result.jumps > 5
    determinants = [np.linalg.det(masses(0.0, x, None)) for x in (jnp.asarray(START), result.x)]
    expected = 2 * np.log(r) * float(result.jumps) + np.log(determinants[0] / determinants[1])
    np.testing.assert_allclose(float(np.sum(result.exponents)) * length, expected, atol=1e-5)
    assert result.sum_rule_residual < 1e-6


# --- bad arguments -------------------------------------------------------------------------------------------------


def gap(t, x, args):
    return x[0]


X = jnp.asarray([0.0, 0.0, 1.0, -1.0])


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: lh.impact(1.0, 0.5, 0.5), r"gap must be a function \(t, x, args\).*got 0.5"),
        (lambda: lh.impact("1", gap, 0.5), r"mass_matrix must be .* got '1'"),
        (lambda: lh.impact(-1.0, gap, 0.5), r"positive definite matrix or a number; got -1.0"),
        (lambda: lh.impact(np.nan, gap, 0.5), r"mass_matrix must be .* got nan"),
        (lambda: lh.impact(np.ones((2, 3)), gap, 0.5), r"mass_matrix must be"),
        (lambda: lh.impact(np.ones((2, 2)), gap, 0.5), r"positive definite"),
        (lambda: lh.impact([[1.0, 0.5], [0.0, 1.0]], gap, 0.5), r"symmetric"),
        (lambda: lh.impact(1.0, gap, 1.5), r"restitution must be between 0 and 1, .* got 1.5"),
        (lambda: lh.impact(1.0, gap, True), r"restitution must be between 0 and 1, .* got True"),
        (lambda: lh.impact(1.0, gap, "0.5"), r"restitution must be .* got '0.5'"),
        (lambda: lh.impact(1.0, gap, np.ones(2)), r"restitution must be .* got array"),
        (lambda: lh.impact(1.0, gap, 0.5)(0.0, X[:3], None), r"wants the state \(q, v\).*got shape \(3,\)"),
        (lambda: lh.impact(np.eye(3), gap, 0.5)(0.0, X, None), r"\(m, m\) = \(2, 2\).*got \(3, 3\)"),
        (lambda: lh.impact(1.0, lambda t, x, args: x, 0.5)(0.0, X, None), r"has 4 contacts: .* which"),
        (lambda: lh.impact(1.0, lambda t, x, args: jnp.eye(2), 0.5)(0.0, X, None), r"scalar or \(c,\); got shape"),
    ],
)
def test_bad_arguments(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_a_mass_matrix_that_is_not_positive_ends_the_run():
    def wall(t, x, args):
        return 1 - x[0]

    reset = lh.impact(lambda t, x, args: -jnp.eye(2), wall, 1.0)
    system = lh.Hybrid(lambda t, x, args: jnp.concatenate([x[2:], 0 * x[2:]]), lh.Transition(wall, reset))
    run = lh.trajectory(system, [0.0, 0.0, 1.0, 0.0], t1=2.0, n=1, throw=False)
    assert run.status == lh.STATUS.nonfinite
