"""The lowering rules of JAX's primitives, by kind; importing this package registers all of them."""

from . import (
    branches,
    calls,
    control,
    entrywise,
    gram_schmidt,
    indexing,
    linear_algebra,
    moving,
    random_bits,
    reductions,
    sorting,
)

__all__ = [
    "branches",
    "calls",
    "control",
    "entrywise",
    "gram_schmidt",
    "indexing",
    "linear_algebra",
    "moving",
    "random_bits",
    "reductions",
    "sorting",
]
