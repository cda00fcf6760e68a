"""Uses of a program's values: the last use of each, which large arrays can stay lazy, and which are the same.

A large array that is computed entry by entry need not be stored if all its uses are in one loop, the loop that computes
the only array (or sum, or store) that depends on it. That loop is its *root*. An array with several roots would be
computed in each of them, so it is stored.

A field and its derivative both need sin x, and JAX writes it twice. For small arrays the emitter leaves out the second
one, for arrays that are computed in loops it is found here.
"""

from collections.abc import Container
from typing import Any, NamedTuple

import numpy as np

from .jax_versions import Jaxpr, Literal, called, literal_value, parts

COSTLY = frozenset(
    "acos acosh asin asinh atan atan2 atanh cbrt cos cosh erf erfc exp exp2 expm1 lgamma log log1p logistic pow sin "
    "sinh tan tanh".split()
)  # primitives that take much longer than to read the result from memory

WITH_RARE_CASES = frozenset(("sin", "cos"))  # of which a loop over memory stores the results, and does nothing else


class Uses(NamedTuple):
    """The uses of variables; equations whose results are not used do not count."""

    last: dict[Any, int]  # variable: index of the equation with its last use; for results, the number of equations
    apart: set[Any]  # variables with several roots, or of a primitive `WITH_RARE_CASES`
    roots: list[frozenset]  # the roots of each operand; result i of the program is the root ("result", i)
    twins: dict[Any, Any]  # variable: an earlier one with the same value, which stands for it


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
    twins = _twins(jaxpr, entrywise)

    def note(atom, place, found) -> None:
        if not isinstance(atom, Literal):
            atom = twins.get(atom, atom)
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
    apart |= {eqn.outvars[0] for eqn in jaxpr.eqns if eqn.primitive.name in WITH_RARE_CASES} & last.keys()
    return Uses(last, apart, [roots.get(variable, frozenset()) for variable in jaxpr.invars], twins)


def _twins(jaxpr: Jaxpr, entrywise) -> dict[Any, Any]:
    """The results of `COSTLY` primitives that an earlier equation has already, by the variable of the earlier one.

    Of all other primitives nothing is left out: what is multiplied again where it is used rounds once with an addition.
    """
    if sum(eqn.primitive.name in COSTLY for eqn in jaxpr.eqns) < 2:
        return {}
    first: dict[Any, Any] = {}  # what an equation computes: the first variable that holds it
    same: dict[Any, Any] = {}  # variable: the first one of the same value
    for eqn in jaxpr.eqns:
        if eqn.primitive.name in entrywise and not eqn.effects:
            operands = tuple(_literal(x) if isinstance(x, Literal) else same.get(x, x) for x in eqn.invars)
            try:
                computed = eqn.primitive.name, operands, tuple(sorted(eqn.params.items()))
                same[eqn.outvars[0]] = first.setdefault(computed, eqn.outvars[0])
            except TypeError:  # parameters without hash or order
                continue
    costly = {eqn.outvars[0] for eqn in jaxpr.eqns if eqn.primitive.name in COSTLY}
    return {variable: earlier for variable, earlier in same.items() if earlier is not variable and variable in costly}


def _literal(literal) -> tuple:
    number = np.asarray(literal_value(literal))
    return str(literal.aval), number.tobytes()


def _outside(found: frozenset, eqn, root) -> frozenset:
    """The roots of an operand of a call, in terms of the calling program."""
    each = [root(eqn.outvars[x[1]]) if x[:1] == ("result",) else {(id(eqn), x)} for x in map(_named, found)]
    return frozenset().union(*each)


def _named(found) -> tuple:
    return found if isinstance(found, tuple) else (found,)


def _shape(atom) -> tuple[int, ...]:
    return atom.aval.shape
