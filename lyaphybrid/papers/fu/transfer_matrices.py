"""Fu, Wang & Wang's own scheme: fixed steps, and a transfer matrix in the right-hand side at a discontinuity.

The state is (θ, θ', z) with z = t. Where a step of length Δt ends outside the mode of the motion, the next
step uses the new field f₊ for the state and their eqs. (8) and (10) for perturbations,

    u' = J_r u,   J_r = Jac/Δt + (I + Jac) ∂f₋/∂x,   Jac = (f₊ − f₋) ∇h / (∇h·f₋)

An Euler step of it is I + Δt J_r = (I + Jac)(I + Δt ∂f₋/∂x): the saltation matrix S = I + Jac after one step of the
old field. A step of RK4 is P₄(Δt J_r) with P₄(y) = 1 + y + y²/2 + y³/6 + y⁴/24, and where S has the eigenvalue r this
has P₄(r − 1) however small Δt is: 0.375 for r = 0 (a stick, which destroys a direction), 0.607 for r = ½.

It is kept only to show this error. It follows the printed equations except where they cannot run or are misprints:
eq. (11) gets its logarithm and eq. (7) its factors u; the printed f₄ at θ' = 0 is the old field where the motion
crosses, so f₁ or f₂ replaces it; and θ' is set to 0 where the motion stops, because f₃ keeps its value. At a crossing
θ' is kept: set to 0 at a time of the grid, it makes numerical orbits lock onto false cycles.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

__all__ = ["FIELDS", "GUARDS", "SchemeRun", "fourth_order", "run", "saltation", "step_matrix", "transfer_matrix"]

FORWARD, BACKWARD, STICK = 0, 1, 2  # f₂, f₁, f₃ of eq. (13)
TRANSFER_SCHEMES = ("euler", "rk4")


def _force(x, args):
    """A sin ωz − λ sin θ."""
    return args["amplitude"] * jnp.sin(args["omega"] * x[2]) - args["gravity"] * jnp.sin(x[0])


def _slipping(direction):
    def field(x, args):
        rate = _force(x, args) - args["beta"] * x[1] - direction * args["alpha"]
        return jnp.stack([x[1], rate, jnp.ones_like(rate)])

    return field


def _sticking(x, args):
    return jnp.stack([x[1], jnp.zeros_like(x[1]), jnp.ones_like(x[1])])


def _velocity(x, args):
    return x[1]


def _breakaway(direction):
    """The guard h at the end of a stick as printed: A sin ωt − βθ' − λ sin θ − α, and its mirror image."""

    def guard(x, args):
        return _force(x, args) - args["beta"] * x[1] - direction * args["alpha"]

    return guard


FIELDS = (_slipping(+1.0), _slipping(-1.0), _sticking)
GUARDS = (_velocity, _breakaway(+1.0), _breakaway(-1.0))  # of a slip; of a stick that ends forward, backward


def saltation(before, after, guard, x, args) -> Float[Array, "n n"]:
    """I + Jac with Jac = (f₊ − f₋) ∇h / (∇h·f₋), as printed above eq. (6).

    Args:
        before: f₋, ``(x, args) -> dx/dt``.
        after: f₊.
        guard: h, ``(x, args) -> scalar``.
        x: (n,) state on the discontinuity.
        args: parameters.
    """
    f, normal = before(x, args), jax.grad(guard)(x, args)
    return jnp.eye(x.shape[0]) + jnp.outer(after(x, args) - f, normal) / jnp.sum(normal * f)


def transfer_matrix(before, after, guard, x, args, dt) -> Float[Array, "n n"]:
    """J_r of eq. (10), for a step dt; the other arguments are those of `saltation`.

    Example:
        The motion stops: for any Δt, I + Δt J_r removes θ', and the step of RK4 keeps 0.375 of it.

        >>> import jax.numpy as jnp
        >>> from lyaphybrid.papers.fu import transfer_matrices as tm
        >>> pendulum = {"beta": 0.052, "alpha": 0.5, "gravity": 0.87, "amplitude": 0.586, "omega": 0.666}
        >>> stop = tm.FIELDS[0], tm.FIELDS[2], tm.GUARDS[0], jnp.array([0.2, 0.0, 1.0]), pendulum
        >>> J = tm.transfer_matrix(*stop, 1e-3)
        >>> [round(float(tm.step_matrix(J, 1e-3, how)[1, 1]), 4) for how in ("euler", "rk4")]
        [0.0, 0.375]
    """
    derivative = jax.jacfwd(before)(x, args)
    s = saltation(before, after, guard, x, args)
    return (s - jnp.eye(x.shape[0])) / dt + s @ derivative


def step_matrix(matrix: Float[Array, "n n"], dt, method: str) -> Float[Array, "n n"]:
    """The matrix of one step of u' = J u with constant J: I + Δt J, or P₄(Δt J).

    Args:
        matrix: J.
        dt: Δt.
        method: "euler" or "rk4".
    """
    one, y = jnp.eye(matrix.shape[0]), dt * matrix
    return one + y if method == "euler" else one + y @ (one + y @ (one + y @ (one + y / 4) / 3) / 2)


def fourth_order(y):
    """P₄(y), the first five terms of e^y.

    Example:
        >>> from lyaphybrid.papers.fu import transfer_matrices as tm
        >>> tm.fourth_order(-1.0), round(tm.fourth_order(-0.5), 3)
        (0.375, 0.607)
    """
    return 1 + y * (1 + y / 2 * (1 + y / 3 * (1 + y / 4)))


class SchemeRun(NamedTuple):
    """The results of the scheme.

    Attributes:
        growth: (periods, 3) logarithms of the norms of Gram and Schmidt, once a period.
        x: (periods, 3) the states at those times.
        period: 2π/ω.
        sticks, crossings: their numbers.
    """

    growth: np.ndarray
    x: np.ndarray
    period: float
    sticks: int
    crossings: int

    @property
    def running(self) -> np.ndarray:
        """(periods, 3) the exponents of eq. (11) after so many periods."""
        return np.cumsum(self.growth, axis=0) / (self.period * np.arange(1, len(self.growth) + 1))[:, None]

    @property
    def exponents(self) -> np.ndarray:
        """(3,) at the end, descending."""
        return np.sort(self.running[-1])[::-1]

    @property
    def stderr(self) -> np.ndarray:
        """(3,) from 32 batches, in the order of `exponents`."""
        batches = self.growth[: len(self.growth) // 32 * 32].reshape(32, -1, 3).mean(axis=1) / self.period
        order = np.argsort(-self.running[-1], kind="stable")
        return (np.std(batches, axis=0, ddof=1) / np.sqrt(32))[order]


def run(x0, args: dict[str, Any], *, method: str, steps: int, periods: int, transient: int = 0) -> SchemeRun:
    """The scheme for the pendulum of the paper.

    Args:
        x0: (3,) start (θ, θ', z), with θ' ≠ 0 or not at rest.
        args: parameters beta, alpha, gravity, amplitude, omega.
        method: "euler" or "rk4".
        steps: number of steps in a period, Δt = 2π/(ω steps).
        periods: length, in periods of the forcing; Gram–Schmidt once a period.
        transient: number of periods before.

    Returns:
        A `SchemeRun`.

    Source:
        Fu Shihui, Wang Qi & Wang Shimin, Numerical calculation of Lyapunov exponents of discontinuous systems with
        dry friction, Journal of Dynamics and Control 2 (2004), in Chinese.
    """
    if method not in TRANSFER_SCHEMES:
        raise ValueError(f"method must be one of {TRANSFER_SCHEMES}; got {method!r}.")
    args = {name: jnp.asarray(value, float) for name, value in args.items()}
    period = 2 * np.pi / float(args["omega"])
    dt = period / steps
    step, number = jnp.asarray(dt), jnp.asarray(steps)  # as arrays, so that other numbers of steps compile nothing new
    growth, states, counts = _run(jnp.asarray(x0, float), args, step, method, number, transient + periods)
    counts = np.asarray(counts)[transient:].sum(axis=0)
    growth, states = np.asarray(growth)[transient:], np.asarray(states)[transient:]
    return SchemeRun(growth, states, period, int(counts[0]), int(counts[1]))


class _State(NamedTuple):
    x: Array
    u: Array  # (3, 3)
    mode: Array
    before: Array  # mode of f₋ if the step begins at a discontinuity; else equal to mode
    sticks: Array
    crossings: Array


@eqx.filter_jit
def _run(x0, args, dt, method, steps, periods):
    """All periods: the growth, the states, and the numbers of sticks and crossings in each."""
    none = jnp.asarray(0, jnp.int32)
    begun = _settled(x0, args, jnp.where(x0[1] > 0, FORWARD, BACKWARD).astype(jnp.int32))
    mode = jnp.where(x0[1] == 0, begun, jnp.where(x0[1] > 0, FORWARD, BACKWARD)).astype(jnp.int32)

    def period(state, _):
        fresh = state._replace(sticks=none, crossings=none)
        state = jax.lax.fori_loop(0, steps, lambda _, s: _step(s, args, dt, method), fresh)
        u, growth = _gram_schmidt(state.u)
        return state._replace(u=u), (growth, state.x, jnp.stack([state.sticks, state.crossings]))

    start = _State(x0, jnp.eye(3), mode, mode, none, none)
    return jax.lax.scan(period, start, None, length=periods)[1]


def _settled(x, args, mode):
    """The mode at θ' = 0: a stick if friction holds the force, else a slip along the force."""
    force = _force(x, args)
    driven = jnp.where(force > 0, FORWARD, BACKWARD)
    return jnp.where(jnp.abs(force) <= args["alpha"], STICK, driven).astype(mode.dtype)


def _step(state: _State, args, dt, method) -> _State:
    """One step, and the mode after it."""
    x, u = _advanced(state, args, dt, method)
    sign = jnp.where(state.mode == FORWARD, 1.0, -1.0)
    stuck = state.mode == STICK
    left = jnp.where(stuck, jnp.abs(_force(x, args)) > args["alpha"], sign * x[1] <= 0)
    mode = jnp.where(left, _settled(x, args, state.mode), state.mode)
    x = jnp.where(left & (mode == STICK), x.at[1].set(0.0), x)
    return _State(
        x,
        u,
        mode,
        state.mode,
        state.sticks + (left & ~stuck & (mode == STICK)).astype(state.sticks.dtype),
        state.crossings + (left & ~stuck & (mode != STICK) & (mode != state.mode)).astype(state.sticks.dtype),
    )


def _advanced(state: _State, args, dt, method):
    """State and perturbations after Δt."""

    def smooth(x, u, mode):
        def both(field):
            return lambda x, u: (field(x, args), jax.vmap(lambda du: _along(field, x, args, du), 1, 1)(u))

        return jax.lax.switch(mode, [both(field) for field in FIELDS], x, u)

    def at_discontinuity(_):
        matrices = [
            lambda x, before=before, after=after: transfer_matrix(
                FIELDS[before], FIELDS[after], _guard(before, after), x, args, dt
            )
            for before in range(3)
            for after in range(3)
        ]
        matrix = jax.lax.switch(3 * state.before + state.mode, matrices, state.x)
        x, _ = _integrated(lambda x, u: smooth(x, u, state.mode), state.x, state.u, dt, method)
        return x, step_matrix(matrix, dt, method) @ state.u

    def between(_):
        return _integrated(lambda x, u: smooth(x, u, state.mode), state.x, state.u, dt, method)

    return jax.lax.cond(state.before != state.mode, at_discontinuity, between, None)


def _along(field, x, args, du):
    return jax.jvp(lambda x: field(x, args), (x,), (du,))[1]


def _guard(before: int, after: int):
    """The guard h between two modes."""
    return GUARDS[0] if before != STICK else GUARDS[1 if after == FORWARD else 2]


def _integrated(rates, x, u, dt, method):
    """A step of Euler or of the classical Runge–Kutta method, for both."""

    def moved(k, c):
        return x + c * dt * k[0], u + c * dt * k[1]

    first = rates(x, u)
    if method == "euler":
        return moved(first, 1.0)
    second = rates(*moved(first, 0.5))
    third = rates(*moved(second, 0.5))
    fourth = rates(*moved(third, 1.0))
    mean = tuple((a + 2 * b + 2 * c + d) / 6 for a, b, c, d in zip(first, second, third, fourth, strict=True))
    return moved(mean, 1.0)


def _gram_schmidt(u):
    """Orthonormal columns, and the logarithms of their norms; a norm of 0 counts as the smallest positive number."""
    columns, growth = [], []
    for i in range(u.shape[1]):
        column = u[:, i]
        for done in columns:
            column = column - jnp.sum(done * column) * done
        norm = jnp.maximum(jnp.sqrt(jnp.sum(column**2)), jnp.finfo(u.dtype).tiny)
        columns.append(column / norm)
        growth.append(jnp.log(norm))
    return jnp.stack(columns, axis=1), jnp.stack(growth)
