"""A run that has ended goes on; and what problems of the zoo can do besides a spectrum."""

import copy
import pickle

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import lyaphybrid as lh
from lyaphybrid import zoo

CASES = {
    "a map": (zoo.henon_map, 64, {}),
    "a flow": (zoo.lorenz63, 4.0, {}),
    "impacts, several runs": (zoo.impact_oscillator, 20.0, {"replicates": 2, "key": jax.random.key(0)}),
    "jumps": (zoo.impact_oscillator, 10, {"clock": "jumps", "averaging": "birkhoff", "count_start": True}),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_a_run_that_goes_on_is_one_run(name):
    problem, t1, options = CASES[name]
    options = {"transient": 0.25 * t1 if name != "jumps" else 4, **options}
    one = problem().spectrum(t1=2 * t1, blocks=16, **options)
    short = problem().spectrum(t1=t1, blocks=8, **options)
    found = short.resume(2 * t1)
    for attribute in ("exponents", "stderr", "x", "t", "jumps", "time", "upper"):
        np.testing.assert_allclose(getattr(found, attribute), getattr(one, attribute), rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(found.history.growth, one.history.growth, rtol=1e-8, atol=1e-8)
    assert (found.name, found.status, found.state_labels) == (one.name, one.status, one.state_labels)
    again = found.resume(3 * t1)
    assert len(again.history.growth) == 24 if again.replicates is None else again.replicates.shape[0] == 2


def test_going_on_compiles_nothing_and_leaves_the_first_as_it_was():
    from lyaphybrid._jax.engines import compilations

    short = zoo.henon_map().spectrum(t1=64, blocks=8)
    before, count = np.asarray(short.exponents), compilations()
    short.resume(128)
    assert compilations() == count
    np.testing.assert_array_equal(short.exponents, before)


@pytest.mark.slow
def test_what_cannot_go_on_says_why():
    done = zoo.henon_map().spectrum(t1=64, blocks=8)
    with pytest.raises(ValueError, match="t1 must be beyond the 64 that the run has reached; got 64"):
        done.resume(64)
    with pytest.raises(ValueError, match="it must be a whole number"):
        done.resume(100.5)
    for other in (copy.copy(done), pickle.loads(pickle.dumps(done)), jax.tree.map(lambda leaf: leaf, done)):
        np.testing.assert_array_equal(other.exponents, done.exponents)
        with pytest.raises(ValueError, match="this one is a copy"):
            other.resume(128)
    escapes = lh.Map(lambda n, x, args: 2 * x + x**2)
    failed = lh.lyapunov_spectrum(escapes, [1.0], t1=64, throw=False)
    with pytest.raises(ValueError, match="did not come to its end: nonfinite"):
        failed.resume(128)


@pytest.mark.slow
def test_problems_have_verbs():
    lorenz = zoo.lorenz63()
    path = lorenz.trajectory(n=3)
    assert float(path.t[-1]) == pytest.approx(0.01 * lorenz.t1)
    assert path.to_xarray().state.values.tolist() == ["x", "y", "z"]
    assert len(zoo.henon_map().trajectory(t1=5, n=5).t) == 5
    with pytest.raises(ValueError, match="counts jumps: give the length of time"):
        zoo.bouncing_ball().trajectory()
    orbit = zoo.rimless_wheel().floquet(transient=20.0)
    assert orbit.stable
    found = zoo.logistic_map().sweep({"r": jnp.array([2.8, 2.9])}, progress=False)
    np.testing.assert_allclose(found.exponents[:, 0], np.log(np.abs([-0.8, -0.9])), rtol=1e-6)


def test_a_printed_spectrum_names_the_problem():
    assert str(zoo.henon_map().spectrum(t1=64)).startswith("henon_map: Lyapunov spectrum per iteration (64 iterations")


def test_what_the_caller_changes_later_changes_no_run():
    """args is an array of the caller, who writes the next value into it before the run goes on."""
    rule = lh.Map(lambda n, x, args: args["r"] * x * (1 - x))
    args = {"r": np.array([2.9])}
    found = lh.lyapunov_spectrum(rule, [0.3], args, t1=1000)
    args["r"][0] = 3.2
    assert found.resume(2000).exponents[0] == pytest.approx(np.log(0.9), abs=1e-3)
