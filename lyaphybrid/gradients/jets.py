"""Jets: a point of an attractor with its frame, and how both change along the unstable direction and with parameters.

With one unstable direction, the motion of points and frames together,

    Φ(x, Q) = (φ(x), Q'),    Q' R = Dφ Q,    J_i = ln R_ii,

has one too: u, whose part in x is the first column of Q, for fibres of frames contract. Along it

    DΦ u = α u',                             α = R_11
    v' = DΦ v + ∂_θΦ − a u' − c F'           v ⟂ u, F in x: what the parameters do, less what grows or drifts
    g' = (g − ∂_u ln α)/α                    the density gradient, g = ∂_u ln ρ of the invariant density on the curve
    b' = ∂_u a + a g'                        the divergence of a u on the curve

where F is the velocity of a flow (c = 0 for a map), and ∂_u of what belongs to the next point is the derivative of
the whole step along u, over α. That takes second derivatives of φ, and third ones of a field.

N. Chandramoorthy & Q. Wang, SIAM J. Appl. Dyn. Syst. 21 (2022) 735, doi:10.1137/21M1405599 (u, v, g and b for a map);
A. Ni & Q. Wang, J. Comput. Phys. 347 (2017) 56, doi:10.1016/j.jcp.2017.06.033 (c for a flow).
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from .. import frames
from ..columns import each_column

__all__ = ["Jet", "Motion", "Point", "Step", "jet_at", "onward"]


class Point(NamedTuple):
    """A point with its frame; or a tangent of both, or (p, …) of them."""

    x: Array  # (n,)
    frame: Array  # (n, k)


class Motion(NamedTuple):
    """φ, and what it depends on."""

    rule: Callable  # (θ, h, x) -> x'
    theta: Array  # (p,)
    h: Array  # length of the step
    flows: bool  # h may change, and the velocity F is the derivative by it


class Jet(NamedTuple):
    """All that is carried along."""

    z: Point
    u: Point
    v: Point  # (p, …), one for each parameter
    u_along: Point  # ∂_u u
    v_along: Point  # ∂_u v
    g: Array


class Step(NamedTuple):
    """What a step from z to z' shows."""

    growth: Array  # (k,) J at z
    direct: Array  # (p, k) ∂_θJ + DJ v at z
    b: Array  # (p,) at z'
    dilation: Array  # (p,) c at z'
    rate: Array  # (k,) dJ/dh at z', of a flow


class Carried(NamedTuple):
    """The first derivatives after a step, and their coefficients."""

    z: Point
    u: Point
    v: Point
    growth: Array
    direct: Array
    a: Array  # (p,)
    c: Array  # (p,)
    rate: Array


def jet_at(x, frame, p: int) -> Jet:
    """A jet that knows nothing yet: it forgets that as fast as the stable directions contract."""
    nothing = Point(jnp.zeros_like(x), jnp.zeros_like(frame))
    each = jax.tree.map(lambda leaf: jnp.zeros((p, *leaf.shape), leaf.dtype), nothing)
    return Jet(Point(x, frame), Point(frame[:, 0], nothing.frame), each, nothing, each, jnp.zeros((), x.dtype))


def onward(motion: Motion, jet: Jet) -> tuple[Jet, Step]:
    """The jet after one step, and what was seen on the way.

    The one loop of `propagation` carries first derivatives alone; here a step of its method is differentiated further.
    """

    def first(z, u, v):
        return _carried(motion, z, u, v)

    new, along = jax.jvp(first, (jet.z, jet.u, jet.v), (jet.u, jet.u_along, jet.v_along))
    alpha = jnp.exp(new.growth[0])
    g = (jet.g - along.growth[0]) / alpha
    u_along, v_along = (jax.tree.map(lambda leaf: leaf / alpha, one) for one in (along.u, along.v))
    b = along.a / alpha + new.a * g
    return Jet(new.z, new.u, new.v, u_along, v_along, g), Step(new.growth, new.direct, b, new.c, new.rate)


def _image(motion: Motion, theta, h, z: Point) -> tuple[Point, Array]:
    """Φ and J."""
    x, linear = jax.linearize(lambda x: motion.rule(theta, h, x), z.x)
    frame, growth, _ = frames.orthonormalise(each_column(linear, z.frame), frames.kind_for(z.frame.shape[1]))
    return Point(x, frame), growth


def _carried(motion: Motion, z: Point, u: Point, v: Point) -> Carried:
    theta, h = motion.theta, motion.h
    (new, growth), (stretched, _) = jax.jvp(lambda z: _image(motion, theta, h, z), (z,), (u,))
    u = _less(stretched, 1 - jnp.exp(-growth[0]), stretched)
    velocity, rate = _velocity(motion, z)
    unstable = new.frame[:, 0]
    across = velocity.x - unstable * (unstable @ velocity.x)
    square = across @ across if motion.flows else 1.0

    def of_parameter(turn, v):
        """∂_θΦ + DΦ v without its parts along F and u."""
        _, (moved, direct) = jax.jvp(lambda theta, z: _image(motion, theta, h, z), (theta, z), (turn, v))
        c = across @ moved.x / square
        moved = _less(moved, c, velocity)
        a = unstable @ moved.x
        return _less(moved, a, u), direct, a, c

    v, direct, a, c = jax.vmap(of_parameter)(jnp.eye(theta.shape[0], dtype=theta.dtype), v)
    return Carried(new, u, v, growth, direct, a, c, rate)


def _velocity(motion: Motion, z: Point) -> tuple[Point, Array]:
    """F and dJ/dh where the step ends; zero for a map."""
    if not motion.flows:
        return jax.tree.map(jnp.zeros_like, z), jnp.zeros(z.frame.shape[1], z.x.dtype)
    onwards = jnp.ones_like(motion.h)
    return jax.jvp(lambda h: _image(motion, motion.theta, h, z), (motion.h,), (onwards,))[1]


def _less(point: Point, factor: Any, other: Point) -> Point:
    """What is left of a point without so much of another."""
    return jax.tree.map(lambda one, two: one - factor * two, point, other)
