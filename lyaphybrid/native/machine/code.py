"""LLVM: machine code in memory, the addresses of its functions, and what this CPU has."""

import ctypes
import ctypes.util
import functools
import itertools
import sys
import threading
from collections.abc import Mapping, Sequence

import llvmlite.binding as llvm

from . import scipy as _scipy

_OF_FLOATS = (
    "fmod tan asin acos atan atan2 sinh cosh tanh asinh acosh atanh log1p expm1 cbrt erf erfc lgamma nextafter "
    "sin cos sincos exp exp2 log log2 pow sqrt floor ceil round roundeven rint fma"
).split()
_LIBRARY = (*_OF_FLOATS, *(name + "f" for name in _OF_FLOATS), *"malloc free abort memcpy memset memmove".split())


@functools.cache
def _library() -> dict[str, int]:
    """The addresses of functions of the C library."""
    names = ["ucrtbase"] if sys.platform == "win32" else [ctypes.util.find_library("m"), None]
    libraries = [ctypes.CDLL(name) for name in names if name is not None or sys.platform != "win32"]
    found = {}
    for name in _LIBRARY:
        functions = [function for library in libraries if (function := getattr(library, name, None)) is not None]
        if functions:
            found[name] = ctypes.cast(functions[0], ctypes.c_void_p).value
    return found


@functools.cache
def doubles_in_a_vector() -> int:
    """The number of doubles in the widest vector register of this CPU."""
    features = llvm.get_host_cpu_features()
    return 8 if features.get("avx512f") else 4 if features.get("avx") else 2


@functools.cache
def has_fused_products() -> bool:
    """Whether this CPU has an instruction for a·b + c with one rounding (FMA)."""
    return bool(llvm.get_host_cpu_features().get("fma")) or llvm.get_default_triple().startswith(("aarch64", "arm64"))


@functools.cache
def _linker():
    # JITLink places code and constants next to each other. LLVM's older linker may place them farther apart than an
    # instruction can address, and then ends the process.
    return llvm.create_lljit_compiler(use_jit_link=sys.platform != "win32")


_names, _linking = itertools.count(), threading.Lock()


class Linked:
    """Machine code that is linked in memory; it stays there as long as this object lives."""

    def __init__(self, code: bytes, functions: Sequence[str], filled: Mapping[str, Sequence[int]]):
        """`functions`: names of the functions whose addresses are needed; `filled`: int32 values of globals."""
        library = llvm.JITLibraryBuilder().add_object_img(code)
        for name, address in (_library() | _scipy.addresses(code)).items():
            library.import_symbol(name, address)
        for name in (*functions, *filled):
            library.export_symbol(name)
        with _linking:
            self._code = library.link(_linker(), f"program {next(_names)}")
        for name, numbers in filled.items():
            (ctypes.c_int32 * len(numbers)).from_address(self._code[name])[:] = numbers

    def address(self, function: str) -> int:
        """The address of a function."""
        return self._code[function]
