"""A sweep on several devices."""

import subprocess
import sys

import numpy as np
import pytest
from numpy.testing import assert_allclose

import two_devices


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
