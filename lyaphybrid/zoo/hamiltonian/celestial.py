"""Bodies under gravity: the double pendulum, Kepler's ellipse, the restricted problem of three bodies."""

import jax.numpy as jnp

from ...integrators import Symplectic
from ...systems.hamiltonians import Hamiltonian, canonical_flow
from ..problem import Problem, Real, positive, problem, require, state

SHINBROT = "T. Shinbrot, C. Grebogi, J. Wisdom & J. A. Yorke, Am. J. Phys. 60 (1992) 491, doi:10.1119/1.16860"
HAIRER = "E. Hairer, Ch. Lubich & G. Wanner, Geometric Numerical Integration (Springer 2006), doi:10.1007/3-540-30666-8"
HENON_BOOK = (
    "M. Hénon, Generating Families in the Restricted Three-Body Problem (Springer 1997), doi:10.1007/3-540-69650-4"
)


def _two_rods(q, p, args):
    apart = q[0] - q[1]
    sine = jnp.sin(apart)
    moving = p[0] * p[0] + 2 * p[1] * p[1] - 2 * p[0] * p[1] * jnp.cos(apart)
    return moving / (2 * (1 + sine * sine)) - args["gravity"] * (2 * jnp.cos(q[0]) + jnp.cos(q[1]))


def _unit_mass(p, args):
    del args
    return 0.5 * jnp.sum(p * p)


def _centre(q, args):
    del args
    return -1 / jnp.sqrt(jnp.sum(q * q))


def _rotating(q, p, args):
    mu, (x, y) = args["mu"], q
    larger = jnp.sqrt((x + mu) * (x + mu) + y * y)
    smaller = jnp.sqrt((x - 1 + mu) * (x - 1 + mu) + y * y)
    return 0.5 * (p[0] * p[0] + p[1] * p[1]) + y * p[0] - x * p[1] - (1 - mu) / larger - mu / smaller


PHASE_PLANE = ("x", "y", "p_x", "p_y")
DOUBLE_PENDULUM = canonical_flow(_two_rods, names=("θ1", "θ2", "p1", "p2"))
KEPLER = Hamiltonian(_unit_mass, _centre, names=PHASE_PLANE)
THREE_BODIES = canonical_flow(_rotating, names=PHASE_PLANE)


@problem
def double_pendulum(*, gravity: Real = 1.0, angle1: Real = 2.0, angle2: Real = 2.0) -> Problem:
    """The double pendulum, two unit masses on massless rods of length 1; x = (θ₁, θ₂, p₁, p₂), starts at rest.

    H = (p₁² + 2p₂² − 2p₁p₂ cos(θ₁ − θ₂)) / (2(1 + sin²(θ₁ − θ₂))) − g(2 cos θ₁ + cos θ₂). Angles are from the downward
    vertical, both absolute, and count whole turns. The default is chaotic: λ₁ = 0.4259(16) over t = 1e5.

    Args:
        gravity: g; the unit of time is √(length/g).
        angle1: of the upper rod at the start.
        angle2: of the lower rod at the start.

    Returns:
        A `Problem`.

    Raises:
        ValueError: if the gravity is not positive.

    Source:
        T. Shinbrot, C. Grebogi, J. Wisdom & J. A. Yorke, Chaos in a double pendulum, Am. J. Phys. 60 (1992) 491,
        doi:10.1119/1.16860.

    Example:
        >>> from lyaphybrid import zoo
        >>> problem = zoo.double_pendulum(angle1=0, angle2=0)
        >>> float(problem.system.energy(problem.x0, problem.args))
        -3.0
    """
    positive(gravity=gravity)
    return Problem(
        system=DOUBLE_PENDULUM,
        x0=state(angle1, angle2, 0.0, 0.0),
        args={"gravity": gravity},
        t1=10_000.0,
        transient=100.0,
        source=SHINBROT,
    )


@problem
def kepler(*, eccentricity: Real = 0.6) -> Problem:
    """Kepler's ellipse in its plane, H = |p|²/2 − 1/|q|: semi-major axis 1, period 2π; starts at the pericentre.

    The motion is periodic: all exponents are 0, and those of a finite run fall like ln t / t.

    Args:
        eccentricity: in [0, 1). The step of 0.05 is for up to 0.6, where the energy errs by 2e-10 over t = 1000;
            beyond, it must be shorter.

    Returns:
        A `Problem`.

    Raises:
        ValueError: on an eccentricity outside [0, 1).

    Source:
        E. Hairer, Ch. Lubich & G. Wanner, Geometric Numerical Integration (Springer 2006), section I.2,
        doi:10.1007/3-540-30666-8.

    Example:
        >>> from lyaphybrid import zoo
        >>> problem = zoo.kepler()
        >>> round(float(problem.system.energy(problem.x0)), 12)
        -0.5
    """
    require("eccentricity", eccentricity, lambda e: 0 <= e < 1, "at least 0 and below 1")
    return Problem(
        system=KEPLER,
        x0=state(1 - eccentricity, 0.0, 0.0, jnp.sqrt((1 + eccentricity) / (1 - eccentricity))),
        args=None,
        t1=10_000.0,
        method=Symplectic("SRKN14a", dt=0.05),
        source=HAIRER,
    )


@problem
def restricted_three_body(*, mu: Real = 0.0121505856, jacobi: Real = 3.19, x: Real = 0.35) -> Problem:
    """The planar circular restricted problem of three bodies in the rotating frame; x = (x, y, p_x, p_y).

    H = (p_x² + p_y²)/2 + y p_x − x p_y − (1 − μ)/r₁ − μ/r₂, the larger body at (−μ, 0), the smaller at (1 − μ, 0),
    their angular velocity 1. Starts on y = 0 with velocity (0, v), v ≥ 0, from the Jacobi constant
    C = x² + y² + 2(1 − μ)/r₁ + 2μ/r₂ − v² = −2H.

    The default C is above 3.18834, that of the equilibrium between the bodies, so the motion stays around the larger
    one. It is chaotic, at a rate that varies much: λ₁ = 0.0352(13) over t = 1e5, 0.012 to 0.063 in 64 parts of that.

    Args:
        mu: mass of the smaller body over that of both; the default is that of Earth and Moon.
        jacobi: C.
        x: start.

    Returns:
        A `Problem`.

    Raises:
        ValueError: on a mass outside (0, 1/2], on a start in one of the bodies, or where no motion has this C.

    Source:
        V. Szebehely, Theory of Orbits: The Restricted Problem of Three Bodies (Academic Press 1967); M. Hénon,
        Generating Families in the Restricted Three-Body Problem (Springer 1997), doi:10.1007/3-540-69650-4.

    Example:
        >>> from lyaphybrid import zoo
        >>> problem = zoo.restricted_three_body()
        >>> round(-2 * float(problem.system.energy(problem.x0, problem.args)), 12)
        3.19
    """
    require("mu", mu, lambda mu: 0 < mu <= 0.5, "above 0 and at most 1/2")
    larger, smaller = abs(x + mu), abs(x - 1 + mu)
    for distance in (larger, smaller):
        require("x", distance, lambda r: r > 0, "at a distance from both bodies")
    left = x * x + 2 * (1 - mu) / larger + 2 * mu / smaller - jacobi
    require("jacobi", left, lambda left: left >= 0, "small enough for the start: x² + 2(1 − μ)/r₁ + 2μ/r₂ − C ≥ 0")
    return Problem(
        system=THREE_BODIES,
        x0=state(x, 0.0, 0.0, x + jnp.sqrt(left)),
        args={"mu": mu},
        t1=10_000.0,
        transient=100.0,
        source=HENON_BOOK,
    )
