"""Explicit Runge–Kutta methods."""

import functools
from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._arguments import is_one_of, positive, require
from .._jax.columns import linear_at
from .._jax.precision import nonzero
from . import tableaux
from .base import Field, Method, Step, Tangent
from .divergences import quadrature

__all__ = [
    "TABLEAUX",
    "RungeKutta",
    "Tableau",
    "along",
    "hermite",
    "summed",
    "tabulated",
    "through",
    "times_of_stages",
    "weighed",
]


class Tableau(NamedTuple):
    """Butcher tableau; ``errors`` holds the weights of one or two error estimates, a row each (none: fixed step)."""

    a: tuple
    b: np.ndarray
    c: tuple
    errors: tuple
    order: int  # of the method; its error estimate is of this power of h, too
    last_is_next: bool  # the last stage is the field at the end of the step (FSAL)
    diagonal: float = 0.0  # a_ii of the stages after the first; if not 0, these stages are implicit
    samples: tuple[int, ...] = ()  # indices of c: stages inside the step whose slopes show what guards do there


def _from_diffrax(solver: type, order: int, samples: tuple[int, ...]) -> Tableau:
    table = solver.tableau
    return Tableau(table.a_lower, table.b_sol, tuple(table.c), (table.b_error,), order, table.fsal, samples=samples)


TABLEAUX = {
    "dopri5": _from_diffrax(diffrax.Dopri5, 5, (0, 1, 2, 3)),
    "tsit5": _from_diffrax(diffrax.Tsit5, 5, (0, 1, 2)),
    "dopri8": _from_diffrax(diffrax.Dopri8, 8, (5, 3, 6, 8, 9)),
    "dop853": Tableau(
        tableaux.DOP853_A,
        tableaux.DOP853_B,
        tableaux.DOP853_C,
        (tableaux.DOP853_E5, tableaux.DOP853_E3),
        8,
        False,
        samples=(2, 3, 8, 9),
    ),
    "rk4": Tableau(tableaux.RK4_A, np.array(tableaux.RK4_B), tableaux.RK4_C, (), 4, False, samples=(1,)),
}


class RungeKutta(Method):
    """An explicit Runge–Kutta method, adaptive (PI control) or with a fixed step.

    Args:
        tableau: "dopri5", "tsit5", "dopri8" (Prince–Dormand 8(7)), "dop853" (8(5,3)) or "rk4".
        rtol: relative tolerance of the local error.
        atol: absolute tolerance of the local error, in units of x.
        dt: a fixed step, in units of time; None: adaptive. Steps are still cut at events.
        control: "xY", the frame's errors are controlled too; "x", the state's alone: steps may be too long for
            perturbations, most of all where the state is at rest.
        max_step: upper limit of adaptive steps, in units of time; None: no limit.

    Raises:
        ValueError: on an unknown tableau or control, on tolerances or steps that are not positive, on "rk4" without
            dt (it has no error estimate), on max_step beside dt.

    Source:
        J. R. Dormand & P. J. Prince, J. Comput. Appl. Math. 6 (1980) 19, doi:10.1016/0771-050X(80)90013-3;
        Ch. Tsitouras, Comput. Math. Appl. 62 (2011) 770, doi:10.1016/j.camwa.2011.06.002;
        E. Hairer, S. P. Nørsett & G. Wanner, Solving ODEs I (1993), doi:10.1007/978-3-540-78862-1.

    Example:
        >>> import lyaphybrid as lh
        >>> lh.RungeKutta("rk4", dt=0.01).adaptive
        False
    """

    tableau: str = eqx.field(static=True)
    control: str = eqx.field(static=True)
    rtol: Any
    atol: Any
    dt: Any
    max_step: Any

    def __init__(
        self,
        tableau: str = "dopri8",
        rtol: Any = 1e-9,
        atol: Any = 1e-12,
        dt: Any = None,
        control: str = "xY",
        max_step: Any = None,
    ):
        if not is_one_of(tableau, TABLEAUX):
            named = "" if isinstance(tableau, str) else " Tolerances are given by name: rtol=…, atol=…."
            raise ValueError(f"Unknown tableau {tableau!r}; the tableaux are {sorted(TABLEAUX)}.{named}")
        if not is_one_of(control, ("x", "xY")):
            raise ValueError(f"control must be 'xY' (state and frame) or 'x' (state alone); got {control!r}.")
        if dt is None and not TABLEAUX[tableau].errors:
            raise ValueError(f"{tableau!r} has no error estimate: give a fixed step, RungeKutta({tableau!r}, dt=…).")
        positive("rtol", rtol)
        positive("atol", atol)
        if dt is not None:
            positive("dt", dt)
        if max_step is not None:
            require(
                dt is None,
                f"max_step = {max_step} is for adaptive steps, and dt = {dt} fixes their length: leave out one.",
            )
            positive("max_step", max_step)
        self.tableau, self.control, self.rtol, self.atol = tableau, control, rtol, atol
        self.dt, self.max_step = dt, max_step

    @property
    def table(self) -> Tableau:
        """The coefficients."""
        return TABLEAUX[self.tableau]

    def stage_times(self, t, h) -> list:
        """The times of the stages."""
        return times_of_stages(tuple(map(float, self.table.c)), t, h)  # Python's: NumPy's make float64 of float32

    @property
    def fixed_step(self) -> Any:
        """The fixed step; None where the error estimate controls h."""
        return self.dt

    @property
    def longest_step(self) -> Any:
        """Upper limit of adaptive steps; None: no limit."""
        return self.max_step

    @property
    def error_order(self) -> int:
        """The order p of the error estimate: it falls as h^p."""
        return self.table.order

    @property
    def stage_count(self) -> int:
        """The number of stage points: all stages but the first, which is the start of the step."""
        return len(self.table.a)

    def step(self, field: Field, t, x, f, h) -> Step:
        """One step over h from (t, x), where f = field(t, x)."""
        table = self.table
        points, slopes = through(
            table, x, h, f, [functools.partial(field, time) for time in self.stage_times(t, h)[1:]]
        )
        new = self._end(x, h, points, slopes)
        slope = slopes[-1] if table.last_is_next else field(t + h, new)
        error = self._errors(h, slopes) if self.adaptive else x[None, :0]
        return Step(
            new,
            slope,
            error,
            (x, f, new, slope, h),
            self.nodes_of(field, t, h, x, points[1:]),
            points[1:],
            tuple(slopes[1:]),
        )

    @property
    def sample_fractions(self) -> tuple[float, ...]:
        """Where in a step `samples` lie: at some of the stages."""
        return tuple(float(self.table.c[i]) for i in self.table.samples)

    def samples(self, field: Field, t, h, step: Step) -> list:
        """Times, states and slopes of some stages inside the step."""
        del field
        times = self.stage_times(t, h)[1:]
        return [(times[i], step.stage_points[i], step.stage_slopes[i]) for i in self.table.samples]

    def tangent(self, field: Field, t, x, h, frame, stage_points=()) -> Tangent:
        """The derivative of the step: the same method for the linear field dx ↦ Df dx at the stage points."""
        if not stage_points:
            return super().tangent(field, t, x, h, frame)
        nodes = self.nodes_of(field, t, h, x, stage_points)
        first, *later = (linear_at(functools.partial(field, time), point) for time, point in zip(*nodes, strict=True))
        tangents, slopes = through(self.table, frame, h, first(frame), later)
        errors = self._errors(h, slopes) if self.adaptive else frame[None, :0]
        return Tangent(None, self._end(frame, h, tangents, slopes), errors, nodes)

    def rare_tangent(self, field: Field, t, x, h, frame, stage_points=()) -> Tangent:
        """The same with a loop over the stages instead of unrolled stages: shorter to compile."""
        if not stage_points:
            return super().rare_tangent(field, t, x, h, frame)
        table, nodes = self.table, self.nodes_of(field, t, h, x, stage_points)
        times, points = (jnp.stack(each) for each in nodes)
        before = jnp.asarray(np.stack([np.pad(row, (0, len(times) - len(row))) for row in ((), *table.a)]), x.dtype)

        def stage(i, slopes):
            along = linear_at(functools.partial(field, times[i]), points[i])
            return slopes.at[i].set(along(frame + h * jnp.tensordot(before[i], slopes, 1)))

        slopes = jax.lax.fori_loop(0, len(times), stage, jnp.zeros((len(times), *frame.shape), frame.dtype))
        errors = self._errors(h, slopes) if self.adaptive else frame[None, :0]
        return Tangent(None, along(frame, h, table.b, slopes), errors, nodes)

    def _end(self, x, h, points, slopes):
        """The end of the step, of a state (n,) or a frame (n, k)."""
        return points[-1] if self.table.last_is_next else along(x, h, self.table.b, slopes)

    def _errors(self, h, slopes):
        return jnp.stack([h * weighed(row, slopes) for row in self.table.errors])

    def points_on(self, field, t, h, stage_points) -> list:
        """The stage points (n,), as a list."""
        del field, t, h
        return list(stage_points)

    def nodes_of(self, field, t, h, x, stage_points):
        """Times and points of the stages."""
        del field
        return self.stage_times(t, h), [x, *stage_points]

    def inside(self, dense, theta):
        """The cubic Hermite interpolant of the step at the fraction theta."""
        x0, f0, x1, f1, h = dense
        return hermite(theta, x0, h * f0, x1, h * f1)

    def ratio(self, error, scale):
        """The error over the tolerance; for DOP853 the combination of its two estimates."""
        if len(self.table.errors) == 1:
            return super().ratio(error, scale)
        fifth, third = (error[0] / scale) ** 2, (error[1] / scale) ** 2
        return jnp.max(fifth / jnp.sqrt(fifth + 0.01 * third + nonzero(1e-40, fifth)))

    def divergence(self, field: Field, nodes, h):
        """∫ tr Df dt over the step by the weights b at the stages."""
        return h * quadrature(field, self.table.b, *nodes)


@functools.partial(jax.jit, static_argnums=0)
def times_of_stages(fractions: tuple[float, ...], t, h) -> list:
    """The times of the stages."""
    return [t, *(t + c * h for c in fractions)]


@jax.jit
def hermite(theta, x0, d0, x1, d1):
    """The cubic with values x0, x1 and slopes d0, d1 (per unit theta) at theta = 0 and 1."""
    other = 1 - theta
    return other**2 * ((1 + 2 * theta) * x0 + theta * d0) + theta**2 * ((3 - 2 * theta) * x1 - other * d1)


def tabulated(table: Tableau, t, h):
    """Weights of the earlier slopes, and times, of all stages but the first, and of the end if it is not a stage."""
    rows, kind = [*table.a, *([] if table.last_is_next else [table.b])], jnp.result_type(h)
    weights = np.stack([np.pad(row, (0, len(rows) + 1 - len(row))) for row in rows])
    fractions = np.array([*table.c, 1.0][: len(rows)])
    return jnp.asarray(weights, kind), t + jnp.asarray(fractions, kind) * h


def summed(weights, slopes: Array) -> Array:
    """The sum Σ w k over the slopes k (stages, …) of the stages that have weights."""
    return jnp.tensordot(jnp.asarray(weights, slopes.dtype), slopes[: len(weights)], 1)


def through(table: Tableau, x, h, first, fields):
    """All stage points and their slopes: `first` at x; `fields` are the functions x -> slope of the later stages."""
    points, slopes = (x,), [first]
    for row, field in zip(table.a, fields, strict=True):
        points += (along(x, h, row, slopes),)
        slopes.append(field(points[-1]))
    return points, slopes


def along(x, h, weights, slopes):
    """The state x + h Σ w k."""
    used = [(float(w), k) for w, k in zip(weights, slopes, strict=False) if w != 0]
    weights, slopes = zip(*used, strict=True)
    return _along(weights, x, h, slopes)


@functools.partial(jax.jit, static_argnums=0)
def _along(weights, x, h, slopes):
    """The state x + h Σ w k; the last slope, which is known latest, then needs one multiply–add only."""
    steps = [(w * h, k) for w, k in zip(weights, slopes, strict=True)]
    *early, (last, latest) = steps
    base = x + _sum([step * k for step, k in early]) if early else x
    return base + last * latest


def weighed(weights, slopes):
    """The sum Σ w k over a list of slopes."""
    used = [(float(w), k) for w, k in zip(weights, slopes, strict=False) if w != 0]
    weights, slopes = zip(*used, strict=True)
    return _weighed(weights, slopes)


@functools.partial(jax.jit, static_argnums=0)
def _weighed(weights, slopes):
    return _sum([w * k for w, k in zip(weights, slopes, strict=True)])


def _sum(terms):
    return sum(terms[1:], terms[0])
