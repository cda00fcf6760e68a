"""Radau IIA with three stages, of order 5, for E(t) x' = f(t, x): its stages are solved simultaneously.

Collocation for the differential part w = E₁ x: with w' = E₁' x + f₁ (eq. (9) of Linh et al.),

    E₁(t_i) x_i − h Σ_j a_ij w'(t_j, x_j) = w(t),   f₂(t_i, x_i) = 0,   t_i = t + c_i h,   x(t + h) = x_3.

The error estimate compares with a method of order 3 that uses these nodes and the start of the step (Hairer & Wanner,
IV.8): the weight at the start is γ, the inverse of the real eigenvalue of A⁻¹, and the difference of both methods is
multiplied by (E₁ − γ h ∂w'/∂x)⁻¹, without which it would be far too large for stiff equations.
"""

from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..._jax.columns import linear_at
from ..._linalg.linear_systems import UNROLLED, FactoredInverse, factored, inverse, matmul
from ...systems.daes.points import solved
from ...systems.daes.semi_linear import Constrained, InverseBlocks, parts_of
from ..base import Field, Step, Tangent
from ..divergences import quadrature
from .linearised import linearised
from .on_constraints import ConstrainedMethod, check_control

__all__ = ["RadauIIA", "estimate"]

C = np.array([(4 - np.sqrt(6)) / 10, (4 + np.sqrt(6)) / 10, 1.0])
STAGES = len(C)
POWERS = C[:, None] ** np.arange(STAGES)  # Σ_j a_ij c_j^q = c_i^(q + 1) / (q + 1)
A = (C[:, None] * POWERS / np.arange(1, STAGES + 1)) @ np.linalg.inv(POWERS)
REAL_EIGENVALUES = [value.real for value in np.linalg.eigvals(np.linalg.inv(A)) if value.imag == 0]
GAMMA = float(1 / REAL_EIGENVALUES[0])
# Weights of the error estimate at the stages: the quadrature of order 3, with γ at the start, minus that of order 5.
# They apply to the increments h Σ a_ij w'_j of w from the start to the stages, so that no slopes are needed.
ERROR_WEIGHTS = np.linalg.solve(A.T, np.linalg.solve(POWERS.T, [-GAMMA, 0.0, 0.0]))


class OfStages(eqx.Module):
    """What a change of the differential parts of all stages (3 d,) does to their points, as a linear function."""

    lifts: Array  # (3, n, d), L_i
    factors: FactoredInverse  # (3 d, 3 d): s ↦ u

    @property
    def shape(self) -> tuple[int, int]:
        """(3 n, 3 d)."""
        return self.lifts.shape[0] * self.lifts.shape[1], self.factors.shape[1]

    def __matmul__(self, s):
        u = (self.factors @ s).reshape(STAGES, self.lifts.shape[2], -1)
        return jnp.matmul(self.lifts, u).reshape(-1, *s.shape[1:])


class OfConstraints(eqx.Module):
    """What a change of the constraints of all stages (3 (n − d),) does to their points, as a linear function."""

    of_stages: OfStages
    falls: Array  # (3, n, n − d), K_i
    mixed: Array  # (3 d, 3 (n − d)): h Σ_j a_ij ∂w'/∂x_j K_j

    @property
    def shape(self) -> tuple[int, int]:
        """(3 n, 3 (n − d))."""
        return self.of_stages.shape[0], self.mixed.shape[1]

    def __matmul__(self, r):
        own = jnp.matmul(self.falls, r.reshape(STAGES, self.falls.shape[2], -1)).reshape(-1, *r.shape[1:])
        return own + self.of_stages @ (self.mixed @ r)


class StagesTogether(eqx.Module):
    """The equations of all stages as those of one point (3 n,) with a differential part (3 d,), at three times."""

    dae: Constrained

    @property
    def n_differential(self) -> int:
        """3 d, the number of differential components."""
        return STAGES * self.dae.n_differential

    def _each(self, part, t, x, args):
        return jax.vmap(lambda t, x: part(t, x, args))(t, x.reshape(STAGES, -1))

    def differential_part(self, t, x, args):
        """The differential parts E₁ x of all stages (3 d,)."""
        return self._each(self.dae.differential_part, t, x, args).ravel()

    def slope(self, t, x, args):
        """The sums Σ_j a_ij w'_j of all stages (3 d,)."""
        return (jnp.asarray(A, x.dtype) @ self._each(self.dae.slope, t, x, args)).ravel()

    def constraint(self, t, x, args):
        """The constraints f₂ of all stages (3 (n − d),)."""
        return self._each(self.dae.constraint, t, x, args).ravel()

    def inverse_blocks(self, t, x, args, share) -> InverseBlocks:
        """The inverse of the Jacobian of all these equations; only a matrix (3 d, 3 d) is inverted.

        With Ē⁻¹ = [L K] in each stage, a Newton correction is δx_i = L_i u_i + K_i r_i, where s_i (d,) and r_i (n − d,)
        are the residuals of the differential equations and of the constraints of stage i, and u_i (d,) solves

            u_i − h Σ_j a_ij ∂w'/∂x_j L_j u_j = s_i + h Σ_j a_ij ∂w'/∂x_j K_j r_j.
        """

        def of_stage(t, x):
            inverse_blocks = self.dae.inverse_blocks(t, x, args)
            both = jnp.concatenate([inverse_blocks.differential_part, inverse_blocks.constraint], axis=1)
            return (
                inverse_blocks.differential_part,
                inverse_blocks.constraint,
                linear_at(lambda x: self.dae.slope(t, x, args), x)(both),
                inverse_blocks.terms,
            )

        differential_part, constraint, slopes, terms = jax.vmap(of_stage)(t, x.reshape(STAGES, -1))
        mixed = share * jnp.einsum("ij,jab->iajb", jnp.asarray(A, x.dtype), slopes)
        d, size = self.dae.n_differential, self.n_differential
        matrix = jnp.eye(size, dtype=x.dtype) - mixed[..., :d].reshape(size, size)
        if size > UNROLLED:
            factors, sign = factored(matrix)
            of_stages = OfStages(differential_part, factors)
            of_constraints: Any = jnp.zeros((x.size, 0), x.dtype)
            if x.size > size:
                of_constraints = OfConstraints(of_stages, constraint, mixed[..., d:].reshape(size, -1))
            return InverseBlocks(of_stages, of_constraints, sign, terms.ravel())
        turned, sign = inverse(matrix)
        of_content = jnp.einsum("ina,iab->inb", differential_part, turned.reshape(STAGES, d, size)).reshape(-1, size)
        own = jnp.einsum("ij,inb->injb", jnp.eye(STAGES, dtype=x.dtype), constraint).reshape(x.size, -1)
        of_constraint = own + matmul(of_content, mixed[..., d:].reshape(size, -1))
        return InverseBlocks(of_content, of_constraint, sign, terms.ravel())


class RadauIIA(ConstrainedMethod):
    """The Radau IIA method with three stages, of order 5, for a stiff `lh.DAE` or `lh.Flow`.

    An L-stable collocation method whose stages are solved simultaneously by Newton's method. Errors and steps as for
    `lh.HalfExplicit`. The error estimate has order 3: steps are shorter, and results more accurate, than the tolerance
    demands. For some fifty components or more `lh.ESDIRK` is faster: here a matrix of 3 n rows is decomposed.

    Args:
        rtol: relative tolerance of the local error.
        control: "xY", the frame's errors are controlled too; "x", the state's alone: steps may be too long for
            perturbations, most of all where the state is at rest.
        atol: absolute tolerance of the local error, in units of x.

    Raises:
        ValueError: on an unknown control, on tolerances that are not positive.

    Source:
        E. Hairer & G. Wanner, Solving ODEs II (1996), sections IV.5 and IV.8, doi:10.1007/978-3-642-05221-7;
        V. H. Linh & N. D. Truong, Electron. Trans. Numer. Anal. 48 (2018) 131, doi:10.1553/etna_vol48s131.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> fast = lh.Flow(lambda t, x, rate: jnp.stack([-x[0], -rate * (x[1] - jnp.sin(x[0]))]))
        >>> method = lh.RadauIIA(1e-6)
        >>> s = lh.lyapunov_spectrum(fast, [1.0, 0.0], 1e6, t1=50.0, transient=50.0, k=1, method=method, max_steps=1000)
        >>> round(float(s.exponents[0]), 6)
        -1.0
    """

    control: str = eqx.field(static=True)
    rtol: Any
    atol: Any

    error_order: ClassVar[int] = 4  # pyright: ignore[reportIncompatibleMethodOverride]  a constant serves as a property
    stage_count: ClassVar[int] = STAGES  # pyright: ignore[reportIncompatibleMethodOverride]

    def __init__(self, rtol: Any = 1e-8, control: str = "xY", *, atol: Any = 1e-12):
        check_control(rtol, atol, control)
        self.rtol, self.control, self.atol = rtol, control, atol

    def stage_times(self, t, h):
        """The times of the stages (3,)."""
        return t + jnp.asarray(C, jnp.result_type(h)) * h

    def step(self, field: Field, t, x, f, h) -> Step:
        """One step over h from (t, x)."""
        dae, args = parts_of(field, x.shape[0])
        at, start, slope = self.stage_times(t, h), dae.differential_part(t, x, args), dae.slope(t, x, args)
        ahead = start[None] + jnp.outer(at - t, slope)
        inverse_blocks = dae.inverse_blocks(t, x, args).differential_part
        guess = jax.vmap(lambda at, ahead: x + matmul(inverse_blocks, ahead - dae.differential_part(at, x, args)))(
            at, ahead
        )
        stages, guess = StagesTogether(dae), guess.ravel()
        known = stages.inverse_blocks(at, guess, args, h) if stages.n_differential > UNROLLED else None
        points, _ = solved(stages, args, at, jnp.tile(start, STAGES), guess, self.point_tolerance, h, known)
        points = points.reshape(STAGES, -1)
        new = points[-1]
        beyond = jax.vmap(lambda at, x: dae.differential_part(at, x, args))(at, points) - start[None]
        error = matmul(dae.inverse_blocks(t, x, args, GAMMA * h).differential_part, estimate(h, slope, beyond))
        slope = field(t + h, new)
        return Step(new, slope, error[None], (x, f, new, slope, h), (at, points), (points,))

    def tangent(self, field: Field, t, x, h, frame, stage_points=()) -> Tangent:
        """The same method for the linearised equations, at the same stage points."""
        new = None
        if not stage_points:
            done = self.step(field, t, x, field(t, x), h)
            stage_points, new = done.stage_points, done.x
        (points,), at = stage_points, self.stage_times(t, h)
        dae, args = parts_of(field, x.shape[0])
        here = linearised(field, t, x, GAMMA * h)
        start = here.differential_part(frame)
        inverse_blocks = StagesTogether(dae).inverse_blocks(at, points.ravel(), args, h).differential_part
        stages = matmul(inverse_blocks, jnp.tile(start, (STAGES, 1))).reshape(STAGES, *frame.shape)
        beyond = jax.vmap(lambda at, stage: dae.differential_part(at, stage, args))(at, stages) - start[None]
        errors = matmul(here.inverse_block, estimate(h, here.slope(frame), beyond))
        return Tangent(new, stages[-1], errors[None], (at, points))

    def divergence(self, field: Field, nodes, h):
        """∫ tr Df dt over the step by the weights of the last stage."""
        return h * quadrature(field, A[-1], *nodes)


def estimate(h, slope, beyond):
    """The difference of the methods of orders 3 and 5, of w (d,) or of its columns (d, k)."""
    return GAMMA * h * slope + jnp.tensordot(jnp.asarray(ERROR_WEIGHTS, beyond.dtype), beyond, 1)
