"""The points of a sweep: what each gives alone, whatever stands beside it."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import lyaphybrid as lh

LORENZ = lh.zoo.lorenz63()
FIXED = lh.RungeKutta("rk4", dt=0.01)
RHO = np.concatenate([np.linspace(5.0, 20.0, 19), [1e9], np.linspace(25.0, 27.0, 7), [1e5]])  # two are out of bounds


def run(args):
    return lh.lyapunov_spectrum(LORENZ.system, LORENZ.x0, args, t1=20.0, method=FIXED, every=10, blocks=8)


def swept(**keywords):
    return lh.sweep(run, {"rho": RHO}, args=LORENZ.args, **{"progress": False, "chunk": 20} | keywords)


@pytest.fixture(scope="module")
def whole():
    return swept()


@pytest.mark.slow
def test_points_are_single_runs(whole):
    for rho, status, exponents in zip(RHO, whole.status.values, whole.exponents.values, strict=True):
        args = LORENZ.args | {"rho": rho}
        alone = lh.lyapunov_spectrum(
            LORENZ.system, LORENZ.x0, args, t1=20.0, method=FIXED, every=10, blocks=8, throw=False
        )
        assert status == int(alone.status)
        if alone.status is lh.STATUS.ok:
            assert_allclose(exponents, alone.exponents, atol=1e-10 if rho < 24 else 1e-3)
        else:
            assert np.all(np.isnan(exponents))
    assert np.sum(whole.status.values == int(lh.STATUS.nonfinite)) == 2


@pytest.mark.parametrize("chunk", [1, 8, 28])
def test_neighbours_change_nothing(whole, chunk):
    assert swept(chunk=chunk).equals(whole)


def test_a_limit_of_steps_is_kept():
    def limited(args):
        return lh.lyapunov_spectrum(
            LORENZ.system, LORENZ.x0, args, t1=1.0, method=FIXED, every=10, blocks=2, max_steps=85
        )

    found = lh.sweep(limited, {"rho": np.array([20.0, 21.0])}, args=LORENZ.args, progress=False)
    assert found.status.values.tolist() == [int(lh.STATUS.max_steps)] * 2


@pytest.mark.parametrize("transient", [0, 100])
def test_a_wanted_error_is_refused_in_a_sweep(transient):
    """How long a run is cannot depend on its values there; with a transient it was as if it had not been given."""

    def run(r):
        return lh.lyapunov_spectrum(LOGISTIC, [0.3], r, t1=500, transient=transient, target_stderr=0.004)

    with pytest.raises(ValueError, match="cannot be used under jit, vmap or grad, or in a sweep"):
        lh.sweep(run, {"args": [3.9, 3.91]}, args=3.9, progress=False)


LOGISTIC = lh.Map(lambda n, x, r: r * x * (1 - x))
