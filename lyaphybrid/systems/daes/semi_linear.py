"""Differential–algebraic equations E(t) x' = f(t, x): their parts, and the velocity x'.

The first d rows of E are E₁, of full rank; the others are zero and give the constraints 0 = f₂(t, x). If
Ē = [E₁; A₂] is nonsingular, A₂ = ∂f₂/∂x, the equations are strangeness-free: the differential part w = E₁ x (in the
code: `differential_part`) determines the state x, and

    w' = E₁' x + f₁(t, x)        with x solving   E₁ x = w,  f₂(t, x) = 0

is an ordinary differential equation in d unknowns (eq. (9) of Linh et al.), which the methods integrate.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy  # its submodules load on first use, which takes a tenth of a second
from jaxtyping import Array

from ..._jax.jaxprs import constant
from ..._linalg.banded import BlockFactors, factorised, probes, solve
from ..._linalg.frames import orthonormalise
from ..._linalg.linear_systems import condition, inverse, matmul, separated, sparse_matmul, split
from ..bound import require_callable
from ..event_driven import EventDriven
from ..labels import time_word, words
from ..smooth import Flow

__all__ = [
    "DAE",
    "Constrained",
    "InverseBlocks",
    "degrees_of_freedom",
    "fields_of",
    "is_constrained",
    "parts_of",
]

RANK = 1e-10  # entries, or singular values, below this times the largest one count as zero
ILL = 1e6  # above this condition number, in the best units, Ē counts as singular


class InverseBlocks(NamedTuple):
    """The two blocks of Ē⁻¹ = [L K]: a change u of E₁ x and r of f₂ is a change L u + K r of the state.

    Large ones are linear functions with a shape and ``@``, not written out.
    """

    differential_part: Any  # (n, d)
    constraint: Any  # (n, n − d)
    sign: Array  # of det Ē, up to a constant factor
    terms: Array  # (n,) |Ē⁻¹| |Ē| |x|: the size of what adds up to x, and is rounded


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
        """The velocity x' = Ē⁻¹ [f₁; −∂f₂/∂t] (n,), which keeps f₂(t, x) = 0."""
        return self.velocity(self.inverse_blocks(t, x, args), t, x, args)

    def velocity(self, inverse_blocks: InverseBlocks, t, x, args):
        """The same with a known Ē⁻¹."""
        moving = jax.jvp(lambda t: self.constraint(t, x, args), (t,), (jnp.ones_like(t),))[1]
        slope = self.residual(t, x, args)[: self.n_differential]
        return matmul(inverse_blocks.differential_part, slope) - matmul(inverse_blocks.constraint, moving)

    def whole_guess(self, x):
        """The state (n,) for the user's guess of `lh.consistent_start`."""
        return x

    def rows(self, t, args):
        """The matrix E₁ (d, n); a NumPy array if it depends neither on t nor on args."""
        return constant(lambda t: self.leading(t, args)[: self.n_differential], jnp.asarray(t))

    def differential_part(self, t, x, args):
        """The differential part w = E₁ x (d,)."""
        return sparse_matmul(self.rows(t, args), x)

    def slope(self, t, x, args):
        """Its derivative w' = E₁' x + f₁ (d,), at a consistent x."""
        turning = jax.jvp(lambda t: self.differential_part(t, x, args), (t,), (jnp.ones_like(t),))[1]
        return turning + self.residual(t, x, args)[: self.n_differential]

    def constraint(self, t, x, args):
        """The constraints f₂ (n − d,)."""
        return self.residual(t, x, args)[self.n_differential :]

    def inverse_blocks(self, t, x, args, share: Any = None) -> InverseBlocks:
        """Ē⁻¹ at (t, x); with a share = h a_ii, as in implicit stages, E₁ − share ∂w'/∂x takes the place of E₁."""
        rows = self.rows(t, args)
        if share is None and isinstance(rows, np.ndarray):
            return self._lifts_along(rows, t, x, args)
        below = jax.jacfwd(lambda x: self.constraint(t, x, args))(x)
        if share is not None:
            rows = rows - share * jax.jacfwd(lambda x: self.slope(t, x, args))(x)
        whole = jnp.concatenate([rows, below])
        back, sign = inverse(whole)
        terms = jnp.abs(back) @ (jnp.abs(whole) @ jnp.abs(x))
        return InverseBlocks(back[:, : self.n_differential], back[:, self.n_differential :], sign, terms)

    def _lifts_along(self, rows: np.ndarray, t, x, args) -> InverseBlocks:
        """The same for a constant E₁: only A₂ Z (n − d, n − d) is inverted, Z a basis of the kernel of E₁."""
        right, kernel = split(rows)
        _, along = jax.linearize(lambda x: self.constraint(t, x, args), x)
        by_kernel, by_content = _columns(along, kernel, x.dtype), _columns(along, right, x.dtype)
        turned, sign = inverse(by_kernel)
        falling = sparse_matmul(kernel, turned)
        differential_part = jnp.asarray(right, x.dtype) - matmul(falling, by_content)
        own, content = jnp.abs(matmul(jnp.asarray(kernel.T, x.dtype), x)), sparse_matmul(np.abs(rows), jnp.abs(x))
        summands = matmul(jnp.abs(by_kernel), own) + matmul(jnp.abs(by_content), content)
        terms = jnp.abs(differential_part) @ content + jnp.abs(falling) @ summands
        return InverseBlocks(differential_part, falling, sign, terms)

    def distance(self, t, x, args, least: Any = 0.0):
        """The distance of x from the constraints, relative to the terms that add up to x; nan if Ē is singular.

        Components that cancel functions of time alone have no such terms: `least` (n,) is added.
        """
        inverse_blocks = self.inverse_blocks(t, x, args)
        correction = jnp.abs(matmul(inverse_blocks.constraint, self.constraint(t, x, args)))
        size = inverse_blocks.terms + least
        return jnp.max(correction / jnp.where((correction == 0) & (size == 0), 1.0, size))

    def whole(self, t, x, args):
        """The matrix Ē (n, n)."""
        below = jax.jacfwd(lambda x: self.constraint(t, x, args))(x)
        return jnp.concatenate([jnp.asarray(self.rows(t, args), x.dtype), below])

    def singularities(self, t, x, args):
        """Whether Ē is nearly singular in the units as they are, and whether in any, or a later row of E is not zero.

        Near a fold a column of Ē falls to zero as one in small units does: there the first is true, the second is not.
        """
        whole = self.whole(t, x, args)
        size = jnp.sum(jnp.abs(whole), axis=1, keepdims=True)
        scaled = whole / jnp.where(size == 0, 1.0, size)
        backward, _ = inverse(scaled)
        nearly = ~(jnp.max(jnp.sum(jnp.abs(backward), axis=1), initial=0.0) < ILL)
        leading = jnp.abs(self.leading(t, args))
        rest = jnp.max(leading[self.n_differential :], initial=0.0) > RANK * jnp.max(leading)
        return nearly | rest, (nearly & ~(condition(whole) < ILL)) | rest

    def onto(self, t, x, args, dx):
        """The projection Ē⁻¹ [E₁ dx; 0] onto the tangent space of the constraints; it keeps E₁ dx."""
        return matmul(self.inverse_blocks(t, x, args).differential_part, self.differential_part(t, dx, args))


class BandedInverseBlock(eqx.Module):
    """The constraint block K of Ē⁻¹ as a linear function for banded constraints: a banded solve, no full matrix."""

    factors: BlockFactors
    places: tuple[int, ...] = eqx.field(static=True)  # indices of the algebraic components
    shape: tuple[int, int] = eqx.field(static=True)

    def __matmul__(self, b):
        found = solve(self.factors, b)
        return jnp.zeros((self.shape[0], *b.shape[1:]), b.dtype).at[np.array(self.places)].set(found)


class Banded(Constrained):
    """The field of a DAE whose constraints are banded in the algebraic components, in their order.

    Attributes:
        bandwidth: largest |i − j| for which constraint i depends on the algebraic component j.
    """

    bandwidth: int = eqx.field(static=True)

    def _lifts_along(self, rows: np.ndarray, t, x, args) -> InverseBlocks:
        if not separated(rows):
            return super()._lifts_along(rows, t, x, args)
        right, kernel = split(rows)
        _, along = jax.linearize(lambda x: self.constraint(t, x, args), x)
        seen = _columns(along, kernel @ probes(kernel.shape[1], self.bandwidth), x.dtype)
        factors, sign = factorised(seen)
        places = tuple(int(i) for i in np.argmax(kernel, axis=0))
        falling: Any = BandedInverseBlock(factors, places, kernel.shape)
        # |K| is not at hand: the algebraic components of a network have one unit.
        terms = jnp.maximum(jnp.abs(x), jnp.max(jnp.abs(kernel.T @ x), initial=0.0))
        lifts = jnp.asarray(right, x.dtype) - falling @ _columns(along, right, x.dtype)
        return InverseBlocks(lifts, falling, sign, terms)


def _columns(along, matrix: np.ndarray, dtype):
    """A linear function applied to each column of a constant matrix."""
    return jax.vmap(along, in_axes=1, out_axes=1)(jnp.asarray(matrix, dtype))


class DAE(Flow):
    """A differential–algebraic equation E(t) x' = f(t, x) of differentiation index one, strangeness-free.

    The first d = n_differential rows of E have full rank; the others are zero, and the same rows of f are constraints.
    Ē = [E₁; ∂f₂/∂x] must be nonsingular along the motion. Perturbations lie in the kernel of ∂f₂/∂x, so there are d
    exponents.

    Args:
        leading: ``(t, args) -> E`` (n, n).
        residual: ``(t, x, args) -> f`` (n,).
        n_differential: d, the number of rows of E that are not zero. Semi-explicit equations have E = diag(1, …, 0, …).
        bandwidth: b, if constraint i depends only on the algebraic components i − b to i + b, as in networks with
            well-ordered nodes (`scipy.sparse.csgraph.reverse_cuthill_mckee` finds an order). Half-explicit methods then
            solve banded equations, whose matrix takes 2 b + 1 directional derivatives. If E is not constant or its rows
            contain more than d components, and in implicit methods, the equations are solved with full matrices.
        names: what the components of x are called, as for `lh.Flow`.
        units: in which they are measured, likewise.
        time_unit: in which time is measured, as for `lh.Flow`.

    Derivatives of results (`jax.jacfwd`, `lh.lyapunov_gradient`), of first and higher order, are those of the solution
    of the constraints, not of the iteration that finds it.

    Raises:
        ValueError: if a function is not callable, or n_differential or bandwidth is not a positive integer.

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

    def __init__(
        self,
        leading: Callable,
        residual: Callable,
        n_differential: int,
        *,
        bandwidth: int | None = None,
        names: Sequence[str] | None = None,
        units: Sequence[str] | None = None,
        time_unit: str | None = None,
    ):
        self.names, self.units, self.time_unit = words(names), words(units), time_word(time_unit)
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
        """The number of differential rows, which is also the number of exponents."""
        return self.field.n_differential

    @classmethod
    def reduced(
        cls,
        leading: Callable,
        residual: Callable,
        args: Any = None,
        *,
        t0: Any = 0.0,
        names: Sequence[str] | None = None,
        units: Sequence[str] | None = None,
        time_unit: str | None = None,
    ) -> "DAE":
        """A DAE for an E of any constant rank d, which need not have zero rows.

        The equations are multiplied by an orthogonal matrix whose first d rows span the range of E(t). Which d columns
        of E span it is determined at t0, by a QR factorisation with pivoting.

        Args:
            leading: ``(t, args) -> E`` (n, n), of constant rank.
            residual: ``(t, x, args) -> f`` (n,).
            args: parameters at which the rank is determined.
            t0: time at which the rank is determined.
            names: what the components of x are called, as for `lh.Flow`.
            units: in which they are measured, likewise.
            time_unit: in which time is measured, as for `lh.Flow`.

        Raises:
            ValueError: if E(t0) is zero.

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
            names=names,
            units=units,
            time_unit=time_unit,
        )


def _check_whole(name: str, value) -> None:
    good = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if not good or value < 1:
        raise ValueError(f"{name} must be at least 1; got {value!r}.")


def _range(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Indices of columns that span the range of a matrix, and a basis of the orthogonal complement of the range."""
    q, r, order = (np.asarray(part) for part in scipy.linalg.qr(matrix, pivoting=True))  # pyright: ignore
    size = np.abs(np.diag(r))
    rank = int(np.sum(size > RANK * size[0]))
    if rank == 0:
        raise ValueError(
            "leading(t0, args) is zero: nothing is differential. Write E with E(t) x' = f(t, x), or solve f = 0."
        )
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
    """The number of exponents of a system with n components: the largest d of its modes (n without constraints)."""
    fields = fields_of(system)
    return max((one.n_differential if isinstance(one, Constrained) else n for one in fields), default=n)


def parts_of(field: Any, n: int) -> tuple[Constrained, Any]:
    """A bound field as (`Constrained`, args); an ordinary field becomes one with E = I and no constraints."""
    if is_constrained(field):
        return field.field, field.args
    return Constrained(lambda t, args: np.eye(n, dtype=jnp.result_type(t)), lambda t, x, args: field(t, x), n), None
