"""Parts of what a user's function is made of: some of the equations of its jaxpr, as a function."""

from collections.abc import Callable, Iterable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal, jaxpr_as_fun

from .tracing import traced

__all__ = [
    "MOVING",
    "applied",
    "by_component",
    "constant",
    "constants",
    "divided",
    "evaluated",
    "explicit",
    "is_affine",
    "is_call",
    "is_timeless",
    "jacobian",
    "needed",
    "part_of",
    "settled",
    "written_out",
]


# Primitives that only move entries about: they do with what belongs to each entry what they do with the entries.
MOVING = {
    "broadcast_in_dim", "concatenate", "convert_element_type", "dynamic_slice", "dynamic_update_slice", "expand_dims",
    "gather", "pad", "reshape", "rev", "scatter", "select_n", "slice", "split", "squeeze", "stack", "tile", "transpose",
    "unstack",
}  # fmt: skip


def part_of(closed: ClosedJaxpr, equations, inputs, outputs) -> Callable[..., list]:
    """Some of the equations as a function."""
    part = closed.jaxpr.replace(eqns=equations, invars=inputs, outvars=outputs)
    return jaxpr_as_fun(ClosedJaxpr(part, closed.consts))


def evaluated(closed: ClosedJaxpr, inputs: list, rule: Callable[..., list]) -> list:
    """The outputs, where each equation is done by rule(closed, equation, operands) -> results."""
    jaxpr = closed.jaxpr
    known = dict(zip([*jaxpr.constvars, *jaxpr.invars], [*closed.consts, *inputs], strict=True))

    def read(atom):
        if isinstance(atom, Literal):
            kind: Any = atom.aval
            return jnp.asarray(atom.val, kind.dtype)
        return known[atom]

    for eqn in jaxpr.eqns:
        known.update(zip(eqn.outvars, rule(closed, eqn, [read(atom) for atom in eqn.invars]), strict=True))
    return [read(atom) for atom in jaxpr.outvars]


def applied(closed: ClosedJaxpr, eqn, operands) -> list:
    """The equation with these operands; what is written into it as a number stays."""
    known = {atom: one for atom, one in zip(eqn.invars, operands, strict=True) if not isinstance(atom, Literal)}
    return part_of(closed, [eqn], list(known), eqn.outvars)(*known.values())


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


def is_call(eqn) -> bool:
    """Whether an equation stands for a program, which it holds."""
    return eqn.primitive.name in ("jit", "pjit")


def needed(closed: ClosedJaxpr, outputs: Iterable | None = None) -> set:
    """The variables that its outputs need, or those of them that are named."""
    found = _variables(closed.jaxpr.outvars if outputs is None else outputs)
    for eqn in reversed(closed.jaxpr.eqns):
        if found.intersection(eqn.outvars):
            found |= _variables(_read(eqn, found))
    return found


def _read(eqn, wanted: set) -> list:
    """The operands that an equation needs for results that are wanted: a call takes all it is given, and x⁰ is 1."""
    if eqn.primitive.name == "integer_pow" and eqn.params["y"] == 0:  # in derivatives of x, by JAX 0.8
        return []
    if not is_call(eqn):
        return eqn.invars
    inner = eqn.params["jaxpr"]
    results = [own for outer, own in zip(eqn.outvars, inner.jaxpr.outvars, strict=True) if outer in wanted]
    within = needed(inner, results)
    return [outer for outer, own in zip(eqn.invars, inner.jaxpr.invars, strict=True) if own in within]


def written_out(function: Callable, *example) -> ClosedJaxpr:
    """The jaxpr of a function, with the equations of the programs that it calls in place of the calls."""
    closed = jax.make_jaxpr(function)(*example)

    def in_place(closed, eqn, operands):
        inner = eqn.params["jaxpr"] if is_call(eqn) else None
        return applied(closed, eqn, operands) if inner is None else evaluated(inner, operands, in_place)

    if not any(map(is_call, closed.jaxpr.eqns)):
        return closed
    return jax.make_jaxpr(lambda *inputs: evaluated(closed, list(inputs), in_place))(*closed.in_avals)


def constants(closed: ClosedJaxpr) -> list:
    """The arrays that are part of a function, and of those that it calls."""
    found = list(closed.consts)
    for eqn in closed.jaxpr.eqns:
        for value in eqn.params.values():
            for one in value if isinstance(value, tuple | list) else (value,):
                inner = ClosedJaxpr(one, ()) if isinstance(one, Jaxpr) else one
                found += constants(inner) if isinstance(inner, ClosedJaxpr) else []
    return found


def is_affine(function: Callable, x) -> bool:
    """Whether the derivative of a function of x is seen not to depend on x."""

    def along(x, dx):
        return jax.jvp(function, (x,), (dx,))[1]

    closed = jax.make_jaxpr(along)(x, x)
    return closed.jaxpr.invars[0] not in needed(closed)


def is_timeless(function: Callable, t, x) -> bool:
    """Whether a function of (t, x) is seen not to depend on t; where that is not seen, it is taken to."""
    closed = jax.make_jaxpr(function)(t, x)
    return closed.jaxpr.invars[0] not in needed(closed)


def _variables(atoms) -> set:
    return {v for v in atoms if not isinstance(v, Literal)}


def by_component(function: Callable, t, x) -> Callable[[list], Any]:
    """A function of (t, x) at t, as one of the list of the components of x.

    Where the function itself reads x one component at a time, the list goes in as it is: a component that is held
    fixed then has no derivative at all, instead of one that is zero, which XLA goes on multiplying with.
    """
    closed = written_out(function, t, x)
    time, point = closed.jaxpr.invars
    reads = [eqn for eqn in closed.jaxpr.eqns if point in eqn.invars]
    rest = [eqn for eqn in closed.jaxpr.eqns if point not in eqn.invars]
    one_by_one = all(eqn.primitive.name == "slice" and eqn.outvars[0].aval.shape == (1,) for eqn in reads)
    if not one_by_one or point in closed.jaxpr.outvars:
        return lambda components: function(t, jnp.stack(components))
    of_reads = part_of(closed, rest, [time, *(eqn.outvars[0] for eqn in reads)], closed.jaxpr.outvars)
    which = [eqn.params["start_indices"][0] for eqn in reads]
    return lambda components: of_reads(t, *(components[i][None] for i in which))[0]


def jacobian(function: Callable, x):
    """Df (m, n) at x (n,), component by component: what does not depend on one costs nothing in its column."""
    of_components = by_component(lambda _, x: function(x), jnp.zeros((), x.dtype), x)

    def column(i: int):
        def of_one(component):
            return of_components([*x[:i], component, *x[i + 1 :]])

        return jax.jvp(of_one, (x[i],), (jnp.ones_like(x[i]),))[1]

    return jnp.stack([column(i) for i in range(x.size)], axis=1)


def constant(function: Callable, *example) -> Any:
    """The value of the function: NumPy's where it is the same for all inputs, and so is known here and now."""
    closed = jax.make_jaxpr(function)(*example)
    if not needed(closed).isdisjoint(closed.jaxpr.invars) or traced(closed.consts):
        return function(*example)
    with jax.ensure_compile_time_eval():
        return np.asarray(function(*(np.zeros(one.aval.shape, one.aval.dtype) for one in closed.jaxpr.invars)))


def settled(function: Callable, *example) -> Callable:
    """The function, with all that its parameters alone decide computed here and now; traced once.

    XLA would take each use of such a number out of a loop by itself, and carry as many copies through the loop.
    """
    closed, shape = jax.make_jaxpr(function, return_shape=True)(*example)
    early, late, kept = divided(closed, ())
    if not kept:
        return jax.jit(function)
    numbers, structure = part_of(closed, early, [], kept)(), jax.tree.structure(shape)
    rest = jax.jit(part_of(closed, late, [*kept, *closed.jaxpr.invars], closed.jaxpr.outvars))  # traced once
    return lambda *inputs: jax.tree.unflatten(structure, rest(*numbers, *jax.tree.leaves(inputs)))


def explicit(function: Callable, *example) -> tuple[Callable, list]:
    """The function as one of what it closes over, too, and that: JAX differentiates a rule of our own by operands only.

    Args:
        function: of arrays; it may close over values that are not known yet, directly or in other functions.
        example: arrays of the shapes of its inputs.

    Returns:
        (numbers, *inputs) ↦ the same, and the numbers.
    """
    closed, shape = jax.make_jaxpr(function, return_shape=True)(*example)
    where = [i for i, one in enumerate(closed.consts) if traced(one)]

    def of_all(numbers, *inputs):
        consts = list(closed.consts)
        for i, number in zip(where, numbers, strict=True):
            consts[i] = number
        found = jaxpr_as_fun(ClosedJaxpr(closed.jaxpr, consts))(*jax.tree.leaves(inputs))
        return jax.tree.unflatten(jax.tree.structure(shape), found)

    return of_all, [closed.consts[i] for i in where]
