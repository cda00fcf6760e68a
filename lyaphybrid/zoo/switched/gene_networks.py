"""Glass networks: genes that are on or off switch each other, and decay in between."""

import functools
import math

import jax.numpy as jnp
import numpy as np

from ...systems.event_driven import EventDriven
from ..problem import Problem, Reference, computed, exact, one_of, problem, require, state

__all__ = ["glass_network"]

BARELY = 1e-300  # a gene that has just been switched is so far beyond its threshold
EARLY = 8  # an event is so many roundings early: what is next to switch must still be on its side of the threshold
# Of four genes: whether each is made, by the other three, the first of them counted as 1, the next 2 and 4.
CHAOTIC = ("01010111", "00011110", "00111010", "10001001")
_CHAOTIC_RATES, _CHAOTIC_ERRORS = (0.15012, 0.0, -1.0, -3.15012), (1e-4, 0.0, 0.0, 1e-4)


def _focal_point(x, args):
    """Where x goes to, ±1 each, by which genes are on."""
    on = jnp.sum(jnp.where(x > 0, 2 ** np.arange(x.shape[0]), 0))
    return jnp.asarray(args["focal"])[on]


def _decay(dt, t, x, args):
    focal = _focal_point(x, args)
    return focal + (x - focal) * jnp.exp(-dt)


def _next_switch(t, x, args):
    focal = _focal_point(x, args)
    waits = jnp.where(x * focal < 0, jnp.log1p(jnp.abs(x)), jnp.inf)
    which = jnp.argmin(waits)
    return jnp.maximum(waits[which] - EARLY * jnp.finfo(x.dtype).eps, 0.0), which


def _switch(t, x, args, which):
    # Its own state does not decide where a gene goes, so that rounding at the threshold does not matter.
    return x.at[which].set(_focal_point(x, args)[which] * BARELY)


def _threshold(t, x, args, which):
    return -_focal_point(x, args)[which] * x[which]


GLASS = EventDriven(_decay, _next_switch, _switch, _threshold, invertible=True)


@problem
def glass_network(*, network: str = "chaotic", n: int = 4) -> Problem:
    """Genes, n of them, that switch each other: x_i' = −x_i + F_i, F_i = ±1 by which of the others have x_j > 0.

    Between two switchings all x_j approach F, (F_i x_j − F_j x_i)/(F_i − x_i) at the next one, of gene i: a motion is a
    product of such fractions, and the exponents are those of products of the matrices 1 − F_i F eᵢᵀ, less the largest
    in a cycle. One of them is 0, along the motion, one −1, of x → cx.

    Args:
        network: "ring": gene i is made where gene i − 1 is off (n odd: it oscillates); or "chaotic": four genes, a
            table
            found by a search among random ones.
        n: number of genes of a ring, odd and at least 3; 4 for "chaotic".

    Returns:
        A `Problem`; with its reference: 0.1501(1), 0, −1, −3.1501(1), or the multipliers of the ring's cycle.

    Source:
        L. Glass & J. S. Pasternack, Prediction of limit cycles in mathematical models of biological oscillations, Bull.
        Math. Biol. 40 (1978) 27, doi:10.1007/BF02463128; chaos: T. Mestl, R. J. Bagley & L. Glass, Phys. Rev. Lett. 79
        (1997) 653, doi:10.1103/PhysRevLett.79.653.

    Example:
        >>> from lyaphybrid import zoo
        >>> print(zoo.glass_network().reference)
        0.15012(10), 0, -1, -3.15012(10) per unit time (products of matrices)
        >>> print(zoo.glass_network(network="ring", n=3).reference)
        0, -1, -2 per unit time (the multipliers of the cycle)
    """
    one_of("network", network, ("chaotic", "ring"))
    if network == "ring":
        require("n", n, lambda v: v >= 3 and v % 2 == 1, "odd and at least 3")
    else:
        require("n", n, lambda v: v == 4, 'the four genes of "chaotic"')
    start = state(*(0.3 * math.cos(2.0 * i + 1.0) for i in range(n)))
    return Problem(
        system=GLASS,
        x0=start,
        args={"focal": _ring(n) if network == "ring" else _by_rules(CHAOTIC)},
        t1=2000.0,
        transient=100.0,
        reference=_cycle(n)
        if network == "ring"
        else computed(_CHAOTIC_RATES, _CHAOTIC_ERRORS, source="products of matrices"),
        source="L. Glass & J. S. Pasternack, Bull. Math. Biol. 40 (1978) 27, doi:10.1007/BF02463128",
    )


@functools.cache
def _patterns(n: int) -> np.ndarray:
    """(2ⁿ, n) which genes are on, by the number of a pattern; that of gene i counts 2ⁱ."""
    return np.arange(2**n)[:, None] >> np.arange(n) & 1


def _ring(n: int) -> np.ndarray:
    """(2ⁿ, n) focal points."""
    return 1.0 - 2.0 * np.roll(_patterns(n), 1, axis=1)


def _by_rules(rules: tuple[str, ...]) -> np.ndarray:
    """(2ⁿ, n) focal points."""
    n = len(rules)
    others = [np.delete(_patterns(n), i, axis=1) @ 2 ** np.arange(n - 1) for i in range(n)]
    return np.stack([2.0 * np.array(list(rules[i]), float)[others[i]] - 1.0 for i in range(n)], axis=1)


@functools.cache
def _cycle(n: int) -> Reference:
    """The ring's cycle: genes switch in turn, so that one switching and a change of names is a whole of it."""
    signs = (-1.0) ** np.arange(n)  # they alternate, but for gene 0 and the one before it: gene 0 switches next
    focal = -np.roll(signs, 1)
    matrix = np.eye(n) - np.outer(focal * focal[0], np.eye(n)[0])
    # Then gene 1 is the next one: called 0, and all signs turned, it is as before.
    values = np.linalg.eigvals(-np.roll(np.eye(n), 1, axis=1) @ matrix)
    values = values[np.argsort(np.abs(values))[::-1]]  # the last one is 0: gene 0 at its threshold
    time = math.log(np.abs(values[0]))
    rates = np.log(np.abs(values[1:-1])) / time - 1.0
    return exact(0.0, *rates, -1.0, source="the multipliers of the cycle")
