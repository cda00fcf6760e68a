"""`lh.EventQueue` against a search of all times."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import lyaphybrid as lh


@pytest.mark.parametrize("n", [1, 2, 7, 8, 9, 64, 65, 1000])
def test_the_earliest_is_that_of_all_times(n):
    """After many replacements of several times at once, some of them equal and some inf, and after a shift."""
    rng = np.random.default_rng(n)
    times = rng.integers(0, 50, n).astype(float)  # with ties
    few = min(n, 5)
    bodies = np.stack([rng.permutation(n)[:few] for _ in range(200)])
    new = rng.integers(0, 50, (200, few)).astype(float)
    new[rng.random((200, few)) < 0.2] = np.inf

    @jax.jit
    def replace_all(queue, bodies, new):
        def one(queue, given):
            queue = queue.replaced(*given)
            return queue, queue.first()

        return jax.lax.scan(one, queue, (bodies, new))

    queue, found = replace_all(lh.EventQueue(jnp.array(times)), bodies, new)
    first, which = map(np.asarray, found)
    for i in range(200):
        times[bodies[i]] = new[i]
        assert first[i] == np.min(times)
        assert which[i] == np.argmin(times)
    first, which = map(np.asarray, queue.earlier(0.5).first())
    assert (first, which) == (np.min(times) - 0.5, np.argmin(times))


@pytest.mark.parametrize("times", [0.0, np.zeros((2, 3)), np.zeros(0)])
def test_times_of_another_shape_are_refused(times):
    """The message says what was given."""
    with pytest.raises(ValueError, match=r"times must have the shape \(n,\).*got \("):
        lh.EventQueue(times)
