"""Stochastic flows along frozen Brownian paths: closed forms, the strong order, and what is refused."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import quad

import lyaphybrid as lh

UNTIL = 64.0


def walked(seed, t, step, sources=1):
    """Where a path is, by noise alone: dx = dW, each source for itself."""
    flow = lh.Flow(lambda t, x, p: 0 * x)
    unit = lambda t, x, p: jnp.eye(sources)  # noqa: E731
    return end(lh.white_noise(flow, unit, step=step, until=UNTIL, sources=sources, seed=seed), [0.0] * sources, None, t)


@pytest.mark.slow
def test_a_path_is_that_of_a_finer_step_and_has_the_right_increments():
    ticks = [float(walked(1, t, 0.5)[0]) for t in (0.5, 1.0, 7.5, 63.5)]
    for step in (0.25, 1 / 64):
        assert_allclose([float(walked(1, t, step)[0]) for t in (0.5, 1.0, 7.5, 63.5)], ticks, rtol=0, atol=1e-12)
    flow = lh.Flow(lambda t, x, p: 0 * x)
    system = lh.white_noise(flow, lambda t, x, p: 1 + 0 * x, step=1 / 64, until=UNTIL, seed=2)
    x = np.asarray(lh.trajectory(system, [0.0], None, t1=UNTIL, n=4096).x[:, 0])
    steps = np.diff(np.concatenate([[0.0], x])) * 8
    assert len(steps) == 4096
    assert abs(np.mean(steps)) < 4 / 64
    assert abs(np.var(steps) - 1) < 4 * (2 / 4096) ** 0.5
    assert abs(np.mean(steps[1:] * steps[:-1])) < 4 / 64
    assert abs(np.mean(steps**4) - 3) < 4 * (96 / 4096) ** 0.5
    lagged = x[64:] - x[:-64]  # over one unit of time: variance 1, in 64 independent ones
    assert abs(np.var(lagged) - 1) < 4 * (2 / 64) ** 0.5


def end(system, x0, args, t1=UNTIL, **how):
    return np.asarray(lh.tangent_map(system, x0, args, t1=t1, **how).x)


@pytest.mark.slow
def test_a_geometric_motion_is_that_of_its_path():
    """dx = a x dt + b x ∘ dW: x = x₀ exp(a t + b W(t)), and the exponent is a + b W(t)/t, of this very path."""
    flow = lh.Flow(lambda t, x, p: p[0] * x)
    system = lh.white_noise(flow, lambda t, x, p: p[1] * x, step=0.25, until=UNTIL, seed=5)
    arrived = float(walked(5, UNTIL, 0.25)[0])
    found = lh.lyapunov_spectrum(system, [1.0], (-0.2, 0.3), t1=UNTIL, method=lh.RungeKutta("dop853", rtol=1e-12))
    exact = -0.2 + 0.3 * arrived / UNTIL
    assert_allclose(found.exponents[0], exact, rtol=0, atol=1e-4)  # RK4 over kicks of size 0.15
    finer = lh.white_noise(
        lh.Flow(lambda t, x, p: p[0] * x), lambda t, x, p: p[1] * x, step=1 / 64, until=UNTIL, seed=5
    )
    again = lh.lyapunov_spectrum(finer, [1.0], (-0.2, 0.3), t1=UNTIL)
    assert_allclose(again.exponents[0], exact, rtol=0, atol=1e-6)


@pytest.mark.slow
def test_additive_noise_of_a_linear_flow_leaves_the_exponent():
    system = lh.white_noise(lh.Flow(lambda t, x, p: -0.7 * x), lambda t, x, p: p + 0 * x, step=0.1, until=400.0)
    found = lh.lyapunov_spectrum(system, [0.0], 0.4, t1=400.0)
    assert_allclose(found.exponents[0], -0.7, rtol=1e-8)
    x = np.asarray(lh.trajectory(system, [0.0], 0.4, t1=400.0, n=4000).x[200:, 0])
    assert abs(np.var(x) - 0.4**2 / 1.4) < 0.03  # of 280 independent values


@pytest.mark.slow
@pytest.mark.parametrize("sigma", [0.3, 0.8])
def test_a_pitchfork_with_multiplicative_noise(sigma):
    """dx = (x − x³) dt + σ x ∘ dW: ⟨x²⟩ = 1, so λ = 1 − 3 = −2 (Arnold 1998, section 9.3)."""
    flow = lh.Flow(lambda t, x, s: x - x**3)
    system = lh.white_noise(flow, lambda t, x, s: s * x, step=0.02, until=1000.0, seed=2)
    found = lh.lyapunov_spectrum(system, [1.0], sigma, t1=900.0, transient=20.0)
    assert abs(found.exponents[0] + 2) < 3 * found.stderr[0]


@pytest.mark.slow
def test_a_pitchfork_with_additive_noise():
    """λ = ⟨1 − 3x²⟩ over the density exp((x² − x⁴/2)/σ²)."""
    sigma = 0.7
    density = lambda x: np.exp((x**2 - x**4 / 2) / sigma**2)  # noqa: E731
    exact = quad(lambda x: (1 - 3 * x**2) * density(x), -4, 4)[0] / quad(density, -4, 4)[0]
    system = lh.white_noise(
        lh.Flow(lambda t, x, s: x - x**3), lambda t, x, s: s + 0 * x, step=0.02, until=3000.0, seed=1
    )
    found = lh.lyapunov_spectrum(system, [0.5], sigma, t1=2900.0, transient=20.0)
    assert abs(found.exponents[0] - exact) < 3 * found.stderr[0]
    assert found.stderr[0] < 0.05


@pytest.mark.slow
def test_two_sources_turn_and_stretch():
    """dx = −x dt + a x ∘ dW₁ + b J x ∘ dW₂: rotations change no length; both exponents are −1 + a W₁(t)/t."""

    def diffusion(t, x, p):
        return jnp.stack([0.2 * x, 0.3 * jnp.stack([-x[1], x[0]])], axis=1)

    flow = lh.Flow(lambda t, x, p: -x)
    system = lh.white_noise(flow, diffusion, step=1 / 32, until=UNTIL, sources=2, seed=lambda p: p["seed"])
    found = lh.lyapunov_spectrum(system, [1.0, 0.0], {"seed": 4}, t1=UNTIL)
    arrived = walked(4, UNTIL, 1 / 32, sources=2)
    assert_allclose(found.exponents, -1 + 0.2 * arrived[0] / UNTIL, rtol=0, atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("noise", ["additive", "multiplicative"])
def test_the_strong_order_is_one(noise):
    """Ends of one path against those of much finer steps: the error falls as the step; mean of several paths."""
    diffusion = {"additive": lambda t, x, p: 0.5 + 0 * x, "multiplicative": lambda t, x, p: 0.5 * jnp.cos(x)}[noise]
    flow = lh.Flow(lambda t, x, p: jnp.sin(2 * x) - x)

    def ends(step):
        system = lh.white_noise(flow, diffusion, step=step, until=4.0, seed=lambda p: p["seed"])
        return np.array([end(system, [0.4], {"seed": jnp.asarray(seed)}, 4.0)[0] for seed in range(24)])

    exact = ends(2.0**-10)
    errors = [np.mean(np.abs(ends(step) - exact)) for step in (2.0**-3, 2.0**-5)]
    assert 0.8 < np.log2(errors[0] / errors[1]) / 2 < 1.3, errors


@pytest.mark.slow
def test_starts_and_parameters_see_the_same_path():
    flow = lh.Flow(lambda t, x, p: -(x**3) - x)
    system = lh.white_noise(flow, lambda t, x, p: p + 0 * x, step=0.05, until=40.0, seed=3)
    assert_allclose(end(system, [2.0], 0.5, 39.0), end(system, [-1.0], 0.5, 39.0), rtol=0, atol=1e-9)
    h = 1e-5
    slope = jax.jacfwd(lambda p: lh.trajectory(system, [1.0], p, t1=5.0, n=1).x[-1, 0])(jnp.asarray(0.5))
    differences = (end(system, [1.0], 0.5 + h, 5.0)[0] - end(system, [1.0], 0.5 - h, 5.0)[0]) / (2 * h)
    assert_allclose(slope, differences, rtol=1e-6)


@pytest.mark.slow
def test_paths_are_swept_and_a_run_goes_on_along_its_own():
    flow = lh.Flow(lambda t, x, p: -(x**3) - x)
    noisy = lh.white_noise(flow, lambda t, x, p: 0.5 + 0 * x, step=0.05, until=20.0, seed=lambda p: p["seed"])

    def run(args, t1=16.0, blocks=8):
        return lh.lyapunov_spectrum(noisy, [1.0], args, t1=t1, blocks=blocks)

    seeds = np.array([1, 2, 5])
    found = lh.sweep(run, {"seed": seeds}, args={"seed": jnp.asarray(1)}, progress=False)
    alone = [run({"seed": jnp.asarray(seed)}) for seed in seeds]
    assert_allclose(found.exponents, [one.exponents for one in alone], rtol=1e-9)
    longer = run({"seed": jnp.asarray(5)}, 8.0, 4).resume(16.0)
    assert_allclose(longer.exponents, alone[2].exponents, rtol=1e-8)
    assert_allclose(longer.x, alone[2].x, rtol=1e-8)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"flow": lh.zoo.impact_oscillator().system}, "no saltation matrix"),
        ({"flow": lh.Map(lambda n, x, p: x)}, "takes an lh.Flow"),
        ({"diffusion": 0.3}, "diffusion"),
        ({"step": 0.0}, "step"),
        ({"until": -1.0}, "until"),
        ({"sources": 0}, "sources"),
    ],
)
def test_what_cannot_be_is_refused(change, words):
    flow = lh.Flow(lambda t, x, p: -x)
    how = {"flow": flow, "diffusion": lambda t, x, p: 0.1 + 0 * x, "step": 0.1, "until": 1.0} | change
    with pytest.raises(ValueError, match=words):
        lh.white_noise(how.pop("flow"), how.pop("diffusion"), **how)


@pytest.mark.slow
def test_beyond_its_end_there_is_no_path():
    """Neither after `until` nor before 0 is the noise silently left out."""
    system = lh.white_noise(lh.Flow(lambda t, x, p: -x), lambda t, x, p: 1 + 0 * x, step=0.25, until=2.0)
    assert lh.tangent_map(system, [0.0], t1=2.1).status == lh.STATUS.ok
    for how in ({"t1": 2.4}, {"t1": 1.0, "t0": -1.1}):
        assert lh.tangent_map(system, [0.0], throw=False, **how).status == lh.STATUS.nonfinite
