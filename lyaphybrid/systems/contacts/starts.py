"""Whether a start lies in the mode that was given for it: beside the surfaces of a Filippov system, or on one."""

from typing import Any

import jax
import numpy as np

from ..._arguments import require
from ..._jax.engines import compiled
from ..._jax.tracing import traced
from ..hybrid import Hybrid
from .surfaces import InitialMode

__all__ = ["check_initial_mode"]


def check_initial_mode(system: Any, x, t0, args: Any, mode: Any) -> None:
    """Check that a start x (n,) lies where its mode holds, beside a surface or on it; not for traced values.

    Raises:
        ValueError: if it lies beyond the surface, or off the one on which it is to slide.
    """
    if not isinstance(system, Hybrid) or not isinstance(system.initial_mode, InitialMode) or mode is None:
        return
    if traced((x, t0, args, mode)):
        return
    with jax.ensure_compile_time_eval():
        off = _outside(system.initial_mode, t0, x, args)
    if traced(off):
        return
    off, names = np.asarray(off), system.mode_names
    belongs = [name for name, distance in zip(names, off, strict=True) if distance == 0]
    require(
        not off[mode],
        f"x0 lies outside mode {names[mode]!r}: the function of its surface misses "
        f"{'zero' if mode >= system.initial_mode.regions else 'its sign'} by {off[mode]:.3g}. Leave mode out, and the "
        f"start determines it; it belongs to {belongs}.",
    )


@compiled(hands_on=True)
def _outside(initial_mode: InitialMode, t, x, args):
    return initial_mode.outside(t, x, args)
