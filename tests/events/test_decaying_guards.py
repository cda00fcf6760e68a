"""Guards that decay to zero and never reach it: where steps are longer than the decay, rounding changes their sign."""

import jax.numpy as jnp
import numpy as np
import pytest

import lyaphybrid as lh


def decaying(t, x, args):
    """x' = 1, y' = −y."""
    return jnp.stack([1.0 + 0 * x[0], -x[1]])


FAR = lh.Transition(lambda t, x, args: 1000 - x[0], lambda t, x, args: x.at[0].set(0.0))
NEVER_MET = lh.Transition(lambda t, x, args: x[1], lambda t, x, args: x.at[1].set(1.0))
REFUSED = lh.Transition(lambda t, x, args: x[1], when=lambda t, x, args: False)
SYSTEMS = {
    "alone": lh.Hybrid(decaying, NEVER_MET),
    "after another": lh.Hybrid(decaying, [FAR, NEVER_MET]),
    "before another": lh.Hybrid(decaying, [NEVER_MET, FAR]),
    "refused": lh.Hybrid(decaying, [FAR, REFUSED]),
    "the border of a flow set": lh.Hybrid(decaying, FAR, flow_set=lambda t, x, args: x[1]),
}


@pytest.mark.parametrize("name", SYSTEMS)
def test_nothing_happens(name):
    run = lh.trajectory(SYSTEMS[name], [0.0, 1.0], t1=60.0, n=1)
    assert len(run.events) == 0
    assert abs(run.x[-1, 0] - 60.0) < 1e-9
    assert 0 <= run.x[-1, 1] < 1e-12


@pytest.mark.parametrize("name", ["after another", "the border of a flow set"])
def test_exponents(name):
    found = lh.lyapunov_spectrum(SYSTEMS[name], [0.0, 1.0], t1=60.0, transient=0.0)
    assert found.status == lh.STATUS.ok
    np.testing.assert_allclose(found.exponents, [0.0, -1.0], atol=1e-7)
