"""The compiler switch of this library: on a CPU, compile a whole `while` nest into one native, vectorised kernel.

By default XLA does so only for loops that touch about 1 kB an iteration; larger ones are dispatched operation
by operation, at 3 to 30 times the cost of hand-written C. And LLVM unrolls short loops altogether before it looks
for vectors, which it finds in loops alone: rows of four columns stay scalar code unless it unrolls only up to
three turns. Once it has found them it reads a row back from memory unless it was written or read at most six
instructions before; it is told to look further (Lorenz: a sixth of the time). `jit(compiler_options=…)` does not
take these options: they must stand in `XLA_FLAGS` before JAX creates its first backend.

What does not fit into one kernel becomes a hundred small ones. XLA's newer way to make these takes more time to
compile, and more memory (64 hard disks: 226 MB above the import, against 144 to 146), for loops that run no faster:
`lean_jit` asks for the older one where the XLA still has it.
"""

import functools
import importlib.util
import os
import re
import threading
import warnings
from collections.abc import Callable
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
from jax._src import xla_bridge

from ._tracing import traced

OPT_OUT = "LYAPHYBRID_KEEP_XLA_FLAGS"
_THRESHOLD = "xla_cpu_small_while_loop_byte_threshold"
_KERNELS = f"{_THRESHOLD}=16777216"  # bytes; no penalty was seen up to 1e9
_VECTORS = "-unroll-full-max-count=3,-available-load-scan-limit=1000"  # LLVM's own
_FLAG = "--xla_backend_extra_options="
_LEAN = {"xla_cpu_use_fusion_emitters": False, "xla_cpu_parallel_codegen_split_count": "1"}


def request_single_kernel_loops() -> None:
    """Add the switch to `XLA_FLAGS` where that still has an effect; else warn.

    Nothing happens where the user has chosen a threshold, where the environment variable
    `LYAPHYBRID_KEEP_XLA_FLAGS` is not empty, or with a JAX older than 0.8. All other flags stay as they are.
    """
    if os.environ.get(OPT_OUT) or jax.__version_info__ < (0, 8):
        return
    flags = os.environ.get("XLA_FLAGS", "").strip()
    in_file = flags != "" and not flags.startswith("-")  # XLA then reads its flags from the file of that name
    if _THRESHOLD in (_text(flags) if in_file else flags):
        return
    options = _options()
    too_late = xla_bridge.backends_are_initialized()
    if too_late and jax.default_backend() != "cpu":
        return
    if too_late or in_file:
        remedy = (
            f"add {_FLAG}{options} to the file that XLA_FLAGS names"
            if in_file
            else "import lyaphybrid before the first JAX computation, or set "
            f'XLA_FLAGS="{_FLAG}{options}" before Python starts'
        )
        warnings.warn(
            f"loops will not compile to single CPU kernels and may run several times slower: {remedy}. "
            f"{OPT_OUT}=1 silences this.",
            stacklevel=3,  # the line that imports lyaphybrid
        )
        return
    os.environ["XLA_FLAGS"] = _merged(flags, options)


def lean_jit(function: Callable) -> Callable:
    """`eqx.filter_jit` for large functions; within other transformations JAX takes no options, and it goes without."""
    plain = eqx.filter_jit(function)

    @functools.cache
    def lean():  # at the first call: an import must not create a backend
        return eqx.filter_jit(function, compiler_options=_known_options())  # pyright: ignore[reportCallIssue]

    @functools.wraps(function)
    def call(*args, **static):
        # Within a jit new arrays are traced, whatever the arguments are.
        return (plain if traced(args, jnp.zeros(())) else lean())(*args, **static)

    call.lower = lambda *args, **static: lean().lower(*args, **static)  # type: ignore[attr-defined]
    return call


@functools.cache
def _known_options() -> dict[str, str | bool]:
    """Those of our options that this XLA knows, asked once: each refusal costs a compilation."""
    return {option: value for option, value in _LEAN.items() if _is_known(option, value)}


def _is_known(option: str, value: str | bool) -> bool:
    try:
        jax.jit(lambda: 0).lower().compile(compiler_options={option: value})
    except jax.errors.JaxRuntimeError as error:
        if "No such compile option" not in str(error):
            raise
        return False
    return True


class _Compilations(threading.local):
    """A count for each thread: another thread may compile meanwhile."""

    count = 0


_compilations = _Compilations()


def compilations() -> int:
    """How many programs XLA has compiled in this thread so far."""
    return _compilations.count


def _listen(event: str, duration_secs: float, **kwargs: str | int) -> None:
    del duration_secs, kwargs
    _compilations.count += event == "/jax/core/compile/backend_compile_duration"


jax.monitoring.register_event_duration_secs_listener(_listen)


def compiles_to_one_kernel(compiled: jax.stages.Compiled) -> bool:
    """Whether the loops of `jax.jit(f).lower(…).compile()` are native CPU kernels, the outermost too."""
    text = compiled.as_text() or ""
    entry = text[text.rfind("\nENTRY ") :]
    return 'xla_cpu_small_call="true"' in text and " while(" not in entry


@functools.cache
def has_wide_vectors() -> bool:
    """Whether the CPU has vectors of eight numbers of 64 bits; where that is not known, it has not."""
    about = Path("/proc/cpuinfo")
    return about.is_file() and re.search(r"^flags\s*:.*\bavx512f\b", about.read_text(), re.MULTILINE) is not None


def _options() -> str:
    """All options; where a plugin for another device is installed, not LLVM's: they would reach that device's code."""
    return _KERNELS if importlib.util.find_spec("jax_plugins") else f"{_KERNELS},{_VECTORS}"


def _merged(flags: str, options: str) -> str:
    if _FLAG in flags:
        return re.sub(rf"""({_FLAG}["']?)""", rf"\g<1>{options},", flags, count=1)
    return f"{flags} {_FLAG}{options}".lstrip()


def _text(file: str) -> str:
    path = Path(file)
    return path.read_text() if path.is_file() else ""
