"""The rivals of the tangent map: the tangent dynamics Hamiltonian, with D²V frozen at points of the orbit.

H_T(δq, δp, t) = ½ δpᵀ T'' δp + ½ δqᵀ D²V(q(t)) δq: the orbit comes first, by any method, and D²V(q) is known at its
points alone. These methods are here to be compared with: their tangent is not the derivative of their
step, and λ₁ of a regular orbit levels off at a value above 0 that falls with the step only.
"""

import math
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.scipy.linalg

from ..._arguments import positive, require
from ..._jax.columns import each_column
from ..._jax.tracing import traced
from ...systems.hamiltonians import halves
from ..base import Controller, Method, Step, Tangent
from .splittings import SCHEMES, A, Scheme
from .symplectic import Composition, Symplectic, separable

__all__ = ["TangentHamiltonian"]

ORBIT = "SBAB2C"
SCHEME_AND_KICKS = {  # by which scheme, and the point of the orbit at which D²V is taken for each of its kicks
    "cc": ("SBAB2C", (0, 0, 0)),
    "eps": ("SBAB2C", (0, 1, 2)),
    "eps-kick": ("SBAB1", (0, 1)),
    "eps-drift": ("SABA1", (1,)),
}
VARIANTS = (*SCHEME_AND_KICKS, "es")
TWO_STEPS = ("eps", "eps-drift")
SMALL = 0.25  # what the series then leave out is below 0.25⁸/16! = 7e-19
COSINE, SINE = ([1 / math.factorial(2 * k + odd) for k in reversed(range(8))] for odd in (0, 1))


class TangentHamiltonian(Composition):
    """The variational equations as those of a Hamiltonian whose coefficients are constant for a while.

    Args:
        variant: where D²V is taken, and what is done with it:

            - "cc": at the start of the step; then the scheme of the orbit, SBAB2 with its corrector.
            - "es": at the start of the step; then the exact solution, by the eigenvectors.
            - "eps": in extended phase space, SBAB2 with its corrector, D²V at the start, in the middle and at the end;
              equation (40) of the paper.
            - "eps-kick": kick, drift, kick, D²V at the start and at the end; (38).
            - "eps-drift": drift, kick, drift, D²V in the middle; (39).
        dt: the step of the tangent, in units of time; the orbit takes two of half the length where D²V is wanted in
            the middle.
        orbit: the method of the orbit, such as ``lh.Symplectic("ABA864", dt=0.05)`` or ``lh.RungeKutta("dop853")``;
            None: SBAB2 with its corrector. One that controls its error makes steps shorter than dt where it has to,
            those of the tangent too.

    Raises:
        ValueError: on an unknown variant, on a step that is not positive, on an orbit by something else than a method
            or in steps of another length; and, where it is used, on a system that is no `lh.Hamiltonian` with a
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
        require(variant in VARIANTS, f"Unknown variant {variant!r}; the variants are {', '.join(VARIANTS)}.")
        positive("dt", dt)
        self.variant, self.dt = variant, dt
        own = dt / self.stage_count
        orbit = Symplectic(ORBIT, dt=own) if orbit is None else orbit
        require(isinstance(orbit, Method), f"orbit must be a method, such as lh.RungeKutta('dop853'); got {orbit!r}.")
        if not orbit.adaptive and not traced((own, orbit.fixed_step)):
            fits = math.isclose(float(orbit.fixed_step), float(own))
            require(fits, f"The orbit must go in steps of {own:g} here; its method has dt = {orbit.fixed_step:g}.")
        self.orbit = orbit

    @property
    def stage_count(self) -> int:
        """Steps of the orbit in one of the tangent: their ends are where D²V is taken."""
        return 2 if self.variant in TWO_STEPS else 1

    @property
    def fixed_step(self) -> Any:
        """The step; None where the error of the orbit is controlled."""
        return None if self.orbit.adaptive else self.dt

    @property
    def longest_step(self) -> Any:
        """No step is longer than dt."""
        return self.dt if self.orbit.adaptive else None

    @property
    def rtol(self) -> Any:
        """The orbit's."""
        return self.orbit.rtol

    @property
    def atol(self) -> Any:
        """The orbit's."""
        return self.orbit.atol

    @property
    def error_order(self) -> int:
        """The orbit's."""
        return self.orbit.error_order

    @property
    def controller(self) -> Controller:
        """The orbit's."""
        return self.orbit.controller

    def loosened(self, least: float) -> "TangentHamiltonian":
        """With the method of the orbit loosened."""
        return TangentHamiltonian(self.variant, self.dt, self.orbit.loosened(least))

    def require(self, field, t, x) -> None:
        """Raise where a field is not that of an `lh.Hamiltonian` that is quadratic in p."""
        name = f"lh.TangentHamiltonian({self.variant!r})"
        separable(field, x, name).require_quadratic(field.args, halves(x)[1], name)
        self.orbit.require(field, t, x)

    def _orbit(self, field: Any, t, x, f, h) -> list[Step]:
        """The steps of the orbit over one of the tangent."""
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
        """That of the worst step of the orbit."""
        ratios = [self.orbit.ratio(one, scale) for one in jnp.split(error, self.stage_count)]
        return jnp.max(jnp.stack(ratios))

    def divergence(self, field, nodes, h):
        """Canonical motion keeps volumes."""
        return jnp.zeros_like(h)

    def tangent(self, field: Any, t, x, h, frame, stage_points=()) -> Tangent:
        """The frame under the quadratic Hamiltonians of the step."""
        points: Sequence = (x, *(stage_points or [one.x for one in self._orbit(field, t, x, field(t, x), h)]))
        forms = [Form(field, point) for point in points]
        dq, dp = jnp.split(frame, 2)
        if self.variant == "es":
            dq, dp = forms[0].solved(dq, dp, h)
        else:
            scheme, kicks = SCHEME_AND_KICKS[self.variant]
            dq, dp = _composed(SCHEMES[scheme], [forms[i] for i in kicks], dq, dp, h)
        return Tangent(points[-1], jnp.concatenate([dq, dp]), frame[None, :0], (t, x))


class Form:
    """The quadratic Hamiltonian ½ δpᵀ T'' δp + ½ δqᵀ D²V δq at a point; perturbations are columns (m, k)."""

    def __init__(self, field: Any, point):
        self.parts, self.args, (self.q, self.p) = field.field, field.args, halves(point)

    def stiffness(self, dq):
        """D²V δq."""
        return each_column(lambda dq: jax.jvp(lambda q: -self.parts.force(q, self.args), (self.q,), (dq,))[1], dq)

    def velocity(self, dp):
        """T'' δp."""
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


def _composed(scheme: Scheme, forms: list[Form], dq, dp, h):
    """A step over h of a scheme, whose kicks take one form after the other."""
    strength, waiting = scheme.corrector * h**3, iter(forms)
    dp = dp + strength * forms[0].bracket(dq)
    for part, share in scheme.parts:
        if part == A:
            dq = dq + share * h * forms[0].velocity(dp)
        else:
            dp = dp - share * h * next(waiting).stiffness(dq)
    return dq, dp + strength * forms[-1].bracket(dq)


def _factor(matrix):
    """The lower triangular L with L Lᵀ = matrix, and L⁻¹; in the plane in closed form, ten times as fast."""
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
    """Eigenvalues and eigenvectors of a symmetric matrix; in the plane by a rotation, its angle from twice it."""
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
    """Cos √z and sin √z / √z, entire functions of z: by their series where |z| is small, as in steps that follow it."""
    return jax.lax.cond(jnp.all(jnp.abs(z) < SMALL), _by_series, _by_functions, z)


def _by_series(z):
    """Σ (−z)ᵏ / (2k)! and Σ (−z)ᵏ / (2k + 1)!, to rounding."""
    return tuple(jnp.polyval(jnp.asarray(c, z.dtype), -z) for c in (COSINE, SINE))


def _by_functions(z):
    """Hyperbolic where z is negative."""
    small = jnp.abs(z) < 1e-8
    root = jnp.sqrt(jnp.where(small, 1.0, jnp.abs(z)))
    c = jnp.where(z > 0, jnp.cos(root), jnp.cosh(root))
    s = jnp.where(z > 0, jnp.sin(root), jnp.sinh(root)) / root
    return jnp.where(small, 1 - z / 2, c), jnp.where(small, 1 - z / 6, s)
