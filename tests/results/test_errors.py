"""Standard errors from blocks: how often they hold the true mean, of processes whose mean is known."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import lyaphybrid as lh
from lyaphybrid.results.errors import standard_error

BLOCKS, RUNS = 64, 4000


def correlated(time: float, blocks=BLOCKS, runs=RUNS):
    """(blocks, runs) of the AR(1) process g' = ag + √(1 − a²) ξ with a = e^{−1/time}; 0: independent."""
    rng = np.random.default_rng(7)
    a = np.exp(-1 / time) if time else 0.0
    growth = [rng.normal(size=runs)]
    for _ in range(blocks - 1):
        growth.append(a * growth[-1] + (1 - a**2) ** 0.5 * rng.normal(size=runs))
    return np.array(growth)


def error_of(growth, lengths=None, xp=np):
    lengths = np.ones(len(growth)) if lengths is None else lengths
    reached, total = float(np.sum(lengths > 0)), np.sum(lengths)
    return standard_error(xp, growth, xp.asarray(lengths), xp.sum(growth, axis=0) / total, reached, total)


def of_independent(growth):
    return np.std(growth, axis=0, ddof=1) / len(growth) ** 0.5


def held(off, error) -> tuple[float, float]:
    """How often one and two errors hold the true mean."""
    return np.mean(np.abs(off) < error), np.mean(np.abs(off) < 2 * error)


@pytest.mark.parametrize("blocks", [10, 32, 64, 1000])
def test_of_independent_blocks_errors_are_what_they_were(blocks):
    growth = correlated(0, blocks, min(RUNS, 10**6 // blocks))
    error, plain = error_of(growth), of_independent(growth)
    same = np.isclose(error, plain, rtol=1e-12, atol=0)
    assert np.mean(same) > 0.90
    assert np.all(error[~same] > plain[~same])
    assert np.mean(error / plain) < 1.05
    one, two = held(np.mean(growth, axis=0), error)
    assert 0.64 < one < 0.72
    assert 0.91 < two < 0.97


# (correlation time in blocks, what one and two errors of independent blocks hold at most, what ours hold at least)
@pytest.mark.parametrize(
    ("time", "plain", "ours"),
    [(0.5, (0.62, 0.92), (0.62, 0.91)), (1, (0.52, 0.83), (0.62, 0.88)), (2, (0.39, 0.69), (0.65, 0.90)),
     (4, (0.28, 0.52), (0.62, 0.87)), (8, (0.21, 0.38), (0.53, 0.81))],
)  # fmt: skip
def test_of_correlated_blocks_errors_hold_the_mean(time, plain, ours):
    """Where the run is at least 16 correlation times long, nearly as often as those of a Gaussian: 68 and 95 %."""
    growth = correlated(time)
    before, now = (held(np.mean(growth, axis=0), of(growth)) for of in (of_independent, error_of))
    assert before[0] < plain[0]
    assert before[1] < plain[1]
    assert ours[0] < now[0] < 0.75
    assert ours[1] < now[1] < 0.98


def test_alternating_blocks_keep_their_error():
    """Those of a motion that a force drives with another period: too large, as it was, never too small."""
    growth = correlated(0)
    growth = growth - 0.6 * np.roll(growth, 1, axis=0)
    assert np.allclose(error_of(growth), of_independent(growth), rtol=1e-12, atol=0)


LEAVES = 2.5e-3  # part of each room from which an iteration goes to the other one


def two_rooms(n, x, args):
    """[0, 1) with 2 branches and [1, 2) with 5, all onto their own interval, and a small branch onto the other one."""
    room = jnp.floor(x)
    inside, branches = x - room, jnp.where(room == 0, 2.0, 5.0)
    stays = inside * branches / (1 - LEAVES)
    leaves = (inside - (1 - LEAVES)) / LEAVES
    return jnp.where(inside < 1 - LEAVES, room + stays - jnp.floor(stays), 1 - room + leaves)


EXPONENT_OF_ROOMS = float((1 - LEAVES) * (np.log(10.0) / 2 - np.log(1 - LEAVES)) - LEAVES * np.log(LEAVES))


@pytest.mark.slow
def test_errors_of_an_intermittent_map():
    """It stays 400 iterations in a room, and its growth is that of the room: blocks of 100 are correlated.

    Its invariant density is 1/2 everywhere, so its exponent is known.
    """
    starts = np.random.default_rng(5).uniform(0, 2, (400, 1))

    def run(x0):
        found = lh.lyapunov_spectrum(lh.Map(two_rooms), x0, t1=BLOCKS * 100, transient=1000)
        return found.exponents[0], found.stderr[0], found.history.growth[:, 0]

    exponents, errors, growth = map(np.asarray, jax.vmap(run)(jnp.asarray(starts)))
    off = exponents - EXPONENT_OF_ROOMS
    assert abs(np.mean(off)) < 4 * np.std(off) / len(off) ** 0.5
    before, now = held(off, of_independent(growth.T) / 100), held(off, errors)
    assert before[0] < 0.45
    assert 0.60 < now[0] < 0.75
    assert 0.87 < now[1] < 0.98


def test_the_mean_of_jax_is_that_of_numpy():
    growth = correlated(2, runs=50)
    inside = jax.jit(lambda growth: error_of(growth, xp=jnp))(jnp.asarray(growth))
    assert np.allclose(inside, error_of(growth), rtol=1e-12, atol=0)


@pytest.mark.parametrize("reached", [64, 50, 33, 9, 2])
def test_blocks_that_were_not_reached_do_not_count(reached):
    growth, there = correlated(4, runs=50), np.arange(BLOCKS) < reached
    some = np.where(there[:, None], growth, 0.0)
    assert np.allclose(error_of(some, there.astype(float)), error_of(growth[:reached]), rtol=1e-12, atol=0)


def test_growth_without_scatter_has_no_error():
    assert error_of(np.ones((BLOCKS, 2))).tolist() == [0.0, 0.0]


def test_blocks_of_other_lengths():
    """Lengths drawn from a gamma distribution, growth a Brownian motion in time: independent."""
    lengths = np.random.default_rng(2).gamma(3.0, 1.0, BLOCKS)
    growth = correlated(0) * lengths[:, None] ** 0.5
    error, true = error_of(growth, lengths), np.sum(lengths) ** -0.5
    assert abs(np.mean(error) / true - 1) < 0.05
    one, two = held(np.sum(growth, axis=0) / np.sum(lengths), error)
    assert 0.63 < one < 0.73
    assert 0.91 < two < 0.97


@pytest.mark.slow
def test_errors_of_weighted_averages():
    """300 runs of the logistic map at r = 3.8: the weights leave fewer blocks that count, and the error says so."""
    logistic = lh.Map(lambda n, x, r: r * x * (1 - x))
    starts = jnp.asarray(np.random.default_rng(5).uniform(0.1, 0.9, (300, 1)))

    def run(x0):
        found = lh.lyapunov_spectrum(logistic, x0, 3.8, t1=2000, transient=200, averaging="birkhoff")
        return found.exponents[0], found.stderr[0]

    values, errors = map(np.asarray, jax.vmap(run)(starts))
    assert 0.9 < np.sqrt(np.mean(errors**2)) / np.std(values, ddof=1) < 1.3
