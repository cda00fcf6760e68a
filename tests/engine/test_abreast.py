"""Sequences that run abreast: the same as one after the other, whatever their number."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from interrupts import interrupted_at
from lyaphybrid.engine.host import abreast, devices, lanes


def turned(shared, state, lane):
    """A step that depends on the state, on the lane and on what is shared, with two results."""
    angle, total = state
    angle = jnp.sin(shared * angle + lane)
    return (angle, total + angle), {"angle": angle, "pair": jnp.stack([total, lane])}


def counted(shared, state, lane):
    """As many steps as the lane says: such lanes part at once."""
    state = jax.lax.while_loop(lambda y: y[0] < lane, lambda y: (y[0] + 1, shared * y[1]), (0, state))[1]
    return state, state


def starts(count, length):
    rng = np.random.default_rng(count)
    return [((rng.normal(), np.zeros(())), rng.normal(size=length)) for _ in range(count)]


@pytest.mark.parametrize("count", [1, 7, 8, 19])
def test_it_is_the_same_as_one_after_the_other(count):
    sequences = starts(count, 200)
    found, done = abreast.run_abreast(turned, jnp.asarray(1.7), sequences)
    expected, _ = lanes.run_sequences(turned, jnp.asarray(1.7), sequences)
    assert len(found) == len(done) == count
    assert np.all(done)
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one["angle"], other["angle"])
        np.testing.assert_array_equal(one["pair"], other["pair"])


def test_they_do_run_at_once(monkeypatch):
    """In vectors of the CPU: there are fewer sequences for the threads."""
    seen, run = [], lanes.run_sequences

    def noted(function, shared, sequences, **keywords):
        seen.append(len(sequences))
        return run(function, shared, sequences, **keywords)

    monkeypatch.setattr(lanes, "run_sequences", noted)
    abreast.run_abreast(turned, jnp.asarray(1.7), starts(16, 3))
    assert seen[0] < 16


@pytest.mark.parametrize("on_devices", [False, True])
def test_where_they_part_they_run_one_after_the_other(monkeypatch, on_devices):
    monkeypatch.setattr(devices, "are_wanted", lambda: on_devices)
    sequences = [(np.asarray(1.0), np.array([i, 2 * i])) for i in range(5)]
    found, _ = abreast.run_abreast(counted, jnp.asarray(2.0), sequences)
    np.testing.assert_array_equal(found, [[2.0**i, 2.0 ** (3 * i)] for i in range(5)])


def test_what_an_interruption_leaves(monkeypatch):
    """Whole bundles, and zeros for what was not computed."""
    monkeypatch.setattr(lanes, "SECONDS_PER_CALL", 1e-6)  # pieces of one lane
    interrupted_at(monkeypatch, lanes._Pool, "hand_over", 0)
    with pytest.warns(UserWarning, match="interrupted"):
        found, done = abreast.run_abreast(turned, jnp.asarray(1.7), starts(24, 200_000))
    computed = np.array(done)
    assert 0 < computed.sum() < computed.size
    assert np.all((np.array([one["angle"] for one in found]) != 0) == computed)
