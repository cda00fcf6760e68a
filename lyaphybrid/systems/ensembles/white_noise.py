"""White noise in a smooth flow: a stochastic differential equation along one Brownian path, by a clock."""

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array

from ..._arguments import positive, require, whole
from ..bound import require_callable
from ..hybrid import Hybrid, Transition
from ..smooth import Flow
from .noise import frozen_noise

__all__ = ["white_noise"]

_CROSSINGS = (
    "white_noise takes an lh.Flow, without guards; got {}. A Brownian path that meets a surface meets it infinitely "
    "often at once: no event time has a derivative, and there is no saltation matrix. With noise of a positive "
    "correlation time there is: let a clock set an input (lh.frozen_noise)."
)


def white_noise(
    flow: Flow, diffusion: Callable, *, step: float, until: float, sources: int = 1, seed: Any = 0
) -> Hybrid:
    """The stochastic flow dx = f dt + G ∘ dW (Stratonovich), along one Brownian path W of `sources` components.

    By a splitting: f alone for one `step`, by the method and the tolerances of the run, then x' = G(t, x) ΔW for one
    unit, by a step of RK4, at the tick of a clock. It is of strong order 1 where the columns of G commute: for additive
    noise, one source, or sources that act on components of their own.

    The path is a function of the seed and the time: the same for all perturbations, starts and points of a sweep, so
    that exponents, covariant vectors, sweeps and derivatives are those of a random dynamical system; and the same for a
    step that is halved, again and again. From Itô's form subtract ½ Σ_j Dg_j g_j from f.

    Args:
        flow: an `lh.Flow`, the drift f.
        diffusion: ``(t, x, args) -> (n,)`` for one source, or ``(n, sources)``.
        step: between two ticks; halve it to see its error.
        until: the latest time of a run, transient included; another one may belong to another path.
        sources: number of components of W.
        seed: a whole number, or a function of args that gives one.

    Returns:
        An `lh.Hybrid` with a clock. Runs begin at t0 = 0 or later; one that goes beyond `until` ends as `nonfinite`.

    Raises:
        ValueError: on anything but an `lh.Flow`, with the reason; on arguments that do not fit.

    Source:
        L. Arnold, Random Dynamical Systems (Springer 1998), doi:10.1007/978-3-662-12878-7; the path is P. Lévy's
        construction by middles, as in J. G. Gaines & T. J. Lyons, SIAM J. Appl. Math. 57 (1997) 1455,
        doi:10.1137/S0036139995286515.

    Example:
        A particle in a double well, x' = x − x³ with multiplicative noise: λ = −2, whatever its strength (Arnold).

        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> noisy = lh.white_noise(lh.Flow(lambda t, x, s: x - x**3), lambda t, x, s: s * x, step=0.02, until=500.0)
        >>> found = lh.lyapunov_spectrum(noisy, [1.0], 0.5, t1=500.0)
        >>> bool(abs(found.exponents[0] + 2) < 4 * found.stderr[0])
        True
    """
    require(isinstance(flow, Flow), _CROSSINGS.format(type(flow).__name__))
    require_callable("diffusion", diffusion, "(t, x, args) -> (n,) or (n, sources)")
    positive("step", step)
    positive("until", until)
    whole("sources", sources, least=1)

    most = until / step + 0.5
    levels = math.floor(math.log2(until / step)) + 1  # the path has 2**levels steps, more than are asked for

    def kick(t, x, args):
        tick = jnp.round(jax.lax.stop_gradient(t) / step)
        where = (seed(args) if callable(seed) else seed), levels, step, sources
        change = _walked(tick, *where) - _walked(tick - 1, *where)
        change = jnp.where((tick > 0) & (tick <= most), change, jnp.nan)  # the path ends: the run is `nonfinite`
        return _along(lambda x: jnp.reshape(diffusion(t, x, args), (x.shape[0], sources)) @ change, x)

    labels = {"names": flow.names, "units": flow.units, "time_unit": flow.time_unit}
    return Hybrid(flow.field, Transition(every=step, reset=kick), **labels)


def _walked(tick, seed, levels: int, step: float, sources: int) -> Array:
    """W (sources,) at a tick: from the ends of the path to ever nearer middles, each given its neighbours."""
    whole = 2.0**levels  # ticks

    def nearer(_, state):
        low, length, at_low, at_high = state
        middle, number = low + length / 2, (whole + low) / length  # its number: 1, then 2 and 3, then 4 to 7, …
        apart = jnp.sqrt(length * step) / 2
        at_middle = (at_low + at_high) / 2 + apart * frozen_noise(seed, number, (sources,))
        right = tick >= middle
        at_low, at_high = jnp.where(right, at_middle, at_low), jnp.where(right, at_high, at_middle)
        return jnp.where(right, middle, low), length / 2, at_low, at_high

    zero = jnp.zeros_like(tick)
    end = jnp.sqrt(whole * step) * frozen_noise(seed, zero, (sources,))
    return jax.lax.fori_loop(0, levels, nearer, (zero, zero + whole, jnp.zeros_like(end), end))[2]


def _along(field: Callable, x):
    """One step of RK4 of length 1: exact to the fifth order in ΔW."""
    one = field(x)
    two = field(x + one / 2)
    three = field(x + two / 2)
    return x + (one + 2 * two + 2 * three + field(x + three)) / 6
