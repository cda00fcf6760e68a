"""Primitives without a rule of their own, expanded into simpler primitives by tracing their implementation.

Primitives of other libraries, and those of JAX that XLA itself does not know, are implemented by a function of arrays,
`primitive.impl`. The jaxpr of that function consists of simpler primitives.
"""

from collections.abc import Callable, Sequence
from functools import partial

import jax

from .jax_versions import ClosedJaxpr, Jaxpr, made_of, subprograms
from .unsupported import UnsupportedError


def traced(function: Callable, avals: Sequence) -> ClosedJaxpr:
    """The closed jaxpr of a function of arrays with these shapes and types."""
    return jax.make_jaxpr(function)(*(jax.ShapeDtypeStruct(aval.shape, aval.dtype) for aval in avals))


def implementation(eqn) -> ClosedJaxpr:
    """The closed jaxpr of an equation's implementation; `UnsupportedError` if it is not made of other primitives."""
    name = eqn.primitive.name
    try:
        found = traced(partial(made_of(eqn.primitive), **eqn.params), [atom.aval for atom in eqn.invars])
    except Exception as error:  # an implementation that is not meant for tracing may raise anything
        raise UnsupportedError(f"the primitive {name}") from error
    if _contains(found.jaxpr, name):  # the implementation of JAX's own primitives is the primitive itself, by XLA
        raise UnsupportedError(f"the primitive {name}")
    return found


def _contains(jaxpr: Jaxpr, name: str) -> bool:
    return any(eqn.primitive.name == name or any(_contains(p, name) for p in subprograms(eqn)) for eqn in jaxpr.eqns)
