"""A reset that is ill-conditioned and not singular: the adaptive exponential neuron against its map of spikes."""

import jax.numpy as jnp
import numpy as np
import pytest

import lyaphybrid as lh
import spike_maps
from lyaphybrid import zoo

START = 95.0  # w of the first reset of the map, within the basin of the only attractor
PEAKS = [-20.0, 0.0, 20.0]


def known(currents, peaks, **lengths):
    """The exponents (currents, peaks, 2), descending, and the standard error of the one that is not zero."""
    value, error = spike_maps.exponents(zoo.adex().args, currents, peaks, start=START, **lengths)
    return np.sort(np.stack([value, 0 * value], axis=-1))[..., ::-1], error[..., None]


def exponents(currents, peaks, t1):
    def run(args):
        return lh.lyapunov_spectrum(zoo.adex().system, zoo.adex().x0, args, t1=t1, transient=5000.0, throw=False)

    return lh.sweep(
        run, {"current": np.asarray(currents), "peak": np.asarray(peaks)}, args=zoo.adex().args, progress=False
    )


def test_the_map_of_spikes_is_the_one_that_an_adaptive_integrator_finds():
    from scipy.integrate import solve_ivp

    p = zoo.adex(current=185.0, peak=0.0).args
    (rows,) = spike_maps.spike_maps(p, [0.0], np.array([80.0, 100.0, 110.0]))

    def spike(w):
        def rate(t, y):
            return np.array(spike_maps._rates(p, *y)[:2])

        def at_peak(t, y):
            return y[0]

        at_peak.terminal = True
        found = solve_ivp(rate, (0.0, 1e3), [p["reset"], w], "DOP853", events=at_peak, rtol=1e-12, atol=1e-12)
        return found.y_events[0][0, 1] + p["b"], found.t_events[0][0]

    for w, image, slope, time in zip([80.0, 100.0, 110.0], *rows, strict=True):
        (above, _), (below, _) = spike(w + 1e-3), spike(w - 1e-3)
        np.testing.assert_allclose([image, time], spike(w), rtol=1e-6)
        assert slope == pytest.approx((above - below) / 2e-3, rel=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("t0", [0.0, 1e6])
def test_spikes_faster_than_the_rounding_of_the_time(t0):
    """At the peak V doubles within 1e-19 ms, and the time is known to 1e-10: steps are far below that."""
    problem = zoo.adex(peak=40.0)
    for method in (lh.RungeKutta("dopri5", rtol=1e-7, atol=1e-9), lh.RungeKutta("dopri8", rtol=1e-7, atol=1e-9)):
        path = lh.trajectory(problem.system, problem.x0, problem.args, t0=t0, t1=300.0, n=1, method=method)
        assert len(path.events) == 17
        np.testing.assert_allclose(path.x[-1], [-48.072717, 100.935474], rtol=5e-6)


@pytest.mark.slow
def test_a_reset_that_is_ill_conditioned_loses_nothing():
    currents, peaks = [160.0, 185.0], [0.0, 20.0, 40.0]  # down to |f⁺|/|f⁻| = 1e-19
    found = exponents(currents, peaks, 10_000.0)
    wanted, error = known(currents, peaks)
    assert not np.any(found.losses)
    assert np.all(found.stderr < 0.002)
    assert np.all(np.abs(found.exponents.values - wanted) <= 5 * np.hypot(found.stderr.values, error))


@pytest.mark.slow
def test_a_sweep_says_what_a_single_run_says():
    problem = zoo.adex(current=185.0)
    single = problem.spectrum(t1=2000.0)

    def run(args):
        return problem.spectrum(args=args, t1=2000.0)

    swept = lh.sweep(run, {"current": np.array([185.0])}, args=problem.args, progress=False)
    np.testing.assert_allclose(swept.exponents.values[0], single.exponents, atol=1e-4)
    assert not np.any(single.losses)
    assert single.notes == frozenset()
    assert single.sum_rule_residual < 1e-9


@pytest.mark.slow
def test_per_spike_the_exponents_are_those_of_the_map():
    """Counted from reset to reset nothing depends on how fast the flow is there."""
    spectrum = zoo.adex(current=163.0).spectrum(clock="jumps", t1=400, transient=400)
    wanted, _ = spike_maps.exponents(zoo.adex().args, [163.0], [20.0], start=START, lanes=2)
    per_spike = wanted[0, 0] * spectrum.time / spectrum.jumps
    np.testing.assert_allclose(spectrum.exponents, [0.0, per_spike], atol=1e-3)


def turned(system, angle):
    """The same system in other coordinates."""
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    (field,), (spike,) = system.fields, system.transitions
    return turn, lh.Hybrid(
        lambda t, y, args: turn @ field(t, turn.T @ y, args),
        lh.Transition(
            lambda t, y, args: spike.guard(t, turn.T @ y, args),
            lambda t, y, args: turn @ spike.reset(t, turn.T @ y, args),
        ),
    )


@pytest.mark.slow
def test_where_rounding_hides_the_small_direction_the_loss_is_flagged():
    """In coordinates that mix a fast and a slow direction 1e-14 of one is rounding of the other; 1e-10 is not."""
    turn, system = turned(zoo.adex().system, 0.7)
    problem = zoo.adex(current=185.0)
    found = [
        lh.lyapunov_spectrum(system, turn @ problem.x0, problem.args | {"peak": peak}, t1=2000.0, transient=500.0)
        for peak in (0.0, 20.0)
    ]
    assert found[0].notes == frozenset()
    assert np.all(np.isfinite(found[0].exponents))
    assert found[1].notes == {"rank_lost", "unresolved"}


@pytest.mark.slow
def test_a_reset_to_a_point_is_singular_however_fast_the_flow():
    """Both w and V are set: nothing of a perturbation is left but its delay."""
    (field,) = zoo.adex().system.fields
    system = lh.Hybrid(
        field,
        lh.Transition(lambda t, x, args: args["peak"] - x[0], lambda t, x, args: jnp.stack([args["reset"], args["b"]])),
    )
    spectrum = lh.lyapunov_spectrum(system, zoo.adex().x0, zoo.adex().args, t1=2000.0)
    assert spectrum.exponents[1] == -jnp.inf
    assert abs(spectrum.exponents[0]) < 1e-2
    assert int(spectrum.losses[1]) == int(spectrum.jumps)
    assert spectrum.losses[0] == 0
    assert "rank_lost" in spectrum.notes


@pytest.mark.slow
def test_41_currents_and_three_peaks_are_those_of_the_map_of_spikes():
    currents = np.linspace(150.0, 190.0, 41)
    found = exponents(currents, PEAKS, 35_000.0)
    wanted, error = known(currents, PEAKS)
    assert np.all(found.status == int(lh.STATUS.ok))
    assert not np.any(found.losses)
    assert np.all(found.stderr < 0.001)
    assert np.all(np.abs(found.exponents.values - wanted) <= 5 * np.hypot(found.stderr.values, error))
