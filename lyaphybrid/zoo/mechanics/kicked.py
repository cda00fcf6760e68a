"""Kicked and struck: a rotor, a clock with its escapement, a juggled ball, a ball between a fixed and a moving wall."""

import math

import jax.numpy as jnp

from ..._jax.tracing import numpy_for
from ...systems.hybrid import Hybrid, Transition
from ..problem import Problem, Real, computed, exact, near, positive, problem, require, state, traced

__all__ = ["escapement_clock", "kicked_rotor", "moving_wall_billiard", "paddle_juggler"]


def _turn(t, x, args):
    return jnp.stack([x[1], -args["damping"] * x[1]])


def _kick(t, x, args):
    return jnp.stack([jnp.mod(x[0], 2 * math.pi), x[1] + args["strength"] * jnp.sin(x[0])])


ROTOR = Hybrid(_turn, Transition(every=lambda args: args["period"], reset=_kick), names=("θ", "p"))


@problem
def kicked_rotor(*, strength: Real = 10.0, damping: Real = 0.0, period: Real = 1.0) -> Problem:
    """A rotor that is kicked at a clock's ticks: θ' = p, p' = −γp, and p⁺ = p + K sin θ every T.

    Without damping it is the standard map of the parameter KT, once per period. The sum of the exponents is −γ.

    Args:
        strength: K.
        damping: γ, at least 0.
        period: T, positive.

    Returns:
        A `Problem`; without damping and with KT = 10 it has the reference ±1.6198(2)/T.

    Source:
        B. V. Chirikov, A universal instability of many-dimensional oscillator systems, Phys. Rep. 52 (1979) 263,
        doi:10.1016/0370-1573(79)90023-1.

    Example:
        >>> from lyaphybrid import zoo
        >>> print(zoo.kicked_rotor().reference)
        1.61980(20), -1.61980(20) per unit time (the standard map, iterated)
    """
    require("damping", damping, lambda v: v >= 0, "at least 0")
    positive(period=period)
    known = not traced(strength, damping, period) and near((strength * period, damping + 1.0), 10.0, 1.0)
    rate, error = (_ROTOR_GROWTH / period, _ROTOR_ERROR / period) if known else (0.0, 0.0)
    return Problem(
        system=ROTOR,
        x0=state(2.0, 0.3),
        args={"strength": strength, "damping": damping, "period": period},
        t1=5000 * period,
        transient=100 * period,
        reference=computed((rate, -rate), (error, error), source="the standard map, iterated") if known else None,
        source="B. V. Chirikov, Phys. Rep. 52 (1979) 263, doi:10.1016/0370-1573(79)90023-1",
    )


_ROTOR_GROWTH, _ROTOR_ERROR = 1.6198, 2e-4  # per kick of the strength 10


def _swing(t, x, args):
    return jnp.stack([x[1], -x[0] - 2 * args["damping"] * x[1]])


def _impulse(t, x, args):
    return jnp.stack([x[0], jnp.sqrt(x[1] ** 2 + 2 * args["energy"])])


CLOCK = Hybrid(
    {"armed": _swing, "released": _swing},  # the way back arms the escapement
    [
        Transition(lambda t, x, args: -x[0], _impulse, source="armed", target="released"),
        Transition(lambda t, x, args: x[0], source="released", target="armed"),
    ],
    names=("x", "v"),
)


@problem
def escapement_clock(*, damping: Real = 0.05, energy: Real = 0.1) -> Problem:
    """A pendulum clock: x'' + 2ζx' + x = 0, and at x = 0, v > 0, the escapement gives the energy E: v⁺² = v² + 2E.

    With q = exp(−2πζ/√(1 − ζ²)), what a period leaves of the speed, the clock goes with v⁻² = 2E q²/(1 − q²). The
    multipliers are 1 and q², the exponents 0 and −2ζ: the clock comes back to its swing twice as fast as the pendulum
    alone would come to rest. With an escapement of constant momentum they would be 0 and −ζ.

    Args:
        damping: ζ, in (0, 1).
        energy: E, positive.

    Returns:
        A `Problem` with its exact reference, 0 and −2ζ.

    Source:
        A. A. Andronov, A. A. Vitt & S. E. Khaikin, Theory of Oscillators, Pergamon 1966, chapter III,
        doi:10.1016/C2013-0-06631-5.

    Example:
        >>> from lyaphybrid import zoo
        >>> print(zoo.escapement_clock().reference)
        0, -0.1 per unit time (multipliers 1 and q²)
    """
    require("damping", damping, lambda v: 0 < v < 1, "between 0 and 1")
    positive(energy=energy)
    numbers = numpy_for(damping, energy)
    period = 2 * math.pi / numbers.sqrt(1 - damping**2)
    left = numbers.exp(-2 * damping * period)
    launch = numbers.sqrt(2 * energy / (1 - left))
    return Problem(
        system=CLOCK,
        # a quarter of a period after the impulse, about: blocks end between two of them
        x0=state(launch, 0.0 * launch),
        args={"damping": damping, "energy": energy},
        mode="released",
        t1=100 * period,
        transient=50 * period,
        reference=None if traced(damping, energy) else exact(0.0, -2 * damping, source="multipliers 1 and q²"),
        source="A. A. Andronov, A. A. Vitt & S. E. Khaikin, Theory of Oscillators (1966), doi:10.1016/C2013-0-06631-5",
    )


def _fall(t, x, args):
    return jnp.stack([x[1], -jnp.ones_like(x[1])])


def _strike(t, x, args):
    rebound, gain = args["restitution"], args["gain"]
    error = args["height"] - (x[1] ** 2 / 2 + x[0])
    return jnp.stack([x[0], -(1 + (1 + rebound) * gain * error) * x[1]])


JUGGLER = Hybrid(_fall, Transition(lambda t, x, args: x[0], _strike), names=("b", "v"))


@problem
def paddle_juggler(*, gain: Real = 0.4, height: Real = 1.0, restitution: Real = 0.7) -> Problem:
    """A ball on a paddle that mirrors its motion: b'' = −1, the paddle at −κb, κ = (1 − r)/(1 + r) + κ₁ (h − η).

    η = v²/2 + b is the ball's energy, the height to which it flies. Ball and paddle meet at b = 0, where the paddle
    moves with −κv⁻; the impact gives v⁺ = −r v⁻ − (1 + r) κ v⁻ = −(1 + (1 + r) κ₁ (h − η)) v⁻. At η = h the ball
    comes back to its height at each strike. With s = 2(1 + r) κ₁ h the multipliers there are 1 and 1 − s: stable
    for 0 < s < 2, at once for s = 1 (an exponent of −∞: the best gain), then doublings of the period up to chaos.

    Args:
        gain: κ₁, positive; s below 3√3 − 2, beyond which some strike would throw the ball through the paddle.
        height: h, positive.
        restitution: r, in (0, 1].

    Returns:
        A `Problem` that starts a little below the height; with its exact reference 0 and ln|1 − s| / (2√(2h)) for
        s < 2.

    Source:
        M. Buehler, D. E. Koditschek & P. J. Kindlmann, Planning and control of robotic juggling and catching tasks,
        Int. J. Robotics Res. 13 (1994) 101, doi:10.1177/027836499401300201.

    Example:
        >>> from lyaphybrid import zoo
        >>> print(zoo.paddle_juggler().reference)
        0, -0.3612082626 per unit time (multipliers 1 and 1 − s)
    """
    require("restitution", restitution, lambda v: 0 < v <= 1, "between 0 and 1")
    positive(gain=gain, height=height)
    numbers = numpy_for(gain, height, restitution)
    speed = numbers.sqrt(2 * height)
    reference = None
    if not traced(gain, height, restitution):
        sharpness = 2 * (1 + restitution) * gain * height
        require("gain", gain, lambda _: sharpness < 3**1.5 - 2, "so small that s = 2(1 + r) κ₁ h is below 3√3 − 2")
        if 0 < sharpness < 2:
            slope = abs(1 - sharpness)
            rate = math.log(slope) / (2 * speed) if slope > 1e-12 else -math.inf
            reference = exact(0.0, rate, source="multipliers 1 and 1 − s")
    return Problem(
        system=JUGGLER,
        x0=state(0.9 * height, 0.0 * height),
        args={"gain": gain, "height": height, "restitution": restitution},
        t1=1000 * speed,
        transient=200 * speed,
        reference=reference,
        source="M. Buehler, D. E. Koditschek & P. J. Kindlmann, Int. J. Robotics Res. 13 (1994) 101, "
        "doi:10.1177/027836499401300201",
    )


def _free(t, x, args):
    return jnp.stack([x[1], jnp.zeros_like(x[1])])


def _wall(t, x, args):
    return 1 + args["amplitude"] * jnp.cos(t) - x[0]


def _off_the_wall(t, x, args):
    rebound = args["restitution"]
    return jnp.stack([x[0], -rebound * x[1] - (1 + rebound) * args["amplitude"] * jnp.sin(t)])


def _off_the_rest(t, x, args):
    return jnp.stack([x[0], -args["restitution"] * x[1]])


FERMI_ULAM = Hybrid(
    _free, [Transition(_wall, _off_the_wall), Transition(lambda t, x, args: x[0], _off_the_rest)], names=("q", "v")
)


@problem
def moving_wall_billiard(*, amplitude: Real = 0.1, restitution: Real = 1.0) -> Problem:
    """A ball between a wall at rest, q = 0, and one that moves, q = 1 + ε cos t (the Fermi–Ulam accelerator).

    No force between the walls: q' = v, v' = 0; v⁺ = −r v⁻ − (1 + r) ε sin t at the moving wall, −r v⁻ at the other one.
    Elastic walls conserve area in (q, v): the exponents are ±λ. Slow balls move irregularly, up to the first invariant
    curve, which no ball crosses: there is no acceleration without bound.

    Args:
        amplitude: ε, in [0, 1).
        restitution: r, in (0, 1].

    Returns:
        A `Problem`; no closed form is known but for ε = 0, where both exponents are 0 with r = 1.

    Source:
        M. A. Lieberman & A. J. Lichtenberg, Stochastic and adiabatic behavior of particles accelerated by periodic
        forces, Phys. Rev. A 5 (1972) 1852, doi:10.1103/PhysRevA.5.1852.

    Example:
        >>> from lyaphybrid import zoo
        >>> print(zoo.moving_wall_billiard(amplitude=0).reference)
        0, 0 per unit time (free flight between two walls)
    """
    require("amplitude", amplitude, lambda v: 0 <= v < 1, "at least 0 and below 1")
    require("restitution", restitution, lambda v: 0 < v <= 1, "between 0 and 1")
    at_rest = not traced(amplitude, restitution) and amplitude == 0 and restitution == 1
    return Problem(
        system=FERMI_ULAM,
        x0=state(0.3, 0.2),
        args={"amplitude": amplitude, "restitution": restitution},
        t1=20_000.0,
        transient=100.0,
        reference=exact(0.0, 0.0, source="free flight between two walls") if at_rest else None,
        source="M. A. Lieberman & A. J. Lichtenberg, Phys. Rev. A 5 (1972) 1852, doi:10.1103/PhysRevA.5.1852",
    )
