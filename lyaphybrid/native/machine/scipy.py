"""Addresses of the LAPACK and BLAS functions that SciPy exports for Cython.

In compiled code the name of a function has the prefix `native_`. All arguments are pointers; integers have 32 bits, and
strings have no hidden length arguments.
"""

import ctypes
import functools
import re

_PREFIX = "native_"


def symbol(function: str) -> str:
    """The name of a function in compiled code."""
    return _PREFIX + function


def addresses(code: bytes) -> dict[str, int]:
    """The addresses of the functions that machine code calls, by symbol."""
    names = sorted(set(re.findall(_PREFIX.encode() + rb"(\w+)", code)))
    return {symbol(name.decode()): _address(name.decode()) for name in names}


@functools.cache
def _address(function: str) -> int:
    import scipy.linalg.cython_blas as blas  # imported here, because the import is slow
    import scipy.linalg.cython_lapack as lapack

    capsule = next(m.__pyx_capi__[function] for m in (blas, lapack) if function in m.__pyx_capi__)
    name_of, pointer_of = ctypes.pythonapi.PyCapsule_GetName, ctypes.pythonapi.PyCapsule_GetPointer
    name_of.restype, name_of.argtypes = ctypes.c_char_p, [ctypes.py_object]
    pointer_of.restype, pointer_of.argtypes = ctypes.c_void_p, [ctypes.py_object, ctypes.c_char_p]
    return pointer_of(capsule, name_of(capsule))
