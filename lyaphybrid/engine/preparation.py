"""From the user's arguments to a `RunProblem`; everything is checked before any computation."""

import functools
import math
import warnings
from collections.abc import Mapping
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

from .._arguments import numbers, parameters, real, require
from .._jax.precision import LEAST_TOLERANCE, cure, eps, is_short, require_double
from .._jax.tracing import array, as_arrays, traced, varying
from .._keywords import user_level
from ..integrators import ContinuousQR, HalfExplicit, RungeKutta
from ..integrators.base import Method
from ..systems.consistency import check_constraints
from ..systems.contacts.starts import check_initial_mode
from ..systems.daes.semi_linear import Constrained, fields_of
from ..systems.event_driven import EventDriven
from ..systems.hybrid import Hybrid
from ..systems.kinds import has_rows, iterates
from ..systems.labels import labels_of, unlabelled
from ..systems.smooth import Flow, Map
from ..systems.validation import check_clocks
from .blocks import COUNTED
from .problems import RunProblem, mode_names

SMALL_UNITS = 1e3  # a state below so many absolute tolerances is in units that are too small
RELATIVE_ATOL = 1e-12  # part of the state that is advised as an absolute tolerance
_NO_STATE = "The start, such as [1.0, 0.0], comes before args, the parameters, which may have names."

__all__ = [
    "RELATIVE_ATOL",
    "SMALL_UNITS",
    "at_precision",
    "grown_columns",
    "method_for",
    "mode_index",
    "prepare",
    "warn_of_small_units",
]


def prepare(system, x0, args, t0, method, mode, name: str = "x0") -> tuple[RunProblem, Any, Any, Any]:
    """Check the user's arguments before any computation; returns (problem, x0, t0, index of the mode).

    `name` is the name of the state in error messages. The mode is None where each initial state determines its own. The
    problem's system has no names for its state: they change no program.
    """
    if not isinstance(system, Flow | Map | Hybrid | EventDriven):
        raise ValueError(
            f"system must be an lh.Flow, lh.Map, lh.Hybrid or lh.EventDriven; got {type(system).__name__}. "
            f"{_wrapped(system)}"
        )
    axes = varying((x0, args, t0))
    require(
        not axes,
        f"inside jax.shard_map pass check_vma=False to it; now values are typed as varying over {sorted(axes)}.",
    )
    x0, shape = _state(system, x0, name)
    labels_of(system, shape)  # refused before anything is computed
    real("t0" if name == "x0" else "t", t0)
    counts = traced(t0) or not iterates(system) or abs(float(t0)) <= COUNTED
    require(counts, f"t0, the number of an iteration, must be at most 2**53, as far as floats count; got {t0!r}.")
    # Python floats would be compiled in as constants; arrays can change without a new compilation.
    method = method_for(system, method)
    _check_precision(name, x0, system, method)
    args = jax.tree.map(lambda leaf: parameters("args", leaf), args)
    args, method = as_arrays(args, x0.dtype), at_precision(method, x0)
    check_clocks(system, args)
    t0 = array(t0, x0.dtype)
    first, index = x0 if x0.ndim == 1 else x0[0], mode_index(system, mode)
    check_constraints(system, first, t0, args)
    check_initial_mode(system, first, t0, args, index)
    if method is not None and method.of_one_mode:
        method.require_at_start(fields_of(system)[0], t0, first, args)
    return RunProblem(unlabelled(system), method, args, shape), x0, t0, index


def at_precision(method, x):
    """The method with its numbers as arrays, and with tolerances that the precision of x can meet."""
    if method is not None and is_short(x):
        method = method.loosened(LEAST_TOLERANCE * eps(x))
    return as_arrays(method, x.dtype)


def _check_precision(name: str, x, system, method) -> None:
    """Raise an error for what float32 cannot do, and warn about its lower accuracy otherwise."""
    if not is_short(x):
        return
    if any(isinstance(field, Constrained) for field in fields_of(system)):
        require_double(name, x, "an lh.DAE")
    require(x.dtype == jnp.float32, f"{name} is {x.dtype}: it must be float64, or float32. {cure(name)}")
    steps, kept = "", at_precision(method, x)
    if method is not None and method.adaptive and not traced(method) and kept.rtol > method.rtol:
        steps = f" Steps are controlled to rtol = {kept.rtol:.2g} and not {method.rtol:.2g}."
    warnings.warn(
        f"{name} is float32: exponents will carry three to four digits, and events may be missed.{steps} {cure(name)}",
        stacklevel=user_level(),
    )


def warn_of_small_units(x0, method) -> None:
    """Warn where all of the start is so small that the absolute tolerance of a method is a large part of it."""
    atol = getattr(method, "atol", None)
    if atol is None or not method.adaptive or traced((x0, method)):
        return
    size, allowed = float(np.max(np.abs(x0))), float(np.max(atol))
    if 0 < size < SMALL_UNITS * allowed:
        warnings.warn(
            f"x0 is at most {size:.1e} large, and atol allows errors of {allowed:.0e} in each step: results are "
            "wrong if the motion stays so small. Take larger units, or a method with a smaller tolerance, such as "
            f"lh.RungeKutta(atol={size * RELATIVE_ATOL:.0e}).",
            stacklevel=user_level(),
        )


def _state(system, x0, name):
    """The states (n,) or (m, n), and the shape of one state as the user gave it: (n,), or (N, d) for many bodies."""
    if any(np.iscomplexobj(leaf) for leaf in jax.tree.leaves(x0)):
        raise ValueError(f"{name} must be real; write a complex state as its real and imaginary parts.")
    if isinstance(x0, Mapping | str | None):
        raise ValueError(f"{name} must be an array of numbers; got {x0!r}. {_NO_STATE}")
    x0 = numbers(name, x0)
    x0 = array(x0, jax.dtypes.canonicalize_dtype(x0.dtype if jnp.issubdtype(x0.dtype, jnp.floating) else float))
    rows = has_rows(system)
    one = 2 if rows else 1
    if x0.ndim not in (one, one + 1) or 0 in x0.shape:
        several, single = ("(m, N, d)", "(N, d), one row a body") if rows else ("(m, n)", "(n,)")
        raise ValueError(f"{name} must have shape {single}, or {several} for m runs at once; got {x0.shape}.")
    if not traced(x0) and not np.all(np.isfinite(x0)):
        raise ValueError(f"{name} must be finite; got {x0}.")
    shape = x0.shape[-one:]
    return x0.reshape(*x0.shape[:-one], math.prod(shape)), shape


@functools.cache
def _default_method(constrained: bool) -> Method:
    return HalfExplicit() if constrained else RungeKutta()


def method_for(system, method):
    """The method that was given, or the default of such a system; None where nothing is stepped."""
    if isinstance(system, Flow) or (isinstance(system, Hybrid) and system.fields is not None):
        if method is None:
            constrained = any(isinstance(field, Constrained) for field in fields_of(system))
            return _default_method(constrained)
        if not isinstance(method, Method):
            raise ValueError(
                f"A system that flows needs a method such as lh.RungeKutta(); got {method!r}. {_as_method(method)}"
            )
        modes = len(fields_of(system))
        require(
            modes == 1 or not method.of_one_mode,
            f"lh.Splitting moves by its own flows, and those of the {modes} modes of this system differ: take "
            "lh.RungeKutta, or lh.Symplectic where the field of each mode is an lh.Hamiltonian.",
        )
        return method
    if method is not None:
        kind = "A map is iterated" if isinstance(system, Map | Hybrid) else "An lh.EventDriven flow is exact"
        raise ValueError(f"{kind}: it takes no method; got {method!r}. Leave method=None.")
    return None


def grown_columns(verb: str, method):
    """The method, for a verb that reads columns with their growth in them: `ContinuousQR` divides it out."""
    require(
        not isinstance(method, ContinuousQR),
        f"{verb} needs columns with their growth in them, and lh.ContinuousQR keeps them orthonormal: give the method "
        "within it.",
    )
    return method


def _wrapped(system) -> str:
    """What to write instead of what is no system."""
    if hasattr(system, "system"):  # a problem of the zoo
        return "Give problem.system, with problem.x0 and problem.args; or call problem.spectrum(t1=…)."
    if hasattr(system, "vector_field"):
        return "Of a diffrax term take the function: lh.Flow(term.vector_field)."
    return "Wrap a function: lh.Flow(field)."


def _as_method(method) -> str:
    """What to write instead of what is no method."""
    if isinstance(method, type):
        return f"Make one by brackets: {method.__name__}()."
    if isinstance(method, str):
        return "Names are tableaux: lh.RungeKutta('dopri5')."
    if isinstance(method, diffrax.AbstractSolver):
        return f"Wrap a solver of diffrax: lh.Diffrax(diffrax.{type(method).__name__}())."
    return "Tolerances go with it: lh.RungeKutta(rtol=1e-9)."


def mode_index(system, mode):
    """The index of a mode given by name or index; None if the state determines the mode."""
    names = mode_names(system)
    if mode is None:
        if isinstance(system, Hybrid) and system.initial_mode is not None:
            return None
        if len(names) > 1:
            raise ValueError(f"This system has the modes {list(names)}: say which one it starts in, mode=….")
        return 0
    if isinstance(mode, str):
        if mode not in names:
            raise ValueError(f"Unknown mode {mode!r}; the modes are {list(names)}.")
        return names.index(mode)
    require(_is_index(mode), f"mode must be the name or the index of one of {list(names)}; got {mode!r}.")
    if traced(mode):
        return mode
    require(0 <= int(mode) < len(names), f"mode {mode} is out of range; the modes are {list(names)}.")
    return int(mode)


def _is_index(mode) -> bool:
    """Whether it is a single integer."""
    if not hasattr(mode, "dtype"):
        return isinstance(mode, int) and not isinstance(mode, bool)
    return mode.shape == () and jnp.issubdtype(mode.dtype, jnp.integer)
