"""Runge–Kutta methods for E(t) x' = f(t, x): half-explicit, and diagonally implicit with an explicit first stage.

They integrate the differential part w = E₁ x (d,), (E₁ x)' = E₁' x + f₁, and each stage solves for the state x that
has this differential part and satisfies the constraints. So they keep the order that they have for ordinary
differential equations; applied directly to E x' = f they would lose it where E depends on time.

V. H. Linh & N. D. Truong, Electron. Trans. Numer. Anal. 48 (2018) 131, doi:10.1553/etna_vol48s131.
"""

import functools
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..._arguments import is_one_of, require
from ..._jax.columns import linear_at
from ..._linalg.linear_systems import UNROLLED, matmul
from ...systems.daes.eliminations import Eliminated
from ...systems.daes.points import solved
from ...systems.daes.semi_linear import parts_of
from ..base import Field, Step, Tangent
from ..divergences import quadrature
from ..runge_kutta import TABLEAUX, Tableau, along, summed, tabulated, through, times_of_stages, weighed
from .implicit_tableaux import IMPLICIT
from .linearised import linearised
from .on_constraints import ConstrainedMethod, check_control

__all__ = ["ESDIRK", "HalfExplicit"]

EXPLICIT = tuple(name for name, table in TABLEAUX.items() if len(table.errors) == 1)


class StageByStage(ConstrainedMethod):
    """Base class of the methods whose stages are solved one after the other."""

    tableau: eqx.AbstractVar[str]

    @property
    def table(self) -> Tableau:
        """The coefficients."""
        return TABLEAUX[self.tableau] if self.tableau in TABLEAUX else IMPLICIT[self.tableau]

    @property
    def error_order(self) -> int:
        """The order p of the error estimate: it falls as h^p."""
        return self.table.order

    @property
    def stage_count(self) -> int:
        """The number of stage points: all stages but the first, and the end of the step if it is not a stage."""
        return len(self.table.a) + (not self.table.last_is_next)

    def stages(self, t, h):
        """For these points: weights of the earlier slopes, times, and shares h a_ii of their own slopes.

        The shares are None for an explicit tableau; the end of the step has share 0.
        """
        weights, times = tabulated(self.table, t, h)
        own = np.arange(self.stage_count) < len(self.table.a)
        return weights, times, self.table.diagonal * h * jnp.asarray(own, times.dtype) if self.table.diagonal else None

    def _is_direct(self, field: Field) -> bool:
        return not self.table.diagonal and isinstance(getattr(field, "field", None), Eliminated)

    def step(self, field: Field, t, x, f, h) -> Step:
        """One step over h from (t, x)."""
        if self._is_direct(field):
            return self._directly(field, t, x, f, h)
        dae, args = parts_of(field, x.shape[0])
        start, slope, inverse_blocks = (
            dae.differential_part(t, x, args),
            dae.slope(t, x, args),
            dae.inverse_blocks(t, x, args),
        )
        sign, keeps = inverse_blocks.sign, self.table.diagonal and x.shape[0] > UNROLLED
        if keeps:  # all stages have the same share: the inverse at the start serves them as long as it is good enough
            inverse_blocks = dae.inverse_blocks(t, x, args, self.table.diagonal * h)

        def stage(state, given):
            point, inverse_blocks, slopes, last, same = state
            i, weights, at, share = given
            base = start + h * (weights @ slopes)
            ahead = base if share is None else base + share * last
            guess = point + matmul(inverse_blocks.differential_part, ahead - dae.differential_part(at, point, args))
            known = inverse_blocks if keeps else None
            point, inverse_blocks = solved(dae, args, at, base, guess, self.point_tolerance, share, known)
            slope = dae.slope(at, point, args)
            # If det Ē changes its sign, the step has crossed a singular point and must be rejected.
            same = same & ((inverse_blocks.sign == sign) if share is None else True)
            return (point, inverse_blocks, slopes.at[i].set(slope), slope, same), point

        slopes = jnp.zeros((self.stage_count + 1, *slope.shape), slope.dtype).at[0].set(slope)
        given = jnp.arange(1, self.stage_count + 1), *self.stages(t, h)
        (new, inverse_blocks, slopes, _, same), stage_points = jax.lax.scan(
            stage, (x, inverse_blocks, slopes, slope, jnp.asarray(True)), given
        )
        error = jnp.where(
            same, matmul(inverse_blocks.differential_part, h * summed(self.table.errors[0], slopes)), jnp.inf
        )
        slope = field(t + h, new)
        return Step(
            new,
            slope,
            error[None],
            (x, f, new, slope, h),
            self.nodes_of(field, t, h, x, (stage_points,)),
            (stage_points,),
        )

    def _directly(self, field: Any, t, x, f, h) -> Step:
        """A step where the constraints are solved in closed form: the ordinary Runge–Kutta method for E₁ x."""
        dae = field.field
        new, error, differential_parts = self._of_content(dae, t, dae.differential_part(t, x, None), h)
        stage_points = (
            jnp.stack(differential_parts[1:] if self.table.last_is_next else [*differential_parts[1:], new]),
        )
        x_new = jnp.stack(dae.components(t + h, new))
        error, slope = dae.raised(dae.sensitivity(t + h, x_new), error), field(t + h, x_new)
        return Step(
            x_new,
            slope,
            error[None],
            (x, f, x_new, slope, h),
            self.nodes_of(field, t, h, x, stage_points),
            stage_points,
        )

    def _of_content(self, dae: Eliminated, t, differential_part, h):
        """E₁ x (d,) after the step, its error estimate, and its values in all stages."""
        table = self.table
        slope_of = jax.jit(functools.partial(Eliminated.slope_of, dae))  # traced once, not in each stage
        first, *later = (functools.partial(slope_of, time) for time in self.stage_times(t, h))
        points, slopes = through(table, differential_part, h, first(differential_part), later)
        new = points[-1] if table.last_is_next else along(differential_part, h, table.b, slopes)
        return new, h * weighed(table.errors[0], slopes), list(points)

    def _tangent_directly(self, field: Any, t, x, h, frame, stage_points, new) -> Tangent:
        dae, table, slope_of = field.field, self.table, jax.jit(functools.partial(Eliminated.slope_of, field.field))
        differential_parts = [dae.differential_part(t, x, None), *stage_points[: len(table.a), : dae.n_differential]]
        nodes = zip(self.stage_times(t, h), differential_parts, strict=True)
        first, *later = (
            linear_at(functools.partial(slope_of, time), differential_part) for time, differential_part in nodes
        )
        change = dae.differential_part(t, frame, None)
        changes, slopes = through(table, change, h, first(change), later)
        moved = changes[-1] if table.last_is_next else along(change, h, table.b, slopes)
        errors = h * weighed(table.errors[0], slopes)
        sensitivity = dae.sensitivity(t + h, self.points_on(field, t, h, (stage_points,))[-1])
        moved, errors = dae.raised(sensitivity, moved), dae.raised(sensitivity, errors)
        return Tangent(new, moved, errors[None], self.nodes_of(field, t, h, x, (stage_points,)))

    def tangent(self, field: Field, t, x, h, frame, stage_points=()) -> Tangent:
        """The same method for the linearised equations, with the same stages."""
        (stage_points,), new = (stage_points, None) if stage_points else self._on_the_way(field, t, x, h)
        if self._is_direct(field):
            return self._tangent_directly(field, t, x, h, frame, stage_points, new)
        first = linearised(field, t, x)
        start, slope = first.differential_part(frame), first.slope(frame)

        def stage(state, given):
            _, _, slopes = state
            i, (weights, at, share), point = given
            here = linearised(field, at, point, share)
            moved = matmul(here.inverse_block, start + h * jnp.tensordot(weights, slopes, 1))
            return (moved, here.inverse_block, slopes.at[i].set(here.slope(moved))), None

        slopes = jnp.zeros((self.stage_count + 1, *slope.shape), slope.dtype).at[0].set(slope)
        given = jnp.arange(1, self.stage_count + 1), self.stages(t, h), stage_points
        (moved, inverse_block, slopes), _ = jax.lax.scan(stage, (frame, first.inverse_block, slopes), given)
        errors = matmul(inverse_block, h * summed(self.table.errors[0], slopes))
        return Tangent(new, moved, errors[None], self.nodes_of(field, t, h, x, (stage_points,)))

    def _on_the_way(self, field, t, x, h):
        done = self.step(field, t, x, field(t, x), h)
        return done.stage_points, done.x

    def stage_times(self, t, h) -> list:
        """The times of the stages."""
        return times_of_stages(tuple(self.table.c), t, h)

    def points_on(self, field, t, h, stage_points) -> list:
        """The stage points (n,); `stage_points` holds those of a direct step as E₁ x."""
        if not self._is_direct(field):
            return list(stage_points[0])
        point_of = jax.jit(lambda t, w: jnp.stack(field.field.components(t, w)))
        times = [*self.stage_times(t, h)[1:], t + h]
        return [point_of(at, w) for at, w in zip(times, stage_points[0][:, : field.field.n_differential], strict=False)]

    def nodes_of(self, field, t, h, x, stage_points):
        """Times and points of the stages."""
        return self.stage_times(t, h), [x, *self.points_on(field, t, h, stage_points)[: len(self.table.c)]]

    def divergence(self, field: Field, nodes, h):
        """∫ tr Df dt over the step by the weights b at the stages."""
        return h * quadrature(field, self.table.b, *nodes)


class HalfExplicit(StageByStage):
    """An explicit Runge–Kutta method for an `lh.DAE`, with error control; the constraints hold in every stage.

    A step passes where |error_i| ≤ atol + rtol |x_i| for each component of the state and, with control="xY", where that
    of each column of the frame is below rtol in units of its length; h ← 0.9 h (tolerance/error)^(1/p), by no more than
    a factor of 5. With atol = rtol errors are compared with rtol (1 + |x_i|), as in the source.

    Args:
        rtol: relative tolerance of the local error.
        control: "xY", the frame's errors are controlled too; "x", the state's alone: steps may be too long for
            perturbations, most of all where the state is at rest.
        tableau: "dopri5", "tsit5" or "dopri8".
        atol: absolute tolerance of the local error, in units of x.

    Raises:
        ValueError: on an unknown tableau or control, on tolerances that are not positive.

    Source:
        V. H. Linh & V. Mehrmann, J. Comput. Appl. Math. 262 (2014) 346, doi:10.1016/j.cam.2013.09.049.

    Example:
        >>> import lyaphybrid as lh
        >>> lh.HalfExplicit(rtol=1e-6).tableau
        'dopri5'
    """

    tableau: str = eqx.field(static=True)
    control: str = eqx.field(static=True)
    rtol: Any
    atol: Any

    def __init__(self, rtol: Any = 1e-9, control: str = "xY", tableau: str = "dopri5", *, atol: Any = 1e-12):
        _check(rtol, atol, control, tableau, EXPLICIT)
        self.rtol, self.control, self.tableau, self.atol = rtol, control, tableau, atol


class ESDIRK(StageByStage):
    """A singly diagonally implicit Runge–Kutta method with an explicit first stage, for a stiff `lh.DAE` or `lh.Flow`.

    Errors and steps as for `lh.HalfExplicit`.

    An error of a column is compared with the column's length at that step. Where the motion relaxes, the column along
    it falls by orders of magnitude within a thin layer, and an earlier error is large beside what is left. Along van
    der Pol's oscillator with μ = 1000 its growth is off by about 10⁶ rtol: there take rtol = 1e-10 (a growth to 1e-4).

    Args:
        tableau: "esdirk34" (Jørgensen, Kristensen & Thomsen; advances with its weights of order 4), "esdirk54b"
            (advances with its weights of order 5; those of order 4 are L-stable), "kvaerno3", "kvaerno4" or "kvaerno5".
        rtol: relative tolerance of the local error.
        atol: absolute tolerance of the local error, in units of x.
        control: "xY", the frame's errors are controlled too; "x", the state's alone: steps may be too long for
            perturbations, most of all where the state is at rest.

    Raises:
        ValueError: on an unknown tableau or control, on tolerances that are not positive.

    Source:
        J. B. Jørgensen, M. R. Kristensen & P. G. Thomsen, A family of ESDIRK integration methods (2018),
        arXiv:1803.01613; A. Kværnø, BIT 44 (2004) 489, doi:10.1023/B:BITN.0000046811.70614.38.

    Example:
        >>> import lyaphybrid as lh
        >>> lh.ESDIRK("kvaerno5", rtol=1e-8).error_order
        5
    """

    tableau: str = eqx.field(static=True)
    control: str = eqx.field(static=True)
    rtol: Any
    atol: Any

    def __init__(self, tableau: str = "kvaerno5", rtol: Any = 1e-8, control: str = "xY", *, atol: Any = 1e-12):
        _check(rtol, atol, control, tableau, tuple(IMPLICIT))
        self.rtol, self.control, self.tableau, self.atol = rtol, control, tableau, atol


def _check(rtol, atol, control, tableau, known) -> None:
    require(is_one_of(tableau, known), f"Unknown tableau {tableau!r}; the tableaux are {', '.join(known)}.")
    check_control(rtol, atol, control)
