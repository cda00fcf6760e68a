"""The continuous QR method: integrates the orthonormal columns Q and, with them, the logarithms φ of their growth.

    Y = Q R,  Y' = D Y   ⟹   W = Qᵀ D Q,   Q' = D Q − Q B,   B = upp(W) + low(W)ᵀ,   φ_i' = w_ii,   φ_i = ln R_ii

For E(t) x' = f, D = Ē⁻¹ [A₁; −A₂']. Equations (20)–(29) of Linh et al. are equivalent, with PᵀĒ = 𝓔Qᵀ and 𝓔W = PᵀĀQ:
because Q has orthonormal columns, 𝓔⁻¹Pᵀ = QᵀĒ⁻¹, and P and 𝓔 cancel. The tests compare with P and 𝓔.

L. Dieci, R. D. Russell & E. S. Van Vleck, SIAM J. Numer. Anal. 34 (1997) 402, doi:10.1137/S0036142993247311.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._arguments import require
from .._linalg.frames import kind_for, orthonormalise
from .._linalg.linear_systems import matmul
from ..systems.daes.semi_linear import is_constrained
from .base import Field, Method, OfAnother, Step, Tangent
from .implicit import radau
from .implicit.half_explicit import ESDIRK, HalfExplicit
from .implicit.linearised import FrameFunctions, linearised
from .implicit.orthonormal_stages import StageMatrices, solved_columns
from .implicit.radau import RadauIIA
from .runge_kutta import RungeKutta, Tableau, summed, tabulated

__all__ = ["ContinuousQR"]


class ContinuousQR(OfAnother):
    """The continuous QR method in the stages of a Runge–Kutta method.

    Where directions turn slowly it takes larger steps than the discrete method, whose steps must resolve the growth of
    the frame: if the rate of growth is smooth, a column may grow by e^1000 within one step. Columns are
    orthonormalised after each step. With the method's control "xY" the errors of Q are controlled as those of x, and
    that of φ over a step is kept below the tolerance times h + max |Δφ|: exponents are means over time.

    Args:
        method: an adaptive `lh.HalfExplicit` (for an `lh.DAE`) or `lh.RungeKutta` (for an `lh.Flow`); for stiff
            equations `lh.ESDIRK` or `lh.RadauIIA`, whose stages solve for Q by Newton's method, one column after the
            other: d or 3 d equations each.

    Raises:
        ValueError: on another method, or a fixed step.

    Source:
        V. H. Linh, N. D. Truong & P. Q. Tuyen, DAE Panel 3 (2025), doi:10.52825/dae-p.v3i.2632, Algorithm 3.3.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> fading = lh.Flow(lambda t, x, args: x * jnp.array([1.0, -2.0]) / (1 + t))
        >>> method = lh.ContinuousQR(lh.RungeKutta("dopri5", rtol=1e-8))
        >>> s = lh.lyapunov_spectrum(fading, [0.0, 0.0], t1=1e6, method=method, blocks=2)
        >>> [round(1e6 * float(value) / float(jnp.log1p(1e6)), 6) for value in s.exponents]
        [1.0, -2.0]
    """

    method: Any

    def __init__(self, method: Method):
        if not isinstance(method, HalfExplicit | ESDIRK | RadauIIA | RungeKutta):
            raise ValueError(
                "ContinuousQR runs in the stages of lh.HalfExplicit, lh.ESDIRK, lh.RadauIIA or lh.RungeKutta; "
                f"got {type(method).__name__}."
            )
        require(
            method.adaptive,
            f"ContinuousQR needs a method that controls its step; got one with dt = {method.fixed_step}: leave out dt.",
        )
        if not isinstance(method, RadauIIA):
            one = len(method.table.errors) == 1
            require(
                one,
                f"ContinuousQR needs one error estimate, and {method.tableau!r} has two: take 'dopri8' or 'dopri5'.",
            )
        self.method = method

    def loosened(self, least: float) -> "ContinuousQR":
        """The same with the inner method loosened."""
        return ContinuousQR(self.method.loosened(least))

    @property
    def inner(self) -> Any:
        """The inner method, which makes the steps of the state."""
        return self.method

    @property
    def control(self) -> str:
        """That of the inner method."""
        return self.method.control

    @property
    def takes_slope(self) -> bool:
        """That of the inner method."""
        return self.method.takes_slope

    @property
    def keeps_constraints(self) -> bool:
        """That of the inner method."""
        return self.method.keeps_constraints

    def solves(self, field: Field) -> bool:
        """True: the stage points are kept, because the tangent linearises the field there."""
        del field
        return True

    @property
    def stage_count(self) -> int:
        """That of the inner method."""
        return self.method.stage_count

    def require(self, field: Field, t, x) -> None:
        """The requirements of the inner method."""
        self.method.require(field, t, x)

    def step(self, field: Field, t, x, f, h) -> Step:
        """The inner method's step of the state."""
        return self.method.step(field, t, x, f, h)

    def inside(self, dense, theta):
        """The inner method's dense output."""
        return self.method.inside(dense, theta)

    def divergence(self, field: Field, nodes, h):
        """∫ tr Df dt by the inner method."""
        return self.method.divergence(field, nodes, h)

    def state_ratio(self, step: Step, x):
        """The error of the state over the tolerance, by the inner method."""
        return self.method.state_ratio(step, x)

    def frame_ratio(self, errors, frame, new):
        """The error over the tolerance: the larger of those of Q and of φ."""
        of_columns = self.method.frame_ratio(errors[:, :-1], frame, new)
        return jnp.maximum(of_columns, jnp.max(jnp.abs(errors[0, -1])) / self.rtol)

    def blank_stage_points(self, x) -> tuple[Array, ...]:
        """Those of the inner method."""
        return self.method.blank_stage_points(x)

    def tangent(self, field: Field, t, x, h, frame, stage_points=()) -> Tangent:
        """Q after the step, and the increments of φ (k,)."""
        new = None
        if not stage_points:
            done = self.method.step(field, t, x, field(t, x), h)
            stage_points, new = done.stage_points, done.x
        if isinstance(self.method, RadauIIA):
            (points,), times = stage_points, self.method.stage_times(t, h)
            nodes = times, points
            columns, of_columns, growth, error = _all_stages(field, t, x, h, frame, times, points, self.rtol)
        else:
            table, points = self.method.table, self.method.points_on(field, t, h, stage_points)
            nodes = self.method.nodes_of(field, t, h, x, stage_points)
            columns, of_columns, rates = _through_stages(table, field, t, x, h, frame, points, self.rtol)
            growth, error = (h * summed(one, rates) for one in (table.b, table.errors[0]))
        size = jnp.abs(h) + jnp.max(jnp.abs(growth))  # scale of φ's error: exponents are means over time
        orthonormal, *_ = orthonormalise(columns, kind_for(frame.shape[1]))
        errors = jnp.concatenate([of_columns, (error / size)[None, :]])
        return Tangent(new, orthonormal, errors[None], nodes, growth)


def _through_stages(table: Tableau, field, t, x, h, frame, points, tolerance):
    """Q after the step, its error, and the rates (stages, k)."""
    weights, times = tabulated(table, t, h)
    # Points of the stages and of the end; for an ordinary field nothing that is computed at the end is used: any point.
    points = jnp.stack(points if is_constrained(field) else [*points, x])[: len(times)]
    first = linearised(field, t, x)
    start, (slope, rate) = first.differential_part(frame), _turned(first, frame)

    def stage(state, given):
        columns, _, slopes, rates = state
        i, weights, at, point, share = given
        here = linearised(field, at, point)
        base = start + h * jnp.tensordot(weights, slopes, 1)
        if table.diagonal:
            guess, together = (
                here.differential_part(columns),
                jax.tree.map(lambda one: one[None], StageMatrices.of(here)),
            )
            solved = solved_columns(together, share[None, None], base[None], guess[None], tolerance)
            part, slope, rate = (one[0] for one in solved)
            columns = matmul(here.inverse_block, part)
        else:
            columns = matmul(here.inverse_block, base)
            slope, rate = _turned(here, columns)
        return (columns, here.inverse_block, slopes.at[i].set(slope), rates.at[i].set(rate)), None

    slopes, rates = (jnp.zeros((len(times) + 1, *one.shape), one.dtype).at[0].set(one) for one in (slope, rate))
    own = np.arange(len(times)) < len(table.a)
    shares = table.diagonal * h * jnp.asarray(own, times.dtype)
    given = jnp.arange(1, len(times) + 1), weights, times, points, shares
    (columns, inverse_block, slopes, rates), _ = jax.lax.scan(stage, (frame, first.inverse_block, slopes, rates), given)
    return columns, matmul(inverse_block, h * summed(table.errors[0], slopes)), rates


def _all_stages(field, t, x, h, frame, times, points, tolerance):
    """Q after a step by Radau IIA, its error, the growth (k,) over the step and its error.

    The equations of the differential parts C_i = E₁ Q_i of the stages are C_i − h Σ_j a_ij C_j' = E₁ Q.
    """
    first = linearised(field, t, x)
    start, (slope, rate) = first.differential_part(frame), _turned(first, frame)
    stages = [linearised(field, *node) for node in zip(times, points, strict=True)]
    together = jax.tree.map(lambda *each: jnp.stack(each), *(StageMatrices.of(here) for here in stages))
    weights, base = h * jnp.asarray(radau.A, x.dtype), jnp.repeat(start[None], len(stages), axis=0)
    parts, _, rates = solved_columns(together, weights, base, base, tolerance)
    grown = matmul(weights, rates)  # from the start to each stage
    damped = linearised(field, t, x, radau.GAMMA * h).inverse_block
    of_columns = matmul(damped, radau.estimate(h, slope, parts - start[None]))
    return matmul(stages[-1].inverse_block, parts[-1]), of_columns, grown[-1], radau.estimate(h, rate, grown)


def _turned(here: FrameFunctions, columns):
    """The derivative (E₁ Q)' (d, k) and the rates of growth w_ii (k,)."""
    turning = matmul(columns.T, here.derivative(columns))
    upper = jnp.triu(turning) + jnp.tril(turning, -1).T
    return here.slope(columns) - matmul(here.differential_part(columns), upper), jnp.diagonal(turning)
