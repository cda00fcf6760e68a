"""Typed PRNG keys, `jax.random.key`, in args and in what functions close over: NumPy has no such type."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import lyaphybrid as lh
from lyaphybrid import STATUS

KEY, X0 = jax.random.key(3), [1.0, 0.0]
OMEGA = float(np.sqrt(1 + jax.random.uniform(KEY)))


def of_random_frequency(t, x, args):
    """The oscillator of a random frequency, which the key fixes."""
    return jnp.stack([x[1], -(1 + jax.random.uniform(args["key"])) * x[0]])


def closing_over_it(t, x, args):
    return of_random_frequency(t, x, {"key": KEY})


CASES = {"in args": (lh.Flow(of_random_frequency), {"key": KEY}), "in a closure": (lh.Flow(closing_over_it), None)}
with_key = pytest.mark.parametrize(("system", "args"), CASES.values(), ids=CASES)


@with_key
@pytest.mark.parametrize("verb", [lh.lyapunov_spectrum, lh.ofli2, lh.gali, lh.trajectory, lh.check, lh.svd_spectrum])
def test_verbs(verb, system, args):
    found = verb(system, X0, args, t1=2.0)
    assert getattr(found, "status", STATUS.ok) == STATUS.ok
    if verb is lh.check:
        assert found.ok


@with_key
def test_tangent_maps_and_orbits(system, args):
    cosine, sine = np.cos(2 * OMEGA), np.sin(2 * OMEGA)
    exact = [[cosine, sine / OMEGA], [-OMEGA * sine, cosine]]
    assert_allclose(lh.tangent_map(system, X0, args, t1=2.0).matrix, exact, rtol=1e-6)
    cycle = lh.floquet(system, X0, args, period=2 * np.pi / OMEGA)
    assert_allclose(np.abs(cycle.multipliers), 1.0, rtol=1e-6)


@with_key
def test_checkpoints(tmp_path, system, args):
    def run(**options):
        return lh.lyapunov_spectrum(system, X0, args, t1=40.0, checkpoint=tmp_path / "run", **options)

    assert_allclose(run().exponents, run(resume=True).exponents, rtol=0)
    other = lh.Flow(lambda t, x, args: of_random_frequency(t, x, {"key": jax.random.key(4)}))
    with pytest.raises(ValueError, match="system, args or method"):
        lh.lyapunov_spectrum(other, X0, None, t1=40.0, checkpoint=tmp_path / "run", resume=True)


def test_stores_of_sweeps(tmp_path):
    def run(args):
        return lh.trajectory(lh.Flow(lambda t, x, a: a["rate"] * of_random_frequency(t, x, a)), X0, args, t1=1.0, n=1)

    def swept(seed):
        over, args = {"rate": [0.5, 1.0]}, {"key": jax.random.key(seed), "rate": 1.0}
        return lh.sweep(run, over=over, args=args, store=tmp_path / "store", progress=False)

    assert_allclose(swept(3).x[:, -1, 0], np.cos(OMEGA * np.array([0.5, 1.0])), rtol=1e-6)
    assert_allclose(swept(3).x[:, -1, 0], np.cos(OMEGA * np.array([0.5, 1.0])), rtol=1e-6)
    with pytest.raises(ValueError, match="other"):
        swept(4)


@pytest.mark.parametrize("implementation", ["threefry2x32", "rbg"])
def test_sweeps_over_keys_of_each_kind(implementation, monkeypatch):
    monkeypatch.setenv("LYAPHYBRID_ENGINE", "auto")  # XLA draws the bits of the second
    keys = jax.random.split(jax.random.key(5, impl=implementation), 3)

    def run(args, key):
        return lh.trajectory(lh.Flow(of_random_frequency), X0, {"key": key}, t1=1.0, n=1)

    found = lh.sweep(run, over={"key": keys}, progress=False)
    omega = np.sqrt([1 + jax.random.uniform(key) for key in keys])
    assert_allclose(found.x[:, -1, 0], np.cos(omega), rtol=1e-6)
