"""Tangent maps of symplectic steps against maps written by hand; the rivals; long runs against theory."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
from numpy.testing import assert_allclose

import lyaphybrid as lh
from lyaphybrid import zoo
from lyaphybrid._jax.engines import compiled
from lyaphybrid.systems.bound import Bound

STEP = 0.05
R1, C1 = {"y": 0.55}, {"y": -0.016}


# The maps of the paper's appendix for Hénon and Heiles, as one writes them by hand: w = (x, y, px, py, and their δ).


def drift(w, h):
    return w + h * np.array([w[2], w[3], 0, 0, w[6], w[7], 0, 0])


def kick(w, h):
    x, y, _, _, dx, dy, _, _ = w
    force = np.array([-x * (1 + 2 * y), y * y - x * x - y])
    rate = np.array([-(1 + 2 * y) * dx - 2 * x * dy, -2 * x * dx + (2 * y - 1) * dy])
    return w + h * np.array([0, 0, *force, 0, 0, *rate])


def correct(w, h):
    """p += h ∂C/∂q with C = |∇V|²."""
    x, y, _, _, dx, dy, _, _ = w
    slope = 2 * np.array([x * (1 + 2 * x * x + 6 * y + 2 * y * y), y - 3 * y**2 + 2 * y**3 + 3 * x**2 + 2 * x**2 * y])
    xx, xy = 1 + 6 * x * x + 6 * y + 2 * y * y, 6 * x + 4 * x * y
    yy = 1 - 6 * y + 6 * y * y + 2 * x * x
    rate = 2 * np.array([xx * dx + xy * dy, xy * dx + yy * dy])
    return w + h * np.array([0, 0, *slope, 0, 0, *rate])


C, D, E = 0.5 - 1 / (2 * np.sqrt(3)), 1 / np.sqrt(3), 0.5
BY_HAND = {
    "SABA2": [(drift, C), (kick, E), (drift, D), (kick, E), (drift, C)],
    "SBAB2": [(kick, 1 / 6), (drift, 0.5), (kick, 2 / 3), (drift, 0.5), (kick, 1 / 6)],
    "leapfrog": [(drift, 0.5), (kick, 1.0), (drift, 0.5)],
}
STRENGTH = {"SABA2": (2 - np.sqrt(3)) / 24, "SBAB2": 1 / 72}


def by_hand(scheme, w, h):
    plain = scheme.rstrip("C")
    ends = [(correct, 0.5 * STRENGTH[plain] * h**2)] if scheme.endswith("C") else []
    for move, share in [*ends, *BY_HAND[plain], *ends]:
        w = move(w, share * h)
    return w


@compiled()
def _one_step(method, system, x, args, h):
    field, t = Bound(system.field, args), jnp.zeros(())
    done = method.step(field, t, x, field(t, x), h).x
    return done, method.tangent(field, t, x, h, jnp.eye(len(x))).frame


def one_step(method, system, x, args=None, h=None):
    """A step of the state and the tangent of all unit vectors; one program for all lengths of the step."""
    h = np.asarray(method.fixed_step if h is None else h, float)
    method, args = jax.tree.map(lambda one: np.asarray(one) if isinstance(one, float) else one, (method, args))
    return tuple(np.asarray(found) for found in _one_step(method, system, np.asarray(x, float), args, h))


@pytest.mark.slow_cases("SBAB2C", "SABA2C")
@pytest.mark.parametrize("scheme", ["SABA2", "SABA2C", "SBAB2", "SBAB2C", "leapfrog"])
def test_step_and_tangent_are_the_maps_written_by_hand(scheme):
    rng = np.random.default_rng(3)
    system = zoo.henon_heiles().system
    for _ in range(5):
        x, h = rng.uniform(-0.5, 0.5, 4), rng.uniform(0.05, 0.5)
        new, matrix = one_step(lh.Symplectic(scheme, dt=h), system, x)
        for column in range(4):
            w = by_hand(scheme, np.concatenate([x, np.eye(4)[column]]), h)
            assert_allclose(new, w[:4], rtol=0, atol=1e-14)
            assert_allclose(matrix[:, column], w[4:], rtol=0, atol=1e-14)


def hessian(x):
    return np.array([[1 + 2 * x[1], 2 * x[0]], [2 * x[0], 1 - 2 * x[1]]])


def composed(moves):
    """The matrix of drifts ("drift", h), kicks (D²V, h) and corrections, acting one after the other."""
    matrix, zero, unit = np.eye(4), np.zeros((2, 2)), np.eye(2)
    for what, form, h in moves:
        block = h * unit if what == "drift" else -h * form if what == "kick" else 2 * h * form @ form
        one = np.block([[unit, block], [zero, unit]]) if what == "drift" else np.block([[unit, zero], [block, unit]])
        matrix = one @ matrix
    return matrix


def rival(variant, points, h):
    """The tangent of a rival from D²V at the points of the orbit, a step of the tangent being h."""
    forms, half, g = [hessian(x) for x in points], 0.5 * h, 0.5 * h**3 / 72
    if variant == "es":
        return scipy.linalg.expm(h * np.block([[np.zeros((2, 2)), np.eye(2)], [-forms[0], np.zeros((2, 2))]]))
    if variant == "eps-kick":
        return composed([("kick", forms[0], half), ("drift", None, h), ("kick", forms[1], half)])
    if variant == "eps-drift":
        return composed([("drift", None, half), ("kick", forms[1], h), ("drift", None, half)])
    a, b, c = forms if variant == "eps" else [forms[0]] * 3
    return composed(
        [("correct", a, g), ("kick", a, h / 6), ("drift", None, half), ("kick", b, 2 * h / 3)]
        + [("drift", None, half), ("kick", c, h / 6), ("correct", c, g)]
    )


@pytest.mark.slow
@pytest.mark.parametrize("variant", ["cc", "es", "eps", "eps-kick", "eps-drift"])
def test_the_rivals_are_the_matrices_written_by_hand(variant):
    problem = zoo.henon_heiles(y=0.3)
    x, h = np.array([0.3, -0.4, 0.2, 0.1]), 0.1
    new, matrix = one_step(lh.TangentHamiltonian(variant, dt=h), problem.system, x)
    parts, points = 2 if variant in ("eps", "eps-drift") else 1, [x]
    for _ in range(parts):
        points.append(one_step(lh.Symplectic("SBAB2C", dt=h / parts), problem.system, points[-1])[0])
    assert_allclose(new, points[-1], rtol=0, atol=1e-15)
    assert_allclose(matrix, rival(variant, points, h), rtol=0, atol=1e-14)
    turn = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.eye(2), np.zeros((2, 2))]])
    assert_allclose(matrix.T @ turn @ matrix, turn, rtol=0, atol=1e-14)  # so that sums of pairs fall as 1/t


ORBITS = {
    "leapfrog": lambda h: lh.Symplectic("leapfrog", dt=h),
    "rk4": lambda h: lh.RungeKutta("rk4", dt=h),
    "dop853": lambda h: lh.RungeKutta("dop853", rtol=1e-10),
}


@pytest.mark.slow_cases("cc-dop853", "eps-dop853")
@pytest.mark.parametrize("orbit", list(ORBITS))
@pytest.mark.parametrize("variant", ["cc", "eps"])
def test_the_rivals_go_along_orbits_by_any_method(variant, orbit):
    """The tangent is that of the points where the method of the orbit stands."""
    problem, x, h = zoo.henon_heiles(y=0.3), np.array([0.3, -0.4, 0.2, 0.1]), 0.1
    parts, points = 2 if variant == "eps" else 1, [x]
    method = ORBITS[orbit](h / parts)
    for _ in range(parts):
        points.append(one_step(method, problem.system, points[-1], h=h / parts)[0])
    new, matrix = one_step(lh.TangentHamiltonian(variant, dt=h, orbit=method), problem.system, x, h=h)
    assert_allclose(new, points[-1], rtol=0, atol=1e-15)
    assert_allclose(matrix, rival(variant, points, h), rtol=0, atol=1e-14)


@pytest.mark.slow
@pytest.mark.parametrize(
    "orbit",
    [lh.RungeKutta("dop853", rtol=1e-13, atol=1e-15), lh.Diffrax(diffrax.Kvaerno5(), rtol=1e-10, atol=1e-12)],
    ids=["dop853", "implicit"],
)
def test_an_orbit_that_controls_its_error_makes_the_steps_shorter(orbit):
    """A coarse dt is cut where the orbit's tolerance asks for it."""
    problem = zoo.henon_heiles(**R1)

    def end(method):
        return np.asarray(lh.trajectory(problem.system, problem.x0, t1=10.0, n=1, method=method).x[-1])

    alone = end(orbit)
    assert_allclose(end(lh.TangentHamiltonian("eps", dt=2.0, orbit=orbit)), alone, rtol=0, atol=1e-8)
    assert np.max(np.abs(end(lh.TangentHamiltonian("eps", dt=2.0)) - alone)) > 1e-3


@pytest.mark.parametrize("h", [0.3, 3.0])
@pytest.mark.parametrize("x", [(0.3, -0.4), (-0.3, -0.4), (0.0, 0.2), (0.0, -0.2), (0.2, 0.0), (0.0, 0.0), (0.1, 0.9)])
def test_the_frozen_form_is_solved_exactly_in_the_plane(h, x):
    """All angles of the eigenvectors, equal eigenvalues, both signs; short steps by a series, long ones not."""
    x = np.array([*x, 0.2, 0.1])
    _, matrix = one_step(lh.TangentHamiltonian("es", dt=h), zoo.henon_heiles().system, x)
    expected = scipy.linalg.expm(h * np.block([[np.zeros((2, 2)), np.eye(2)], [-hessian(x), np.zeros((2, 2))]]))
    assert_allclose(matrix, expected, rtol=0, atol=3e-14 * np.max(np.abs(expected)))


def test_the_frozen_form_takes_coupled_masses():
    """T = p₀²/2 + 0.6 p₀p₁ + p₁²: its factor is no diagonal matrix."""
    mass = np.array([[1.0, 0.6], [0.6, 2.0]])
    system = lh.Hamiltonian(lambda p, args: p @ jnp.asarray(mass) @ p / 2, zoo.henon_heiles().system.field.potential)
    x = np.array([0.3, -0.4, 0.2, 0.1])
    _, matrix = one_step(lh.TangentHamiltonian("es", dt=0.3), system, x)
    generator = np.block([[np.zeros((2, 2)), mass], [-hessian(x), np.zeros((2, 2))]])
    assert_allclose(matrix, scipy.linalg.expm(0.3 * generator), rtol=0, atol=1e-14)


@pytest.mark.parametrize("h", [0.2, 2.0])
def test_the_frozen_form_is_solved_exactly_for_any_masses_and_signs(h):
    """Three degrees of freedom: by LAPACK's eigenvectors; far out D²V has a negative eigenvalue."""
    problem = zoo.hamiltonian_3d()
    method, x = lh.TangentHamiltonian("es", dt=h), np.array([0.9, -1.5, 0.4, 0.1, 0.2, 0.3])
    _, matrix = one_step(method, problem.system, x, problem.args)
    omega = np.sqrt([1.0, 2.0, 3.0])
    form = np.diag(omega) + np.array([[2 * (x[1] + x[2]), 2 * x[0], 2 * x[0]], [2 * x[0], 0, 0], [2 * x[0], 0, 0]])
    assert np.linalg.eigvalsh(form)[0] < -0.1
    generator = np.block([[np.zeros((3, 3)), np.diag(omega)], [-form, np.zeros((3, 3))]])
    assert_allclose(matrix, scipy.linalg.expm(h * generator), rtol=0, atol=1e-12)


@pytest.mark.slow_cases(all_but=("henon_heiles-SBAB2C",))
@pytest.mark.parametrize("scheme", ["SBAB2C", "ABA864", "SRKN14a"])
@pytest.mark.parametrize("name", ["henon_heiles", "hamiltonian_3d", "fpu_beta"])
def test_the_tangent_of_a_step_keeps_the_symplectic_form(scheme, name):
    problem = zoo.get(name)()
    _, matrix = one_step(lh.Symplectic(scheme, dt=0.1), problem.system, problem.x0, problem.args)
    m = len(problem.x0) // 2
    omega = np.block([[np.zeros((m, m)), np.eye(m)], [-np.eye(m), np.zeros((m, m))]])
    assert_allclose(matrix.T @ omega @ matrix, omega, rtol=0, atol=1e-12)


@pytest.mark.slow
def test_exponents_come_in_pairs_at_every_time():
    for name, t1 in (("henon_heiles", 20_000.0), ("hamiltonian_3d", 5000.0), ("fpu_beta", 2000.0)):
        spectrum = zoo.get(name)().spectrum(t1=t1)
        running = np.asarray(spectrum.history.exponents)
        print(name, np.max(np.abs(running + running[:, ::-1])))
        assert np.max(np.abs(running + running[:, ::-1])) < 1e-10


@pytest.mark.slow
def test_one_event_under_a_symplectic_method():
    """Free flight to a wall: of a fixed step without stages inside only its ends are known."""
    free = lh.Hamiltonian(lambda p, args: jnp.sum(p * p) / 2, lambda q, args: 0.0 * q[0])
    wall = lh.Transition(lambda t, x, args: 0.45 - x[0], lambda t, x, args: jnp.stack([x[0], -x[1]]))
    found = lh.tangent_map(lh.Hybrid(free, wall), [0.0, 0.5], t1=1.0, method=lh.Symplectic("leapfrog", dt=0.25))
    assert_allclose(found.x, [0.4, -0.5], rtol=0, atol=1e-14)
    assert_allclose(found.matrix, [[-1.0, -1.0], [0.0, -1.0]], rtol=0, atol=1e-14)
    assert found.notes == frozenset()


@pytest.mark.slow
def test_events_under_a_symplectic_method():
    """Hénon and Heiles with an elastic wall: energy is kept to the method's error through all impacts."""
    problem = zoo.henon_heiles()
    flip = jnp.array([1.0, 1.0, -1.0, 1.0])
    walled = lh.Hybrid(problem.system, lh.Transition(lambda t, x, args: 0.3 - x[0], lambda t, x, args: flip * x))
    method = lh.Symplectic("SRKN14a", dt=0.1)
    path = lh.trajectory(walled, problem.x0, t1=500.0, method=method)
    energies = jax.vmap(problem.system.energy)(path.x)
    assert len(path.events) > 30
    assert_allclose(energies, 0.125, rtol=0, atol=1e-9)
    tangent = lh.tangent_map(walled, problem.x0, t1=20.0, method=method).matrix
    reference = lh.tangent_map(walled, problem.x0, t1=20.0, method=lh.RungeKutta(rtol=1e-12, atol=1e-14)).matrix
    assert_allclose(tangent, reference, rtol=0, atol=1e-6 * np.max(np.abs(reference)))


def kepler_flow(dt, t, x, args):
    """Around the sun, H = |p|²/2 − 1/|q|, in closed form: by Gauss's f and g functions of the eccentric anomaly."""
    q, p = x[:2], x[2:]
    r, speed, along = jnp.sqrt(q @ q), p @ p, q @ p
    a = 1 / (2 / r - speed)
    n = a**-1.5
    c, s = 1 - r / a, along / jnp.sqrt(a)

    def newton(_, e):
        f = e - c * jnp.sin(e) + s * (1 - jnp.cos(e)) - n * dt
        return e - f / (1 - c * jnp.cos(e) + s * jnp.sin(e))

    e = jax.lax.fori_loop(0, 12, newton, n * dt)
    cos, sin = jnp.cos(e), jnp.sin(e)
    new_r = a * (1 - c * cos + s * sin)
    f, g = 1 - a / r * (1 - cos), dt - (e - sin) / n
    rate_f, rate_g = -jnp.sqrt(a) / (r * new_r) * sin, 1 - a / new_r * (1 - cos)
    return jnp.concatenate([f * q + g * p, rate_f * q + rate_g * p])


def bulge(q, args):
    """The potential of an oblate sun, in the plane of its equator."""
    return -args / jnp.sqrt(q @ q) ** 3


def bulge_flow(dt, t, x, args):
    return jnp.concatenate([x[:2], x[2:] - dt * jax.grad(bulge)(x[:2], args)])


def sun_and_bulge(q, p, args):
    return 0.5 * (p @ p) - 1 / jnp.sqrt(q @ q) + bulge(q, args)


@pytest.mark.slow
def test_kepler_and_a_perturbation():
    """With the flow of the first part exact, errors are those of a perturbation: they go with ε."""
    system, x0, errors = lh.canonical_flow(sun_and_bulge), jnp.array([0.7, 0.0, 0.0, 1.3]), {}
    for name in ("SABA1", "SABA3", "ABA864"):
        method = lh.Splitting((kepler_flow, bulge_flow), name, dt=0.1)
        for epsilon in (1e-2, 1e-4):
            path = lh.trajectory(system, x0, epsilon, t1=50.0, n=101, method=method)
            energy = jax.vmap(lambda x, e=epsilon: system.energy(x, e))(path.x)
            errors[name, epsilon] = float(jnp.max(jnp.abs(energy - energy[0])))
    print(errors)
    assert errors["ABA864", 1e-4] < 1e-11
    assert errors["SABA3", 1e-2] < 0.1 * errors["SABA1", 1e-2]
    assert 30 < errors["SABA1", 1e-2] / errors["SABA1", 1e-4] < 200
    method = lh.Splitting((kepler_flow, bulge_flow), "ABA864", dt=0.1)
    ours = lh.tangent_map(system, x0, 1e-2, t1=10.0, method=method).matrix
    theirs = lh.tangent_map(system, x0, 1e-2, t1=10.0, method=lh.RungeKutta(rtol=1e-12, atol=1e-14)).matrix
    assert_allclose(ours, theirs, rtol=0, atol=1e-6 * np.max(np.abs(theirs)))
    omega = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.eye(2), np.zeros((2, 2))]])
    assert_allclose(ours.T @ omega @ ours, omega, rtol=0, atol=1e-9)
    spectrum = lh.lyapunov_spectrum(system, x0, 1e-2, t1=50.0, method=method)
    assert spectrum.sum_rule_residual < 1e-10


@pytest.mark.slow
def test_a_splitting_of_drifts_and_kicks_is_the_scheme():
    problem = zoo.henon_heiles()

    def drift(dt, t, x, args):
        return jnp.concatenate([x[:2] + dt * x[2:], x[2:]])

    def kick(dt, t, x, args):
        return jnp.concatenate([x[:2], x[2:] + dt * problem.system.field.force(x[:2], args)])

    by_pairs = [(0, 0.5), (1, 1.0), (0, 0.5)]
    for coefficients, name in (("ABA864", "ABA864"), (by_pairs, "leapfrog")):
        ours = problem.spectrum(method=lh.Splitting((drift, kick), coefficients, dt=0.05), t1=200.0)
        theirs = problem.spectrum(method=lh.Symplectic(name, dt=0.05), t1=200.0)
        assert_allclose(ours.exponents, theirs.exponents, rtol=0, atol=1e-9)


REFUSED = [
    (lambda: lh.Symplectic("SABA11", dt=0.1), "Unknown scheme"),
    (lambda: lh.Symplectic("SABA2C"), "needs its step"),
    (lambda: lh.Symplectic("SABA2C", dt=-0.1), "must be positive"),
    (lambda: lh.TangentHamiltonian("ec", dt=0.1), "Unknown variant"),
    (lambda: lh.TangentHamiltonian("cc", dt=0.1, orbit="ABA864"), "orbit must be a method"),
    (lambda: lh.TangentHamiltonian("eps", dt=0.1, orbit=lh.Symplectic("ABA864", dt=0.1)), "steps of 0.05 here"),
    (lambda: lh.Splitting((lambda dt, t, x, a: x,), "SABA2", dt=0.1), "two functions"),
    (lambda: lh.Splitting((lambda dt, t, x, a: x,) * 2, "SABA2C", dt=0.1), "two general parts"),
    (lambda: lh.Splitting((lambda dt, t, x, a: x,) * 3, "ABA864", dt=0.1), "3 general parts; .* leapfrog, ForestRuth"),
    (lambda: lh.Splitting((lambda dt, t, x, a: x,) * 3, [(0, 1.0), (1, 1.0)], dt=0.1), "flow 2 must sum to 1"),
    (lambda: lh.Splitting((lambda dt, t, x, a: x,) * 2, [(0, 1.0), (1, 1.0), (2, 1.0)], dt=0.1), "flows 0 to 1"),
    (lambda: lh.Splitting((lambda dt, t, x, a: x,) * 2, [(0, 0.5), (1, 1.0)], dt=0.1), "must sum to 1"),
    (lambda: lh.Hamiltonian(1.0, lambda q, args: q[0]), "kinetic must be a function"),
    (lambda: lh.canonical_flow(None), "energy must be a function"),
]


@pytest.mark.parametrize(("make", "says"), REFUSED, ids=[says for _, says in REFUSED])
def test_bad_methods_are_refused(make, says):
    with pytest.raises(ValueError, match=says):
        make()


def relativistic(p, args):
    return jnp.sum(jnp.sqrt(1 + p**2))


def bowl(q, args):
    return jnp.sum(q**2) / 2


NOT_FOR = [
    (lh.Flow(lambda t, x, args: -x), lh.Symplectic("SABA2", dt=0.1), "moves the two parts"),
    (lh.Hamiltonian(relativistic, bowl), lh.Symplectic("SABA2C", dt=0.1), "quadratic in p"),
    (lh.Hamiltonian(relativistic, bowl), lh.TangentHamiltonian("cc", dt=0.1), "quadratic in p"),
    (lh.canonical_flow(lambda q, p, args: jnp.sum(q * p)), lh.Symplectic("SABA2", dt=0.1), "moves the two parts"),
]


@pytest.mark.parametrize(("system", "method", "says"), NOT_FOR)
def test_methods_say_what_they_cannot_take(system, method, says):
    with pytest.raises(ValueError, match=says):
        lh.lyapunov_spectrum(system, [0.1, 0.2], t1=1.0, method=method)


def test_an_odd_state_is_refused():
    with pytest.raises(ValueError, match="even number"):
        lh.trajectory(lh.Hamiltonian(bowl, bowl), [0.1, 0.2, 0.3], t1=1.0, method=lh.Symplectic("SABA2", dt=0.1))


@pytest.mark.slow
def test_a_general_hamiltonian_by_runge_kutta():
    """The same as T + V; and with p in the potential part too."""
    problem = zoo.henon_heiles()

    def energy(q, p, args):
        return problem.system.energy(jnp.concatenate([q, p]), args)

    general = lh.canonical_flow(energy)
    assert_allclose(general.field(0.0, problem.x0, None), problem.system.field(0.0, problem.x0, None), atol=1e-16)
    ours = lh.lyapunov_spectrum(general, problem.x0, t1=100.0)
    theirs = lh.lyapunov_spectrum(problem.system, problem.x0, t1=100.0, method=lh.RungeKutta())
    assert_allclose(ours.exponents, theirs.exponents, rtol=0, atol=1e-7)


# Long runs.


def running(method, times, parameters=R1):
    """t λ₁(t) of an orbit from the paired frame, at the ends of the blocks."""
    spectrum = zoo.henon_heiles(**parameters).spectrum(t1=times[-1], times=np.asarray(times), method=method, k=2)
    return np.asarray(spectrum.history.exponents)[:, 0] * np.asarray(spectrum.history.time), spectrum


LEVELS = [1e5, 2e5, 4e5, 6e5, 8e5, 1e6]


@pytest.mark.slow
def test_one_over_t_is_kept_by_the_tangent_map_and_runge_kutta():
    problem = zoo.henon_heiles(**R1)
    for method, drift in (
        (lh.Symplectic("SBAB2C", dt=STEP), 2e-7),
        (lh.RungeKutta("dop853", rtol=1e-12, atol=1e-14), 1e-9),
    ):
        product, spectrum = running(method, LEVELS)
        energy = abs(float(problem.system.energy(spectrum.x)) / 0.125 - 1)
        print(method, product[-1] / LEVELS[-1], energy)
        assert product[-1] / LEVELS[-1] < 3e-5
        assert energy <= drift


@pytest.mark.slow
@pytest.mark.parametrize(
    ("variant", "order", "level"),
    [("cc", 1, 1.5e-3), ("es", 1, None), ("eps", 2, 7.8e-5), ("eps-kick", 1, None), ("eps-drift", 1, None)],
)
def test_the_rivals_level_off(variant, order, level):
    """d(t λ₁)/dt over [1e5, 1e6] falls with the step to the power of the order, and is not 0.

    An error of the order p makes a parabolic block hyperbolic: the exponent goes with its root, τ^(p/2).
    """
    found = []
    for dt in (STEP, STEP / 2):
        product, _ = running(lh.TangentHamiltonian(variant, dt=dt), LEVELS)
        found.append((product[-1] - product[0]) / (LEVELS[-1] - LEVELS[0]))
    print(variant, found, found[0] / found[1])
    assert abs(found[0] / found[1] - 2**order) <= 0.1 * 2**order
    if level is not None:
        assert level / 1.5 < found[0] < level * 1.5


@pytest.mark.slow
def test_the_big_chaotic_sea():
    """Errors of blocks are those of an orbit that sticks: the mean of several."""
    problem = zoo.henon_heiles(**C1)
    rng = np.random.default_rng(1)
    starts = np.asarray(problem.x0) + np.concatenate([np.zeros((16, 2)), np.zeros((16, 2))], axis=1)
    starts[:, 1] += rng.uniform(-1e-3, 1e-3, 16)
    starts[:, 2] = np.sqrt(0.25 - starts[:, 1] ** 2 + 2 / 3 * starts[:, 1] ** 3)
    spectrum = problem.spectrum(x0=jnp.asarray(starts), t1=500_000.0, k=1)
    known = problem.reference
    print(spectrum.exponents, spectrum.stderr)
    assert float(spectrum.stderr[0]) <= 1e-3
    assert abs(float(spectrum.exponents[0]) - known.exponents[0]) < 5 * np.hypot(
        float(spectrum.stderr[0]), known.stderr[0]
    )
