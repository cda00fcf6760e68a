"""Whether values are known now, or only while a compiled function runs."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

__all__ = ["array", "enclosed", "traced"]


def array(value: Any, dtype) -> Any:
    """An array of that type: NumPy's where the value is known now, for a compiled function takes it in at less cost."""
    return (jnp if traced(value) else np).asarray(value, dtype)


def traced(*values: Any) -> bool:
    """Whether any leaf of the values is a tracer (under jit, vmap, grad)."""
    return any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(values))


def enclosed(values: Any) -> list:
    """What the functions among the leaves close over, and the functions among that, and so on."""
    found, functions, seen = [], jax.tree.leaves(values), set()
    while functions:
        one = functions.pop()
        if id(one) in seen:
            continue
        seen.add(id(one))
        within = [getattr(one, "__wrapped__", None), getattr(one, "__self__", None)]
        if isinstance(one, functools.partial):
            within += [one.func, one.args, one.keywords]
        for cell in getattr(one, "__closure__", None) or ():
            try:
                within.append(cell.cell_contents)
            except ValueError:  # not yet bound
                continue
        found += jax.tree.leaves(within)
        functions += jax.tree.leaves(within)
    return found
