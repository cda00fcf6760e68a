"""Transverse exponents and the master stability function, against closed forms and whole networks."""

import jax.numpy as jnp
import numpy as np
from scipy.optimize import brentq

import lyaphybrid as lh
from benchmarks.capabilities.rows import Row, Stopwatch, apart
from benchmarks.peers.tables import duration

TITLE = "Synchronisation through jumps"
STEP = lh.RungeKutta("rk4", dt=0.01)
RING = np.roll(np.eye(4), 1, axis=0) + np.roll(np.eye(4), -1, axis=0) - 2 * np.eye(4)
ALTERNATING, FASTEST = np.array([[1.0], [-1.0], [1.0], [-1.0]]), -4.0  # an eigenvector of the ring and its eigenvalue
MANY, TURN = 1000, 2 * np.pi  # nodes
EVERY, GROWTH = 0.5, 0.2  # of the sampled loop


def logistic(n, x, r):
    return r * x * (1 - x)


def oscillate(t, x, args):
    return jnp.stack([x[1], jnp.cos(args["omega"] * t) - x[0] - 0.1 * x[1]])


IMPACTING = lh.Hybrid(
    oscillate, lh.Transition(lambda t, x, args: -x[0], lambda t, x, args: jnp.stack([x[0], -0.8 * x[1]]))
)


def adapts(t, x, args):
    """A leaky neuron with an adaptation current and a filtered copy of it, x = (v, w, u)."""
    return jnp.stack([args - x[0] - x[1], -0.3 * x[1], 0.5 * (x[1] - x[2])])


NEURON = lh.Hybrid(
    adapts, lh.Transition(lambda t, x, args: 1.0 - x[0], lambda t, x, args: jnp.stack([0 * x[0], x[1] + 0.3, x[2]]))
)
# x' = GROWTH x + u with u held between ticks, when it becomes −x and what comes from the others.
SAMPLED = lh.Hybrid(
    lambda t, x, args: jnp.stack([GROWTH * x[0] + x[1], 0 * x[1]]),
    lh.Transition(every=EVERY, reset=lambda t, x, args: jnp.stack([x[0], args["u"] - x[0]])),
)


def heard(args, c):
    return {"u": args["u"] + c[0]}


def position(t, x, args):
    return x[:1]


def spring(t, x, args):
    return jnp.stack([0 * x[0], x[0]])


def filtered(t, x, args):
    return jnp.stack([x[2], 0 * x[1], 0 * x[2]])


def over_a_tick(alpha: float) -> float:
    """The multiplier of the sampled loop over a tick: its other one is 0."""
    grown = np.exp(GROWTH * EVERY)
    return grown + (alpha - 1) * (grown - 1) / GROWTH


def maps_of_one_multiplier(clock: Stopwatch) -> Row:
    alphas, how = np.array([-1.7, -0.3, 0.5]), {"t1": 500, "blocks": 4}
    found = clock(lambda: lh.master_stability(lh.Map(logistic), logistic, [0.3], 3.9, at=alphas, **how))
    alone = lh.lyapunov_spectrum(lh.Map(logistic), [0.3], 3.9, **how)
    exact = alone.exponents + np.log(np.abs(1 + alphas))
    truth = "closed form, λ + ln|1 + α| with the λ of one map"
    return Row("logistic maps coupled through themselves", truth, apart(found.largest, exact), 1e-11)


def driven_lorenz(clock: Stopwatch) -> Row:
    lorenz = lh.zoo.lorenz63()
    how = {"response": [0, 2], "t1": 50.0, "transient": 10.0}
    found = clock(lambda: lh.transverse_spectrum(lorenz.system, lorenz.x0, lorenz.args, **how))
    return Row("Lorenz' x and z driven by y", "closed form, −β and −σ", apart(found.exponents, [-8 / 3, -10.0]), 1e-6)


def sampled_loops(clock: Stopwatch) -> Row:
    alphas = np.array([-3.5, -0.4, 0.3])
    how = {"at": alphas, "enters": heard, "t1": 200.0, "transient": 100.25}
    found = clock(lambda: lh.master_stability(SAMPLED, position, [0.0, 0.0], {"u": 0.0}, **how))
    exact = np.log(np.abs(over_a_tick(alphas))) / EVERY
    truth = "closed form, the multiplier of a tick"
    return Row("loops coupled through the resets of a clock", truth, apart(found.largest, exact), 1e-9)


def critical(clock, node, coupling, x0, args, bracket, *, enters=None, **how) -> tuple[float, float]:
    """The strength at which the fastest mode of a ring of four becomes stable: by one node, by the whole ring."""
    n, how = len(x0), {"blocks": 4, "every": 1, "method": STEP} | how

    def of_nodes(strengths):
        at = FASTEST * strengths
        found = lh.master_stability(node, coupling, x0, args, at=at, k=n, enters=enters, **how)
        return np.max(np.asarray(found.exponents), axis=1)

    def by_nodes():
        strengths = np.linspace(*bracket, 21)
        signs = np.sign(of_nodes(strengths))
        first = np.flatnonzero(signs[:-1] != signs[1:])[0]
        return brentq(lambda s: of_nodes(np.array([s]))[0], *strengths[first : first + 2], xtol=1e-10)

    network = lh.coupled_network(node, coupling, RING, enters=enters)
    frame, start = np.kron(ALTERNATING, np.eye(n)), np.tile(x0, len(RING))

    def by_ring(strength):
        return float(np.max(lh.lyapunov_spectrum(network, start, (args, strength), frame=frame, **how).exponents))

    found = clock(by_nodes)
    return found, brentq(by_ring, found - 2e-3, found + 2e-3, xtol=1e-10)


WHOLE = "spectrum of the whole network of four"


def critical_impacts(clock: Stopwatch) -> Row:
    found, exact = critical(clock, IMPACTING, spring, [-1.0, 0.3], {"omega": 4.0}, (-0.1, 0.9), t1=20.0)
    return Row("critical coupling of impact oscillators", WHOLE, apart(found, exact), 1e-6)


def critical_neurons(clock: Stopwatch) -> Row:
    found, exact = critical(clock, NEURON, filtered, [0.2, 0.1, 0.05], 1.6, (-1.3, -0.9), t1=8.0)
    return Row("critical coupling of adapting neurons", WHOLE, apart(found, exact), 1e-6)


def critical_loops(clock: Stopwatch) -> Row:
    how = {"enters": heard, "t1": 20.0, "transient": 10.25}
    found, exact = critical(clock, SAMPLED, position, [1.0, 0.0], {"u": 0.0}, (0.5, 1.0), **how)
    closed = brentq(lambda s: over_a_tick(FASTEST * s) + 1, 0.5, 1.0, xtol=1e-14)
    error = max(apart(found, exact), apart(found, closed))
    return Row("critical coupling of sampled loops", f"{WHOLE}, and closed form", error, 1e-6)


def a_thousand_nodes(clock: Stopwatch) -> Row:
    """The slowest mode of a ring; its second exponent is −∞, for a tick forgets u."""
    ring = np.roll(np.eye(MANY), 1, axis=0) + np.roll(np.eye(MANY), -1, axis=0) - 2 * np.eye(MANY)
    vector, gamma = np.cos(TURN / MANY * np.arange(MANY))[:, None], -2 + 2 * np.cos(TURN / MANY)
    x0, args, strength = [1.0, 0.0], {"u": 0.0}, 0.15
    how = {"t1": 2.3, "blocks": 4, "every": 1, "method": STEP}
    at = gamma * strength
    found = clock(lambda: lh.master_stability(SAMPLED, position, x0, args, at=at, k=2, enters=heard, **how))
    network, frame = lh.coupled_network(SAMPLED, position, ring, enters=heard), np.kron(vector, np.eye(2))

    def whole():
        return lh.lyapunov_spectrum(network, np.tile(x0, MANY), (args, strength), frame=frame, **how)

    def alone():
        return lh.lyapunov_spectrum(SAMPLED, x0, args, **how)

    all_of_them, one = Stopwatch(), Stopwatch()
    exact = np.max(np.asarray(all_of_them(whole).exponents))
    one(alone)
    costs = clock.second, one.second, all_of_them.second
    remark = "second calls {}, of one node alone {}, of the whole network {}".format(*map(duration, costs))
    error = apart(found.largest, exact)
    return Row(f"a mode of a ring of {MANY} sampled loops", "spectrum of the whole network", error, 1e-9, remark=remark)


ROWS = (
    maps_of_one_multiplier,
    driven_lorenz,
    sampled_loops,
    critical_impacts,
    critical_neurons,
    critical_loops,
    a_thousand_nodes,
)
