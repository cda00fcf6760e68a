"""Hashes of functions and arrays, by which a later run recognises its own results."""

import hashlib
import re
from collections.abc import Callable, Mapping

import jax
import numpy as np
from jax.extend.core import ClosedJaxpr

from .jaxprs import constants

__all__ = ["as_bytes", "hash_of_arrays", "hash_of_function", "hash_of_jaxpr"]


def hash_of_function(function: Callable, *example) -> str:
    """Hash of a function's jaxpr and its constants."""
    return hash_of_jaxpr(jax.make_jaxpr(function)(*example))


def hash_of_jaxpr(closed: ClosedJaxpr) -> str:
    """Hash of a jaxpr and its constants."""
    digest = hashlib.sha256(re.sub(r"0x[0-9a-f]+", "", str(closed)).encode())  # without the addresses of functions
    for constant in constants(closed):
        digest.update(as_bytes(np.asarray(constant)))
    return digest.hexdigest()


def hash_of_arrays(arrays: Mapping[str, np.ndarray], begun: str = "") -> str:
    """Hash of named arrays; `begun` is another hash to include."""
    digest = hashlib.sha256(begun.encode())
    for name in sorted(arrays):
        digest.update(name.encode() + as_bytes(arrays[name]))
    return digest.hexdigest()


def as_bytes(values: np.ndarray) -> bytes:
    """Type, shape and entries of an array as bytes."""
    return f"{values.dtype.str}{values.shape}".encode() + np.ascontiguousarray(values).tobytes()
