"""Input (`ExponentFunction`) and result (`Estimate`) of each method for derivatives of exponents."""

import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np

from ..._arguments import numbers, parameters, require
from ..._entries import name_of
from ..._jax.precision import require_double
from ..._jax.tracing import as_arrays, as_jax, numpy_for
from ...engine.blocks import is_zero
from ...systems.kinds import System
from ...systems.labels import labels_of, unlabelled

__all__ = [
    "ArgsOf",
    "ExponentFunction",
    "Estimate",
    "InapplicableError",
    "UntrustedError",
    "case_of",
    "parameters_of",
    "tree_of",
    "unknown",
    "with_arrays",
]

LENGTH_KEYWORDS = ("t0", "transient", "t1")


class UntrustedError(Exception):
    """A method does not apply to this motion; `failed`: for the motion itself could not be followed."""

    def __init__(self, message: str, failed: bool = False):
        super().__init__(message)
        self.failed = failed


class InapplicableError(ValueError):
    """A method does not apply to this kind of system: bad input where the user asks for it by its name."""


class ExponentFunction(NamedTuple):
    """Exponents as a function of the parameters, all of them in one vector θ."""

    system: Any
    start: Callable  # args ↦ (n,)
    theta: np.ndarray  # (p,)
    args_of: "ArgsOf"  # (p,) ↦ args
    names: tuple[str, ...]  # (p,) for messages: "rho", "spring[2]"
    k: int
    options: Mapping[str, Any]  # t1, t0, transient, mode, method, every, clock of `lyapunov_spectrum`
    time_unit: str = ""  # where the system gives one


class Estimate(NamedTuple):
    """Exponents and their derivatives by one method."""

    value: np.ndarray  # (k,)
    value_stderr: np.ndarray  # (k,)
    gradient: np.ndarray  # (k, p)
    stderr: np.ndarray  # (k, p)
    trust: bool
    reasons: tuple[str, ...]  # why it can or cannot be trusted, each with the deciding number
    cost: int  # in runs of length t1
    time_per_jump: Any = None  # an Estimate with k = 1, from a regression of a system that jumps
    of_unstable_orbit: bool = False  # whether nothing but this speaks against it


def unknown(case: ExponentFunction, why: str) -> Estimate:
    """Nothing is known of the derivatives, nor of the exponents."""
    value, gradient = np.full(case.k, np.nan), np.full((case.k, len(case.theta)), np.nan)
    return Estimate(value, value, gradient, gradient, trust=False, reasons=(why,), cost=0)


def case_of(
    system, x0, args, k: int, options: Mapping[str, Any], free: Sequence[str] | None = None
) -> ExponentFunction:
    """A case; the parameters are the floating-point leaves of args, or those named in `free`; the rest stays fixed."""
    theta, args_of, names = parameters_of(args, free)
    start = x0 if callable(x0) else FixedStart(x0)
    first = start_of(x0, args)
    require_double("x0", first, "a derivative of exponents")
    if not isinstance(system, System):  # it is refused where it is run
        return ExponentFunction(system, start, theta, args_of, names, k, options)
    time_unit = labels_of(system, first.shape).time_unit
    return ExponentFunction(unlabelled(system), start, theta, args_of, names, k, options, time_unit)


def start_of(x0, args):
    """The start as an array, x0 itself or what x0(args) gives.

    Raises:
        ValueError: if it is not made of real numbers, or of none.
    """
    name, given = ("x0(args)", x0(args)) if callable(x0) else ("x0", x0)
    start = numbers(name, given)
    several = "or (N, d) where the system has rows of bodies"
    require(
        0 not in start.shape and start.ndim in (1, 2), f"{name} must have shape (n,), {several}; got {start.shape}."
    )
    return start


def with_arrays(options: Mapping[str, Any], dtype) -> dict[str, Any]:
    """The options with arrays in place of numbers, so that other numbers compile nothing new."""
    lengths = {name: options[name] for name in LENGTH_KEYWORDS if name in options and not is_zero(options[name])}
    arrays = {name: np.asarray(value, dtype) for name, value in lengths.items()}
    return {**options, **arrays, "method": as_arrays(options.get("method"), dtype)}


def parameters_of(args, free: Sequence[str] | None, word: str = "over") -> tuple[np.ndarray, "ArgsOf", tuple[str, ...]]:
    """The free leaves of args: their values (p,), args as a function of them, their names."""
    args = jax.tree.map(functools.partial(parameters, "args"), args)
    args = as_jax(jax.tree.map(lambda leaf: np.asarray(leaf) if isinstance(leaf, float) else leaf, args))
    named = {name_of(path): leaf for path, leaf in jax.tree_util.tree_leaves_with_path(args)}
    known = [name for name, leaf in named.items() if eqx.is_inexact_array_like(leaf)]
    require(bool(known), f"args has no floating-point number to differentiate by, got {args!r}: write 1.0 for 1.")
    wanted = known if free is None else list(free)
    wrong = [name for name in wanted if name not in known]
    hints = [f" {name} is an integer in args: write 2.0 for 2." for name in wrong if name in named]
    wholes = {name: name.partition("[")[0] for name in wrong}
    hints += [f" {name} is one entry: name {one}, all of it." for name, one in wholes.items() if one in known]
    require(not wrong and bool(wanted), f"{word} must name some of {', '.join(known)}; got {free!r}.{''.join(hints)}")
    parts, fixed = eqx.partition(args, jax.tree_util.tree_map_with_path(lambda path, _: name_of(path) in wanted, args))
    leaves, structure = jax.tree.flatten(parts)
    theta = np.concatenate([np.ravel(leaf) for leaf in leaves])
    return theta, ArgsOf(structure, tuple(map(np.shape, leaves)), fixed), _names(parts)


class ArgsOf(eqx.Module):
    """The function θ ↦ args as a pytree, so that other values compile nothing new."""

    structure: Any = eqx.field(static=True)
    shapes: tuple[tuple[int, ...], ...] = eqx.field(static=True)
    fixed: Any

    def __call__(self, theta):
        """The args with these parameters."""
        return eqx.combine(self.free(theta), self.fixed)

    def free(self, values):
        """The tree of the parameters alone, of values (…, p): leaves (…) + their shape."""
        ends = np.cumsum([int(np.prod(shape)) for shape in self.shapes])[:-1]
        xp = numpy_for(values)
        values = xp.asarray(values)
        parts = xp.split(values, ends, axis=-1) if len(ends) else [values]
        leaves = [part.reshape((*part.shape[:-1], *shape)) for part, shape in zip(parts, self.shapes, strict=True)]
        return jax.tree.unflatten(self.structure, as_jax(leaves))


class FixedStart(eqx.Module):
    """A start that does not depend on args."""

    x0: Any

    def __call__(self, args):
        """The start."""
        return self.x0


def _names(free) -> tuple[str, ...]:
    names = []
    for path, leaf in jax.tree_util.tree_leaves_with_path(free):
        name, shape = name_of(path), np.shape(leaf)
        names += [name + (str(list(index)) if shape else "") for index in np.ndindex(*shape)]
    return tuple(names)


def tree_of(case: ExponentFunction, values: np.ndarray):
    """Values (k, p) as a tree of args, leaves (k,) + leaf.shape; leaves that are no parameters are None."""
    return case.args_of.free(values)
