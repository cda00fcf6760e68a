"""How each primitive of JAX is lowered, by kind: importing this package registers all rules."""

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
