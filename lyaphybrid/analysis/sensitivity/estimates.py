"""What every way to a derivative of exponents takes, and what it finds."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..._arguments import require
from ..._jax.precision import require_double
from ...engine.blocks import is_zero
from ...engine.preparation import as_arrays

__all__ = ["ArgsOf", "Case", "Estimate", "UntrustedError", "case_of", "parameters_of", "tree_of", "with_arrays"]

LENGTHS = ("t0", "transient", "t1")


class UntrustedError(Exception):
    """A method does not apply to this motion."""


class Case(NamedTuple):
    """Exponents as a function of the parameters, all of them in one vector θ."""

    system: Any
    start: Callable  # args ↦ (n,)
    theta: np.ndarray  # (p,)
    args_of: "ArgsOf"  # (p,) ↦ args
    names: tuple[str, ...]  # (p,) for messages: "rho", "spring[2]"
    k: int
    options: Mapping[str, Any]  # t1, t0, transient, mode, method, every, clock of `lyapunov_spectrum`


class Estimate(NamedTuple):
    """Exponents and their derivatives by one method."""

    value: np.ndarray  # (k,)
    value_stderr: np.ndarray  # (k,)
    gradient: np.ndarray  # (k, p)
    stderr: np.ndarray  # (k, p)
    trust: bool
    reasons: tuple[str, ...]  # why, or why not: each with the number that decided
    cost: int  # runs of length t1, or what takes as long
    time_per_jump: Any = None  # an Estimate with k = 1, where the system jumps and its method looks


def case_of(system, x0, args, k: int, options: Mapping[str, Any], free: Sequence[str] | None = None) -> Case:
    """A case; the parameters are the floating-point leaves of args, or those named; all else stays as it is."""
    theta, args_of, names = parameters_of(args, free)
    start = x0 if callable(x0) else Fixed(x0)
    require_double("x0", start(args), "a derivative of exponents")
    return Case(system, start, theta, args_of, names, k, options)


def with_arrays(options: Mapping[str, Any], dtype) -> dict[str, Any]:
    """Options with arrays for numbers: a run with other numbers is then not compiled anew."""
    lengths = {name: options[name] for name in LENGTHS if name in options and not is_zero(options[name])}
    arrays = {name: np.asarray(value, dtype) for name, value in lengths.items()}
    return {**options, **arrays, "method": as_arrays(options.get("method"), dtype)}


def parameters_of(args, free: Sequence[str] | None, word: str = "free") -> tuple[np.ndarray, "ArgsOf", tuple[str, ...]]:
    """Those leaves of args that are free: their values (p,), args as a function of them, their names."""
    args = jax.tree.map(lambda leaf: jnp.asarray(leaf) if isinstance(leaf, float) else leaf, args)
    known = {_name(path): eqx.is_inexact_array_like(leaf) for path, leaf in jax.tree_util.tree_leaves_with_path(args)}
    known = [name for name, floating in known.items() if floating]
    require(bool(known), "args has no floating-point leaf: there is nothing to differentiate by.")
    wanted = known if free is None else list(free)
    wrong = [name for name in wanted if name not in known]
    require(not wrong and bool(wanted), f"{word} must name some of {', '.join(known)}; got {free!r}.")
    parts, fixed = eqx.partition(args, jax.tree_util.tree_map_with_path(lambda path, _: _name(path) in wanted, args))
    leaves, structure = jax.tree.flatten(parts)
    theta = np.concatenate([np.ravel(leaf) for leaf in leaves])
    return theta, ArgsOf(structure, tuple(map(np.shape, leaves)), fixed), _names(parts)


class ArgsOf(eqx.Module):
    """θ ↦ args; two of the same structure are the same to a compiler."""

    structure: Any = eqx.field(static=True)
    shapes: tuple[tuple[int, ...], ...] = eqx.field(static=True)
    fixed: Any

    def __call__(self, theta):
        """The args with these parameters."""
        return eqx.combine(self.free(theta), self.fixed)

    def free(self, values):
        """The tree of the parameters alone, of values (…, p): leaves (…) + their shape."""
        ends = np.cumsum([int(np.prod(shape)) for shape in self.shapes])[:-1]
        parts = jnp.split(jnp.asarray(values), ends, axis=-1)
        leaves = [part.reshape(*part.shape[:-1], *shape) for part, shape in zip(parts, self.shapes, strict=True)]
        return jax.tree.unflatten(self.structure, leaves)


class Fixed(eqx.Module):
    """A start that does not depend on args."""

    x0: Any

    def __call__(self, args):
        """The start."""
        return self.x0


def _name(path) -> str:
    return jax.tree_util.keystr(path, simple=True, separator=".") or "args"


def _names(free) -> tuple[str, ...]:
    names = []
    for path, leaf in jax.tree_util.tree_leaves_with_path(free):
        name, shape = _name(path), np.shape(leaf)
        names += [name + (str(list(index)) if shape else "") for index in np.ndindex(*shape)]
    return tuple(names)


def tree_of(case: Case, values: np.ndarray):
    """Values (k, p) as a tree of args, leaves (k,) + leaf.shape; what is no parameter is None."""
    return case.args_of.free(values)
