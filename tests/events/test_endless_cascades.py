"""Cascades without end, counted by jumps: what the state left beyond zero, or counted already, does not fire again."""

import jax.numpy as jnp
import numpy as np
import pytest

import lyaphybrid as lh

# A point falls from 1, and c from `beyond`. At 0 two guards throw the state to and fro for ever; a third counts when c
# falls through zero, and lets it fall on.
TO = lh.Transition(lambda t, x, args: x[0], lambda t, x, args: x.at[0].set(1.0).at[2].set(-1.0))
FRO = lh.Transition(lambda t, x, args: x[2], lambda t, x, args: x.at[0].set(-1.0).at[2].set(1.0))
COUNT = lh.Transition(lambda t, x, args: x[1], lambda t, x, args: x.at[3].add(1.0))


def _falling(t, x, args):
    return jnp.stack([-jnp.ones_like(x[0]), -jnp.ones_like(x[0]), 0 * x[0], 0 * x[0]])


ORDERS = {"last": [TO, FRO, COUNT], "first": [COUNT, TO, FRO], "between": [TO, COUNT, FRO]}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("order", "at"),
    [
        ("first", 0.5),
        *(pytest.param(*case, marks=pytest.mark.slow) for case in (("last", 0.5), ("between", 0.5), ("first", 1.0))),
    ],
)
def test_a_guard_left_beyond_zero_counts_once(order, at):
    """c falls through zero half a unit before the cascade, or at its very instant, as the first of both guards."""
    start = [1.0, at, 1.0, 0.0]
    found = lh.lyapunov_spectrum(lh.Hybrid(_falling, ORDERS[order]), start, clock="jumps", t1=101, blocks=4)
    x = np.asarray(found.x)
    assert x[3] == 1
    assert int(found.jumps) == 101
    np.testing.assert_allclose(x[[0, 2]], [-1.0, 1.0])  # after a hundred jumps of the cascade
    assert float(found.t) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.slow
def test_a_guard_that_comes_back_counts_again():
    """c begins beyond zero and does not count at first; once it was lifted it counts each time it is thrown below."""
    system = lh.Hybrid(
        _falling,
        [
            lh.Transition(lambda t, x, args: x[1], lambda t, x, args: x + jnp.asarray([0.0, 2.0, 0.0, 1.0])),
            lh.Transition(lambda t, x, args: x[0], lambda t, x, args: x.at[:3].set(jnp.asarray([1.0, -1.0, -1.0]))),
            lh.Transition(lambda t, x, args: x[2], lambda t, x, args: x.at[:3].set(jnp.asarray([-1.0, 1.0, 1.0]))),
        ],
    )
    found = lh.lyapunov_spectrum(system, [1.0, -0.5, 1.0, 0.0], clock="jumps", t1=302, blocks=4)
    assert np.asarray(found.x)[3] == 100  # two jumps to and fro, then three again and again: down, count, up
