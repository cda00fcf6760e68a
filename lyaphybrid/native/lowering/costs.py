"""Estimates of code size, and the compiler options that follow: what is unrolled, and how much LLVM optimises.

An array of up to `small` elements is held as entries: its code is unrolled element by element, and moving elements
costs nothing. This gives the fastest code, except where an index is known only at run time: then each element must be
compared and selected, and the code grows. So `small` is 16, unless a smaller value makes the code much shorter, as for
hard disks, whose states are looked up by the number of a disk. With more than 16, loops carry more values than fit into
registers. The estimate counts the instructions that the jaxpr becomes, each loop's body once.

LLVM's search for vectors among scalar instructions ("SLP", here `scattered`) pays for few programs, such as hard disks;
in long programs it would take most of LLVM's time.
"""

import math
import weakref
from typing import NamedTuple

from .jax_versions import Jaxpr, parts, scan_of, subprograms
from .values import size

SMALL = (16, 8, 4)
MUCH = 1.5  # ratio of instruction counts above which a smaller value of `small` is taken
OPTIMISATION_LEVEL = 2  # of LLVM's optimisation
LONG_SCAN = 1000  # iterations from which on a scan counts as long
SCATTERED = 12_000  # instructions, up to which LLVM searches for vectors among scalar instructions
MOST_ITERATIONS_UNROLLED = 8  # iterations of a scan that is unrolled, at most
MOST_INSTRUCTIONS_UNROLLED = 400  # instructions of all its iterations together, at most …
WITH_ARRAYS = 5000  # … or this if it indexes arrays in memory (a continuous QR): constant indices then save more
WORTH_A_JUMP = 20  # equations from which on a branch that no lane takes is jumped over
SELDOM = "seldom"  # name of jitted functions that are rarely executed
_LOOP = 6  # estimated instructions of an equation that becomes part of a loop over memory


class Options(NamedTuple):
    """Options with which a program is compiled."""

    small: int
    level: int  # LLVM's optimisation level, 0 to 3, of the final code
    scattered: bool = False  # whether LLVM searches for vectors among scalar instructions


def plan(jaxpr: Jaxpr) -> Options:
    """The options of a program: the largest `small` with at most `MUCH` times the fewest instructions."""
    estimates = {small: instructions(jaxpr, small) for small in SMALL}
    least = min(estimates.values())
    small = next(small for small in SMALL if estimates[small] <= MUCH * least)
    return Options(small, OPTIMISATION_LEVEL, estimates[small] <= SCATTERED)


def runs_long(jaxpr: Jaxpr) -> bool:
    """Whether a program contains a loop of many iterations, or of an unknown number."""
    return any(
        eqn.primitive.name == "while"
        or (eqn.primitive.name == "scan" and scan_of(eqn).length >= LONG_SCAN)
        or any(map(runs_long, subprograms(eqn)))
        for eqn in jaxpr.eqns
    )


# Cached, because `plan` and the rules ask for the same loop bodies repeatedly.
_known: weakref.WeakKeyDictionary[Jaxpr, dict[float, int]] = weakref.WeakKeyDictionary()


def instructions(jaxpr: Jaxpr, small: float = math.inf) -> int:
    """An estimate of the number of instructions that a program becomes."""
    known = _known.setdefault(jaxpr, {})
    if small not in known:
        known[small] = sum(_of_equation(eqn, small) for eqn in jaxpr.eqns)
    return known[small]


def turns_written_out(small: float, scan, avals) -> int:
    """The largest length at which a scan is unrolled, so that its indices are constants; `avals`: arrays it indexes."""
    most = MOST_INSTRUCTIONS_UNROLLED if all(size(aval.shape) <= small for aval in avals) else WITH_ARRAYS
    return (
        MOST_ITERATIONS_UNROLLED
        if min(scan.length, MOST_ITERATIONS_UNROLLED) * instructions(parts(scan.body)[0], small) <= most
        else 0
    )


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
    """Whether a branch that lanes do not share is long enough to be jumped over if no lane takes it."""
    return _work(branch) >= WORTH_A_JUMP


def _work(jaxpr: Jaxpr) -> int:
    """The number of equations of a program, including those of its subprograms."""
    return sum(1 + sum(map(_work, subprograms(eqn))) for eqn in jaxpr.eqns)


def apart(jaxpr: Jaxpr) -> float:
    """An estimate of the part of a program in branches, which lanes may not share; without what is rarely executed.

    For problems of the zoo it agrees with the value found by lowering within a factor of two.
    """
    total, within = _in_branches(jaxpr, False)
    return within / max(total, 1)


def _in_branches(jaxpr: Jaxpr, inside: bool) -> tuple[int, int]:
    """The numbers of instructions, and of those in branches (all, if the program is `inside` a branch)."""
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
