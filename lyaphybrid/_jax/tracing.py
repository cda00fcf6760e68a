"""Whether values are concrete, tracers or PRNG keys, and the arrays that they are handed on as."""

import functools
from types import ModuleType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax._src.core import trace_state_clean  # there is no public name for it
from jax.core import Tracer

from ..native import on_device

__all__ = [
    "array",
    "as_arrays",
    "as_jax",
    "enclosed",
    "is_typed_key",
    "module_of",
    "numpy_for",
    "traced",
    "transforming",
    "varying",
    "without_key_type",
]


def array(value: Any, dtype) -> Any:
    """An array of the type: NumPy's for concrete values, which a compiled function accepts with less overhead."""
    return numpy_for(value).asarray(value, dtype)


def as_arrays(tree, dtype):
    """The tree with Python floats replaced by arrays, because floats would be compiled in as constants."""
    return jax.tree.map(lambda leaf: array(leaf, dtype) if isinstance(leaf, float) else leaf, tree)


def module_of(value: Any) -> ModuleType:
    """`jax.numpy` for its arrays, NumPy for all else."""
    return jnp if isinstance(value, jax.Array) else np


def numpy_for(*values: Any) -> ModuleType:
    """`jax.numpy` where some of the values are tracers, else NumPy: each of JAX's functions would be compiled first."""
    return jnp if traced(*values) else np


def as_jax(tree: Any) -> Any:
    """The tree with NumPy's arrays and numbers as JAX arrays, which compiles nothing; all else stays as it is."""
    leaves, structure = jax.tree.flatten(tree)
    ours = [i for i, leaf in enumerate(leaves) if isinstance(leaf, np.ndarray | np.generic)]
    for i, placed in zip(ours, on_device([np.asarray(leaves[i]) for i in ours]), strict=True):
        leaves[i] = placed
    return jax.tree.unflatten(structure, leaves)


def is_typed_key(value: Any) -> bool:
    """Whether it is an array of PRNG keys, as `jax.random.key` makes them: NumPy has no such type."""
    return hasattr(value, "dtype") and jnp.issubdtype(value.dtype, jax.dtypes.prng_key)


def without_key_type(value: Any) -> np.ndarray:
    """The value as an array of NumPy: PRNG keys as their data."""
    return np.asarray(jax.random.key_data(value) if is_typed_key(value) else value)


def traced(*values: Any) -> bool:
    """Whether any leaf of the values is a tracer (under jit, vmap, grad)."""
    return any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(values))


def transforming() -> bool:
    """Whether a transformation (jit, vmap, grad) is under way: else nothing is traced, and new arrays are not."""
    return not trace_state_clean()


def varying(values: Any) -> set[str]:
    """The axes of a mesh over which leaves are said to vary, inside `jax.shard_map` with check_vma=True."""
    kinds = [jax.typeof(leaf) for leaf in jax.tree.leaves(values) if isinstance(leaf, Tracer)]
    # Types of JAX 0.8 have the axes as `vma`, later ones as `mat.varying`.
    return {axis for kind in kinds for axis in (kind.vma if hasattr(kind, "vma") else kind.mat.varying)}


def enclosed(values: Any) -> list:
    """All values that the functions among the leaves close over, directly or through other functions."""
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
            except ValueError:  # the variable is not assigned yet
                continue
        found += jax.tree.leaves(within)
        functions += jax.tree.leaves(within)
    return found
