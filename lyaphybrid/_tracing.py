"""Whether values are known now, or only while a compiled function runs."""

from typing import Any

import jax
from jax.core import Tracer

__all__ = ["traced"]


def traced(*values: Any) -> bool:
    """Whether any leaf of the values is a tracer (under jit, vmap, grad)."""
    return any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(values))
