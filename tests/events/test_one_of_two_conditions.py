"""`when` is asked at the root, before any jump: of transitions on one guard it chooses those that fire there."""

import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import lyaphybrid as lh

X0, T1 = [1.0, 0.0], 9.0


def field(t, x, args):
    return jnp.stack([x[1], -x[0]])


def barrier(t, x, args):
    """A body passes it: a fast one is braked, a slow one pushed."""
    return x[0] - 0.5


def is_fast(t, x, args):
    return x[1] < -0.8


BRAKED = lh.Transition(barrier, lambda t, x, a: jnp.stack([x[0], 0.5 * x[1]]), when=is_fast)
PUSHED = lh.Transition(barrier, lambda t, x, a: jnp.stack([x[0], 1.5 * x[1]]), when=lambda t, x, a: ~is_fast(t, x, a))
BOTH = lh.Transition(
    lambda t, x, a: jnp.stack([x[0] - 0.5, x[0] - 0.5]),
    lambda t, x, a, which: jnp.stack([x[0], jnp.where(which == 0, 0.5, 1.5) * x[1]]),
    when=lambda t, x, a: jnp.stack([is_fast(t, x, a), ~is_fast(t, x, a)]),
)
IN_ONE = lh.Transition(barrier, lambda t, x, a: jnp.stack([x[0], jnp.where(is_fast(t, x, a), 0.5, 1.5) * x[1]]))


@pytest.mark.parametrize("transitions", [[BRAKED, PUSHED], [PUSHED, BRAKED], BOTH])
def test_the_body_is_braked_or_pushed_and_not_both(transitions):
    system, single = lh.Hybrid(field, transitions), lh.Hybrid(field, IN_ONE)
    found, expected = (lh.trajectory(one, X0, t1=T1) for one in (system, single))
    assert len(found.events) == len(expected.events) == 2
    assert_allclose(found.events.t, expected.events.t, rtol=1e-12)
    assert_allclose(found.x[-1], expected.x[-1], atol=1e-12)
    spectra = [lh.lyapunov_spectrum(one, X0, t1=T1) for one in (system, single)]
    assert_allclose(spectra[0].exponents, spectra[1].exponents, atol=1e-12)


def test_it_may_fire_when_the_body_comes_again():
    """The first transition turns a fast body back, so that it comes again, slowly: then the second ends the run."""
    back = lh.Transition(barrier, lambda t, x, a: jnp.stack([x[0], -0.5 * x[1]]), when=is_fast)
    stop = lh.Transition(barrier, when=lambda t, x, a: ~is_fast(t, x, a), terminal=True)
    found = lh.trajectory(lh.Hybrid(field, [back, stop]), X0, t1=20.0, throw=False)
    assert found.status.name == "terminated"
    # From (1/2, √3/4) the phase to the axis of symmetry is passed twice.
    assert_allclose(found.events.t, [np.pi / 3, np.pi / 3 + 2 * np.arctan(np.sqrt(3.0) / 2)], rtol=1e-9)


def test_a_jump_that_sends_the_body_across_asks_after_it():
    """A tick brings x beyond the barrier: the body is slow there, and put back to 2."""
    kicked = lh.Transition(every=0.5, reset=lambda t, x, a: jnp.stack([x[0] - 0.4, x[1]]))
    fast = lh.Transition(barrier, lambda t, x, a: jnp.stack([1 + 0 * x[0], x[1]]), when=is_fast)
    slow = lh.Transition(
        barrier, lambda t, x, a: jnp.stack([2 + 0 * x[0], x[1] - 1]), when=lambda t, x, a: ~is_fast(t, x, a)
    )
    found = lh.trajectory(lh.Hybrid(field, [kicked, fast, slow]), X0, t1=0.6)
    assert np.asarray(found.events.transition).tolist() == [0, 2]
    assert_allclose(found.events.x_after[-1], [2.0, -np.sin(0.5) - 1], rtol=1e-12)
