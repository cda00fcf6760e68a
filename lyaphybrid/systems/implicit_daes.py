"""Fully implicit equations F(t, x, x') = 0 of index one, as a strangeness-free `lh.DAE` with a constant E.

Let P (d, n) have orthonormal rows that span the row space of ∂F/∂x', so that F depends on x' through v = P x' alone. In
the unknowns x and v the equations are

    P x' = v,    0 = F(t, x, Pᵀ v),        Ē = [P 0; ∂F/∂x, ∂F/∂x' Pᵀ]

and Ē is nonsingular if the index is one: ∂F/∂x' Pᵀ has full rank d, and ∂F/∂x maps the kernel of P bijectively onto a
complement of the range of ∂F/∂x'. The differential part is P x. So half-explicit and implicit methods keep their order,
as in semi-explicit form; in each stage they solve F = 0 for v and for the part of x in the kernel of P.
"""

import contextlib
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .._arguments import State, require
from .._jax.precision import require_double
from .._linalg.linear_systems import condition, sparse_matmul
from ..errors import NoConsistentPointError
from .bound import require_callable
from .consistency import consistent_start
from .daes.implicit_fields import KERNEL_CHANGE, ImplicitField, in_few_words
from .daes.semi_linear import DAE, ILL, RANK

__all__ = ["implicit_dae"]

KERNEL_SAMPLES = 8  # random points around the start at which the kernel of ∂F/∂x' must be the same
AROUND = 0.3  # their distance from it (standard deviation), relative to 1 + |x|


def implicit_dae(
    equations: Callable,
    x0: State,
    args: Any = None,
    *,
    slope: State | None = None,
    t0: Any = 0.0,
    names: Sequence[str] | None = None,
    time_unit: str | None = None,
) -> DAE:
    """F(t, x, x') = 0 of differentiation index one as an `lh.DAE`, whose state is [x, v], v = P x'.

    If F contains only some components of x', P selects them, and v are their derivatives. The kernel of ∂F/∂x' must be
    the same at all times and states, and with the args of all runs. (If it is not, as with d/dt q(x) for a nonlinear q,
    take q as variables: q' = …, 0 = q − q(x).) The exponents are those of the motion of x; finite-time values use the
    norm of x and v together.

    Args:
        equations: ``(t, x, x', args) -> F`` (n,).
        x0: (n,) a point near the motion, at which the rank of ∂F/∂x' is determined.
        args: pytree of parameters, those of the runs: a term ε y' is dropped if ε = 0 here. A run with others in
            which F contains more of x' is refused, or ends with `STATUS.singular_dae` where args are traced.
        slope: (n,) x' there; None: 0. If F is not linear in x' it should be close to the true value: it chooses the
            branch, here and where `lh.consistent_start` is given x alone.
        t0: time.
        names: what the n components of x are called, as for `lh.Flow`; those of v are v0, v1, ….
        time_unit: in which time is measured, as for `lh.Flow`.

    Returns:
        An `lh.DAE` with n + d components. `lh.consistent_start(dae, x0)` keeps P x0 and solves for the rest and v.

    Raises:
        ValueError: on arguments that do not fit; if F does not depend on x', if the kernel of ∂F/∂x' is not constant,
            or if the index is above one.

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
    v = jnp.asarray(rows) @ dx
    dae = _with_rows(equations, rows, (names, time_unit), in_few_words(args), v)
    state = jnp.concatenate([x, v])
    _check_index(dae, jnp.asarray(t0, float), state, args)
    return dae


def _with_rows(equations: Callable, rows: np.ndarray, labels: tuple, built_with: str, guess) -> DAE:
    """The DAE for the state [x, v] (n + d,), with P (d, n) = rows and a guess (d,) of v."""
    (names, time_unit), (d, n) = labels, rows.shape
    back = np.ascontiguousarray(rows.T)
    leading = np.zeros((n + d, n + d))
    leading[:d, :n] = rows

    def residual(t, state, args):
        x, v = state[:n], state[n:]
        return jnp.concatenate([v, equations(t, x, sparse_matmul(back, v), args)])

    names = None if names is None else [*names, *(f"v{i}" for i in range(d))]
    dae = DAE(lambda t, args: jnp.asarray(leading), residual, d, names=names, time_unit=time_unit)
    field = ImplicitField(dae.field.leading, residual, d, n, equations, built_with, tuple(map(float, guess)))
    return eqx.tree_at(lambda dae: dae.field, dae, field)


def _rows(equations: Callable, t, x, dx, args) -> np.ndarray:
    """The matrix P (d, n); its rows are unit vectors if F depends on some components of x' and not on the others."""
    seen = jax.jit(jax.jacfwd(equations, argnums=2))
    here = np.asarray(seen(t, x, dx, args))
    require(
        bool(np.all(np.isfinite(here))),
        f"∂F/∂x' is not finite at x0 = {np.asarray(x)} with the slope {np.asarray(dx)}: start elsewhere.",
    )
    n, size = x.shape[0], np.max(np.abs(here))
    require(size > 0, "equations(t, x, dx, args) do not depend on dx at x0: nothing is differential. Is dx used?")
    occurs = np.max(np.abs(here), axis=0) > RANK * size
    rank = int(np.linalg.matrix_rank(here, tol=RANK * size))
    rows = np.eye(n)[occurs] if occurs.sum() == rank else np.linalg.svd(here)[2][:rank]
    noise = np.random.default_rng(20101)
    for _ in range(KERNEL_SAMPLES):
        around = [AROUND * (1 + np.abs(one)) * noise.standard_normal(n) + one for one in (x, dx)]
        there = np.asarray(seen(t + noise.standard_normal(), *map(jnp.asarray, around), args))
        if not np.all(np.isfinite(there)):  # outside the domain of F
            continue
        left = np.max(np.abs(there - there @ rows.T @ rows))
        require(
            left <= KERNEL_CHANGE * np.max(np.abs(there)),
            f"The kernel of ∂F/∂x' changes from one state to another: at x = {np.asarray(x)} it has dimension "
            f"{n - rank}, and at x = {around[0]} F depends on x' otherwise. Take what is differentiated as variables.",
        )
    return rows


def _check_index(dae: DAE, t, state, args) -> None:
    """Raise a ValueError if Ē is singular: at the consistent point near the guess, or at the guess if none is found."""
    # From a rough guess, or with an index above one, perhaps no consistent point is found.
    with contextlib.suppress(ValueError, NoConsistentPointError):
        state = consistent_start(dae, state, args, t0=t)
    found = float(jax.jit(lambda t, x: condition(dae.field.whole(t, x, args)))(t, state))
    d, total = dae.n_differential, state.shape[0]
    require(
        found < ILL,
        f"F(t, x, x') = 0 is not of index one at x0: ∂F/∂x' has rank {d} of {total - d}, and together with ∂F/∂x "
        f"along its kernel it is singular (condition number {found:.2g}). Either equations depend on each other "
        "there, or some must be differentiated: a constraint on positions, say, until accelerations occur in it.",
    )
