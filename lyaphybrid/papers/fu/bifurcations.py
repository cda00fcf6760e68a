"""The bifurcations of cycles of the friction pendulum, where their largest exponent must vanish.

Listed are the values of β at α = 0.01 at which a cycle loses its stability or ends, from cycles that a program
independent of this package continued by Newton's method. Here each cycle is computed again, on the side where it is
stable, at two distances δ from the listed value; λ₁ goes to zero as √δ at a fold and as δ at the others, and its zero
follows. A cycle that loses its symmetry, or doubles, continues to exist: on the other side λ₁ is positive.
"""

import dataclasses
import functools
from collections.abc import Callable, Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np

from ...analysis.orbits.periodic_orbits import floquet
from ...systems.hybrid import Hybrid

__all__ = ["LISTED", "Bifurcation", "Vanishing", "vanishings"]

PERIOD = 2 * np.pi / 0.666
DISTANCE, DISTANCE_TO_FOLD = 1e-6, 1e-8  # δ
SECOND_DISTANCE = 4  # the second distance, in units of the first


@dataclasses.dataclass(frozen=True)
class Bifurcation:
    """A bifurcation of a cycle.

    Attributes:
        beta: listed value.
        kind: "fold", "symmetry" (it is lost: a pitchfork) or "doubling".
        cycle: its name; periods of the forcing, and turns of θ in them.
        side: +1 where the cycle is stable above β, −1 below.
        start: (θ, θ') of the cycle at t = 0, near β.
        near: the smaller δ.
        error: largest error of the listed value.
    """

    beta: float
    kind: str
    cycle: str
    periods: int
    turns: int
    side: int
    start: tuple[float, float]
    near: float
    error: float = 1e-9

    @property
    def name(self) -> str:
        """Name: kind and cycle."""
        return f"{self.kind} of {self.cycle}"


@dataclasses.dataclass(frozen=True)
class Vanishing:
    """λ₁ near a bifurcation.

    Attributes:
        listed: the bifurcation.
        stable: λ₁ at the distances δ and 4δ, on the side where the cycle is stable.
        beyond: λ₁ of the same cycle at δ on the other side; nan at a fold, where it ends.
    """

    listed: Bifurcation
    stable: tuple[float, float]
    beyond: float

    @property
    def zero(self) -> float:
        """The zero of λ₁: linear in λ₁² at a fold, else by inverse interpolation through three points."""
        near, (low, high) = self.listed.near, self.stable
        if self.listed.kind == "fold":
            distance = np.polyfit([low**2, high**2], [near, SECOND_DISTANCE * near], 1)[-1]
        else:
            distance = np.polyfit([self.beyond, low, high], [-near, near, SECOND_DISTANCE * near], 2)[-1]
        return float(self.listed.beta + self.listed.side * distance)

    @property
    def agrees(self) -> bool:
        """Whether λ₁ is negative on the stable side, positive beyond, and zero at the listed value."""
        near, far = self.stable
        signs = far < near < 0 and (self.listed.kind == "fold" or self.beyond > 0)
        return bool(signs and abs(self.zero - self.listed.beta) <= self.listed.error)


def _listed(beta, kind, cycle, periods, turns, side, start, near=None, **error) -> Bifurcation:
    near = (DISTANCE_TO_FOLD if kind == "fold" else DISTANCE) if near is None else near
    return Bifurcation(beta, kind, cycle, periods, turns, side, start, near, **error)


# The last but one and "symmetry of P5" come from an interpolation of trace and determinant, to 1e-7. P1w3 has complex
# multipliers, and λ₁ = −β/2, up to 8e-9 before its fold.
LISTED = (
    _listed(0.0141710587, "fold", "P1w3", 1, -3, -1, (-2.1775924334, -2.7870913563), near=1e-10, error=1e-10),
    _listed(0.0552057, "symmetry", "P5", 5, 0, 1, (0.559450759, -0.740964197), error=1e-7),
    _listed(0.0583948553, "fold", "P5", 5, 0, -1, (0.533690336, -0.709796108)),
    _listed(0.119144134, "doubling", "P3w2", 3, 2, 1, (-1.992380461, 0.235979198)),
    _listed(0.1211681137, "fold", "P3w2", 3, 2, -1, (-1.884267607, 0.299014215)),
    _listed(0.141556765, "doubling", "P3", 3, 0, 1, (-0.553154372, -1.01716719)),
    _listed(0.1459824746, "symmetry", "P3", 3, 0, 1, (-0.439756923, -0.99955096)),
    _listed(0.1467190146, "doubling", "P1", 1, 0, 1, (-2.029876334, -1.245908564)),
    _listed(0.1587880508, "fold", "P3", 3, 0, -1, (-0.348218721, -0.850468938)),
    _listed(0.1905219547, "symmetry", "P1", 1, 0, 1, (-1.825221132, -1.289566642)),
    _listed(0.2100355766, "doubling", "P2w1", 2, 1, 1, (-2.307802991, 0.067704177)),
    _listed(0.2140805105, "fold", "P2w1", 2, 1, -1, (-2.12691772, 0.183952849)),
    _listed(0.2400935056, "symmetry", "P5b", 5, 0, 1, (-0.666933634, 0.332671055)),
    _listed(0.2486769, "symmetry", "P5b", 5, 0, -1, (-0.649994140, 0.521740327), error=1e-7),
    _listed(0.2529744417, "fold", "P5c", 5, 0, -1, (-0.111958505, 0.78725554)),
)


@functools.cache
def _turned(turns: int) -> Callable | None:
    """The symmetry θ → θ + 2π turns after the cycle; None without turns."""
    return None if turns == 0 else lambda x: x + 2 * np.pi * jnp.asarray([turns, 0.0])


def _exponent(system: Hybrid, args: Mapping[str, Any], one: Bifurcation, x, distance: float):
    """λ₁ of the cycle at this distance, positive where it is stable, and its point at t = 0."""
    args = dict(args) | {"beta": jnp.asarray(one.beta + one.side * distance)}
    orbit = floquet(system, x, args, period=one.periods * PERIOD, modulo=_turned(one.turns))
    return float(orbit.exponents[0]), orbit.x0


def vanishings(system: Hybrid, args: Mapping[str, Any], listed=LISTED) -> tuple[Vanishing, ...]:
    """λ₁ at each of the bifurcations.

    Args:
        system: the forced pendulum, state (θ, θ').
        args: its parameters; β is replaced.
        listed: which bifurcations.
    """
    found = []
    for one in listed:
        far, x = _exponent(system, args, one, jnp.asarray(one.start), SECOND_DISTANCE * one.near)
        near, x = _exponent(system, args, one, x, one.near)
        beyond = np.nan if one.kind == "fold" else _exponent(system, args, one, x, -one.near)[0]
        found.append(Vanishing(one, (near, far), beyond))
    return tuple(found)
