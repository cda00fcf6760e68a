"""LAPACK and BLAS: the functions that SciPy offers to Cython, by their addresses.

A function is called `native_` and its name in compiled code. All arguments go by pointer; integers have 32 bits, and
strings no hidden lengths.
"""

import ctypes
import functools
import re

_PREFIX = "native_"


def symbol(function: str) -> str:
    """What a function is called in compiled code."""
    return _PREFIX + function


def addresses(code: bytes) -> dict[str, int]:
    """Where the functions are that machine code calls."""
    names = sorted(set(re.findall(_PREFIX.encode() + rb"(\w+)", code)))
    return {symbol(name.decode()): _address(name.decode()) for name in names}


@functools.cache
def _address(function: str) -> int:
    import scipy.linalg.cython_blas as blas  # here, for it takes a while
    import scipy.linalg.cython_lapack as lapack

    capsule = next(m.__pyx_capi__[function] for m in (blas, lapack) if function in m.__pyx_capi__)
    name_of, pointer_of = ctypes.pythonapi.PyCapsule_GetName, ctypes.pythonapi.PyCapsule_GetPointer
    name_of.restype, name_of.argtypes = ctypes.c_char_p, [ctypes.py_object]
    pointer_of.restype, pointer_of.argtypes = ctypes.c_void_p, [ctypes.py_object, ctypes.c_char_p]
    return pointer_of(capsule, name_of(capsule))
