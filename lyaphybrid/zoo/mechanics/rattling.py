"""Bodies with impacts on both sides: a rocking block, a rattling gear. State (x, v); the forcing is explicit in time.

Between impacts both are linear, so that the symmetric motions with one impact each half period of the forcing,
x(t + π/ω) = −x(t), are known in closed form: `_symmetric`.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from ...systems.hybrid import Hybrid, Transition
from ..problem import Problem, Real, Reference, exact, positive, problem, require, state, traced


def _rock(side):
    def field(t, x, args):
        return jnp.stack([x[1], x[0] - side + args["amplitude"] * jnp.cos(args["omega"] * t)])

    return field


def _upright(t, x, args):
    return x[0]


def _change_corner(t, x, args):
    return jnp.stack([x[0], args["restitution"] * x[1]])


def _toppling(t, x, args):
    return (1 + args["amplitude"]) ** 2 - x[0] ** 2


def _drift(t, x, args):
    return jnp.stack([x[1], args["amplitude"] * jnp.cos(args["omega"] * t) - 2 * args["zeta"] * x[1]])


def _clearances(t, x, args):
    return jnp.stack([args["gap"] + x[0], args["gap"] - x[0]])


def _knock(t, x, args, which):
    return jnp.stack([x[0], -args["restitution"] * x[1]])


ROCKING = Hybrid(
    {"right": _rock(1.0), "left": _rock(-1.0)},
    [
        Transition(_upright, _change_corner, source="right", target="left", direction=-1),
        Transition(_upright, _change_corner, source="left", target="right", direction=+1),
        Transition(_toppling, terminal=True),
    ],
    names=("tilt", "rate"),
)
RATTLING = Hybrid(_drift, Transition(_clearances, _knock), names=("x", "v"))


class _Half(NamedTuple):
    """The linear motion from one impact to the next: z' = M (z − centre) + (0, A cos ωt)."""

    matrix: np.ndarray
    flow: Callable  # t -> exp(Mt)
    centre: np.ndarray
    wall: float  # it starts with an impact at −wall and ends with one at wall
    keeps: float  # v⁺ = keeps · v⁻
    free: Callable  # x -> whether a position between the impacts is possible


class _Orbit(NamedTuple):
    """A symmetric motion."""

    start: np.ndarray  # at t = 0
    multipliers: np.ndarray  # absolute values for half a period, descending


def _symmetric(half: _Half, amplitude: float, omega: float) -> _Orbit | None:
    """The symmetric motion with one impact each half period, the fastest if there are several; None if there is none.

    With the forced part z_p(t) = Re Z e^{i(ωt + φ)} a half period h takes z(0) = (−wall, v) to z(h), while z_p(h) =
    −z_p(0). Both ends depend only on v, so z_p(0) is linear in v, and its length |Z₁| determines v.
    """
    h, identity, unit = math.pi / omega, np.eye(2), np.array([0.0, 1.0])
    forced = np.linalg.solve(1j * omega * identity - half.matrix, amplitude * unit)
    flow, place = half.flow(h), np.array([half.wall, 0.0])
    at_rest = half.centre + flow @ (-place - half.centre) - place
    constant = np.linalg.solve(identity + flow, at_rest)
    slope = np.linalg.solve(identity + flow, flow @ unit + unit / half.keeps)
    scale = np.array([1.0, 1 / omega])
    quadratic = [np.sum((slope * scale) ** 2), 2 * np.sum(slope * constant * scale**2)]
    speeds = np.roots([*quadratic, np.sum((constant * scale) ** 2) - abs(forced[0]) ** 2])
    for v in sorted(speeds.real[np.abs(speeds.imag) == 0], reverse=True):
        phase = np.angle((constant + v * slope) @ [1.0, -1j / omega] / forced[0])
        orbit = _one_symmetric(half, forced, amplitude, omega, v, phase)
        if orbit is not None:
            return orbit
    return None


def _one_symmetric(half: _Half, forced, amplitude: float, omega: float, v: float, phase: float) -> _Orbit | None:
    """The motion that leaves an impact with velocity v at this phase of the forcing, if it meets no wall before h."""
    h, begin = math.pi / omega, np.array([-half.wall, v])

    def driven(t):
        return np.real(forced * np.exp(1j * (omega * t + phase)))

    def at(t):
        return half.centre + driven(t) + half.flow(t) @ (begin - half.centre - driven(0.0))

    if v <= 0 or not all(half.free(at(t)[0]) for t in np.linspace(0, h, 402)[1:-1]):
        return None
    zero = (-phase / omega) % (2 * h)  # time from the impact until ωt + φ is a multiple of 2π
    start = at(zero) if zero < h else -at(zero - h)
    # Accelerations before and after the last impact; after it the motion is the mirrored start.
    end, force = np.array([half.wall, -v / half.keeps]), amplitude * math.cos(phase)
    before = (half.matrix @ (end - half.centre))[1] - force
    after = -(half.matrix @ (begin - half.centre))[1] - force
    saltation = np.array([[half.keeps, 0.0], [(after - half.keeps * before) / end[1], half.keeps]])
    multipliers = np.abs(np.linalg.eigvals(saltation @ half.flow(h)))
    return _Orbit(start, np.sort(multipliers)[::-1])


def _start(half: _Half, amplitude: float, omega: float, otherwise) -> tuple[tuple, Reference | None]:
    """A start on (or near) the symmetric motion, and the reference where it attracts."""
    orbit = _symmetric(half, amplitude, omega)
    if orbit is None:
        return otherwise, None
    x, v = orbit.start
    if orbit.multipliers[0] >= 1:
        return (x, 1.05 * v), None
    rates = np.log(orbit.multipliers) * omega / math.pi
    return (x, v), exact(*rates, source="multipliers of the symmetric orbit")


@problem
def rocking_block(*, restitution: Real = 0.7, amplitude: Real = 2.0, omega: Real = 2.0) -> Problem:
    """A slender block rocks on a floor that shakes: x'' = x − sgn x + A cos ωt, and v⁺ = r v⁻ at x = 0.

    x is the angle of tilt over the angle at which the block would balance on its corner; x > 0 is mode "right", x < 0
    "left". At x = 0 the block changes corners and keeps the sense in which it turns, at the cost of the part 1 − r of
    its velocity. The flow keeps areas and an impact multiplies them by r²: the exponents sum to 2 ln r · (impacts per
    unit time) exactly. A block that passes |x| = 1 + A topples, for from there nothing brings it back: the run ends as
    `terminated`. A tilt that dies out ends as `zeno`. The equation is that of small angles; the unit of time is
    (mgR/I)^(−1/2) for a block of mass m, R from the corner to its centre of mass, I its moment of inertia about the
    corner.

    Args:
        restitution: r, in (0, 1).
        amplitude: A, acceleration of the floor over the least that tilts the block.
        omega: ω, radians per time.

    Returns:
        A `Problem` that starts on the symmetric motion with one impact each half period of the floor, where there is
        one (a little off it where it repels); where it attracts with its exact reference, ln|μ| ω/π, μ the eigenvalues
        of S · [[cosh h, sinh h], [sinh h, cosh h]] with h = π/ω: −0.0455, −0.4086 at the default parameters.

    Source:
        S. J. Hogan, On the dynamics of rigid-block motion under harmonic forcing, Proc. R. Soc. Lond. A 425 (1989) 441,
        doi:10.1098/rspa.1989.0114; G. W. Housner, Bull. Seismol. Soc. Am. 53 (1963) 403.

    Example:
        >>> from lyaphybrid import zoo
        >>> print(zoo.rocking_block().reference)
        -0.0455061282, -0.408626515 per unit time (multipliers of the symmetric orbit)
    """
    require("restitution", restitution, lambda r: 0 < r < 1, "between 0 and 1")
    positive(amplitude=amplitude, omega=omega)
    x0, reference = (0.1, 0.0), None
    if (
        not traced(restitution, amplitude, omega) and omega > 0.2
    ):  # slower ones repel by more than e^15 in half a period
        block = _Half(
            np.array([[0.0, 1.0], [1.0, 0.0]]),
            lambda t: np.array([[math.cosh(t), math.sinh(t)], [math.sinh(t), math.cosh(t)]]),
            np.array([1.0, 0.0]),
            0.0,
            restitution,
            lambda x: x > 0,
        )
        x0, reference = _start(block, amplitude, omega, x0)
    return Problem(
        system=ROCKING,
        x0=state(*x0),
        args={"restitution": restitution, "amplitude": amplitude, "omega": omega},
        mode="left" if not traced(x0[0]) and x0[0] < 0 else "right",
        t1=1280 * math.pi / omega,
        transient=40 * math.pi / omega,
        reference=reference,
        source="S. J. Hogan, Proc. R. Soc. Lond. A 425 (1989) 441, doi:10.1098/rspa.1989.0114",
    )


@problem
def gear_rattle(
    *,
    omega: Real = 2.0,
    zeta: Real = 0.1,
    restitution: Real = 0.6,
    gap: Real = 0.5,
    amplitude: Real = 1.5,
) -> Problem:
    """A loose gear rattles in its backlash: x'' + 2ζx' = A cos ωt for |x| < b, and v⁺ = −r v⁻ at x = ±b.

    x is the position of the loose wheel's teeth between those of the wheel that drives it, and A the amplitude of
    that wheel's acceleration: the simplest model of rattling, a mass between two walls that shake. One guard with two
    components. The exponents sum to −2ζ + 2 ln r · (impacts per unit time) exactly.

    Args:
        omega: ω, radians per time.
        zeta: ζ, drag, 0 or positive, per time.
        restitution: r, in (0, 1).
        gap: b, half of the backlash, length.
        amplitude: A, length per time².

    Returns:
        A `Problem` that starts on the symmetric motion with one impact at each wall a period, where there is one (a
        little off it where it repels); where it attracts with its exact reference, ln|μ| ω/π, μ the eigenvalues of S
        times the flow over half a period: −0.1126, −0.7377 at the default parameters.

    Source:
        F. Pfeiffer & A. Kunert, Rattling models from deterministic to stochastic processes, Nonlinear Dynamics 1 (1990)
        63, doi:10.1007/BF01857585.

    Example:
        >>> from lyaphybrid import zoo
        >>> print(zoo.gear_rattle().reference)
        -0.1126466493, -0.7377567353 per unit time (multipliers of the symmetric orbit)
    """
    require("restitution", restitution, lambda r: 0 < r < 1, "between 0 and 1")
    require("zeta", zeta, lambda z: z >= 0, "0 or positive")
    positive(omega=omega, gap=gap, amplitude=amplitude)
    x0, reference = (0.0 * gap, omega * gap), None
    if not traced(omega, zeta, restitution, gap, amplitude):
        drag = 2 * zeta
        gear = _Half(
            np.array([[0.0, 1.0], [0.0, -drag]]),
            lambda t: np.array([[1.0, -math.expm1(-drag * t) / drag if drag else t], [0.0, math.exp(-drag * t)]]),
            np.zeros(2),
            gap,
            -restitution,
            lambda x: abs(x) < gap,
        )
        x0, reference = _start(gear, amplitude, omega, x0)
    return Problem(
        system=RATTLING,
        x0=state(*x0),
        args={"omega": omega, "zeta": zeta, "restitution": restitution, "gap": gap, "amplitude": amplitude},
        t1=1280 * math.pi / omega,
        transient=40 * math.pi / omega,
        reference=reference,
        source="F. Pfeiffer & A. Kunert, Nonlinear Dynamics 1 (1990) 63, doi:10.1007/BF01857585",
    )
