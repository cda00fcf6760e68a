"""Twenty neurons whose avalanches destroy direction after direction: the rank of the tangent map, exactly."""

import jax.numpy as jnp
import numpy as np
import pytest

import lyaphybrid as lh

N, TAU, PRIME = 20, 10.0, 2**31 - 1
GENERATOR = np.random.default_rng(42)
WEIGHTS = GENERATOR.normal(-0.03, 0.12, (N, N))
np.fill_diagonal(WEIGHTS, 0.0)
INPUTS = GENERATOR.uniform(1.15, 1.6, N)
FIRST_START = GENERATOR.uniform(0.0, 0.9, N)
NETWORK = lh.Hybrid(
    lambda t, v, args: (INPUTS - v) / TAU,
    lh.Transition(
        lambda t, v, args: 1.0 - v, lambda t, v, args, which: (v + jnp.asarray(WEIGHTS)[:, which]).at[which].set(0.0)
    ),
    max_cascade=200,
)


def tangent_maps(v, length):
    """The instant of each spike, whose saltation is diag(kept) + column eᵢᵀ: (kept (N,), column (N,), i, avalanche)."""
    t, v = 0.0, v.copy()
    while True:
        waits = TAU * np.log((INPUTS - v) / (INPUTS - 1))
        first = j = int(np.argmin(waits))
        t += waits[j]
        if t > length:
            return
        v = INPUTS - (INPUTS - v) * np.exp(-waits[j] / TAU)
        v[j] = 1.0
        before, kept, spikes = (INPUTS - v) / TAU, np.ones(N), 0
        while True:
            kept[j], spikes = 0.0, spikes + 1
            v = v + WEIGHTS[:, j]
            v[j] = 0.0
            over = np.flatnonzero(v >= 1.0)
            if not len(over):
                break
            j = int(over[0])
        yield kept, ((INPUTS - v) / TAU - kept * before) / before[first], first, spikes > 1


def rank(matrix):
    """Of a matrix of integers modulo the prime."""
    matrix, found = matrix.copy(), 0
    for column in range(N):
        rows = np.flatnonzero(matrix[found:, column]) + found
        if len(rows):
            matrix[[found, rows[0]]] = matrix[[rows[0], found]]
            matrix[found] = matrix[found] * pow(int(matrix[found, column]), -1, PRIME) % PRIME
            below = matrix[found + 1 :]
            matrix[found + 1 :] = (below - below[:, column : column + 1] * matrix[found]) % PRIME
            found += 1
    return found


def exact_rank(v, length):
    """Of the tangent map, its numbers as fractions of 2⁴⁵ modulo the prime: no rounding."""
    image = np.random.default_rng(9).integers(1, PRIME, (N, N))
    for kept, column, i, _ in tangent_maps(v, length):
        column = np.array([int(entry) % PRIME for entry in np.round(column * 2.0**45)])
        kept = kept.astype(int) * (2**45 % PRIME)
        image = (kept[:, None] * image % PRIME + np.outer(column, image[i]) % PRIME) % PRIME
    return rank(image)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [None, 0, 3, 5])
def test_every_direction_that_avalanches_destroy_is_found(seed):
    """Residuals of lost columns are up to 3e-12 long here, those of the columns that stay at least 3e-4."""
    start = FIRST_START if seed is None else np.random.default_rng(100 + seed).uniform(0.0, 0.9, N)
    found = lh.lyapunov_spectrum(NETWORK, jnp.asarray(start), t1=1400.0)
    assert np.sum(np.isneginf(found.exponents)) == N - exact_rank(start, 1400.0)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, 12])
def test_where_rounding_hides_a_loss_that_is_said(seed):
    """Here one or two of 15, or 16, leave up to 1e-9 of a column, which had become short time after time."""
    start = np.random.default_rng(100 + seed).uniform(0.0, 0.9, N)
    found = lh.lyapunov_spectrum(NETWORK, jnp.asarray(start), t1=1400.0)
    missed = N - exact_rank(start, 1400.0) - int(np.sum(np.isneginf(found.exponents)))
    assert 0 <= missed <= 2
    assert "unresolved" in found.notes
