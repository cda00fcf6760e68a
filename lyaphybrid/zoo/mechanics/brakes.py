"""A wheel that brakes without locking."""

import jax.numpy as jnp

from ...systems.hybrid import Hybrid, Transition
from ..problem import Problem, Real, computed, near, positive, problem, require, state, traced

__all__ = ["abs_brake"]

GRIP = (1.28, 23.99, 0.52)  # a tyre on dry asphalt


def _slipping(rate):
    def field(t, x, args):
        most, rise, fall = GRIP
        grip = most * (1 - jnp.exp(-rise * x[0])) - fall * x[0]
        return jnp.stack([args["inertia_rate"] * (x[1] - grip), rate(args) + 0 * x[1]])

    return field


BRAKE = Hybrid(
    {"apply": _slipping(lambda args: args["apply"]), "release": _slipping(lambda args: -args["release"])},
    [
        Transition(lambda t, x, args: args["high"] - x[0], source="apply", target="release"),
        Transition(lambda t, x, args: x[0] - args["low"], source="release", target="apply"),
        Transition(lambda t, x, args: 1 - x[0], terminal=True),
    ],
    names=("slip", "torque"),
)


@problem
def abs_brake(
    *,
    apply: Real = 10.0,
    release: Real = 20.0,
    high: Real = 0.25,
    low: Real = 0.1,
    inertia_rate: Real = 18.0,
) -> Problem:
    """An anti-lock brake: one wheel at a given speed of the car, a valve that applies or releases the brake.

    s' = c (T − μ(s)) of the slip and T' = r₊ or −r₋ of the brake's torque, in units of the wheel's load times its
    radius; μ(s) = 1.28 (1 − e^(−23.99 s)) − 0.52 s. The valve opens where s rises to `high` and closes where it falls
    to `low`. The grip is greatest at s = 0.17; beyond it the wheel tends to lock, and the motion between the two
    surfaces is a cycle. A wheel that locks (s = 1) ends the run as `terminated`.

    Args:
        apply: r₊, per s, positive.
        release: r₋, per s, positive.
        high: the slip at which the brake is released; below 1.
        low: the slip at which it is applied again; positive, below `high`.
        inertia_rate: c = R² F/(J v), per s, for the radius R, the load F, the wheel's inertia J and the car's speed v.

    Returns:
        A `Problem`; at the default parameters with the reference 0, −85.045676(2).

    Source:
        W. Pasillas-Lépine, Hybrid modeling and limit cycle analysis for a class of five-phase anti-lock brake
        algorithms, Vehicle System Dynamics 44 (2006) 173, doi:10.1080/00423110500385873; the grip: M. Burckhardt,
        Fahrwerktechnik: Radschlupf-Regelsysteme, Vogel 1993.

    Example:
        >>> from lyaphybrid import zoo
        >>> print(zoo.abs_brake().reference)
        0, -85.0456764(20) per unit time (the map from opening to opening)
    """
    positive(apply=apply, release=release, low=low, inertia_rate=inertia_rate)
    if not traced(high, low):
        require("high", high, lambda v: low < v < 1, "above low and below 1")
    args = {"apply": apply, "release": release, "high": high, "low": low, "inertia_rate": inertia_rate}
    known = near(tuple(args.values()), 10, 20, 0.25, 0.1, 18)
    reference = computed((0.0, _RATE), (0.0, _ERROR), source="the map from opening to opening") if known else None
    return Problem(
        system=BRAKE,
        x0=state(0.15, 1.0),
        args=args,
        mode="apply",
        t1=100.0,
        transient=20.0,
        reference=reference,
        source="W. Pasillas-Lépine, Vehicle System Dynamics 44 (2006) 173, doi:10.1080/00423110500385873",
    )


_RATE, _ERROR = -85.0456764, 2e-6
