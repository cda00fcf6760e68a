"""NumPy's arrays as JAX arrays on the default device.

`jax.device_put` takes about 14 µs an array, most of it in Python. A result has some twenty arrays, and a short run
takes less than they would. JAX's own last step alone takes 3 µs.
"""

import functools
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np
from jax._src.lib import xla_client  # pyright: ignore[reportPrivateImportUsage]
from jax.core import ShapedArray
from jax.sharding import SingleDeviceSharding

_put = getattr(xla_client, "batched_device_put", None)  # there is no public name for it


def on_device(arrays: Sequence[Any]) -> list:
    """The same as `jax.device_put(list(arrays))`: NumPy's arrays as JAX arrays; others stay as they are."""
    if _put is None or jax.config.jax_default_device is not None:  # pyright: ignore[reportAttributeAccessIssue]
        return jax.device_put(list(arrays))
    devices = jax.local_devices()[:1]
    sharding = SingleDeviceSharding(devices[0])
    return [_one(array, sharding, devices) if type(array) is np.ndarray else jax.device_put(array) for array in arrays]


def _one(array: np.ndarray, sharding: SingleDeviceSharding, devices: list) -> Any:
    assert _put is not None
    aval = _aval(array.shape, array.dtype, bool(jax.config.read("jax_enable_x64")))
    return _put(aval, sharding, [array if array.dtype == aval.dtype else array.astype(aval.dtype)], devices, False)


@functools.lru_cache(1024)
def _aval(shape: tuple[int, ...], dtype: np.dtype, double: bool) -> ShapedArray:
    """The type of an array; `double`: whether 64 bits are on, on which the type depends."""
    del double
    return ShapedArray(shape, jax.dtypes.canonicalize_dtype(dtype))
