"""Orbits that are not alone: families by what is conserved, and orbits that close modulo a symmetry."""

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
import scipy.optimize
import scipy.special
from numpy.testing import assert_allclose

import lyaphybrid as lh

PENDULUM = lh.Hamiltonian(lambda p, args: jnp.sum(p**2) / 2, lambda q, args: -jnp.sum(jnp.cos(q)))
FULL_TURN = jnp.array([2 * jnp.pi, 0.0])


def swing_period(energy):
    return 4 * scipy.special.ellipk((energy + 1) / 2)


def rotation_period(energy):
    return 4 / np.sqrt(2 * (energy + 1)) * scipy.special.ellipk(2 / (energy + 1))


def energy_of(system, x, args=None):
    return float(system.energy(jnp.asarray(x), args))


def van_der_pol(t, x, mu):
    return jnp.stack([x[1], mu * (1 - x[0] ** 2) * x[1] - x[0]])


# Families.


@pytest.mark.slow_cases("start0-1")
@pytest.mark.parametrize("segments", [1, 3])
@pytest.mark.parametrize("start", [[1.0, 0.3], [2.5, 0.1], [0.1, 0.05]])
def test_a_pendulum_keeps_its_energy(start, segments):
    energy = energy_of(PENDULUM, start)
    orbit = lh.floquet(PENDULUM, start, conserve=True, segments=segments)
    assert abs(energy_of(PENDULUM, orbit.x0) - energy) < 1e-10
    assert orbit.period == pytest.approx(swing_period(energy), rel=1e-9)
    assert_allclose(orbit.multipliers, [1.0, 1.0], atol=0)
    assert orbit.family == 1
    assert orbit.notes == {"family"}
    assert orbit.stability == "neutral"
    assert not orbit.stable
    assert "one of a family" in str(orbit)


def test_without_conserve_it_says_that_there_is_a_family_and_that_the_energy_moved():
    orbit = lh.floquet(PENDULUM, [2.5, 0.3])
    assert orbit.family == 1
    assert orbit.stability == "neutral"
    assert orbit.period == pytest.approx(swing_period(energy_of(PENDULUM, orbit.x0)), rel=1e-9)
    moved = abs(energy_of(PENDULUM, orbit.x0) - energy_of(PENDULUM, [2.5, 0.3]))
    assert moved > 1e-4
    assert orbit.notes == {"family", "moved"}
    assert "conserve=True keeps it" in str(orbit)


def test_of_a_period_that_is_given_too():
    orbit = lh.floquet(PENDULUM, [2.0, 0.0], period=swing_period(-np.cos(1.5)))
    assert energy_of(PENDULUM, orbit.x0) == pytest.approx(-np.cos(1.5), abs=1e-9)


@pytest.mark.slow
def test_henon_heiles_on_its_axis():
    """Along y the motion is that of one degree of freedom; across, x'' = −(1 + 2y) x, Hill's equation."""
    system, stabilities = lh.zoo.henon_heiles().system, []
    for energy in (0.03, 0.12, 0.16):
        top = np.sort(np.roots([-2 / 3, 1, 0, -2 * energy]).real)[1]

        def hill(t, state):
            y, p, a, b, c, d = state
            return [p, -y + y**2, b, -(1 + 2 * y) * a, d, -(1 + 2 * y) * c]

        def bottom(t, state):
            return state[1]

        bottom.direction = 1.0
        options = {"method": "DOP853", "rtol": 1e-13, "atol": 1e-14}
        half = scipy.integrate.solve_ivp(hill, (0, 30), [top, 0, 1, 0, 0, 1], events=bottom, **options)
        period = 2 * next(t for t in half.t_events[0] if t > 1e-3)
        a, b, c, d = scipy.integrate.solve_ivp(hill, (0, period), [top, 0, 1, 0, 0, 1], **options).y[2:, -1]
        across = np.linalg.eigvals(np.array([[a, c], [b, d]]).astype(complex))
        orbit = lh.floquet(system, [0.0, top - 0.02, 0.0, np.sqrt(0.04 * (top - top**2))], conserve=True)
        wanted = energy_of(system, [0.0, top - 0.02, 0.0, np.sqrt(0.04 * (top - top**2))])
        assert abs(energy_of(system, orbit.x0) - wanted) < 1e-10
        exact = lh.floquet(system, [0.0, top, 0.0, 0.0], conserve=True)
        assert exact.period == pytest.approx(period, rel=1e-9)
        expected = np.concatenate([[1.0, 1.0], across])
        assert_allclose(_sorted(exact.multipliers), _sorted(expected), atol=1e-8)
        assert exact.family == 1
        assert (exact.stability == "unstable") == (abs(a + d) > 2)
        stabilities.append(exact.stability)
    assert set(stabilities) <= {"elliptic", "unstable"}
    assert "elliptic" in stabilities


def _sorted(values):
    return np.sort_complex(np.round(np.asarray(values, complex), 10))


def kepler(t, x, args):
    return jnp.concatenate([x[2:], -x[:2] / jnp.sum(x[:2] ** 2) ** 1.5])


def kepler_energy(x, args):
    return jnp.sum(x[2:] ** 2) / 2 - 1 / jnp.sqrt(jnp.sum(x[:2] ** 2))


def momentum(x, args):
    return x[0] * x[3] - x[1] * x[2]


@pytest.mark.slow
def test_kepler_orbits_are_a_family_of_three_parameters():
    both = lambda x, args: jnp.stack([kepler_energy(x, args), momentum(x, args)])  # noqa: E731
    start = jnp.array([1.0, 0.1, -0.2, 1.1])
    for conserve in (kepler_energy, both):
        orbit = lh.floquet(lh.Flow(kepler), start, conserve=conserve)
        energy = float(kepler_energy(start, None))
        assert orbit.period == pytest.approx(2 * np.pi * (-2 * energy) ** -1.5, rel=1e-10)
        assert abs(float(kepler_energy(orbit.x0, None)) - energy) < 1e-10
        assert orbit.family == 3
        assert_allclose(orbit.multipliers, np.ones(4), atol=0)
        assert orbit.stability == "neutral"
    assert abs(float(momentum(orbit.x0, None) - momentum(start, None))) < 1e-10


BALL = lh.Hybrid(
    lambda t, x, args: jnp.stack([x[1], -args["g"] + 0 * x[0]]),
    lh.Transition(lambda t, x, args: x[0], lambda t, x, args: jnp.stack([x[0], -args["r"] * x[1]])),
)


def height(x, args):
    return args["g"] * x[0] + x[1] ** 2 / 2


@pytest.mark.slow
def test_an_elastic_ball():
    orbit = lh.floquet(BALL, [0.7, 0.3], {"g": 9.81, "r": 1.0}, conserve=height)
    speed = np.sqrt(2 * 9.81 * 0.7 + 0.09)
    assert orbit.period == pytest.approx(2 * speed / 9.81, abs=1e-11)
    assert orbit.jumps == 1
    assert orbit.family == 1
    assert orbit.stability == "neutral"
    assert float(height(orbit.x0, {"g": 9.81})) == pytest.approx(speed**2 / 2, abs=1e-10)


@pytest.mark.slow
def test_forced_orbits_are_judged_by_the_circle_not_by_rounding():
    mathieu = lh.Flow(lambda t, x, args: jnp.stack([x[1], -(args[0] + args[1] * jnp.cos(t)) * x[0]]))
    for args, stability in (((0.6, 0.1), "elliptic"), ((0.25, 0.3), "unstable")):
        orbit = lh.floquet(mathieu, [0.0, 0.0], jnp.array(args), period=2 * np.pi)
        assert orbit.stability == stability
        assert orbit.family == 0
        assert abs(np.prod(np.asarray(orbit.multipliers)) - 1) < 1e-9


@pytest.mark.slow
def test_a_block_that_may_lie_anywhere():
    problem = lh.zoo.block_on_plate()
    orbit = lh.floquet(problem.system, problem.x0, problem.args, period=2 * np.pi)
    assert orbit.family == 1
    assert orbit.stability == "stable"
    assert complex(orbit.multipliers[0]) == 1.0
    assert_allclose(orbit.exponents, [0.0, -0.22551868844396014], atol=1e-10)


def test_a_fold_is_no_family():
    """x² + 1/4 touches the diagonal at 1/2."""
    orbit = lh.floquet(lh.Map(lambda n, x, args: x**2 + 0.25), [0.501], period=1, max_iterations=60)
    assert abs(complex(orbit.multipliers[0]) - 1) < 1e-6
    assert orbit.family == 0
    assert orbit.notes == frozenset()


# Modulo a symmetry.


@pytest.mark.parametrize("segments", [1, 3])
def test_a_pendulum_that_goes_round(segments):
    start = [0.3, 2.5]
    orbit = lh.floquet(PENDULUM, start, conserve=True, modulo=lambda x: x + FULL_TURN, segments=segments)
    assert orbit.period == pytest.approx(rotation_period(energy_of(PENDULUM, start)), rel=1e-10)
    assert abs(energy_of(PENDULUM, orbit.x0) - energy_of(PENDULUM, start)) < 1e-10
    assert orbit.family == 1
    assert orbit.shift.shape == (0,)


@pytest.mark.slow
@pytest.mark.parametrize("segments", [1, 3])
def test_a_component_that_grows(segments):
    """Beside a van der Pol oscillator something moves on: by T in a period, as the velocity's mean is 0."""

    def field(t, x, mu):
        return jnp.concatenate([van_der_pol(t, x[:2], mu), 1 + 0.3 * x[1:2]])

    alone = lh.floquet(lh.Flow(van_der_pol), [2.0, 0.0], 1.0)
    orbit = lh.floquet(lh.Flow(field), [2.0, 0.0, 5.0], 1.0, modulo=2, segments=segments, transient=20.0)
    assert orbit.period == pytest.approx(alone.period, rel=1e-10)
    assert_allclose(orbit.shift, [orbit.period], rtol=1e-10)
    assert_allclose(orbit.multipliers, [1.0, 1.0, alone.multipliers[1].real], atol=1e-9)
    assert orbit.stable
    assert orbit.family == 0
    end = lh.trajectory(lh.Flow(field), orbit.x0, 1.0, t1=orbit.period, method=lh.RungeKutta(rtol=1e-12)).x[-1]
    assert_allclose(end, orbit.x0 + jnp.array([0.0, 0.0, orbit.period]), atol=1e-9)


def test_half_a_turn_and_a_mirror():
    whole = lh.floquet(lh.Flow(van_der_pol), [2.0, 0.0], 1.0)
    half = lh.floquet(lh.Flow(van_der_pol), [2.0, 0.0], 1.0, modulo=lambda x: -x)
    assert 2 * half.period == pytest.approx(whole.period, rel=1e-11)
    assert_allclose(np.asarray(half.multipliers) ** 2, whole.multipliers, atol=1e-9)
    assert_allclose(half.exponents, whole.exponents, atol=1e-9)


# A mass in V(r) = −1/r + b/2r²: Kepler's motion with L² + b for L², so that it precesses.
EXTRA = 0.3


def precessing(t, x, b):
    r2 = jnp.sum(x[:2] ** 2)
    return jnp.concatenate([x[2:], x[:2] * (b / r2**2 - 1 / r2**1.5)])


def energy_there(x, b):
    return kepler_energy(x, None) + b / (2 * jnp.sum(x[:2] ** 2))


def turned(x, angle):
    cosine, sine = jnp.cos(angle), jnp.sin(angle)
    turn = jnp.array([[cosine, -sine], [sine, cosine]])
    return jnp.concatenate([turn @ x[:2], turn @ x[2:]])


@pytest.mark.slow
@pytest.mark.parametrize("segments", [1, 2])
def test_an_orbit_that_precesses(segments):
    start = jnp.array([1.0, 0.2, -0.1, 1.2])
    both = lambda x, b: jnp.stack([energy_there(x, b), momentum(x, b)])  # noqa: E731
    orbit = lh.floquet(lh.Flow(precessing), start, EXTRA, conserve=both, modulo=turned, segments=segments)
    energy, spin = np.asarray(both(start, EXTRA))
    assert_allclose(both(orbit.x0, EXTRA), [energy, spin], atol=1e-10)
    assert orbit.period == pytest.approx(2 * np.pi * (-2 * energy) ** -1.5, rel=1e-10)
    assert_allclose(orbit.shift, 2 * np.pi * spin / np.sqrt(spin**2 + EXTRA), rtol=1e-9)
    assert_allclose(orbit.multipliers, np.ones(4), atol=1e-12)
    assert orbit.family == 2


@pytest.mark.slow
def test_a_circle_modulo_a_turn_that_is_known():
    """A relative equilibrium: over the angle φ its neighbours oscillate by √(L² + b)/L φ."""
    angle, spin = 1.0, np.sqrt(1 - EXTRA)  # r = L² + b = 1
    orbit = lh.floquet(
        lh.Flow(precessing),
        [1.0, 0.0, 0.0, spin],
        EXTRA,
        modulo=lambda x: turned(x, jnp.asarray(angle)),
        conserve=momentum,
    )
    assert orbit.period == pytest.approx(angle / spin, rel=1e-10)
    expected = np.exp(np.array([0, 0, 1j, -1j]) * angle / spin)
    assert_allclose(_sorted(orbit.multipliers), _sorted(expected), atol=1e-8)
    assert orbit.stability == "elliptic"
    assert orbit.family == 1
    with pytest.raises(lh.NoPeriodicOrbitError, match="moves along the group alone"):
        lh.floquet(lh.Flow(precessing), [1.0, 0.0, 0.0, spin], EXTRA, modulo=turned, conserve=momentum)


def test_a_map_on_the_plane_that_covers_its_cylinder():
    """The standard map at p = 2π goes round once in an iteration, and has the trace 2 + K cos θ."""
    kick = 0.9

    def rule(n, x, args):
        p = x[1] + args * jnp.sin(x[0])
        return jnp.stack([x[0] + p, p])

    for theta, stability in ((0.0, "unstable"), (np.pi, "elliptic")):
        start = [theta + 0.05, 2 * np.pi - 0.03]
        orbit = lh.floquet(lh.Map(rule), start, kick, period=1, modulo=lambda x: x + FULL_TURN)
        assert_allclose(orbit.x0, [theta, 2 * np.pi], atol=1e-12)
        assert np.sum(np.asarray(orbit.multipliers)).real == pytest.approx(2 + kick * np.cos(theta), abs=1e-12)
        assert orbit.stability == stability


# A runner: a mass on a spring that swings forward in flight to a fixed angle. State (x, y, x', y', foot).
G, STIFFNESS, LENGTH, ANGLE = 9.81, 250.0, 1.0, np.deg2rad(68.0)


def _leg(x):
    return jnp.stack([x[0] - x[4], x[1]])


def stance(t, x, args):
    leg = _leg(x)
    length = jnp.sqrt(jnp.sum(leg**2))
    force = args["k"] * (LENGTH / length - 1) * leg
    return jnp.stack([x[2], x[3], force[0], force[1] - G, 0 * x[4]])


def flight(t, x, args):
    return jnp.stack([x[2], x[3], 0 * x[0], -G + 0 * x[0], 0 * x[0]])


RUNNER = lh.Hybrid(
    {"rise": flight, "fall": flight, "stance": stance},
    [
        lh.Transition(lambda t, x, args: x[3], source="rise", target="fall"),
        lh.Transition(
            lambda t, x, args: x[1] - LENGTH * jnp.sin(ANGLE),
            lambda t, x, args: x.at[4].set(x[0] + LENGTH * jnp.cos(ANGLE)),
            source="fall",
            target="stance",
        ),
        lh.Transition(lambda t, x, args: LENGTH - jnp.sqrt(jnp.sum(_leg(x) ** 2)), source="stance", target="rise"),
    ],
)


def flight_energy(x, args):
    return G * x[1] + (x[2] ** 2 + x[3] ** 2) / 2


def stance_energy(x, args):
    return flight_energy(x, args) + args["k"] / 2 * (LENGTH - jnp.sqrt(jnp.sum(_leg(x) ** 2))) ** 2


def stepped(x, s):
    return x + s * jnp.array([1.0, 0.0, 0.0, 0.0, 1.0])


def step(apex, energy):
    """From an apex to the next by SciPy: its height, and the time and way between."""
    speed, touch = np.sqrt(2 * (energy - G * apex)), LENGTH * np.sin(ANGLE)
    fall = np.sqrt(2 * (apex - touch) / G)
    foot = LENGTH * np.cos(ANGLE)

    def field(t, x):
        length = np.hypot(x[0], x[1])
        force = STIFFNESS * (LENGTH / length - 1)
        return [x[2], x[3], force * x[0], force * x[1] - G]

    def off(t, x):
        return np.hypot(x[0], x[1]) - LENGTH if t > 1e-3 else -1.0

    off.terminal, off.direction = True, 1.0
    start = [-foot, touch, speed, -G * fall]
    run = scipy.integrate.solve_ivp(field, (0, 1), start, "DOP853", events=off, rtol=1e-13, atol=1e-14)
    x, y, vx, vy = run.y_events[0][0]
    rise = vy / G
    way = speed * fall + foot + x + vx * rise
    return y + vy**2 / (2 * G), fall + run.t_events[0][0] + rise, way


@pytest.mark.slow
@pytest.mark.parametrize("segments", [1, 2])
def test_a_runner(segments):
    args, energy = {"k": STIFFNESS}, G * 1.0 + 12.5
    apex = scipy.optimize.brentq(lambda y: step(y, energy)[0] - y, 0.93, 1.0, xtol=1e-14)
    _, period, way = step(apex, energy)
    multiplier = (step(apex + 1e-5, energy)[0] - step(apex - 1e-5, energy)[0]) / 2e-5
    start = jnp.array([3.0, 0.95, np.sqrt(2 * (energy - G * 0.95)), 0.0, 2.0])
    energies = {"rise": flight_energy, "fall": flight_energy, "stance": stance_energy}
    options = {"mode": "fall", "modulo": stepped, "segments": segments}
    orbit = lh.floquet(RUNNER, start, args, conserve=energies, **options)
    assert abs(float(energies[RUNNER.mode_names[orbit.mode]](orbit.x0, args)) - energy) < 1e-10
    assert orbit.period == pytest.approx(period, rel=1e-9)
    assert_allclose(orbit.shift, way, rtol=1e-9)
    assert_allclose(orbit.multipliers, sorted([1, 1, 1, multiplier, 0], key=abs, reverse=True), atol=1e-6)
    assert orbit.family == 1
    assert orbit.stability == ("stable" if abs(multiplier) < 1 else "unstable")


# What is wrong is refused.


@pytest.mark.slow_cases(
    "options3-a quantity that the motion conserves; got one that changes", "options5-changes at the rate"
)
@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"conserve": "energy"}, "conserve must be True, a function"),
        ({"conserve": True}, r"conserve=True needs an lh\.Hamiltonian"),
        ({"conserve": {"fly": height}}, r"unknown modes \['fly'\]"),
        ({"conserve": lambda x, args: x}, "a quantity that the motion conserves; got one that changes"),
        ({"conserve": lambda x, args: jnp.zeros(())}, "derivative is 0 at x0"),
        ({"conserve": lambda x, args: x[0] + x[1] ** 2}, "changes at the rate"),
        ({"modulo": "x"}, "modulo must be a component"),
        ({"modulo": True}, "modulo must be a component"),
        ({"modulo": 2}, "components of x go from 0 to 1"),
        ({"modulo": (0, 0)}, "may be named once"),
        ({"modulo": lambda x, s, a: x}, r"other arguments than \(x\)"),
        ({"modulo": lambda x: x[:1]}, "must return a state like x"),
        ({"modulo": lambda x: x * jnp.array([1.0, 0.0])}, "possible to undo"),
        ({"modulo": lambda x, s: x + 1 + s}, r"g\(x, 0\) must be x"),
        ({"modulo": lambda x, s: x * 1}, "must move x with s"),
        ({"modulo": 1}, "must be a symmetry of the system"),
    ],
)
def test_what_is_wrong_is_refused(options, says):
    with pytest.raises(ValueError, match=says):
        lh.floquet(BALL, [0.7, 0.3], {"g": 9.81, "r": 1.0}, **options)


def test_impacts_that_lose_energy_are_named():
    with pytest.raises(ValueError, match="changed by the jump of transition 0"):
        lh.floquet(BALL, [0.7, 0.3], {"g": 9.81, "r": 0.999}, conserve=height, period=1.0)


@pytest.mark.slow
def test_jumps_that_are_not_symmetric_are_found():
    """The field does not see where it is, and a turn closes; but the next is longer."""
    slower = lh.Hybrid(
        lambda t, x, args: jnp.stack([1 + 0 * x[0], -1 + 0 * x[0]]),
        lh.Transition(lambda t, x, args: x[1], lambda t, x, args: jnp.stack([x[0], 1 + args * x[0]])),
    )
    assert lh.floquet(slower, [0.0, 0.5], 0.0, modulo=0).shift[0] == pytest.approx(1.0, abs=1e-12)
    with pytest.raises(lh.NoPeriodicOrbitError, match="is not repeated"):
        lh.floquet(slower, [0.0, 0.5], 0.01, modulo=0)


# Continuation.


@pytest.mark.slow
def test_the_family_of_a_pendulum_is_followed_in_its_energy():
    branch = lh.continuation(PENDULUM, [1.0, 0.0], None, over=(-0.9, 0.9), conserve=True, step=0.2)
    assert branch.ends == ("range", "range")
    assert branch.specials == ()
    assert_allclose(branch.period, swing_period(branch.values), rtol=1e-9)
    energies = [energy_of(PENDULUM, orbit.x0) for orbit in branch.orbits]
    assert_allclose(energies, branch.values, atol=1e-9)
    assert_allclose(branch.values[[0, -1]], [-0.9, 0.9], atol=1e-12)
    assert all(orbit.family == 1 for orbit in branch.orbits)


@pytest.mark.slow
def test_a_parameter_changes_while_the_energy_is_kept():
    """p²/2 − g cos q at energy 0: the swing ends at q = π/2 whatever g is, and T ~ g^(−1/2)."""
    system = lh.Hamiltonian(lambda p, g: jnp.sum(p**2) / 2, lambda q, g: -g * jnp.sum(jnp.cos(q)))
    branch = lh.continuation(system, [jnp.pi / 2, 0.0], 1.0, over={"args": (0.5, 2.0)}, conserve=True, step=0.2)
    assert branch.ends == ("range", "range")
    assert_allclose(branch.period, swing_period(0.0) / np.sqrt(branch.values), rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("segments", [1, 2])
def test_a_branch_modulo_a_group(segments):
    def field(t, x, mu):
        return jnp.concatenate([van_der_pol(t, x[:2], mu), mu + 0.3 * x[1:2]])

    branch = lh.continuation(
        lh.Flow(field), [2.0, 0.0, 0.0], 1.0, over={"args": (0.5, 1.5)}, modulo=2, step=0.2, segments=segments
    )
    assert branch.ends == ("range", "range")
    assert branch.specials == ()
    for value, orbit in zip(branch.values, branch.orbits, strict=True):
        assert_allclose(orbit.shift, [value * orbit.period], rtol=1e-8)
        assert orbit.stable


@pytest.mark.slow
def test_the_axis_of_henon_heiles_is_followed_in_its_energy():
    system = lh.zoo.henon_heiles().system
    branch = lh.continuation(system, [0.0, 0.4, 0.0, 0.0], None, over=(0.05, 0.12), conserve=True, step=0.3)
    assert branch.ends == ("range", "range")
    for energy, orbit in zip(branch.values, branch.orbits, strict=True):
        top = np.sort(np.roots([-2 / 3, 1, 0, -2 * energy]).real)[1]
        alone = lh.floquet(system, [0.0, top, 0.0, 0.0], conserve=True)
        assert orbit.period == pytest.approx(alone.period, rel=1e-8)
        assert_allclose(_sorted(orbit.multipliers), _sorted(alone.multipliers), atol=1e-6)


@pytest.mark.parametrize(
    ("conserve", "says"), [(None, "give conserve too"), (lambda x, args: x, "must then be one number")]
)
def test_bad_arguments_of_continuation(conserve, says):
    with pytest.raises(ValueError, match=says):
        lh.continuation(PENDULUM, [1.0, 0.0], None, over=(-0.9, 0.9), conserve=conserve)


def test_pairs_that_stay_on_the_circle_have_no_torus_bifurcations():
    """Two coupled oscillators along the energy: |μ| − 1 is rounding, and changes its sign as that does."""
    pair = lh.Hamiltonian(
        lambda p, a: jnp.sum(p**2) / 2, lambda q, a: q[0] ** 2 / 2 + q[1] ** 2 + 0.3 * (q[0] * q[1]) ** 2
    )
    branch = lh.continuation(pair, [0.5, 0.0, 0.0, 0.0], over=(0.05, 1.0), conserve=True)
    assert branch.specials == ()
    assert all(np.max(np.abs(np.abs(orbit.multipliers) - 1)) < 1e-9 for orbit in branch.orbits)
