"""Disordered lattices, and splittings of three parts: exact motion, other integrators, finite differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
from numpy.testing import assert_allclose

import lyaphybrid as lh
from lyaphybrid import zoo
from lyaphybrid.zoo.hamiltonian.lattices import THREE_PARTS

both = pytest.mark.parametrize("name", ["klein_gordon", "schroedinger_lattice"])


def end(problem, t1, method=None, x0=None):
    x0 = problem.x0 if x0 is None else x0
    found = lh.trajectory(problem.system, x0, problem.args, t1=t1, n=1, method=method or problem.method)
    return np.asarray(found.x[-1])


# Written out, site by site.


def klein_gordon_by_hand(q, p, args):
    n, w = len(q), args["disorder"]
    u = np.concatenate([[0.0], q, [0.0]])
    force = [
        -args["stiffness"][i] * q[i] - args["nonlinearity"] * q[i] ** 3 + (u[i + 2] - 2 * u[i + 1] + u[i]) / w
        for i in range(n)
    ]
    return np.concatenate([p, force])


def schroedinger_by_hand(q, p, args):
    """i ψ' = ε ψ + β |ψ|² ψ − ψ_{l+1} − ψ_{l−1}."""
    psi = np.concatenate([[0.0], (q + 1j * p) / np.sqrt(2), [0.0]])
    rate = [
        (args["disorder"] * args["levels"][i] + args["nonlinearity"] * abs(psi[i + 1]) ** 2) * psi[i + 1]
        - psi[i + 2]
        - psi[i]
        for i in range(len(q))
    ]
    rate = -1j * np.sqrt(2) * np.array(rate)
    return np.concatenate([rate.real, rate.imag])


@both
def test_the_field_is_that_written_out(name):
    problem, rng = zoo.get(name)(n=9, seed=4, nonlinearity=0.7, disorder=3.0), np.random.default_rng(1)
    q, p = rng.uniform(-1, 1, (2, 9))
    expected = {"klein_gordon": klein_gordon_by_hand, "schroedinger_lattice": schroedinger_by_hand}[name]
    found = problem.system.field(0.0, jnp.concatenate([q, p]), problem.args)
    assert_allclose(found, expected(q, p, problem.args), rtol=0, atol=1e-14)


def test_disorder_is_drawn_from_its_interval():
    levels, stiffness = zoo.schroedinger_lattice().args["levels"], zoo.klein_gordon().args["stiffness"]
    assert levels.shape == stiffness.shape == (256,)
    assert -0.5 <= levels.min() < -0.48 < 0.48 < levels.max() <= 0.5
    assert 0.5 <= stiffness.min() < 0.52 < 1.48 < stiffness.max() <= 1.5
    assert np.any(zoo.klein_gordon(seed=1).args["stiffness"] != stiffness)


# Without the quartic part the motion is known.


def test_linear_oscillators_move_as_their_normal_modes():
    n, t = 200, 50.0
    problem = zoo.klein_gordon(n=n, nonlinearity=0.0)
    matrix = np.diag(problem.args["stiffness"] + 2 / 4.0) - (np.eye(n, k=1) + np.eye(n, k=-1)) / 4.0
    squares, modes = scipy.linalg.eigh(matrix)
    omega, p0 = np.sqrt(squares), modes.T @ np.asarray(problem.x0)[n:]
    expected = np.concatenate([modes @ (np.sin(omega * t) / omega * p0), modes @ (np.cos(omega * t) * p0)])
    assert_allclose(end(problem, t, lh.Symplectic("SRKN14a", dt=0.1)), expected, rtol=0, atol=1e-9)


@pytest.mark.slow
def test_the_linear_schroedinger_equation_is_an_exponential():
    n, t = 200, 20.0
    problem = zoo.schroedinger_lattice(n=n, nonlinearity=0.0)
    matrix = np.diag(4.0 * problem.args["levels"]) - np.eye(n, k=1) - np.eye(n, k=-1)
    energies, modes = scipy.linalg.eigh(matrix)
    start = np.asarray(problem.x0)[:n] + 1j * np.asarray(problem.x0)[n:]
    psi = modes @ (np.exp(-1j * energies * t) * (modes.T @ start))
    expected = np.concatenate([psi.real, psi.imag])
    assert_allclose(end(problem, t, lh.Splitting(THREE_PARTS, "SuzukiUmeno8", dt=0.05)), expected, rtol=0, atol=1e-8)


# With it: another integrator, finite differences, what is conserved.


@pytest.mark.slow
@both
def test_motion_and_exponent_are_those_of_runge_kutta(name):
    problem, other = zoo.get(name)(n=40), lh.RungeKutta("dop853", rtol=1e-11, atol=1e-13)
    fine = {
        "klein_gordon": lh.Symplectic("SRKN14a", dt=0.05),
        "schroedinger_lattice": lh.Splitting(THREE_PARTS, "SuzukiUmeno8", dt=0.05),
    }[name]
    ours, theirs = (problem.spectrum(t1=20.0, blocks=2, method=method) for method in (fine, other))
    assert_allclose(ours.x, theirs.x, rtol=0, atol=1e-7)
    assert_allclose(ours.exponents, theirs.exponents, rtol=0, atol=1e-7)


@pytest.mark.slow_cases("schroedinger_lattice")
@both
def test_the_tangent_map_is_the_derivative_of_the_motion(name):
    n, t, small = 12, 5.0, 1e-5
    problem = zoo.get(name)(n=n)
    matrix = np.asarray(lh.tangent_map(problem.system, problem.x0, problem.args, t1=t, method=problem.method).matrix)
    for i in (0, n // 2, n + n // 2, 2 * n - 1):
        step = np.zeros(2 * n)
        step[i] = small
        ends = [end(problem, t, x0=np.asarray(problem.x0) + sign * step) for sign in (1, -1)]
        assert_allclose(matrix[:, i], (ends[0] - ends[1]) / (2 * small), rtol=0, atol=1e-8)
    turn = np.block([[np.zeros((n, n)), np.eye(n)], [-np.eye(n), np.zeros((n, n))]])
    assert_allclose(matrix.T @ turn @ matrix, turn, rtol=0, atol=1e-11)


@pytest.mark.slow
@both
def test_hundreds_of_sites_keep_energy_and_norm(name):
    problem = zoo.get(name)(n=300)
    way = lh.trajectory(problem.system, problem.x0, problem.args, t1=200.0, n=20, method=problem.method).x
    energies = jax.vmap(lambda x: problem.system.energy(x, problem.args))(way)
    assert_allclose(energies, problem.system.energy(problem.x0, problem.args), rtol=0, atol=5e-6)
    assert float(jnp.max(jnp.abs(way[-1] - problem.x0))) > 0.1
    if name == "schroedinger_lattice":
        assert_allclose(jnp.sum(way**2, axis=1) / 2, 1.0, rtol=0, atol=2e-5)


@pytest.mark.slow
def test_three_parts_have_the_order_of_their_scheme():
    """Halving the step divides errors by 2 to the power of the order."""
    problem = zoo.schroedinger_lattice(n=12)
    exact = end(problem, 4.0, lh.RungeKutta("dop853", rtol=1e-13, atol=1e-15))
    for scheme, order, dt in (("leapfrog", 2, 0.02), ("ForestRuth", 4, 0.02), ("Yoshida6", 6, 0.1)):
        errors = [
            np.linalg.norm(end(problem, 4.0, lh.Splitting(THREE_PARTS, scheme, dt=step)) - exact)
            for step in (dt, dt / 2)
        ]
        assert abs(np.log2(errors[0] / errors[1]) - order) < 0.3, (scheme, errors)


@pytest.mark.slow
def test_all_exponents_come_in_pairs():
    problem = zoo.schroedinger_lattice(n=6)
    found = problem.spectrum(t1=100.0, blocks=2, frame=None)
    assert found.exponents.shape == (12,)
    assert_allclose(found.exponents + found.exponents[::-1], 0.0, rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("build", "says"),
    [
        (lambda: zoo.klein_gordon(n=1), "n must be at least 2"),
        (lambda: zoo.klein_gordon(energy=0.0), "energy must be positive"),
        (lambda: zoo.schroedinger_lattice(norm=-1.0), "norm must be positive"),
        (lambda: zoo.schroedinger_lattice(seed=-1), "seed must be 0 or more"),
    ],
)
def test_bad_parameters_are_refused(build, says):
    with pytest.raises(ValueError, match=says):
        build()
