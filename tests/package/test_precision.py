"""Float32: what runs is right to the digits that the warning promises; what cannot be is refused before computing."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import lyaphybrid as lh
from lyaphybrid._jax.precision import LEAST_TOLERANCE, digits, eps, nonzero

DIGITS = 1e-3  # three to four digits


def in_float32(run):
    """What a run gives with JAX as a newcomer finds it."""
    with jax.enable_x64(False), pytest.warns(UserWarning, match="x0? is float32: .* three to four digits"):
        return run()


def lorenz(t, x, args):
    return jnp.stack([10.0 * (x[1] - x[0]), x[0] * (28.0 - x[2]) - x[1], x[0] * x[1] - 8.0 / 3.0 * x[2]])


def forced(t, x, args):
    return jnp.stack([x[1], jnp.cos(args["omega"] * t) - 0.1 * x[1] - x[0]])


def van_der_pol(t, x, mu):
    return jnp.stack([x[1], mu * (1 - x[0] ** 2) * x[1] - x[0]])


def fading(t, x, args):
    return jnp.array([-0.13, -1.7], x.dtype) * x


def stiff(t, x, args):
    return jnp.stack([-0.5 * x[0] + 0.1 * jnp.sin(x[1]), -300.0 * (x[1] - x[0])])


OSCILLATOR = lh.Hybrid(
    forced,
    lh.Transition(
        guard=lambda t, x, args: -x[0], reset=lambda t, x, args: jnp.stack([x[0], -args["restitution"] * x[1]])
    ),
)
WALL = {"omega": 2.8, "restitution": 0.8}
HENON = lh.Map(lambda n, x, args: jnp.stack([1.0 - 1.4 * x[0] ** 2 + x[1], 0.3 * x[0]]))
CAT = lh.Map(lambda n, x, args: jnp.stack([2.0 * x[0] + x[1], x[0] + x[1]]) % 1.0)
HENON_HEILES = lh.Hamiltonian(
    lambda p, args: 0.5 * jnp.sum(p**2), lambda q, args: 0.5 * jnp.sum(q**2) + q[0] ** 2 * q[1] - q[1] ** 3 / 3.0
)
LEAPS = lh.Symplectic("SABA2C", dt=0.05)
REGULAR = [0.0, 0.0, 0.3, 0.1]


def exponents(system, x0, args=None, **options):
    return lh.lyapunov_spectrum(system, x0, args, **options).exponents


def floquet():
    orbit = lh.floquet(lh.Flow(van_der_pol), [2.0, 0.0], 1.0)
    return np.append(np.abs(np.asarray(orbit.multipliers)), orbit.period)


def floquet_with_impacts():
    orbit = lh.floquet(OSCILLATOR, [0.0, 0.6], WALL | {"omega": 2.0}, period=np.pi, transient=60.0)
    return np.append(np.sort(np.abs(np.asarray(orbit.multipliers))), [orbit.x0[0], orbit.x0[1]])


# What no chaos blurs: the same numbers in both precisions.
ALIKE = {
    "trajectory": lambda: lh.trajectory(OSCILLATOR, [0.0, -0.5], WALL, t1=20.0).x,
    "events": lambda: lh.trajectory(OSCILLATOR, [0.0, -0.5], WALL, t1=20.0).events.t,
    "tangent map": lambda: lh.tangent_map(OSCILLATOR, [0.0, -0.5], WALL, t1=10.0).matrix,
    "floquet": floquet,
    "floquet with impacts": floquet_with_impacts,
    "saltation": lambda: lh.saltation_matrix(OSCILLATOR, 1.0, [0.0, -0.5], WALL, transition=0),
    "two million steps": lambda: exponents(
        lh.Flow(fading), [1.0, 1.0], t1=20_000.0, blocks=2, method=lh.RungeKutta("rk4", dt=0.01)
    ),
    "two hundred thousand iterations": lambda: exponents(CAT, [0.1, 0.33], t1=200_000, blocks=2),
    "sliding": lambda: lh.zoo.friction_pendulum(alpha=0.5).spectrum(t1=600.0, transient=100.0).exponents,
    "stiff": lambda: exponents(lh.Flow(stiff), [0.3, 0.2], t1=20.0, transient=5.0, method=lh.ESDIRK()),
    "megno": lambda: lh.megno(HENON_HEILES, REGULAR, t1=100.0, method=LEAPS).values[-1],
}


def several(cases, slow):
    return pytest.mark.parametrize(
        "name", [pytest.param(name, marks=[pytest.mark.slow] * (name in slow)) for name in cases]
    )


@pytest.mark.slow_cases("trajectory", "two hundred thousand iterations", "megno", "events")
@several(ALIKE, slow=("tangent map", "floquet with impacts", "sliding", "stiff"))
def test_as_in_float64(name):
    got, wanted = np.asarray(in_float32(ALIKE[name])), np.asarray(ALIKE[name]())
    assert got.dtype != wanted.dtype or name.startswith("floquet")
    assert_allclose(got, wanted, rtol=DIGITS, atol=DIGITS * np.max(np.abs(wanted[np.isfinite(wanted)])))


@pytest.mark.parametrize("method", [lh.RadauIIA(1e-4), lh.ESDIRK(rtol=1e-4)], ids=lambda method: type(method).__name__)
def test_implicit_methods_with_a_start_in_float32(method):
    with pytest.warns(UserWarning, match="x0 is float32"):  # while JAX computes in float64
        found = lh.lyapunov_spectrum(lh.Flow(fading), jnp.array([1.0, 1.0], jnp.float32), t1=50.0, method=method)
    assert found.exponents.dtype == jnp.float32
    assert_allclose(found.exponents, [-0.13, -1.7], rtol=DIGITS)


# Chaos forgets its digits: within standard errors of values from long runs in float64, and these errors small.
CHAOTIC = {
    "Lorenz": (
        lambda: lh.lyapunov_spectrum(lh.Flow(lorenz), [1.0, 1.0, 1.0], t1=1000.0, transient=20.0),
        (0.90563, 0.0, -14.57229), 0.02,
    ),
    "Lorenz, dop853": (
        lambda: lh.lyapunov_spectrum(
            lh.Flow(lorenz), [1.0, 1.0, 1.0], t1=1000.0, transient=20.0, method=lh.RungeKutta("dop853")
        ),
        (0.90563, 0.0, -14.57229), 0.02,
    ),
    "Lorenz, fixed steps": (
        lambda: lh.lyapunov_spectrum(
            lh.Flow(lorenz), [1.0, 1.0, 1.0], t1=5000.0, transient=20.0, method=lh.RungeKutta("rk4", dt=0.01)
        ),
        (0.90563, 0.0, -14.57229), 0.02,
    ),
    "oscillator": (
        lambda: lh.lyapunov_spectrum(OSCILLATOR, [0.0, -0.5], WALL, t1=2000.0, transient=200.0),
        (0.1569, -0.4753), 0.02,
    ),
    "Hénon": (
        lambda: lh.lyapunov_spectrum(HENON, [0.1, 0.1], t1=100_000, transient=100),
        (0.41919, -1.62316), 0.002,
    ),
    "billiard": (lambda: lh.zoo.sinai_billiard().spectrum(t1=8000.0), (2.738746, 0.0, 0.0, -2.738746), 0.05),
    "disks": (lambda: lh.zoo.hard_disks(n=8, density=0.5).spectrum(t1=50.0, k=2), (3.25, 3.05), 0.2),
}  # fmt: skip


@pytest.mark.slow_cases("Lorenz", "disks")
@several(CHAOTIC, slow=("oscillator", "Lorenz, dop853"))
def test_chaos(name):
    run, values, most = CHAOTIC[name]
    s = in_float32(run)
    assert s.status == lh.STATUS.ok
    assert s.exponents.dtype == jnp.float32
    assert np.all(np.asarray(s.stderr) < most)
    assert np.all(np.abs(np.asarray(s.exponents) - values) <= 5 * np.asarray(s.stderr) + DIGITS)


@pytest.mark.slow
def test_sweep():
    def run(kick):
        return lh.lyapunov_spectrum(CAT, jnp.stack([kick, 0.3 * kick]), t1=1000, blocks=4)

    found = in_float32(lambda: lh.sweep(run, {"args": np.array([0.1, 0.2, 0.3])}, args=0.1, progress=False))
    assert found.exponents.dtype == np.float32
    assert_allclose(found.exponents.values, np.full((3, 2), [0.9624237, -0.9624237]), rtol=DIGITS)


@pytest.mark.slow
def test_covariant_vectors_and_gali():
    found = in_float32(lambda: lh.covariant_vectors(lh.Flow(lorenz), [1.0, 1.0, 1.0], t1=100.0, transient=20.0))
    assert found.status == lh.STATUS.ok
    assert abs(float(np.sum(found.exponents)) + 41 / 3) < DIGITS * 41 / 3
    field = in_float32(lambda: lh.angle_field(CAT, [[0.0, 0.0], [1.0, 1.0]], shape=(2, 2), transient=20))
    assert_allclose(field.angles, np.pi / 2, rtol=DIGITS)  # the matrix is symmetric
    indicator = in_float32(lambda: lh.gali(HENON_HEILES, REGULAR, t1=100.0, method=LEAPS))
    assert indicator.status == lh.STATUS.ok


def test_what_the_warning_says():
    with jax.enable_x64(False):
        with pytest.warns(UserWarning, match=r"rtol = 3.8e-06 and not 1e-09.*jax_enable_x64"):
            lh.trajectory(lh.Flow(fading), [1.0, 1.0], t1=1.0)
        with pytest.warns(UserWarning, match="x0 is float32") as seen:
            lh.trajectory(lh.Flow(fading), [1.0, 1.0], t1=1.0, method=lh.RungeKutta(rtol=1e-4, atol=1e-6))
        assert "rtol" not in str(seen[0].message)


def test_tolerances_rise_together():
    method = lh.RungeKutta(rtol=1e-9, atol=1e-12).loosened(1e-6)
    assert_allclose([method.rtol, method.atol], [1e-6, 1e-9], rtol=1e-12)
    assert lh.ContinuousQR(lh.HalfExplicit(rtol=1e-9)).loosened(1e-6).rtol == pytest.approx(1e-6)
    assert lh.RungeKutta(rtol=1e-3).loosened(1e-6).rtol == 1e-3
    assert lh.Symplectic(dt=0.1).loosened(1e-6) == lh.Symplectic(dt=0.1)


CIRCLE = lh.DAE(
    lambda t, args: jnp.diag(jnp.array([1.0, 0.0])),
    lambda t, x, args: jnp.stack([x[1], x[0] ** 2 + x[1] ** 2 - 1]),
    n_differential=1,
)
LOGISTIC = lh.Map(lambda n, x, r: r * x * (1 - x))
LOGISTIC_OF_TWO = lh.Map(lambda n, x, p: p["r"] * x * (1 - x) + p["s"])
REFUSED = {
    "an lh.DAE": lambda: lh.lyapunov_spectrum(CIRCLE, [0.6, 0.8], t1=1.0),
    "consistent_start": lambda: lh.consistent_start(CIRCLE, [0.6, 0.8]),
    "bifurcation_curve": lambda: lh.bifurcation_curve(
        LOGISTIC_OF_TWO,
        [0.6],
        {"r": 2.5, "s": 0.0},
        over={"r": (2.0, 3.0), "s": (-1.0, 1.0)},
        period=1,
        border=lambda n, x, args: x[0] - 0.6,
    ),
    "continuation": lambda: lh.continuation(LOGISTIC, [0.6], 2.5, over={"args": (2.0, 3.0)}, period=1),
    "a derivative of exponents": lambda: lh.lyapunov_gradient(LOGISTIC, [0.3], 2.9, t1=1000),
}


@pytest.mark.parametrize("who", REFUSED)
def test_refused_before_computing(who):
    message = f"x0 is float32: {who} needs float64. .*jax_enable_x64', True"
    with jax.enable_x64(False), pytest.raises(ValueError, match=message):
        REFUSED[who]()


def test_half_precision():
    with pytest.raises(ValueError, match="x0 is float16: it must be float64, or float32"):
        lh.trajectory(lh.Flow(fading), jnp.ones(2, jnp.float16), t1=1.0)


def test_float64_takes_constants_as_they_are():
    x = jnp.ones(1)
    assert eps(x) == np.finfo(float).eps
    assert [digits(value, x) for value in (1e-9, 1e-12)] == [1e-9, 1e-12]
    assert [nonzero(value, x) for value in (1e-40, 1e-300)] == [1e-40, 1e-300]
    assert LEAST_TOLERANCE * eps(x) < 1e-14
