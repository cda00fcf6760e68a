"""Phase and isostable responses of limit cycles, through their jumps.

Near a stable cycle each state has a phase θ, θ' = 1, and isostable coordinates ψ, ψ' = κψ, that decay. Their gradients
along the cycle are rows that the tangent map Φ of the cycle, with all saltation matrices, carries backwards,

    Z(s)ᵀ = Z(t)ᵀ Φ(t, s),     I(s)ᵀ = I(t)ᵀ Φ(t, s) e^(−κ (t − s)),

from the left eigenvectors of the monodromy matrix: Zᵀ M = Zᵀ with Z·f = 1, and Iᵀ M = μ Iᵀ, κ = ln μ / T. Nothing is
inverted, so directions that a jump destroys are no obstacle.
"""

import dataclasses
import functools
import warnings
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ... import plots
from ..._arguments import State, integers, require, require_values, whole
from ..._keywords import explains_keywords, user_level
from ..._linalg.eigenrows import eigenrows
from ..._text import Table
from ...engine import preparation
from ...errors import RunFailedError
from ...integrators import RungeKutta
from ...integrators.base import Method
from ...results.result import Data, Result, in_time
from ...systems.daes.semi_linear import Constrained, fields_of
from ...systems.hybrid import Hybrid
from ...systems.labels import Labels, labels_of
from ...systems.smooth import Flow
from ..trajectories import tangent_map
from .motion.motions import Motion, Node, sized
from .periodic_orbits import Floquet, floquet
from .periods import depends_on_time
from .phase_readings import MovingOn, PhaseReader

__all__ = ["PhaseResponse", "phase_response"]

PHASES_SHOWN = 12  # rows of a table
SETTLED = 1e-7  # part to which what decays slowest shrinks before a phase is read off …
MOST_TURNS = 20_000  # … within so many periods …
LONGER_RETURNS = 4  # … and so many times these, where the motion took its time …
NEAR_ENOUGH, BACK_ON_CYCLE = 1e-6, 1e-5  # … to come so near to the cycle, relative to its size; it must come so near
NEUTRAL_RATE = 1e-9  # rates of a phase difference below this, relative to the interaction function, are errors of it
FORCED = (
    "phase_response is of systems that do not depend on time: a forced motion has the phase of what forces it. "
    "lh.floquet gives its multipliers."
)
EVEN = (
    "The interaction function is even: every phase difference stays as it is, to the first order of the coupling, and "
    "none attracts. None is returned."
)
NO_EIGENVECTORS = (
    "`isostables` are nan for multipliers of size {}: equal ones, as far as can be told, with fewer eigenvectors than "
    "that (a Jordan block), so that motions decay like t·exp(κt) and there is no isostable coordinate for each. "
    "`response` is not concerned."
)
FAMILY = (
    "This orbit is one of a family with a conserved quantity: a kick leads to a neighbour, not back, so that there is "
    "no phase response."
)


class PhaseResponse(Result, eqx.Module):
    """Responses along a limit cycle at equally spaced phases.

    Attributes:
        t: (phases,) the phases, as times since `x[0]`; x: (phases, n) states there; mode: (phases,) indices.
        period: T.
        response: (phases, n) Z = ∂θ/∂x, by how much time the motion is ahead for good after a small kick, per unit of
            it; in a mode that is bound to a surface for kicks along the surface.
        multipliers: (m,) Floquet multipliers but that of the phase and those that are 0, the largest first.
        isostables: (phases, n, m) I = ∂ψ/∂x, complex, scaled by I·v = 1 at x[0] with the eigenvector v, |v| = 1; of
            equal multipliers for a basis of their eigenspace, nan if it has fewer dimensions (a Jordan block).
        orbit: the `Floquet` orbit.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> clock = lh.Flow(lambda t, x, a: x * (1 - x @ x) + jnp.stack([-x[1], x[0]]))
        >>> found = lh.phase_response(clock, [1.0, 0.2], phases=8)
        >>> ahead = found.finite([0.0, 0.1])  # atan2(y + 0.1, x) − atan2(y, x)
        >>> x, y = found.x.T
        >>> bool(jnp.allclose(ahead, jnp.arctan2(x * 0.1, 1 + y * 0.1), atol=1e-8))
        True
    """

    t: np.ndarray
    x: np.ndarray
    mode: np.ndarray
    response: np.ndarray
    isostables: np.ndarray
    multipliers: np.ndarray
    orbit: Floquet
    state_labels: Labels = eqx.field(static=True)
    _cycle: MovingOn = eqx.field(static=True)

    @property
    def period(self) -> float:
        """T."""
        return self.orbit.period

    def finite(self, kick: Any, at: Sequence[int] | None = None) -> np.ndarray:
        """The time by which the motion is ahead for good after a kick of any size at each phase, by simulation.

        Args:
            kick: what is added to the state, (n,), or (phases, n). The mode stays as it is: in one that is bound to a
                surface, kick along the surface. A kick across a guard is no crossing, unless a `flow_set` ends there:
                with ``flow_set=lambda t, x, args: 1 - x[0]`` a kick over the threshold 1 is a spike.
            at: indices of phases; None: all.

        Returns:
            (phases,) times in (−T/2, T/2], for phases are equal modulo T: a delay by 0.9 T is ahead by 0.1 T. nan where
            the motion has not come back to the cycle after four times the periods in which the multipliers let a kick
            decay to 1e-7 (at most 80 000).

        Raises:
            ValueError: on another shape, or on indices that are none.
        """
        n, d = self.x.shape
        phases = range(n) if at is None else integers("at", at, 0, n - 1)
        kicks = np.asarray(kick, float)
        m = len(phases)
        require(kicks.shape in ((d,), (m, d)), f"kick must have shape ({d},) or ({m}, {d}); got {kicks.shape}.")
        kicks = np.broadcast_to(kicks, (m, d))
        reader = PhaseReader.of(self._cycle, self.period, self.x, self.mode, self.response)
        return np.array([self._ahead_after(reader, k, one) for k, one in zip(phases, kicks, strict=True)])

    def _ahead_after(self, reader: PhaseReader, k: int, kick) -> float:
        slowest = float(np.max(np.abs(self.multipliers), initial=0.0))
        wanted = 1.0 if slowest < SETTLED else np.log(SETTLED) / np.log(min(slowest, 1 - 1e-9))
        turns = max(2, min(MOST_TURNS, int(np.ceil(wanted)))) * self.period
        y, mode, phase, distance = self.x[k] + kick, self.mode[k], np.nan, np.inf
        try:
            for _ in range(LONGER_RETURNS):
                y, mode = self._cycle.moved(y, mode, turns)
                phase, distance = reader.read(y, mode)
                if distance <= NEAR_ENOUGH:
                    break
        except RunFailedError:
            return np.nan
        ahead = phase - self.t[k] if distance <= BACK_ON_CYCLE else np.nan
        return (ahead + self.period / 2) % self.period - self.period / 2

    def interaction(self, coupling: Callable) -> np.ndarray:
        """(phases,) the interaction function Γ(Δ) = ⟨Z(s) · G(x(s), x(s + Δ))⟩ at Δ = `t`.

        An oscillator that feels s G(x, y) of another one, ahead of it by Δ, has θ' = 1 + s Γ(Δ) for small s. Where Z or
        G jump the mean is right to about one in so many phases.

        Args:
            coupling: G, ``(x, y, args) -> (n,)``, of the states of the oscillator and of the other one.
        """
        x, args = jnp.asarray(self.x), self._cycle.args
        inputs = jax.vmap(lambda own: jax.vmap(lambda other: coupling(own, other, args))(x))(x)
        each = np.einsum("kd,kjd->kj", self.response, np.asarray(inputs))
        n = len(self.t)
        return np.array([np.mean(each[np.arange(n), (np.arange(n) + shift) % n]) for shift in range(n)])

    def locked(self, coupling: Callable) -> list[tuple[float, bool]]:
        """Phase differences at which two such oscillators, each coupled to the other, stay; with whether each attracts.

        The zeros of Γ(−Δ) − Γ(Δ), by linear interpolation, 0 ≤ Δ < T. Where this is 0 for all Δ, to a billionth of the
        largest |Γ|, every difference stays, to this order, and none attracts: none is returned, with a warning.

        Args:
            coupling: as for `interaction`.
        """
        of = self.interaction(coupling)
        rate = np.roll(of[::-1], 1) - of  # of Δ
        after, step, found = np.roll(rate, -1), self.period / len(rate), []
        tiny = NEUTRAL_RATE * np.max(np.abs(of))
        if np.all(np.abs(rate) <= tiny):
            warnings.warn(EVEN, stacklevel=user_level())
            return []
        for k, (one, other) in enumerate(zip(rate, after, strict=True)):
            if abs(one) <= tiny:
                found.append((float(self.t[k]), bool(other < 0)))
            elif abs(other) > tiny and one * other < 0:
                found.append((float(self.t[k] + step * one / (one - other)), bool(other < 0)))
        return found

    def plot(self, ax: plots.Axes | None = None, **style: Any) -> plots.Axes:
        """The phase response of each component against the phase. `style` goes to what it draws."""
        return plots.phase_responses(self, ax, **style)

    def _table(self) -> Table:
        names = self.state_labels.columns(self.x.shape[1])
        chosen = np.unique(np.linspace(0, len(self.t) - 1, PHASES_SHOWN).astype(int))
        rows = [(f"{self.t[i]:.6g}", *(f"{value:.6g}" for value in (*self.x[i], *self.response[i]))) for i in chosen]
        sizes = ", ".join(f"{abs(mu):.6g}" for mu in self.multipliers) or "none"
        notes = [f"other multipliers, their sizes: {sizes}"]
        if np.any(np.isnan(self.isostables)):
            notes.append("some isostable responses are nan: equal multipliers with too few eigenvectors")
        heads = ("phase", *names, *(f"∂θ/∂{name}" for name in names))
        unit = self.state_labels.time_unit or "units of time"
        return Table(f"Phase response of a cycle of period {self.period:.9g}, in {unit}", rows, notes, heads)

    def _data(self) -> Data:
        labels, m = self.state_labels.columns(self.x.shape[1]), len(self.multipliers)
        variables = {
            "x": (("phase", "state"), self.x),
            "mode": ("phase", self.mode),
            "response": (("phase", "state"), self.response),
            "isostables": (("phase", "state", "multiplier"), self.isostables) if m else None,
            "multipliers": ("multiplier", self.multipliers) if m else None,
        }
        phases = ("phase", self.t, in_time(self.state_labels.time_unit))
        return Data(variables, {"phase": phases, "state": labels}, {"period": self.period})


@explains_keywords
def phase_response(
    system: Flow | Hybrid,
    x0: State,
    args: Any = None,
    *,
    phases: int = 200,
    mode: str | int | None = None,
    method: Method | None = None,
    transient: float = 0.0,
    segments: int = 1,
) -> PhaseResponse:
    """How a limit cycle, with its jumps, answers small kicks: by a shift of its phase, and by what decays.

    The cycle is found as by `lh.floquet`. Its phase θ runs from 0 to the period T, θ' = 1; ∂θ/∂x along the cycle is the
    (infinitesimal) phase response curve, here of all components at once.

    Args:
        system: an `lh.Flow` or `lh.Hybrid` that does not depend on time.
        x0: (n,) a point near the cycle; far from it give a transient.
        args: pytree of parameters.
        phases: how many there are, equally spaced.
        mode: mode at x0, where there are several.
        method: None: adaptive `lh.RungeKutta` with rtol = 1e-12.
        transient: length of a run before the cycle is looked for.
        segments: as for `lh.floquet`.

    Returns:
        A `PhaseResponse` with `.response` (phases, n), `.isostables`, `.finite(kick)`, `.interaction(coupling)`,
        `.locked(coupling)` and `.plot()`. It is found by Newton's method and has no derivatives of its own; that of the
        period of a smooth flow by a parameter p is −period · `.interaction(∂f/∂p)[0]`.

    Raises:
        ValueError: on arguments that do not fit; on a system that depends on time; where the orbit is one of a family.
        NoPeriodicOrbitError: where no cycle was found.
        RunFailedError: where the motion from x0 fails.

    Source:
        S. Shirasaka, W. Kurebayashi & H. Nakao, Phase reduction theory for hybrid nonlinear oscillators, Phys. Rev. E
        95 (2017) 012212, doi:10.1103/PhysRevE.95.012212; isostables: D. Wilson & J. Moehlis, Phys. Rev. E 94 (2016)
        052213, doi:10.1103/PhysRevE.94.052213.

    Example:
        A leaky neuron with a constant current, v' = 2 − v, reset from 1 to 0: ∂θ/∂v = 1 / (2 − v).

        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> neuron = lh.Hybrid(
        ...     lambda t, v, args: 2.0 - v,
        ...     lh.Transition(lambda t, v, args: 1.0 - v[0], lambda t, v, args: 0 * v),
        ... )
        >>> found = lh.phase_response(neuron, [0.5], phases=16)
        >>> round(found.period, 9), bool(jnp.allclose(found.response, 1 / (2 - found.x)))
        (0.693147181, True)
    """
    fits = isinstance(system, Flow | Hybrid) and not any(isinstance(one, Constrained) for one in fields_of(system))
    require(fits, f"phase_response takes an lh.Flow or lh.Hybrid without constraints; got {type(system).__name__}.")
    whole("phases", phases, least=4)
    preparation.grown_columns("phase_response", method)
    require_values("phase_response", x0, args)
    require(not depends_on_time(system, jnp.asarray(x0, float), args), FORCED)
    orbit = floquet(system, x0, args, mode=mode, method=method, transient=transient, segments=segments)
    require(not orbit.family, FAMILY)
    method = _fine_method(system, args, orbit) if method is None else method
    cycle, (_, x, index) = MovingOn(system, args, method), orbit.base
    step, points, modes, maps = orbit.period / phases, [x], [index], []
    for _ in range(phases):
        piece = tangent_map(system, points[-1], args, t1=step, mode=cycle.mode(modes[-1]), method=method)
        points.append(piece.x)
        modes.append(int(piece.mode))
        maps.append(np.asarray(piece.matrix))
    velocities = [np.asarray(cycle.field(point, mode)) for point, mode in zip(points[:-1], modes[:-1], strict=True)]
    found = _responses(maps, velocities)
    missing = np.any(np.isnan(found[1]), axis=(0, 1))
    if np.any(missing):
        sizes = ", ".join(f"{abs(mu):.6g}" for mu in found[2][missing])
        warnings.warn(NO_EIGENVECTORS.format(sizes), stacklevel=user_level())
    return PhaseResponse(
        step * np.arange(phases), np.array(points[:-1]), np.array(modes[:-1], np.int32), *found, orbit,
        labels_of(system, (len(x),)), cycle,
    )  # fmt: skip


def _fine_method(system: Flow | Hybrid, args: Any, orbit: Floquet) -> Method:
    """The default method, for the sizes of the components on the orbit."""
    method = RungeKutta(rtol=1e-12, atol=1e-14)
    mode = orbit.base[2] if isinstance(system, Hybrid) else None
    flow = Motion(preparation.prepare(system, orbit.base[1], args, 0.0, method, mode)[0])
    fine = sized(flow, flow.piece(Node(*orbit.base), orbit.period), True, orbit.x0).problem.method
    return dataclasses.replace(method, atol=float(fine.atol))


def _responses(maps: list[np.ndarray], velocities: list[np.ndarray]):
    """Z (phases, n), I (phases, n, m) and the multipliers (m,) from the tangent maps of pieces and the velocities."""
    monodromy = functools.reduce(lambda product, matrix: matrix @ product, maps)
    phase, values, rows = eigenrows(monodromy)
    decays = np.exp(-np.log(values.astype(complex)) / len(maps))
    phases, others = [], []
    for matrix, velocity in zip(maps[::-1], velocities[::-1], strict=True):
        phase = phase @ matrix
        phase = phase / (phase @ velocity)
        rows = (rows @ matrix) * decays[:, None]
        phases.append(phase)
        others.append(rows.T)
    return np.array(phases[::-1]), np.array(others[::-1]), values
