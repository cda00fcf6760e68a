"""Jets: a point of an attractor with its frame, and how both change along the unstable direction and with parameters.

With one unstable direction, the motion of points and frames together,

    Φ(x, Q) = (φ(x), Q'),    Q' R = Dφ Q,    J_i = ln R_ii,

has one too, u, because frames over the same point converge. Its part in x has length 1 and, for a flow, is
perpendicular to the velocity F: a part along F only shifts time, and would make large terms that cancel.

    DΦ u = α u' + κ F'
    v' = DΦ v + ∂_θΦ − a u' − c F'           v ⟂ u, F in x: effect of parameters without its parts along u and F
    ∂_u' = (∂_u − κ ∂_F)/α,  ∂_F' = ∂_F      for functions of the next point; without prime, of the step from this one
    g' = (g − ∂_u' α − ∂_F' κ)/α             the density gradient: the divergence of u under the invariant measure
    b' = ∂_u' a + a g'                       the divergence of a u

In a map F = 0, and g = ∂_u ln ρ of the density on the unstable curve. The third line is the derivative of the second
along a curve, and g' follows from the first, because Φ preserves the measure and so divergences, and div F = 0.

N. Chandramoorthy & Q. Wang, SIAM J. Appl. Dyn. Syst. 21 (2022) 735, doi:10.1137/21M1405599 (u, v, g and b of a map);
A. Ni & Q. Wang, J. Comput. Phys. 347 (2017) 56, doi:10.1016/j.jcp.2017.06.033 (c of a flow).
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from ...._jax.columns import each_column
from ...._linalg import frames

__all__ = ["Jet", "JetMap", "FramedPoint", "StepTerms", "jet_at", "onward"]


class FramedPoint(NamedTuple):
    """A point with its frame; or a tangent of both, or (p, …) of them."""

    x: Array  # (n,)
    frame: Array  # (n, k)


class JetMap(NamedTuple):
    """The map φ and its inputs."""

    rule: Callable  # (θ, h, x) -> x'
    theta: Array  # (p,)
    h: Array  # length of the step
    flows: bool  # whether φ is a step of a flow; then F is its derivative by h


class TangentJet(NamedTuple):
    """A tangent of a point, and the derivatives of u and v along it."""

    z: FramedPoint
    u: FramedPoint
    v: FramedPoint


class Jet(NamedTuple):
    """A point with all derivatives that are propagated."""

    z: FramedPoint
    u: FramedPoint
    v: FramedPoint  # (p, …), one for each parameter
    unstable: TangentJet  # along u
    flow: TangentJet  # along F
    g: Array


class StepTerms(NamedTuple):
    """The terms of a step from z to z' for the sums."""

    growth: Array  # (k,) J at z
    direct: Array  # (p, k) ∂_θJ + DJ v at z
    b: Array  # (p,) at z'
    dilation: Array  # (p,) c at z'
    rate: Array  # (k,) dJ/dh at z', of a flow


class CarriedDerivatives(NamedTuple):
    """The first derivatives after a step, and their coefficients."""

    z: FramedPoint
    u: FramedPoint
    v: FramedPoint
    alpha: Array
    kappa: Array
    a: Array  # (p,)


def jet_at(x, frame, p: int) -> Jet:
    """A first jet with zero derivatives; the error decays as the stable directions contract."""
    nothing = FramedPoint(jnp.zeros_like(x), jnp.zeros_like(frame))
    each = jax.tree.map(lambda leaf: jnp.zeros((p, *leaf.shape), leaf.dtype), nothing)
    u, still = FramedPoint(frame[:, 0], nothing.frame), TangentJet(nothing, nothing, each)
    return Jet(FramedPoint(x, frame), u, each, still._replace(z=u), still, jnp.zeros((), x.dtype))


def onward(motion: JetMap, jet: Jet) -> tuple[Jet, StepTerms]:
    """The jet after one step, and the terms of the step.

    The engine's loop propagates first derivatives only; here a step of the same method is differentiated further.
    """
    new, derivative, (velocity, step) = jax.linearize(
        lambda z, u, v: _carried(motion, z, u, v), jet.z, jet.u, jet.v, has_aux=True
    )
    by_flow = derivative(*jet.flow)
    by_unstable = jax.tree.map(lambda one, two: (one - new.kappa * two) / new.alpha, derivative(*jet.unstable), by_flow)
    g = (jet.g - by_unstable.alpha - by_flow.kappa) / new.alpha
    unstable, flow = TangentJet(new.u, by_unstable.u, by_unstable.v), TangentJet(velocity, by_flow.u, by_flow.v)
    return Jet(new.z, new.u, new.v, unstable, flow, g), step._replace(b=by_unstable.a + new.a * g)


def _image(motion: JetMap, theta, h, z: FramedPoint) -> tuple[FramedPoint, Array]:
    """Φ and J."""
    x, linear = jax.linearize(lambda x: motion.rule(theta, h, x), z.x)
    frame, growth, _ = frames.orthonormalise(each_column(linear, z.frame), frames.kind_for(z.frame.shape[1]))
    return FramedPoint(x, frame), growth


def _carried(
    motion: JetMap, z: FramedPoint, u: FramedPoint, v: FramedPoint
) -> tuple[CarriedDerivatives, tuple[FramedPoint, StepTerms]]:
    """The first derivatives after a step; the velocity at its end; and its terms without b."""
    theta, h = motion.theta, motion.h
    (new, growth), (stretched, _) = jax.jvp(lambda z: _image(motion, theta, h, z), (z,), (u,))
    velocity, rate = _velocity(motion, z)
    square = velocity.x @ velocity.x if motion.flows else 1.0
    kappa = stretched.x @ velocity.x / square
    across = _less(stretched, kappa, velocity)
    alpha = jnp.sqrt(across.x @ across.x)
    u = jax.tree.map(lambda leaf: leaf / alpha, across)

    def of_parameter(turn, v):
        """∂_θΦ + DΦ v without its parts along F and u."""
        _, (moved, direct) = jax.jvp(lambda theta, z: _image(motion, theta, h, z), (theta, z), (turn, v))
        c, a = velocity.x @ moved.x / square, u.x @ moved.x
        return _less(_less(moved, c, velocity), a, u), direct, a, c

    v, direct, a, c = jax.vmap(of_parameter)(jnp.eye(theta.shape[0], dtype=theta.dtype), v)
    return CarriedDerivatives(new, u, v, alpha, kappa, a), (
        velocity,
        StepTerms(growth, direct, jnp.zeros_like(a), c, rate),
    )


def _velocity(motion: JetMap, z: FramedPoint) -> tuple[FramedPoint, Array]:
    """F and dJ/dh at the end of the step; zero for a map."""
    if not motion.flows:
        return jax.tree.map(jnp.zeros_like, z), jnp.zeros(z.frame.shape[1], z.x.dtype)
    onwards = jnp.ones_like(motion.h)
    return jax.jvp(lambda h: _image(motion, motion.theta, h, z), (motion.h,), (onwards,))[1]


def _less(point: FramedPoint, factor: Any, other: FramedPoint) -> FramedPoint:
    """Point − factor · other."""
    return jax.tree.map(lambda one, two: one - factor * two, point, other)
