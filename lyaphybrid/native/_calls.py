"""Rules for calls of other programs: their equations are lowered in place."""

import numpy as np

from ._jax_versions import called
from ._lowering import KEEPS_ROWS, rule

_CALLS = (
    "jit", "pjit", "closed_call", "core_call", "remat", "remat2", "checkpoint", "custom_jvp_call", "custom_vjp_call",
    "custom_vjp_call_jaxpr", "custom_lin", "run_state",
)  # fmt: skip
KEEPS_ROWS |= set(_CALLS)


@rule(*_CALLS)
def call(b, eqn, *values):
    return b.run(called(eqn), values)


@rule("platform_index")
def platform_index(b, eqn):
    platforms = eqn.params["platforms"]
    return b.constant_value(np.int32(next(i for i, p in enumerate(platforms) if p is None or "cpu" in p)))
