"""Derivatives of the exponents at an equilibrium: first of the point (implicit function theorem), then of eigenvalues.

At an equilibrium of E x' = f(x; θ), f(x*; θ) = 0, so that A dx* = −∂f/∂θ with A = ∂f/∂x, and the exponents are the real
parts of the finite eigenvalues of the pencil A − λE. A group of them whose deflating subspaces are V on the right and U
on the left has the sum tr Λ with Λ = (Uᴴ E V)⁻¹ Uᴴ A V, and

    d tr Λ = tr[(Uᴴ E V)⁻¹ (Uᴴ dA V − Uᴴ dE V Λ)],    dA = ∂A/∂θ + ∂A/∂x dx*.

G. W. Stewart & J. Sun, Matrix Perturbation Theory (Academic Press 1990); R. Seydel, Practical Bifurcation and Stability
Analysis (Springer 2010), doi:10.1007/978-1-4419-1740-9.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy  # its submodules load on first use, which takes a tenth of a second

from ..._jax.engines import compiled
from ..._jax.tracing import array
from ...engine import preparation
from ...engine.host import reporting
from ...errors import RunFailedError
from ...integrators import HalfExplicit, RungeKutta
from ...systems.daes.semi_linear import Constrained
from ...systems.smooth import Flow
from ..orbits.motion.motions import Motion, Node
from ..orbits.periods import depends_on_time
from .estimates import Estimate, ExponentFunction, InapplicableError, UntrustedError

__all__ = ["by_equilibrium"]

NEWTON_ITERATIONS = 40  # of Newton's method
CORRECTION_ROUNDING = 1e-12  # corrections below this fraction of 1 + |x| are rounding
AT_REST = 1e-3  # of 1 + |x|: a motion this near to the equilibrium has come to rest there
EQUAL_REAL_PARTS = 1e-6  # real parts nearer than this, relative to the eigenvalues' size, form one group
WORST_CONDITION = 1e9  # largest condition numbers of A and of the eigenvalues
HUGE = 1e8  # an eigenvalue this many times the largest finite one is infinite
OPERATION_ROUNDING = 4 * float(np.finfo(float).eps)


class Pencil(NamedTuple):
    """E x' = f(x; θ) near a point."""

    residual: Any  # (n,) f
    matrix: Any  # (n, n) A
    leading: Any  # (n, n) E
    slopes: Any  # (p, n) ∂f/∂θ


class Equilibrium(NamedTuple):
    """An equilibrium."""

    x: np.ndarray  # (n,)
    pencil: Pencil
    correction: float  # last correction of Newton's method, relative to 1 + |x|
    values: np.ndarray  # (k,) the finite eigenvalues, by descending real parts

    @property
    def stable(self) -> bool:
        """Whether all directions contract."""
        return bool(np.all(np.real(self.values) < 0))

    def is_near(self, node: Node) -> bool:
        """Whether a motion has come to rest at it."""
        return self.distance(node) <= AT_REST

    def distance(self, node: Node) -> float:
        """Distance of a point, relative to 1 + |x|."""
        return float(np.max(np.abs(np.asarray(node.x) - self.x)) / (1 + np.max(np.abs(self.x))))


def by_equilibrium(case: ExponentFunction, *, progress: Any = None) -> Estimate:
    """Exponents of the equilibrium at which the motion comes to rest, and their derivatives.

    Args:
        case: with the options of `lyapunov_spectrum`; Newton's method starts from the state after the transient.
        progress: None, True for a bar, or a function of the fraction done.

    Raises:
        UntrustedError: where Newton's method finds no equilibrium.
        InapplicableError: where the system jumps, or depends on time.
    """
    if not isinstance(case.system, Flow):
        raise InapplicableError(
            f"equilibria are looked for of an lh.Flow or lh.DAE alone; got an lh.{type(case.system).__name__}."
        )
    report = reporting.reporter(progress)
    try:
        flow, end = _motion_and_start(case)
        end = _point_after(flow, end, case.options["transient"])
        report(0.4)
        rest = _equilibrium_near(case, end)
        if rest.stable and not rest.is_near(end):
            end = _point_after(flow, end, case.options["t1"])
        report(0.8)
        found = _judged(case, rest, end)
        report(1.0)
        return found
    finally:
        report(None)


def _motion_and_start(case: ExponentFunction) -> tuple[Motion, Node]:
    """The motion and where it starts."""
    options, args = case.options, case.args_of(case.theta)
    constrained, method = isinstance(case.system.field, Constrained), options["method"]
    if method is None:
        method = HalfExplicit(rtol=1e-12, tableau="dopri8") if constrained else RungeKutta(rtol=1e-12, atol=1e-14)
    problem, x, t, mode = preparation.prepare(
        case.system, case.start(args), args, options["t0"], method, options["mode"]
    )
    if depends_on_time(case.system, x, problem.args):
        raise InapplicableError("no equilibrium: the system depends on time.")
    return Motion(problem), Node(float(t), x, mode)


def _point_after(flow: Motion, node: Node, length: float) -> Node:
    """The point after some time."""
    try:
        return flow.piece(node, float(length)).end if length > 0 else node
    except RunFailedError as failed:
        raise UntrustedError(f"no equilibrium: the run failed. {str(failed).splitlines()[0]}", failed=True) from failed


def _equilibrium_near(case: ExponentFunction, start: Node) -> Equilibrium:
    """The equilibrium that Newton's method finds from a point."""
    x, theta, correction = np.asarray(start.x), np.asarray(case.theta), np.inf
    for _ in range(NEWTON_ITERATIONS):
        pencil = Pencil(*map(np.asarray, _pencil(case.system, case.args_of, theta, array(start.t, x.dtype), x)))
        step = np.linalg.lstsq(pencil.matrix, -pencil.residual, rcond=1e-13)[0] if _finite(pencil) else np.nan * x
        if not np.all(np.isfinite(step)):
            break
        size = 1 + np.max(np.abs(x))
        before, correction = correction, float(np.max(np.abs(step)) / size)
        if correction <= CORRECTION_ROUNDING and correction >= before / 2:  # only rounding is left
            return Equilibrium(x, pencil, correction, _finite_eigenvalues(case, pencil))
        x = x + step
    raise UntrustedError(f"no equilibrium: Newton's method does not converge from {np.asarray(start.x)}.")


def _finite(pencil: Pencil) -> bool:
    return all(bool(np.all(np.isfinite(part))) for part in pencil)


@compiled(hands_on=True)
def _pencil(system: Flow, args_of, theta, t, x) -> Pencil:
    def of(theta, x):
        return _residual(system, t, x, args_of(theta))

    slopes, matrix = jax.jacfwd(of, argnums=(0, 1))(theta, x)
    return Pencil(of(theta, x), matrix, _leading(system, t, x, args_of(theta)), slopes.T)


@compiled(hands_on=True)
def _matrix_derivatives(system: Flow, args_of, theta, t, x, dx):
    """The derivatives of A and E (p, n, n) by the parameters, with the point moving by dx (p, n)."""

    def both(theta, x):
        args = args_of(theta)
        return jax.jacfwd(lambda x: _residual(system, t, x, args))(x), _leading(system, t, x, args)

    turns = jnp.eye(len(theta), dtype=theta.dtype)
    return jax.vmap(lambda turn, dx: jax.jvp(both, (theta, x), (turn, dx))[1])(turns, dx)


def _residual(system: Flow, t, x, args):
    return (system.field.residual if isinstance(system.field, Constrained) else system.field)(t, x, args)


def _leading(system: Flow, t, x, args):
    return system.field.leading(t, args) if isinstance(system.field, Constrained) else jnp.eye(x.size, dtype=x.dtype)


def _finite_eigenvalues(case: ExponentFunction, pencil: Pencil) -> np.ndarray:
    """Finite eigenvalues of A − λE by descending real parts; constraints cause infinite ones."""
    if not isinstance(case.system.field, Constrained):
        found = np.linalg.eigvals(pencil.matrix)
    else:
        above, below = np.asarray(scipy.linalg.eigvals(pencil.matrix, pencil.leading, homogeneous_eigvals=True))
        finite = np.argsort(np.abs(above) / np.hypot(np.abs(above), np.abs(below)))
        kept = finite[: case.system.field.n_differential]
        found = above[kept] / below[kept]
    return found[np.lexsort((found.imag, -found.real))]


def _judged(case: ExponentFunction, rest: Equilibrium, end: Node) -> Estimate:
    """The estimate, and whether it can be trusted."""
    x, theta, pencil = rest.x, np.asarray(case.theta), rest.pencil
    condition = float(np.linalg.cond(pencil.matrix))
    dx = np.linalg.lstsq(pencil.matrix, -pencil.slopes.T, rcond=None)[0].T
    changes = tuple(
        map(np.asarray, _matrix_derivatives(case.system, case.args_of, theta, array(end.t, x.dtype), x, dx))
    )
    value, groups = np.real(rest.values), _groups(rest.values)
    gradient, errors, apart = np.empty((len(value), len(theta))), np.empty(len(value)), np.empty(len(value))
    for group in groups:
        slope, errors[group] = _of_group(pencil, changes, rest.values, group)
        gradient[group] = slope / len(group)
        others = np.delete(rest.values, group)
        apart[group] = np.min(np.abs(rest.values[group][:, None] - others), initial=np.inf)
    near, k = rest.is_near(end), case.k
    reasons = [f"Newton's method ended with a correction of {rest.correction:.1e}"]
    reasons.append(f"the equilibrium is {'stable' if rest.stable else 'not stable: motion does not stay there'}")
    reasons.append(f"the motion {'comes' if near else 'does NOT come'} to rest: it is {rest.distance(end):.1e} away")
    reasons.append(f"condition number {condition:.1e} of the equations of the equilibrium")
    for group in groups:
        if len(group) > 1 and min(group) < k:
            names = ", ".join(f"λ{i + 1}" for i in group)
            reasons.append(f"{names}: a complex pair or nearly the same, the derivative is that of their mean")
    size = float(np.linalg.norm(pencil.matrix))
    change = np.array([np.linalg.norm(one) for one in changes[0]]) + np.abs(np.linalg.norm(dx, axis=1))
    mixing = (size / apart)[:, None]  # of the eigenvectors, by rounding of A
    with np.errstate(invalid="ignore"):  # ∞·0 where the equations are singular: not trusted
        stderr = OPERATION_ROUNDING * errors[:, None] * ((condition + mixing) * np.abs(gradient) + change)
    return Estimate(
        value=value[:k],
        value_stderr=OPERATION_ROUNDING * errors[:k] * size,
        gradient=gradient[:k],
        stderr=stderr[:k],
        trust=rest.stable and near and condition <= WORST_CONDITION and bool(np.max(errors[:k]) <= WORST_CONDITION),
        reasons=tuple(reasons),
        cost=1,
    )


def _groups(values: np.ndarray) -> list[list[int]]:
    """Indices of eigenvalues, sorted by real parts, in groups of equal real parts, which are differentiated together.

    A complex pair is such a group. Where other eigenvalues have equal real parts, only their mean has a derivative.
    """
    groups = [[0]]
    for i in range(1, len(values)):
        gap = values[i - 1].real - values[i].real
        if gap <= EQUAL_REAL_PARTS * max(abs(values[i - 1]), abs(values[i])):
            groups[-1].append(i)
        else:
            groups.append([i])
    return groups


def _of_group(pencil: Pencil, changes, values: np.ndarray, group: list[int]) -> tuple[np.ndarray, float]:
    """The derivatives (p,) of the sum of the real parts, and the condition number of these eigenvalues."""
    right = _subspace(pencil.matrix, pencil.leading, values, group)
    left = _subspace(pencil.matrix.T, pencil.leading.T, values.conj(), group)
    scale = left.conj().T @ pencil.leading @ right
    dual = np.linalg.solve(scale, left.conj().T)
    inside = dual @ pencil.matrix @ right
    slopes = [np.trace(dual @ da @ right - dual @ de @ right @ inside).real for da, de in zip(*changes, strict=True)]
    return np.array(slopes), float(np.linalg.norm(dual, 2))


def _subspace(matrix, leading, values: np.ndarray, group: list[int]) -> np.ndarray:
    """An orthonormal basis (n, m) of the deflating subspace of the group's eigenvalues."""
    others = np.delete(values, group)

    def belongs(above, below):
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.atleast_1d(above) / np.atleast_1d(below)
        mine = np.min(np.abs(ratio[:, None] - values[group]), axis=1)
        theirs = np.min(np.abs(ratio[:, None] - others), axis=1, initial=np.inf)
        return np.isfinite(ratio) & (mine < theirs) & (np.abs(ratio) < HUGE * np.max(np.abs(values)))

    try:
        *_, vectors = scipy.linalg.ordqz(matrix, leading, sort=belongs, output="complex")  # pyright: ignore
    except ValueError as failed:  # SciPy's word for LAPACK's "too ill-conditioned to be reordered"
        raise UntrustedError("eigenvalues of the equilibrium cannot be told from one another.") from failed
    return vectors[:, : len(group)]
