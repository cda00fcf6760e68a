"""Coupled standard maps, symplectic in x = (θ_1 … θ_m, p_1 … p_m). Exponents are per iteration."""

from typing import ClassVar

import jax.numpy as jnp

from ...systems.smooth import Map
from ..problem import Problem, Real, problem, require, state
from .maps import TURN

KOOK = "H.-T. Kook & J. D. Meiss, Physica D 35 (1989) 65, doi:10.1016/0167-2789(89)90096-1"
KANTZ = "H. Kantz & P. Grassberger, J. Phys. A 21 (1988) L127, doi:10.1088/0305-4470/21/3/003"


class _CanonicalMap(Map):
    """An `lh.Map` that preserves dθ∧dp, so that its runs start from the paired frame."""

    canonical: ClassVar[bool] = True


def _kicked(q, p, kick):
    """Momenta first, then angles with the new momenta, all mod 2π."""
    p = p + kick
    x = jnp.concatenate([q + p, p])
    return x - TURN * jnp.floor(x / TURN)


def _froeschle(n, x, args):
    q, p = x[:2], x[2:]
    common = args["coupling"] * jnp.sin(q[0] + q[1])
    kick = jnp.stack([args["K1"] * jnp.sin(q[0]) + common, args["K2"] * jnp.sin(q[1]) + common])
    return _kicked(q, p, kick)


def _ring(n, x, args):
    m = x.shape[0] // 2
    q, p = x[:m], x[m:]
    neighbours = jnp.sin(jnp.roll(q, -1) - q) + jnp.sin(jnp.roll(q, 1) - q)
    return _kicked(q, p, args["K"] * jnp.sin(q) - args["coupling"] * neighbours)


FROESCHLE, RING = _CanonicalMap(_froeschle), _CanonicalMap(_ring)


@problem
def froeschle_map(*, K1: Real = 2.5, K2: Real = 3.5, coupling: Real = 0.5) -> Problem:
    """Froeschlé's map, two standard maps coupled through θ₁ + θ₂; x = (θ₁, θ₂, p₁, p₂), all mod 2π.

    p_i⁺ = p_i + K_i sin θ_i + b sin(θ₁ + θ₂), θ_i⁺ = θ_i + p_i⁺. Symplectic: the exponents are ±λ₁, ±λ₂; by default
    0.7667(9) and 0.4347(9) over 2e6 iterations.

    Args:
        K1: strength of the first kick.
        K2: strength of the second kick.
        coupling: b.

    Returns:
        A `Problem`.

    Source:
        C. Froeschlé, Numerical study of a four-dimensional mapping, Astron. Astrophys. 16 (1972) 172; H.-T. Kook &
        J. D. Meiss, Periodic orbits for reversible, symplectic mappings, Physica D 35 (1989) 65,
        doi:10.1016/0167-2789(89)90096-1.

    Example:
        >>> from lyaphybrid import zoo
        >>> zoo.froeschle_map(coupling=0.1).x0.shape
        (4,)
    """
    return Problem(
        system=FROESCHLE,
        x0=state(1.0, 0.5, 2.0, 3.0),
        args={"K1": K1, "K2": K2, "coupling": coupling},
        t1=200_000,
        transient=1000,
        clock="jumps",
        source="C. Froeschlé, Astron. Astrophys. 16 (1972) 172; " + KOOK,
    )


@problem
def coupled_standard_maps(*, n: int = 3, K: Real = 3.0, coupling: Real = 0.5) -> Problem:
    """Standard maps on a ring, each coupled to both neighbours; x = (θ_1 … θ_n, p_1 … p_n), all mod 2π.

    p_i⁺ = p_i + K sin θ_i − β [sin(θ_{i+1} − θ_i) + sin(θ_{i−1} − θ_i)], θ_i⁺ = θ_i + p_i⁺. Symplectic: the exponents
    come in pairs ±λ; by default 0.8259(7), 0.6506(8) and 0.3897(8) over 2e6 iterations.

    Args:
        n: number of maps; two are neighbours on both sides.
        K: strength of the kick.
        coupling: β.

    Returns:
        A `Problem`.

    Raises:
        ValueError: on fewer than two maps.

    Source:
        H. Kantz & P. Grassberger, Internal Arnold diffusion and chaos thresholds in coupled symplectic maps, J. Phys. A
        21 (1988) L127, doi:10.1088/0305-4470/21/3/003.

    Example:
        >>> from lyaphybrid import zoo
        >>> zoo.coupled_standard_maps(n=5).x0.shape
        (10,)
    """
    require("n", n, lambda n: n >= 2, "at least 2")
    return Problem(
        system=RING,
        x0=state(*((1.0 + i) % TURN for i in range(n)), *((2.0 + 0.3 * i * i) % TURN for i in range(n))),
        args={"K": K, "coupling": coupling},
        t1=200_000,
        transient=1000,
        clock="jumps",
        source=KANTZ,
    )
