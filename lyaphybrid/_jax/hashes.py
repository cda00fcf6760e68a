"""Hashes of functions and arrays, by which a later run recognises its own results."""

import hashlib
import re
from collections.abc import Callable, Mapping

import jax
import numpy as np
from jax.extend.core import ClosedJaxpr, Literal

from .jaxprs import inside
from .tracing import without_key_type

__all__ = ["as_bytes", "hash_of_arrays", "hash_of_function", "hash_of_jaxpr"]


def hash_of_function(function: Callable, *example) -> str:
    """Hash of a function's jaxpr and its constants."""
    return hash_of_jaxpr(jax.make_jaxpr(function)(*example))


def hash_of_jaxpr(closed: ClosedJaxpr) -> str:
    """Hash of a jaxpr, its numbers, and all that it calls."""
    digest = hashlib.sha256()
    for one in _with_programs(closed):
        digest.update(re.sub(r"0x[0-9a-f]+", "", str(one)).encode())  # without the addresses of functions
        for number in _numbers(one):
            digest.update(as_bytes(without_key_type(number)))
    return digest.hexdigest()


def _with_programs(closed: ClosedJaxpr) -> list[ClosedJaxpr]:
    """The jaxpr, and those of the compiled programs that it calls, which its text does not show."""
    found = [closed]
    for eqn in closed.jaxpr.eqns:
        called = [getattr(value, "closed", None) for value in eqn.params.values()]
        for program in [one for one in called if isinstance(one, ClosedJaxpr)]:
            found += _with_programs(program)
        for inner in inside(eqn):
            found += _with_programs(inner)[1:]
    return found


def _numbers(closed: ClosedJaxpr) -> list:
    """The constants and literals of a jaxpr and of those inside it: its text shortens them."""
    found = list(closed.consts)
    for eqn in closed.jaxpr.eqns:
        found += [atom.val for atom in eqn.invars if isinstance(atom, Literal)]
        for inner in inside(eqn):
            found += _numbers(inner)
    return found


def hash_of_arrays(arrays: Mapping[str, np.ndarray], begun: str = "") -> str:
    """Hash of named arrays; `begun` is another hash to include."""
    digest = hashlib.sha256(begun.encode())
    for name in sorted(arrays):
        digest.update(name.encode() + as_bytes(arrays[name]))
    return digest.hexdigest()


def as_bytes(values: np.ndarray) -> bytes:
    """Type, shape and entries of an array as bytes."""
    return f"{values.dtype.str}{values.shape}".encode() + np.ascontiguousarray(values).tobytes()
