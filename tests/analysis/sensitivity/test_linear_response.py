"""Derivatives of chaotic exponents by linear response against exact values and others; and what is refused."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import stats

import lyaphybrid as lh
from known_gradients import (
    CIRCLE,
    FIXED,
    TORUS,
    baker,
    blaschke,
    conjugate,
    of_solenoid,
    perturbed_cat,
    solenoid,
    torus,
)
from lyaphybrid.analysis.sensitivity.response import continuity, jets, responses

KEY = jax.random.key(1)


def lorenz(**keywords):
    problem = lh.zoo.lorenz63()
    keywords = {"t1": 30.0, "transient": 30.0, "method": FIXED} | keywords
    return lh.lyapunov_gradient(
        problem.system, problem.x0, problem.args, algorithm="linear_response", key=KEY, **keywords
    )  # fmt: skip


def gradient(rule, x0, args, t1, **keywords):
    keywords = {"transient": 1000, "key": KEY} | keywords
    return lh.lyapunov_gradient(lh.Map(rule), x0, args, t1=t1, algorithm="linear_response", **keywords)


def assert_within(found, exact, known=0.0, most=3.0):
    assert np.all(np.abs(found.gradient - np.array(exact)) < most * np.hypot(found.stderr, np.array(known)) + 1e-9)
    assert found.trust, found.reasons


@pytest.mark.slow
def test_the_solenoid():
    a = 0.4
    found = gradient(solenoid, [0.3, 0.1, 0.2], a, 10_000)
    assert_within(found, of_solenoid(a))
    assert found.stderr[0] < 4e-3
    assert np.max(found.stderr[1:]) < 2e-4
    assert_allclose(found.value, [np.log(1 + np.sqrt(1 - a**2)), np.log(0.4), np.log(0.25)], atol=3e-3)


@pytest.mark.slow
@pytest.mark.parametrize(("a", "t1"), [(0.2, 80_000), (0.4, 200_000)], ids=["0.2", "0.4"])
def test_the_solenoid_to_a_thousandth(a, t1):
    found = gradient(solenoid, [0.3, 0.1, 0.2], a, t1)
    assert_within(found, of_solenoid(a))
    assert found.stderr[0] < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("t1", [25_000, pytest.param(80_000, marks=pytest.mark.slow)])
def test_the_perturbed_cat_map(t1):
    found = gradient(perturbed_cat, [0.3, 0.1], 0.4, t1)
    assert_within(found, [-0.04806, 0.01293], [0.00032, 0.00026])
    assert np.max(found.stderr) < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("c", [0.8, 1.5])
def test_a_change_of_coordinates_changes_no_exponent(c):
    found = gradient(conjugate, [0.3], c, 5_000)
    assert_within(found, [0.0])
    assert found.stderr[0] < 3e-3


def bent(n, x, a):
    return jnp.mod(2 * x + a * jnp.sin(x), CIRCLE)


def of_transfer_operator(a, modes=64, points=4096):
    """λ of `bent` from its invariant density, the fixed point of the transfer operator in Fourier modes."""
    x = CIRCLE * np.arange(points) / points
    order = np.arange(-modes, modes + 1)
    operator = np.exp(-1j * np.outer(order, 2 * x + a * np.sin(x))) @ np.exp(1j * np.outer(x, order)) / points
    values, vectors = np.linalg.eig(operator)
    density = np.exp(1j * np.outer(x, order)) @ vectors[:, np.argmin(np.abs(values - 1))]
    return np.mean((density / np.mean(density)).real * np.log(2 + a * np.cos(x)))


@pytest.mark.slow
@pytest.mark.slow_cases("0.5")
@pytest.mark.parametrize("a", [0.5, 0.9])
def test_a_circle_map_against_its_transfer_operator(a):
    found = gradient(bent, [0.3], a, 10_000)
    exact = (of_transfer_operator(a + 1e-4) - of_transfer_operator(a - 1e-4)) / 2e-4
    assert_within(found, [exact])
    assert found.stderr[0] < 0.03 * abs(exact)
    assert_allclose(found.value[0], of_transfer_operator(a), atol=4 * found.value_stderr[0])


def lorenz_field(x):
    return lh.zoo.lorenz63().system.field(0.0, x, {"sigma": 10.0, "rho": 28.0, "beta": 8 / 3})


def of_field(field, parameter, t1):
    """The derivative by one parameter of Lorenz' system, changed."""
    return lh.lyapunov_gradient(
        lh.Flow(field), [1.0, 1.0, 20.0], parameter, t1=t1, transient=30.0, algorithm="linear_response", key=KEY,
        method=FIXED,
    )  # fmt: skip


@pytest.mark.slow
def test_faster_time():
    """f → c f multiplies all exponents by c: all of it is a shift of time."""
    found = of_field(lambda t, x, c: c * lorenz_field(x), 1.0, 30.0)
    assert_allclose(found.gradient[0], found.value[0] + found.value[1], rtol=1e-9)
    assert found.gradient[1] == found.stderr[1] == 0
    assert_allclose(found.gradient[2], found.value[2], rtol=1e-9)
    assert_allclose(found.stderr[2], found.value_stderr[2], rtol=1e-6)
    assert found.trust, found.reasons


@pytest.mark.slow
def test_time_that_runs_unevenly():
    """f → (1 + c z) f multiplies exponents by 1/E[1/(1 + c z)]: dλ/dc = λ E[z] at c = 0, and E[z] = 23.55."""
    found = of_field(lambda t, x, c: (1 + c * x[2]) * lorenz_field(x), 0.0, 50.0)
    exact = 23.55 * np.array([0.9056, 0, -14.5723])
    assert_within(found, exact, 0.01 * np.abs(exact))
    assert np.all(found.stderr < np.array([0.5, 1e-9, 1.5]))


@pytest.mark.slow
def test_a_change_of_coordinates_of_a_flow_changes_no_exponent():
    """x₂ + c x₁²/300 in the place of x₂."""

    def field(t, u, c):
        def changed(x, sign):
            return x + jnp.stack([0 * x[0], sign * c * x[0] ** 2 / 300, 0 * x[0]])

        x = changed(u, -1)
        return jax.jvp(lambda x: changed(x, 1), (x,), (lorenz_field(x),))[1]

    found = of_field(field, 0.5, 50.0)
    assert_within(found, [0.0, 0.0, 0.0], 1e-4)  # of a step's error
    assert np.max(found.stderr) < 4e-3


@pytest.mark.slow
def test_the_volume_of_lorenz():
    """λ₁ + λ₂ + λ₃ = −(σ + 1 + β)."""
    found = lorenz()
    for name, exact in {"sigma": -1, "rho": 0, "beta": -1}.items():
        assert_allclose(np.sum(found.gradient[name]), exact, atol=1e-4)
        assert found.gradient[name][1] == 0
    assert any("zero exponent along the flow" in reason for reason in found.reasons)


@pytest.mark.slow
def test_lorenz():
    found = lorenz(t1=600.0, over=["rho"])
    slopes, errors = found.gradient["rho"], found.stderr["rho"]
    assert found.trust, found.reasons
    assert errors[0] < 1e-3
    assert abs(slopes[0] - 0.0242) < 3 * np.hypot(errors[0], 2e-4)
    assert abs(slopes[2] + 0.0243) < 3 * np.hypot(errors[2], 2e-4)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rule", "x0", "a", "exact"), [(conjugate, [0.3], 0.6, 0.0), (blaschke, [0.3], 0.4, of_solenoid(0.4)[0])]
)
def test_errors_have_the_size_they_should(rule, x0, a, exact):
    found = [gradient(rule, x0, a, 2500, key=jax.random.key(seed)) for seed in range(36)]
    scores = [float((one.gradient[0] - exact) / one.stderr[0]) for one in found]
    assert 0.7 < np.std(scores) < 1.5
    assert abs(np.mean(scores)) < 0.8
    assert sum(one.trust for one in found) >= 33


@pytest.mark.slow
def test_the_density_gradient_of_a_known_density():
    """ρ ∝ 1/(c² cos² x/2 + sin² x/2), g = ∂_x ln ρ and b = (∂_x∂_cφ)/φ' + ∂_cφ g."""
    motion = jets.JetMap(lambda c, h, x: conjugate(0, x, c[0]), jnp.array([0.6]), jnp.array(1.0), False)
    jet = jets.jet_at(jnp.array([0.3]), jnp.ones((1, 1)), 1)
    onward = jax.jit(lambda jet: jets.onward(motion, jet))
    for _ in range(60):
        before = jet.z.x[0]
        jet, seen = onward(jet)
    g = jax.grad(lambda x: -jnp.log(0.36 * jnp.cos(x / 2) ** 2 + jnp.sin(x / 2) ** 2))(jet.z.x[0])
    assert_allclose(jet.g, g, rtol=1e-10)

    def by_c(x):
        return jax.grad(lambda c: conjugate(0, x, c))(0.6)

    slope = jax.grad(lambda x: conjugate(0, x, 0.6))(before)
    assert_allclose(seen.b[0], jax.grad(by_c)(before) / slope + by_c(before) * g, rtol=1e-9)
    assert_allclose(jet.v.x, 0, atol=1e-14)


@pytest.mark.slow
def test_derivatives_along_the_unstable_direction():
    """Those of u and v, against the difference between two points on one unstable curve."""
    motion = jets.JetMap(lambda a, h, x: solenoid(0, x, a[0]), jnp.array([0.4]), jnp.array(1.0), False)
    onward = jax.jit(lambda jet: jets.onward(motion, jet)[0])
    one = jets.jet_at(jnp.array([0.3, 0.1, 0.2]), jnp.eye(3), 1)
    for _ in range(100):
        one = onward(one)
    apart = 1e-11
    two = one._replace(z=jax.tree.map(lambda z, u: z + apart * u, one.z, one.u))
    for _ in range(20):
        apart = apart * float(jnp.linalg.norm(jax.jvp(lambda x: solenoid(0, x, 0.4), (one.z.x,), (one.u.x,))[1]))
        one, two = onward(one), onward(two)
    assert 1e-7 < apart < 1e-3
    for name, along in {"u": one.unstable.u, "v": one.unstable.v}.items():
        quotient = jax.tree.map(lambda a, b: (b - a) / apart, getattr(one, name), getattr(two, name))
        for exact, near in zip(jax.tree.leaves(along), jax.tree.leaves(quotient), strict=True):
            assert_allclose(near, exact, atol=1e-3 * float(jnp.max(jnp.abs(exact))) + 1e-6)


@pytest.mark.slow
def test_what_is_remembered_fades_smoothly():
    """As the probability that eight geometric times together take longer than the lag."""
    retained, stages = jnp.array([0.5, 0.9]), jnp.zeros((responses.MEMORY_STAGES, 2, 1))
    for lag in range(200):
        stages = responses.remembered(stages, jnp.full(1, float(lag == 0)), retained)
        left = [stats.nbinom.sf(lag - responses.MEMORY_STAGES, responses.MEMORY_STAGES, 1 - r) for r in (0.5, 0.9)]
        assert_allclose(jnp.sum(stages, axis=0)[:, 0], left, atol=1e-12)


def lozi(n, x, a):
    return jnp.stack([1 - a * jnp.abs(x[0]) + x[1], 0.3 * x[0]])


def stretched(n, x, a):
    """β x mod 1, β no whole number: 0 and 1 do not go on alike."""
    return jnp.mod(2.3 * x + a * jnp.sin(CIRCLE * x) / CIRCLE, 1.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rule", "x0", "a"), [(baker, [0.31234, 0.1], 0.3), (lozi, [0.1, 0.1], 1.7), (stretched, [0.3], 0.2)]
)
def test_breaks_are_refused(rule, x0, a):
    found = gradient(rule, x0, a, 5000)
    assert not found.trust
    assert any("how a discontinuity moves; use regression" in reason for reason in found.reasons)


@pytest.mark.slow
def test_a_field_with_a_kink_is_refused():
    found = of_field(lambda t, x, c: lorenz_field(x) + 0.3 * c * jnp.abs(x), 1.0, 50.0)
    assert not found.trust
    assert any("discontinuity" in reason for reason in found.reasons)


@pytest.mark.slow
def test_henon_is_refused():
    """The density along the unstable manifold is singular: its gradient's tail is so heavy that it has no mean."""
    found = gradient(lambda n, x, a: jnp.stack([1 - a * x[0] ** 2 + x[1], 0.3 * x[0]]), [0.1, 0.1], 1.4, 20_000)
    assert not found.trust
    assert any("the square of the density gradient has no mean" in reason for reason in found.reasons)
    assert not any("discontinuity" in reason for reason in found.reasons)


def two_cats(n, x, a):
    return jnp.concatenate([perturbed_cat(n, x[:2], a), perturbed_cat(n, x[2:], a)])


def beside_a_rotation(n, x, a):
    return jnp.concatenate([perturbed_cat(n, x[:2], a), jnp.mod(x[2:] + 0.1, 1.0)])


@pytest.mark.slow_cases(
    "two_cats-x00-more than one unstable direction",
    "beside_a_rotation-x01-or a neutral one",
    "<lambda>-x03-those of regular motion",
    "<lambda>-x02-not chaotic",
)
@pytest.mark.parametrize(
    ("rule", "x0", "says"),
    [
        (two_cats, [0.3, 0.1, 0.2, 0.7], "more than one unstable direction"),
        (beside_a_rotation, [0.3, 0.1, 0.5], "or a neutral one"),
        (lambda n, x, a: a * x, [0.3], "not chaotic"),
        (lambda n, x, a: torus(n, x, TORUS | {"turn": a + 1.9}), [0.3, 0.1], "those of regular motion"),
        (lambda n, x, a: 3 + a * x**2, [0.3], "the runs failed: nonfinite"),
    ],
)
def test_what_has_not_one_unstable_direction_is_refused(rule, x0, says):
    found = gradient(rule, x0, 0.4, 5000)
    assert not found.trust
    assert says in found.reasons[0]
    assert np.all(np.isnan(found.gradient))


def smooth(x):
    return jnp.stack([jnp.tanh(5 * x[0]) + x[1] ** 2, jnp.cos(x[0])])


def kinked(x):
    return jnp.stack([jnp.abs(x[0]), x[1]])


def torn(x):
    return jnp.stack([2.5 * x[0] + jnp.where(x[0] > 0, 0.5, 0.0), x[1]])


def wound(x):
    return jnp.stack([jnp.mod(2 * x[0], 1.0), 0.5 * x[1] + jnp.sin(CIRCLE * x[0])])


@pytest.mark.parametrize(
    ("function", "charts", "expected"),
    [(smooth, True, False), (smooth, False, False), (kinked, True, True), (torn, True, True), (wound, True, False),
     (wound, False, True)],
)  # fmt: skip
def test_breaks(function, charts, expected):
    """Points 0.001 apart, on both sides of x = 0."""
    found = continuity.breaks(function, jnp.array([-3e-4, 0.7]), jnp.array([0.8, 0.6]), 1.0, charts)
    assert bool(found) == expected


@pytest.mark.slow
def test_runs_that_were_interrupted_are_left_out(monkeypatch):
    whole = responses.run_abreast

    def interrupted(*args, **keywords):
        results, done = whole(*args, **keywords)
        for one in done[2:]:
            one[-1] = False
        return results, done

    monkeypatch.setattr(responses, "run_abreast", interrupted)
    found = gradient(blaschke, [0.3], 0.4, 2000)
    assert np.isfinite(found.gradient[0])
    monkeypatch.setattr(responses, "run_abreast", lambda *a, **k: (whole(*a, **k)[0], [np.zeros(3, bool)] * 32))
    with pytest.raises(lh.NoDerivativeError, match="interrupted before two runs were done"):
        gradient(blaschke, [0.3], 0.4, 2000)


FLOW = lh.Flow(lambda t, x, a: a * x)
BOUNCING = lh.Hybrid(lambda t, x, a: a * x, lh.Transition(lambda t, x, a: x[0], lambda t, x, a: -x))


@pytest.mark.parametrize(
    ("system", "keywords", "says"),
    [
        (BOUNCING, {}, "jumps.*'regression'"),
        (lh.Hamiltonian(lambda p, a: a * jnp.sum(p**2), lambda q, a: jnp.sum(q**2)), {}, "conserved energy"),
        (FLOW, {}, "must be fixed: method=lh.RungeKutta"),
        (FLOW, {"method": lh.RungeKutta(rtol=1e-6)}, "must be fixed"),
        (lh.Flow(lambda t, x, a: a * x + jnp.cos(t)), {"method": FIXED}, "does not depend on time"),
        (lh.Map(lambda n, x, a: a * x + n), {}, "does not depend on time"),
        (lh.Map(lambda n, x, a: a * x), {"key": None}, "key=jax.random.key"),
        (lh.Map(lambda n, x, a: a * x), {"clock": "jumps"}, "clock='jumps'"),
    ],
)  # fmt: skip
def test_bad_input(system, keywords, says):
    keywords = {"key": KEY, "t1": 100} | keywords
    with pytest.raises(ValueError, match=says):
        lh.lyapunov_gradient(system, [0.5, 0.5], 0.5, algorithm="linear_response", **keywords)


@pytest.mark.slow
def test_a_function_within_a_jit_may_take_a_time_that_it_does_not_need():
    rule = jax.jit(blaschke)
    found = gradient(lambda n, x, a: rule(n, x, a), [0.3], 0.4, 1000)
    assert np.isfinite(found.gradient[0])
