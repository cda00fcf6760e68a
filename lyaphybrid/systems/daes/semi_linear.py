"""Differential–algebraic equations E(t) x' = f(t, x): their parts, and their velocity.

The first d rows of E are E₁, of full rank; the others are zero, and say 0 = f₂(t, x). Where Ē = [E₁; A₂] is
nonsingular, A₂ = ∂f₂/∂x, the equations are strangeness-free: the content w = E₁ x is all that the motion remembers,

    w' = E₁' x + f₁(t, x)        with x solving   E₁ x = w,  f₂(t, x) = 0,

an ordinary differential equation in d unknowns (eq. (9) of Linh et al.). Methods integrate that one.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg
from jaxtyping import Array

from ..._jax.jaxprs import constant
from ..._linalg.banded import Factors, factorised, probes, solve
from ..._linalg.frames import orthonormalise
from ..._linalg.linear_systems import inverse, product, split, times
from ..bound import require_callable
from ..event_driven import EventDriven
from ..smooth import Flow

__all__ = [
    "DAE",
    "Constrained",
    "Lifts",
    "degrees_of_freedom",
    "fields_of",
    "is_constrained",
    "parts_of",
]

RANK = 1e-10  # what is smaller than this, relative to the largest, is zero
ILL = 1e6  # from this condition number on Ē, its rows of length one, is taken to be singular


class Lifts(NamedTuple):
    """The columns of Ē⁻¹: from rates of the content and of the constraint to those of the state."""

    content: Array  # (n, d)
    constraint: Array  # (n, n − d)
    sign: Array  # of det Ē, up to a constant factor


class Constrained(eqx.Module):
    """The field of a DAE and its parts; called, it gives x' of the underlying ordinary differential equation.

    Attributes:
        leading: ``(t, args) -> E`` (n, n).
        residual: ``(t, x, args) -> f`` (n,).
        n_differential: number of the differential rows, d.
    """

    leading: Callable
    residual: Callable
    n_differential: int = eqx.field(static=True)

    def __call__(self, t, x, args):
        """X' = Ē⁻¹ [f₁; −∂f₂/∂t], which keeps f₂(t, x) = 0."""
        return self.velocity(self.lifts(t, x, args), t, x, args)

    def velocity(self, lifts: Lifts, t, x, args):
        """The same where Ē⁻¹ is known."""
        moving = jax.jvp(lambda t: self.constraint(t, x, args), (t,), (jnp.ones_like(t),))[1]
        slope = self.residual(t, x, args)[: self.n_differential]
        return product(lifts.content, slope) - product(lifts.constraint, moving)

    def whole_guess(self, x):
        """A state (n,) for what users give as a guess."""
        return x

    def rows(self, t, args):
        """E₁ (d, n); a NumPy array where it is the same at all times and for all parameters."""
        return constant(lambda t: self.leading(t, args)[: self.n_differential], jnp.asarray(t))

    def content(self, t, x, args):
        """W = E₁ x (d,)."""
        return times(self.rows(t, args), x)

    def slope(self, t, x, args):
        """W' = E₁' x + f₁ (d,), at a consistent x."""
        turning = jax.jvp(lambda t: self.content(t, x, args), (t,), (jnp.ones_like(t),))[1]
        return turning + self.residual(t, x, args)[: self.n_differential]

    def constraint(self, t, x, args):
        """f₂ (n − d,)."""
        return self.residual(t, x, args)[self.n_differential :]

    def lifts(self, t, x, args, share: Any = None) -> Lifts:
        """Ē⁻¹ at (t, x); or the inverse for E₁ − share ∂w'/∂x in the place of E₁, as implicit stages need it."""
        rows = self.rows(t, args)
        if share is None and isinstance(rows, np.ndarray):
            return self._lifts_along(rows, t, x, args)
        below = jax.jacfwd(lambda x: self.constraint(t, x, args))(x)
        if share is not None:
            rows = rows - share * jax.jacfwd(lambda x: self.slope(t, x, args))(x)
        whole, sign = inverse(jnp.concatenate([rows, below]))
        return Lifts(whole[:, : self.n_differential], whole[:, self.n_differential :], sign)

    def _lifts_along(self, rows: np.ndarray, t, x, args) -> Lifts:
        """The same for a constant E₁: only A₂ Z, with Z a basis of E₁'s kernel, is to be inverted."""
        right, kernel = split(rows)
        _, along = jax.linearize(lambda x: self.constraint(t, x, args), x)
        turned, sign = inverse(_columns(along, kernel))
        falling = times(kernel, turned)
        return Lifts(jnp.asarray(right, x.dtype) - product(falling, _columns(along, right)), falling, sign)

    def distance(self, t, x, args):
        """How far x is from the constraints, relative to 1 + |x|; nan where Ē is singular."""
        correction = product(self.lifts(t, x, args).constraint, self.constraint(t, x, args))
        return jnp.max(jnp.abs(correction) / (1 + jnp.abs(x)))

    def whole(self, t, x, args):
        """Ē (n, n)."""
        below = jax.jacfwd(lambda x: self.constraint(t, x, args))(x)
        return jnp.concatenate([jnp.asarray(self.rows(t, args), x.dtype), below])

    def is_singular(self, t, x, args):
        """Whether Ē is singular, or nearly; or a row of E that should be zero is not."""
        whole = self.whole(t, x, args)
        size = jnp.sum(jnp.abs(whole), axis=1, keepdims=True)
        scaled = whole / jnp.where(size == 0, 1.0, size)
        backward, _ = inverse(scaled)
        condition = jnp.max(jnp.sum(jnp.abs(backward), axis=1), initial=0.0)
        leading = jnp.abs(self.leading(t, args))
        rest = jnp.max(leading[self.n_differential :], initial=0.0) > RANK * jnp.max(leading)
        return ~(condition < ILL) | rest

    def onto(self, t, x, args, dx):
        """The projection Ē⁻¹ [E₁ dx; 0] onto the tangent space of the constraint, which keeps the content."""
        return product(self.lifts(t, x, args).content, self.content(t, dx, args))


class Falling(eqx.Module):
    """Ē⁻¹'s columns for the constraints, as a linear function: where the constraints are banded most of it is zero."""

    factors: Factors
    places: tuple[int, ...] = eqx.field(static=True)  # of the algebraic components
    shape: tuple[int, int] = eqx.field(static=True)

    def __matmul__(self, b):
        found = solve(self.factors, b)
        return jnp.zeros((self.shape[0], *b.shape[1:]), b.dtype).at[np.array(self.places)].set(found)


class Banded(Constrained):
    """The same where the constraints are banded in the algebraic components, in their order.

    Attributes:
        bandwidth: largest distance of a constraint to an algebraic component in it.
    """

    bandwidth: int = eqx.field(static=True)

    def _lifts_along(self, rows: np.ndarray, t, x, args) -> Lifts:
        right, kernel = split(rows)
        _, along = jax.linearize(lambda x: self.constraint(t, x, args), x)
        seen = _columns(along, kernel @ probes(kernel.shape[1], self.bandwidth))
        factors, sign = factorised(seen)
        places = tuple(int(i) for i in np.argmax(kernel, axis=0))
        falling: Any = Falling(factors, places, kernel.shape)
        return Lifts(jnp.asarray(right, x.dtype) - falling @ _columns(along, right), falling, sign)


def _columns(along, matrix: np.ndarray):
    """A linear function of the columns of a matrix that is known, as columns."""
    return jax.vmap(along, in_axes=1, out_axes=1)(jnp.asarray(matrix))


class DAE(Flow):
    """A differential–algebraic equation E(t) x' = f(t, x) of differentiation index one, strangeness-free.

    The first d = n_differential rows of E are of full rank, the others zero: these rows of f are constraints. Ē = [E₁;
    ∂f₂/∂x] must be nonsingular along the motion. Perturbations live in the kernel of ∂f₂/∂x, so there are d exponents.

    Args:
        leading: ``(t, args) -> E`` (n, n).
        residual: ``(t, x, args) -> f`` (n,).
        n_differential: d, the number of rows of E that are not zero. Semi-explicit equations have E = diag(1, …, 0, …).
        bandwidth: b, where the i-th constraint depends on no algebraic component but the (i − b)-th to the (i + b)-th,
            as in networks whose nodes are well ordered (`scipy.sparse.csgraph.reverse_cuthill_mckee` finds an order):
            half-explicit methods then solve banded equations, whose entries 2 b + 1 derivatives show. Where E is not
            constant, and in implicit methods, they are solved in full.

    Derivatives of what is computed (`jax.jacfwd`, `lh.lyapunov_gradient`), of first and higher order, are those of the
    solution of the constraints, not of the iteration that finds it.

    Raises:
        ValueError: if a function is not callable, n_differential or bandwidth no whole number above 0.

    Source:
        V. H. Linh, N. D. Truong & P. Q. Tuyen, DAE Panel 3 (2025), doi:10.52825/dae-p.v3i.2632; P. Kunkel &
        V. Mehrmann, Differential-Algebraic Equations (EMS 2006), doi:10.4171/017.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> decay = lh.DAE(
        ...     lambda t, args: jnp.diag(jnp.array([1.0, 0.0])),
        ...     lambda t, x, args: jnp.array([-x[1], x[1] - 2 * x[0]]),
        ...     n_differential=1,
        ... )
        >>> start = lh.consistent_start(decay, [1.0, 0.0])
        >>> start.tolist()
        [1.0, 2.0]
        >>> round(float(lh.lyapunov_spectrum(decay, start, t1=10.0).exponents[0]), 6)
        -2.0
    """

    field: Constrained

    def __init__(self, leading: Callable, residual: Callable, n_differential: int, *, bandwidth: int | None = None):
        require_callable("leading", leading, "(t, args) -> E")
        require_callable("residual", residual, "(t, x, args) -> f")
        _check_whole("n_differential, the number of nonzero rows of E,", n_differential)
        if bandwidth is None:
            self.field = Constrained(leading, residual, int(n_differential))
        else:
            _check_whole("bandwidth", bandwidth)
            self.field = Banded(leading, residual, int(n_differential), int(bandwidth))  # pyright: ignore[reportIncompatibleMethodOverride]

    @property
    def n_differential(self) -> int:
        """The number of differential rows, and of exponents."""
        return self.field.n_differential

    @classmethod
    def reduced(cls, leading: Callable, residual: Callable, args: Any = None, *, t0: Any = 0.0) -> "DAE":
        """The same for an E of any constant rank d, none of whose rows need be zero.

        The equations are multiplied by an orthogonal matrix whose first d rows span the columns of E(t). Which columns
        do is found at t0, by a QR factorisation with pivoting.

        Args:
            leading: ``(t, args) -> E`` (n, n), of constant rank.
            residual: ``(t, x, args) -> f`` (n,).
            args: parameters at which the rank is determined.
            t0: and the time.

        Raises:
            ValueError: where E(t0) is zero.

        Example:
            >>> import jax.numpy as jnp, lyaphybrid as lh
            >>> both = lh.DAE.reduced(
            ...     lambda t, args: jnp.array([[1.0, 1.0], [1.0, 1.0]]),
            ...     lambda t, x, args: jnp.array([-x[0], x[1]]),
            ... )
            >>> both.n_differential
            1
        """
        require_callable("leading", leading, "(t, args) -> E")
        columns, complement = _range(np.asarray(leading(jnp.asarray(t0, float), args)))
        kept, rest = jnp.asarray(columns), jnp.asarray(complement)

        def multiplier(t, args):
            spanning, *_ = orthonormalise(leading(t, args)[:, kept])
            others, *_ = orthonormalise(rest - spanning @ (spanning.T @ rest))
            return jnp.concatenate([spanning, others], axis=1).T

        return cls(
            lambda t, args: multiplier(t, args) @ leading(t, args),
            lambda t, x, args: multiplier(t, args) @ residual(t, x, args),
            len(columns),
        )


def _check_whole(name: str, value) -> None:
    good = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if not good or value < 1:
        raise ValueError(f"{name} must be at least 1; got {value!r}.")


def _range(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Columns that span the range of a matrix, and a basis of its orthogonal complement."""
    q, r, order = (np.asarray(part) for part in scipy.linalg.qr(matrix, pivoting=True))  # pyright: ignore
    size = np.abs(np.diag(r))
    rank = int(np.sum(size > RANK * size[0]))
    if rank == 0:
        raise ValueError("leading(t0, args) is zero: nothing is differential.")
    return order[:rank], q[:, rank:]


def is_constrained(field: Any) -> bool:
    """Whether a field with its parameters is that of a DAE."""
    return isinstance(getattr(field, "field", None), Constrained)


def fields_of(system: Any) -> tuple:
    """The fields of a system's modes."""
    if isinstance(system, EventDriven):
        return (system.velocity,) if system.schedule is None else ()
    return (system.field,) if isinstance(system, Flow) else getattr(system, "fields", None) or ()


def degrees_of_freedom(system: Any, n: int) -> int:
    """How many exponents a system with n components has: constraints leave fewer, those of every mode."""
    fields = fields_of(system)
    return max((one.n_differential if isinstance(one, Constrained) else n for one in fields), default=n)


def parts_of(field: Any, n: int) -> tuple[Constrained, Any]:
    """The parts of a field and its parameters; an ordinary one is E = 1 without constraints."""
    if is_constrained(field):
        return field.field, field.args
    return Constrained(lambda t, args: np.eye(n), lambda t, x, args: field(t, x), n), None
