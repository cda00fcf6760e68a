"""Primitives without a rule of their own, by what they do outside of a compiled program.

Primitives of other libraries, and those of JAX that XLA itself does not know, are implemented by a function of arrays,
`primitive.impl`. Traced, that function is a program of simpler primitives.
"""

from collections.abc import Callable, Sequence
from functools import partial

import jax

from .jax_versions import ClosedJaxpr, Jaxpr, subprograms
from .unsupported import UnsupportedError


def traced(function: Callable, avals: Sequence) -> ClosedJaxpr:
    """The program of a function of arrays like these."""
    return jax.make_jaxpr(function)(*(jax.ShapeDtypeStruct(aval.shape, aval.dtype) for aval in avals))


def implementation(eqn) -> ClosedJaxpr:
    """The program that an equation stands for; `UnsupportedError` if its primitive is not made of others."""
    name = eqn.primitive.name
    try:
        found = traced(partial(eqn.primitive.impl, **eqn.params), [atom.aval for atom in eqn.invars])
    except Exception as error:  # whatever a function that is not meant for tracing does
        raise UnsupportedError(f"the primitive {name}") from error
    if _contains(found.jaxpr, name):  # JAX's own are compiled by XLA as they are
        raise UnsupportedError(f"the primitive {name}")
    return found


def _contains(jaxpr: Jaxpr, name: str) -> bool:
    return any(eqn.primitive.name == name or any(_contains(p, name) for p in subprograms(eqn)) for eqn in jaxpr.eqns)
