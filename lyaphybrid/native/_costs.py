"""What is unrolled, and how hard LLVM tries.

An array of up to `small` elements is held as entries: its code is written out element by element, and moving elements
about is free. That makes the fastest code for little work, but the code grows with the work, and LLVM's time with the
code. So `small` is the largest of a few values for which the estimated code stays below a limit; a program that is too
large in any case is lowered with the value that makes it shortest. The estimate counts instructions in the
jaxpr, each loop's body once.
"""

import math
from typing import NamedTuple

from ._jax_versions import Jaxpr, parts, scan_of, subprograms
from ._values import size

SMALL = (64, 32, 16, 8, 4)
LIMIT = 25_000  # instructions estimated, of which about half remain (impact oscillator: 13 076 for 6 847 lines)
_LOOP = 12  # instructions of a loop over memory


class Plan(NamedTuple):
    """How a program is compiled."""

    small: int
    level: int  # of LLVM's optimisation: 1, 2, 3


def plan(jaxpr: Jaxpr) -> Plan:
    """Of the values of `small` the largest for which the code stays short."""
    estimates = {}
    for small in SMALL:
        estimates[small] = instructions(jaxpr, small)
        if estimates[small] <= LIMIT:
            return Plan(small, 2)
    return Plan(min(SMALL, key=estimates.__getitem__), 2)


def instructions(jaxpr: Jaxpr, small: float = math.inf) -> int:
    """About how many instructions the program becomes."""
    return sum(_of_equation(eqn, small) for eqn in jaxpr.eqns)


def _of_equation(eqn, small: float) -> int:
    name, results = eqn.primitive.name, [size(variable.aval.shape) for variable in eqn.outvars]
    if inner := subprograms(eqn):
        turns = 1
        if name == "scan":
            scan = scan_of(eqn)
            few = scan.length <= 4 and len(parts(scan.body)[0].eqns) <= 50 and max(results, default=0) <= small
            turns = scan.length if few else 1
        return turns * sum(instructions(program, small) for program in inner) + sum(n for n in results if n <= small)
    largest = max(results, default=0)
    if largest > small:
        return _LOOP
    if name == "dot_general":
        (over, _), _ = eqn.params["dimension_numbers"]
        return 2 * largest * size([eqn.invars[0].aval.shape[axis] for axis in over])
    if name in _MOVING:
        return 0
    if name.startswith(("reduce", "arg", "cum")):
        of = size(eqn.invars[0].aval.shape)
        return of if of <= small else _LOOP
    if name.startswith("scatter") or name == "dynamic_update_slice":
        changed = size(eqn.invars[2 if name.startswith("scatter") else 1].aval.shape)
        return 2 * largest * changed if changed <= small else _LOOP
    if name in ("gather", "dynamic_slice"):
        of = size(eqn.invars[0].aval.shape)
        return largest * (of if of <= small else 3)
    if name == "sort":
        return 4 * len(results) * largest**2
    return largest


_MOVING = {
    "broadcast_in_dim", "reshape", "squeeze", "expand_dims", "slice", "transpose", "rev", "concatenate", "stack",
    "unstack", "split", "pad", "iota", "copy", "stop_gradient", "optimization_barrier",
}  # fmt: skip
