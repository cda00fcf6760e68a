"""LLVM: from the text of a module to an address."""

import ctypes
import ctypes.util
import functools
import sys

import llvmlite.binding as llvm

from . import _scipy

llvm.initialize_native_target()
llvm.initialize_native_asmprinter()

_OF_FLOATS = (
    "fmod tan asin acos atan atan2 sinh cosh tanh asinh acosh atanh log1p expm1 cbrt erf erfc lgamma nextafter "
    "sin cos sincos exp exp2 log pow sqrt floor ceil round roundeven rint fma"
).split()
_LIBRARY = (*_OF_FLOATS, *(name + "f" for name in _OF_FLOATS), *"malloc free abort memcpy memset memmove".split())


@functools.cache
def _symbols() -> None:
    """Tell LLVM where the functions of the C library are."""
    names = ["ucrtbase"] if sys.platform == "win32" else [ctypes.util.find_library("m"), None]
    libraries = [ctypes.CDLL(name) for name in names if name is not None or sys.platform != "win32"]
    for function in _LIBRARY:
        for library in libraries:
            if (found := getattr(library, function, None)) is not None:
                llvm.add_symbol(function, ctypes.cast(found, ctypes.c_void_p).value)
                break


def describe() -> str:
    """What machine code depends on, beside the module's text."""
    return f"LLVM {llvm.llvm_version_info}, {llvm.get_default_triple()}, {llvm.get_host_cpu_name()}, {_features()}"


@functools.cache
def _features() -> str:
    return llvm.get_host_cpu_features().flatten()


@functools.cache
def doubles_in_a_vector() -> int:
    """How many numbers the widest vectors of this CPU hold."""
    features = llvm.get_host_cpu_features()
    return 8 if features.get("avx512f") else 4 if features.get("avx") else 2


def _target_machine(level: int):
    target = llvm.Target.from_default_triple()
    return target.create_target_machine(
        cpu=llvm.get_host_cpu_name(), features=_features(), opt=level, reloc="pic", codemodel="small"
    )


def object_code(text: str, level: int) -> bytes:
    """Machine code, not yet linked, of a module."""
    machine = _target_machine(level)
    module = llvm.parse_assembly(text)
    module.triple, module.data_layout = machine.triple, str(machine.target_data)
    options = llvm.create_pipeline_tuning_options(speed_level=level)
    options.slp_vectorization = options.loop_vectorization = level >= 2
    options.loop_unrolling = level >= 2
    builder = llvm.create_pass_builder(machine, options)
    builder.getModulePassManager().run(module, builder)
    return machine.emit_object(module)


class Linked:
    """Machine code in memory."""

    def __init__(self, code: bytes):
        _symbols()
        _scipy.register(code)
        # llvmlite's memory manager puts code and constants side by side: LLVM's own may put them farther apart than
        # an instruction reaches, and then ends the process.
        self._engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), _target_machine(0), use_lmm=True)
        self._engine.add_object_file(llvm.ObjectFileRef.from_data(code))
        self._engine.finalize_object()

    def address(self, function: str) -> int:
        """Where a function begins."""
        return self._engine.get_function_address(function)
