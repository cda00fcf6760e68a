"""Disordered lattices: the quartic Klein–Gordon chain, and the discrete nonlinear Schrödinger equation.

Hundreds of sites, one of which is excited at the start. Without the quartic part all modes are localised (Anderson);
with it the packet spreads, and λ₁(t) falls, more slowly than 1/t.
"""

import jax.numpy as jnp
import numpy as np

from ...integrators import Splitting, Symplectic
from ...systems.hamiltonians import Hamiltonian, canonical_flow, halves
from ..problem import Problem, Real, positive, problem, require

SPREADING = (
    "Ch. Skokos, D. O. Krimer, S. Komineas & S. Flach, Phys. Rev. E 79 (2009) 056211, doi:10.1103/PhysRevE.79.056211"
)


def _unit_masses(p, args):
    del args
    return jnp.sum(p**2) / 2


def _quartic_sites(q, args):
    # With q = 0 beyond both ends Σ (q_{l+1} − q_l)²/2 = Σ q_l² − Σ q_l q_{l+1}: less work than from the differences.
    coupling = 1 / args["disorder"]
    sites = (args["stiffness"] / 2 + coupling) * q**2 + args["nonlinearity"] * q**4 / 4
    return jnp.sum(sites) - coupling * jnp.sum(q[1:] * q[:-1])


KLEIN_GORDON = Hamiltonian(_unit_masses, _quartic_sites)


def _neighbours(values):
    """The sum of the two neighbours, 0 beyond both ends (n,)."""
    end = jnp.zeros(1, values.dtype)
    return jnp.concatenate([values[1:], end]) + jnp.concatenate([end, values[:-1]])


def _schroedinger_energy(q, p, args):
    square = q**2 + p**2
    sites = args["disorder"] * args["levels"] * square / 2 + args["nonlinearity"] * square**2 / 8
    return jnp.sum(sites) - jnp.sum(q[1:] * q[:-1]) - jnp.sum(p[1:] * p[:-1])


def _turned(dt, t, x, args):
    """Flow of the sites' energy: each (q, p) rotates by its own angle."""
    del t
    q, p = halves(x)
    angle = dt * (args["disorder"] * args["levels"] + args["nonlinearity"] * (q**2 + p**2) / 2)
    c, s = jnp.cos(angle), jnp.sin(angle)
    return jnp.concatenate([c * q + s * p, c * p - s * q])


def _drifted(dt, t, x, args):
    """Flow of −Σ p_l p_{l+1}."""
    del t, args
    q, p = halves(x)
    return jnp.concatenate([q - dt * _neighbours(p), p])


def _kicked(dt, t, x, args):
    """Flow of −Σ q_l q_{l+1}."""
    del t, args
    q, p = halves(x)
    return jnp.concatenate([q, p + dt * _neighbours(q)])


SCHROEDINGER = canonical_flow(_schroedinger_energy)
THREE_PARTS = (_turned, _drifted, _kicked)


def _alike(n: int) -> dict:
    """Default options: one deviation vector with equal components, for the largest exponent."""
    return {"frame": np.full((2 * n, 1), (2 * n) ** -0.5)}


def _checked(n: int, seed: int) -> np.random.Generator:
    require("n", n, lambda n: n >= 2, "at least 2")
    require("seed", seed, lambda seed: seed >= 0, "0 or more")
    return np.random.default_rng(seed)


def _at_the_middle(n: int, value):
    return jnp.zeros(2 * n).at[n + n // 2].set(value)


@problem
def klein_gordon(
    *, n: int = 256, energy: Real = 0.4, disorder: Real = 4.0, nonlinearity: Real = 1.0, seed: int = 0
) -> Problem:
    """The disordered quartic Klein–Gordon chain, H = Σ p²/2 + ε q²/2 + g q⁴/4 + (q_{l+1} − q_l)²/(2W), fixed ends.

    The ε_l are drawn evenly from [1/2, 3/2]. At the start the site in the middle has all of the energy, as p. There is
    one deviation vector unless `frame` says otherwise: ``spectrum(k=8, frame=None)`` takes eight.

    Args:
        n: number of sites.
        energy: of the motion.
        disorder: W, the inverse of the coupling.
        nonlinearity: g.
        seed: of the ε_l.

    Returns:
        A `Problem`.

    Raises:
        ValueError: on fewer than two sites, an energy or disorder that is not positive, a negative seed.

    Source:
        Ch. Skokos, D. O. Krimer, S. Komineas & S. Flach, Phys. Rev. E 79 (2009) 056211,
        doi:10.1103/PhysRevE.79.056211.

    Example:
        >>> from lyaphybrid import zoo
        >>> problem = zoo.klein_gordon(n=100)
        >>> round(float(problem.system.energy(problem.x0, problem.args)), 12)
        0.4
    """
    stiffness = _checked(n, seed).uniform(0.5, 1.5, n)
    positive(energy=energy, disorder=disorder)
    return Problem(
        system=KLEIN_GORDON,
        x0=_at_the_middle(n, jnp.sqrt(2 * jnp.asarray(energy, float))),
        args={"disorder": disorder, "nonlinearity": nonlinearity, "stiffness": stiffness},
        t1=10_000.0,
        method=Symplectic("ABA864", dt=0.2),
        options=_alike(n),
        source=SPREADING,
    )


@problem
def schroedinger_lattice(
    *, n: int = 256, norm: Real = 1.0, disorder: Real = 4.0, nonlinearity: Real = 1.0, seed: int = 0
) -> Problem:
    """The disordered discrete nonlinear Schrödinger equation, i ψ' = ε ψ + β |ψ|² ψ − ψ_{l+1} − ψ_{l−1}, fixed ends.

    With ψ = (q + ip)/√2: H = Σ ε (q² + p²)/2 + β (q² + p²)²/8 − q_l q_{l+1} − p_l p_{l+1}, and the norm Σ (q² + p²)/2
    is kept, too. The ε_l are drawn evenly from [−W/2, W/2]. At the start all of the norm is at the site in the middle.
    Its method splits H into three parts that flow in closed form: the sites, the q and the p. There is one deviation
    vector unless `frame` says otherwise, as in ``spectrum(k=8, frame=None)``.

    Args:
        n: number of sites.
        norm: Σ |ψ|².
        disorder: W.
        nonlinearity: β.
        seed: of the ε_l.

    Returns:
        A `Problem`.

    Raises:
        ValueError: on fewer than two sites, a norm or disorder that is not positive, a negative seed.

    Source:
        Ch. Skokos, D. O. Krimer, S. Komineas & S. Flach, Phys. Rev. E 79 (2009) 056211,
        doi:10.1103/PhysRevE.79.056211; its three parts: Ch. Skokos, E. Gerlach, J. D. Bodyfelt, G. Papamikos & S. Eggl,
        Phys. Lett. A 378 (2014) 1809, doi:10.1016/j.physleta.2014.04.050.

    Example:
        >>> from lyaphybrid import zoo
        >>> problem = zoo.schroedinger_lattice(n=100, norm=2.0)
        >>> round(float((problem.x0**2).sum() / 2), 12)
        2.0
    """
    levels = _checked(n, seed).uniform(-0.5, 0.5, n)
    positive(norm=norm, disorder=disorder)
    return Problem(
        system=SCHROEDINGER,
        x0=_at_the_middle(n, jnp.sqrt(2 * jnp.asarray(norm, float))),
        args={"disorder": disorder, "levels": levels, "nonlinearity": nonlinearity},
        t1=10_000.0,
        method=Splitting(THREE_PARTS, "Yoshida6", dt=0.1),
        options=_alike(n),
        source=SPREADING,
    )
