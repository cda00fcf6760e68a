"""`Problem`: a named system with its start, sensible lengths and a value to compare with; the registry."""

import dataclasses
import difflib
import functools
import inspect
import math
from collections.abc import Callable, Mapping
from typing import Any, ParamSpec, TypeAlias

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._jax.tracing import traced
from ..systems.kinds import System

__all__ = ["Problem", "Real", "Reference", "get", "problem", "unknown"]

P = ParamSpec("P")
Real: TypeAlias = Any  # a number, or a traced scalar under jit, vmap and grad


@dataclasses.dataclass(frozen=True)
class Reference:
    """Exponents that are known independently of this library.

    Attributes:
        exponents: descending; -inf where a reset kills a direction.
        stderr: one standard deviation each; 0 where the value is exact.
        exact: whether the values are closed forms.
        source: where they come from.
        clock: "time" or "jumps": what they are counted per (iterations of a map are jumps).
    """

    exponents: tuple[float, ...]
    stderr: tuple[float, ...]
    exact: bool
    source: str
    clock: str = "time"

    def __str__(self) -> str:
        values = ", ".join(map(_with_error, self.exponents, self.stderr))
        return f"{values} per {'unit time' if self.clock == 'time' else 'jump'} ({self.source})"


def exact(*exponents: float, source: str, clock: str = "time") -> Reference:
    """A reference in closed form, sorted."""
    values = tuple(sorted(map(float, exponents), reverse=True))
    return Reference(values, (0.0,) * len(values), True, source, clock)


def computed(exponents, stderr, *, source: str, clock: str = "time") -> Reference:
    """A reference with standard errors."""
    return Reference(tuple(map(float, exponents)), tuple(map(float, stderr)), False, source, clock)


def _with_error(value: float, stderr: float) -> str:
    if stderr == 0:
        return f"{value:.10g}"
    decimals = max(0, 1 - math.floor(math.log10(stderr)))
    return f"{value:.{decimals}f}({round(stderr * 10**decimals)})"


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Problem:
    """A system of the zoo, ready to run.

    Attributes:
        name: of the zoo's function.
        parameters: of the zoo's function, by name.
        system: an `lh.Flow`, `lh.Map`, `lh.Hybrid` or `lh.EventDriven`; the same object for all parameters
            that are numbers, so that changing them does not compile again.
        x0: start, shape (n,).
        args: what the system's functions get as `args`.
        mode: the mode at the start, where there are several.
        method: None: the default of the system.
        t1, transient: lengths in units of `clock` that give two to four digits within seconds.
        clock: "time" or "jumps".
        options: further defaults of `lyapunov_spectrum`.
        reference: exponents known otherwise, None where none are for these parameters.
        source: of the system.

    Example:
        >>> from lyaphybrid import zoo
        >>> problem = zoo.henon_map(a=1.3)
        >>> problem.parameters
        {'a': 1.3, 'b': 0.3}
        >>> zoo.logistic_map().reference.exponents
        (0.6931471805599453,)
    """

    system: System
    x0: Float[Array, " n"]
    args: Any
    t1: Any
    source: str
    reference: Reference | None = None
    transient: Any = 0.0
    clock: str = "time"
    mode: str | None = None
    method: Any = None
    options: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    parameters: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    name: str = ""

    def spectrum(self, **overrides):
        """`lyapunov_spectrum` of this problem.

        Args:
            overrides: any argument of `lh.lyapunov_spectrum`; `x0` and `args` too.

        Returns:
            A `Spectrum`.
        """
        from ..analysis.spectra import lyapunov_spectrum

        keywords = {
            "x0": self.x0,
            "args": self.args,
            "t1": self.t1,
            "transient": self.transient,
            "clock": self.clock,
            "mode": self.mode,
            "method": self.method,
            **self.options,
            **overrides,
        }
        return lyapunov_spectrum(self.system, keywords.pop("x0"), keywords.pop("args"), **keywords)

    def __repr__(self) -> str:
        parameters = ", ".join(f"{name}={_short(value)}" for name, value in self.parameters.items())
        mode = f" in mode {self.mode!r}" if self.mode else ""
        unit = "" if self.clock == "time" else " " + self.clock
        kind = next(c.__name__ for c in type(self.system).__mro__ if not c.__name__.startswith("_"))
        return "\n".join(
            [
                f"{self.name}({parameters})",
                f"  {kind}, dimension {self.x0.shape[-1]}, starts at {_point(self.x0)}{mode}",
                f"  t1 = {_short(self.t1)}{unit} after a transient of {_short(self.transient)}{unit}",
                f"  reference: {self.reference or 'none for these parameters'}",
                f"  source: {self.source}",
            ]
        )


def _is_array(value: Any) -> bool:
    return np.ndim(value) > 0


def _short(value: Any) -> str:
    if _is_array(value):
        return f"an array {np.shape(value)}"
    return f"{value:.10g}" if isinstance(value, int | float) and not isinstance(value, bool) else str(value)


def _point(x: Array) -> str:
    if traced(x):
        return "a traced point"
    shown = ", ".join(f"{v:.4g}" for v in np.asarray(x)[:6])
    return f"({shown}{', …' if len(x) > 6 else ''})"


# The registry.

_ZOO: dict[str, Callable[..., Problem]] = {}


def problem(function: Callable[P, Problem]) -> Callable[P, Problem]:
    """Put a function of keyword parameters into the zoo; unknown and ill-typed parameters become ValueErrors.

    A parameter takes the kind of its default: a truth value, a float, a whole number, or anything else unchecked. Where
    it is more than `Real` an array goes to the function unchecked.
    """
    name = function.__name__
    signature = inspect.signature(function).parameters
    defaults = {k: p.default for k, p in signature.items()}
    arrays = {k for k, p in signature.items() if isinstance(p.default, float) and p.annotation is not Real}

    @functools.wraps(function)
    def build(*positional: P.args, **parameters: P.kwargs) -> Problem:
        valid = ", ".join(f"{k}={_short(v)}" for k, v in defaults.items())
        if positional:
            raise ValueError(f"{name} takes its parameters by name: {name}({valid}); got {positional!r}.")
        for key in parameters:
            if key not in defaults:
                raise ValueError(
                    f"{name} has no parameter {key!r}; the nearest is {nearest(key, defaults)[0]!r} of {name}({valid})."
                )
        checked = {
            k: v if k in arrays and _is_array(v) else _as_kind_of(defaults[k], k, v) for k, v in parameters.items()
        }
        made = function(**checked)  # type: ignore[call-arg]
        return dataclasses.replace(made, name=name, parameters=made.parameters or {**defaults, **checked})

    _ZOO[name] = build
    return build


def get(name: str) -> Callable[..., Problem]:
    """The function of the zoo that has this name.

    Args:
        name: one of `zoo.names()`.

    Raises:
        ValueError: on an unknown name; the valid ones are listed, the nearest first.

    Example:
        >>> from lyaphybrid import zoo
        >>> zoo.get("cat_map")().reference.clock
        'jumps'
    """
    if name not in _ZOO:
        raise ValueError(unknown(name))
    return _ZOO[name]


def unknown(name: str) -> str:
    """The message for a name that is not in the zoo."""
    return f"The zoo has no {name!r}. Its problems, the nearest first: {', '.join(nearest(name, _ZOO))}."


def nearest(name: str, valid) -> list[str]:
    """The valid names, those most like `name` first."""
    return difflib.get_close_matches(name, list(valid), n=max(1, len(valid)), cutoff=0.0)


# What the zoo's functions check their parameters with. A traced value has no value yet: it passes.


def number(name: str, value: Any) -> Any:
    """A finite real number as a float; traced scalars pass."""
    if traced(value):
        if value.shape != ():
            raise ValueError(f"{name} must be a single number; got an array of shape {value.shape}.")
        return value
    scalar = isinstance(value, int | float | np.number | np.ndarray | Array) and not isinstance(value, bool)
    if not (scalar and np.ndim(value) == 0 and np.isrealobj(value) and np.isfinite(value)):
        raise ValueError(f"{name} must be a finite real number; got {value!r}.")
    return float(value)


def several(name: str, value: Any, n: int) -> Any:
    """A finite real number; or n of them, as an array."""
    if np.ndim(value) == 0:
        return number(name, value)
    if traced(value):
        values = value
    else:
        values = np.asarray(value)
        if values.dtype.kind not in "iuf" or not np.all(np.isfinite(values)):
            raise ValueError(f"{name} must be finite real numbers; got {value!r}.")
    if values.shape != (n,):
        raise ValueError(f"{name} must be a number, or one for each of the n = {n} bodies; got shape {values.shape}.")
    return jnp.asarray(values, float)


def _as_kind_of(default: Any, name: str, value: Any) -> Any:
    if isinstance(default, bool):
        if not isinstance(value, bool | np.bool_):
            raise ValueError(f"{name} must be True or False; got {value!r}.")
        return bool(value)
    if isinstance(default, float):
        return number(name, value)
    if isinstance(default, int):
        if isinstance(value, bool) or not isinstance(value, int | np.integer):
            raise ValueError(f"{name} must be a whole number; got {value!r}.")
        return int(value)
    return value


def require(name: str, value: Any, holds: Callable[[Any], bool], wanted: str) -> None:
    """Raise where the value is known and does not satisfy the condition."""
    if not traced(value) and not holds(value):
        raise ValueError(f"{name} must be {wanted}; got {value!r}.")


def positive(**values: Any) -> None:
    """Raise where one of the values is known and not above 0."""
    for name, value in values.items():
        require(name, value, lambda v: bool(np.all(np.asarray(v) > 0)), "positive")


def one_of(name: str, value: Any, choices: tuple[str, ...]) -> None:
    """Raise where the value is not one of the choices."""
    if value not in choices:
        raise ValueError(f"{name} must be one of {', '.join(map(repr, choices))}; got {value!r}.")


def near(value: Any, *wanted: Any) -> bool:
    """Whether the value (a number or several) is known and equal to what is wanted up to rounding."""
    given = value if isinstance(value, tuple) else (value,)
    return not traced(given) and all(math.isclose(a, b, rel_tol=1e-12) for a, b in zip(given, wanted, strict=True))


def state(*components: Any) -> Float[Array, " n"]:
    """A state vector in JAX's present default precision."""
    if not traced(*components):
        return jnp.asarray(np.array([float(c) for c in components]), dtype=float)  # compiles nothing
    return jnp.stack([jnp.asarray(c, dtype=float) for c in components])
