"""Jumps across which perturbations of a driven part, or across a subspace, have no rule: said also within a sweep."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import lyaphybrid as lh

CURRENTS = np.array([1.5, 1.2])


def spikes(t, v, w, which):
    """The spike of neuron 0 moves neuron 1 by w."""
    return jnp.where(which == 0, jnp.stack([0 * v[0], v[1] + w]), jnp.stack([v[0], 0 * v[1]]))


PAIR = lh.Hybrid(lambda t, v, w: CURRENTS - v, lh.Transition(lambda t, v, w: 1 - v, spikes))


def conditional(w):
    return lh.transverse_spectrum(PAIR, [0.3, 0.1], w, response=[1], t1=400.0, throw=False)


def conditional_by_flights(w, t1=400.0):
    """ln of what is left of a perturbation of neuron 1, from spike to spike in closed form."""
    v, t, total = np.array([0.3, 0.1]), 0.0, 0.0
    while True:
        flights = np.log((CURRENTS - v) / (CURRENTS - 1))
        first, flight = int(np.argmin(flights)), float(np.min(flights))
        if t + flight > t1:
            return (total - (t1 - t)) / t1
        t, total = t + flight, total - flight
        v = CURRENTS + (v - CURRENTS) * np.exp(-flight)
        total += np.log(CURRENTS[1] / (CURRENTS[1] - 1)) if first == 1 else 0.0
        v = np.array([0.0, v[1] + w]) if first == 0 else np.array([v[0], 0.0])


def test_a_spike_that_brings_about_another_has_no_rule_within_a_sweep_either():
    """Alone it is refused; in a sweep the run ends, where it gave an exponent of 1.26 without a word."""
    with pytest.raises(ValueError, match=r"several jumps follow each other .* let the reset of the first do"):
        conditional(0.5)
    found = lh.sweep(conditional, {"args": np.array([-0.2, 0.5])}, args=0.1, progress=False)
    assert found.status.values.tolist() == [lh.STATUS.ok, lh.STATUS.nonfinite]
    np.testing.assert_allclose(found.exponents.values[0], [conditional_by_flights(-0.2)], rtol=1e-9)
    assert jax.jit(conditional)(0.5).status == lh.STATUS.nonfinite
    assert jax.vmap(conditional)(jnp.array([-0.2, 0.5])).status_code.tolist() == [0, int(lh.STATUS.nonfinite)]


def test_neurons_that_spike_one_by_one_leave_the_common_motion_within_a_sweep_too():
    equal = lh.Hybrid(lambda t, v, c: c - v, lh.Transition(lambda t, v, c: 1 - v, lambda t, v, c, i: v.at[i].set(0.0)))

    def across(current):
        how = {"subspace": [[1.0], [1.0]], "t1": 50.0, "throw": False}
        return lh.transverse_spectrum(equal, [0.2, 0.2], current, **how)

    with pytest.raises(ValueError, match="does not stay in the subspace: the jump"):
        across(1.2)
    found = lh.sweep(across, {"args": np.array([0.9, 1.2])}, args=1.0, progress=False)
    assert found.status.values.tolist() == [lh.STATUS.ok, lh.STATUS.nonfinite]  # the first one never spikes
    np.testing.assert_allclose(found.exponents.values[0], [-1.0], rtol=1e-9)


def test_a_response_that_moves_the_drive_ends_within_a_sweep():
    bouncing = lh.Hybrid(lambda t, x, w: jnp.stack([-x[0], x[2], -1.0 + 0 * x[2]]), lh.Transition(
        lambda t, x, w: x[1], lambda t, x, w: jnp.stack([x[0] + w, 0 * x[1], -0.8 * x[2]])
    ))  # fmt: skip

    def run(w):
        return lh.transverse_spectrum(bouncing, [0.1, 1.0, 0.0], w, response=[1, 2], t1=3.0, throw=False)

    with pytest.raises(ValueError, match="the response decides"):
        run(0.5)
    found = lh.sweep(run, {"args": np.array([0.0, 0.5])}, args=0.1, progress=False)
    assert found.status.values.tolist() == [lh.STATUS.ok, lh.STATUS.nonfinite]


def test_a_coupling_whose_output_jumps_ends_within_a_sweep():
    """Each α of an oscillator with impacts that is coupled by its velocity; by its position there is a rule."""
    wall = lh.Transition(lambda t, x, a: x[0], lambda t, x, a: jnp.stack([x[0], -0.8 * x[1]]))
    oscillator = lh.Hybrid(lambda t, x, a: jnp.stack([x[1], jnp.cos(2.8 * t) - a * x[1] - x[0]]), wall)

    def by(coupling):
        return lambda a: lh.master_stability(oscillator, coupling, [0.1, 0.5], a, at=[-0.1], t1=20.0, throw=False)

    velocity, position = by(lambda t, x, a: x * jnp.array([0.0, 1.0])), by(lambda t, x, a: jnp.stack([0 * x[0], x[0]]))
    with pytest.raises(ValueError, match="the coupling's output jumps"):
        velocity(0.1)
    assert jax.jit(velocity)(0.1).status_code.tolist() == [int(lh.STATUS.nonfinite)]
    found = jax.jit(position)(0.1)
    assert found.status_code.tolist() == [0]
    np.testing.assert_allclose(found.exponents, position(0.1).exponents, rtol=1e-9)
