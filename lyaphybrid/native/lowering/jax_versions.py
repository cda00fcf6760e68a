"""Parameters of a jaxpr's equations that differ between versions of JAX; they are read only here.

Tested with 0.8.0, 0.10.1 and 0.12.0.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal

_CALLED = ("jaxpr", "call_jaxpr", "fun_jaxpr")
_UPDATE = "update_jaxpr"  # of a scatter-add and the like, whose names say the same


class Scan(NamedTuple):
    """The parameters of a scan; its operands are the constants, then the carry, then the arrays scanned over."""

    body: ClosedJaxpr
    length: int
    reverse: bool
    consts: int
    carry: int


def scan_of(equation) -> Scan:
    """The parameters of a `scan` equation."""
    p = equation.params
    body, length, reverse = p["jaxpr"], p["length"], p["reverse"]
    if "num_consts" in p:
        return Scan(body, length, reverse, p["num_consts"], p["num_carry"])
    # From 0.12 on: trees (consts, carry, xs) of the operands.
    consts, carry, _ = p["ft_in"].unpack()
    return Scan(body, length, reverse, len(consts), len(carry))


def made_of(primitive) -> Callable:
    """The function of simpler primitives that a primitive is: of some of JAX's own, from 0.12 on, not its `impl`."""
    # Every primitive has the attribute by inheritance, as a function that raises or as None: only its own counts.
    return vars(primitive).get("to_lojax", primitive.impl)


def called(equation) -> ClosedJaxpr | Jaxpr:
    """The program that a call equation (`jit`, `custom_jvp_call`, …) holds."""
    for name in _CALLED:
        if (found := equation.params.get(name)) is not None:
            return found
    raise KeyError(f"{equation.primitive.name}: no jaxpr among the parameters {sorted(equation.params)}")


def index_mode(equation) -> str:
    """The treatment of indices out of bounds: "clip", "drop" (a gather then fills), or "promise" (there are none)."""
    name = getattr(equation.params["mode"], "name", str(equation.params["mode"])).lower()
    return {"clip": "clip", "fill_or_drop": "drop", "promise_in_bounds": "promise"}.get(name, name)


def linear_solve(equation) -> tuple[ClosedJaxpr, list[int]]:
    """The solving program of a `custom_linear_solve`, and the positions of its operands among the equation's."""
    lengths, programs = equation.params["const_lengths"], equation.params["jaxprs"]
    first = lengths.matvec + lengths.vecmat
    constants = range(first, first + lengths.solve)
    return programs.solve, [*constants, *range(sum(lengths), len(equation.invars))]


def axis_of_greatest(equation) -> int:
    """The axis of a `top_k`; up to version 0.8 always the last one."""
    return equation.params.get("axis", equation.invars[0].aval.ndim - 1)


def literal_value(literal: Literal) -> np.ndarray:
    """The value of a literal as an array of its type."""
    aval: Any = literal.aval
    return np.asarray(literal.val, aval.dtype)


def parts(jaxpr: ClosedJaxpr | Jaxpr) -> tuple[Jaxpr, Any]:
    """A jaxpr and its constants."""
    return (jaxpr.jaxpr, jaxpr.consts) if isinstance(jaxpr, ClosedJaxpr) else (jaxpr, ())


def subprograms(equation) -> list[Jaxpr]:
    """The programs that an equation runs; a `native_call` has a `Program`, with its jaxpr in `closed`."""
    found = []
    for name, parameter in equation.params.items():
        if name == _UPDATE:
            continue
        for each in parameter if isinstance(parameter, tuple | list) else (parameter,):
            program = getattr(each, "closed", each)
            if isinstance(program, ClosedJaxpr | Jaxpr):
                found.append(parts(program)[0])
    return found
