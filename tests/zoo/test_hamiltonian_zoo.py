"""Hamiltonian systems, symplectic maps and Lorenz' ring of the zoo, against equations written out by hand."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import lyaphybrid as lh
from lyaphybrid import zoo

TURN = 2 * math.pi

# Equations of motion in NumPy, each derived on paper: (q, p, parameters) -> (dq/dt, dp/dt).


def by_hand_henon_heiles(q, p, _):
    x, y = q
    return p, np.array([-x - 2 * x * y, -y - x * x + y * y])


def by_hand_hamiltonian_3d(q, p, _):
    omega = np.sqrt([1.0, 2.0, 3.0])
    a, b, c = q
    return omega * p, -omega * q - np.array([2 * a * (b + c), a * a, a * a])


def chain(q, tension):
    """The forces on masses between springs, both ends fixed."""
    pull = tension(np.diff(q, prepend=0.0, append=0.0))
    return pull[1:] - pull[:-1]


def by_hand_fpu_beta(q, p, parameters):
    return p, chain(q, lambda r: r + parameters["beta"] * r**3)


def by_hand_fpu_alpha(q, p, parameters):
    return p, chain(q, lambda r: r + parameters["alpha"] * r**2)


def by_hand_double_pendulum(q, p, parameters):
    """From L = θ₁'² + θ₂'²/2 + θ₁'θ₂' cos(θ₁ − θ₂) + g(2 cos θ₁ + cos θ₂)."""
    g, apart = parameters["gravity"], q[0] - q[1]
    speed = np.linalg.solve([[2, np.cos(apart)], [np.cos(apart), 1]], p)
    drag = speed[0] * speed[1] * np.sin(apart)
    return speed, np.array([-drag - 2 * g * np.sin(q[0]), drag - g * np.sin(q[1])])


def by_hand_kepler(q, p, _):
    return p, -q / np.hypot(*q) ** 3


def by_hand_restricted_three_body(q, p, parameters):
    """x'' − 2y' = x − pull, y'' + 2x' = y − pull, with p = (x' − y, y' + x)."""
    mu, (x, y) = parameters["mu"], q
    u, v = p[0] + y, p[1] - x
    larger, smaller = (1 - mu) / np.hypot(x + mu, y) ** 3, mu / np.hypot(x - 1 + mu, y) ** 3
    ax = 2 * v + x - larger * (x + mu) - smaller * (x - 1 + mu)
    ay = -2 * u + y - (larger + smaller) * y
    return np.array([u, v]), np.array([ax - v, ay + u])


BY_HAND = {name.removeprefix("by_hand_"): f for name, f in globals().items() if name.startswith("by_hand_")}
DRIFTS = {  # of the energy over t = 20 by the problem's own method: a few times what was seen
    "henon_heiles": 2e-8,
    "hamiltonian_3d": 3e-8,
    "fpu_beta": 3e-9,
    "fpu_alpha": 1e-12,
    "double_pendulum": 5e-10,
    "kepler": 1e-9,
    "restricted_three_body": 1e-10,
}
hamiltonian = pytest.mark.parametrize("name", BY_HAND)


@pytest.mark.slow_cases("fpu_beta", "fpu_alpha")
@hamiltonian
def test_the_field_is_that_derived_by_hand(name):
    problem, rng = zoo.get(name)(), np.random.default_rng(5)
    m = problem.x0.shape[0] // 2
    for _ in range(5):
        q, p = rng.uniform(-0.7, 0.7, (2, m))
        expected = np.concatenate(BY_HAND[name](q, p, problem.parameters))
        found = problem.system.field(0.0, jnp.concatenate([q, p]), problem.args)
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)


@pytest.mark.slow
@hamiltonian
def test_the_method_of_the_problem_keeps_its_energy(name):
    problem = zoo.get(name)()
    motion = lh.trajectory(problem.system, problem.x0, problem.args, t1=20.0, n=40, method=problem.method)
    energy = jax.vmap(lambda x: problem.system.energy(x, problem.args))(motion.x)
    assert np.max(np.ptp(motion.x, axis=0)) > 0.1  # it moves
    drift = np.max(np.abs(energy - problem.system.energy(problem.x0, problem.args)))
    assert drift < DRIFTS[name]


@hamiltonian
def test_hamiltonian_problems_start_from_the_paired_frame(name):
    problem = zoo.get(name)()
    assert problem.system.canonical
    shown = "Hamiltonian" if hasattr(problem.system.field, "kinetic") else "Flow"
    assert f"  {shown}, dimension {problem.x0.shape[0]}" in repr(problem)


@pytest.mark.slow
def test_starts_have_the_energy_asked_for_under_vmap_too():
    def energies(value):
        built = [
            zoo.henon_heiles(energy=value),
            zoo.hamiltonian_3d(energy=value),
            zoo.kepler(eccentricity=value),
            zoo.restricted_three_body(jacobi=3 + value),
            zoo.double_pendulum(gravity=value, angle1=0.0, angle2=math.pi),
        ]
        return jnp.stack([problem.system.energy(problem.x0, problem.args) for problem in built])

    values = jnp.array([0.1, 0.15])
    for value, found in zip(values, jax.vmap(energies)(values), strict=True):
        np.testing.assert_allclose(found, [value, value, -0.5, -(3 + value) / 2, -value], atol=1e-14)


# Equilibria and their frequencies, in closed form.


def frequencies(problem, x):
    """ω > 0 of the eigenvalues ±iω at an equilibrium x, ascending."""
    field = problem.system.field(0.0, x, problem.args)
    np.testing.assert_allclose(field, 0, atol=1e-15)
    values = np.linalg.eigvals(jax.jacfwd(lambda x: problem.system.field(0.0, x, problem.args))(x))
    np.testing.assert_allclose(values.real, 0, atol=1e-10)
    return np.sort(values.imag)[len(x) // 2 :]


@pytest.mark.slow
@pytest.mark.parametrize("build", [zoo.fpu_alpha, zoo.fpu_beta])
def test_a_chain_has_the_frequencies_of_its_normal_modes(build):
    n = 12
    expected = 2 * np.sin(np.pi * np.arange(1, n + 1) / (2 * (n + 1)))
    np.testing.assert_allclose(frequencies(build(n=n), jnp.zeros(2 * n)), expected, atol=1e-12)


@pytest.mark.slow
def test_a_chain_of_small_amplitude_swings_in_its_lowest_mode():
    n, amplitude = 5, 1e-7
    problem = zoo.fpu_alpha(n=n, amplitude=amplitude)
    omega = 2 * math.sin(math.pi / (2 * (n + 1)))
    end = lh.trajectory(problem.system, problem.x0, problem.args, t1=20.0, n=1, method=problem.method).x[-1]
    mode = math.sqrt(2 / (n + 1)) * np.sin(np.pi * np.arange(1, n + 1) / (n + 1))
    assert math.isclose(np.linalg.norm(mode), 1)
    expected = np.concatenate([math.cos(20 * omega) * mode, -omega * math.sin(20 * omega) * mode])
    np.testing.assert_allclose(np.asarray(end) / amplitude, expected, atol=1e-6)


@pytest.mark.slow
def test_three_oscillators_and_two_pendulums_have_their_frequencies():
    np.testing.assert_allclose(frequencies(zoo.hamiltonian_3d(), jnp.zeros(6)), np.sqrt([1, 2, 3]), rtol=1e-12)
    hanging = frequencies(zoo.double_pendulum(gravity=3.0), jnp.zeros(4))
    np.testing.assert_allclose(hanging**2, 3 * (2 + np.sqrt(2) * np.array([-1, 1])), rtol=1e-12)


@pytest.mark.slow
def test_motion_about_the_triangular_point_has_its_frequencies():
    mu = 0.0121505856
    x, y = 0.5 - mu, math.sqrt(3) / 2
    found = frequencies(zoo.restricted_three_body(mu=mu), jnp.array([x, y, -y, x]))
    root = math.sqrt(1 - 27 * mu * (1 - mu))
    np.testing.assert_allclose(found**2, [(1 - root) / 2, (1 + root) / 2], rtol=1e-12)


# Kepler's ellipse.


@pytest.mark.slow
@pytest.mark.parametrize("eccentricity", [0.0, 0.6])
def test_the_ellipse_closes_after_one_period(eccentricity):
    problem = zoo.kepler(eccentricity=eccentricity)
    motion = lh.trajectory(problem.system, problem.x0, t1=TURN, n=2, method=problem.method)
    half, whole = np.asarray(motion.x)
    ratio = math.sqrt((1 - eccentricity) / (1 + eccentricity))
    np.testing.assert_allclose(half, [-1 - eccentricity, 0, 0, -ratio], atol=5e-8)  # the apocentre
    np.testing.assert_allclose(whole, problem.x0, atol=5e-8)


@pytest.mark.slow
def test_the_angular_momentum_is_kept_to_rounding():
    problem = zoo.kepler()
    motion = lh.trajectory(problem.system, problem.x0, t1=20 * TURN, n=100, method=problem.method)
    x, y, u, v = np.asarray(motion.x).T
    np.testing.assert_allclose(x * v - y * u, math.sqrt(1 - 0.6**2), rtol=0, atol=2e-14)


@pytest.mark.slow
def test_exponents_of_kepler_decay_like_those_of_periodic_motion():
    """The period depends on the energy: a tangent grows like t, so λ_1(t) ≈ ln t / t."""
    for t in (100 * TURN, 1000 * TURN):
        found = zoo.kepler().spectrum(t1=t, count_start=True).exponents
        assert 0.5 * math.log(t) / t < found[0] < 3 * math.log(t) / t
        np.testing.assert_allclose(found + np.flip(found), 0, atol=1e-9)


# The restricted problem of three bodies, the double pendulum.


def test_the_jacobi_constant_of_velocities_is_kept():
    problem = zoo.restricted_three_body()
    mu = problem.args["mu"]
    motion = lh.trajectory(problem.system, problem.x0, problem.args, t1=500.0, n=2000)
    x, y, a, b = np.asarray(motion.x).T
    u, v = a + y, b - x
    larger, smaller = np.hypot(x + mu, y), np.hypot(x - 1 + mu, y)
    constant = x * x + y * y + 2 * (1 - mu) / larger + 2 * mu / smaller - u * u - v * v
    np.testing.assert_allclose(constant, 3.19, rtol=0, atol=1e-8)
    assert np.max(larger) < 0.8369 + mu  # does not pass the equilibrium between the bodies
    assert np.min(larger) > 0.05  # nor collide


@pytest.mark.slow
@pytest.mark.parametrize(("name", "least"), [("restricted_three_body", 0.01), ("double_pendulum", 0.2)])
def test_the_default_motion_is_chaotic(name, least):
    found = zoo.get(name)().spectrum(t1=3000.0)
    assert found.exponents[0] > least
    assert found.exponents[0] > 2 * found.stderr[0]
    np.testing.assert_allclose(found.exponents + np.flip(found.exponents), 0, atol=1e-7)


# Symplectic maps.

MAPS = [zoo.froeschle_map(), *(zoo.coupled_standard_maps(n=n) for n in (2, 3, 6))]
maps = pytest.mark.parametrize("problem", MAPS, ids=lambda p: f"{p.name}{p.x0.shape[0]}")


def by_hand_map(problem, x):
    """One iteration, element by element."""
    m = len(x) // 2
    q, p, a = list(x[:m]), list(x[m:]), problem.args
    for i in range(m):
        if problem.name == "froeschle_map":
            p[i] += a[f"K{i + 1}"] * math.sin(q[i]) + a["coupling"] * math.sin(q[0] + q[1])
        else:
            before, after = q[i - 1], q[(i + 1) % m]
            p[i] += a["K"] * math.sin(q[i]) - a["coupling"] * (math.sin(after - q[i]) + math.sin(before - q[i]))
    return np.array([(a + b) % TURN for a, b in zip(q, p, strict=True)] + [b % TURN for b in p])


@maps
def test_a_map_is_that_written_by_hand(problem):
    rng = np.random.default_rng(3)
    for _ in range(5):
        x = rng.uniform(0, TURN, problem.x0.shape)
        found = problem.system.rule(0.0, jnp.asarray(x), problem.args)
        np.testing.assert_allclose(found, by_hand_map(problem, x), atol=1e-12)


@pytest.mark.slow_cases("coupled_standard_maps12", "coupled_standard_maps6")
@maps
def test_a_map_is_symplectic(problem):
    m = problem.x0.shape[0] // 2
    omega = np.block([[np.zeros((m, m)), np.eye(m)], [-np.eye(m), np.zeros((m, m))]])
    for x in np.random.default_rng(4).uniform(0, TURN, (5, 2 * m)):
        jacobian = np.asarray(jax.jacfwd(lambda x: problem.system.rule(0.0, x, problem.args))(jnp.asarray(x)))
        assert np.max(np.abs(jacobian)) > 1
        np.testing.assert_allclose(jacobian.T @ omega @ jacobian, omega, atol=1e-13)


@pytest.mark.slow
@maps
def test_exponents_of_a_map_come_in_pairs(problem):
    found = problem.spectrum(t1=2000)
    assert np.all(found.exponents[: len(found.exponents) // 2] > 0.05)
    np.testing.assert_allclose(found.exponents + np.flip(found.exponents), 0, atol=1e-10)
    assert f"  Map, dimension {len(found.exponents)}" in repr(problem)


@pytest.mark.slow
@pytest.mark.parametrize(
    "problem", [zoo.froeschle_map(K1=6.9115, K2=6.9115, coupling=0), zoo.coupled_standard_maps(K=6.9115, coupling=0)]
)
def test_maps_without_coupling_are_standard_maps(problem):
    m = problem.x0.shape[0] // 2
    alone = zoo.standard_map()
    pairs = jax.vmap(lambda x: alone.system.rule(0.0, x, alone.args))(problem.x0.reshape(2, m).T)
    np.testing.assert_allclose(problem.system.rule(0.0, problem.x0, problem.args), pairs.T.ravel(), atol=1e-14)
    found = problem.spectrum(t1=50_000)
    sum_of_positive = float(jnp.sum(found.exponents[:m]))
    error = float(jnp.linalg.norm(found.stderr[:m]))
    assert error < 0.02 * m
    assert abs(sum_of_positive - m * alone.reference.exponents[0]) < 5 * error


# Lorenz' ring.


def test_the_ring_of_lorenz_is_that_written_by_hand():
    n, forcing = 7, 5.5
    x = np.random.default_rng(6).normal(size=n)
    expected = [(x[(i + 1) % n] - x[i - 2]) * x[i - 1] - x[i] + forcing for i in range(n)]
    problem = zoo.lorenz96(n=n, forcing=forcing)
    np.testing.assert_allclose(problem.system.field(0.0, jnp.asarray(x), problem.args), expected, rtol=1e-13)


@pytest.mark.slow
def test_the_fixed_point_of_the_ring_has_the_eigenvalues_of_waves():
    n, forcing = 9, 8.0
    problem, at = zoo.lorenz96(n=n, forcing=forcing), jnp.full(n, forcing)
    np.testing.assert_array_equal(problem.system.field(0.0, at, problem.args), np.zeros(n))
    jacobian = jax.jacfwd(lambda x: problem.system.field(0.0, x, problem.args))(at)
    phase = np.exp(1j * TURN * np.arange(n) / n)
    expected = forcing * (phase - phase**-2) - 1
    distances = np.abs(np.linalg.eigvals(jacobian)[:, None] - expected)
    assert max(distances.min(axis=0).max(), distances.min(axis=1).max()) < 1e-12


@pytest.mark.slow
def test_exponents_of_the_ring_sum_to_minus_n():
    found = zoo.lorenz96(n=8).spectrum(t1=50.0)
    assert found.exponents[0] > 0.5
    assert abs(float(jnp.sum(found.exponents)) + 8) < 1e-10


@pytest.mark.slow
def test_the_ring_of_forty_has_the_exponent_and_the_dimension_of_the_literature():
    """About 1.7 and 27.1: A. Karimi & M. R. Paul, Chaos 20 (2010) 043105, doi:10.1063/1.3496397."""
    found = zoo.lorenz96().spectrum(t1=200.0)
    assert found.stderr[0] < 0.08
    assert abs(found.exponents[0] - 1.68) < 5 * found.stderr[0]
    assert abs(found.kaplan_yorke_dimension() - 27.1) < 0.4
    assert abs(float(jnp.sum(found.exponents)) + 40) < 1e-9
