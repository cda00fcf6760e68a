"""Circuits and neurons: oscillators with diodes and tubes, forced relaxation oscillators, models of nerve cells."""

import jax
import jax.numpy as jnp
import numpy as np

from ..spectra import Known
from ..table import published

KINKS = "piecewise linear: the field is continuous, its derivative is not"
SLOPES = (-0.14285714, 0.28571429, -0.57142857, 0.28571429, -0.57142857, 0.28571429)  # of the multi-scroll diode
BREAKS = (1.0, 2.15, 3.6, 8.2, 13.0)  # where its slope changes
BEER_WEIGHTS = np.array([[5.422, -0.018, 2.75], [-0.24, 4.59, 1.21], [0.535, -2.25, 3.885]])
BEER_BIASES, BEER_TIMES = np.array([-4.108, -2.787, -1.114]), np.array([1.0, 2.5, 1.0])
INHIBITION = -np.array(
    [
        [0, 1, 0, 0, 1, 1],
        [0, 0, 0, 1, 1, 1],
        [1, 1, 0, 0, 1, 0],
        [1, 1, 1, 0, 0, 0],
        [1, 1, 0, 1, 0, 0],
        [0, 1, 1, 1, 0, 0],
    ],
    dtype=float,
)


@published(
    start=(-5.118, -0.2758, 2.659),
    turn=2.3,
    source="M. E. Yalçın, J. A. K. Suykens & J. P. L. Vandewalle, Cellular Neural Networks, Multi-Scroll Chaos and "
    "Synchronization, World Scientific (2005)",
    note=KINKS,
)
def multi_chua(x, y, z, *, a=9.0, b=14.286):
    """Chua's circuit with a diode of eleven pieces: several scrolls."""
    kinks = zip(SLOPES[:-1], SLOPES[1:], BREAKS, strict=True)
    bends = sum((m - n) / 2 * (jnp.abs(x + c) - jnp.abs(x - c)) for m, n, c in kinks)
    return a * (y - SLOPES[-1] * x - bends), x - y + z, -b * y


@published(
    start=(10.56, -0.2872, 9.878),
    turn=6.0,
    source="M. P. Kennedy, Chaos in the Colpitts oscillator, IEEE Trans. Circuits Syst. I 41 (1994) 771, "
    "doi:10.1109/81.331536; form and parameters as in the dysts collection",
    note=KINKS,
)
def colpitts(x, y, z, *, a=30.0, b=0.8, c=20.0, d=0.08, e=10.0):
    """The Colpitts oscillator: a transistor that conducts below a threshold."""
    return y - a * jnp.maximum(e - 1 - z, 0.0), c - x - b * y - z, y - d * z


@published(
    start=(-1.83, 0.5205, 0.6443),
    turn=6.8,
    source="V. S. Anishchenko, V. Astakhov, A. Neiman, T. Vadivasova & L. Schimansky-Geier, Nonlinear Dynamics of "
    "Chaotic and Stochastic Systems, 2nd ed., Springer (2007), doi:10.1007/978-3-540-38168-6",
    note="max(x, 0)²: the second derivative jumps",
)
def anishchenko_astakhov(x, y, z, *, mu=1.2, eta=0.5):
    """An oscillator with inertial nonlinearity."""
    return mu * x + y - x * z, -x, eta * (jnp.maximum(x, 0.0) ** 2 - z)


def _saturated(x):
    return (jnp.abs(x + 1) - jnp.abs(x - 1)) / 2


@published(
    start=(1.274, 1.176, -0.5665),
    turn=3.2,
    source="P. Arena, R. Caponetto, L. Fortuna & D. Porto, Bifurcation and chaos in noninteger order cellular neural "
    "networks, Int. J. Bifurcation Chaos 8 (1998) 1527, doi:10.1142/S0218127498001170",
    note=KINKS,
)
def cellular_neural_network(x, y, z, *, a=4.4, b=3.21, c=1.1, d=1.24):
    """Three cells of a cellular neural network."""
    u, v, w = _saturated(x), _saturated(y), _saturated(z)
    return -x + d * u - b * (v + w), -y - b * u + c * v - a * w, -z - b * u + a * v + w


@published(
    start=(1.509, 2.093, 0.9213),
    turn=30.0,
    source="R. D. Beer, On the dynamics of small continuous-time recurrent neural networks, Adapt. Behav. 3 (1995) "
    "469, doi:10.1177/105971239500300405",
    known=Known((0.010,), 5e-4, "Fig. 9D of the source, after LyapunovExponents.jl"),
)
def beer_rnn(*x):
    """Three neurons with graded response and a chaotic choice of weights."""
    x = jnp.stack(x)
    return (BEER_WEIGHTS @ jax.nn.sigmoid(x + BEER_BIASES) - x) / BEER_TIMES


@published(
    start=(0.8726, -1.208, 0.651, -0.565, 0.2598, 1.096),
    turn=10.9,
    source="J. E. Lewis & L. Glass, Nonlinear dynamics and symbolic dynamics of neural networks, Neural Comput. 4 "
    "(1992) 621, doi:10.1162/neco.1992.4.5.621",
)
def hopfield(*x, tau=2.5, steepness=10.0, beta=0.5):
    """Six neurons of a Hopfield network that inhibit one another."""
    x = jnp.stack(x)
    return -x / tau + (1 + jnp.tanh(steepness * (INHIBITION @ x))) / 2 - beta


@published(
    start=(-1.521, 0.1964),
    turn=9.97,
    source="B. van der Pol, A theory of the amplitude of free and forced triode vibrations, Radio Rev. 1 (1920) 701; "
    "parameters as in the dysts collection, but ω = 2π/10, which it rounds to 0.63: there the motion is a cycle",
)
def forced_van_der_pol(t, x, v, *, a=1.2, mu=8.53, omega=0.62832):
    """The van der Pol oscillator under a periodic force."""
    return v, mu * (1 - x**2) * v - x + a * jnp.sin(omega * t)


@published(
    start=(-1.216, -0.04647),
    turn=144.0,
    source="R. FitzHugh, Impulses and physiological states in theoretical models of nerve membrane, Biophys. J. 1 "
    "(1961) 445, doi:10.1016/S0006-3495(61)86902-6; force as in the dysts collection",
)
def forced_fitzhugh_nagumo(
    t, v, w, *, a=0.7, b=0.8, current=0.965, force=0.4008225, gamma=0.08, omega=0.043650793650793655
):
    """A nerve membrane under a slow periodic current."""
    return v - v**3 / 3 - w + current + force * jnp.sin(omega * t), gamma * (v + a - b * w)


@published(
    start=(-0.02181, -0.03754, 0.03337),
    turn=1.8,
    source="M. Marhl & M. Perc, Determining the flexibility of regular and chaotic attractors, Chaos Solitons Fractals "
    "28 (2006) 822; form and parameters as in the dysts collection, which cites no title and the year 2005",
)
def hindmarsh_rose(x, y, z, *, a=0.49, b=1.0, c=0.0322, d=1.0, s=1.0, tx=0.03, tz=0.8):
    """A bursting neuron of the type of Hindmarsh and Rose, in scaled variables."""
    dx = -x + (y - a * x**3 + b * x**2 + z) / tx
    return dx, -a * x**3 - (d - b) * x**2 + z, (-s * x - z + c) / tz


@published(
    start=(-45.77, 0.122, 0.4673),
    turn=1.0,
    source="T. R. Chay, Chaos in a three-variable model of an excitable cell, Physica D 16 (1985) 233, "
    "doi:10.1016/0167-2789(85)90060-0",
)
def excitable_cell(v, n, c, *, gi=1800.0, gkv=1700.0, gkc=11.0, gl=7.0, kc=0.183333, rho=0.27):
    """Chay's model of a bursting cell of the pancreas: voltage (mV), a gate and calcium; time in seconds."""
    alpha_m, beta_m = 0.1 * (25 + v) / (1 - jnp.exp(-0.1 * v - 2.5)), 4 * jnp.exp(-(v + 50) / 18)
    alpha_h, beta_h = 0.07 * jnp.exp(-0.05 * v - 2.5), 1 / (1 + jnp.exp(-0.1 * v - 2))
    alpha_n, beta_n = 0.01 * (20 + v) / (1 - jnp.exp(-0.1 * v - 2)), 0.125 * jnp.exp(-(v + 30) / 80)
    m, h = alpha_m / (alpha_m + beta_m), alpha_h / (alpha_h + beta_h)
    open_gates = m**3 * h
    potassium = (gkv * n**4 + gkc * c / (1 + c)) * (-75 - v)
    dv = gi * open_gates * (100 - v) + potassium + gl * (-40 - v)
    return dv, 230 * (alpha_n - n * (alpha_n + beta_n)), rho * (open_gates * (100 - v) - kc * c)
