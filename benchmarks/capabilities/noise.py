"""Frozen noise: random maps, kicks and inputs, and white noise along a path, against closed forms and exact maps."""

import math

import jax
import jax.numpy as jnp
import numpy as np
from scipy.integrate import quad
from scipy.special import digamma
from scipy.stats import norm

import lyaphybrid as lh
from benchmarks.capabilities.rows import Row, Stopwatch, apart, errors_away

TITLE = "Frozen noise and random hybrid systems"
RATE, EVERY, SEED = 0.7, 0.25, {"seed": 1}
PATHS = 24  # over which the strong error is a mean


def random(args, count, **kind):
    return lh.frozen_noise(args["seed"], count, **kind)


def found_of(clock: Stopwatch, system, x0, **how) -> lh.Spectrum:
    return clock(lambda: lh.lyapunov_spectrum(system, x0, SEED, **how))


def in_errors(clock: Stopwatch, name: str, truth: str, exact, system, x0, **how) -> Row:
    found = found_of(clock, system, x0, **how)
    error = errors_away(found.exponents, exact, found.stderr)
    return Row(name, truth, error, 3.0, "se", f"one se is {float(np.max(found.stderr)):.1g}")


def lognormal(clock: Stopwatch) -> Row:
    system = lh.Map(lambda n, x, args: x * jnp.exp(0.3 + 0.8 * random(args, n)))
    return in_errors(clock, "lognormal factors", "closed form, 0.3", 0.3, system, [0.0], t1=40_000)


def matrices(clock: Stopwatch) -> Row:
    system = lh.Map(lambda n, x, args: lh.frozen_noise(args["seed"], n, (3, 3)) @ x)
    exact = [0.5 * (np.log(2) + digamma(m / 2)) for m in (3, 2, 1)]
    truth, how = "closed form, (ln 2 + ψ(m/2))/2", {"t1": 40_000, "transient": 100}
    return in_errors(clock, "products of Gaussian matrices", truth, exact, system, [0.0, 0.0, 0.0], **how)


def additive(clock: Stopwatch) -> Row:
    found = found_of(clock, lh.Map(lambda n, x, args: 0.6 * x + random(args, n)), [0.0], t1=1000)
    return Row("a linear map with noise added", "closed form, ln 0.6", apart(found.exponents, np.log(0.6)), 1e-9)


def kicks(clock: Stopwatch) -> Row:
    reset = lambda t, x, args: x * (1 + 0.5 * random(args, t / EVERY))  # noqa: E731
    system = lh.Hybrid(lambda t, x, args: -RATE * x, lh.Transition(every=EVERY, reset=reset))
    mean = quad(lambda z: np.log(abs(1 + 0.5 * z)) * norm.pdf(z), -12, 12, points=[-2.0], limit=400)[0]
    truth = "closed form, a Gaussian mean of ln|1 + z/2|"
    return in_errors(clock, "random kicks of a flow", truth, -RATE + mean / EVERY, system, [1.0], t1=5000.0)


def held(clock: Stopwatch) -> Row:
    """x' = u x with u set anew by a clock."""
    reset = lambda t, x, args: jnp.stack([x[0], 0.5 - random(args, t / EVERY, kind="exponential")])  # noqa: E731
    field = lambda t, x, args: jnp.stack([x[1] * x[0], 0 * x[1]])  # noqa: E731
    system, how = lh.Hybrid(field, lh.Transition(every=EVERY, reset=reset)), {"frame": [[1.0], [0.0]], "t1": 5000.0}
    return in_errors(clock, "a random rate, held between ticks", "closed form, −1/2", -0.5, system, [1.0, 0.0], **how)


def tents(clock: Stopwatch) -> Row:
    def bent(n, x, args):
        peak = random(args, n, kind="uniform")
        return jnp.where(x < peak, x / peak, (1 - x) / (1 - peak))

    truth = "closed form, 1/2, a mean entropy"
    return in_errors(clock, "tents with random peaks", truth, 0.5, lh.Map(bent), [0.3], t1=40_000)


def spike_by_spike(currents, v: float) -> float:
    """The exponent of v' = I − v with spikes at 1, I held over each of these lengths: growth by I/(I − 1) a spike."""
    growth = 0.0
    for current in currents:
        left = EVERY
        while current > 1 and (wait := math.log((current - v) / (current - 1))) < left:
            growth, v, left = growth + math.log(current / (current - 1)), 0.0, left - wait
        v = current + (v - current) * math.exp(-left)
    return growth / (len(currents) * EVERY) - 1


def reliable_neuron(clock: Stopwatch) -> Row:
    new_current = lambda t, x, args: jnp.stack([x[0], 1.2 + 0.8 * random(args, t / EVERY)])  # noqa: E731
    spikes = lh.Transition(lambda t, x, args: 1.0 - x[0], lambda t, x, args: jnp.stack([0 * x[0], x[1]]))
    neuron = lh.Hybrid(
        lambda t, x, args: jnp.stack([x[1] - x[0], 0 * x[1]]), [spikes, lh.Transition(every=EVERY, reset=new_current)]
    )
    found = found_of(clock, neuron, [0.2, 1.2], t1=2000.0, frame=[[1.0], [0.0]])
    counts = jnp.arange(1.0, 2000.0 / EVERY)
    currents = [1.2, *np.asarray(1.2 + 0.8 * jax.vmap(lambda n: random(SEED, n))(counts))]
    error, rate = apart(found.exponents, spike_by_spike(currents, 0.2)), float(found.exponents[0])
    truth = "exact map from spike to spike, along the same noise"
    return Row("reliability of a neuron with a random current", truth, error, 1e-8, remark=f"λ = {rate:.4f}")


def end(system, x0, args, t1: float) -> np.ndarray:
    return np.asarray(lh.tangent_map(system, x0, args, t1=t1).x)


def geometric_motion(clock: Stopwatch) -> Row:
    """dx = a x dt + b x ∘ dW: the exponent of a path is a + b W(t)/t."""
    path = {"step": 1 / 64, "until": 64.0, "seed": 5}
    walked = lh.white_noise(lh.Flow(lambda t, x, p: 0 * x), lambda t, x, p: 1 + 0 * x, **path)
    system = lh.white_noise(lh.Flow(lambda t, x, p: p[0] * x), lambda t, x, p: p[1] * x, **path)
    found = clock(lambda: lh.lyapunov_spectrum(system, [1.0], (-0.2, 0.3), t1=64.0))
    exact = -0.2 + 0.3 * end(walked, [0.0], None, 64.0)[0] / 64.0
    truth = "closed form, a + b W(t)/t of this very path"
    return Row("geometric Brownian motion", truth, apart(found.exponents, exact), 1e-6)


def pitchfork(clock: Stopwatch) -> Row:
    """dx = (x − x³) dt + σ x ∘ dW: ⟨x²⟩ = 1."""
    flow = lh.Flow(lambda t, x, s: x - x**3)
    system = lh.white_noise(flow, lambda t, x, s: s * x, step=0.02, until=1000.0, seed=2)
    found = clock(lambda: lh.lyapunov_spectrum(system, [1.0], 0.8, t1=900.0, transient=20.0))
    error = errors_away(found.exponents, -2.0, found.stderr)
    return Row("a pitchfork with multiplicative white noise", "closed form, −2 (Arnold 1998)", error, 3.0, "se")


def strong_order(clock: Stopwatch) -> Row:
    """Ends of paths against those of much finer steps."""
    flow = lh.Flow(lambda t, x, p: jnp.sin(2 * x) - x)

    def ends(step):
        noisy = lh.white_noise(flow, lambda t, x, p: 0.5 * jnp.cos(x), step=step, until=4.0, seed=lambda p: p["seed"])
        return np.array([end(noisy, [0.4], {"seed": jnp.asarray(seed)}, 4.0)[0] for seed in range(PATHS)])

    coarse, fine = clock(lambda: [ends(2.0**-5), ends(2.0**-8)])
    exact = ends(2.0**-12)
    order = np.log2(np.mean(np.abs(coarse - exact)) / np.mean(np.abs(fine - exact))) / 3
    remark = f"{order:.2f}, from steps of 1/32 and 1/256"
    return Row("strong order of white noise", "1, against steps of 1/4096", abs(order - 1), 0.15, remark=remark)


ROWS = (
    lognormal,
    matrices,
    additive,
    kicks,
    held,
    tents,
    reliable_neuron,
    geometric_motion,
    pitchfork,
    strong_order,
)
