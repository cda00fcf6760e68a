"""Networks of integrate-and-fire neurons: three models, three topologies, two forms.

And a single adaptive exponential neuron.
"""

import functools
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...systems.event_driven import EventDriven
from ...systems.hybrid import Hybrid, Transition
from ...systems.kinds import System
from ..problem import (
    Problem,
    Real,
    Reference,
    computed,
    exact,
    near,
    one_of,
    positive,
    problem,
    require,
    state,
    traced,
)

EQUAL_POTENTIALS = 1e-12  # potentials this near to threshold or reset are equal to it up to rounding


class Neuron(NamedTuple):
    """A model of one neuron; its functions act elementwise on all neurons."""

    field: Callable  # (x, current) -> dx/dt
    flow: Callable  # (dt, x, current) -> x after the time dt
    wait: Callable  # (x, current) -> time to threshold
    pulse: Callable  # (x, strength, current) -> x after a pulse
    threshold: float
    reset: float


def _linear(slope: float) -> Neuron:
    """The neuron x' = I + γx, γ = ±1: x + γI is proportional to e^γt."""

    def wait(x, current):
        ratio = (1 + slope * current) / (x + slope * current)
        return slope * jnp.log(jnp.where(ratio > 0, ratio, jnp.inf))  # inf beyond the fixed point of γ = 1

    return Neuron(
        field=lambda x, current: current + slope * x,
        flow=lambda dt, x, current: (x + slope * current) * jnp.exp(slope * dt) - slope * current,
        wait=wait,
        pulse=lambda x, strength, current: x + strength,
        threshold=1.0,
        reset=0.0,
    )


def _kicked_phase(x, strength, current):
    """V = √I tan(φ/2) becomes V + ε. By atan2, so that it is continuous where rounding takes φ past π."""
    across, along = jnp.sin(x / 2), jnp.cos(x / 2)
    return 2 * jnp.arctan2(across + strength / jnp.sqrt(current) * along, along)


NEURON_SLOPES = {"leaky": -1.0, "xif": 1.0}
NEURONS = {
    **{model: _linear(slope) for model, slope in NEURON_SLOPES.items()},
    "qif": Neuron(
        field=lambda x, current: 2 * jnp.sqrt(current) * jnp.ones_like(x),
        flow=lambda dt, x, current: x + 2 * jnp.sqrt(current) * dt,
        wait=lambda x, current: (math.pi - x) / (2 * jnp.sqrt(current)),
        pulse=_kicked_phase,
        threshold=math.pi,
        reset=-math.pi,
    ),
}


def _to_neighbours(coupling, which, x):
    n = x.shape[0]
    apart = (jnp.arange(n, dtype=which.dtype) - which) % n
    return jnp.where((apart == 1) | (apart == n - 1), coupling, 0.0)


# What a spike of neuron `which` adds to all others; its own entry is ignored.
PULSES = {
    "all": lambda coupling, which, x: coupling,
    "ring": _to_neighbours,
    "matrix": lambda coupling, which, x: coupling[:, which],
}


def _is(which, x):
    return jnp.arange(x.shape[0], dtype=which.dtype) == which


def _firing(neuron: Neuron, topology: str) -> Callable:
    """The reset of one spike. Neurons at their reset value fired at the same time and are refractory."""

    def fire(t, x, args, which):
        which = jnp.asarray(which)
        kicked = neuron.pulse(x, PULSES[topology](args["coupling"], which, x), args["current"])
        refractory = jnp.abs(x - neuron.reset) <= EQUAL_POTENTIALS
        kicked = jnp.where(refractory, x, kicked)  # x, not the constant, to keep the derivative
        return jnp.where(_is(which, x), neuron.reset, kicked)

    return fire


def _avalanche(neuron: Neuron, topology: str) -> Callable:
    """The spikes of one neuron and of all that it lifts above the threshold, in the order of their indices."""
    fire = _firing(neuron, topology)

    def above(x):
        # A neuron at the threshold up to rounding came there by the flow: its spike is a separate event.
        return x > neuron.threshold + EQUAL_POTENTIALS

    def jump(t, x, args, which):
        return jax.lax.while_loop(
            lambda x: jnp.any(above(x)),
            lambda x: fire(t, x, args, jnp.argmax(above(x))),
            fire(t, x, args, which),
        )

    return jump


def _in_closed_form(neuron: Neuron, topology: str) -> EventDriven:
    def below_threshold(t, x, args, which):
        return neuron.threshold - jnp.sum(jnp.where(_is(jnp.asarray(which), x), x, 0.0))

    return EventDriven(
        flow=lambda dt, t, x, args: neuron.flow(dt, x, args["current"]),
        next_event=lambda t, x, args: (neuron.wait(jnp.max(x), args["current"]), jnp.argmax(x)),
        jump=_avalanche(neuron, topology),
        guard=below_threshold,
    )


def _with_guards(neuron: Neuron, topology: str, n: int) -> Hybrid:
    firing = Transition(lambda t, x, args: neuron.threshold - x, _firing(neuron, topology))
    return Hybrid(lambda t, x, args: neuron.field(x, args["current"]), firing, max_cascade=n)


@functools.cache
def _network(model: str, topology: str, form: str, n: int) -> System:
    """The same object for the same structure, so that compiled code is reused."""
    neuron = NEURONS[model]
    return _with_guards(neuron, topology, n) if form == "hybrid" else _in_closed_form(neuron, topology)


# Known exponents.


def _splay(slope: float, current: float, coupling: float, n: int) -> list[float] | None:
    """Exponents of the state in which n neurons of x' = I + γx fire in turn at equal intervals T, if it is stable.

    With v = x + γI and Q = e^γT those that wait, the next to fire first, go from v_j to v_{j−1} = Q v_j + ε until
    Q v_1 is at the threshold. All follows from Q = v_threshold/v_1, δQ = −Q δv_1/v_1.
    """
    threshold, reset = 1 + slope * current, slope * current
    steps = np.polynomial.Polynomial([-threshold, *[coupling] * (n - 1), reset])
    roots = [r.real for r in steps.roots() if abs(r.imag) < 1e-9 and r.real > 0 and slope * (r.real - 1) > 0]
    if len(roots) != 1:
        return None
    growth = roots[0] - steps(roots[0]) / steps.deriv()(roots[0])
    v = [reset]
    for _ in range(n - 1):
        v.insert(0, growth * v[0] + coupling)
    if np.any(np.diff(v) >= 0):  # pulses change the order of firing, or lift some above threshold
        return None
    matrix = growth * np.eye(n - 1, k=1)
    matrix[:, 0] -= growth * np.array(v[1:]) / v[0]
    period = slope * math.log(growth)
    exponents = np.log(np.abs(np.linalg.eigvals(matrix))) / period
    return None if np.any(exponents >= 0) else [0.0, *exponents]


def _reference(model: str, current: float, coupling: Any, topology: str, n: int) -> Reference | None:
    """The reference for all-to-all coupling; for two neurons a ring is the same."""
    if np.ndim(coupling) or (topology == "ring" and n > 2):
        return None
    if model == "qif":
        return exact(0.0, 0.0, source="every orbit is periodic and neutral") if n == 2 else None
    if model == "leaky" and coupling > 0:
        return exact(0.0, *[-math.inf] * (n - 1), source="synchrony")
    if model == "xif" and (n > 2 or _lifted_at_once(current, coupling)):
        return None
    splay = _splay(NEURON_SLOPES[model], current, coupling, n) if coupling else None
    if splay is None:
        return None
    return exact(*splay, source="the antiphase orbit" if n == 2 else "the splay state")


def _lifted_at_once(current: float, coupling: float) -> bool:
    """Whether the first spike of an "xif" pair lifts the other over the threshold; if not, no later one does."""
    first, second = _potentials(2)
    return (second + current) / (first + current) * (1 + current) - current + coupling >= 1


def _loses(model: str, coupling: Any) -> bool:
    """Whether avalanches may destroy directions, which needs an orthonormalisation after each of them."""
    return model != "qif" and (traced(coupling) or bool(np.any(np.asarray(coupling) > 0)))


def _potentials(n: int) -> list[float]:
    """Distinct starts in [0, 1), for more than two spread by the golden mean."""
    return [0.6326296498429654, 0.46839295794497127] if n == 2 else [0.618033988749895 * i % 1 for i in range(n)]


def _strengths(coupling: Any, topology: str, n: int) -> tuple[Any, str]:
    """The coupling as it goes into `args`, and its topology."""
    if np.ndim(coupling) == 0:
        return coupling, topology
    if topology != "all":
        raise ValueError(
            f'topology must be "all" where coupling is a matrix, which says itself who reaches whom; got {topology!r}.'
        )
    if np.shape(coupling) != (n, n):
        raise ValueError(
            f"coupling must be a number or have the shape (n, n) = ({n}, {n}); got {np.shape(coupling)}. "
            "Give the number of neurons as n."
        )
    if not traced(coupling):
        matrix = np.asarray(coupling, dtype=float)
        if not np.all(np.isfinite(matrix)):
            raise ValueError("coupling must be finite; got inf or nan in the matrix.")
        if np.any(np.diagonal(matrix) != 0):
            raise ValueError(
                f"coupling must be 0 on the diagonal, for a spike resets its own neuron; got {np.diagonal(matrix)!r}."
            )
    return jnp.asarray(coupling, dtype=float), "matrix"


@problem
def integrate_and_fire(
    *,
    n: int = 2,
    current: Real = 2.0,
    coupling: Real | Float[Array, "n n"] = -0.1,
    form: str = "hybrid",
    model: str = "leaky",
    topology: str = "all",
) -> Problem:
    """Neurons, n of them, that fire at a threshold, fall to their reset and kick those they reach by ε.

    "leaky" x' = I − x and "xif" (anti-leaky: it accelerates) x' = I + x, both from 0 to 1 and kicked to x + ε;
    "qif" (quadratic) V' = V² + I from −∞ to ∞, in the phase of V = √I tan(φ/2): φ' = 2√I from −π to π, kicked to
    2 arctan(tan(φ/2) + ε/√I).

    A neuron that a pulse lifts to the threshold fires at the same instant: the neurons above it fire one by one, the
    first in number first, each once at most. A neuron that has fired stays at its reset until the avalanche is over;
    what reaches it is lost (Mirollo & Strogatz). Those that fire together go on together: all but one of their
    directions are lost, exponents of −∞. No pulse lifts a "qif" neuron to its threshold at infinity.

    Known, with v = x + γI, γ = −1 ("leaky") or 1 ("xif"): two neurons with γε > 0 fire in turn, every T, with v of the
    waiting one just after the other fired a root of v² − εv = v_reset v_threshold and T = γ ln(v_threshold/v); the
    exponents are 0 and 2γ + ln(v_reset/v_threshold)/T. More leaky neurons with ε < 0, all to all, end in a splay state,
    those with ε > 0 in synchrony. Two "qif" neurons have 0 and 0: V of the waiting one just
    after a spike is V, ε − V, V, …

    Args:
        n: number of neurons, at least 2.
        current: I; above the threshold 1 of "leaky", else positive.
        coupling: ε, what a spike adds: excitation above 0, inhibition below. Or (n, n), zero on the diagonal: [i, j]
            is what a spike of j adds to i. An "xif" neuron that inhibition throws below −I never fires again.
        form: "hybrid", an `lh.Hybrid` with one guard (n,), each spike a jump; or "event_driven", the same in closed
            form, each avalanche one jump.
        model: "leaky", "xif" or "qif".
        topology: whom a spike reaches: "all" others, or on a "ring" the two next to it.

    Returns:
        A `Problem`, with its exact reference where one is known: 0, −0.1851059509884756 at the defaults.

    Source:
        R. E. Mirollo & S. H. Strogatz, Synchronization of pulse-coupled biological oscillators, SIAM J. Appl.
        Math. 50 (1990) 1645, doi:10.1137/0150098; inhibition: C. van Vreeswijk, L. F. Abbott & G. B.
        Ermentrout, J. Comput. Neurosci. 1 (1994) 313, doi:10.1007/BF00961879; splay states: M. Calamai, A. Politi &
        A. Torcini, Phys. Rev. E 80 (2009) 036209, doi:10.1103/PhysRevE.80.036209; "xif": P. Manz, S. Goedeke &
        R.-M. Memmesheimer, Phys. Rev. E 100 (2019) 042404, doi:10.1103/PhysRevE.100.042404; "qif": M. Monteforte &
        F. Wolf, Phys. Rev. Lett. 105 (2010) 268104, doi:10.1103/PhysRevLett.105.268104.

    Example:
        >>> from lyaphybrid import zoo
        >>> print(zoo.integrate_and_fire(form="event_driven").reference)
        0, -0.185105951 per unit time (the antiphase orbit)
        >>> print(zoo.integrate_and_fire(n=3, coupling=0.1).reference)
        0, -inf, -inf per unit time (synchrony)
    """
    require("n", n, lambda v: v >= 2, "at least 2")
    one_of("model", model, tuple(NEURONS))
    one_of("form", form, ("hybrid", "event_driven"))
    one_of("topology", topology, ("all", "ring"))
    if model == "leaky":
        require("current", current, lambda v: v > 1, "above the threshold 1")
    positive(current=current)
    strengths, kind = _strengths(coupling, topology, n)
    neuron = NEURONS[model]
    x0 = state(*(neuron.reset + (neuron.threshold - neuron.reset) * p for p in _potentials(n)))
    return Problem(
        system=_network(model, kind, form, n),
        x0=x0,
        args={"current": current, "coupling": strengths},
        t1=1000.0,
        transient=100.0,
        options={"every": 1} if form == "event_driven" and _loses(model, coupling) else {},
        reference=None if traced(current, coupling) else _reference(model, current, coupling, topology, n),
        source="R. E. Mirollo & S. H. Strogatz, SIAM J. Appl. Math. 50 (1990) 1645, doi:10.1137/0150098",
    )


# The adaptive exponential neuron.


def _adapting(t, x, args):
    v, w = x[0], x[1]
    away = v - args["rest"]
    upstroke = args["slope"] * jnp.exp((v - args["threshold"]) / args["slope"])
    charge = args["conductance"] * (upstroke - away) - w + args["current"]
    return jnp.stack([charge / args["capacitance"], (args["a"] * away - w) / args["adaptation_time"]])


ADEX = Hybrid(
    _adapting,
    Transition(
        lambda t, x, args: args["peak"] - x[0],
        lambda t, x, args: jnp.stack([args["reset"], x[1] + args["b"]]),
    ),
    names=("V", "w"),
    units=("mV", "pA"),
)


@problem
def adex(
    *,
    current: Real = 175.0,
    peak: Real = 20.0,
    reset: Real = -48.0,
    a: Real = -11.0,
    b: Real = 30.0,
    adaptation_time: Real = 130.0,
    capacitance: Real = 100.0,
    conductance: Real = 12.0,
    rest: Real = -60.0,
    threshold: Real = -50.0,
    slope: Real = 2.0,
) -> Problem:
    """The adaptive exponential neuron (AdEx): a spike runs away, is cut off, and leaves the neuron tired.

    C V' = −g(V − E) + gΔ exp((V − V_T)/Δ) − w + I, τ w' = a(V − E) − w; at V_peak V falls to V_r, and w grows by b. In
    pF, mV, ms, nS and pA; exponents per ms.

    The field is e^((V_peak − V_T)/Δ) times as fast before the reset as after it: 1e15 by default. Still the
    reset is not singular, and the cut-off V_peak does not matter: one exponent is 0, the other one that of the map from
    w after a spike to w after the next. Irregular spiking of Naud et al.

    Args:
        current: I.
        peak: V_peak, where a spike is cut off; above V_T.
        reset: V_r; below V_peak.
        a: coupling of the adaptation to the voltage.
        b: adaptation by a spike.
        adaptation_time: τ.
        capacitance: C.
        conductance: g of the leak.
        rest: E of the leak.
        threshold: V_T, at which spikes begin.
        slope: Δ, over which they do.

    Returns:
        A `Problem`; at the default parameters, whatever the peak from −20 mV on, with the reference 0.01600(2), 0.

    Source:
        R. Brette & W. Gerstner, Adaptive exponential integrate-and-fire model as an effective description of
        neuronal activity, J. Neurophysiol. 94 (2005) 3637, doi:10.1152/jn.00686.2005; the parameters: R. Naud, N.
        Marcille, C. Clopath & W. Gerstner, Biol. Cybern. 99 (2008) 335, doi:10.1007/s00422-008-0264-7; its chaos: J.
        Touboul & R. Brette, Biol. Cybern. 99 (2008) 319, doi:10.1007/s00422-008-0267-4.

    Example:
        >>> from lyaphybrid import zoo
        >>> print(zoo.adex(peak=0).reference)
        0.016000(20), 0 per unit time (the map from spike to spike)
    """
    positive(adaptation_time=adaptation_time, capacitance=capacitance, conductance=conductance, slope=slope)
    args = {
        "current": current,
        "peak": peak,
        "reset": reset,
        "a": a,
        "b": b,
        "adaptation_time": adaptation_time,
        "capacitance": capacitance,
        "conductance": conductance,
        "rest": rest,
        "threshold": threshold,
        "slope": slope,
    }
    if not traced(peak, reset, threshold):
        require("peak", peak, lambda v: v > max(reset, threshold), "above reset and threshold")
    others = tuple(value for name, value in args.items() if name != "peak")
    known = near(others, 175, -48, -11, 30, 130, 100, 12, -60, -50, 2) and not traced(peak) and peak >= -20
    return Problem(
        system=ADEX,
        x0=state(reset, 90.0),
        args=args,
        t1=50_000.0,
        transient=1000.0,
        reference=computed((0.016, 0.0), (2e-5, 0.0), source="the map from spike to spike") if known else None,
        source="R. Brette & W. Gerstner, J. Neurophysiol. 94 (2005) 3637, doi:10.1152/jn.00686.2005",
    )
