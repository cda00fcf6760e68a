"""Smooth flows."""

import jax.numpy as jnp

from ...systems.smooth import Flow
from ..problem import Problem, Real, computed, near, problem, require, state


def _lorenz(t, x, args):
    a, b, c = x[0], x[1], x[2]
    return jnp.stack([args["sigma"] * (b - a), a * (args["rho"] - c) - b, a * b - args["beta"] * c])


def _rossler(t, x, args):
    return jnp.stack([-x[1] - x[2], x[0] + args["a"] * x[1], args["b"] + x[2] * (x[0] - args["c"])])


def _lorenz96(t, x, args):
    return (jnp.roll(x, -1) - jnp.roll(x, 2)) * jnp.roll(x, 1) - x + args["forcing"]


LORENZ = Flow(_lorenz, names=("x", "y", "z"))
ROSSLER = Flow(_rossler, names=("x", "y", "z"))
LORENZ96 = Flow(_lorenz96)


@problem
def lorenz63(*, sigma: Real = 10.0, rho: Real = 28.0, beta: Real = 8 / 3) -> Problem:
    """Lorenz' convection: x' = σ(y − x), y' = x(ρ − z) − y, z' = xy − βz.

    The exponents sum to −(σ + 1 + β) exactly.

    Args:
        sigma: Prandtl number.
        rho: Rayleigh number over its critical value.
        beta: aspect ratio of the rolls.

    Returns:
        A `Problem`; at the default parameters with the reference 0.90587(15), 0, −14.57254(15).

    Source:
        E. N. Lorenz, Deterministic nonperiodic flow, J. Atmos. Sci. 20 (1963) 130,
        doi:10.1175/1520-0469(1963)020<0130:DNF>2.0.CO;2.

    Example:
        >>> from lyaphybrid import zoo
        >>> zoo.lorenz63(rho=30).args["rho"]
        30.0
    """
    known = near((sigma, rho, beta), 10, 28, 8 / 3)
    return Problem(
        system=LORENZ,
        x0=state(1.0, 1.0, 20.0),
        args={"sigma": sigma, "rho": rho, "beta": beta},
        t1=10_000.0,
        transient=50.0,
        reference=computed(
            (0.905873, 0.0, -14.572541), (1.5e-4, 0.0, 1.5e-4), source="order 8 in C, step 0.01, t = 1e6"
        )
        if known
        else None,
        source="E. N. Lorenz, J. Atmos. Sci. 20 (1963) 130, doi:10.1175/1520-0469(1963)020<0130:DNF>2.0.CO;2",
    )


@problem
def rossler(*, a: Real = 0.2, b: Real = 0.2, c: Real = 5.7) -> Problem:
    """Rössler's band: x' = −y − z, y' = x + ay, z' = b + z(x − c).

    Args:
        a: anti-damping of the spiral.
        b: inflow of z.
        c: value of x above which z grows.

    Returns:
        A `Problem`; at the default parameters with the reference 0.07142(7), 0, −5.39424(6).

    Source:
        O. E. Rössler, An equation for continuous chaos, Phys. Lett. A 57 (1976) 397,
        doi:10.1016/0375-9601(76)90101-8.

    Example:
        >>> from lyaphybrid import zoo
        >>> zoo.rossler().x0.shape
        (3,)
    """
    known = near((a, b, c), 0.2, 0.2, 5.7)
    return Problem(
        system=ROSSLER,
        x0=state(1.0, 1.0, 0.0),
        args={"a": a, "b": b, "c": c},
        t1=20_000.0,
        transient=500.0,
        reference=computed(
            (0.071419, 0.0, -5.394236), (7e-5, 0.0, 6e-5), source="RK4 in C, step 0.005, two runs of t = 2e6"
        )
        if known
        else None,
        source="O. E. Rössler, Phys. Lett. A 57 (1976) 397, doi:10.1016/0375-9601(76)90101-8",
    )


@problem
def lorenz96(*, n: int = 40, forcing: Real = 8.0) -> Problem:
    """Lorenz' ring of n sites on a circle of latitude: x_i' = (x_{i+1} − x_{i−2}) x_{i−1} − x_i + F, indices mod n.

    The exponents sum to −n exactly; by default λ₁ = 1.669(16) over t = 2000. Starts at the fixed point x_i = F, but for
    x_1 = F + 0.01.

    Args:
        n: number of sites.
        forcing: F; the motion is chaotic at 8 for n = 40.

    Returns:
        A `Problem`.

    Raises:
        ValueError: on fewer than four sites.

    Source:
        E. N. Lorenz, Predictability: a problem partly solved, ECMWF Seminar on Predictability 1 (1996) 1; E. N. Lorenz
        & K. A. Emanuel, J. Atmos. Sci. 55 (1998) 399, doi:10.1175/1520-0469(1998)055<0399:OSFSWO>2.0.CO;2.

    Example:
        >>> from lyaphybrid import zoo
        >>> zoo.lorenz96(n=8).x0.shape
        (8,)
    """
    require("n", n, lambda n: n >= 4, "at least 4")
    return Problem(
        system=LORENZ96,
        x0=state(forcing + 0.01, *[forcing] * (n - 1)),
        args={"forcing": forcing},
        t1=500.0,
        transient=50.0,
        source="E. N. Lorenz & K. A. Emanuel, J. Atmos. Sci. 55 (1998) 399, "
        "doi:10.1175/1520-0469(1998)055<0399:OSFSWO>2.0.CO;2",
    )
