"""Electronic circuits: kinks, comparators, clocks, diodes. Every mode has its own linear field."""

import math

import jax.numpy as jnp

from ...systems.hybrid import Hybrid, Transition
from ..problem import Problem, Real, computed, exact, near, positive, problem, require, state, traced


def _chua(side):
    """The field beyond the kink at x = side; 0: between the kinks."""

    def field(t, x, args):
        inner, outer = args["m0"], args["m1"]
        current = outer * x[0] + side * (inner - outer) if side else inner * x[0]
        return jnp.stack([args["alpha"] * (x[1] - x[0] - current), x[0] - x[1] + x[2], -args["beta"] * x[1]])

    return field


def _above(threshold):
    return lambda t, x, args: x[0] - threshold


CHUA = Hybrid(
    {"left": _chua(-1.0), "middle": _chua(0.0), "right": _chua(+1.0)},
    [
        Transition(_above(1.0), source="middle", target="right", direction=+1),
        Transition(_above(1.0), source="right", target="middle", direction=-1),
        Transition(_above(-1.0), source="middle", target="left", direction=-1),
        Transition(_above(-1.0), source="left", target="middle", direction=+1),
    ],
    names=("x", "y", "z"),
)


def _phase(parity):
    """The elapsed fraction of the current period, for the even (parity 0) or the odd periods (parity 1).

    It is 0 at the tick that begins the period and 1 at the one that ends it, and continues smoothly for half a period
    beyond both: its jump lies in the middle of a period of the other parity, where it is not used.
    """

    def phase(t, args):
        periods = t / args["period"] - parity
        return periods - 2 * jnp.round((periods - 0.5) / 2)

    return phase


def _two_periods(args):
    return 2 * args["period"]


def _one_period(args):
    return args["period"]


def _charge(x, args):
    """The slope of the capacitor's voltage."""
    return (x[1] - x[0] / args["resistance"]) / args["capacitance"]


def _filter(switch):
    """RLC filter of the buck converter, its input at the source (switch 1) or at the diode (0). State (v, i)."""

    def field(t, x, args):
        return jnp.stack([_charge(x, args), (switch * args["voltage"] - x[0]) / args["inductance"]])

    return field


def _control(x, args):
    return args["gain"] * (x[0] - args["wanted"])


def _ramp_above_control(parity):
    phase = _phase(parity)

    def guard(t, x, args):
        return args["low"] + (args["high"] - args["low"]) * phase(t, args) - _control(x, args)

    return guard


def _after_a_crossing(on, off):
    """The mode after the ramp has met the control: `on` where the ramp continues above it."""

    def target(t, x, args):
        climb = (args["high"] - args["low"]) / args["period"]
        return jnp.where(climb > args["gain"] * _charge(x, args), on, off)

    return target


def _after_a_tick(on, off):
    """The mode after a tick, at which the ramp has fallen to its lower end."""
    return lambda t, x, args: jnp.where(_control(x, args) < args["low"], on, off)


BUCK = Hybrid(
    {"on_even": _filter(1.0), "off_even": _filter(0.0), "on_odd": _filter(1.0), "off_odd": _filter(0.0)},
    [
        # Crossings may be nearly tangent, and rounding of the time may put the guard on either side after a jump. So
        # the mode follows from the rates, which are equal in both modes, and a second firing changes nothing.
        Transition(_ramp_above_control(0), source=("on_even", "off_even"), target=_after_a_crossing(0, 1), direction=0),
        Transition(_ramp_above_control(1), source=("on_odd", "off_odd"), target=_after_a_crossing(2, 3), direction=0),
        Transition(every=_two_periods, target=_after_a_tick(0, 1)),
        Transition(every=_two_periods, phase=_one_period, target=_after_a_tick(2, 3)),
    ],
    names=("v", "i"),
    units=("V", "A"),
)


def _discharge(x, args):
    return -x[0] / (args["resistance"] * args["capacitance"])


def _charge_inductor(t, x, args):
    return jnp.stack([_discharge(x, args), args["voltage"] / args["inductance"] + 0 * x[1]])


def _conduct(t, x, args):
    return jnp.stack([_charge(x, args), (args["voltage"] - x[0]) / args["inductance"]])


def _idle(t, x, args):
    return jnp.stack([_discharge(x, args), 0 * x[1]])


def _duty_left(parity):
    """Guard: falls through 0 when the switch has been on for the fraction of the period chosen at the tick."""
    phase = _phase(parity)

    def guard(t, x, args):
        over = phase(t, args)
        # While the switch is on, v only decays, so its value at the tick follows from the present one.
        sampled = x[0] * jnp.exp(over * args["period"] / (args["resistance"] * args["capacitance"]))
        return args["duty"] - args["feedback"] * (sampled - args["wanted"]) - over

    return guard


def _current(t, x, args):
    return x[1]


def _no_current(t, x, args):
    return jnp.stack([x[0], 0 * x[1]])


def _without_current(t, x, args, dx):
    return jnp.stack([dx[0], 0 * dx[1]])


BOOST = Hybrid(
    {"on_even": _charge_inductor, "on_odd": _charge_inductor, "off": _conduct, "idle": _idle},
    [
        Transition(_duty_left(0), source="on_even", target="off", direction=-1),
        Transition(_duty_left(1), source="on_odd", target="off", direction=-1),
        Transition(_current, _no_current, source="off", target="idle", direction=-1),
        Transition(every=_two_periods, target="on_even"),
        Transition(every=_two_periods, phase=_one_period, target="on_odd"),
    ],
    tangent={"idle": _without_current},
    names=("v", "i"),
    units=("V", "A"),
)


def _oscillate_about(centre):
    def field(t, x, args):
        pull = (args["omega"] ** 2 + args["beta"] ** 2) * (x[0] - centre)
        return jnp.stack([x[1], 2 * args["beta"] * x[1] - pull])

    return field


def _speed(t, x, args):
    return x[1]


def _sign(t, x, args):
    return jnp.where(x[0] > 0, 0, 1)


CORRON = Hybrid(
    {"plus": _oscillate_about(1.0), "minus": _oscillate_about(-1.0)},
    Transition(_speed, target=_sign, direction=0),
)


@problem
def chua(*, alpha: Real = 9.0, beta: Real = 100 / 7, m0: Real = -8 / 7, m1: Real = -5 / 7) -> Problem:
    """Chua's circuit: x' = α(y − x − f(x)), y' = x − y + z, z' = −βy; f has slope m₀ in |x| < 1 and m₁ beyond.

    f is continuous, f(±1) = ±m₀: the field does not jump at the kinks and S = I there. Steps end at the kinks
    nevertheless. At t = 2e5 the zero exponent comes out as −0.0038(5) with RK4 in steps of 0.05 over the kinks, and as
    0.00002(6) in the same steps that end at them; adaptive steps over the kinks are right too, but need many small
    steps. The exponents sum to the mean divergence.

    Args:
        alpha: α, ratio of the capacitances, positive.
        beta: β, positive.
        m0: slope of f between the kinks.
        m1: slope of f beyond the kinks.

    Returns:
        A `Problem` in mode "middle"; at the default parameters with the reference 0.32689(54), 0, −2.5177(20).

    Source:
        L. O. Chua, M. Komuro & T. Matsumoto, The double scroll family, IEEE Trans. Circuits Syst. 33 (1986) 1072,
        doi:10.1109/TCS.1986.1085869.

    Example:
        >>> from lyaphybrid import zoo
        >>> print(zoo.chua().reference)
        0.32689(54), -0.000002(30), -2.5177(20) per unit time (RK4 in C with exact landing on the kinks, t = 4e5)
    """
    positive(alpha=alpha, beta=beta)
    known = near((alpha, beta, m0, m1), 9.0, 100 / 7, -8 / 7, -5 / 7)
    return Problem(
        system=CHUA,
        x0=state(0.1, 0.2, 0.3),
        args={"alpha": alpha, "beta": beta, "m0": m0, "m1": m1},
        mode="middle",
        t1=20_000.0,
        transient=200.0,
        reference=computed(
            (0.326889, -2e-6, -2.517658),
            (5.4e-4, 3e-5, 2e-3),
            source="RK4 in C with exact landing on the kinks, t = 4e5",
        )
        if known
        else None,
        source="L. O. Chua, M. Komuro & T. Matsumoto, IEEE Trans. Circuits Syst. 33 (1986) 1072, "
        "doi:10.1109/TCS.1986.1085869",
    )


@problem
def buck_converter(*, voltage: Real = 33.0) -> Problem:
    """A buck converter: C v' = i − v/R, L i' = V − v while the control a (v − v_ref) is below a ramp, else L i' = −v.

    The ramp rises from 3.8 to 8.2 V and falls at once, every T = 400 µs; the switch follows the comparator without
    a latch, so it may switch several times a period. R = 22 Ω, L = 20 mH, C = 47 µF, a = 8.4, v_ref = 11.3 V; state
    (v, i) in volts and amperes, time in seconds.

    A ramp written with floor(t/T) would make a guard that jumps. Instead a clock ticks where the ramp falls, and sets
    the switch again. For a smooth ramp on both sides of a tick, periods are even and odd in turn, each with its own
    modes and a ramp that continues smoothly beyond both ends of the period.
    So the phase is no component of the state and there are two exponents. They sum to −1/(RC) exactly, S having
    determinant 1. The mode fits t = 0 and every even multiple of T as a start.

    Args:
        voltage: V of the source, volts, positive. One switching a period repeats up to about 24.5 V; 33 V is chaotic.

    Returns:
        A `Problem` in mode "off_even", 20 000 periods long; at 33 V with the reference 1198.4(1.9), −2165.6(1.9)
        per second.

    Source:
        D. C. Hamill, J. H. B. Deane & D. J. Jefferies, Modeling of chaotic DC-DC converters by iterated nonlinear
        mappings, IEEE Trans. Power Electron. 7 (1992) 25, doi:10.1109/63.124574.

    Example:
        >>> from lyaphybrid import zoo
        >>> print(zoo.buck_converter().reference)
        1198.4(19), -2165.6(19) per unit time (independent program, 5e5 periods)
    """
    positive(voltage=voltage)
    period = 400e-6
    return Problem(
        system=BUCK,
        x0=state(12.0, 0.5),
        args={
            "voltage": voltage,
            "resistance": 22.0,
            "inductance": 20e-3,
            "capacitance": 47e-6,
            "period": period,
            "gain": 8.4,
            "wanted": 11.3,
            "low": 3.8,
            "high": 8.2,
        },
        mode="off_even",
        t1=20_000 * period,
        transient=200 * period,
        reference=computed((1198.445, -2165.563), (1.9, 1.9), source="independent program, 5e5 periods")
        if near(voltage, 33.0)
        else None,
        source="D. C. Hamill, J. H. B. Deane & D. J. Jefferies, IEEE Trans. Power Electron. 7 (1992) 25, "
        "doi:10.1109/63.124574",
    )


@problem
def boost_converter(
    *, voltage: Real = 16.0, resistance: Real = 25.0, duty: Real = 0.21, feedback: Real = 0.2
) -> Problem:
    """A boost converter in discontinuous conduction: a period on, off and idle, and what the current was is forgotten.

    On: L i' = V, C v' = −v/R. Off, the diode conducts: L i' = V − v, C v' = i − v/R. Idle, once i has come down to 0:
    i = 0, C v' = −v/R, and no perturbation of i. A clock puts the switch on every T = 1/3000 s, for a fraction of the
    period that the voltage at the tick decides: D − κ (v − 25 V), or not at all where that is negative. This voltage
    is not stored: while the switch is on v only decays, so it is v e^{t/RC}. (The phase t is that
    of `buck_converter`.) L = 208 µH, C = 222 µF; state (v, i) in volts and amperes, time in seconds.

    Every period with a pulse loses a direction: one exponent is −inf, the other that of the map of v at a tick to v at
    the next. At 12.5 Ω and D = 0.2874, the literature's values, chaos would not be discontinuous in the exact flow: the
    current no longer comes down to 0 in every period. Hence half of that load.

    Args:
        voltage: V of the source, volts, positive.
        resistance: R of the load, ohms, positive.
        duty: D, between 0 and 1, the fraction at which the output is 25 V.
        feedback: κ, per volt. At the other defaults one pulse repeats up to 0.13 and two up to 0.17.

    Returns:
        A `Problem` in mode "on_even", 20 000 periods long; at the default parameters with the reference 1023.49(29),
        −inf per second.

    Source:
        C. K. Tse, Flip bifurcation and chaos in three-state boost switching regulators, IEEE Trans. Circuits Syst. I
        41 (1994) 16, doi:10.1109/81.260213; the reference: tests/zoo/test_circuits.py.

    Example:
        >>> from lyaphybrid import zoo
        >>> print(zoo.boost_converter().reference)
        1023.49(29), -inf per unit time (closed-form map of a period, 2e7 periods)
    """
    positive(voltage=voltage, resistance=resistance)
    require("duty", duty, lambda d: 0 < d < 1, "between 0 and 1")
    period = 1 / 3000
    return Problem(
        system=BOOST,
        x0=state(25.0, 0.0),
        args={
            "voltage": voltage,
            "resistance": resistance,
            "inductance": 208e-6,
            "capacitance": 222e-6,
            "period": period,
            "duty": duty,
            "feedback": feedback,
            "wanted": 25.0,
        },
        mode="on_even",
        t1=20_000 * period,
        transient=200 * period,
        reference=computed(
            (1023.488, -math.inf),
            (0.286, 0.0),
            source="closed-form map of a period, 2e7 periods",
        )
        if near((voltage, resistance, duty, feedback), 16.0, 25.0, 0.21, 0.2)
        else None,
        source="C. K. Tse, IEEE Trans. Circuits Syst. I 41 (1994) 16, doi:10.1109/81.260213",
    )


@problem
def corron_oscillator(*, beta: Real = 0.68, omega: Real = 2 * math.pi) -> Problem:
    """An oscillator that a comparator keeps bounded: u'' − 2βu' + (ω² + β²)(u − s) = 0; s → sgn u wherever u' = 0.

    Between two zeros of u', half a turn π/ω apart whatever the state, u − s is multiplied by −e^{βπ/ω}. So a
    difference of u grows at the rate β, and the direction of the flow is neutral: the exponents are β and 0 for every
    orbit. A turn multiplies by r = e^{2πβ/ω}, at most 2. At r = 2 (β = ln 2 at ω = 2π, the usual choice) it shifts the
    binary digits of the state by one, and floating-point orbits of this map collapse (see `baker_map`), unless the
    integration makes errors enough; the default is slightly less. State (u, u').

    Args:
        beta: β, growth rate, positive, per time, at most ω ln 2 / 2π.
        omega: ω, radians per time.

    Returns:
        A `Problem` in mode "plus" (s = 1) with its exact reference.

    Source:
        N. J. Corron, J. N. Blakely & M. T. Stahl, A matched filter for chaos, Chaos 20 (2010) 023123,
        doi:10.1063/1.3432557.

    Example:
        >>> from lyaphybrid import zoo
        >>> print(zoo.corron_oscillator().reference)
        0.68, 0 per unit time (growth over half a turn)
    """
    positive(beta=beta, omega=omega)
    if not traced(beta, omega):
        bound = omega * math.log(2) / (2 * math.pi)
        require("beta", beta, lambda b: b <= bound, f"at most ω ln 2 / 2π = {bound:.4g}, so that u stays bounded")
    return Problem(
        system=CORRON,
        x0=state(0.3, 0.0),
        args={"beta": beta, "omega": omega},
        mode="plus",
        t1=1000.0,
        transient=20.0,
        reference=None if traced(beta) else exact(beta, 0.0, source="growth over half a turn"),
        source="N. J. Corron, J. N. Blakely & M. T. Stahl, Chaos 20 (2010) 023123, doi:10.1063/1.3432557",
    )
