"""Uses of a program's values: the last use of each, and which large arrays can stay lazy.

A large array that is computed entry by entry need not be stored if all its uses are in one loop, the loop that computes
the only array (or sum, or store) that depends on it. That loop is its *root*. An array with several roots would be
computed in each of them, so it is stored.
"""

from collections.abc import Container
from typing import Any, NamedTuple

from .jax_versions import Jaxpr, Literal, called, parts


class Uses(NamedTuple):
    """The uses of variables; equations whose results are not used do not count."""

    last: dict[Any, int]  # variable: index of the equation with its last use; for results, the number of equations
    apart: set[Any]  # variables with several roots
    roots: list[frozenset]  # the roots of each operand; result i of the program is the root ("result", i)


def uses_of(jaxpr: Jaxpr, entrywise: Container[str], calls: Container[str], known: dict[Jaxpr, Uses]) -> Uses:
    """The uses of the variables of a program, given the names of entrywise primitives and of calls.

    `known`: a cache for this program and those that it calls.
    """
    if jaxpr not in known:
        known[jaxpr] = _uses_of(jaxpr, entrywise, calls, known)
    return known[jaxpr]


def _uses_of(jaxpr: Jaxpr, entrywise, calls, known) -> Uses:
    roots: dict[Any, frozenset] = {}
    last: dict[Any, int] = {}

    def note(atom, place, found) -> None:
        if not isinstance(atom, Literal):
            last.setdefault(atom, place)
            roots[atom] = roots.get(atom, frozenset()) | found

    def root(variable) -> frozenset:
        """The loop in which a variable is computed: that of its only root, or its own, {variable}."""
        found = roots.get(variable, frozenset())
        return found if len(found) == 1 else frozenset([variable])

    for i, atom in enumerate(jaxpr.outvars):
        note(atom, len(jaxpr.eqns), frozenset([("result", i)]))
    for place in reversed(range(len(jaxpr.eqns))):
        eqn = jaxpr.eqns[place]
        if not eqn.effects and not any(variable in last for variable in eqn.outvars):
            continue
        name = eqn.primitive.name
        if name in calls:
            within = uses_of(parts(called(eqn))[0], entrywise, calls, known).roots
            for atom, found in zip(eqn.invars, within, strict=True):
                note(atom, place, _outside(found, eqn, root))
            continue
        for atom in eqn.invars:
            together = name in entrywise and _shape(atom) == _shape(eqn.outvars[0])
            note(atom, place, root(eqn.outvars[0]) if together else frozenset([(place, name)]))
    apart = {variable for variable, found in roots.items() if len(found) > 1}
    return Uses(last, apart, [roots.get(variable, frozenset()) for variable in jaxpr.invars])


def _outside(found: frozenset, eqn, root) -> frozenset:
    """The roots of an operand of a call, in terms of the calling program."""
    each = [root(eqn.outvars[x[1]]) if x[:1] == ("result",) else {(id(eqn), x)} for x in map(_named, found)]
    return frozenset().union(*each)


def _named(found) -> tuple:
    return found if isinstance(found, tuple) else (found,)


def _shape(atom) -> tuple[int, ...]:
    return atom.aval.shape
