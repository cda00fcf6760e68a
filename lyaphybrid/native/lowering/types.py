"""Element types of JAX, NumPy and LLVM (float64 is LLVM's double), and numbers in LLVM IR."""

import functools
import struct

import jax
import numpy as np

from .unsupported import UnsupportedError

_LLVM = {
    "bool": "i1",  # in registers; a byte in memory
    "int8": "i8",
    "uint8": "i8",
    "int16": "i16",
    "uint16": "i16",
    "int32": "i32",
    "uint32": "i32",
    "int64": "i64",
    "uint64": "i64",
    "float32": "float",
    "float64": "double",
    "void": "i1",  # float0, the type of cotangents of integers, which are never read
    "key<fry>": "i64",  # a PRNG key of JAX (Threefry): two words of 32 bits
}
BYTES = {"i1": 1, "i8": 1, "i16": 2, "i32": 4, "i64": 8, "float": 4, "double": 8}
BITS = {"i1": 1, "i8": 8, "i16": 16, "i32": 32, "i64": 64}
INDEX = np.dtype(np.int64)


@functools.cache
def llvm_type(dtype) -> str:
    """The LLVM type of an element; `UnsupportedError` for complex numbers, half floats and keys of other PRNGs."""
    name = getattr(dtype, "name", None) or np.dtype(dtype).name
    if name not in _LLVM:
        raise UnsupportedError(f"elements of type {name}")
    return _LLVM[name]


@functools.cache
def numpy_type(dtype) -> np.dtype:
    """The type of NumPy arrays of such elements; uint64 for PRNG keys."""
    return np.dtype(np.uint64) if _is_key(dtype) else np.dtype(dtype)


@functools.cache
def _is_key(dtype) -> bool:
    return str(getattr(dtype, "name", "")).startswith("key<")


def as_numpy(array) -> np.ndarray:
    """The array as a NumPy array; PRNG keys as uint64."""
    if isinstance(array, np.ndarray) or not _is_key(getattr(array, "dtype", None)):
        return np.asarray(array)
    llvm_type(array.dtype)
    words = np.ascontiguousarray(jax.random.key_data(array))
    return words.view(np.uint64).reshape(array.shape)


def of_numpy(array: np.ndarray, dtype):
    """The NumPy array as JAX expects it; an array of PRNG keys for a key type."""
    if not _is_key(dtype):
        return array
    words = array.reshape(*array.shape, 1).view(np.uint32)
    return jax.random.wrap_key_data(jax.numpy.asarray(words), impl="threefry2x32")


def is_float(dtype) -> bool:
    """Whether elements are floating-point numbers."""
    return kind(dtype) == "f"


@functools.cache
def kind(dtype) -> str:
    """NumPy's letter for the kind of a type: b(oolean), i(nteger), u(nsigned), f(loat)."""
    return numpy_type(dtype).kind


def in_memory(type_: str) -> str:
    """The LLVM type of an element in memory: a boolean takes a byte."""
    return "i8" if type_ == "i1" else type_


def literal(number: bool | int | float, type_: str) -> str:
    """A number in LLVM IR; floats by their bits, which is exact and includes nan and inf."""
    if type_ == "i1":
        return "true" if number else "false"
    if type_ in ("double", "float"):
        exact = float(number) if type_ == "double" else float(np.float32(number))
        return f"0x{struct.unpack('<Q', struct.pack('<d', exact))[0]:016X}"
    return str(int(number))
