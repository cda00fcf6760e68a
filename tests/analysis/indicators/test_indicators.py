"""Indicators of chaos against closed forms, brute force and each other; for maps, flows and systems that jump."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
from numpy.testing import assert_allclose

import balls
import lyaphybrid as lh
from lyaphybrid import zoo

CAT = np.array([[3.0, 2.0], [1.0, 1.0]])
cat = lh.Map(lambda n, x, args: jnp.stack([3 * x[0] + 2 * x[1], x[0] + x[1]]) % 1.0)


def torus(**more):
    return zoo.henon_heiles(y=0.55, **more)


def sea():
    return zoo.henon_heiles()


# GALI and SALI.


def brute_force(matrices, vectors):
    """ln of the volumes of the first 2, 3, … unit vectors, from the fundamental matrix at each time."""
    found = []
    for matrix in matrices:
        moved = np.asarray(matrix) @ vectors
        moved = moved / np.linalg.norm(moved, axis=0)
        k = vectors.shape[1]
        found.append([np.sum(np.log(np.linalg.svd(moved[:, :j], compute_uv=False))) for j in range(2, k + 1)])
    return np.array(found)


@pytest.mark.slow
def test_gali_is_the_product_of_singular_values():
    problem, times = torus(), np.array([3.0, 10.0, 31.0, 60.0])
    vectors = np.linalg.qr(np.random.default_rng(5).standard_normal((4, 4)))[0]
    vectors[:, 2] += 0.7 * vectors[:, 0]  # they need not be orthogonal
    vectors = vectors / np.linalg.norm(vectors, axis=0)
    ours = lh.gali(
        problem.system, problem.x0, t1=60.0, times=times, orders=(2, 3, 4), frame=vectors, method=problem.method
    )
    matrices = [lh.tangent_map(problem.system, problem.x0, t1=t, method=problem.method).matrix for t in times]
    assert ours.orders == (2, 3, 4)
    assert ours.values.shape == (4, 3)
    assert_allclose(ours.log_values, brute_force(matrices, vectors), rtol=0, atol=1e-8)


@pytest.mark.slow
def test_gali_through_impacts_is_the_product_of_singular_values():
    problem = zoo.impact_oscillator(omega=2.0)
    options = {"mode": problem.mode, "method": lh.RungeKutta(rtol=1e-11, atol=1e-13)}
    times, vectors = np.array([4.0, 11.0, 20.0]), np.array([[0.8, -0.3], [0.6, 0.95393920141]])
    vectors = vectors / np.linalg.norm(vectors, axis=0)
    ours = lh.gali(problem.system, problem.x0, problem.args, t1=20.0, times=times, frame=vectors, **options)
    matrices = [lh.tangent_map(problem.system, problem.x0, problem.args, t1=t, **options).matrix for t in times]
    assert_allclose(ours.log_values, brute_force(matrices, vectors), rtol=0, atol=1e-6)


@pytest.mark.slow
def test_gali_far_below_the_smallest_float():
    """The cat map: ln GALI_2 falls by the difference of the exponents at every step."""
    found = lh.gali(cat, [0.1, 0.2], t1=4000, times=np.arange(100, 4001, 100))
    gap = 2 * np.log(2 + np.sqrt(3))
    assert_allclose(np.diff(np.asarray(found.log_values)[:, 0]), -100 * gap, rtol=1e-11)
    assert float(found.log_values[-1, 0]) < -10_000
    assert float(found.values[-1, 0]) == 0.0


@pytest.mark.slow
def test_sali_is_the_shorter_diagonal():
    problem, times = sea(), np.array([5.0, 20.0, 80.0])
    vectors = np.linalg.qr(np.random.default_rng(6).standard_normal((4, 2)))[0]
    ours = lh.sali(problem.system, problem.x0, t1=80.0, times=times, frame=vectors, method=problem.method)
    for t, value in zip(times, np.asarray(ours.values), strict=True):
        moved = np.asarray(lh.tangent_map(problem.system, problem.x0, t1=t, method=problem.method).matrix) @ vectors
        a, b = (moved / np.linalg.norm(moved, axis=0)).T
        assert_allclose(value, min(np.linalg.norm(a + b), np.linalg.norm(a - b)), rtol=1e-7)


@pytest.mark.slow
def test_several_starts_at_once_and_under_jit():
    problem = torus()
    starts = jnp.stack([problem.x0, sea().x0])
    together = lh.gali(problem.system, starts, t1=200.0, method=problem.method, blocks=8)
    alone = [lh.gali(problem.system, x, t1=200.0, method=problem.method, blocks=8) for x in starts]
    assert together.log_values.shape == (2, 8, 3)
    compiled = jax.jit(lambda x: lh.gali(problem.system, x, t1=200.0, method=problem.method, blocks=8).log_values)
    for i in range(2):
        assert_allclose(together.log_values[i], alone[i].log_values, rtol=0, atol=1e-9)
        assert_allclose(compiled(starts[i]), alone[i].log_values, rtol=0, atol=1e-9)


@pytest.mark.slow
def test_a_direction_that_a_jump_destroys():
    """A reset that kills a direction makes all volumes 0 for ever."""
    system = lh.Hybrid(
        lambda t, x, args: jnp.stack([x[1], -x[0], 0.1 * x[2]]),
        lh.Transition(every=1.0, phase=0.5, reset=lambda t, x, args: jnp.stack([x[0], 0 * x[1], x[2]])),
    )
    found = lh.gali(system, [1.0, 0.0, 0.1], t1=4.0, times=[0.4, 1.0, 4.0])
    values = np.asarray(found.log_values)
    assert np.all(np.isfinite(values[0]))
    assert np.all(np.isneginf(values[1:, 1]))  # three vectors in a plane
    assert found.verdict.kind == "undecided"


# What grows.


def test_a_shear_in_closed_form():
    """w(t) = (1, t): ln ‖w‖ = ½ ln(1 + t²), and its integral is known."""
    shear = lh.Flow(lambda t, x, args: jnp.stack([x[1], 0 * x[1]]))
    frame, t = np.array([[0.0], [1.0]]), 50.0
    method = lh.RungeKutta("rk4", dt=0.005)
    length = 0.5 * np.log(1 + t * t)
    area = t * length - t + np.arctan(t)
    found = lh.megno(shear, [0.0, 1.0], t1=t, frame=frame, method=method)
    assert_allclose(found.values[-1], 2 * (length - area / t), rtol=0, atol=1e-6)
    assert_allclose(lh.fli(shear, [0.0, 1.0], t1=t, frame=frame, method=method).values[-1], length, rtol=0, atol=1e-12)
    across = lh.ofli(shear, [0.0, 1.0], t1=t, frame=frame, method=method)
    assert_allclose(across.values[-1], 0.0, rtol=0, atol=1e-12)  # the part across the flow (1, 0) stays 1


def test_megno_of_a_map_in_closed_form():
    """Y = (2/t) Σ (s − ½) λ = λ t for a vector that grows by the same factor at each step."""
    _, vectors = np.linalg.eigh(CAT @ CAT.T)
    eigenvalues, right = (np.real(part) for part in np.linalg.eig(CAT))  # of real ones too NumPy 2.5 gives complex ones
    frame = right[:, [np.argmax(eigenvalues)]]
    growth = np.log(np.max(eigenvalues))
    found = lh.megno(cat, [0.1, 0.2], t1=400, frame=frame, times=[100.0, 200.0, 400.0])
    assert_allclose(found.values, growth * np.array([100.0, 200.0, 400.0]), rtol=1e-12)
    assert_allclose(found.mean, growth * np.array([100.0, 200.0, 400.0]) / 2, rtol=1e-3)
    assert vectors.shape == (2, 2)


GROWS = lh.Flow(lambda t, x, args: jnp.stack([1 + 0 * x[0], x[1] + x[1] ** 2]))
UP = [[0.0], [1.0]]


@pytest.mark.parametrize(
    ("method", "tolerance"),
    [(lh.RungeKutta("dopri5", rtol=1e-10), 1e-6), (lh.RungeKutta("rk4", dt=0.01), 1e-6)],
    ids=["adaptive", "fixed"],
)
def test_ofli2_in_closed_form(method, tolerance):
    """y' = y + y² at y = 0: ξ = eᵗ, δξ = 2(eᵗ − 1)eᵗ, so ξ + ½ δξ = e²ᵗ, beyond what a float can hold."""
    found = lh.ofli2(GROWS, [0.0, 0.0], t1=600.0, frame=UP, method=method, blocks=8)
    assert_allclose(found.values, 2 * found.time, rtol=0, atol=tolerance)
    assert found.verdict.kind == "chaotic"


@pytest.mark.slow
def test_ofli2_is_the_second_derivative_of_the_motion():
    """Two derivatives through all steps of a leapfrog that is written out here."""
    problem, h, times = sea(), 0.05, np.array([0.05, 5.0, 20.0, 60.0])
    force = problem.system.field.force

    def steps(x):
        def step(x, _):
            q, p = x[:2] + h / 2 * x[2:], x[2:]
            p = p + h * force(q, None)
            x = jnp.concatenate([q + h / 2 * p, p])
            return x, x

        return jax.lax.scan(step, x, None, length=1200)[1]

    gradient = np.asarray(jax.grad(problem.system.energy)(problem.x0))
    along = jnp.asarray(gradient / np.linalg.norm(gradient))
    way = steps(problem.x0)
    xi, second = jax.jvp(lambda x: jax.jvp(steps, (x,), (along,))[1], (problem.x0,), (along,))
    vectors = np.asarray(xi + second / 2)
    fields = np.asarray(jax.vmap(lambda x: problem.system.field(0.0, x, None))(way))
    across = vectors - fields * np.sum(vectors * fields, axis=1, keepdims=True) / np.sum(
        fields**2, axis=1, keepdims=True
    )
    highest = np.maximum.accumulate(np.log(np.linalg.norm(across, axis=1)))
    ours = lh.ofli2(problem.system, problem.x0, t1=60.0, times=times, method=lh.Symplectic("leapfrog", dt=h))
    expected = np.maximum(0.0, highest[np.round(times / h).astype(int) - 1])
    assert_allclose(ours.values, expected, rtol=0, atol=1e-9)


@pytest.mark.slow
def test_ofli2_of_several_starts_and_under_jit():
    problem, options = torus(), {"t1": 50.0, "blocks": 4, "method": lh.Symplectic("leapfrog", dt=0.05)}
    starts = jnp.stack([problem.x0, sea().x0])
    together = lh.ofli2(problem.system, starts, **options).values
    compiled = jax.jit(lambda x: lh.ofli2(problem.system, x, **options).values)
    for x, values in zip(starts, together, strict=True):
        assert_allclose(values, lh.ofli2(problem.system, x, **options).values, rtol=0, atol=1e-10)
        assert_allclose(values, compiled(x), rtol=0, atol=1e-10)


VERDICTS = [
    ("a torus", torus, "regular"),
    ("the sea", sea, "chaotic"),
]


@pytest.mark.slow_cases("ofli2-a torus", "ofli-a torus", "gali-a torus", "sali-a torus", "megno-a torus")
@pytest.mark.parametrize(("name", "make", "kind"), VERDICTS, ids=[name for name, *_ in VERDICTS])
@pytest.mark.parametrize("indicator", [lh.gali, lh.sali, lh.megno, lh.fli, lh.ofli, lh.ofli2], ids=lambda f: f.__name__)
def test_verdicts(indicator, name, make, kind):
    problem = make()
    verdict = indicator(problem.system, problem.x0, t1=10_000.0, method=problem.method).verdict
    print(name, verdict)
    assert verdict.kind == kind
    assert verdict.kind in str(verdict)


@pytest.mark.slow
def test_a_short_run_decides_nothing():
    problem = sea()
    found = lh.gali(problem.system, problem.x0, t1=30.0, method=problem.method)
    assert found.verdict.kind != "chaotic"
    assert lh.fli(problem.system, problem.x0, t1=30.0, blocks=4, method=problem.method).verdict.kind == "undecided"


@pytest.mark.slow
def test_hybrid_chaos_and_hybrid_order():
    for parameters, kind in (({}, "chaotic"), ({"omega": 2.0}, "regular")):
        problem = zoo.impact_oscillator(**parameters)
        found = lh.fli(problem.system, problem.x0, problem.args, t1=2000.0, mode=problem.mode)
        print(found.verdict)
        assert found.verdict.kind == kind


@pytest.mark.slow
def test_pictures_show_each_order():
    problem = torus()
    options = {"t1": 50.0, "blocks": 8, "method": problem.method}
    found = lh.gali(problem.system, problem.x0, **options)
    ax = found.plot()
    assert [text.get_text() for text in ax.get_legend().get_texts()] == ["GALI$_{2}$", "GALI$_{3}$", "GALI$_{4}$"]
    for line, logs in zip(ax.get_lines(), np.asarray(found.log_values).T, strict=True):
        assert_allclose(line.get_ydata(), logs / np.log(10))
    assert lh.sali(problem.system, problem.x0, **options).plot().get_ylabel().endswith("SALI")
    mean = lh.megno(problem.system, problem.x0, **options)
    assert_allclose(mean.plot().get_lines()[1].get_ydata(), mean.mean)
    assert len(lh.fli(problem.system, problem.x0, **options).plot().get_lines()) == 1


REFUSED = [
    (lambda: lh.gali(cat, [0.1, 0.2], t1=10, orders=(3,)), "orders must be"),
    (lambda: lh.gali(cat, [0.1, 0.2], t1=10, frame=np.eye(3)), "frame must have shape"),
    (lambda: lh.ofli(cat, [0.1, 0.2], t1=10), "needs an lh.Flow"),
    (lambda: lh.ofli2(cat, [0.1, 0.2], t1=10), "needs an lh.Flow or lh.Hamiltonian"),
    (lambda: lh.ofli2(zoo.pendulum_dae().system, [0.1] * 3, t1=10.0), "takes two derivatives of a flow"),
    (lambda: lh.ofli2(GROWS, [0.0, 0.0], t1=10.0, frame=np.eye(2)), "frame must have shape"),
    (
        lambda: lh.ofli2(sea().system, sea().x0, t1=10.0, method=lh.TangentHamiltonian("cc", dt=0.1)),
        "differentiates the step itself",
    ),
    (lambda: lh.covariant_vectors(cat, [0.1, 0.2], t1=10, k=3), "deviation vectors were asked for"),
    (lambda: lh.covariant_vectors(cat, [0.1, 0.2], t1=-10), "must be positive"),
]


@pytest.mark.parametrize(("call", "says"), REFUSED, ids=[says for _, says in REFUSED])
def test_bad_arguments_are_refused(call, says):
    with pytest.raises(ValueError, match=says):
        call()


@pytest.mark.parametrize("verb", [lh.sali, lh.megno, lh.fli, lh.ofli, lh.ofli2])
def test_what_they_do_not_take_python_refuses(verb):
    with pytest.raises(TypeError, match="unexpected keyword argument 'orders'"):
        verb(cat, [0.1, 0.2], t1=10, orders=(2,))


def test_a_run_that_fails_says_so_and_keeps_what_it_has():
    blowing_up = lh.Flow(lambda t, x, args: x**2)
    with pytest.raises(lh.RunFailedError) as failure:
        lh.fli(blowing_up, [1.0], t1=2.0)
    assert failure.value.status in (lh.STATUS.nonfinite, lh.STATUS.step_underflow)
    found = lh.fli(blowing_up, [1.0], t1=2.0, throw=False)
    assert found.status.failed
    assert np.isfinite(found.values[0])
    assert np.isnan(found.values[-1])


# Covariant vectors.


@pytest.mark.slow
def test_the_angle_of_the_cat_map():
    found = lh.covariant_vectors(cat, [0.1, 0.2], t1=100, blocks=100)
    assert_allclose(np.degrees(found.angles), 73.89788624801, rtol=0, atol=1e-8)
    assert_allclose(found.exponents, np.log([2 + np.sqrt(3), 2 - np.sqrt(3)]), rtol=0, atol=1e-12)
    assert_allclose(found.time, np.arange(101))
    assert "growth per iteration" in str(found)


@pytest.mark.slow
def test_vectors_of_the_henon_map_are_carried_along():
    problem = zoo.henon_map()
    found = lh.covariant_vectors(
        problem.system, problem.x0, problem.args, t1=2000, blocks=2000, transient=500, settle=500
    )
    jacobian = jax.vmap(jax.jacfwd(lambda x: problem.system.rule(0.0, x, problem.args)))(found.x)
    moved = np.einsum("tij,tjk->tik", np.asarray(jacobian), np.asarray(found.vectors))[:-1]
    lengths = np.linalg.norm(moved, axis=1)
    assert_allclose(np.log(lengths), found.growth, rtol=0, atol=1e-7)
    along = np.abs(np.sum(moved / lengths[:, None, :] * np.asarray(found.vectors)[1:], axis=1))
    assert_allclose(along, 1.0, rtol=0, atol=1e-9)
    exponents = problem.spectrum(t1=2000, transient=500).exponents
    assert_allclose(found.exponents, exponents, rtol=0, atol=2e-2)
    assert_allclose(jnp.sum(found.exponents), np.log(0.3), rtol=0, atol=2e-2)


@pytest.mark.slow
@pytest.mark.parametrize("k", [3, 2])
def test_the_neutral_vector_of_lorenz_is_the_flow(k):
    problem = zoo.lorenz63()
    lengths = {"t1": 50.0, "blocks": 1000, "transient": 50.0, "settle": 50.0}
    found = lh.covariant_vectors(problem.system, problem.x0, problem.args, k=k, **lengths)
    assert found.vectors.shape == (1001, 3, k)
    assert found.angles.shape == (1001, k * (k - 1) // 2)
    flow = np.asarray(jax.vmap(lambda x: problem.system.field(0.0, x, problem.args))(found.x))
    flow = flow / np.linalg.norm(flow, axis=1)[:, None]
    neutral = np.asarray(found.vectors)[:, :, 1]
    off = np.arcsin(np.minimum(1.0, np.linalg.norm(neutral - np.sum(neutral * flow, axis=1)[:, None] * flow, axis=1)))
    print(np.quantile(off, [0.5, 0.9, 0.99, 1.0]))
    assert np.mean(off < 1e-2) >= 0.99


@pytest.mark.slow
def test_vectors_through_impacts():
    """With the phase as a third component the flow itself is a covariant vector; it maps to itself across impacts."""
    omega, zeta, restitution = 2.8, 0.05, 0.8

    def field(t, x, args):
        return jnp.stack([x[1], jnp.cos(x[2]) - 2 * zeta * x[1] - x[0], omega + 0 * x[2]])

    flip = jnp.array([1.0, -restitution, 1.0])
    system = lh.Hybrid(field, lh.Transition(lambda t, x, args: -x[0], lambda t, x, args: flip * x))
    method = lh.RungeKutta(rtol=1e-12, atol=1e-14)
    found = lh.covariant_vectors(
        system, [-0.1, 0.5, 0.0], t1=200.0, blocks=800, transient=200.0, settle=200.0, method=method
    )
    flow = np.asarray(jax.vmap(lambda x: field(0.0, x, None))(found.x))
    flow = flow / np.linalg.norm(flow, axis=1)[:, None]
    exponents = np.asarray(found.exponents)
    neutral = np.argmin(np.abs(exponents))
    assert abs(exponents[neutral]) < 1e-2
    vector = np.asarray(found.vectors)[:, :, neutral]
    off = np.linalg.norm(vector - np.sum(vector * flow, axis=1)[:, None] * flow, axis=1)  # the sine of the angle
    print(exponents, np.max(off))
    assert np.max(off) < 1e-8


@pytest.mark.slow
def test_a_direction_that_is_lost_at_each_period():
    """One direction is killed at each tick; those that go on are the vectors of what is left."""
    matrix = np.array([[0.1, 0.4, 0.2], [0.0, -0.3, 0.5], [0.3, 0.1, -0.2]])
    system = lh.Hybrid(
        lambda t, x, args: jnp.asarray(matrix) @ x,
        lh.Transition(every=1.0, phase=0.5, reset=lambda t, x, args: jnp.array([1.0, 1.0, 0.0]) * x),
    )
    lengths = {"t1": 20.0, "blocks": 20, "transient": 60.0, "settle": 60.0}
    method = lh.RungeKutta(rtol=1e-12, atol=1e-14)
    found = lh.covariant_vectors(system, [1.0, 0.5, 0.2], method=method, **lengths)
    half = scipy.linalg.expm(0.5 * matrix)
    period = half @ np.diag([1.0, 1.0, 0.0]) @ half
    eigenvalues, right = np.linalg.eig(period)
    order = np.argsort(-np.abs(eigenvalues))
    assert np.all(np.isreal(eigenvalues))
    assert_allclose(found.exponents[:2], np.log(np.abs(eigenvalues[order[:2]])), rtol=0, atol=1e-9)
    assert np.isneginf(found.exponents[2])
    for i in range(3):
        vector = np.real(right[:, order[i]])
        along = np.abs(np.asarray(found.vectors)[:-1, :, i] @ (vector / np.linalg.norm(vector)))
        assert_allclose(along, 1.0, rtol=0, atol=1e-9)


# Long runs.


def slopes(found, first, last):
    """d ln GALI_k / d ln t by least squares over the times between."""
    time = np.asarray(found.time)
    chosen = (time >= first) & (time <= last * (1 + 1e-9))
    assert np.sum(chosen) >= 30
    return np.polyfit(np.log(time[chosen]), np.asarray(found.log_values)[chosen], 1)[0]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "parameters", "orders", "expected", "first", "within", "dt"),
    [
        ("henon_heiles", {"y": 0.55}, range(2, 5), [0, -2, -4], 1e4, 0.3, 0.05),
        ("hamiltonian_3d", {}, range(2, 7), [0, 0, -2, -4, -6], 1e4, 0.3, 0.05),
        (
            "fpu_beta", {}, range(2, 17), [-max(0, k - 4) if k <= 12 else -2 * (k - 8) for k in range(2, 17)], 1e5, 0.5,
            0.2,
        ),
    ],
    ids=["R1", "R2", "R3"],
)  # fmt: skip
def test_slopes_on_tori(name, parameters, orders, expected, first, within, dt):
    problem = zoo.get(name)(**parameters)
    times = np.geomspace(first / 10, 1e6, 100)
    method = lh.Symplectic("SBAB2C", dt=dt)
    found = lh.gali(problem.system, problem.x0, problem.args, t1=1e6, times=times, orders=orders, method=method)
    seen = slopes(found, first, 1e6)
    print(name, np.round(seen, 2))
    assert_allclose(seen, expected, rtol=0, atol=within)


@pytest.mark.slow
def test_slopes_in_chaos_are_differences_of_exponents():
    """Means over stretches of one orbit: the two runs of a stretch part, and what each finds in it differs."""
    problem, t1 = sea(), 2e5
    start, times, slopes, expected = problem.x0, np.linspace(2e3, t1, 100), [], []
    for _ in range(12):
        found = lh.gali(problem.system, start, t1=t1, times=times, orders=(2, 3, 4), method=problem.method)
        run = problem.spectrum(x0=start, t1=t1)
        slopes.append(np.polyfit(times, np.asarray(found.log_values), 1)[0])
        expected.append([-np.sum(run.exponents[0] - run.exponents[1:k]) for k in (2, 3, 4)])
        start = run.x
    slopes, expected = np.array(slopes), np.array(expected)
    stderr = np.hypot(np.std(slopes, axis=0), np.std(expected, axis=0)) / np.sqrt(11)
    print(slopes.mean(0), expected.mean(0), stderr)
    assert np.all(stderr < 0.05 * np.abs(expected.mean(axis=0)))
    assert np.all(np.abs(slopes.mean(axis=0) - expected.mean(axis=0)) < 3 * stderr)


@pytest.mark.slow
def test_megno_of_a_torus_and_of_the_sea():
    problem = torus()
    found = lh.megno(problem.system, problem.x0, t1=1e5, method=problem.method)
    assert abs(float(found.mean[-1]) - 1.97) < 0.05
    problem = sea()
    found = lh.megno(problem.system, problem.x0, t1=1e5, method=problem.method)
    growth = lh.fli(problem.system, problem.x0, t1=1e5, method=problem.method).values[-1]
    print(found.mean[-1], growth / 2)
    assert abs(float(found.mean[-1]) / float(growth / 2) - 1) < 0.15


@pytest.mark.slow
def test_birkhoff_weights_on_a_torus():
    problem = torus()
    spectrum = problem.spectrum(t1=1e5, averaging="birkhoff-regular", blocks=2000, k=2)
    print(spectrum.exponents)
    assert abs(float(spectrum.exponents[0])) <= 1e-7


@pytest.mark.slow
def test_a_map_of_stability_is_settled_early():
    """Hénon and Heiles: SALI at t = 3000 says the same of the starts of a section as at t = 10 000."""
    n, limit = 45, np.log(1e-4)
    y, py = np.meshgrid(np.linspace(-0.5, 0.75, n), np.linspace(-0.55, 0.55, n))
    square = 0.25 - py**2 - y**2 + 2 * y**3 / 3
    inside = square >= 0
    starts = np.stack([0 * y, y, np.sqrt(np.where(inside, square, 0.0)), py], axis=-1)[inside]
    chaotic = {}
    for t1 in (3000.0, 10_000.0):
        method = lh.Symplectic("SBAB2C", dt=0.1)
        found = lh.sali(sea().system, starts, t1=t1, blocks=2, times=None, method=method)
        chaotic[t1] = np.asarray(found.log_values)[:, -1] < limit
    same = np.mean(chaotic[3000.0] == chaotic[10_000.0])
    print(len(starts), np.mean(chaotic[10_000.0]), same)
    assert 0.4 < np.mean(chaotic[10_000.0]) < 0.7
    assert same >= 0.97


@pytest.mark.slow
def test_two_equal_largest_exponents_are_no_regular_motion():
    """Two cat maps side by side: two deviation vectors never align, and GALI_3 says that they tell nothing."""

    def cats(n, x, args):
        a, b, c, d = x
        return jnp.stack([2 * a + b, a + b, 2 * c + d, c + d]) % 1.0

    start = [0.1, 0.2, 0.37, 0.71]
    found = lh.gali(lh.Map(cats), start, t1=300)
    assert found.verdict.kind == "undecided"
    assert "lh.fli" in found.verdict.reason
    assert lh.fli(lh.Map(cats), start, t1=300).verdict.kind == "chaotic"
    without = lh.gali(lh.Map(cats), start, t1=300, orders=(3, 4))
    assert without.verdict.kind == "undecided"
    assert "no 2" in str(without)


@pytest.mark.slow
def test_gali_of_bodies_in_rows():
    """Balls between walls are sheared, (q, v) ↦ ±(q + t v, v): the volume of the normalised columns is known."""
    frame, t = np.linalg.qr(np.random.default_rng(3).standard_normal((4, 3)))[0], 7.3
    columns = np.kron(np.eye(2), [[1.0, t], [0.0, 1.0]]) @ frame
    columns /= np.linalg.norm(columns, axis=0)
    wanted = [np.sum(np.log(scipy.linalg.svdvals(columns[:, :k]))) for k in (2, 3)]
    found = lh.gali(balls.between_walls(), balls.START, t1=t, orders=[2, 3], frame=frame, blocks=4)
    assert_allclose(found.log_values[-1], wanted, rtol=1e-10)
    assert lh.gali(balls.between_walls(), balls.START, t1=t, blocks=4).orders == (2, 3, 4)
