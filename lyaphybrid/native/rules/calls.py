"""Rules for calls of other programs, which are inlined."""

from collections.abc import Callable

import jax
import numpy as np

from ..lowering.costs import SELDOM
from ..lowering.emitter import is_wide
from ..lowering.jax_versions import called
from ..lowering.lowering import CALLS, KEEPS_ROWS, rule
from ..lowering.types import llvm_type
from ..lowering.values import filled, flat

CALLS |= {
    "jit", "pjit", "closed_call", "core_call", "remat", "remat2", "checkpoint", "custom_jvp_call", "custom_vjp_call",
    "custom_vjp_call_jaxpr", "custom_lin", "run_state", "eval_jaxpr",
}  # fmt: skip
KEEPS_ROWS |= CALLS


PROGRAMS: dict[str, Callable] = {}  # name of a jitted function: a rule that computes the same in another way


def program(name: str) -> Callable:
    """Register a rule for a jitted function by its name; the rule returns None for operands that it cannot take."""

    def decorate(function: Callable) -> Callable:
        PROGRAMS[name] = function
        return function

    return decorate


@rule(*sorted(CALLS))
def call(b, eqn, *values):
    found = None
    if (name := eqn.params.get("name")) in PROGRAMS:
        found = PROGRAMS[name](b, eqn, *values)
    return b.run(called(eqn), values) if found is None else found


def seldom(function: Callable) -> Callable:
    """Mark a function as rarely executed: its code does not count in the decision whether to compile for lanes."""

    def seldom(*args):
        return function(*args)

    return jax.jit(seldom)


@program(SELDOM)
def _(b, eqn, *values):
    before, begun = b.seldom, len(b.lines)
    found = b.run(called(eqn), values)
    b.seldom = before + len(b.lines) - begun
    return found


@rule("native_call")
def native_call(b, eqn, *values):
    """A native program that is called within another is inlined."""
    return b.run(eqn.params["program"].closed, values)


KEEPS_ROWS.add("native_call")


@rule("select_if_vmap")
def select_if_vmap(b, eqn, condition, x, y):
    """A primitive of equinox's loops: `x`, because the condition holds; with lanes a selection for each lane."""
    entry = b.entry_of(condition)
    if not is_wide(entry):
        return x
    type_ = llvm_type(eqn.outvars[0].aval.dtype)
    each = zip(flat(b.entries(x)), flat(b.entries(y)), strict=True)
    return filled(x.shape, [b.select(entry, type_, p, q) for p, q in each])


KEEPS_ROWS |= {"select_if_vmap", "nondifferentiable_backward", "announce_jaxpr"}


@rule("nondifferentiable_backward", "announce_jaxpr")
def unchanged(b, eqn, *values):
    """Primitives of equinox that matter only to transformations: the identity."""
    return list(values)


@rule("platform_index")
def platform_index(b, eqn):
    platforms = eqn.params["platforms"]
    return b.constant_value(np.int32(next(i for i, p in enumerate(platforms) if p is None or "cpu" in p)))
