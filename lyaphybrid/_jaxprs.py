"""Parts of what a user's function is made of: some of the equations of its jaxpr, as a function."""

from collections.abc import Callable, Iterable

import jax
from jax.extend.core import ClosedJaxpr, Literal, jaxpr_as_fun

__all__ = ["divided", "needed", "part_of", "settled"]


def part_of(closed: ClosedJaxpr, equations, inputs, outputs) -> Callable[..., list]:
    """Some of the equations as a function."""
    part = closed.jaxpr.replace(eqns=equations, invars=inputs, outvars=outputs)
    return jaxpr_as_fun(ClosedJaxpr(part, closed.consts))


def divided(closed: ClosedJaxpr, known: Iterable) -> tuple[list, list, list]:
    """The equations that need constants and known inputs alone; the others; and what these take from the first."""
    known, early, late = {*closed.jaxpr.constvars, *known}, [], []
    for eqn in closed.jaxpr.eqns:
        if _variables(eqn.invars) <= known:
            early.append(eqn)
            known.update(eqn.outvars)
        else:
            late.append(eqn)
    used = _variables(closed.jaxpr.outvars).union(*(_variables(eqn.invars) for eqn in late))
    return early, late, [v for eqn in early for v in eqn.outvars if v in used]


def needed(closed: ClosedJaxpr) -> set:
    """The variables that its outputs need."""
    found = _variables(closed.jaxpr.outvars)
    for eqn in reversed(closed.jaxpr.eqns):
        if found.intersection(eqn.outvars):
            found |= _variables(eqn.invars)
    return found


def _variables(atoms) -> set:
    return {v for v in atoms if not isinstance(v, Literal)}


def settled(function: Callable, *example) -> Callable:
    """The function, with all that its parameters alone decide computed here and now.

    XLA would take each use of such a number out of a loop by itself, and carry as many copies through the loop.
    """
    closed, shape = jax.make_jaxpr(function, return_shape=True)(*example)
    early, late, kept = divided(closed, ())
    if not kept:
        return function
    numbers, structure = part_of(closed, early, [], kept)(), jax.tree.structure(shape)
    rest = part_of(closed, late, [*kept, *closed.jaxpr.invars], closed.jaxpr.outvars)
    return lambda *inputs: jax.tree.unflatten(structure, rest(*numbers, *jax.tree.leaves(inputs)))
