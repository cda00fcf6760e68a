"""The host divides a run into calls by the clock: no bit of a result, and no note, may depend on where calls end."""

import jax.numpy as jnp
import numpy as np
import pytest

import lyaphybrid as lh
from lyaphybrid.engine.host import driver

ATTEMPTS = 199, 50, 7  # of each call, against one call for all
NEURONS = 6
_draw = np.random.default_rng(3)
COUPLING = _draw.normal(size=(NEURONS, NEURONS)) * (1 - np.eye(NEURONS)) * 0.15
STARTS = _draw.uniform(0, 0.9, (3, NEURONS))


def neurons(gamma):
    """Leaky neurons; who fires is reset to zero and kicks the others. Each spike loses a direction."""

    def kicked(t, v, args, which):
        return jnp.where(jnp.arange(NEURONS, dtype=which.dtype) == which, 0.0, v + jnp.asarray(COUPLING)[:, which])

    def field(t, v, args):
        return 1.4 + gamma * v + 0.1 * jnp.cos(jnp.arange(1.0, NEURONS + 1) + t)

    return lh.Hybrid(field, lh.Transition(lambda t, v, args: v - 1.0, direction=+1, reset=kicked))


def _zoo(name, t1, **options):
    problem = getattr(lh.zoo, name)(**options)
    return lambda: problem.spectrum(t1=t1)


def _neurons(gamma, x0, **options):
    system = neurons(gamma)
    return lambda: lh.lyapunov_spectrum(system, x0, t1=20.0, **options)


RUNS = {
    "neurons": _neurons(-1.0, STARTS[0]),
    "neurons, three starts": _neurons(-1.0, STARTS),
    "neurons that run away": _neurons(1.0, STARTS[0]),
    "neurons, the state alone controls": _neurons(-1.0, STARTS[0], method=lh.RungeKutta(control="x")),
    "friction pendulum": _zoo("friction_pendulum", 60.0),
    "impact oscillator": _zoo("impact_oscillator", 200.0),
    "buck converter": _zoo("buck_converter", 0.01),
    "hard disks": _zoo("hard_disks", 20.0, n=4),
}


def _all_of(spectrum):
    values = [spectrum.exponents, spectrum.x, spectrum.frame, spectrum.history, spectrum.losses, spectrum.jumps]
    return [np.asarray(value) for value in values], spectrum.notes


@pytest.mark.slow
@pytest.mark.parametrize("name", RUNS)
def test_results_do_not_depend_on_where_calls_end(name, monkeypatch):
    found = []
    for attempts in (10**7, *ATTEMPTS):
        for bound in ("FIRST_ATTEMPTS", "FEWEST_ATTEMPTS", "MOST_ATTEMPTS"):
            monkeypatch.setattr(driver, bound, attempts)
        found.append(_all_of(RUNS[name]()))
    (whole, notes), *divided = found
    assert np.all(whole[-1] > 0), "no event, no proof"
    for values, notes_too in divided:
        for one, other in zip(whole, values, strict=True):
            np.testing.assert_array_equal(one, other)
        assert notes_too == notes


@pytest.mark.parametrize("first", [2000, 10**7])
def test_stiffness_is_asked_after_fixed_numbers_of_attempts(first, monkeypatch):
    """A short run, of which a call allowed many more attempts than it made, was asked on fast machines only."""
    monkeypatch.setattr(driver, "FIRST_ATTEMPTS", first)
    asked = []
    monkeypatch.setattr(driver.StiffnessVotes, "at_the_end", lambda votes, state, given, rates: asked.append(given))
    flow = lh.Flow(lambda t, x, args: -args * x)
    method = lh.RungeKutta(rtol=1e-11, atol=1e-11)
    lh.lyapunov_spectrum(flow, [1.0], 1.0, t1=100.0, method=method)
    assert asked
    assert asked[-1] < 2000
