"""The one compiler switch of this library: on a CPU, compile a whole `while` nest into one native kernel.

By default XLA does so only for loops that touch about 1 kB an iteration; larger ones are dispatched operation
by operation, at 3 to 30 times the cost of hand-written C. `jit(compiler_options=…)` does not take the
threshold: it must stand in `XLA_FLAGS` before JAX creates its first backend.
"""

import os
import re
import warnings
from pathlib import Path

import jax
from jax._src import xla_bridge

OPT_OUT = "LYAPHYBRID_KEEP_XLA_FLAGS"
_THRESHOLD = "xla_cpu_small_while_loop_byte_threshold"
_OPTION = f"{_THRESHOLD}=16777216"  # bytes; no penalty was seen up to 1e9
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
    too_late = xla_bridge.backends_are_initialized()
    if too_late and jax.default_backend() != "cpu":
        return
    if too_late or in_file:
        remedy = (
            f"add {_FLAG}{_OPTION} to the file that XLA_FLAGS names"
            if in_file
            else "import lyaphybrid before the first JAX computation, or set "
            f'XLA_FLAGS="{_FLAG}{_OPTION}" before Python starts'
        )
        warnings.warn(
            f"loops will not compile to single CPU kernels and may run several times slower: {remedy}. "
            f"{OPT_OUT}=1 silences this.",
            stacklevel=3,  # the line that imports lyaphybrid
        )
        return
    os.environ["XLA_FLAGS"] = _with_option(flags)


def compiles_to_one_kernel(compiled: jax.stages.Compiled) -> bool:
    """Whether the loops of `jax.jit(f).lower(…).compile()` are native CPU kernels, the outermost too."""
    text = compiled.as_text() or ""
    entry = text[text.rfind("\nENTRY ") :]
    return 'xla_cpu_small_call="true"' in text and " while(" not in entry


def _with_option(flags: str) -> str:
    if _FLAG in flags:
        return re.sub(rf"""({_FLAG}["']?)""", rf"\g<1>{_OPTION},", flags, count=1)
    return f"{flags} {_FLAG}{_OPTION}".lstrip()


def _text(file: str) -> str:
    path = Path(file)
    return path.read_text() if path.is_file() else ""
