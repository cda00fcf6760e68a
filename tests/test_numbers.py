"""Loops that are written in numbers: the same results, alone and under vmap; sweeps side by side."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import lyaphybrid as lh
from lyaphybrid import numbers
from lyaphybrid.sweeps import sweeping

pytestmark = pytest.mark.unoptimised

LORENZ = lh.zoo.lorenz63()
FIXED = lh.RungeKutta("rk4", dt=0.01)
RHO = np.concatenate([np.linspace(5.0, 20.0, 19), [1e9], np.linspace(25.0, 27.0, 7), [1e5]])  # two are out of bounds


def mixed(state):
    """What small arrays go through in a step, and what has no rule."""
    i, x, y = state
    y = 0.5 * jnp.transpose(y) + jnp.outer(x, x) - jnp.concatenate([y[1:], y[:1]]) / 3
    x = jnp.where(x > 0.3, y @ x, jnp.pad(x[:2], (1, 0))) + jnp.max(y, axis=0) - jnp.sort(x)
    x = x / (1 + jnp.sqrt(jnp.sum(x * x))) + jnp.arange(3.0) * 0.1
    inner = jax.lax.while_loop(lambda s: s[0] < i % 4, lambda s: (s[0] + 1, 0.9 * s[1] + 0.01), (0, x))
    return i + 1, inner[1], y / (1 + jnp.max(jnp.abs(y)))


def looped(while_loop, x):
    y = jnp.reshape(jnp.arange(9.0), (3, 3)) / 10
    return while_loop(lambda state: (state[0] < 10) & jnp.all(state[1] < 5), mixed, (0, x, y))


STARTS = np.random.default_rng(2).normal(size=(5, 3))


def test_a_loop_in_numbers_is_the_loop():
    for x in STARTS:
        expected, found = looped(jax.lax.while_loop, jnp.asarray(x)), looped(numbers.while_loop, jnp.asarray(x))
        jax.tree.map(lambda a, b: assert_allclose(a, b, rtol=1e-13, atol=1e-14), expected, found)


def test_under_vmap_too():
    each = [looped(jax.lax.while_loop, jnp.asarray(x)) for x in STARTS]
    found = jax.vmap(lambda x: looped(numbers.while_loop, x))(STARTS)
    for i, expected in enumerate(each):
        jax.tree.map(lambda a, b, i=i: assert_allclose(a, b[i], rtol=1e-13, atol=1e-14), expected, found)


def run(args):
    return lh.lyapunov_spectrum(LORENZ.system, LORENZ.x0, args, t1=20.0, method=FIXED, every=10, blocks=8)


def swept(**keywords):
    return lh.sweep(run, {"rho": RHO}, args=LORENZ.args, **{"progress": False, "chunk": 20} | keywords)


@pytest.fixture(scope="module")
def wide():
    """As on a CPU with wide vectors, whatever this one has."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sweeping, "has_wide_vectors", lambda: True)
        yield swept()


def test_points_side_by_side_are_single_runs(wide):
    for rho, status, exponents in zip(RHO, wide.status.values, wide.exponents.values, strict=True):
        args = LORENZ.args | {"rho": rho}
        alone = lh.lyapunov_spectrum(
            LORENZ.system, LORENZ.x0, args, t1=20.0, method=FIXED, every=10, blocks=8, throw=False
        )
        assert status == int(alone.status)
        if alone.status is lh.STATUS.ok:
            assert_allclose(exponents, alone.exponents, atol=1e-10 if rho < 24 else 1e-3)
        else:
            assert np.all(np.isnan(exponents))
    assert np.sum(wide.status.values == int(lh.STATUS.nonfinite)) == 2


@pytest.mark.parametrize("chunk", [1, 8, 28])
def test_neighbours_change_nothing(wide, chunk, monkeypatch):
    monkeypatch.setattr(sweeping, "has_wide_vectors", lambda: True)
    assert swept(chunk=chunk).equals(wide)


def test_without_wide_vectors_they_follow_each_other(wide, monkeypatch):
    monkeypatch.setattr(sweeping, "has_wide_vectors", lambda: False)
    found = swept()
    regular = RHO < 24
    assert_allclose(found.exponents[regular], wide.exponents[regular], atol=1e-10)
    assert np.array_equal(found.status, wide.status)


def suits(run, args):
    return sweeping.Work.of(run, run, args, sweeping.plan({"args": np.array([1.0])}, None, args), None).wide


@pytest.mark.parametrize(
    ("system", "method", "expected"),
    [
        (lh.Flow(lambda t, x, a: -a * x), FIXED, True),
        (lh.Flow(lambda t, x, a: -a * x), lh.RungeKutta(), False),
        (
            lh.Hybrid(lambda t, x, a: -a * x, [lh.Transition(lambda t, x, a: x[0] - 1, lambda t, x, a: -x)]),
            FIXED,
            False,
        ),
        (lh.Map(lambda n, x, a: a * x), None, False),
    ],
)
def test_only_small_flows_in_fixed_steps(system, method, expected, monkeypatch):
    monkeypatch.setattr(sweeping, "has_wide_vectors", lambda: True)
    assert (
        suits(lambda a: lh.lyapunov_spectrum(system, jnp.ones(3), a, t1=1.0, method=method, blocks=2), 1.0) == expected
    )
    assert not suits(lambda a: a**2, 1.0)


def test_a_limit_of_steps_is_kept(monkeypatch):
    monkeypatch.setattr(sweeping, "has_wide_vectors", lambda: True)

    def limited(args):
        return lh.lyapunov_spectrum(
            LORENZ.system, LORENZ.x0, args, t1=1.0, method=FIXED, every=10, blocks=2, max_steps=85
        )

    found = lh.sweep(limited, {"rho": np.array([20.0, 21.0])}, args=LORENZ.args, progress=False)
    assert found.status.values.tolist() == [int(lh.STATUS.max_steps)] * 2
