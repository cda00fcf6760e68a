"""Where the orbits of an autonomous flow shrink to an equilibrium, and their branch ends.

Next to a Hopf point the orbits are x_H + a Re(v exp(iωt)) + O(a²), and p − p_H = O(a²). Multiple shooting does not see
the end at a = 0: it goes on to −a, which is the same orbits half a turn later. So a step that would pass a = 0 is
replaced by one to a smaller orbit, and the Hopf point itself is found from

    f(x; p) = 0,    Df(x; p) v = iω E v,    c·v = 1

(E = I, except in a DAE), by Newton's method from the mean and the first harmonic of the last orbit. Where events remain
until the end, the equilibrium lies on a guard; such a branch is followed until the orbits are points.

Yu. A. Kuznetsov, Elements of Applied Bifurcation Theory (Springer 2004), chapters 3 and 5 and section 10.2,
doi:10.1007/978-1-4757-3978-7; M. di Bernardo, C. Budd, A. Champneys & P. Kowalczyk, Piecewise-smooth Dynamical Systems
(Springer 2008), doi:10.1007/978-1-84628-708-4.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..._jax.engines import compiled
from ..._jax.tracing import as_jax
from ...errors import RunFailedError
from ...systems.daes.semi_linear import Constrained, fields_of
from ..orbits.shooting import Node, OrbitIterate
from ..orbits.symmetries import Symmetry
from .equations import BranchEquations, BranchPoint

__all__ = [
    "BOUNDARY_EQUILIBRIUM",
    "HOPF",
    "Swing",
    "at_a_point",
    "before_equilibrium",
    "hopf_point",
    "in_front_of_hopf",
    "is_smooth",
    "swing_of",
]

HOPF, BOUNDARY_EQUILIBRIUM = "Hopf", "boundary equilibrium"
IN_REACH = 2.0  # steps: an equilibrium farther away than this is not looked for
SHRINKS = 0.5  # of the extent: a step that leaves less may lead through an equilibrium
COLLAPSED = 1e-3  # of the extent: a step that leaves less has arrived at an equilibrium, which is no orbit
OVERTONES = 0.3  # largest share of an orbit that is not its first harmonic, next to a Hopf point
LAST_ORBIT = 0.1  # of the extent: that of the last orbit of a branch, relative to the one before
PARAMETER_ROUNDED = 1e-9  # of the range of the parameter: less tells nothing about what it changes with
MOST_IMAGES = 12  # of an orbit modulo a symmetry, that make up the whole orbit
IMAGE_IS_BACK = 1e-6  # of its size
SHRUNK = 1e-5  # extent, relative to the largest orbit, of what is a point
HOPF_ITERATIONS = 12
HOPF_CONVERGED = 1e-10  # last correction of Newton's method, in scaled unknowns


class Swing(NamedTuple):
    """An orbit about its mean, at equally many times in each of its pieces."""

    mean: np.ndarray  # (n,)
    away: np.ndarray  # (samples, n) of its points from the mean
    weights: np.ndarray  # (samples,) shares of the period
    turns: np.ndarray  # (samples,) time since the first node, in periods of the whole orbit
    images: int  # modulo a symmetry: how many make up the whole orbit

    def times(self, other: "Swing") -> float:
        """The mean product of two orbits."""
        return float(self.weights @ np.sum(self.away * other.away, axis=1))

    @property
    def extent(self) -> float:
        """The root of the mean square distance from the mean."""
        return float(np.sqrt(self.times(self)))

    def resembles(self, other: "Swing | None", share: float) -> bool:
        """Whether another orbit is at the same phase, with about this share of the extent."""
        if other is None or other.images != self.images:
            return False
        ratio = other.extent / (share * self.extent)
        return self.times(other) > 0.5 * self.extent * other.extent and 0.5 < ratio < 2

    @property
    def harmonic(self) -> np.ndarray:
        """Complex (n,): the orbit is its mean and the real part of this, times exp(iωt), and overtones."""
        return 2 * (self.weights * np.exp(-2j * np.pi * self.turns)) @ self.away


def swing_of(orbit: OrbitIterate, symmetry: Symmetry | None = None) -> Swing | None:
    """The whole orbit, with its images modulo a symmetry; None where these do not come back, or change with a group."""
    points = np.concatenate([piece.points for piece in orbit.pieces])
    lengths = [np.full(len(piece.points), piece.length / len(piece.points)) for piece in orbit.pieces]
    times = np.concatenate([piece.start.t - orbit.nodes[0].t + piece.times for piece in orbit.pieces])
    images = [points] if symmetry is None else _images(symmetry, points)
    if images is None:
        return None
    count, whole = len(images), np.concatenate(images)
    weights = np.tile(np.concatenate(lengths), count) / (count * orbit.period)
    turns = np.concatenate([times + i * orbit.period for i in range(count)]) / (count * orbit.period)
    mean = weights @ whole
    return Swing(mean, whole - mean, weights, turns, count)


def _images(symmetry: Symmetry, points: np.ndarray) -> list[np.ndarray] | None:
    """The points (samples, n) and their images, until these are back."""
    if symmetry.freedom:
        return None
    x, size = points[-1], float(np.max(np.abs(points)))
    for count in range(1, MOST_IMAGES + 1):
        x = symmetry.image(x).x
        if np.max(np.abs(x - points[-1])) <= IMAGE_IS_BACK * size:
            images = [points]
            for _ in range(count - 1):
                images.append(np.asarray(_image_of_all(symmetry.action, as_jax(images[-1]))))
            return images
    return None


@eqx.filter_jit
def _image_of_all(action, points):
    return jax.vmap(lambda x: action(x, jnp.zeros(0, x.dtype)))(points)


def is_smooth(orbit: OrbitIterate) -> bool:
    """Whether no event changes anything on the way."""
    events = [piece.events for piece in orbit.pieces if piece.events is not None]
    return all(
        np.array_equal(one.x_before, one.x_after) and np.array_equal(one.mode_before, one.mode_after) for one in events
    )


def before_equilibrium(
    equations: BranchEquations, last: Any, after: Any, length: float, in_front: Callable[[Swing], Any]
) -> Any:
    """The next point of a branch or curve, None for a shorter step; or, before a Hopf point, the last one.

    Where the period is given, or something is conserved, a small orbit is like any other.

    Args:
        equations: those of the branch through the last point.
        last: the last point.
        after: what a step leads to, or None.
        length: of that step.
        in_front: (the last orbit) -> a point with a smaller orbit and the Hopf point that is its `limit`, or None.
    """
    swing = _swing_at(equations, last)
    if swing is None:
        return after
    centre = np.concatenate([swing.mean - np.asarray(node.x) for node in last.orbit.nodes])
    if np.linalg.norm(centre / equations.scales(last.orbit)[: len(centre)]) > IN_REACH * length:
        return after
    passed, left = False, 0.0
    if after is not None:
        ahead = _swing_at(equations, after)
        if ahead is None or ahead.images != swing.images:
            return after
        passed, left = swing.times(ahead) <= 0, ahead.extent / swing.extent
        if left > SHRINKS and not passed:
            return after
    end = in_front(swing) if is_smooth(last.orbit) else None
    if end is not None:
        return end
    return None if passed or left < COLLAPSED else after


def in_front_of_hopf(
    equations: BranchEquations, last: BranchPoint, swing: Swing, over: tuple[float, float]
) -> BranchPoint | None:
    """A smaller orbit between this one and the Hopf point ahead; None if there is no such point."""
    limit = hopf_point(equations, last.orbit, last.parameter, swing)
    if limit is None or not over[0] <= limit.parameter <= over[1]:
        return None
    states = len(last.orbit.nodes) * len(swing.mean)
    outward = last.u - limit.u
    across = np.where(np.arange(len(outward)) < states, outward, 0.0)
    distance = float(np.linalg.norm(across))
    if not distance > 0 or last.tangent @ outward >= 0:
        return None
    shares = np.where(np.arange(len(outward)) < states, LAST_ORBIT, LAST_ORBIT**2)
    guess, across = limit.u + shares * outward, across / distance
    end = equations.corrected(guess, last.orbit, across, float(across @ guess), reach=LAST_ORBIT * distance)
    if end is None or not over[0] <= end.parameter <= over[1]:
        return None
    off, before = (abs(point.parameter - limit.parameter) for point in (end, last))
    if off > LAST_ORBIT * before + PARAMETER_ROUNDED * equations.span:
        return None
    ahead = swing_of(end.orbit, equations.symmetry)
    return end._replace(tangent=-end.tangent, limit=limit) if swing.resembles(ahead, LAST_ORBIT) else None


def hopf_point(equations: BranchEquations, near: OrbitIterate, p: float, swing: Swing) -> BranchPoint | None:
    """The Hopf point next to an orbit, with nodes as that orbit has; None if none is found."""
    v = swing.harmonic
    rest = swing.away - np.real(np.exp(2j * np.pi * swing.turns)[:, None] * v)
    if swing._replace(away=rest).extent > OVERTONES * swing.extent:
        return None
    found = _solved(equations, near.nodes[0], p, 2 * np.pi / (swing.images * near.period), swing.mean, v)
    if found is None:
        return None
    x, p, omega = found
    scales, states = equations.scales(near), len(near.nodes) * len(x)
    values = equations.vector(near, p) * scales
    inward = -values / scales
    values[:states], values[states] = np.tile(x, len(near.nodes)), 2 * np.pi / (swing.images * omega)
    u = values / scales
    try:
        orbit, p = equations.shoot(u, near)
    except (RunFailedError, ValueError):
        return None
    inward += u
    return BranchPoint(orbit, p, u, equations.linearised(orbit, p)[0], inward / np.linalg.norm(inward), 0)


def _solved(
    equations: BranchEquations, node: Node, p: float, omega: float, x: np.ndarray, v: np.ndarray
) -> tuple[np.ndarray, float, float] | None:
    """State, parameter and frequency at a Hopf point, by Newton's method."""
    n, flow, swings = len(x), equations.motion(p), np.abs(v)
    units = np.where(swings > 0, swings, np.max(swings))  # of each component, so that those of the state do not matter
    unit = v / units / np.linalg.norm(v / units)
    c = np.concatenate([unit.real / units, unit.imag / units])
    z = np.concatenate([x, [p, omega], unit.real * units, unit.imag * units])
    columns = np.concatenate([np.maximum(units, np.abs(x)), [equations.span, omega], units, units])
    system, mode = flow.problem.system, flow.mode(node)
    for _ in range(HOPF_ITERATIONS):
        gaps, jacobian = map(
            np.asarray, _hopf_equations(system, equations.args_of, mode, *as_jax((np.asarray(node.t), z, c)))
        )
        if not (np.all(np.isfinite(jacobian)) and np.all(np.isfinite(gaps))):
            return None
        rows = np.linalg.norm(jacobian * columns, axis=1)
        rows = np.where(rows > 0, rows, 1.0)
        step = np.linalg.lstsq(jacobian * columns / rows[:, None], -gaps / rows, rcond=1e-13)[0]
        z = z + step * columns
        if np.linalg.norm(step) <= HOPF_CONVERGED:
            return z[:n], float(z[n]), float(z[n + 1])
    return None


@compiled()
def _hopf_equations(system, args_of, mode: int, t, z, c):
    """The residuals (3n + 2,) of the equations of a Hopf point, and their Jacobian."""
    n, field = (z.shape[0] - 2) // 3, fields_of(system)[mode]
    constrained = isinstance(field, Constrained)
    slope = field.residual if constrained else field

    def gaps(z):
        x, p, omega, real, imaginary = z[:n], z[n], z[n + 1], z[n + 2 : 2 * n + 2], z[2 * n + 2 :]
        args = args_of(p)
        value, along = jax.linearize(lambda x: slope(t, x, args), x)
        leading = jnp.asarray(field.leading(t, args)) if constrained else jnp.eye(n, dtype=z.dtype)
        rates = along(real) + omega * leading @ imaginary, along(imaginary) - omega * leading @ real
        ends = jnp.stack([c[:n] @ real + c[n:] @ imaginary - 1, c[:n] @ imaginary - c[n:] @ real])
        return jnp.concatenate([value, *rates, ends])

    return gaps(z), jax.jacfwd(gaps)(z)


def _swing_at(equations: BranchEquations, point: Any) -> Swing | None:
    """The orbit of a point about its mean; None where a small orbit is like any other."""
    free = equations.autonomous and not equations.discrete and equations.conserved is None
    return swing_of(point.orbit, equations.symmetry) if free else None


def at_a_point(equations: BranchEquations, points: list[Any]) -> BranchPoint | None:
    """The last orbit, with the parameter at which it would be a point; None unless the orbits have shrunk to one."""
    swings = [_swing_at(equations, point) for point in points]
    extents = [swing.extent for swing in swings if swing is not None]
    if len(extents) < 2 or not extents[-1] < min(extents[-2], SHRUNK * max(extents)):
        return None
    share, last = extents[-1] / (extents[-2] - extents[-1]), points[-1]
    return last._replace(parameter=last.parameter + share * (last.parameter - points[-2].parameter))
