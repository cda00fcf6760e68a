"""The compiler switch of this library: on a CPU, compile a whole `while` nest into one native, vectorised kernel.

By default XLA does so only for loops that touch about 1 kB an iteration; larger ones are dispatched operation
by operation, at 3 to 30 times the cost of hand-written C. And LLVM unrolls short loops altogether before it looks
for vectors, which it finds in loops alone: rows of four columns stay scalar code unless it unrolls only up to
three turns. Once it has found them it reads a row back from memory unless it was written or read at most six
instructions before; it is told to look further (Lorenz: a sixth of the time). `jit(compiler_options=…)` does not
take these options: they must stand in `XLA_FLAGS` before JAX creates its first backend.
"""

import importlib.util
import os
import re
import warnings
from pathlib import Path

import jax
from jax._src import xla_bridge

OPT_OUT = "LYAPHYBRID_KEEP_XLA_FLAGS"
_THRESHOLD = "xla_cpu_small_while_loop_byte_threshold"
_KERNELS = f"{_THRESHOLD}=16777216"  # bytes; no penalty was seen up to 1e9
_VECTORS = "-unroll-full-max-count=3,-available-load-scan-limit=1000"  # LLVM's own
_FLAG = "--xla_backend_extra_options="


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


def compiles_to_one_kernel(compiled: jax.stages.Compiled) -> bool:
    """Whether the loops of `jax.jit(f).lower(…).compile()` are native CPU kernels, the outermost too."""
    text = compiled.as_text() or ""
    entry = text[text.rfind("\nENTRY ") :]
    return 'xla_cpu_small_call="true"' in text and " while(" not in entry


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
