"""A heart cell that is stimulated with a period: how long it is excited, beat by beat."""

import math

import jax.numpy as jnp

from ...systems.smooth import Map
from ..problem import Problem, Real, Reference, exact, positive, problem, require, state, traced

__all__ = ["cardiac_alternans"]

SAME_BEAT, MOST_BEATS = 1e-13, 100_000


def _beat(n, x, args):
    late = jnp.ceil((x + args["refractory"]) / args["period"])  # stimuli before this one find the cell refractory
    rest = late * args["period"] - x
    return args["longest"] - args["loss"] * jnp.exp(-rest / args["recovery"])


HEART = Map(_beat, names=("A",), units=("ms",))


@problem
def cardiac_alternans(
    *,
    period: Real = 225.0,
    longest: Real = 220.0,
    loss: Real = 150.0,
    recovery: Real = 45.0,
    refractory: Real = 10.0,
) -> Problem:
    """Alternans of the heart: A⁺ = A_max − B e^(−D/τ), D = NT − A; A lasts an excitation, D the rest before it.

    N is the smallest number with D ≥ D_min: stimuli that come earlier have no effect. Where the restitution curve is
    steeper than 1, (B/τ) e^(−D/τ) > 1, equal beats give way to long and short ones in turn.

    Args:
        period: T of the stimuli, in ms, positive.
        longest: A_max, in ms, positive.
        loss: B, in ms, positive.
        recovery: τ, in ms, positive.
        refractory: D_min, in ms, at least 0.

    Returns:
        A `Problem`; where beats repeat, each or every second, with the exact reference ln|dA⁺/dA| per beat.

    Source:
        J. B. Nolasco & R. W. Dahlen, A graphic method for the study of alternation in cardiac action potentials, J.
        Appl. Physiol. 25 (1968) 191, doi:10.1152/jappl.1968.25.2.191.

    Example:
        >>> from lyaphybrid import zoo
        >>> print(zoo.cardiac_alternans(period=250).reference)
        -0.245223492 per jump (equal beats)
        >>> print(zoo.cardiac_alternans().reference)
        -0.09645690373 per jump (long and short beats in turn)
    """
    positive(period=period, longest=longest, loss=loss, recovery=recovery)
    require("refractory", refractory, lambda v: v >= 0, "at least 0")
    args = {"period": period, "longest": longest, "loss": loss, "recovery": recovery, "refractory": refractory}
    return Problem(
        system=HEART,
        x0=state(0.8 * longest),
        args=args,
        t1=10_000,
        transient=1000,
        clock="jumps",
        reference=None if traced(*args.values()) else _alternation(0.8 * longest, **args),
        source="J. B. Nolasco & R. W. Dahlen, J. Appl. Physiol. 25 (1968) 191, doi:10.1152/jappl.1968.25.2.191",
    )


def _alternation(a: float, period, longest, loss, recovery, refractory) -> Reference | None:
    """The exponent of the fixed point, or of the cycle of two, to which the beats converge; None if they do not."""

    def beat(a):
        lost = loss * math.exp(-(math.ceil((a + refractory) / period) * period - a) / recovery)
        return longest - lost, lost / recovery

    for _ in range(MOST_BEATS):
        first, slope = beat(a)
        second, other = beat(first)
        if abs(second - a) < SAME_BEAT * longest:
            rate = math.log(slope * other) / 2
            what = "equal beats" if abs(first - a) < 1e-9 * longest else "long and short beats in turn"
            return exact(rate, source=what, clock="jumps") if rate < 0 else None
        a = second
    return None
