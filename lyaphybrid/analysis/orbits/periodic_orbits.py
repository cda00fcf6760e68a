"""Periodic orbits and their Floquet multipliers, through all jumps on the way.

Newton's method for an orbit, in `shooting`, needs the fundamental matrix M = dφ_T/dx that it is after anyway: its
eigenvalues are the multipliers μ, and the exponents ln|μ|/T.
"""

import dataclasses
import functools
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..._arguments import positive, real, require, whole
from ..._jax.precision import digits
from ..._jax.tracing import traced
from ...engine import preparation, problems
from ...errors import NoPeriodicOrbitError, RunFailedError
from ...integrators import HalfExplicit, RungeKutta
from ...integrators.base import Method
from ...systems.daes.semi_linear import Constrained, fields_of
from ...systems.event_driven import EventDriven
from ...systems.hybrid import Hybrid
from ...systems.smooth import Flow, Map
from .families import energy_moved, family_of
from .invariants import conserved_of, require_conserved
from .multipliers import multipliers_of, stability_of
from .periods import check_period, depends_on_time
from .shooting import Motion, Node, Orbit, at_start, close_return, nearest, newton, placed
from .symmetries import symmetry_of

__all__ = ["CONVERGED", "Floquet", "floquet", "floquet_of", "in_any_case", "require_period"]

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
        stability: what the multipliers say but those that are 1 in any case, along the flow of an autonomous system,
            along a family and along a group: "stable" (all are inside the unit circle), "unstable" (one is outside),
            "elliptic" (those on it are complex), "neutral" (one on it is real, or there are no others).
        residual: largest |φ_T(x) − x| over the nodes, relative to the size of the orbit; inf of what is no orbit: where
            the mode after T is another, or an autonomous system does not carry its velocity along to itself.
        monodromy: (n, n), dx(T)/dx(0) at a point of the orbit that may be another than x0, away from events.
        base: that point, as its time, state and mode.
        mode: index of the mode at x0.
        events: number of jumps in a period.
        shift: (q,) s after a period, of an orbit modulo a group g(x, s): what a runner's step is long.
        family: on how many parameters the orbits near this one depend, whatever is asked to be conserved: 0 of an orbit
            by itself, 1 where an energy is conserved.
        notes: frozenset of names: "family", "moved" (the energy of this orbit is not that of the start).
    """

    x0: Array
    period: float
    multipliers: Array
    exponents: Array
    stability: str = eqx.field(static=True)
    residual: float
    monodromy: Array
    base: tuple[float, Array, int]
    mode: int = eqx.field(static=True)
    events: int = eqx.field(static=True)
    shift: Array
    family: int = eqx.field(static=True)
    notes: frozenset[str] = eqx.field(static=True)

    @property
    def stable(self) -> bool:
        """Whether the stability is "stable": the orbit attracts; one of a family, within what is conserved."""
        return self.stability == "stable"

    def __str__(self) -> str:
        lines = [f"Periodic orbit, T = {self.period:.12g}, {self.events} jumps, residual {self.residual:.1e}"]
        for mu, rate in zip(np.asarray(self.multipliers), np.asarray(self.exponents), strict=True):
            value = f"{mu.real:.9g}" + (f" {'-' if mu.imag < 0 else '+'} {abs(mu.imag):.9g}i" if mu.imag else "")
            lines.append(f"  μ = {value:<28s} λ = {rate:.12g}")
        lines.append("  stable" if self.stable else f"  {self.stability}: not asymptotically stable")
        if self.shift.size:
            lines.append(f"  modulo a shift of {', '.join(f'{s:.12g}' for s in np.asarray(self.shift))} in each period")
        if self.family:
            parameters = "one parameter" if self.family == 1 else f"{self.family} parameters"
            lines.append(f"  one of a family of orbits with {parameters}, along which multipliers are 1")
        if "moved" in self.notes:
            lines.append("  its energy is not that of the start: conserve=True keeps it")
        return "\n".join(lines)

    __repr__ = __str__


def floquet(
    system: Flow | Map | Hybrid | EventDriven,
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
    conserve: Any = None,
    modulo: Any = None,
) -> Floquet:
    """The periodic orbit near x0, and its Floquet multipliers.

    After T the state is the same, and the mode; and of an autonomous system one multiplier is 1, as its velocity is
    carried along to itself. Where Newton's method comes to a point whose motion ends in another mode it goes on from
    there, by a turn of the motion.

    Where something is conserved orbits come in families, and Newton's method goes to one of those near x0. The result
    says so (`family`); `conserve` fixes which one. Multipliers along a family are 1, and are given as 1.

    Args:
        system: an `lh.Flow`, `lh.Hybrid` (sliding modes included), `lh.Map` or `lh.EventDriven` (without a schedule).
        x0: (n,) a point near the orbit; far from it give a transient, where the orbit attracts.
        args: pytree of parameters.
        period: of a system that depends on time: a multiple of its own period, a number or ``args -> number`` (of a map
            the number of iterations). None: unknown, for autonomous systems; it is taken from the first close return.
        t0: the time at x0.
        mode: mode at x0, where there are several.
        method: one that is right for the system; None: the default with rtol = 1e-12; closed forms have none.
        transient: run for so long before, in whole periods where the period is given.
        segments: of multiple shooting: more for orbits that are long and unstable, or whose smallest multipliers are
            wanted: in the derivative of one piece they are hidden by the rounding of the largest.
        max_iterations: of Newton's method.
        throw: raise where it does not converge; False returns what there is, with its residual.
        conserve: what is to have the value that it has at x0: a function ``(x, args) -> number``, or ``-> (c,)`` for
            several, that the motion conserves; ``{"mode": function, …}`` where it differs from mode to mode; True: the
            energy of an `lh.Hamiltonian` or `lh.canonical_flow`.
        modulo: a symmetry after which the orbit closes, x(T) = g(x0): ``g(x) -> x``, a step or a rotation that is
            known; ``g(x, s) -> x`` with g(x, 0) = x, a group whose s is found; the index of a component that grows, or
            several. Multipliers are those of Dg⁻¹ dx(T)/dx(0); along a group they are 1.

    Returns:
        A `Floquet`.

    Raises:
        ValueError: on arguments that do not fit; on a system that depends on time, without a period or with one after
            which fields, guards, resets or clocks are not as before: it says which seems to be theirs; where the motion
            does not conserve what it is to, or has not the symmetry.
        NoPeriodicOrbitError: where Newton's method does not converge, or to what is no orbit (an equilibrium; what
            closes in another mode), and `throw`; where no close return was found.
        RunFailedError: where the motion from x0 itself fails.

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

        A pendulum that swings up to 90°, and one that goes round; each has its energy.

        >>> pendulum = lh.Hamiltonian(lambda p, args: jnp.sum(p**2) / 2, lambda q, args: -jnp.sum(jnp.cos(q)))
        >>> swing = lh.floquet(pendulum, [jnp.pi / 2, 0.0], conserve=True)
        >>> round(swing.period, 6), swing.family, swing.stability
        (7.416299, 1, 'neutral')
        >>> turn = jnp.array([2 * jnp.pi, 0.0])
        >>> round(lh.floquet(pendulum, [0.0, 3.0], conserve=True, modulo=lambda x: x + turn).period, 6)
        2.41289
    """
    kinds = Flow | Hybrid | Map | EventDriven
    require(
        isinstance(system, kinds), f"floquet needs an lh.Flow, lh.Hybrid, lh.Map or lh.EventDriven; got {system!r}."
    )
    require(
        not isinstance(system, EventDriven) or system.schedule is None,
        "floquet needs an lh.EventDriven with next_event, and this one has a schedule: write it without one, or take "
        "lh.tangent_map(…, t1=period) at a point of the orbit, whose eigenvalues are the multipliers.",
    )
    whole("segments", segments, least=1)
    whole("max_iterations", max_iterations, least=1)
    require(not traced((x0, args, t0)), "floquet decides from values: it cannot be used under jit, vmap or grad.")
    discrete = isinstance(system, Map)
    if method is None and not discrete and not isinstance(system, EventDriven):
        constrained = any(isinstance(field, Constrained) for field in fields_of(system))
        method = HalfExplicit(rtol=1e-12, tableau="dopri8") if constrained else RungeKutta(rtol=1e-12, atol=1e-14)
    problem, start, time, index = preparation.prepare(system, x0, args, t0, method, mode)
    require(start.ndim == 1, f"x0 must have shape (n,) here; got {start.shape}.")
    symmetry = symmetry_of(modulo, system, start, problem.args, time)
    flow = Motion(problem, symmetry)
    point = Node(float(time), start, index)
    flow = flow._replace(conserved=conserved_of(conserve, system, start, flow.mode(point), problem.args))
    period = period(args) if callable(period) else period
    require_period(flow, period, point)
    real("transient, a length,", transient)
    if transient > 0:
        run = flow.piece(point, float(transient if period is None else np.ceil(transient / period) * period))
        point = Node(point.t, run.x, run.mode)
    autonomous = period is None
    given = point
    point, guess = close_return(flow, point) if period is None else (point, float(np.asarray(period)))
    if flow.conserved is not None:
        require_conserved(flow, flow.piece(point, guess))
    orbit = newton(flow, placed(flow, point, guess, segments), guess, autonomous, max_iterations)
    base = orbit.nodes[0]
    if autonomous:
        end = nearest(flow, base, orbit.period, start)
    else:
        end = at_start(flow, base, given, guess, orbit.shift)
    result = floquet_of(flow, orbit, end, autonomous, family_of(flow, orbit, autonomous))
    if result.family and conserve is None and energy_moved(flow, given, end):
        result = dataclasses.replace(result, notes=result.notes | {"moved"})
    if throw and not result.residual <= digits(CONVERGED, start):
        raise NoPeriodicOrbitError(_failure(flow, orbit, result), result)
    return result


def _failure(flow: Motion, orbit: Orbit, result: Floquet) -> str:
    """What Newton's method found instead of an orbit."""
    if orbit.torn:
        wanted, found = (problems.mode_names(flow.problem.system)[mode] for mode in orbit.torn[0])
        return (
            f"No periodic orbit: after {orbit.period:.6g}, {orbit.iterations} iterations of Newton's method, the state "
            f"is back to {orbit.gap:.1e} of its size, but in mode {found!r} where it should be in {wanted!r}: (a) x0 "
            "is too far from a periodic orbit, give a transient or another mode; (b) there is none, the motion leaves "
            "this cycle of events; (c) the period is not one of this motion."
        )
    converged = orbit.residual <= digits(CONVERGED, orbit.nodes[0].x)
    if converged and _rests(flow, orbit):
        return (
            f"No periodic orbit: at x = {orbit.nodes[0].x} the motion moves along the group alone, modulo that it is "
            "an equilibrium, and any time is a period: give one element of the group, g(x), such as the turn after "
            "which it is to close."
        )
    if converged and not _repeats(flow, orbit):
        return (
            f"No periodic orbit: the state after {orbit.period:.6g} is the image of that at the start, but the period "
            "is not repeated from there. modulo must be a symmetry of guards, resets and switches too."
        )
    if converged:
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


def _rests(flow: Motion, orbit: Orbit) -> bool:
    """Whether the motion is along the group alone: modulo that it is an equilibrium, which has no period."""
    if flow.symmetry is None or not flow.symmetry.freedom:
        return False
    base = orbit.nodes[0]
    velocity, along = flow.velocity(base), flow.symmetry.image(base.x).by_shift
    across = velocity - along @ np.linalg.lstsq(along, velocity)[0]
    return bool(np.linalg.norm(across) <= digits(ALONG, base.x) * np.linalg.norm(velocity))


def _repeats(flow: Motion, orbit: Orbit) -> bool:
    """Whether the next period is the image of this one, jumps included: else it was no symmetry."""
    if flow.symmetry is None or orbit.torn:
        return True
    start, end = orbit.nodes[0], flow.goal(orbit.goal, orbit.shift)
    try:
        again = flow.piece(orbit.goal._replace(t=start.t), orbit.period)
    except RunFailedError:
        return False
    spread = 1 + np.linalg.norm(again.matrix, 2)
    apart = np.linalg.norm(np.asarray(again.x) - np.asarray(end.x))
    return bool(apart <= digits(ALONG, start.x) * spread * max(1.0, float(np.max(np.abs(start.x)))))


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


def in_any_case(flow: Motion, orbit: Orbit, autonomous: bool, family: np.ndarray) -> np.ndarray:
    """The directions (n, d) at the first node with the multiplier 1; none where it is that along the flow alone."""
    base, known = orbit.nodes[0], family
    if flow.symmetry is not None:
        known = np.column_stack([flow.symmetry.image(base.x).by_shift, family])
    return np.column_stack([flow.velocity(base), known]) if autonomous and known.shape[1] else known


def floquet_of(flow: Motion, orbit: Orbit, point: Node, autonomous: bool, family: np.ndarray | None = None) -> Floquet:
    """The multipliers of an orbit that Newton's method found.

    `point` is the one to show of it; `family` holds the directions (n, f) from its first node to other orbits.
    """
    base = orbit.nodes[0]
    family = np.zeros((len(point.x), 0)) if family is None else family
    matrices = [piece.matrix for piece in orbit.pieces]
    if flow.symmetry is not None:
        matrices[-1] = np.linalg.solve(flow.symmetry.image(base.x, orbit.shift).by_state, matrices[-1])
    known = in_any_case(flow, orbit, autonomous, family)
    # Constraints leave fewer directions than there are components: the others are none that the orbit destroys.
    multipliers, others = multipliers_of(matrices, known, flow.degrees_of_freedom(point), autonomous)
    sizes = np.abs(multipliers)
    exponents = np.where(sizes > 0, np.log(np.where(sizes > 0, sizes, 1.0)) / orbit.period, -np.inf)
    good = not autonomous or (_goes_along(flow, orbit) and not _rests(flow, orbit))
    good = good and _repeats(flow, orbit)
    return Floquet(
        x0=jnp.asarray(point.x),
        period=orbit.period,
        multipliers=jnp.asarray(multipliers),
        exponents=jnp.asarray(exponents),
        stability=stability_of(others, base.x),
        residual=orbit.residual if good else np.inf,
        monodromy=jnp.asarray(functools.reduce(lambda product, matrix: matrix @ product, matrices)),
        base=(base.t, jnp.asarray(base.x), flow.mode(base)),
        mode=flow.mode(point),
        events=sum(piece.jumps for piece in orbit.pieces),
        shift=jnp.asarray(orbit.shift),
        family=family.shape[1],
        notes=frozenset({"family"} if family.shape[1] else ()),
    )
