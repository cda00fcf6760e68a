"""Laws that hold whatever the numbers: linear systems, sums, zeros, orders, two methods on one system."""

import inspect

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import lyaphybrid as lh
from examples import HENON, TABLE, TABLE_ARGS
from lyaphybrid import zoo
from lyaphybrid.integrators.runge_kutta import TABLEAUX

SPIRAL = np.array([[0.3, -2.0, 0.0], [2.0, 0.3, 0.0], [0.1, 0.0, -0.7]])
LINEAR = lh.Flow(lambda t, x, a: a @ x)
LORENZ = lh.Flow(
    lambda t, x, args: jnp.stack([10.0 * (x[1] - x[0]), x[0] * (28.0 - x[2]) - x[1], x[0] * x[1] - 8.0 / 3.0 * x[2]])
)


# --- linear systems ----------------------------------------------------------------------------------------------


def test_a_linear_flow_has_the_real_parts_of_its_eigenvalues():
    run = lh.lyapunov_spectrum(LINEAR, [1.0, 0.0, 1.0], jnp.asarray(SPIRAL), t1=40 * np.pi, averaging="birkhoff")
    assert_allclose(run.exponents, [0.3, 0.3, -0.7], rtol=0, atol=1e-6)
    assert_allclose(np.sum(run.history.growth) / (40 * np.pi), -0.1, rtol=0, atol=1e-9)
    assert run.sum_rule_residual < 1e-9


@pytest.mark.parametrize("n", [2, 5, *(pytest.param(n, marks=pytest.mark.slow) for n in (18, 40))])
def test_a_linear_map_has_the_logarithms_of_its_multipliers(n):
    """k = 2, 5, 18, 40 columns: Gram–Schmidt by columns, in stages and as a loop; LAPACK."""
    sizes = np.geomspace(3.0, 0.2, n)
    upper = np.diag(sizes) + np.triu(0.1 * np.random.default_rng(n).normal(size=(n, n)), 1)
    run = lh.lyapunov_spectrum(lh.Map(lambda t, x, a: a @ x), np.full(n, 1e-200), jnp.asarray(upper), t1=200, blocks=4)
    assert_allclose(run.exponents, np.log(sizes), rtol=0, atol=1e-12)  # triangular: the unit frame stays


@pytest.mark.parametrize("kind", ["mgs", "lapack", "cholesky"])
def test_all_orthonormalisations_give_the_same(kind):
    usual = lh.lyapunov_spectrum(HENON, [0.1, 0.1], 1.4, t1=60, blocks=4, every=2)
    other = lh.lyapunov_spectrum(HENON, [0.1, 0.1], 1.4, t1=60, blocks=4, every=2, orthonormalise=kind)
    assert_allclose(other.exponents, usual.exponents, rtol=0, atol=1e-12)
    assert_allclose(np.abs(other.frame), np.abs(usual.frame), rtol=0, atol=1e-8)


def test_leading_exponents_are_those_of_the_whole_spectrum():
    start = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    whole, one = (
        lh.lyapunov_spectrum(LORENZ, [1.0, 1.0, 20.0], t1=20.0, frame=start[:, :k], blocks=4, every=0.1) for k in (3, 1)
    )
    assert one.exponents.shape == (1,)
    assert one.sum_rule_residual is None  # only a whole frame has a volume
    assert_allclose(one.exponents, whole.exponents[:1], rtol=0, atol=2e-5)  # its steps are its own


# --- sums and zeros ----------------------------------------------------------------------------------------------


def test_the_sum_of_the_lorenz_exponents_is_the_divergence():
    run = lh.lyapunov_spectrum(LORENZ, [1.0, 1.0, 20.0], t1=200.0)
    assert_allclose(jnp.sum(run.exponents), -(10.0 + 1.0 + 8.0 / 3.0), rtol=0, atol=1e-8)
    assert run.sum_rule_residual < 1e-8
    assert abs(float(run.exponents[1])) < 0.02  # along the flow


@pytest.mark.slow
def test_the_sum_rule_counts_the_jumps():
    """tr Df = -0.05; a bounce has ln|det S| = 2 ln r, a kick changes no volume."""
    run = lh.lyapunov_spectrum(TABLE, [1.0, 0.2], TABLE_ARGS, t1=12.0)
    path = lh.trajectory(TABLE, [1.0, 0.2], TABLE_ARGS, t1=12.0, n=2)
    bounces = int(np.sum(np.asarray(path.events.transition) == 0))
    assert bounces > 10
    assert run.sum_rule_residual < 1e-8
    assert_allclose(jnp.sum(run.exponents), -0.05 + 2 * np.log(0.8) * bounces / 12.0, rtol=0, atol=1e-8)


@pytest.mark.slow
def test_the_sum_rule_sees_what_rounding_has_spoilt():
    """A residual that could not be large would say nothing: in 60 steps a spread of e^(60·2.03) leaves no digit."""
    run, rare = (lh.lyapunov_spectrum(HENON, [0.1, 0.1], 1.4, t1=1200, every=n, blocks=4) for n in (None, 60))
    assert run.sum_rule_residual < 1e-12
    assert_allclose(jnp.sum(run.exponents), np.log(0.3), rtol=0, atol=1e-12)
    assert rare.sum_rule_residual > 1e-3
    assert rare.notes == {"unresolved"}  # which is no loss of rank


# --- order, and two methods --------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("tableau", TABLEAUX)
def test_the_order_of_a_method_holds_for_state_and_tangent_across_impacts(tableau):
    """Halving the step divides the error by 2^order: forced oscillator, three impacts, against a fine run."""
    order = TABLEAUX[tableau].order
    problem = zoo.impact_oscillator()

    @jax.jit
    def end(dt):
        run = lh.tangent_map(
            problem.system, [-0.4, 0.3], problem.args, t1=4.0, method=lh.RungeKutta(tableau, dt=dt), throw=False
        )
        return jnp.concatenate([run.x, run.matrix.ravel()]), run.jumps

    steps = 4.0 / np.array([14, 28] if order == 8 else [40, 80])
    fine, jumps = end(4.0 / (56 if order == 8 else 640))
    errors = [float(jnp.max(jnp.abs(end(dt)[0] - fine))) for dt in steps]
    assert jumps >= 2
    assert errors[0] > 1e-9
    assert np.log2(errors[0] / errors[1]) > order - 0.7


@pytest.mark.parametrize("tableau", TABLEAUX)
def test_a_tableau_is_consistent_and_documented(tableau):
    """Nodes are sums of the rows of A, the weights sum to 1 and those of error estimates to 0."""
    table = TABLEAUX[tableau]
    np.testing.assert_allclose([np.sum(row) for row in table.a], table.c, rtol=0, atol=1e-14)
    assert np.sum(table.b) == pytest.approx(1.0, abs=1e-14)
    assert all(abs(np.sum(row)) < 1e-14 for row in table.errors)
    assert f'"{tableau}"' in inspect.getdoc(lh.RungeKutta)


@pytest.mark.slow
def test_tolerances_bound_the_error():
    exact = lh.tangent_map(TABLE, [1.0, 0.2], TABLE_ARGS, t1=6.0, method=lh.RungeKutta(rtol=1e-13, atol=1e-15))
    for rtol in (1e-5, 1e-8):
        run = lh.tangent_map(TABLE, [1.0, 0.2], TABLE_ARGS, t1=6.0, method=lh.RungeKutta(rtol=rtol, atol=rtol / 1e3))
        assert np.max(np.abs(run.x - exact.x)) < 100 * rtol
        assert np.max(np.abs(run.matrix - exact.matrix)) < 1000 * rtol * np.max(np.abs(exact.matrix))


def _stiff_relaxation():
    """A fast variable follows cos x at rate 1e4; the slow one bounces between two walls."""

    def field(t, x, args):
        return jnp.stack([x[1], -x[0], -args * (x[2] - jnp.cos(x[0]))])

    def turn(t, x, args):
        return jnp.stack([x[0], -0.9 * x[1], x[2]])

    return lh.Hybrid(
        field, [lh.Transition(lambda t, x, a: 0.5 + x[0], turn), lh.Transition(lambda t, x, a: 0.5 - x[0], turn)]
    )


@pytest.mark.slow
def test_a_stiff_flow_with_events_by_an_implicit_method():
    """Both methods see the same events; the implicit one in fewer steps, for stability does not bound them."""
    system, x0, steps = _stiff_relaxation(), [0.0, 2.0, 1.0], 4000
    implicit, explicit = lh.Diffrax(diffrax.Kvaerno5(), rtol=1e-8, atol=1e-10), lh.RungeKutta(rtol=1e-8)
    stiff = lh.trajectory(system, x0, 1e4, t1=2.0, n=5, method=implicit, max_steps=steps)
    usual = lh.trajectory(system, x0, 1e4, t1=2.0, n=5, method=explicit)
    with pytest.raises(lh.RunFailedError, match="max_steps"):
        lh.trajectory(system, x0, 1e4, t1=2.0, n=5, method=explicit, max_steps=steps)
    assert len(stiff.events) == len(usual.events) >= 3
    assert_allclose(stiff.events.t, usual.events.t, rtol=0, atol=1e-8)
    assert_allclose(stiff.x, usual.x, rtol=0, atol=1e-7)


@pytest.mark.slow
def test_exponents_of_a_stiff_flow_with_events(monkeypatch):
    monkeypatch.setenv("LYAPHYBRID_ENGINE", "auto")  # diffrax's implicit solvers call Python where they fail
    system, x0 = _stiff_relaxation(), [0.0, 2.0, 1.0]
    implicit = lh.Diffrax(diffrax.Kvaerno5(), rtol=1e-8, atol=1e-10)
    run = lh.lyapunov_spectrum(system, x0, 1e3, t1=2.0, k=2, blocks=4, method=implicit)
    usual = lh.lyapunov_spectrum(system, x0, 1e3, t1=2.0, k=2, blocks=4, method=lh.RungeKutta(rtol=1e-10))
    assert run.jumps == usual.jumps >= 3
    assert_allclose(run.exponents, usual.exponents, rtol=0, atol=1e-5)


# --- what the arguments of a spectrum mean -------------------------------------------------------------------------


def test_count_start_adds_the_growth_of_the_given_frame():
    frame = np.array([[2.0, 1.0], [0.0, 3.0]])
    runs = [
        lh.lyapunov_spectrum(HENON, [0.1, 0.1], 1.4, t1=50, blocks=4, frame=frame, count_start=count)
        for count in (False, True)
    ]
    without, counted = (np.sum(np.asarray(run.history.exponents[-1])) for run in runs)
    assert_allclose(counted - without, np.log(6.0) / 50, rtol=1e-10)


def test_averagings_agree_and_the_smooth_one_converges_faster():
    """Quasiperiodic growth ln|2 + cos(n φ)|, whose mean is known: ln((2 + √3)/2)."""
    rotor = lh.Map(lambda n, x, args: jnp.stack([x[0] + 2.399963229728653, x[1] * (2.0 + jnp.cos(x[0]))]))
    exact = np.log((2 + np.sqrt(3)) / 2)
    uniform, smooth = (
        lh.lyapunov_spectrum(rotor, [0.3, 0.0], t1=2000, blocks=1000, averaging=averaging)
        for averaging in ("uniform", "birkhoff")
    )
    assert abs(float(uniform.exponents[0]) - exact) < 1e-3
    assert abs(float(smooth.exponents[0]) - exact) < 1e-8 < abs(float(uniform.exponents[0]) - exact)


def test_regular_averaging_takes_the_linear_growth_away():
    """A shear: |dx| grows like t, its exponent is 0; uniform means fall like ln(t)/t only."""
    shear = lh.Map(lambda n, x, args: jnp.stack([x[0] + x[1], x[1]]))
    runs = {
        averaging: lh.lyapunov_spectrum(
            shear, [0.1, 0.2], t1=4000, blocks=400, frame=np.eye(2)[:, ::-1], averaging=averaging
        )
        for averaging in ("uniform", "birkhoff", "birkhoff-regular")
    }
    size = {name: float(jnp.max(jnp.abs(run.exponents))) for name, run in runs.items()}
    assert size["uniform"] > 1e-3
    assert size["birkhoff-regular"] < 1e-6 < size["birkhoff"]


def test_until_goes_on_to_the_wanted_error():
    short = lh.lyapunov_spectrum(HENON, [0.1, 0.1], 1.4, t1=5000)
    long = lh.lyapunov_spectrum(HENON, [0.1, 0.1], 1.4, t1=5000, target_stderr=0.002)
    assert float(short.stderr[0]) > 0.002 >= float(np.max(long.stderr))
    assert float(long.time) > 5000
    assert float(long.time) % 5000 == 0
    assert_allclose(np.nansum(long.history.growth[:, 0]) / long.time, long.exponents[0], rtol=1e-12)


@pytest.mark.parametrize("more", [{}, {"times": [1.0, 4.0, 64.0]}, {"max_steps": 10**6}])
def test_an_error_that_no_run_reaches_ends_it(more):
    """Errors fall like 1/√t: from 1e-2 to 1e-30 that would take 1e56 times t1."""
    with pytest.raises(lh.RunFailedError, match="target_stderr=1e-30 is out of reach") as failed:
        lh.lyapunov_spectrum(HENON, [0.1, 0.1], 1.4, t1=64, target_stderr=1e-30, **more)
    found = failed.value.result
    assert found.status is lh.STATUS.stalled
    assert found.time == 64
    assert np.all(np.isfinite(found.exponents))


@pytest.mark.slow
def test_replicates_are_perturbed_starts_and_their_scatter_is_the_error():
    runs = [
        lh.lyapunov_spectrum(HENON, [0.1, 0.1], 1.4, t1=1000, transient=100, replicates=8, key=jax.random.key(seed))
        for seed in (1, 1, 2)
    ]
    assert runs[0].replicates.shape == (8, 2)
    assert np.array_equal(runs[0].replicates, runs[1].replicates)
    assert not np.array_equal(runs[0].replicates, runs[2].replicates)
    assert_allclose(runs[0].stderr, np.std(runs[0].replicates, axis=0, ddof=1) / np.sqrt(8), rtol=1e-12)
    assert np.all(np.abs(runs[0].exponents - runs[2].exponents) < 5 * np.hypot(runs[0].stderr, runs[2].stderr))


@pytest.mark.parametrize("times", ["log", (1.0, 2.0, 4.0, 20.0)])
def test_times_of_the_history_are_as_asked_for(times):
    run = lh.lyapunov_spectrum(LORENZ, [1.0, 1.0, 20.0], t1=20.0, k=1, times=times, blocks=5)
    wanted = np.geomspace(0.02, 20.0, 5) if times == "log" else times
    assert_allclose(run.history.time, wanted, rtol=1e-12)


@pytest.mark.slow
def test_error_bars_are_honest():
    """The logistic map's exponent is ln 2: the error bar covers the true error in most of 40 runs."""
    starts = jnp.linspace(0.1, 0.45, 40)[:, None]
    run = jax.vmap(
        lambda x: lh.lyapunov_spectrum(lh.Map(lambda n, x, r: r * x * (1 - x)), x, 4.0, t1=20_000, transient=100)
    )(starts)
    off = np.abs(np.asarray(run.exponents[:, 0]) - np.log(2)) / np.asarray(run.stderr[:, 0])
    assert np.max(off) < 5
    assert 0.4 < np.mean(off < 1)
