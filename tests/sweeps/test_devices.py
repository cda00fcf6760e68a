"""A sweep on several devices."""

import subprocess
import sys

import jax
import numpy as np
import pytest
from numpy.testing import assert_allclose

import lyaphybrid as lh
import two_devices
from lyaphybrid.engine.host import devices


@pytest.mark.slow
def test_two_devices_give_the_same_dataset(tmp_path):
    """Bit by bit; side by side, as on accelerators, other kernels round otherwise, and chaos amplifies it."""
    one = two_devices.swept()
    for way in ((), ("sharded",)):
        command = [sys.executable, two_devices.__file__, tmp_path / "two.npz", *way]
        subprocess.run(command, check=True)
        two = np.load(tmp_path / "two.npz")
        assert np.array_equal(one.status, two["status"])
        if not way:
            assert all(np.array_equal(one[name], two[name], equal_nan=True) for name in one.data_vars)
        regular = one.exponents.values[..., 0] < -0.05
        assert np.sum(regular) > 25
        assert_allclose(two["exponents"][regular], one.exponents.values[regular], atol=1e-10)


RATES = np.linspace(2.5, 2.9, 23)  # the logistic map has a stable fixed point, with the exponent ln|2 − r|


def swept(monkeypatch, most, said="RESOURCE_EXHAUSTED: Out of memory allocating 12345 bytes."):
    """A sweep as on an accelerator whose memory holds `most` points; also how many each call had."""
    together, sizes = devices._together, []

    def with_little_memory(function, shared, states, lanes, mesh):
        sizes.append(len(jax.tree.leaves(lanes)[0]))
        if sizes[-1] > most:
            raise jax.errors.JaxRuntimeError(said)
        return together(function, shared, states, lanes, mesh)

    monkeypatch.setattr(devices, "are_wanted", lambda: True)
    monkeypatch.setattr(devices, "_together", with_little_memory)
    logistic = lh.Map(lambda n, x, r: r * x * (1 - x))

    def run(r):
        return lh.lyapunov_spectrum(logistic, [0.3], r, transient=200, t1=100, blocks=4)

    return lh.sweep(run, {"args": RATES}, args=2.5, progress=False), sizes


@pytest.mark.slow
def test_a_chunk_that_needs_too_much_memory_is_halved(monkeypatch):
    with pytest.warns(UserWarning, match=r"23 runs at once need more memory than the devices have: going on with 11"):
        found, sizes = swept(monkeypatch, 11)
    assert sizes == [23, 11, 11, 11]
    assert_allclose(found.exponents[:, 0], np.log(abs(2 - RATES)), atol=1e-9)


@pytest.mark.slow
def test_halved_again_and_again_until_one_is_too_much(monkeypatch):
    with pytest.warns(UserWarning, match="more memory"), pytest.raises(jax.errors.JaxRuntimeError) as caught:
        swept(monkeypatch, 0)
    assert "does not hold a single run" in caught.value.__notes__[0]


@pytest.mark.slow
def test_other_errors_of_a_device_are_not_taken_for_it(monkeypatch):
    with pytest.raises(jax.errors.JaxRuntimeError, match="INTERNAL"):
        swept(monkeypatch, 0, "INTERNAL: something else")
