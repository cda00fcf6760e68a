"""Alternatives to the tangent map: the tangent dynamics Hamiltonian, with D²V frozen at points of the orbit.

H_T(δq, δp, t) = ½ δpᵀ T'' δp + ½ δqᵀ D²V(q(t)) δq. The orbit is integrated first, by any method, and D²V(q) is known
only at its points. These methods are here for comparison: their tangent is not the derivative of their step, so λ₁ of
a regular orbit levels off at a value above 0, which decreases only with the step.
"""

import math
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.scipy.linalg

from ..._arguments import is_one_of, positive, require
from ..._jax.columns import each_column
from ..._jax.tracing import traced
from ...systems.hamiltonians import halves
from ..base import Controller, Method, Step, Tangent
from .splittings import PART_A, SCHEMES, Scheme
from .symplectic import Composition, Symplectic, separable

__all__ = ["TangentHamiltonian"]

ORBIT = "SBAB2C"
SCHEME_AND_KICKS = {  # variant: its scheme, and for each kick the index of the orbit's point at which D²V is taken
    "cc": ("SBAB2C", (0, 0, 0)),
    "eps": ("SBAB2C", (0, 1, 2)),
    "eps-kick": ("SBAB1", (0, 1)),
    "eps-drift": ("SABA1", (1,)),
}
VARIANTS = (*SCHEME_AND_KICKS, "es")
TWO_STEPS = ("eps", "eps-drift")
SERIES_RANGE = 0.25  # truncation error of the series below this: 0.25⁸/16! = 7e-19
COSINE, SINE = ([1 / math.factorial(2 * k + odd) for k in reversed(range(8))] for odd in (0, 1))


class TangentHamiltonian(Composition):
    """The variational equations as those of a Hamiltonian with piecewise constant coefficients.

    Args:
        variant: where D²V is evaluated, and the scheme for the perturbations:

            - "cc": at the start of the step; SBAB2 with its corrector, as for the orbit.
            - "es": at the start of the step; the exact solution, by eigenvectors.
            - "eps": in extended phase space, SBAB2 with its corrector, D²V at the start, in the middle and at the end;
              equation (40) of the paper.
            - "eps-kick": kick, drift, kick, D²V at the start and at the end; (38).
            - "eps-drift": drift, kick, drift, D²V in the middle; (39).
        dt: the step of the tangent, in units of time; variants that need D²V in the middle make two steps of the orbit
            of half the length.
        orbit: the method of the orbit, such as ``lh.Symplectic("ABA864", dt=0.05)`` or ``lh.RungeKutta("dop853")``;
            None: SBAB2 with its corrector. A method with error control makes steps shorter than dt where its
            tolerance demands it, and the tangent makes the same steps.

    Raises:
        ValueError: on an unknown variant, on a step that is not positive, on an `orbit` that is no method or has
            steps of another length; and, where it is used, on a system that is no `lh.Hamiltonian` with a
            kinetic energy that is quadratic in p.

    Source:
        Ch. Skokos & E. Gerlach, Phys. Rev. E 82 (2010) 036704, doi:10.1103/PhysRevE.82.036704.

    Example:
        >>> import lyaphybrid as lh
        >>> lh.TangentHamiltonian("eps", dt=0.05).adaptive
        False
        >>> lh.TangentHamiltonian("eps", dt=0.05, orbit=lh.RungeKutta("dop853", rtol=1e-10)).adaptive
        True
    """

    variant: str = eqx.field(static=True)
    dt: Any
    orbit: Any

    def __init__(self, variant: str, dt: Any, orbit: Method | None = None):
        require(is_one_of(variant, VARIANTS), f"Unknown variant {variant!r}; the variants are {', '.join(VARIANTS)}.")
        positive("dt", dt)
        self.variant, self.dt = variant, dt
        own = dt / self.stage_count
        orbit = Symplectic(ORBIT, dt=own) if orbit is None else orbit
        require(isinstance(orbit, Method), f"orbit must be a method, such as lh.RungeKutta('dop853'); got {orbit!r}.")
        if not orbit.adaptive and not traced((own, orbit.fixed_step)):
            fits = math.isclose(float(orbit.fixed_step), float(own))
            require(
                fits,
                f"The orbit must go in steps of {own:g} here; its method has dt = {orbit.fixed_step:g}: give that one.",
            )
        self.orbit = orbit

    @property
    def stage_count(self) -> int:
        """Steps of the orbit in one step of the tangent; D²V is taken at their ends."""
        return 2 if self.variant in TWO_STEPS else 1

    @property
    def fixed_step(self) -> Any:
        """The fixed step; None if the orbit's method controls its error."""
        return None if self.orbit.adaptive else self.dt

    @property
    def longest_step(self) -> Any:
        """The step dt if the orbit's method controls its error; otherwise None."""
        return self.dt if self.orbit.adaptive else None

    @property
    def rtol(self) -> Any:
        """That of the orbit's method."""
        return self.orbit.rtol

    @property
    def atol(self) -> Any:
        """That of the orbit's method."""
        return self.orbit.atol

    @property
    def error_order(self) -> int:
        """That of the orbit's method."""
        return self.orbit.error_order

    @property
    def controller(self) -> Controller:
        """That of the orbit's method."""
        return self.orbit.controller

    @property
    def of_one_mode(self) -> bool:
        """That of the orbit's method."""
        return self.orbit.of_one_mode

    def require_at_start(self, field: Any, t, x, args) -> None:
        """The requirements of the orbit's method."""
        self.orbit.require_at_start(field, t, x, args)

    def loosened(self, least: float) -> "TangentHamiltonian":
        """The same with the method of the orbit loosened."""
        return TangentHamiltonian(self.variant, self.dt, self.orbit.loosened(least))

    def require(self, field: Any, t, x) -> None:
        """Raise a ValueError unless the field is that of an `lh.Hamiltonian` with T quadratic in p."""
        name = f"lh.TangentHamiltonian({self.variant!r})"
        separable(field, x, name).require_quadratic(field.args, halves(x)[1], name)
        self.orbit.require(field, t, x)

    def _orbit(self, field: Any, t, x, f, h) -> list[Step]:
        """The steps of the orbit over one step of the tangent."""
        short, steps = h / self.stage_count, []
        for _ in range(self.stage_count):
            steps.append(self.orbit.step(field, t, x, f, short))
            t, x, f = t + short, steps[-1].x, steps[-1].f
        return steps

    def step(self, field: Any, t, x, f, h) -> Step:
        """One step over h from (t, x)."""
        steps = self._orbit(field, t, x, f, h)
        last, errors = steps[-1], jnp.concatenate([one.error for one in steps])
        return Step(last.x, last.f, errors, (x, f, last.x, last.f, h), (t, x), tuple(one.x for one in steps))

    def ratio(self, error, scale):
        """The largest ratio of the steps of the orbit."""
        ratios = [self.orbit.ratio(one, scale) for one in jnp.split(error, self.stage_count)]
        return jnp.max(jnp.stack(ratios))

    def divergence(self, field, nodes, h):
        """Zero: the flow of a Hamiltonian conserves phase-space volume."""
        return jnp.zeros_like(h)

    def tangent(self, field: Any, t, x, h, frame, stage_points=()) -> Tangent:
        """The frame after the step, by the quadratic Hamiltonians at the points of the orbit."""
        points: Sequence = (x, *(stage_points or [one.x for one in self._orbit(field, t, x, field(t, x), h)]))
        forms = [QuadraticHamiltonian(field, point) for point in points]
        dq, dp = jnp.split(frame, 2)
        if self.variant == "es":
            dq, dp = forms[0].solved(dq, dp, h)
        else:
            scheme, kicks = SCHEME_AND_KICKS[self.variant]
            dq, dp = _composed(SCHEMES[scheme], [forms[i] for i in kicks], dq, dp, h)
        return Tangent(points[-1], jnp.concatenate([dq, dp]), frame[None, :0], (t, x))


class QuadraticHamiltonian:
    """The quadratic Hamiltonian ½ δpᵀ T'' δp + ½ δqᵀ D²V δq at a point; perturbations are columns (m, k)."""

    def __init__(self, field: Any, point):
        self.parts, self.args, (self.q, self.p) = field.field, field.args, halves(point)

    def stiffness(self, dq):
        """The columns D²V δq (m, k)."""
        return each_column(lambda dq: jax.jvp(lambda q: -self.parts.force(q, self.args), (self.q,), (dq,))[1], dq)

    def velocity(self, dp):
        """The columns T'' δp (m, k)."""
        return each_column(lambda dp: jax.jvp(lambda p: self.parts.velocity(p, self.args), (self.p,), (dp,))[1], dp)

    def bracket(self, dq):
        """Half the derivative of C = (D²V δq)ᵀ T'' (D²V δq)."""
        return self.stiffness(self.velocity(self.stiffness(dq)))

    def solved(self, dq, dp, h):
        """The exact solution: with T'' = L Lᵀ, δq = L y and δp = L⁻ᵀ y', y'' = −Lᵀ D²V L y = −W diag(w) Wᵀ y."""
        unit = jnp.eye(dq.shape[0], dtype=dq.dtype)
        lower, inverse = _factor(self.velocity(unit))
        w, vectors = _eigenvectors(lower.T @ self.stiffness(unit) @ lower)
        to_q, to_p = lower @ vectors, inverse.T @ vectors
        y, rate = to_p.T @ dq, to_q.T @ dp
        c, s = _cosine_and_sine(w * h**2)
        c, s = c[:, None], h * s[:, None]
        return to_q @ (c * y + s * rate), to_p @ (c * rate - w[:, None] * s * y)


def _composed(scheme: Scheme, forms: list[QuadraticHamiltonian], dq, dp, h):
    """A step over h of a scheme; its i-th kick uses forms[i]."""
    strength, waiting = scheme.corrector * h**3, iter(forms)
    dp = dp + strength * forms[0].bracket(dq)
    for part, share in scheme.parts:
        if part == PART_A:
            dq = dq + share * h * forms[0].velocity(dp)
        else:
            dp = dp - share * h * next(waiting).stiffness(dq)
    return dq, dp + strength * forms[-1].bracket(dq)


def _factor(matrix):
    """The lower triangular L with L Lᵀ = matrix, and L⁻¹; in closed form for 2 × 2, without calls of a library."""
    if matrix.shape[0] != 2:
        lower = jnp.linalg.cholesky(matrix)
        return lower, jax.scipy.linalg.solve_triangular(lower, jnp.eye(len(matrix), dtype=matrix.dtype), lower=True)
    (a, b), (_, d) = matrix
    first, zero = jnp.sqrt(a), jnp.zeros_like(a)
    low = b / first
    last = jnp.sqrt(d - low**2)
    lower = jnp.stack([jnp.stack([first, zero]), jnp.stack([low, last])])
    return lower, jnp.stack([jnp.stack([1 / first, zero]), jnp.stack([-low / (first * last), 1 / last])])


def _eigenvectors(matrix):
    """Eigenvalues and eigenvectors of a symmetric matrix; for 2 × 2 by a rotation, computed from twice its angle."""
    if matrix.shape[0] != 2:
        return jnp.linalg.eigh(matrix)
    (a, b), (_, d) = matrix
    mean, half = 0.5 * (a + d), 0.5 * (a - d)
    root = jnp.sqrt(half**2 + b**2)
    away = jnp.where(root > 0, root, 1.0)
    larger = jnp.sqrt(0.5 * (1 + jnp.where(root > 0, jnp.abs(half), 1.0) / away))  # of cos and sin of the angle
    other = 0.5 * b / (away * larger)
    c, s = jnp.where(half < 0, jnp.abs(other), larger), jnp.where(half < 0, jnp.copysign(larger, b), other)
    return jnp.stack([mean + root, mean - root]), jnp.stack([jnp.stack([c, -s]), jnp.stack([s, c])])


def _cosine_and_sine(z):
    """The entire functions cos √z and sin √z / √z of z (m,); by series if all |z| are small, the usual case."""
    return jax.lax.cond(jnp.all(jnp.abs(z) < SERIES_RANGE), _by_series, _by_functions, z)


def _by_series(z):
    """The sums Σ (−z)ᵏ / (2k)! and Σ (−z)ᵏ / (2k + 1)!, to rounding."""
    return tuple(jnp.polyval(jnp.asarray(c, z.dtype), -z) for c in (COSINE, SINE))


def _by_functions(z):
    """The same by cos and sin for z > 0, and by cosh and sinh for z < 0."""
    small = jnp.abs(z) < 1e-8
    root = jnp.sqrt(jnp.where(small, 1.0, jnp.abs(z)))
    c = jnp.where(z > 0, jnp.cos(root), jnp.cosh(root))
    s = jnp.where(z > 0, jnp.sin(root), jnp.sinh(root)) / root
    return jnp.where(small, 1 - z / 2, c), jnp.where(small, 1 - z / 6, s)
