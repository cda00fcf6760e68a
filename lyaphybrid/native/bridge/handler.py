"""The function that XLA calls: a handler of its foreign function interface (FFI), written in LLVM IR.

Its argument is an `XLA_FFI_CallFrame`, a C structure whose layout (`xla/ffi/api/c_api.h`, shipped with JAX) has been
the same since version 0.1 of the interface. The numbers below are offsets in bytes on 64-bit machines.
"""

import functools
import re
from pathlib import Path

import jax

_EXTENSION, _ARGUMENTS, _RESULTS = 8, 72, 112  # in the frame: kind of call; arrays of pointers to buffers
_IS_METADATA, _METADATA = 8, 24  # in the extension: 1 if XLA asks for metadata; pointer to the metadata to fill
_MAJOR, _MINOR, _TRAITS = 24, 28, 32  # in the metadata
_DATA = 24  # in a buffer
_VERSION = "version"  # a global of the module: its code is that of every JAX, and can be kept on disk for all


@functools.cache
def filled() -> dict[str, tuple[int, ...]]:
    """The numbers that the module's globals have when it is linked: the version of the FFI of the installed JAX."""
    text = (Path(jax.ffi.include_dir()) / "xla/ffi/api/c_api.h").read_text()
    major, minor = (re.search(rf"#define XLA_FFI_API_{part} (\d+)", text) for part in ("MAJOR", "MINOR"))
    if major is None or minor is None:
        raise RuntimeError(f"jax {jax.__version__}: no version in XLA's c_api.h")
    return {_VERSION: (int(major[1]), int(minor[1]))}


def handler(inputs: int, outputs: int) -> str:
    """LLVM IR of the handler: it collects the addresses of the arrays and calls `@call`; null means success."""
    lines = [
        f"@{_VERSION} = global [2 x i32] zeroinitializer",
        "define ptr @handler(ptr %frame) {",
        "entry:",
        f"  %inputs = alloca [{max(1, inputs)} x ptr]",
        f"  %outputs = alloca [{max(1, outputs)} x ptr]",
        *_field("extension", "frame", _EXTENSION),
        "  %extended = icmp ne ptr %extension, null",
        "  br i1 %extended, label %asked, label %work",
        "asked:",
        f"  %kind.at = getelementptr i8, ptr %extension, i64 {_IS_METADATA}",
        "  %kind = load i32, ptr %kind.at",
        "  %is.metadata = icmp eq i32 %kind, 1",
        "  br i1 %is.metadata, label %describe, label %work",
        "describe:",
        *_field("metadata", "extension", _METADATA),
        f"  %major = load i32, ptr @{_VERSION}",
        f"  %minor.from = getelementptr i32, ptr @{_VERSION}, i64 1",
        "  %minor = load i32, ptr %minor.from",
    ]
    for name, offset, number in (("major", _MAJOR, "%major"), ("minor", _MINOR, "%minor"), ("traits", _TRAITS, 0)):
        lines += [
            f"  %{name}.at = getelementptr i8, ptr %metadata, i64 {offset}",
            f"  store i32 {number}, ptr %{name}.at",
        ]
    lines += ["  ret ptr null", "work:"]
    for array, source, offset, count in (
        ("inputs", "arguments", _ARGUMENTS, inputs),
        ("outputs", "results", _RESULTS, outputs),
    ):
        lines += _field(source, "frame", offset)
        for i in range(count):
            lines += [
                f"  %{source}.{i}.at = getelementptr ptr, ptr %{source}, i64 {i}",
                f"  %{source}.{i} = load ptr, ptr %{source}.{i}.at",
                *_field(f"{source}.{i}.data", f"{source}.{i}", _DATA),
                f"  %{array}.{i}.at = getelementptr ptr, ptr %{array}, i64 {i}",
                f"  store ptr %{source}.{i}.data, ptr %{array}.{i}.at",
            ]
    lines += ["  call void @call(ptr %inputs, ptr %outputs)", "  ret ptr null", "}", ""]
    return "\n".join(lines)


def _field(name: str, of: str, offset: int) -> list[str]:
    """Instructions that load a pointer from a structure, at an offset in bytes."""
    return [f"  %{name}.in = getelementptr i8, ptr %{of}, i64 {offset}", f"  %{name} = load ptr, ptr %{name}.in"]
