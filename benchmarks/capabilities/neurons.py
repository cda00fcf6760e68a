"""Large networks of neurons, against networks that fire spike by spike in NumPy, and closed forms."""

import math

import numpy as np

import lyaphybrid as lh
from benchmarks.capabilities.rows import Row, Stopwatch, apart, timed
from benchmarks.peers.tables import duration

TITLE = "Networks of spiking neurons"
LARGE, SYNAPSES, LEADING = 100_000, 50, 10
CURRENT = 8.0  # of leaky neurons
SPIKES, MANY_SPIKES = 2000, (50_000, 300_000)  # compared, and timed
CHAOTIC, FEWER = 100, 1000  # quadratic neurons with all their exponents, and spikes, for chaos multiplies rounding
BETWEEN = 20  # spikes between two orthonormalisations


def targets_of(n: int, synapses: int, seed: int) -> np.ndarray:
    """(n, synapses) whom each neuron reaches, as the graph is drawn for `lh.zoo.sparse_network`."""
    from lyaphybrid.zoo.switched.sparse_networks import random_targets

    return random_targets(n, synapses, seed)


def columns(n: int, k: int) -> np.ndarray:
    """Orthonormal directions."""
    return np.linalg.qr(np.random.default_rng(1).normal(size=(n, k)))[0]


def grown(rows: np.ndarray, growth: np.ndarray) -> np.ndarray:
    """The columns orthonormalised, and what they had grown by added."""
    rows, upper = np.linalg.qr(rows)
    growth += np.log(np.abs(np.diagonal(upper)))
    return rows


def leaky_by_hand(x, targets, strength: float, spikes: int, frame) -> tuple[np.ndarray, np.ndarray]:
    """v' = I − v: the state and the exponents per spike just after so many spikes.

    With y = (v − I) eᵗ all stand still between spikes, and the one with the largest y fires next. A spike at δv of the
    neuron that fires moves others by −ε δv/(I − 1), and itself by the factor I/(I − 1).
    """
    y, rows, t, growth = np.asarray(x) - CURRENT, np.array(frame), 0.0, np.zeros(frame.shape[1])
    for spike in range(1, spikes + 1):
        one = int(np.argmax(y))
        t = math.log(-y[one] / (CURRENT - 1))
        y[one] = -CURRENT * math.exp(t)
        y[targets[one]] += strength * math.exp(t)
        rows[targets[one]] -= strength / (CURRENT - 1) * rows[one]
        rows[one] *= CURRENT / (CURRENT - 1)
        if spike % 500 == 0 or spike == spikes:
            rows = grown(rows, growth)
    return CURRENT + y * math.exp(-t), np.sort((growth - t) / spikes)[::-1]


def quadratic_by_hand(x, targets, strength: float, current: float, spikes: int, frame) -> np.ndarray:
    """V' = V² + I in the phase φ of V = √I tan(φ/2), which turns at one rate: exponents per spike."""
    phases, rows, growth = np.array(x), np.array(frame), np.zeros(frame.shape[1])
    kick = strength / math.sqrt(current)
    for spike in range(1, spikes + 1):
        one = int(np.argmax(phases))
        phases += math.pi - phases[one]
        phases[one] = -math.pi
        reached = targets[one]
        tangent = np.tan(phases[reached] / 2)
        slope = ((1 + tangent**2) / (1 + (tangent + kick) ** 2))[:, None]
        phases[reached] = 2 * np.arctan(tangent + kick)
        rows[reached] = slope * rows[reached] + (1 - slope) * rows[one]
        if spike % BETWEEN == 0 or spike == spikes:
            rows = grown(rows, growth)
    return np.sort(growth / spikes)[::-1]


def kaplan_yorke(exponents: np.ndarray) -> float:
    sums = np.cumsum(exponents)
    j = int(np.sum(sums >= 0))
    return j + sums[j - 1] / abs(exponents[j])


def large_network(clock: Stopwatch) -> Row:
    problem = lh.zoo.sparse_network(n=LARGE, synapses=SYNAPSES, model="leaky", current=CURRENT)
    frame = columns(LARGE, LEADING)
    how = {"frame": frame, "clock": "jumps", "transient": 0.0, "blocks": 2}

    def run(spikes):
        return lh.lyapunov_spectrum(problem.system, problem.x0, problem.args, t1=spikes, **how)

    found = clock(lambda: run(SPIKES))
    x, exact = leaky_by_hand(problem.x0, targets_of(LARGE, SYNAPSES, 0), problem.args["coupling"], SPIKES, frame)
    short, long = MANY_SPIKES
    run(long)  # what runs for long is optimised meanwhile
    seconds = timed(lambda: run(long))[0] - timed(lambda: run(short))[0]
    cost = duration(seconds / (long - short))
    error = max(apart(found.x, x), apart(found.exponents, exact))
    name = f"{LARGE} leaky neurons, {SYNAPSES} synapses each, {LEADING} exponents and the state"
    return Row(name, "exact map from spike to spike", error, 1e-9, remark=f"a spike costs {cost}")


def dimension(clock: Stopwatch) -> Row:
    problem = lh.zoo.sparse_network(n=CHAOTIC, synapses=20)
    frame = columns(CHAOTIC, CHAOTIC)
    how = {"frame": frame, "clock": "jumps", "transient": 0.0, "t1": FEWER}
    found = clock(lambda: lh.lyapunov_spectrum(problem.system, problem.x0, problem.args, **how))
    current, strength = problem.args["current"], problem.args["coupling"]
    exact = quadratic_by_hand(problem.x0, targets_of(CHAOTIC, 20, 0), strength, current, FEWER, frame)
    ours, theirs = float(found.kaplan_yorke_dimension()) / CHAOTIC, kaplan_yorke(exact) / CHAOTIC
    error, remark = max(apart(found.exponents, exact), abs(ours - theirs)), f"{ours:.6f} per neuron"
    name = f"Kaplan–Yorke dimension of {CHAOTIC} quadratic neurons, all exponents"
    return Row(name, "exact map from spike to spike", error, 1e-7, remark=remark)


def pair(clock: Stopwatch) -> Row:
    """With the threshold 1 − I and the reset −I of v − I, of two that fire in turn."""
    current, coupling = 1.7, -0.3
    problem = lh.zoo.integrate_and_fire(model="leaky", coupling=coupling, current=current, form="event_driven")
    found = clock(lambda: problem.spectrum(clock="jumps", transient=1000, t1=1000))
    threshold, reset = 1 - current, -current
    waiting = (coupling - math.sqrt(coupling**2 + 4 * threshold * reset)) / 2
    exact = [0.0, -2 - math.log(reset / threshold) / math.log(threshold / waiting)]
    per_time = np.asarray(found.exponents * found.jumps / found.time)
    return Row("two inhibited leaky neurons", "closed form, a quadratic equation", apart(per_time, exact), 1e-10)


def splay(clock: Stopwatch) -> Row:
    """Five that fire in turn: the eigenvalues of the map from spike to spike, of those that wait."""
    n, current, coupling = 5, 2.0, -0.1
    threshold, reset = 1 - current, -current
    steps = np.polynomial.Polynomial([-threshold, *[coupling] * (n - 1), reset])
    (decay,) = (root.real for root in steps.roots() if abs(root.imag) < 1e-9 and 0 < root.real < 1)
    waiting = [reset]
    for _ in range(n - 1):
        waiting.insert(0, decay * waiting[0] + coupling)
    matrix = decay * np.eye(n - 1, k=1)
    matrix[:, 0] -= decay * np.array(waiting[1:]) / waiting[0]
    multipliers = np.sort(np.abs(np.append(np.linalg.eigvals(np.linalg.matrix_power(matrix, n)), 1.0)))
    problem = lh.zoo.integrate_and_fire(n=n, current=current, coupling=coupling, form="event_driven")
    long = lh.trajectory(problem.system, problem.x0, problem.args, t1=500.0, n=2)
    period = -n * math.log(decay)
    found = clock(lambda: lh.tangent_map(problem.system, long.x[-1], problem.args, t1=period))
    sizes = np.sort(np.abs(np.linalg.eigvals(np.asarray(found.matrix))))
    error = max(apart(sizes, multipliers), apart(found.x, long.x[-1]))
    return Row("five leaky neurons that fire in turn", "closed form, a polynomial equation", error, 1e-9)


ROWS = (large_network, dimension, pair, splay)
