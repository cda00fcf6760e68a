"""A phase-locked loop with a charge pump."""

import jax.numpy as jnp
import numpy as np

from ...systems.hybrid import Hybrid, Transition
from ..problem import Problem, Real, Reference, exact, positive, problem, require, state, traced

__all__ = ["charge_pump_pll"]


def _pumped(sign):
    def field(t, x, args):
        rate = 1 + x[2] + sign * args["proportional"]
        return jnp.stack([jnp.ones_like(x[0]), rate, sign * args["integral"] - args["leak"] + 0 * x[2]])

    return field


def _edge(i):
    return lambda t, x, args: 1 - x[i]


def _wrapped(i):
    return lambda t, x, args: x.at[i].add(-1.0)


def _edges(i, steps):
    return [Transition(_edge(i), _wrapped(i), source=before, target=after) for before, after in steps]


LOOP = Hybrid(
    {"down": _pumped(-1.0), "idle": _pumped(0.0), "up": _pumped(1.0)},
    _edges(0, [("down", "idle"), ("idle", "up"), ("up", "up")])
    + _edges(1, [("up", "idle"), ("idle", "down"), ("down", "down")]),
    names=("reference", "oscillator", "w"),
)


@problem
def charge_pump_pll(*, integral: Real = 0.2, proportional: Real = 0.6, leak: Real = 0.02) -> Problem:
    """A phase-locked loop of second order with a charge pump, from edge to edge.

    Phases in turns, times in periods of the reference: a' = 1 of the reference, b' = 1 + w + p i of the oscillator, and
    w' = g i − ℓ of the filter. An edge of the reference (a = 1, then a − 1) raises the pump i by one, from −1 to 0, 0
    to 1, or leaves it at 1; an edge of the oscillator lowers it. The leak ℓ makes the pump work in each period: in lock
    it is on for δ = ℓ/g of it. Without a leak both edges coincide in lock, and there is no derivative.

    Args:
        integral: g, positive.
        proportional: p, at least 0.
        leak: ℓ, positive; below g, so that the pump can make up for it.

    Returns:
        A `Problem` that starts near the lock. Where this is stable it has the exact reference: 0, and the logarithms of
        the two multipliers of the map from one edge of the reference to the next.

    Source:
        F. M. Gardner, Charge-pump phase-lock loops, IEEE Trans. Commun. 28 (1980) 1849, doi:10.1109/TCOM.1980.1094619;
        M. van Paemel, Analysis of a charge-pump PLL: a new model, IEEE Trans. Commun. 42 (1994) 2490,
        doi:10.1109/26.297861.

    Example:
        >>> from lyaphybrid import zoo
        >>> print(zoo.charge_pump_pll().reference)
        0, -0.2449780209, -0.2449780209 per unit time (the multipliers of the lock)
    """
    positive(integral=integral, leak=leak)
    require("proportional", proportional, lambda v: v >= 0, "at least 0")
    known = not traced(integral, proportional, leak)
    if known:
        require("leak", leak, lambda v: v < integral, "below the pump's own rate, integral")
    return Problem(
        system=LOOP,
        x0=state(0.5, 0.45, 0.0),
        args={"integral": integral, "proportional": proportional, "leak": leak},
        mode="idle",
        t1=1000.0,
        transient=200.0,
        reference=_lock(integral, proportional, leak) if known else None,
        source="F. M. Gardner, IEEE Trans. Commun. 28 (1980) 1849, doi:10.1109/TCOM.1980.1094619",
    )


def _lock(g: float, p: float, leak: float) -> Reference | None:
    """The multipliers of the locked motion; with b and w at an edge of the reference it goes from (b, w) to (b, w)."""
    on = leak / g
    rest = 1 - on
    # Over a period the oscillator's phase gains 1: p δ and the integral of w cancel.
    low = -p * on - (g - leak) * on * (1 - on / 2) + leak * rest**2 / 2
    slope = 1 + low + p + (g - leak) * on  # of the phase where the pump is switched off
    by_phase, by_rate = -1 / slope, -on / slope  # derivatives of δ
    after = 1 + low + (g - leak) * on - leak * rest  # of the phase at the next edge of the reference
    w = np.array([(g - leak) * by_phase, 1 + (g - leak) * by_rate])  # where the pump is switched off
    turned = np.array([by_phase, by_rate])
    matrix = np.stack([rest * w - after * turned, w + leak * turned])
    rates = np.log(np.abs(np.linalg.eigvals(matrix)))
    return exact(0.0, *rates, source="the multipliers of the lock") if np.all(rates < 0) else None
