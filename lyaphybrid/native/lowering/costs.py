"""What is unrolled, and how hard LLVM tries.

An array of up to `small` elements is held as entries: its code is written out element by element, and moving elements
about is free. That makes the fastest code, but where an index is known at run time only each element has to be asked
for, and the code grows. So `small` is 16, unless a smaller value makes the code much shorter: of four hard disks, say,
whose states are looked up by the number of a disk (0.58 times as long a run with 8). With more than 16 loops carry so
much that it does not fit into registers (a pendulum with dry friction: 1.05 times as long a run with 64).
The estimate counts instructions in the jaxpr, each loop's body once.

To look for vectors among scattered numbers makes four hard disks 1.5 times as fast and others hardly faster; in long
programs it takes LLVM more time than all else (relay feedback: 1.9 s instead of 0.5).
"""

import math
import weakref
from typing import NamedTuple

from .jax_versions import Jaxpr, parts, scan_of, subprograms
from .values import size

SMALL = (16, 8, 4)
MUCH = 1.5  # times as many instructions
LEVEL = 2  # of LLVM's optimisation
LONG = 1000  # turns from which on a loop counts as one that runs long
SCATTERED = 12_000  # instructions up to which LLVM looks for vectors among scattered numbers
TURNS = 8  # of a scan that is written out, at most
WRITTEN_OUT = 400  # instructions of all its turns together, at most …
WITH_ARRAYS = 5000  # … and where it indexes arrays in memory: a continuous QR's stages then take 0.85 of the time
WORTH_A_JUMP = 20  # equations
SELDOM = "seldom"  # the name of functions that are
_LOOP = 6  # instructions of an equation that becomes part of a loop over memory


class Plan(NamedTuple):
    """How a program is compiled."""

    small: int
    level: int  # of LLVM's optimisation, 0 to 3, of the best code
    scattered: bool = False  # whether LLVM looks for vectors among scattered numbers


def plan(jaxpr: Jaxpr) -> Plan:
    """The largest value of `small` for which the code is not much longer than it could be."""
    estimates = {small: instructions(jaxpr, small) for small in SMALL}
    least = min(estimates.values())
    small = next(small for small in SMALL if estimates[small] <= MUCH * least)
    return Plan(small, LEVEL, estimates[small] <= SCATTERED)


def runs_long(jaxpr: Jaxpr) -> bool:
    """Whether there is a loop in it of many turns, or of nobody knows how many."""
    return any(
        eqn.primitive.name == "while"
        or (eqn.primitive.name == "scan" and scan_of(eqn).length >= LONG)
        or any(map(runs_long, subprograms(eqn)))
        for eqn in jaxpr.eqns
    )


# What loops hold is asked for again and again.
_known: weakref.WeakKeyDictionary[Jaxpr, dict[float, int]] = weakref.WeakKeyDictionary()


def instructions(jaxpr: Jaxpr, small: float = math.inf) -> int:
    """About how many instructions the program becomes."""
    known = _known.setdefault(jaxpr, {})
    if small not in known:
        known[small] = sum(_of_equation(eqn, small) for eqn in jaxpr.eqns)
    return known[small]


def turns_written_out(small: float, scan, avals) -> int:
    """Scans of up to so many turns are written out, for then their indices are known; `avals`: all that it indexes."""
    most = WRITTEN_OUT if all(size(aval.shape) <= small for aval in avals) else WITH_ARRAYS
    return TURNS if min(scan.length, TURNS) * instructions(parts(scan.body)[0], small) <= most else 0


def _of_equation(eqn, small: float) -> int:
    name, results = eqn.primitive.name, [size(variable.aval.shape) for variable in eqn.outvars]
    if inner := subprograms(eqn):
        turns = 1
        if name == "scan":
            scan = scan_of(eqn)
            avals = [atom.aval for atom in (*eqn.invars[scan.consts + scan.carry :], *eqn.outvars)]
            turns = scan.length if scan.length <= turns_written_out(small, scan, avals) else 1
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


def worth_a_jump(branch: Jaxpr) -> bool:
    """Whether a branch that lanes do not share is passed over where none takes it."""
    return _work(branch) >= WORTH_A_JUMP


def _work(jaxpr: Jaxpr) -> int:
    """How many equations are in a program, those of programs within it included."""
    return sum(1 + sum(map(_work, subprograms(eqn))) for eqn in jaxpr.eqns)


def apart(jaxpr: Jaxpr) -> float:
    """About which part of a program stands in branches, which lanes may not share; what is seldom run does not count.

    Of 11 problems of the zoo this is between 0.5 and 1.4 times what is found when they are lowered.
    """
    total, within = _in_branches(jaxpr, False)
    return within / max(total, 1)


def _in_branches(jaxpr: Jaxpr, inside: bool) -> tuple[int, int]:
    """Instructions, and those in branches: all where the program is `inside` of one."""
    total = within = 0
    for eqn in jaxpr.eqns:
        inner = subprograms(eqn)
        if not inner:
            n = _of_equation(eqn, SMALL[0])
            total, within = total + n, within + n * inside
        elif eqn.params.get("name") != SELDOM:
            branches = eqn.primitive.name == "cond"
            for each in inner:
                n, some = _in_branches(each, inside or (branches and worth_a_jump(each)))
                total, within = total + n, within + some
    return total, within


_MOVING = {
    "broadcast_in_dim", "reshape", "squeeze", "expand_dims", "slice", "transpose", "rev", "concatenate", "stack",
    "unstack", "split", "pad", "iota", "empty", "empty2", "copy", "stop_gradient",
    "optimization_barrier",
}  # fmt: skip
