"""Large sparse networks of integrate-and-fire neurons: a spike costs what its synapses cost, whatever their number."""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...systems.event_driven import EventDriven, Schedule
from ...systems.event_queue import EventQueue
from ..problem import Problem, Real, one_of, positive, problem, require, traced
from .neurons import NEURONS, Neuron

__all__ = ["sparse_network"]


def random_targets(n: int, synapses: int, seed: int) -> np.ndarray:
    """(n, synapses) whom each neuron reaches: different others, drawn at random."""
    draw = np.random.default_rng(seed)
    rows = np.sort(draw.integers(0, n - 1, (n, synapses)), axis=1)
    while np.any(again := np.any(rows[:, 1:] == rows[:, :-1], axis=1)):
        if 4 * synapses > n:  # too many would have to be drawn again
            rows = np.stack([draw.choice(n - 1, synapses, replace=False) for _ in range(n)])
            break
        rows[again] = np.sort(draw.integers(0, n - 1, (int(np.sum(again)), synapses)), axis=1)
    return (rows + (rows >= np.arange(n)[:, None])).astype(np.int32)


def _scheduled(neuron: Neuron, targets: np.ndarray) -> EventDriven:
    """The network in comoving coordinates: y is where a neuron would have been at the last rebasing."""

    def reached(targets, which):
        return jnp.concatenate([which[None], targets[which]])

    def next_spikes(t, y, args):
        return t + neuron.wait(neuron.flow(t, y, args["current"]), args["current"])

    def predicted(t, y, args):
        return EventQueue(next_spikes(t, y, args))

    def spiked(targets, queue, t, y, args, which):
        bodies = reached(targets, which)
        return queue.replaced(bodies, next_spikes(t, y[bodies], args))

    def jump(t, rows, args, which):
        strength, current = jnp.broadcast_to(args["coupling"], targets.shape[:1])[which], args["current"]
        kicked = neuron.pulse(neuron.flow(t, rows[1:], current), strength, current)
        after = jnp.concatenate([jnp.full(1, neuron.reset, rows.dtype), kicked])
        return neuron.flow(-t, after, current)

    graph = jnp.asarray(targets)
    schedule = Schedule(
        init=predicted,
        next=EventQueue.first,
        update=jax.tree_util.Partial(spiked, graph),
        shift=EventQueue.earlier,
        touch=jax.tree_util.Partial(reached, graph),
        flat=True,
    )
    return EventDriven(
        flow=lambda dt, y, args: neuron.flow(dt, y, args["current"]),
        next_event=None,
        jump=jump,
        guard=lambda t, rows, args, which: neuron.threshold - neuron.flow(t, rows[0], args["current"]),
        schedule=schedule,
        invertible=True,
    )


@functools.lru_cache(maxsize=8)
def _network(model: str, n: int, synapses: int, seed: int) -> EventDriven:
    """The same object for the same structure, so that compiled code is reused."""
    return _scheduled(NEURONS[model], random_targets(n, synapses, seed))


@problem
def sparse_network(
    *,
    n: int = 1000,
    synapses: int = 50,
    current: Real = 1.0,
    coupling: Real | Float[Array, " n"] | None = None,
    model: str = "qif",
    seed: int = 0,
) -> Problem:
    """Many neurons, each of which reaches a few others, drawn at random: networks of up to some hundred thousand.

    The models are those of `integrate_and_fire`: "qif" V' = V² + I, in the phase φ of V = √I tan(φ/2), and "leaky"
    V' = I − V; time in units of the membrane's time constant. A spike adds ε to each neuron that it reaches. With
    ε = −J/√K for K synapses and a current I of the order √K the network is in the balanced state: it fires irregularly,
    at rates near I/(√K J). There "qif" networks are chaotic, with λ₁ that does not depend on n; "leaky" ones with
    inhibition alone are stable, though as irregular.

    The ten leading exponents are computed unless k says otherwise. What a spike costs grows with the logarithm of n
    alone, as long as the state and its perturbations lie in the caches of the processor.

    Args:
        n: number of neurons, at least 3.
        synapses: K, how many others each neuron reaches, from 1 to n − 1. How many reach it scatters like K ± √K.
        current: I; above the threshold 1 of "leaky", else positive.
        coupling: ε, what a spike adds: of all neurons, or (n,) that of each; "leaky" ones must be inhibited, for one
            that is lifted over the threshold would have to fire at once. None: −1/√K.
        model: "qif" or "leaky".
        seed: of the graph and of the start.

    Returns:
        A `Problem`, without a reference.

    Source:
        M. Monteforte & F. Wolf, Dynamical entropy production in spiking neuron networks in the balanced state, Phys.
        Rev. Lett. 105 (2010) 268104, doi:10.1103/PhysRevLett.105.268104; "leaky": S. Jahnke, R.-M. Memmesheimer &
        M. Timme, Phys. Rev. Lett. 100 (2008) 048102, doi:10.1103/PhysRevLett.100.048102.

    Example:
        >>> from lyaphybrid import zoo
        >>> network = zoo.sparse_network(n=200, synapses=20)
        >>> bool(network.spectrum(t1=50.0, transient=10.0, k=2).exponents[0] > 0)
        True
    """
    require("n", n, lambda v: v >= 3, "at least 3")
    require("synapses", synapses, lambda v: 1 <= v <= n - 1, f"from 1 to n - 1 = {n - 1}")
    one_of("model", model, ("qif", "leaky"))
    if model == "leaky":
        require("current", current, lambda v: v > 1, "above the threshold 1")
    positive(current=current)
    strength = -1 / math.sqrt(synapses) if coupling is None else coupling
    if np.ndim(strength) and np.shape(strength) != (n,):
        raise ValueError(f"coupling must be a number or have the shape (n,) = ({n},); got {np.shape(strength)}.")
    if not traced(strength):
        require("coupling", strength, lambda v: bool(np.all(np.isfinite(v))), "finite")
        if model == "leaky":
            require("coupling", strength, lambda v: bool(np.all(np.asarray(v) <= 0)), 'at most 0 where model="leaky"')
    neuron = NEURONS[model]
    phases = np.random.default_rng((seed, n)).uniform(size=n)
    return Problem(
        system=_network(model, n, synapses, seed),
        x0=jnp.asarray(neuron.reset + (neuron.threshold - neuron.reset) * phases),
        args={"current": current, "coupling": strength},
        t1=200.0,
        transient=50.0,
        options={"k": min(10, n)},
        source="M. Monteforte & F. Wolf, Phys. Rev. Lett. 105 (2010) 268104, doi:10.1103/PhysRevLett.105.268104",
    )
