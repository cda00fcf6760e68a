"""Dry friction and relays: two fields, a surface, and motion that slides on it. All are made by `lh.filippov`."""

import math

import jax.numpy as jnp

from ...systems.contacts.filippov import filippov
from ..problem import Problem, Real, computed, exact, near, one_of, positive, problem, require, state, traced

FU = "Fu Shihui, Wang Qi & Wang Shimin, Journal of Dynamics and Control 2 (2004), in Chinese"
LEINE = "R. I. Leine et al., Nonlinear Dynamics 16 (1998) 41, doi:10.1023/A:1008289604683"


def _velocity(t, x, args):
    return x[1]


def _pendulum(direction):
    """θ and θ' where the pendulum moves in this direction; a third component is the time."""

    def field(t, x, args):
        time = x[2] if x.shape[0] == 3 else t
        drive = args["amplitude"] * jnp.sin(args["omega"] * time)
        force = drive - args["gravity"] * jnp.sin(x[0]) - args["beta"] * x[1] - direction * args["alpha"]
        return jnp.stack([x[1], force, *(1 + 0 * z for z in x[2:])])

    return field


def _block(direction):
    def field(t, x, args):
        return jnp.stack([x[1], args["amplitude"] * jnp.sin(args["omega"] * t) - direction * args["alpha"]])

    return field


def _on_belt(direction):
    def field(t, x, args):
        slip = direction * (x[1] - args["belt"])
        friction = args["friction"] / (1 + args["delta"] * slip)
        return jnp.stack([x[1], args["force"] * jnp.cos(args["eta"] * t) - x[0] - direction * friction])

    return field


def _slip_velocity(t, x, args):
    return x[1] - args["belt"]


def _lags(direction):
    """Three lags 1/(s + 1) in series, the relay at the input of the first."""

    def field(t, x, args):
        return jnp.stack([x[1] - x[0], x[2] - x[1], -direction - x[2]])

    return field


def _first(t, x, args):
    return x[0]


def _masses(direction):
    def field(t, x, args):
        return jnp.stack([x[1], 0 * x[1] - direction])

    return field


def _weighted(t, x, args):
    return args["slope"] * x[0] + x[1]


PENDULUM_PARTS = (_pendulum(+1.0), _pendulum(-1.0), _velocity)  # plus, minus, surface
PENDULUM = filippov(*PENDULUM_PARTS, names=("θ", "θ'"))
AUTONOMOUS = filippov(*PENDULUM_PARTS, names=("θ", "θ'", "z"))
BLOCK = filippov(_block(+1.0), _block(-1.0), _velocity, names=("x", "v"))
BELT = filippov(_on_belt(+1.0), _on_belt(-1.0), _slip_velocity, names=("x", "v"))
RELAY = filippov(_lags(+1.0), _lags(-1.0), _first)
SLIDING_RELAY = filippov(_masses(+1.0), _masses(-1.0), _weighted)

# (beta, alpha) at the other parameters of the paper; start; exponents; stderr; how
_PENDULUM_VALUES = (
    ((0.3, 0.01), (-2.25588703039235, -0.578073404007456), (-0.152604511216481,) * 2, (1e-13, 1e-13), "monodromy"),
    ((0.052, 0.5), (-0.450144532581872, 0.0), (-0.028474432537751, -math.inf), (1e-13, 0.0), "monodromy"),
    ((0.052, 0.01), (0.1, 0.0), (0.12031, -math.inf), (1e-4, 0.0), "event-driven Taylor series, 3e6 periods"),
)


@problem
def friction_pendulum(
    *,
    beta: Real = 0.052,
    alpha: Real = 0.01,
    gravity: Real = 0.87,
    amplitude: Real = 0.586,
    omega: Real = 0.666,
    form: str = "forced",
) -> Problem:
    """A forced pendulum with dry friction: θ'' + βθ' + λ sin θ + α Sgn(θ') ∋ A sin ωt.

    It sticks where θ' = 0 and |A sin ωt − λ sin θ| ≤ α, and there loses the direction δθ'. At β = 0.3, α = 0.01 it
    slips to and fro with period 2π/ω; at β = 0.052, α = 0.5 it sticks twice a period; at β = 0.052, α = 0.01 it is
    chaotic and sticks 3.7e-4 times a period, for 0.03 each: a run of a few hundred periods without a stick
    gives −0.177, a longer one −inf.

    Args:
        beta: β, viscous damping.
        alpha: α, dry friction, not negative.
        gravity: λ.
        amplitude: A of the forcing.
        omega: ω of the forcing, positive.
        form: "forced", state (θ, θ'), two exponents; "autonomous", state (θ, θ', z) with z' = 1: three, one of them 0.

    Returns:
        A `Problem`; at the three sets of parameters above with a reference, and on the periodic orbit.

    Source:
        Fu Shihui, Wang Qi & Wang Shimin, Numerical calculation of Lyapunov exponents of discontinuous systems with
        dry friction, Journal of Dynamics and Control 2 (2004); C.-H. Lamarque & J. Bastien, Numerical study of a
        forced pendulum with friction, Nonlinear Dynamics 23 (2000) 335, doi:10.1023/A:1008328000605.

    Example:
        >>> from lyaphybrid import zoo
        >>> print(zoo.friction_pendulum().reference)
        0.12031(10), -inf per unit time (event-driven Taylor series, 3e6 periods)
    """
    one_of("form", form, ("forced", "autonomous"))
    positive(omega=omega)
    require("alpha", alpha, lambda v: v >= 0, "at least 0")
    start, reference = (0.1, 0.0), None
    for parameters, point, exponents, stderr, how in _PENDULUM_VALUES:
        if near((beta, alpha, gravity, amplitude, omega), *parameters, 0.87, 0.586, 0.666):
            if form == "autonomous":
                exponents, stderr = (*exponents, 0.0), (*stderr, 0.0)
                order = sorted(range(3), key=lambda i: -exponents[i])
                exponents, stderr = (tuple(values[i] for i in order) for values in (exponents, stderr))
            start, reference = point, computed(exponents, stderr, source=how)
    return Problem(
        system=PENDULUM if form == "forced" else AUTONOMOUS,
        x0=state(*start) if form == "forced" else state(*start, 0.0),
        args={"beta": beta, "alpha": alpha, "gravity": gravity, "amplitude": amplitude, "omega": omega},
        t1=2000 * 2 * math.pi / omega,
        transient=50 * 2 * math.pi / omega,
        reference=reference,
        source="C.-H. Lamarque & J. Bastien, Nonlinear Dynamics 23 (2000) 335, doi:10.1023/A:1008328000605; " + FU,
    )


@problem
def block_on_plate(*, alpha: Real = 0.3, amplitude: Real = 1.0, omega: Real = 1.0) -> Problem:
    """A block on a plate that shakes: v' = A sin ωt − α Sgn(v), x' = v.

    For α/A ≤ 1/√(1 + π²/4) it slips to and fro without sticking. v changes its sign at the phase φ, cos φ = πα/2A,
    and each time S = diag(1, r), r = (A sin φ − α)/(A sin φ + α): the exponents are 0, for x is cyclic, and 2 ln r/T.
    With more friction it sticks, and the second is −inf.

    Args:
        alpha: α, friction over mass, below A.
        amplitude: A, the largest acceleration of the plate.
        omega: ω, radians per time.

    Returns:
        A `Problem` on the periodic motion, with its exact reference.

    Source:
        J. P. Den Hartog, Forced vibrations with combined Coulomb and viscous friction, Trans. ASME 53 (1931) APM 107;
        R. I. Leine & H. Nijmeijer, Dynamics and Bifurcations of Non-Smooth Mechanical Systems (Springer 2004),
        doi:10.1007/978-3-540-44398-8.

    Example:
        >>> from lyaphybrid import zoo
        >>> print(zoo.block_on_plate().reference)
        0, -0.2255186884 per unit time (phase at which the slip changes its sign)
    """
    positive(amplitude=amplitude, omega=omega)
    require("alpha", alpha, lambda v: v >= 0, "at least 0")
    reference, start = None, (0.0, 0.0)
    if not traced(alpha, amplitude, omega):
        require("alpha", alpha, lambda v: v < amplitude, f"below amplitude = {amplitude:g}, or the block never moves")
        slips = alpha / amplitude <= 1 / math.sqrt(1 + math.pi**2 / 4)
        if slips:
            phase = math.acos(math.pi * alpha / (2 * amplitude))
            force = amplitude * math.sin(phase)
            start = (0.0, (alpha * (math.pi - phase) - amplitude * (math.cos(phase) + 1)) / omega)
            decay = math.log((force - alpha) / (force + alpha)) * omega / math.pi
            reference = exact(0.0, decay, source="phase at which the slip changes its sign")
        else:
            reference = exact(0.0, -math.inf, source="it sticks")
    return Problem(
        system=BLOCK,
        x0=state(*start),
        args={"alpha": alpha, "amplitude": amplitude, "omega": omega},
        t1=50 * 2 * math.pi / omega,
        transient=2 * 2 * math.pi / omega,
        reference=reference,
        source="R. I. Leine & H. Nijmeijer, doi:10.1007/978-3-540-44398-8",
    )


@problem
def stick_slip_belt(
    *,
    force: Real = 0.0,
    eta: Real = 1.4,
    belt: Real = 0.2,
    friction: Real = 1.0,
    delta: Real = 3.0,
) -> Problem:
    """A mass on a moving belt: x'' + x = −F sgn(v)/(1 + δ|v|) + u cos ηt, v = x' − v_b.

    Friction falls with the velocity of the slip, so that rest on the belt alternates with slip. Without forcing a limit
    cycle attracts, in finite time: each stick destroys a direction, and the exponents are 0 and −inf.

    Args:
        force: u, amplitude of the forcing.
        eta: η, its frequency.
        belt: v_b, velocity of the belt, positive.
        friction: F, stiction.
        delta: δ, how fast friction falls.

    Returns:
        A `Problem`; with the exact reference 0, −inf at the other default parameters without forcing, and with
        0.08089(18), −inf at u = 0.5 (chaos).

    Source:
        R. I. Leine, D. H. van Campen, A. de Kraker & L. van den Steen, Stick-slip vibrations induced by alternate
        friction models, Nonlinear Dynamics 16 (1998) 41, doi:10.1023/A:1008289604683.

    Example:
        >>> from lyaphybrid import zoo
        >>> zoo.stick_slip_belt(force=0.5).reference.exponents
        (0.08089, -inf)
    """
    positive(belt=belt, eta=eta, friction=friction)
    require("delta", delta, lambda v: v >= 0, "at least 0")
    reference, start = None, (friction, belt)
    if near((belt, friction, delta), 0.2, 1.0, 3.0):
        if near(force, 0.0):
            reference = exact(0.0, -math.inf, source="a limit cycle with a stick")
        elif near((force, eta), 0.5, 1.4):
            start = (0.5, belt)
            reference = computed((0.08089, -math.inf), (1.8e-4, 0.0), source="an independent program")
    return Problem(
        system=BELT,
        x0=state(*start),
        args={"force": force, "eta": eta, "belt": belt, "friction": friction, "delta": delta},
        t1=20_000.0,
        transient=200.0,
        reference=reference,
        source=LEINE,
    )


# Of the limit cycle that switches twice a period, plant 1/(s + 1)³.
_RELAY_START = (0.0, 0.29063092222931247, 0.7258679257978886)
_RELAY_EXPONENTS = (0.0, -0.520218541822618, -2.479781458177381)


@problem
def relay_feedback(*, form: str = "crossing", slope: Real = 0.5) -> Problem:
    """A linear plant in a loop with a relay, u = −sgn y.

    "crossing": y = 1/(s + 1)³ u, x₁' = x₂ − x₁, x₂' = x₃ − x₂, x₃' = u − x₃, y = x₁. The limit cycle crosses y = 0
    every 1.83988; the exponents sum to −3, the divergence.
    "sliding": y = (s + c)/s² u, x₁' = x₂, x₂' = u, y = c x₁ + x₂. Where c|x₂| < 1 both fields point at y = 0: the
    motion slides into the origin as x₁' = −c x₁, and the exponents are −c and −inf.

    Args:
        form: "crossing" or "sliding".
        slope: c of the sliding form, positive.

    Returns:
        A `Problem` with its exact reference.

    Source:
        K. H. Johansson, A. E. Barabanov & K. J. Åström, Limit cycles with chattering in relay feedback systems, IEEE
        Trans. Automatic Control 47 (2002) 1414, doi:10.1109/TAC.2002.802770.

    Example:
        >>> from lyaphybrid import zoo
        >>> print(zoo.relay_feedback(form="sliding").reference)
        -0.5, -inf per unit time (motion on the surface)
    """
    one_of("form", form, ("crossing", "sliding"))
    positive(slope=slope)
    crossing = form == "crossing"
    reference = None
    if crossing:
        reference = exact(*_RELAY_EXPONENTS, source="half-period map of the limit cycle")
    elif not traced(slope):
        reference = exact(-slope, -math.inf, source="motion on the surface")
    return Problem(
        system=RELAY if crossing else SLIDING_RELAY,
        x0=state(*_RELAY_START) if crossing else state(1.0, 0.5),
        args={} if crossing else {"slope": slope},
        t1=200.0 if crossing else 40.0,
        transient=20.0 if crossing else 10.0,
        reference=reference,
        source="K. H. Johansson, A. E. Barabanov & K. J. Åström, doi:10.1109/TAC.2002.802770",
    )
