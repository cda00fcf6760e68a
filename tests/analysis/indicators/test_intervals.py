"""Spectral intervals against closed forms, for flows, maps and systems that jump."""

import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import lyaphybrid as lh

ROOT = np.sqrt(2.0)


def slow(t, x, args):
    """Averages over [0, t] that never settle: (t + 1) sin ln(t + 1) is the integral of the first rate."""
    s = jnp.log(t + 1)
    return x * jnp.stack([jnp.sin(s) + jnp.cos(s), jnp.sin(s) - jnp.cos(s) - 5])


SLOW = lh.Flow(slow)
# Of the closed forms, by an independent program: averages over [0, t], 100 ≤ t ≤ 1e4, and over windows of 100.
LYAPUNOV = [[-1.0091065632545313, 1.0003884294316148], [-5.999999999999987, -4.02268478573225]]
SACKER_SELL = [[-1.2261651064867845, 1.4137865765175388], [-6.404430261108282, -3.5858048973553376]]
STEKLOV = 3.0479317007732063


@pytest.mark.slow
def test_averages_that_never_settle():
    found = lh.spectral_intervals(SLOW, [0.0, 0.0], t1=1e4, window=100.0, tau=100.0)
    print(found)
    assert_allclose(found.lyapunov, LYAPUNOV, rtol=0, atol=1e-3)
    assert_allclose(found.sacker_sell, SACKER_SELL, rtol=0, atol=1e-3)
    assert_allclose(found.steklov, [STEKLOV], rtol=0, atol=1e-3)
    assert found.separated
    assert found.status == lh.STATUS.ok
    assert "integrally separated" in str(found)
    assert "Sacker–Sell" in str(found)


@pytest.mark.slow
def test_intervals_approach_their_limits():
    """[-1, 1] and [-6, -4]; [-√2, √2] and [-5 - √2, -5 + √2]; 2 cos ln(t + 1) + 5 ≥ 3."""
    found = lh.spectral_intervals(SLOW, [0.0, 0.0], t1=6e5, window=1e3, tau=1e3)
    print(found)
    assert_allclose(found.lyapunov, [[-1, 1], [-6, -4]], rtol=0, atol=1e-2)
    assert_allclose(found.sacker_sell, [[-ROOT, ROOT], [-5 - ROOT, -5 + ROOT]], rtol=0, atol=1e-2)
    assert_allclose(found.steklov, [3.0], rtol=0, atol=1e-2)


@pytest.mark.slow
def test_limits_by_large_steps():
    """Up to t = 1e8 by the continuous QR method: a step may be as long as what is looked at."""
    method = lh.ContinuousQR(lh.RungeKutta("dopri5", rtol=1e-6, atol=1e-9))
    found = lh.spectral_intervals(SLOW, [0.0, 0.0], t1=1e8, window=1e5, tau=1e3, method=method)
    print(found)
    assert_allclose(found.lyapunov, [[-1, 1], [-6, -4]], rtol=0, atol=1e-2)
    assert_allclose(found.sacker_sell, [[-ROOT, ROOT], [-5 - ROOT, -5 + ROOT]], rtol=0, atol=1e-2)
    assert_allclose(found.steklov, [3.0], rtol=0, atol=1e-2)
    assert found.separated


@pytest.mark.slow
def test_a_map_in_closed_form():
    """Growth by 2 for ten iterations, by 1/2 for the next ten."""
    halves = lh.Map(lambda n, x, args: x * jnp.where(n % 20 < 10, 2.0, 0.5))
    found = lh.spectral_intervals(halves, [0.0], t1=400, window=10, tau=40)
    log2 = np.log(2.0)
    assert_allclose(found.sacker_sell, [[-log2, log2]], rtol=0, atol=1e-12)
    assert_allclose(found.lyapunov, [[0.0, 10 / 50 * log2]], rtol=0, atol=1e-12)
    assert found.steklov.shape == (0,)
    assert "iteration" in str(found)


def test_directions_that_change_places_are_not_separated():
    """Each grows faster than the other in turn, over longer than a window."""
    turns = lh.Map(lambda n, x, args: x * jnp.where((n // 200) % 2 == 0, jnp.array([2.0, 0.5]), jnp.array([0.5, 2.1])))
    found = lh.spectral_intervals(turns, [0.0, 0.0], t1=2000, window=50, tau=100)
    assert not found.separated
    assert "not integrally separated" in str(found)


@pytest.mark.slow
def test_jumps_count():
    """ẋ = −0.3 x, and x ← 2 x at each tick: over whole periods the average is always the same."""
    system = lh.Hybrid(lambda t, x, args: -0.3 * x, lh.Transition(every=1.0, phase=0.5, reset=lambda t, x, args: 2 * x))
    found = lh.spectral_intervals(system, [0.0], t1=100.0, window=8.0, tau=10.0)
    assert_allclose(found.sacker_sell, np.full((1, 2), np.log(2.0) - 0.3), rtol=0, atol=1e-9)
    # Running averages end in mid-period too: from k − 1/2 to k + 1/2 one tick is counted or not.
    low, high = np.asarray(found.lyapunov)[0]
    assert (
        np.log(2.0) * (1 - 0.51 / 10.5) - 0.3 < low < np.log(2.0) - 0.3 < high < np.log(2.0) * (1 + 0.51 / 10.5) - 0.3
    )


@pytest.mark.slow
def test_a_direction_that_is_destroyed():
    system = lh.Hybrid(
        lambda t, x, args: jnp.array([0.1, -0.2]) * x,
        lh.Transition(every=4.0, phase=2.0, reset=lambda t, x, args: jnp.array([1.0, 0.0]) * x),
    )
    found = lh.spectral_intervals(system, [0.0, 0.0], t1=40.0, window=1.0, tau=10.0)
    assert_allclose(found.sacker_sell[0], [0.1, 0.1], rtol=0, atol=1e-9)
    assert np.isneginf(found.sacker_sell[1, 0])
    assert_allclose(found.sacker_sell[1, 1], -0.2, rtol=0, atol=1e-9)  # windows between two ticks
    assert np.all(np.isneginf(found.lyapunov[1]))


def test_the_last_piece_may_be_shorter():
    found = lh.spectral_intervals(SLOW, [0.0, 0.0], t1=103.3, window=10.0, tau=20.0)
    assert float(found.time[-1]) == pytest.approx(103.3)
    assert float(found.start[-1]) + 10.0 <= 103.3
    assert len(found.windows) == len(found.start)


def test_a_run_that_fails_keeps_what_it_has():
    blowing_up = lh.Flow(lambda t, x, args: x**2)
    with pytest.raises(lh.RunFailedError):
        lh.spectral_intervals(blowing_up, [1.0], t1=2.0, window=0.1, tau=0.1)
    found = lh.spectral_intervals(blowing_up, [1.0], t1=2.0, window=0.1, tau=0.1, throw=False)
    assert found.status.failed
    assert np.all(np.isfinite(found.sacker_sell))
    assert abs(float(found.time[-1]) - 1.0) < 1e-6  # where it blows up


def test_the_picture():
    found = lh.spectral_intervals(SLOW, [0.0, 0.0], t1=200.0, window=10.0, tau=20.0)
    running, windows = found.plot()
    for line, values in zip(running.get_lines(), np.asarray(found.running).T, strict=True):
        assert_allclose(line.get_ydata(), values)
    assert len(windows.get_lines()) == 2
    assert len(windows.patches) == 2


REFUSED = [
    ({"window": 0.0}, "window must be positive"),
    ({"window": 200.0}, "window must be at most t1"),
    ({"tau": 100.0}, r"tau must be in \[0, t1\)"),
    ({"x0": [[0.0, 0.0]]}, "follows one orbit"),
]


@pytest.mark.parametrize(("change", "says"), REFUSED, ids=[says for _, says in REFUSED])
def test_bad_arguments_are_refused(change, says):
    keywords = {"x0": [0.0, 0.0], "t1": 100.0, "window": 10.0, "tau": 20.0} | change
    with pytest.raises(ValueError, match=says):
        lh.spectral_intervals(SLOW, keywords.pop("x0"), **keywords)


def test_what_it_does_not_take_python_refuses():
    with pytest.raises(TypeError, match="unexpected keyword argument 'blocks'"):
        lh.spectral_intervals(SLOW, [0.0, 0.0], t1=100.0, window=10.0, tau=20.0, blocks=3)
