"""What the native compiler computes, compared with XLA."""

import jax
import numpy as np

from lyaphybrid import native
from lyaphybrid.native.lowering.costs import Options

PLANS = {"buffers": Options(1, 2), "mixed": Options(16, 1), "entries": Options(64, 0)}
TOLERANCE = {np.dtype(np.float64): 1e-12, np.dtype(np.float32): 2e-5}


def difference(expected, got) -> str | None:
    """How two arrays differ: integers in any digit, floating-point numbers beyond rounding."""
    expected, got = np.asarray(expected), np.asarray(got)
    if expected.dtype != got.dtype or expected.shape != got.shape:
        return f"{got.dtype}{got.shape} instead of {expected.dtype}{expected.shape}"
    if expected.dtype.kind != "f":
        wrong = expected != got
    else:
        tolerance = TOLERANCE[expected.dtype]
        scale = np.max(np.abs(expected), initial=0, where=np.isfinite(expected))
        wrong = ~np.isclose(got, expected, tolerance, min(float(scale), 1) * tolerance, equal_nan=True)
    if not wrong.any():
        return None
    return f"at {np.argwhere(wrong)[:4].tolist()}: {got[wrong][:4]} instead of {expected[wrong][:4]}"


def differences(function, *operands, expected=None, **options) -> dict[str, str]:
    """Where the results of the compiled function differ from XLA's: {path: how}."""
    operands = jax.tree.map(np.asarray, operands)
    expected = jax.jit(function)(*operands) if expected is None else expected
    got = native.compile(function, *operands, **options)(*operands)
    found = {}
    for (path, x), y in zip(jax.tree_util.tree_leaves_with_path(expected), jax.tree.leaves(got), strict=True):
        if (how := difference(x, y)) is not None:
            found[jax.tree_util.keystr(path)] = how
    return found
