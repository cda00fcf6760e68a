"""Neurons that integrate and fire."""

import math

import jax.numpy as jnp

from ..systems import EventDriven, Hybrid, Transition
from .problem import Problem, Real, exact, one_of, problem, require, state, traced


def _charge(t, x, args):
    return args["current"] - x


def _below_threshold(t, x, args):
    return 1 - x


def _is(which, x):
    which = jnp.asarray(which)
    return jnp.arange(x.shape[0], dtype=which.dtype) == which


def _fire(t, x, args, which):
    return jnp.where(_is(which, x), 0.0, x + args["coupling"])


def _charge_for(dt, t, x, args):
    return args["current"] - (args["current"] - x) * jnp.exp(-dt)


def _next_to_fire(t, x, args):
    current, which = args["current"], jnp.argmax(x)
    return jnp.log((current - jnp.max(x)) / (current - 1)), which


def _below_threshold_of(t, x, args, which):
    return 1 - jnp.sum(jnp.where(_is(which, x), x, 0.0))


HYBRID = Hybrid(_charge, Transition(_below_threshold, _fire))
EXACT = EventDriven(flow=_charge_for, next_event=_next_to_fire, jump=_fire, guard=_below_threshold_of)


def _potentials(n: int) -> list[float]:
    """Distinct starts in [0, 1), for more than two spread by the golden mean."""
    return [0.6326296498429654, 0.46839295794497127] if n == 2 else [0.618033988749895 * i % 1 for i in range(n)]


@problem
def integrate_and_fire(*, n: int = 2, current: Real = 2.0, coupling: Real = -0.1, form: str = "hybrid") -> Problem:
    """Leaky neurons, n of them: x_i' = I − x_i; where x_i reaches 1 it falls to 0 and the others get ε.

    Two neurons that inhibit each other (ε < 0) fire in turn: u = I − x of the waiting one, just after the
    other fired, solves u² + εu = I(I − 1); they fire every T = ln(u/(I − 1)). The exponents are 0 and −2 +
    ln(I/(I − 1))/T, because the leak gives −2 and each crossing has det S = I/(I − 1).

    Args:
        n: number of neurons, at least 2.
        current: I, above the threshold 1.
        coupling: ε, what a spike adds to every other neuron. Excitation (ε > 0) makes cascades: "hybrid"
            only.
        form: "hybrid", an `lh.Hybrid` with one guard (n,); or "event_driven", the same in closed form.

    Returns:
        A `Problem`, with its exact reference for two neurons and ε < 0: 0, −0.1851059509884756 at the
        defaults.

    Source:
        R. E. Mirollo & S. H. Strogatz, Synchronization of pulse-coupled biological oscillators, SIAM J. Appl.
        Math. 50 (1990) 1645, doi:10.1137/0150098; inhibition: C. van Vreeswijk, L. F. Abbott & G. B.
        Ermentrout, J. Comput. Neurosci. 1 (1994) 313, doi:10.1007/BF00961879.

    Example:
        >>> from lyaphybrid import zoo
        >>> print(zoo.integrate_and_fire(form="event_driven").reference)
        0, -0.185105951 per unit time (the antiphase orbit)
    """
    require("n", n, lambda v: v >= 2, "at least 2")
    require("current", current, lambda v: v > 1, "above the threshold 1")
    one_of("form", form, ("hybrid", "event_driven"))
    reference = None
    if not traced(current, coupling):
        if form == "event_driven":
            require(
                "coupling",
                coupling,
                lambda v: v <= 0,
                'at most 0 in form "event_driven" (excitation cascades)',
            )
        if n == 2 and coupling < 0:
            wait = (-coupling + math.sqrt(coupling**2 + 4 * current * (current - 1))) / 2
            period = math.log(wait / (current - 1))
            slow = -2 + math.log(current / (current - 1)) / period
            reference = exact(0.0, slow, source="the antiphase orbit")
    return Problem(
        system=HYBRID if form == "hybrid" else EXACT,
        x0=state(*_potentials(n)),
        args={"current": current, "coupling": coupling},
        t1=1000.0,
        transient=100.0,
        reference=reference,
        source="R. E. Mirollo & S. H. Strogatz, SIAM J. Appl. Math. 50 (1990) 1645, doi:10.1137/0150098",
    )
