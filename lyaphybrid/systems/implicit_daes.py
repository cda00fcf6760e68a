"""Fully implicit equations F(t, x, x') = 0 of index one, as a strangeness-free `lh.DAE` with a constant E.

Let P (d, n) have orthonormal rows that span those of ∂F/∂x', so that F depends on v = P x' alone. In the unknowns x and
v the equations are

    P x' = v,    0 = F(t, x, Pᵀ v),        Ē = [P 0; ∂F/∂x, ∂F/∂x' Pᵀ]

and Ē is nonsingular where the index is one: ∂F/∂x' Pᵀ has full rank d, and on what it leaves out ∂F/∂x is nonsingular
along the kernel of P. The content is P x. So half-explicit and implicit methods keep their order, as in semi-explicit
form; what they solve in each stage, F = 0 for the kernel's part of x and for v, is F linearised.
"""

import contextlib
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .._arguments import require
from .._jax.precision import require_double
from .._linalg.linear_systems import times
from .bound import require_callable
from .consistency import consistent_start
from .daes.semi_linear import DAE, ILL, RANK, Constrained

__all__ = ["ImplicitField", "implicit_dae"]

LOOKS = 8  # points around the start where the kernel of ∂F/∂x' must be the same
AROUND = 0.3  # how far from it they are, relative to 1 + |x|


class ImplicitField(Constrained):
    """The field of a DAE whose state is [x, v].

    Attributes:
        n: components of x.
    """

    n: int = eqx.field(static=True)

    def whole_guess(self, x):
        """[x, 0] for x (n,) alone; a state as it is."""
        return jnp.concatenate([x, jnp.zeros(self.n_differential, x.dtype)]) if x.shape[0] == self.n else x


def implicit_dae(equations: Callable, x0, args: Any = None, *, slope=None, t0: Any = 0.0) -> DAE:
    """F(t, x, x') = 0 of differentiation index one as an `lh.DAE`, whose state is [x, v], v = P x'.

    Where components of x' do not occur in F, P takes the others: v are the derivatives of those components. The kernel
    of ∂F/∂x', of what F does not see of x', must be the same at all times and states. (Where it is not, as in
    d/dt q(x) with any q, take q as variables: q' = …, 0 = q − q(x).) Exponents are those of the motion of x; the metric
    at finite times is that of x and v together.

    Args:
        equations: ``(t, x, x', args) -> F`` (n,).
        x0: (n,) a point near the motion, at which the rank of ∂F/∂x' is determined.
        args: pytree of parameters.
        slope: (n,) x' there; None: 0. Where F is not linear in x' it should be near the truth.
        t0: time.

    Returns:
        An `lh.DAE` with n + d components. `lh.consistent_start(dae, x0)` keeps P x0 and finds the others, and v.

    Raises:
        ValueError: on arguments that do not fit; where F does not see x'; where the kernel of ∂F/∂x' is not constant;
            where the index is above one.

    Source:
        P. Kunkel & V. Mehrmann, Differential-Algebraic Equations (EMS 2006), doi:10.4171/017.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> def equations(t, x, dx, args):
        ...     return jnp.stack([dx[0] + 0.1 * dx[0] ** 3 + x[1], x[1] - x[0]])
        >>> dae = lh.implicit_dae(equations, [1.0, 1.0])
        >>> start = lh.consistent_start(dae, [1.0, 1.0])
        >>> [round(float(value), 4) for value in start]
        [1.0, 1.0, -0.9217]
        >>> round(float(lh.lyapunov_spectrum(dae, start, t1=20.0, transient=20.0).exponents[0]), 6)
        -1.0
    """
    require_callable("equations", equations, "(t, x, x', args) -> F")
    x = jnp.asarray(x0, float)
    require_double("x0", x, "implicit_dae")
    require(x.ndim == 1 and bool(np.all(np.isfinite(x))), f"x0 must be a finite state (n,); got {x0!r}.")
    n = x.shape[0]
    dx = jnp.zeros(n) if slope is None else jnp.asarray(slope, float)
    require(dx.shape == (n,), f"slope must have the shape of x0, ({n},); got {dx.shape}.")
    shape = jax.eval_shape(equations, jnp.asarray(t0, float), x, dx, args).shape
    require(shape == (n,), f"equations(t, x, x', args) must have the shape of x0, ({n},); got {shape}.")
    rows = _rows(equations, jnp.asarray(t0, float), x, dx, args)
    dae = _with_rows(equations, rows)
    state = jnp.concatenate([x, jnp.asarray(rows) @ dx])
    _check_index(dae, jnp.asarray(t0, float), state, args)
    return dae


def _with_rows(equations: Callable, rows: np.ndarray) -> DAE:
    """The equations for [x, v]."""
    d, n = rows.shape
    back = np.ascontiguousarray(rows.T)
    leading = np.zeros((n + d, n + d))
    leading[:d, :n] = rows

    def residual(t, state, args):
        x, v = state[:n], state[n:]
        return jnp.concatenate([v, equations(t, x, times(back, v), args)])

    dae = DAE(lambda t, args: jnp.asarray(leading), residual, d)
    return eqx.tree_at(lambda dae: dae.field, dae, ImplicitField(dae.field.leading, residual, d, n))


def _rows(equations: Callable, t, x, dx, args) -> np.ndarray:
    """P (d, n): unit vectors where F sees some components of x' and not the others."""
    seen = jax.jit(jax.jacfwd(equations, argnums=2))
    here = np.asarray(seen(t, x, dx, args))
    require(bool(np.all(np.isfinite(here))), "∂F/∂x' is not finite at x0 and slope: start elsewhere.")
    n, size = x.shape[0], np.max(np.abs(here))
    require(size > 0, "equations do not depend on x' at x0: nothing is differential.")
    occurs = np.max(np.abs(here), axis=0) > RANK * size
    rank = int(np.linalg.matrix_rank(here, tol=RANK * size))
    rows = np.eye(n)[occurs] if occurs.sum() == rank else np.linalg.svd(here)[2][:rank]
    noise = np.random.default_rng(20101)
    for _ in range(LOOKS):
        around = [AROUND * (1 + np.abs(one)) * noise.standard_normal(n) + one for one in (x, dx)]
        there = np.asarray(seen(t + noise.standard_normal(), *map(jnp.asarray, around), args))
        if not np.all(np.isfinite(there)):  # outside of where F is defined
            continue
        left = np.max(np.abs(there - there @ rows.T @ rows))
        require(
            left <= 1e-8 * np.max(np.abs(there)),
            f"The kernel of ∂F/∂x' changes from one state to another: at x = {np.asarray(x)} it has dimension "
            f"{n - rank}, and at x = {around[0]} F depends on x' otherwise. Take what is differentiated as variables.",
        )
    return rows


def _check_index(dae: DAE, t, state, args) -> None:
    """Whether Ē is nonsingular: at the guess, and where that is no point of the motion, at a consistent one near it."""
    with contextlib.suppress(ValueError):  # from a rough guess, or with an index above one, none may be found
        state = consistent_start(dae, state, args, t0=t)
    whole = np.asarray(jax.jit(lambda t, x: dae.field.whole(t, x, args))(t, state))
    scaled = whole / np.maximum(np.linalg.norm(whole, axis=1, keepdims=True), 1e-300)
    d, total = dae.n_differential, whole.shape[0]
    condition = np.linalg.cond(scaled) if np.all(np.isfinite(scaled)) else np.inf
    require(
        bool(condition < ILL),
        f"F(t, x, x') = 0 is not of index one at x0: ∂F/∂x' has rank {d} of {total - d}, and together with ∂F/∂x "
        f"along its kernel it is singular (condition number {condition:.2g}). Either equations depend on each other "
        "there, or some must be differentiated: a constraint on positions, say, until accelerations occur in it.",
    )
