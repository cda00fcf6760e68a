"""Coupled oscillators, H = T(p) + V(q): Hénon and Heiles, three of them, chains of Fermi, Pasta, Ulam and Tsingou."""

import jax.numpy as jnp
import numpy as np

from ...integrators import Symplectic
from ...systems.hamiltonians import Hamiltonian
from ..problem import Problem, Real, computed, near, positive, problem, require, state

SKOKOS = "Ch. Skokos & E. Gerlach, Phys. Rev. E 82 (2010) 036704, doi:10.1103/PhysRevE.82.036704"
STEP = 0.05  # step size of the paper
OMEGA = np.sqrt([1.0, 2.0, 3.0])


def _unit_masses(p, args):
    del args
    return jnp.sum(p**2) / 2


def _henon_heiles(q, args):
    del args
    x, y = q[0], q[1]
    return (x**2 + y**2) / 2 + x**2 * y - y**3 / 3  # AD makes more of x * x than of x**2


def _three_kinetic(p, args):
    del args
    return jnp.sum(jnp.asarray(OMEGA, p.dtype) * p**2) / 2


def _three_potential(q, args):
    del args
    return jnp.sum(jnp.asarray(OMEGA, q.dtype) * q**2) / 2 + q[0] ** 2 * (q[1] + q[2])


def _stretches(q):
    """Extensions (n + 1,) of the springs of a chain with fixed ends."""
    end = jnp.zeros(1, q.dtype)
    return jnp.concatenate([q, end]) - jnp.concatenate([end, q])


def _quartic_chain(q, args):
    r = _stretches(q)
    return jnp.sum(r**2 / 2 + args["beta"] * r**4 / 4)


def _cubic_chain(q, args):
    r = _stretches(q)
    return jnp.sum(r**2 / 2 + args["alpha"] * r**3 / 3)


HENON_HEILES = Hamiltonian(_unit_masses, _henon_heiles, names=("x", "y", "p_x", "p_y"))
THREE = Hamiltonian(_three_kinetic, _three_potential)
FPU_BETA = Hamiltonian(_unit_masses, _quartic_chain)
FPU_ALPHA = Hamiltonian(_unit_masses, _cubic_chain)


@problem
def henon_heiles(*, energy: Real = 0.125, y: Real = -0.016, py: Real = 0.0) -> Problem:
    """Hénon and Heiles' star in a galaxy: V = (x² + y²)/2 + x²y − y³/3, unit masses; x = (x, y, p_x, p_y).

    Starts on the section x = 0 with p_x ≥ 0. At energy 1/8: y = 0.55 is on a torus (R1 of Skokos & Gerlach), y = −0.016
    in the big chaotic sea (C1), y = −0.01333 in a thin chaotic layer around an island (in place of C2).

    Args:
        energy: of the motion; below 1/6 it is bounded.
        y: start.
        py: start.

    Returns:
        A `Problem`; for energy 1/8 and the start in the sea with the reference 0.04434(22), 0, 0, −0.04434(22).

    Raises:
        ValueError: if there is no motion of this energy at this start.

    Source:
        M. Hénon & C. Heiles, Astron. J. 69 (1964) 73, doi:10.1086/109234; Ch. Skokos & E. Gerlach, Phys. Rev. E 82
        (2010) 036704, doi:10.1103/PhysRevE.82.036704.

    Example:
        >>> from lyaphybrid import zoo
        >>> problem = zoo.henon_heiles(y=0.55)
        >>> float(problem.system.energy(problem.x0)).__round__(15)
        0.125
    """
    left = 2 * energy - py * py - y * y + 2 * y * y * y / 3
    require("energy", left, lambda left: left >= 0, "large enough for the start: 2E − p_y² − y² + 2y³/3 ≥ 0")
    return Problem(
        system=HENON_HEILES,
        x0=state(0.0, y, jnp.sqrt(left), py),
        args=None,
        t1=200_000.0,
        method=Symplectic("SABA2C", dt=STEP),
        reference=computed(
            (0.04434, 0.0, 0.0, -0.04434), (2.2e-4, 0.0, 0.0, 2.2e-4), source="C, mean of 15 runs of t = 1e7"
        )
        if near((energy, y, py), 0.125, -0.016, 0.0)
        else None,
        source="M. Hénon & C. Heiles, Astron. J. 69 (1964) 73, doi:10.1086/109234",
    )


@problem
def hamiltonian_3d(*, energy: Real = 0.09, p1: Real = 0.1, p3: Real = 0.0) -> Problem:
    """Three oscillators, H = Σ ω_i (q_i² + p_i²)/2 + q₁²q₂ + q₁²q₃, ω = (1, √2, √3).

    Starts at q = 0 with p_2 ≥ 0 from the energy. The default is on a torus (R2 of Skokos & Gerlach).

    Args:
        energy: of the motion.
        p1: start.
        p3: start.

    Returns:
        A `Problem`.

    Raises:
        ValueError: if there is no motion of this energy at this start.

    Source:
        G. Contopoulos, L. Galgani & A. Giorgilli, Phys. Rev. A 18 (1978) 1183, doi:10.1103/PhysRevA.18.1183; Ch. Skokos
        & E. Gerlach, Phys. Rev. E 82 (2010) 036704, doi:10.1103/PhysRevE.82.036704.

    Example:
        >>> from lyaphybrid import zoo
        >>> round(float(zoo.hamiltonian_3d().x0[4]), 10)
        0.346710474
    """
    left = 2 * energy - OMEGA[0] * p1 * p1 - OMEGA[2] * p3 * p3
    require("energy", left, lambda left: left >= 0, "large enough for the start: 2E ≥ p_1² + √3 p_3²")
    return Problem(
        system=THREE,
        x0=state(0.0, 0.0, 0.0, p1, jnp.sqrt(left / OMEGA[1]), p3),
        args=None,
        t1=20_000.0,
        method=Symplectic("SABA2C", dt=STEP),
        source=SKOKOS,
    )


@problem
def fpu_beta(*, n: int = 8, beta: Real = 1.5, amplitude: Real = 0.1) -> Problem:
    """The chain of Fermi, Pasta, Ulam and Tsingou: n unit masses, springs with V(r) = r²/2 + βr⁴/4, fixed ends.

    Starts at rest with all masses displaced alike: for n = 8, β = 1.5 this is on a 4-dimensional torus (R3 of Skokos &
    Gerlach).

    Args:
        n: number of masses.
        beta: strength of the quartic part.
        amplitude: displacement at the start.

    Returns:
        A `Problem`.

    Raises:
        ValueError: on fewer than two masses.

    Source:
        E. Fermi, J. Pasta & S. Ulam, Los Alamos report LA-1940 (1955), doi:10.2172/4376203; Ch. Skokos, T. Bountis &
        Ch. Antonopoulos, Eur. Phys. J. Spec. Top. 165 (2008) 5, doi:10.1140/epjst/e2008-00844-2.

    Example:
        >>> from lyaphybrid import zoo
        >>> zoo.fpu_beta(n=16).x0.shape
        (32,)
    """
    require("n", n, lambda n: n >= 2, "at least 2")
    return Problem(
        system=FPU_BETA,
        x0=jnp.concatenate([jnp.full(n, jnp.asarray(amplitude, float)), jnp.zeros(n)]),
        args={"beta": beta},
        t1=20_000.0,
        method=Symplectic("SABA2C", dt=STEP),
        source="E. Fermi, J. Pasta & S. Ulam, Los Alamos report LA-1940 (1955), doi:10.2172/4376203",
    )


@problem
def fpu_alpha(*, n: int = 32, alpha: Real = 0.25, amplitude: Real = 1.0) -> Problem:
    """The same chain with V(r) = r²/2 + αr³/3, started at rest in its lowest mode: where the recurrences were seen.

    Args:
        n: number of masses.
        alpha: strength of the cubic part.
        amplitude: q_i = A √(2/(n + 1)) sin(πi/(n + 1)) at the start.

    Returns:
        A `Problem`.

    Raises:
        ValueError: on fewer than two masses, on a strength that is not positive.

    Source:
        E. Fermi, J. Pasta & S. Ulam, Los Alamos report LA-1940 (1955), doi:10.2172/4376203.

    Example:
        >>> from lyaphybrid import zoo
        >>> problem = zoo.fpu_alpha()
        >>> float(problem.system.energy(problem.x0, problem.args)) < 0.01
        True
    """
    require("n", n, lambda n: n >= 2, "at least 2")
    positive(alpha=alpha)
    mode = np.sqrt(2 / (n + 1)) * np.sin(np.pi * np.arange(1, n + 1) / (n + 1))
    return Problem(
        system=FPU_ALPHA,
        x0=jnp.concatenate([amplitude * mode, jnp.zeros(n)]),
        args={"alpha": alpha},
        t1=20_000.0,
        method=Symplectic("SABA2C", dt=0.1),
        source="E. Fermi, J. Pasta & S. Ulam, Los Alamos report LA-1940 (1955), doi:10.2172/4376203",
    )
