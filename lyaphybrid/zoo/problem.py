"""`Problem`: a named system with its start, lengths of runs and a reference value; and the registry."""

import dataclasses
import difflib
import functools
import inspect
import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, ParamSpec, TypeAlias, TypeVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._jax.tracing import traced
from .._text import with_error
from ..analysis.orbits.periodic_orbits import Floquet, floquet
from ..analysis.spectra import lyapunov_spectrum
from ..analysis.trajectories import Trajectory, trajectory
from ..results.spectrum import Spectrum
from ..sweeps import sweep
from ..systems.kinds import System, iterates

if TYPE_CHECKING:
    import xarray

__all__ = ["Problem", "Real", "Reference", "get", "problem", "unknown"]

P = ParamSpec("P")
T = TypeVar("T")
PART = 0.01  # of the length of a spectrum, over which a trajectory goes
Real: TypeAlias = Any  # a number, or a traced scalar under jit, vmap and grad


@dataclasses.dataclass(frozen=True)
class Reference:
    """Exponents that are known independently of this library.

    Attributes:
        exponents: descending; -inf where a reset destroys a direction.
        stderr: one standard deviation each; 0 where the value is exact.
        exact: whether the values are closed forms.
        source: their origin.
        clock: "time" or "jumps": the unit that they are per (an iteration of a map is a jump).
    """

    exponents: tuple[float, ...]
    stderr: tuple[float, ...]
    exact: bool
    source: str
    clock: str = "time"

    def __str__(self) -> str:
        pairs = zip(self.exponents, self.stderr, strict=True)
        values = ", ".join(with_error(value, error) if error else f"{value:.10g}" for value, error in pairs)
        return f"{values} per {'unit time' if self.clock == 'time' else 'jump'} ({self.source})"


def exact(*exponents: float, source: str, clock: str = "time") -> Reference:
    """A reference in closed form, sorted."""
    values = tuple(sorted(map(float, exponents), reverse=True))
    return Reference(values, (0.0,) * len(values), True, source, clock)


def computed(exponents, stderr, *, source: str, clock: str = "time") -> Reference:
    """A reference with standard errors."""
    return Reference(tuple(map(float, exponents)), tuple(map(float, stderr)), False, source, clock)


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
        t1, transient: lengths in units of `clock`, enough for two to four digits.
        clock: "time" or "jumps".
        options: further defaults of `lyapunov_spectrum`.
        reference: independently known exponents; None if there are none for these parameters.
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

    def spectrum(self, **overrides: Any) -> Spectrum:
        """`lyapunov_spectrum` of this problem.

        Args:
            overrides: any argument of `lh.lyapunov_spectrum`; `x0` and `args` too.

        Returns:
            A `Spectrum`.
        """
        own = {"t1": self.t1, "transient": self.transient, "clock": self.clock, **self.options}
        return self._run(lyapunov_spectrum, {**self._start(), **own, **overrides})._with_problem_name(self.name)

    def trajectory(self, **overrides: Any) -> Trajectory:
        """`lh.trajectory` of this problem; without t1 over a hundredth of the length of its spectrum.

        Args:
            overrides: any argument of `lh.trajectory`; `x0` and `args` too.

        Returns:
            A `Trajectory`.

        Raises:
            ValueError: without t1 where a spectrum counts jumps: they are no length of time.

        Example:
            >>> from lyaphybrid import zoo
            >>> zoo.lorenz63().trajectory(t1=1.0, n=4).to_xarray().state.values.tolist()
            ['x', 'y', 'z']
        """
        if "t1" not in overrides:
            discrete = iterates(self.system)
            if self.clock != "time" and not discrete:
                raise ValueError(f"{self.name} counts {self.clock}: give the length of time, trajectory(t1=…).")
            overrides["t1"] = math.ceil(PART * self.t1) if discrete else PART * self.t1
        return self._run(trajectory, {**self._start(), **overrides})

    def floquet(self, **overrides: Any) -> Floquet:
        """`lh.floquet` of this problem, from its start: give a `transient` where the orbit attracts, and its `period`.

        Args:
            overrides: any argument of `lh.floquet`; `x0` and `args` too.

        Returns:
            A `Floquet`.

        Example:
            >>> from lyaphybrid import zoo
            >>> wheel = zoo.rimless_wheel().floquet(transient=20.0)
            >>> wheel.stable, wheel.jumps
            (True, 1)
        """
        return self._run(floquet, {**self._start(), "method": None, **overrides})

    def sweep(self, over: Mapping[str, Any] | None = None, **options: Any) -> "xarray.Dataset":
        """`lh.sweep` of this problem's spectrum: `lh.sweep(problem, over, **options)`.

        Args:
            over: {name: values}, names of entries of `args`, "x0" or "key".
            options: any other argument of `lh.sweep`.

        Returns:
            An `xarray.Dataset`.

        Example:
            >>> from lyaphybrid import zoo
            >>> found = zoo.logistic_map().sweep({"r": [2.8, 2.9]}, progress=False)
            >>> [round(float(value), 6) for value in found.exponents[:, 0]]  # ln|2 − r|
            [-0.223144, -0.105361]
        """
        return sweep(self, over, **options)

    def _start(self) -> dict[str, Any]:
        """What all verbs take."""
        return {"x0": self.x0, "args": self.args, "mode": self.mode, "method": self.method}

    def _run(self, verb: Callable[..., T], keywords: dict[str, Any]) -> T:
        return verb(self.system, keywords.pop("x0"), keywords.pop("args"), **keywords)

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

    A parameter must be of the kind of its default: bool, float or int; other kinds are not checked. Where the
    annotation allows more than `Real`, arrays are not checked.
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


# Checks of parameters. Traced values are not checked.


def number(name: str, value: Any) -> Any:
    """A finite real number as a float; traced scalars are not checked."""
    if traced(value):
        if value.shape != ():
            raise ValueError(f"{name} must be a single number; got an array of shape {value.shape}.")
        return value
    scalar = isinstance(value, int | float | np.number | np.ndarray | Array) and not isinstance(value, bool)
    if not (scalar and np.ndim(value) == 0 and np.isrealobj(value) and np.isfinite(value)):
        raise ValueError(f"{name} must be a finite real number; got {value!r}.")
    return float(value)


def several(name: str, value: Any, n: int) -> Any:
    """A finite real number, or n of them as an array."""
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
    """Raise unless the value is traced or satisfies the condition."""
    if not traced(value) and not holds(value):
        raise ValueError(f"{name} must be {wanted}; got {value!r}.")


def positive(**values: Any) -> None:
    """Raise unless each value is traced or above 0."""
    for name, value in values.items():
        require(name, value, lambda v: bool(np.all(np.asarray(v) > 0)), "positive")


def one_of(name: str, value: Any, choices: tuple[str, ...]) -> None:
    """Raise where the value is not one of the choices."""
    if value not in choices:
        raise ValueError(f"{name} must be one of {', '.join(map(repr, choices))}; got {value!r}.")


def near(value: Any, *wanted: Any) -> bool:
    """Whether the value (a number or several) is not traced and equal to the wanted one up to rounding."""
    given = value if isinstance(value, tuple) else (value,)
    return not traced(given) and all(math.isclose(a, b, rel_tol=1e-12) for a, b in zip(given, wanted, strict=True))


def state(*components: Any) -> Float[Array, " n"]:
    """A state vector in JAX's current default precision."""
    if not traced(*components):
        return jnp.asarray(np.array([float(c) for c in components]), dtype=float)  # compiles nothing
    return jnp.stack([jnp.asarray(c, dtype=float) for c in components])
