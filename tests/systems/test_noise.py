"""Frozen noise: exponents of random systems with closed forms, the same noise for all, derivatives at fixed noise."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import quad
from scipy.special import digamma
from scipy.stats import norm

import lyaphybrid as lh

RATE, EVERY = 0.7, 0.25


def mean_of(function):
    """The mean over a normal variable."""
    return quad(lambda z: function(z) * norm.pdf(z), -12, 12, points=[-2.0], limit=400)[0]


def lognormal(n, x, args):
    return x * jnp.exp(0.3 + 0.8 * lh.frozen_noise(args["seed"], n))


def matrices(n, x, args):
    return lh.frozen_noise(args["seed"], n, (3, 3)) @ x


def additive(n, x, args):
    return 0.6 * x + lh.frozen_noise(args["seed"], n)


def kicked(t, x, args):
    return x * (1 + 0.5 * lh.frozen_noise(args["seed"], t / EVERY))


def held(t, x, args):
    """x' = u x, u a component that a clock sets anew."""
    return jnp.stack([x[1] * x[0], 0 * x[1]])


def set_anew(t, x, args):
    return jnp.stack([x[0], 0.5 - lh.frozen_noise(args["seed"], t / EVERY, kind="exponential")])


def bent(n, x, args):
    """A random tent map, its peak at a uniform place: λ = ⟨−p ln p − (1 − p) ln(1 − p)⟩ = 1/2."""
    peak = lh.frozen_noise(args["seed"], n, kind="uniform")
    return jnp.where(x < peak, x / peak, (1 - x) / (1 - peak))


CLOSED = {
    "lognormal factors": (lh.Map(lognormal), [0.0], [0.3], {"t1": 40_000}),
    "Gaussian matrices": (
        lh.Map(matrices),
        [0.0, 0.0, 0.0],  # a linear map: perturbations of rest
        [0.5 * (np.log(2) + digamma(m / 2)) for m in (3, 2, 1)],
        {"t1": 40_000, "transient": 100},
    ),
    "additive noise": (lh.Map(additive), [0.0], [np.log(0.6)], {"t1": 1000}),
    "random kicks": (
        lh.Hybrid(lambda t, x, args: -RATE * x, lh.Transition(every=EVERY, reset=kicked)),
        [1.0],
        [-RATE + mean_of(lambda z: np.log(abs(1 + 0.5 * z))) / EVERY],
        {"t1": 5000.0},
    ),
    "a rate that is held": (
        lh.Hybrid(held, lh.Transition(every=EVERY, reset=set_anew)),
        [1.0, 0.0],
        [-0.5],
        {"t1": 5000.0, "frame": [[1.0], [0.0]]},
    ),
    "random tents": (lh.Map(bent), [0.3], [0.5], {"t1": 40_000}),
}


@pytest.mark.slow_cases("Gaussian matrices", "random kicks", "a rate that is held")
@pytest.mark.parametrize("name", CLOSED)
def test_exponents_of_random_systems(name):
    """Within three standard errors of what is known; where nothing is random but the state, exactly."""
    system, x0, exact, how = CLOSED[name]
    found = lh.lyapunov_spectrum(system, x0, {"seed": 1}, **how)
    least = 1e-9 if name == "additive noise" else 0.0
    assert np.all(np.abs(found.exponents - np.array(exact)) < 3 * np.asarray(found.stderr) + least), (found, exact)


def test_all_starts_see_the_same_noise():
    """A stable random map: all starts end on one trajectory, another for another seed."""
    run = lambda x, seed: lh.trajectory(lh.Map(additive), [x], {"seed": seed}, t1=200, n=1).x[-1, 0]  # noqa: E731
    assert_allclose(run(3.0, 1), run(-2.0, 1), rtol=0, atol=1e-12)
    assert abs(run(3.0, 1) - run(3.0, 2)) > 1e-3


@pytest.mark.slow
def test_a_driven_neuron_is_reliable():
    """A leaky neuron with a random current: a negative exponent, and spikes at the same times from different starts."""

    def current(t, x, args):
        return jnp.stack([x[0], 1.2 + 0.8 * lh.frozen_noise(args["seed"], t / EVERY)])

    neuron = lh.Hybrid(
        lambda t, x, args: jnp.stack([x[1] - x[0], 0 * x[1]]),
        [
            lh.Transition(lambda t, x, args: 1.0 - x[0], lambda t, x, args: jnp.stack([0 * x[0], x[1]])),
            lh.Transition(every=EVERY, reset=current),
        ],
    )
    found = lh.lyapunov_spectrum(neuron, [0.2, 1.2], {"seed": 1}, t1=2000.0, frame=[[1.0], [0.0]])
    assert found.exponents[0] < -5 * found.stderr[0]
    late = []
    for start in (0.1, 0.9):
        events = lh.trajectory(neuron, [start, 1.2], {"seed": 1}, t1=200.0, n=1).events
        spikes = np.asarray(events.t)[np.asarray(events.transition) == 0]
        late.append(spikes[spikes > 150])
    assert_allclose(late[0], late[1], rtol=0, atol=1e-8)


@pytest.mark.slow
def test_derivatives_are_at_fixed_noise():
    def end(strength):
        rule = lambda n, x, args: 0.5 * x + args * lh.frozen_noise(7, n)  # noqa: E731
        return lh.trajectory(lh.Map(rule), [0.0], strength, t1=30, n=1).x[-1, 0]

    assert_allclose(jax.jacfwd(end)(jnp.asarray(0.3)), end(1.0), rtol=1e-12)  # linear in the strength


@pytest.mark.slow
def test_seeds_are_swept_and_runs_go_on_with_their_noise(tmp_path):
    """Each point is its own run; a run that was cut in two sees what the whole one sees."""

    def exponents(args, **more):
        return lh.lyapunov_spectrum(lh.Map(multiplied), [1.0], args, **{"t1": 400, "blocks": 8} | more)

    def multiplied(n, x, args):
        return x * (0.5 + 0.1 * lh.frozen_noise(args["seed"], n))

    seeds = np.array([1, 2, 5])
    found = lh.sweep(exponents, {"seed": seeds}, args={"seed": jnp.asarray(1)}, progress=False)
    alone = [exponents({"seed": jnp.asarray(seed)}).exponents for seed in seeds]
    assert_allclose(found.exponents, alone, rtol=1e-12)
    assert len(np.unique(found.exponents)) == 3
    path, args = tmp_path / "run.npz", {"seed": jnp.asarray(5)}
    exponents(args, t1=200, blocks=4, checkpoint=path)
    longer = exponents(args, blocks=4, checkpoint=path, resume=True)
    assert_allclose(longer.exponents, alone[2], rtol=1e-12)


@pytest.mark.slow
def test_numbers_are_those_of_their_count():
    counts = jnp.asarray([0.0, 1.0, 2.0**32, 2.0**32 + 1, -1.0, 2.0**50])
    values = [float(lh.frozen_noise(3, count)) for count in counts]
    assert len(set(values)) == len(values)
    assert float(lh.frozen_noise(3, 4.0 + 1e-9)) == float(lh.frozen_noise(3, 4.0 - 1e-9))
    many = np.asarray(jax.vmap(lambda n: lh.frozen_noise(3, n))(jnp.arange(20_000.0)))
    assert abs(np.mean(many)) < 4 / 20_000**0.5
    assert abs(np.std(many) - 1) < 0.03
    assert abs(np.mean(many[1:] * many[:-1])) < 4 / 20_000**0.5
    with pytest.raises(ValueError, match="kind must be one of"):
        lh.frozen_noise(3, 1.0, kind="white")


def test_a_count_that_is_nan_gives_nan():
    assert np.isnan(lh.frozen_noise(3, jnp.nan, (2,), kind="uniform")).all()
    assert np.isnan(jax.jit(lambda count: lh.frozen_noise(3, count))(jnp.nan))
    assert np.isfinite(lh.frozen_noise(3, 5))


@pytest.mark.parametrize("seed", [3.4, np.float32(0.5), np.nan, np.asarray(-1.5), jnp.asarray(1e9 + 0.5)])
def test_a_seed_that_is_not_whole_is_refused(seed):
    """It had the noise of the seed below; where it is traced it can only make all nan."""
    with pytest.raises(ValueError, match="a seed that is a whole number"):
        lh.frozen_noise(seed, 7.0)
    assert np.isnan(jax.jit(lambda seed: lh.frozen_noise(seed, 7.0, (2,)))(seed)).all()


@pytest.mark.parametrize("seed", [-1, np.int32(-7), -2.0])
def test_a_negative_seed_is_refused(seed):
    """It had the noise of 2**64 less."""
    with pytest.raises(ValueError, match="a seed from 0 on"):
        lh.frozen_noise(seed, 7.0)
    assert np.isnan(jax.jit(lambda seed: lh.frozen_noise(seed, 7.0))(seed))


def test_the_largest_seed():
    with pytest.raises(ValueError, match=f"a seed up to {2**64 - 1} at this precision; got {2**64}"):
        lh.frozen_noise(2**64, 7.0)
    with jax.enable_x64(False):
        assert lh.frozen_noise(2**32 - 1, 7.0) == lh.frozen_noise(np.uint32(2**32 - 1), 7.0) != lh.frozen_noise(5, 7.0)
        with pytest.raises(ValueError, match=f"a seed up to {2**32 - 1} at this precision"):
            lh.frozen_noise(2**32, 7.0)


def test_a_whole_seed_of_any_type_is_that_seed():
    drawn = lh.frozen_noise(5, 7.0)
    assert drawn == lh.frozen_noise(5.0, 7.0) == jax.jit(lambda seed: lh.frozen_noise(seed, 7.0))(5.0)
    assert lh.frozen_noise(2**64 - 1, 7.0) == lh.frozen_noise(np.uint64(2**64 - 1), 7.0) != drawn


def test_every_bit_of_a_seed_counts():
    seeds = [5, 2**31 + 5, 2**32 + 5, 2**63 + 5]
    drawn = [float(lh.frozen_noise(jnp.asarray(seed, "uint64"), 7.0)) for seed in seeds]
    assert len(set(drawn)) == len(seeds)
    assert float(lh.frozen_noise(2**32 + 5, 7.0)) == drawn[2]
    for kind in ("int32", "uint8", "float64"):
        assert float(lh.frozen_noise(jnp.asarray(5, kind), 7.0)) == drawn[0]
    run = lambda seed: lh.trajectory(lh.Map(additive), [0.0], {"seed": seed}, t1=3, n=1).x[-1, 0]  # noqa: E731
    assert run(5) != run(2**32 + 5)
