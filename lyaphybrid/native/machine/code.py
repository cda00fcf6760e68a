"""LLVM: from the text of a module to machine code and the addresses of its functions."""

import ctypes
import ctypes.util
import functools
import itertools
import sys
import threading
from collections.abc import Sequence

import llvmlite.binding as llvm

from . import scipy as _scipy

llvm.initialize_native_target()
llvm.initialize_native_asmprinter()

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


def describe() -> str:
    """What machine code depends on besides the module's text: LLVM, the platform, the CPU and its features."""
    return f"LLVM {llvm.llvm_version_info}, {llvm.get_default_triple()}, {llvm.get_host_cpu_name()}, {_features()}"


@functools.cache
def _features() -> str:
    """The features of this CPU, with gather and scatter instructions avoided on x86, where they are slow."""
    own = llvm.get_host_cpu_features().flatten()
    on_x86 = llvm.get_default_triple().startswith(("x86_64", "amd64"))
    return f"{own},+prefer-no-gather,+prefer-no-scatter" if on_x86 else own


@functools.cache
def doubles_in_a_vector() -> int:
    """The number of doubles in the widest vector register of this CPU."""
    features = llvm.get_host_cpu_features()
    return 8 if features.get("avx512f") else 4 if features.get("avx") else 2


@functools.cache
def has_fused_products() -> bool:
    """Whether this CPU has an instruction for a·b + c with one rounding (FMA)."""
    return bool(llvm.get_host_cpu_features().get("fma")) or llvm.get_default_triple().startswith(("aarch64", "arm64"))


def _target_machine(level: int):
    target = llvm.Target.from_default_triple()
    return target.create_target_machine(
        cpu=llvm.get_host_cpu_name(), features=_features(), opt=level, reloc="pic", codemodel="small"
    )


def object_code(text: str, level: int, scattered: bool = False, loops: bool = True) -> bytes:
    """The object code of a module.

    Args:
        text: the module.
        level: LLVM's optimisation level, 0 to 3.
        scattered: whether to search for vectors among scalar instructions (SLP).
        loops: whether loops become vectors and are unrolled, from level 2 on.
    """
    machine = _target_machine(level)
    module = llvm.parse_assembly(text)
    module.triple, module.data_layout = machine.triple, str(machine.target_data)
    options = llvm.create_pipeline_tuning_options(speed_level=level)
    options.slp_vectorization = scattered
    options.loop_vectorization = options.loop_unrolling = loops and level >= 2
    builder = llvm.create_pass_builder(machine, options)
    builder.getModulePassManager().run(module, builder)
    if scattered:  # LLVM's search for them can put an instruction after its uses; to emit that ends the process
        try:
            module.verify()
        except RuntimeError:
            return object_code(text, level, loops=loops)
    return machine.emit_object(module)


@functools.cache
def _linker():
    # JITLink places code and constants next to each other. LLVM's older linker may place them farther apart than an
    # instruction can address, and then ends the process.
    return llvm.create_lljit_compiler(use_jit_link=sys.platform != "win32")


_names, _linking = itertools.count(), threading.Lock()


class Linked:
    """Machine code that is linked in memory; it stays there as long as this object lives."""

    def __init__(self, code: bytes, functions: Sequence[str]):
        """`functions`: names of the functions whose addresses are needed."""
        library = llvm.JITLibraryBuilder().add_object_img(code)
        for name, address in (_library() | _scipy.addresses(code)).items():
            library.import_symbol(name, address)
        for name in functions:
            library.export_symbol(name)
        with _linking:
            self._code = library.link(_linker(), f"program {next(_names)}")

    def address(self, function: str) -> int:
        """The address of a function."""
        return self._code[function]
