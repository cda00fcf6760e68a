"""Whether values are known now, or only while a compiled function runs."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

__all__ = ["array", "traced"]


def array(value: Any, dtype) -> Any:
    """An array of that type: NumPy's where the value is known now, for a compiled function takes it in at less cost."""
    return (jnp if traced(value) else np).asarray(value, dtype)


def traced(*values: Any) -> bool:
    """Whether any leaf of the values is a tracer (under jit, vmap, grad)."""
    return any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(values))
