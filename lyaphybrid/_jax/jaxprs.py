"""Analysis and splitting of jaxprs: some of the equations of a user's function as a function of their own."""

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal, jaxpr_as_fun

from ..native.lowering.jax_versions import scan_of
from .tracing import traced

__all__ = [
    "MOVING",
    "applied",
    "by_component",
    "constant",
    "depending",
    "divided",
    "evaluated",
    "explicit",
    "inside",
    "is_affine",
    "is_call",
    "is_timeless",
    "jacobian",
    "needed",
    "part_of",
    "partially_evaluated",
    "results_of",
    "written_out",
]


# Primitives that only move entries: they can be applied unchanged to values that belong to each entry.
MOVING = {
    "broadcast_in_dim", "concatenate", "convert_element_type", "dynamic_slice", "dynamic_update_slice", "expand_dims",
    "gather", "pad", "reshape", "rev", "scatter", "select_n", "slice", "split", "squeeze", "stack", "tile", "transpose",
    "unstack",
}  # fmt: skip


def part_of(closed: ClosedJaxpr, equations, inputs, outputs) -> Callable[..., list]:
    """Some of the equations as a function inputs -> outputs."""
    part = closed.jaxpr.replace(eqns=equations, invars=inputs, outvars=outputs)
    return jaxpr_as_fun(ClosedJaxpr(part, closed.consts))


def evaluated(closed: ClosedJaxpr, inputs: list, rule: Callable[..., list]) -> list:
    """Evaluate a jaxpr with rule(closed, equation, operands) -> results in place of each equation."""
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
    """Evaluate one equation with these operands; literals in it stay as they are."""
    known = {atom: one for atom, one in zip(eqn.invars, operands, strict=True) if not isinstance(atom, Literal)}
    return part_of(closed, [eqn], list(known), eqn.outvars)(*known.values())


def divided(closed: ClosedJaxpr, known: Iterable) -> tuple[list, list, list]:
    """Equations that depend only on constants and known inputs, the others, and the variables passed between them."""
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
    """Whether an equation is a call of a jitted function."""
    return eqn.primitive.name in ("jit", "pjit")


def needed(closed: ClosedJaxpr, outputs: Iterable | None = None) -> set:
    """The variables on which the outputs, or the given ones of them, depend."""
    found = _variables(closed.jaxpr.outvars if outputs is None else outputs)
    for eqn in reversed(closed.jaxpr.eqns):
        if found.intersection(eqn.outvars):
            found |= _variables(_read(eqn, found))
    return found


def _read(eqn, wanted: set) -> list:
    """The operands on which the wanted results depend; looks inside calls, and x⁰ = 1 depends on nothing."""
    if eqn.primitive.name == "integer_pow" and eqn.params["y"] == 0:  # in derivatives of x, by JAX 0.8
        return []
    if not is_call(eqn):
        return eqn.invars
    inner = eqn.params["jaxpr"]
    results = [own for outer, own in zip(eqn.outvars, inner.jaxpr.outvars, strict=True) if outer in wanted]
    within = needed(inner, results)
    return [outer for outer, own in zip(eqn.invars, inner.jaxpr.invars, strict=True) if own in within]


def depending(closed: ClosedJaxpr, inputs: Sequence[bool]) -> tuple[bool, ...]:
    """Which outputs depend on the inputs that are marked; looks inside calls, branches and loops."""
    found = {variable for variable, marked in zip(closed.jaxpr.invars, inputs, strict=True) if marked}
    for eqn in closed.jaxpr.eqns:
        marked = [not isinstance(atom, Literal) and atom in found for atom in eqn.invars]
        found.update(variable for variable, one in zip(eqn.outvars, results_of(eqn, marked), strict=True) if one)
    return tuple(not isinstance(atom, Literal) and atom in found for atom in closed.jaxpr.outvars)


def results_of(eqn, marked: list[bool]) -> Sequence[bool]:
    """Which results of an equation depend on the operands that are marked."""
    params, everything = eqn.params, [any(marked)] * len(eqn.outvars)
    if not any(marked):
        return everything
    if is_call(eqn):
        return depending(params["jaxpr"], marked)
    if eqn.primitive.name == "cond" and not marked[0]:
        return [any(each) for each in zip(*(depending(one, marked[1:]) for one in params["branches"]), strict=True)]
    if eqn.primitive.name == "scan":
        scan = scan_of(eqn)
        consts, carry, each = np.split(np.array(marked), [scan.consts, scan.consts + scan.carry])
        return _of_loop(scan.body, consts.tolist(), carry.tolist(), each.tolist())
    if eqn.primitive.name == "while":
        first, fixed = params["cond_nconsts"], params["body_nconsts"]
        carried = _of_loop(params["body_jaxpr"], marked[first : first + fixed], marked[first + fixed :], ())
        (ends,) = depending(params["cond_jaxpr"], [*marked[:first], *carried])
        return everything if ends else carried
    return everything


def _of_loop(body: ClosedJaxpr, fixed: Sequence[bool], carried: Sequence[bool], each: Sequence[bool]) -> list[bool]:
    """Which results of a loop depend on what is marked: what is carried may come to do so after some turns."""
    while True:
        found = depending(body, [*fixed, *carried, *each])
        after = [before or now for before, now in zip(carried, found[: len(carried)], strict=True)]
        if after == list(carried):
            return [*after, *found[len(carried) :]]
        carried = after


def written_out(function: Callable, *example) -> ClosedJaxpr:
    """The jaxpr of a function with all calls of jitted functions inlined."""
    closed = jax.make_jaxpr(function)(*example)

    def in_place(closed, eqn, operands):
        inner = eqn.params["jaxpr"] if is_call(eqn) else None
        return applied(closed, eqn, operands) if inner is None else evaluated(inner, operands, in_place)

    if not any(map(is_call, closed.jaxpr.eqns)):
        return closed
    return jax.make_jaxpr(lambda *inputs: evaluated(closed, list(inputs), in_place))(*closed.in_avals)


def inside(eqn) -> list[ClosedJaxpr]:
    """The jaxprs among the parameters of an equation: of a call, of branches, of the body of a loop."""
    values = [one for value in eqn.params.values() for one in (value if isinstance(value, tuple | list) else (value,))]
    closed = [_closed(one) if isinstance(one, Jaxpr) else one for one in values]
    return [one for one in closed if isinstance(one, ClosedJaxpr)]


def _closed(jaxpr: Jaxpr) -> ClosedJaxpr:
    """A jaxpr whose constants the equation around it knows: here they are inputs, the first ones."""
    return ClosedJaxpr(jaxpr.replace(constvars=[], invars=[*jaxpr.constvars, *jaxpr.invars]), ())


def is_affine(function: Callable, x) -> bool:
    """Whether the derivative of a function of x provably does not depend on x, from its jaxpr."""

    def along(x, dx):
        return jax.jvp(function, (x,), (dx,))[1]

    closed = jax.make_jaxpr(along)(x, x)
    return closed.jaxpr.invars[0] not in needed(closed)


def is_timeless(function: Callable, t, x) -> bool:
    """Whether a function of (t, x) provably does not depend on t, from its jaxpr."""
    closed = jax.make_jaxpr(function)(t, x)
    return closed.jaxpr.invars[0] not in needed(closed)


def _variables(atoms) -> set:
    return {v for v in atoms if not isinstance(v, Literal)}


def by_component(function: Callable, t, x) -> Callable[[list], Any]:
    """A function of (t, x) at fixed t as a function of the list of components of x.

    If the function reads x one component at a time, the list is used directly: a component that is held fixed then has
    no derivative at all, instead of a zero derivative with which XLA would multiply.
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
    """Df (m, n) at x (n,), column by column; parts that do not depend on a component cost nothing in its column."""
    of_components = by_component(lambda _, x: function(x), jnp.zeros((), x.dtype), x)

    def column(i: int):
        def of_one(component):
            return of_components([*x[:i], component, *x[i + 1 :]])

        return jax.jvp(of_one, (x[i],), (jnp.ones_like(x[i]),))[1]

    return jnp.stack([column(i) for i in range(x.size)], axis=1)


def constant(function: Callable, *example) -> Any:
    """The value of the function; a NumPy array, computed now, if it does not depend on the inputs."""
    closed = jax.make_jaxpr(function)(*example)
    if not needed(closed).isdisjoint(closed.jaxpr.invars) or traced(closed.consts):
        return function(*example)
    with jax.ensure_compile_time_eval():
        return np.asarray(function(*(np.zeros(one.aval.shape, one.aval.dtype) for one in closed.jaxpr.invars)))


def partially_evaluated(function: Callable, *example) -> Callable:
    """The function, traced once, with all subexpressions that depend only on its parameters computed now.

    Otherwise XLA hoists each use of such a value out of a loop separately and carries a copy per use through the loop.
    """
    closed, shape = jax.make_jaxpr(function, return_shape=True)(*example)
    early, late, kept = divided(closed, ())
    if not kept:
        return jax.jit(function)
    numbers, structure = part_of(closed, early, [], kept)(), jax.tree.structure(shape)
    rest = jax.jit(part_of(closed, late, [*kept, *closed.jaxpr.invars], closed.jaxpr.outvars))  # traced once
    return lambda *inputs: jax.tree.unflatten(structure, rest(*numbers, *jax.tree.leaves(inputs)))


def explicit(function: Callable, *example) -> tuple[Callable, list]:
    """The function with the tracers that it closes over as an explicit argument, and these tracers.

    A custom derivative rule in JAX differentiates with respect to operands only, not to closed-over values.

    Args:
        function: of arrays; it may close over tracers, directly or in other functions.
        example: arrays of the shapes of its inputs.

    Returns:
        The function (numbers, *inputs) ↦ result, and the numbers.
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
