"""Periodic orbits and their Floquet multipliers, through all jumps on the way.

Newton's method for an orbit, in `shooting`, needs the fundamental matrix M = dφ_T/dx that it is after anyway: its
eigenvalues are the multipliers μ, and the exponents ln|μ|/T.
"""

import functools
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from . import frames, runs
from ._tracing import traced
from .checks import positive, real, require, whole
from .daes import Constrained, fields_of
from .methods import HalfExplicit, RungeKutta
from .methods.base import Method
from .periods import check_period, depends_on_time
from .precision import digits
from .products import product_eigenvalues
from .shooting import Motion, Node, NoPeriodicOrbit, Orbit, at_start, close_return, nearest, newton, placed
from .systems import Flow, Hybrid, Map

__all__ = ["CONVERGED", "Floquet", "floquet", "floquet_of", "require_period"]

CONVERGED = 1e-9  # residual, relative to the orbit, that a periodic orbit must reach
ALONG = 1e-6  # of a velocity, by which it may be missed: orbits miss it by rounding, all else by about itself …
ROUNDED = 1e-9  # … and of the largest that a derivative could make of it, where errors are as large


class Floquet(eqx.Module):
    """A periodic orbit and its multipliers.

    Attributes:
        x0: (n,) the point of the orbit at t0 (of an autonomous system: the one nearest to the start that was given).
        period: T.
        multipliers: complex (n,), the largest first; exactly 0 where a direction is destroyed on the way. Of
            an `lh.DAE` there are n_differential.
        exponents: (n,) ln|μ|/T, descending; -inf where μ = 0.
        stable: whether all multipliers, but the 1 along the flow of an autonomous system, are inside the unit circle.
        residual: largest |φ_T(x) − x| over the nodes, relative to the size of the orbit; inf of what is no orbit: where
            the mode after T is another, or an autonomous system does not carry its velocity along to itself.
        monodromy: (n, n), dx(T)/dx(0) at a point of the orbit that may be another than x0, away from events.
        base: that point, as its time, state and mode.
        mode: index of the mode at x0.
        events: number of jumps in a period.
    """

    x0: Array
    period: float = eqx.field(static=True)
    multipliers: Array
    exponents: Array
    stable: bool = eqx.field(static=True)
    residual: float = eqx.field(static=True)
    monodromy: Array
    base: tuple[float, Array, int]
    mode: int = eqx.field(static=True)
    events: int = eqx.field(static=True)

    def __str__(self) -> str:
        lines = [f"Periodic orbit, T = {self.period:.12g}, {self.events} jumps, residual {self.residual:.1e}"]
        for mu, rate in zip(np.asarray(self.multipliers), np.asarray(self.exponents), strict=True):
            value = f"{mu.real:.9g}" + (f" {'-' if mu.imag < 0 else '+'} {abs(mu.imag):.9g}i" if mu.imag else "")
            lines.append(f"  μ = {value:<28s} λ = {rate:.12g}")
        return "\n".join([*lines, f"  {'stable' if self.stable else 'not asymptotically stable'}"])

    __repr__ = __str__


def floquet(
    system: Flow | Map | Hybrid,
    x0,
    args: Any = None,
    *,
    period: Any = None,
    t0=0.0,
    mode: str | int | None = None,
    method: Method | None = None,
    transient=0.0,
    segments: int = 1,
    max_iterations: int = 30,
    throw: bool = True,
) -> Floquet:
    """The periodic orbit near x0, and its Floquet multipliers.

    After T the state is the same, and the mode; and of an autonomous system one multiplier is 1, as its velocity is
    carried along to itself. Where Newton's method comes to a point whose motion ends in another mode it goes on from
    there, by a turn of the motion.

    Args:
        system: an `lh.Flow`, `lh.Hybrid` (sliding modes included) or `lh.Map`.
        x0: (n,) a point near the orbit; far from it give a transient, where the orbit attracts.
        args: pytree of parameters.
        period: of a system that depends on time: a multiple of its own period, a number or ``args -> number`` (of a map
            the number of iterations). None: unknown, for autonomous systems; it is taken from the first close return.
        t0: the time at x0.
        mode: mode at x0, where there are several.
        method: one that is right for the system; None: the default with rtol = 1e-12.
        transient: run for so long before, in whole periods where the period is given.
        segments: of multiple shooting: more for orbits that are long and unstable, or whose smallest multipliers are
            wanted: in the derivative of one piece they are hidden by the rounding of the largest.
        max_iterations: of Newton's method.
        throw: raise where it does not converge; False returns what there is, with its residual.

    Returns:
        A `Floquet`.

    Raises:
        ValueError: on arguments that do not fit; on a system that depends on time, without a period or with one after
            which fields, guards, resets or clocks are not as before: it says which seems to be theirs.
        NoPeriodicOrbit: where Newton's method does not converge, or to what is no orbit (an equilibrium; what closes in
            another mode), and `throw`; where no close return was found.
        RunFailed: where the motion from x0 itself fails.

    Source:
        R. Seydel, Practical Bifurcation and Stability Analysis (Springer 2010), chapter 7,
        doi:10.1007/978-1-4419-1740-9; for jumps R. I. Leine & H. Nijmeijer, Dynamics and Bifurcations of Non-Smooth
        Mechanical Systems (Springer 2004), doi:10.1007/978-3-540-44398-8.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> def van_der_pol(t, x, mu):
        ...     return jnp.stack([x[1], mu * (1 - x[0] ** 2) * x[1] - x[0]])
        >>> orbit = lh.floquet(lh.Flow(van_der_pol), [2.0, 0.0], 1.0)
        >>> round(orbit.period, 6), orbit.stable
        (6.663287, True)
    """
    require(isinstance(system, Flow | Hybrid | Map), f"floquet needs an lh.Flow, lh.Hybrid or lh.Map; got {system!r}.")
    whole("segments", segments, least=1)
    whole("max_iterations", max_iterations, least=1)
    require(not traced((x0, args, t0)), "floquet decides from values: it cannot be used under jit, vmap or grad.")
    discrete = isinstance(system, Map)
    if method is None and not discrete:
        constrained = any(isinstance(field, Constrained) for field in fields_of(system))
        method = HalfExplicit(rtol=1e-12, tableau="dopri8") if constrained else RungeKutta(rtol=1e-12, atol=1e-14)
    problem, start, time, index = runs.prepare(system, x0, args, t0, method, mode)
    require(start.ndim == 1, f"x0 must have shape (n,) here; got {start.shape}.")
    flow = Motion(problem)
    point = Node(float(time), start, index)
    period = period(args) if callable(period) else period
    require_period(flow, period, point)
    real("transient, a length,", transient)
    if transient > 0:
        run = flow.piece(point, float(transient if period is None else np.ceil(transient / period) * period))
        point = Node(point.t, run.x, run.mode)
    autonomous = period is None
    given = point
    point, guess = close_return(flow, point) if period is None else (point, float(np.asarray(period)))
    orbit = newton(flow, placed(flow, point, guess, segments), guess, autonomous, max_iterations)
    base = orbit.nodes[0]
    end = nearest(flow, base, orbit.period, start) if autonomous else at_start(flow, base, given, guess)
    result = floquet_of(flow, orbit, end, autonomous)
    if throw and not result.residual <= digits(CONVERGED, start):
        raise NoPeriodicOrbit(_failure(flow, orbit, result), result)
    return result


def _failure(flow: Motion, orbit: Orbit, result: Floquet) -> str:
    """What Newton's method found instead of an orbit."""
    if orbit.torn:
        wanted, found = (runs.mode_names(flow.problem.system)[mode] for mode in orbit.torn[0])
        return (
            f"No periodic orbit: after {orbit.period:.6g}, {orbit.iterations} iterations of Newton's method, the state "
            f"is back to {orbit.gap:.1e} of its size, but in mode {found!r} where it should be in {wanted!r}: (a) x0 "
            "is too far from a periodic orbit, give a transient or another mode; (b) there is none, the motion leaves "
            "this cycle of events; (c) the period is not one of this motion."
        )
    if orbit.residual <= digits(CONVERGED, orbit.nodes[0].x):
        values = ", ".join(f"{mu:.6g}" for mu in np.asarray(result.multipliers))
        return (
            f"No periodic orbit: the state is back after {orbit.period:.6g}, but one multiplier of an autonomous "
            f"system's orbit is 1, and those here are {values}: (a) it is an equilibrium, its speed is "
            f"{np.linalg.norm(flow.velocity(orbit.nodes[0])):.1e}; (b) the method is too coarse, tighten its "
            "tolerances; (c) the derivative of a reset, guard or field is not that of its values."
        )
    return (
        f"Newton's method stands at a residual of {orbit.gap:.1e} after {orbit.iterations} iterations, "
        f"period {orbit.period:.6g}: (a) x0 is too far from a periodic orbit, give a transient; (b) the orbit is "
        "unstable and long, give segments; (c) the period is not one of this motion."
    )


def _goes_along(flow: Motion, orbit: Orbit) -> bool:
    """Whether each piece carries its velocity to that of the next, M_i f(x_i) = f(x_{i+1}): then a multiplier is 1."""
    along, rounded = (digits(part, orbit.nodes[0].x) for part in (ALONG, ROUNDED))
    speeds = [(piece.matrix, flow.velocity(piece.start), flow.velocity(node)) for piece, node in orbit.seams]
    return all(
        np.linalg.norm(matrix @ before - after)
        < along * np.linalg.norm(after) + rounded * np.linalg.norm(matrix, 2) * np.linalg.norm(before)
        for matrix, before, after in speeds
    )


def require_period(flow: Motion, period, point: Node, where: str = "") -> None:
    """Whether a period was given where there is one to give, and is one from there on."""
    system, args = flow.problem.system, flow.problem.args
    if isinstance(system, Map):
        whole("period, of a map its number of iterations,", period, least=1)
    elif period is not None:
        positive("period", period)
    if period is not None:
        return check_period(system, period, point.x, args, point.t, where=where)
    return require(
        not depends_on_time(system, point.x, args),
        "This system depends on time: give period, that of its forcing or a multiple of it.",
    )


def floquet_of(flow: Motion, orbit: Orbit, point: Node, autonomous: bool) -> Floquet:
    """The multipliers of an orbit that Newton's method found; `point` is the one to show of it."""
    n, base = len(point.x), orbit.nodes[0]
    matrices = [piece.matrix for piece in orbit.pieces]
    monodromy = functools.reduce(lambda product, matrix: matrix @ product, matrices)
    multipliers = product_eigenvalues(matrices)
    # Constraints leave fewer directions than there are components: the others are none that the orbit destroys.
    free = flow.degrees_of_freedom(point)
    multipliers = multipliers[np.argsort(-np.abs(multipliers), kind="stable")][:free]
    multipliers[n - _destroyed(matrices) :] = 0.0
    sizes = np.abs(multipliers)
    exponents = np.where(sizes > 0, np.log(np.where(sizes > 0, sizes, 1.0)) / orbit.period, -np.inf)
    others = np.delete(sizes, np.argmin(np.abs(multipliers - 1))) if autonomous else sizes
    return Floquet(
        x0=jnp.asarray(point.x),
        period=orbit.period,
        multipliers=jnp.asarray(multipliers),
        exponents=jnp.asarray(exponents),
        stable=bool(np.all(others < 1)),
        residual=orbit.residual if not autonomous or _goes_along(flow, orbit) else np.inf,
        monodromy=jnp.asarray(monodromy),
        base=(base.t, jnp.asarray(base.x), 0 if isinstance(flow.problem.system, Map) else flow.mode(base)),
        mode=0 if isinstance(flow.problem.system, Map) else flow.mode(point),
        events=sum(piece.jumps for piece in orbit.pieces),
    )


def _destroyed(matrices: list[np.ndarray]) -> int:
    """How many directions the orbit destroys, over as many turns as it may take.

    Each piece is judged by itself, like a jump in `frames`: contraction over a whole period may be as strong as
    rounding, within one piece it must not be.
    """
    n = len(matrices[0])
    columns = np.eye(n)
    for matrix in matrices * n:
        moved = matrix @ columns
        scale = digits(frames.LOST, matrix) * max(1.0, float(np.max(np.abs(matrix))))
        columns = _independent(moved, scale)
    return int(np.sum(np.all(columns == 0, axis=0)))


def _independent(columns: np.ndarray, scale: float) -> np.ndarray:
    """Orthonormal columns, zero where one depends on those before."""
    out = np.zeros_like(columns)
    for j, column in enumerate(columns.T):
        for _ in range(2):
            column = column - out @ (out.T @ column)
        length = np.linalg.norm(column)
        out[:, j] = column / length if length > scale else 0.0
    return out
