"""Izhikevich's neuron: two equations, one of them quadratic, and a reset."""

import jax.numpy as jnp

from ...systems.hybrid import Hybrid, Transition
from ..problem import Problem, Real, computed, near, problem, require, state, traced

__all__ = ["izhikevich"]


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
