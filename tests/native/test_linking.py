"""Machine code in memory."""

import os
import subprocess
import sys

import pytest

CROWDED = """
import ctypes
import jax.numpy as jnp
import numpy as np
from lyaphybrid import native

of_c = ctypes.CDLL(None)
of_c.mmap.restype = ctypes.c_void_p
of_c.mmap.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int, ctypes.c_int, ctypes.c_int, ctypes.c_long]
NOTHING, PRIVATE, NOT_RESERVED = 0, 0x22, 0x4000
assert of_c.mmap(None, 5 << 30, NOTHING, PRIVATE | NOT_RESERVED, -1, 0) != ctypes.c_void_p(-1).value
kept = []
for i in range(300):
    table = np.arange(50, dtype=np.float32) + i
    kept.append(native.compile(lambda k: jnp.asarray(table)[k] * 2, 3))
    assert kept[-1](3) == 2 * (3 + i)
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="how memory is asked for")
def test_code_and_its_constants_lie_together():
    """An instruction reaches 2 GB far; free pages are farther apart here, as in a process that has grown large."""
    environment = os.environ | {"LYAPHYBRID_CACHE": "off"}
    done = subprocess.run([sys.executable, "-c", CROWDED], capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stderr[-500:]
