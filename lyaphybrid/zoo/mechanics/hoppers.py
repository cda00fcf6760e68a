"""Hopping and running on springs. Lengths in legs, weights in weights, so that g = 1 and m = 1."""

import math

import jax.numpy as jnp

from ...systems.hybrid import Hybrid, Transition
from ..problem import Problem, Real, computed, near, positive, problem, require, state

__all__ = ["slip_runner", "vertical_hopper"]


def _in_the_air(t, x, args):
    return jnp.stack([x[1], -jnp.ones_like(x[1])])


def _on_the_leg(extra):
    def field(t, x, args):
        force = args["stiffness"] * (1 + extra * args["thrust"] - x[0]) - args["damping"] * x[1]
        return jnp.stack([x[1], force - 1])

    return field


HOPPER = Hybrid(
    {"flight": _in_the_air, "compression": _on_the_leg(0), "thrust": _on_the_leg(1)},
    [
        Transition(lambda t, x, args: x[0] - 1, source="flight", target="compression"),
        Transition(lambda t, x, args: x[1], source="compression", target="thrust", direction=1),
        Transition(lambda t, x, args: 1 + args["thrust"] - x[0], source="thrust", target="flight"),
        Transition(lambda t, x, args: x[0], source=("compression", "thrust"), terminal=True),
    ],
    names=("y", "y'"),
)


@problem
def vertical_hopper(*, stiffness: Real = 10.0, damping: Real = 0.4, thrust: Real = 0.15) -> Problem:
    """A mass on a springy leg hops in place: y'' = −1 in the air, y'' = k (l − y) − c y' − 1 on the leg.

    It lands at y = 1 with l = 1; at the lowest point the leg's rest length grows to l = 1 + δ, which gives back what
    the damper took, and the mass leaves the ground at y = 1 + δ; in the air the leg shortens. All pieces are linear;
    the motion that hops has the multipliers 1 and that of the map from one landing to the next. A hopper whose leg
    collapses (y = 0) ends the run as `terminated`; one that takes too little off stays on the ground.

    Args:
        stiffness: k, above 1.
        damping: c, at least 0.
        thrust: δ, positive.

    Returns:
        A `Problem` that starts in flight; at the default parameters with the reference 0, −0.040441112.

    Source:
        D. E. Koditschek & M. Bühler, Analysis of a simplified hopping robot, Int. J. Robotics Res. 10 (1991) 587,
        doi:10.1177/027836499101000601.

    Example:
        >>> from lyaphybrid import zoo
        >>> print(zoo.vertical_hopper().reference)
        0, -0.0404411119(10) per unit time (the map from landing to landing)
    """
    require("stiffness", stiffness, lambda v: v > 1, "above 1")
    require("damping", damping, lambda v: v >= 0, "at least 0")
    positive(thrust=thrust)
    known = near((stiffness, damping, thrust), 10, 0.4, 0.15)
    reference = computed((0.0, _HOPPER), (0.0, 1e-9), source="the map from landing to landing") if known else None
    return Problem(
        system=HOPPER,
        x0=state(1.3, 0.0),
        args={"stiffness": stiffness, "damping": damping, "thrust": thrust},
        mode="flight",
        t1=500.0,
        transient=100.0,
        reference=reference,
        source="D. E. Koditschek & M. Bühler, Int. J. Robotics Res. 10 (1991) 587, doi:10.1177/027836499101000601",
    )


_HOPPER = -0.040441111892


SEYFARTHS_ANGLE = math.radians(68.0)


def _ballistic(t, x, args):
    return jnp.stack([x[2], x[3], jnp.zeros_like(x[2]), -jnp.ones_like(x[3])])


def _stance(t, x, args):
    length = jnp.sqrt(x[0] ** 2 + x[1] ** 2)
    pull = args["stiffness"] * (1 / length - 1)
    return jnp.stack([x[2], x[3], pull * x[0], pull * x[1] - 1])


def _land(t, x, args):
    return jnp.stack([0 * x[0] - jnp.cos(args["angle"]), x[1], x[2], x[3]])


RUNNER = Hybrid(
    {"ascent": _ballistic, "descent": _ballistic, "stance": _stance},  # it may leave the ground lower than it lands
    [
        Transition(lambda t, x, args: x[3], source="ascent", target="descent"),
        Transition(lambda t, x, args: x[1] - jnp.sin(args["angle"]), _land, source="descent", target="stance"),
        Transition(lambda t, x, args: 1 - x[0] ** 2 - x[1] ** 2, source="stance", target="ascent"),
        Transition(lambda t, x, args: x[1], source=("stance", "descent"), terminal=True),
        Transition(lambda t, x, args: x[2], source="ascent", terminal=True),
    ],
    names=("x", "y", "x'", "y'"),
)


@problem
def slip_runner(*, stiffness: Real = 25.5, angle: Real = SEYFARTHS_ANGLE, speed: Real = 1.596) -> Problem:
    """The spring-loaded inverted pendulum runs: a mass on a springy leg without mass, no damper and no motor.

        flight: x'' = 0, y'' = −1;     stance: (x, y)'' = k (1/l − 1)(x, y) − (0, 1), l² = x² + y²

    It lands where y falls to sin α, with the leg at the angle α to the ground; then x, measured from the foot, becomes
    −cos α. It leaves the ground at l = 1. The energy is conserved, yet the gait attracts within its level: the
    exponents are 0 (along the motion), 0 (energy), that of the map from apex to apex, and −inf, for x is forgotten at
    each landing. A runner that falls (y = 0) or turns back in the air (x' = 0) ends the run as `terminated`.

    Args:
        stiffness: k, in weights per leg length, positive.
        angle: α, in (0, π/2); 68° by default.
        speed: x' at the first apex, positive, in √(g l); y there is 1.

    Returns:
        A `Problem` that starts at an apex, close to the gait; at the default parameters with the reference 0, 0,
        −2.359430(5), −inf.

    Source:
        A. Seyfarth, H. Geyer, M. Günther & R. Blickhan, A movement criterion for running, J. Biomechanics 35 (2002)
        649, doi:10.1016/S0021-9290(01)00245-7.

    Example:
        >>> from lyaphybrid import zoo
        >>> print(zoo.slip_runner().reference)
        0, 0, -2.3594300(50), -inf per unit time (the map from apex to apex)
    """
    require("angle", angle, lambda v: 0 < v < math.pi / 2, "between 0 and π/2")
    positive(stiffness=stiffness, speed=speed)
    known = near((stiffness, angle, speed), 25.5, SEYFARTHS_ANGLE, 1.596)
    values, errors = (0.0, 0.0, _RUNNER, -math.inf), (0.0, 0.0, 5e-6, 0.0)
    return Problem(
        system=RUNNER,
        x0=state(0.0, 1.0, speed, 0.0),
        args={"stiffness": stiffness, "angle": angle},
        mode="descent",
        t1=500.0,
        transient=100.0,
        reference=computed(values, errors, source="the map from apex to apex") if known else None,
        source="A. Seyfarth et al., J. Biomechanics 35 (2002) 649, doi:10.1016/S0021-9290(01)00245-7",
    )


_RUNNER = -2.35943
