"""Single neurons with a reset: Izhikevich's, one with a dendrite, one with a conductance that adapts."""

import jax.numpy as jnp

from ...systems.hybrid import Hybrid, Transition
from ..problem import Problem, Real, computed, near, positive, problem, require, state, traced

__all__ = ["conductance_neuron", "izhikevich", "two_compartment_neuron"]


def _rates(t, x, args):
    v, u = x[0], x[1]
    return jnp.stack([0.04 * v**2 + 5 * v + 140 - u + args["current"], args["a"] * (args["b"] * v - u)])


def _spike(t, x, args):
    return jnp.stack([args["c"] + 0 * x[0], x[1] + args["d"]])


IZHIKEVICH = Hybrid(_rates, Transition(lambda t, x, args: args["peak"] - x[0], _spike), names=("v", "u"))


@problem
def izhikevich(
    *,
    current: Real = -99.0,
    a: Real = 0.2,
    b: Real = 2.0,
    c: Real = -56.0,
    d: Real = -16.0,
    peak: Real = 30.0,
) -> Problem:
    """Izhikevich's neuron: v' = 0.04 v² + 5v + 140 − u + I, u' = a (bv − u); at v = 30, v⁺ = c and u⁺ = u + d.

    In ms and mV. One exponent is 0 where it spikes without end, the other one is that of the map from u after a spike
    to u after the next. At the default parameters it spikes irregularly; a = 0.02, b = 0.2, c = −65, d = 8, I = 10 is
    the regular spiking of a cortical cell.

    Args:
        current: I.
        a: rate of recovery, per ms.
        b: coupling of the recovery to the voltage.
        c: v after a spike; below the peak.
        d: what u gains by a spike.
        peak: v at which a spike is cut off; unlike AdEx its height matters.

    Returns:
        A `Problem`; at the default parameters with the reference 0.09856(2), 0.

    Source:
        E. M. Izhikevich, Simple model of spiking neurons, IEEE Trans. Neural Networks 14 (2003) 1569,
        doi:10.1109/TNN.2003.820440; its chaos: S. Nobukawa, H. Nishimura, T. Yamanishi & J.-Q. Liu, PLoS ONE 10 (2015)
        e0138919, doi:10.1371/journal.pone.0138919.

    Example:
        >>> from lyaphybrid import zoo
        >>> print(zoo.izhikevich().reference)
        0.098560(20), 0 per unit time (the map from spike to spike)
    """
    args = {"current": current, "a": a, "b": b, "c": c, "d": d, "peak": peak}
    if not traced(peak, c):
        require("peak", peak, lambda v: v > c, "above c, the voltage after a spike")
    known = near(tuple(args.values()), -99, 0.2, 2, -56, -16, 30)
    return Problem(
        system=IZHIKEVICH,
        x0=state(c, -112.0),
        args=args,
        t1=20_000.0,
        transient=1000.0,
        reference=computed(_RATES, _ERRORS, source="the map from spike to spike") if known else None,
        source="E. M. Izhikevich, IEEE Trans. Neural Networks 14 (2003) 1569, doi:10.1109/TNN.2003.820440",
    )


_RATES, _ERRORS = (0.09856, 0.0), (2e-5, 0.0)


def _compartments(t, x, args):
    flow = args["coupling"] * (x[1] - x[0])
    return jnp.stack([-x[0] + flow, -x[1] - flow + args["current"]])


def _soma_resets(t, x, args):
    return jnp.stack([args["reset"] + 0 * x[0], x[1]])


TWO_COMPARTMENTS = Hybrid(
    _compartments, Transition(lambda t, x, args: 1 - x[0], _soma_resets), names=("soma", "dendrite")
)


@problem
def two_compartment_neuron(*, coupling: Real = 1.0, current: Real = 4.0, reset: Real = 0.0) -> Problem:
    """A leaky soma and a leaky dendrite: V' = −V + κ (D − V), D' = −D + κ (V − D) + I; at V = 1 the soma alone resets.

    Times in the membrane's time constant, voltages in the threshold. The dendrite remembers across spikes: one exponent
    is 0, the other that of the map from D at a spike to D at the next, −2 (1 + κ) + ln(V'⁺/V'⁻)/T.

    Args:
        coupling: κ, positive.
        current: I into the dendrite; it spikes without end where κI > 1 + 2κ.
        reset: V after a spike, below 1.

    Returns:
        A `Problem`; at the default parameters with the reference 0, −2.13504014.

    Source:
        J.-P. Rospars & P. Lánský, Stochastic model neuron without resetting of dendritic potential, Biol. Cybern. 69
        (1993) 283, doi:10.1007/BF00203125.

    Example:
        >>> from lyaphybrid import zoo
        >>> print(zoo.two_compartment_neuron().reference)
        0, -2.135040140(10) per unit time (the map from spike to spike)
    """
    positive(coupling=coupling)
    require("reset", reset, lambda v: v < 1, "below 1, the threshold")
    if not traced(coupling, current):
        require("current", current, lambda v: coupling * v > 1 + 2 * coupling, "so large that κI > 1 + 2κ")
    known = near((coupling, current, reset), 1, 4, 0)
    return Problem(
        system=TWO_COMPARTMENTS,
        x0=state(0.0, 1.0),
        args={"coupling": coupling, "current": current, "reset": reset},
        t1=1000.0,
        transient=100.0,
        reference=computed((0.0, _DENDRITE), (0.0, 1e-8), source="the map from spike to spike") if known else None,
        source="J.-P. Rospars & P. Lánský, Biol. Cybern. 69 (1993) 283, doi:10.1007/BF00203125",
    )


def _with_conductance(t, x, args):
    return jnp.stack([-x[0] - x[1] * (x[0] - args["reversal"]) + args["current"], -x[1] / args["memory"]])


def _opens_channels(t, x, args):
    return jnp.stack([0 * x[0], x[1] + args["gain"]])


CONDUCTANCE = Hybrid(_with_conductance, Transition(lambda t, x, args: 1 - x[0], _opens_channels), names=("V", "g"))


@problem
def conductance_neuron(*, current: Real = 3.0, gain: Real = 0.4, memory: Real = 5.0, reversal: Real = -0.5) -> Problem:
    """A neuron that tires: V' = −V − g (V − E) + I, g' = −g/τ; at V = 1 a spike, V⁺ = 0 and g⁺ = g + Δ.

    Times in the membrane's time constant, conductances in the leak's, voltages in the threshold. Each spike opens
    potassium channels, which close slowly; in the end what they gain is what they lose. One exponent is 0; the other is
    that of the map from g after a spike to g after the next.

    Args:
        current: I, above 1.
        gain: Δ, at least 0.
        memory: τ, positive.
        reversal: E, below 1.

    Returns:
        A `Problem`; at the default parameters with the reference 0, −0.98589874.

    Source:
        A. Treves, Mean-field analysis of neuronal spike dynamics, Network 4 (1993) 259,
        doi:10.1088/0954-898X_4_3_002.

    Example:
        >>> from lyaphybrid import zoo
        >>> print(zoo.conductance_neuron().reference)
        0, -0.985898742(10) per unit time (the map from spike to spike)
    """
    positive(memory=memory)
    require("current", current, lambda v: v > 1, "above 1: it never spikes else")
    require("gain", gain, lambda v: v >= 0, "at least 0")
    require("reversal", reversal, lambda v: v < 1, "below 1, the threshold")
    known = near((current, gain, memory, reversal), 3, 0.4, 5, -0.5)
    return Problem(
        system=CONDUCTANCE,
        x0=state(0.0, 0.5),
        args={"current": current, "gain": gain, "memory": memory, "reversal": reversal},
        t1=2000.0,
        transient=200.0,
        reference=computed((0.0, _TIRED), (0.0, 1e-8), source="the map from spike to spike") if known else None,
        source="A. Treves, Network 4 (1993) 259, doi:10.1088/0954-898X_4_3_002",
    )


_DENDRITE, _TIRED = -2.1350401398, -0.9858987418
