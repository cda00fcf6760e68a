"""First and second variations of a flow along one direction, as first and second derivatives of the step itself.

Those of the flow φ_t are ξ = Dφ_t ξ₀ and δξ = D²φ_t(ξ₀, ξ₀), δξ₀ = 0. One step Φ maps them to DΦ ξ and
DΦ δξ + D²Φ(ξ, ξ). In chaotic motion they grow like e^(λt) and e^(2λt), so the state holds a unit vector u, a vector w
and a number s with ξ = e^s u and δξ = e^(2s) w.
"""

from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from .._jax.precision import nonzero
from ..systems.bound import Bound
from .base import Field, Method, OfAnother, Step, Tangent
from .runge_kutta import hermite

__all__ = ["SecondVariation", "VariedField", "highest_of", "started"]


def started(x: Array, direction: Array, f: Array) -> Array:
    """The initial state (3n + 2,): x, u, w, s and the largest value so far, for a unit vector `direction` (n,)."""
    return jnp.concatenate([x, direction, 0 * x, jnp.stack([0 * x[0], _across(direction, 0 * x, 0 * x[0], f)])])


def highest_of(state: Array) -> Array:
    """The largest ln |part of ξ + ½ δξ orthogonal to the flow| so far."""
    return state[..., -1]


def _parts(state: Array) -> tuple:
    """x, u, w, s and the largest value so far."""
    n = (state.shape[0] - 2) // 3
    return state[:n], state[n : 2 * n], state[2 * n : 3 * n], state[-2], state[-1]


def _across(u, w, s, f):
    """The logarithm of the length of the part of ξ + ½ δξ = e^s u + ½ e^(2s) w that is orthogonal to f (n,)."""
    most = jnp.maximum(s, 0.0)  # divided out as e^most, against overflow
    vector = jnp.exp(-most) * u + 0.5 * jnp.exp(s - most) * w
    square = jnp.sum(f**2)
    rest = vector - f * (jnp.sum(vector * f) / jnp.where(square > 0, square, 1.0))
    left = jnp.sum(rest**2)
    return s + most + 0.5 * jnp.log(jnp.maximum(left, nonzero(1e-300, left)))


class VariedField(eqx.Module):
    """The field of x, u, w and s: ρ = u·Df u = s', u' = Df u − ρu, w' = Df w + D²f(u, u) − 2ρw."""

    field: Any

    def __call__(self, t, state, args):
        """d(x, u, w, s)/dt (3n + 2,); the last component, a running maximum, gets 0."""
        x, u, w, s, _ = _parts(state)

        def first(x, u):
            return jax.jvp(lambda x: self.field(t, x, args), (x,), (u,))

        (f, along), (_, second) = jax.jvp(first, (x, u), (u, w))
        rate = jnp.sum(u * along)
        return jnp.concatenate([f, along - rate * u, second - 2 * rate * w, jnp.stack([rate, 0 * s])])


class SecondVariation(OfAnother):
    """A method for x that also carries ξ and δξ; their errors are controlled as those of frames are."""

    takes_slope: ClassVar[bool] = False

    method: Any

    def __init__(self, method: Method):
        self.method = method

    @property
    def inner(self) -> Any:
        """The inner method, which makes the steps of x."""
        return self.method

    @property
    def control(self) -> str:
        """Always "x": the state already contains the variations."""
        return "x"

    def loosened(self, least: float) -> "SecondVariation":
        """The same with the inner method loosened."""
        return SecondVariation(self.method.loosened(least))

    def require(self, field, t, x) -> None:
        """The requirements of the inner method."""
        self.method.require(_inner(field), t, _parts(x)[0])

    def step(self, field: Field, t, x, f, h) -> Step:
        """One step over h from (t, x)."""
        del f
        start, u, w, s, highest = _parts(x)
        inner = _inner(field)

        def step(x):
            done = self.method.step(inner, t, x, inner(t, x), h)
            return done.x, done.error

        def first(x, u):
            return jax.jvp(step, (x,), (u,))

        ((new, error), (xi, xi_error)), (_, (second, second_error)) = jax.jvp(first, (start, u), (u, w))
        length = jnp.sqrt(jnp.sum(xi**2))
        length = jnp.where(length > 0, length, nonzero(1e-300, length))
        u, w, s = xi / length, second / length**2, s + jnp.log(length)
        highest = jnp.maximum(highest, _across(u, w, s, inner(t + h, new)))
        made = jnp.concatenate([new, u, w, jnp.stack([s, highest])])
        slope = field(t + h, made)
        errors = jnp.concatenate([error, xi_error / length, second_error / length**2], axis=1)
        return Step(made, slope, errors, (x, field(t, x), made, slope, h), (t, x))

    def state_ratio(self, step: Step, x):
        """The larger ratio of x, by the inner method, and of u and w, as columns of a frame of length 1 at least."""
        before, after = _parts(x), _parts(step.x)
        error, *errors = jnp.split(step.error, 3, axis=1)
        scale = self.atol + self.rtol * jnp.maximum(jnp.abs(before[0]), jnp.abs(after[0]))

        def columns(u, w):
            return jnp.stack([u, jnp.where(jnp.sum(w**2) > 1.0, w, u)], axis=1)

        ratio = self.method.frame_ratio(jnp.stack(errors, axis=2), columns(*before[1:3]), columns(*after[1:3]))
        return jnp.maximum(self.method.ratio(error, scale), ratio)

    def tangent(self, field: Field, t, x, h, frame, stage_points=()) -> Tangent:
        """The end of the step; the frame stays as it is, because the state already contains the variations."""
        del stage_points
        return Tangent(self.step(field, t, x, field(t, x), h).x, frame, frame[None, :0], (t, x))

    def inside(self, dense, theta):
        """The cubic Hermite interpolant of the step at the fraction theta."""
        x0, f0, x1, f1, h = dense
        return hermite(theta, x0, h * f0, x1, h * f1)

    def divergence(self, field: Field, nodes, h):
        """∫ tr Df dt of the field of x, by its value at the start of the step."""
        t, x = nodes
        inner, start = _inner(field), _parts(x)[0]
        return h * jnp.trace(jax.jacfwd(lambda x: inner(t, x))(start))


def _inner(field: Any) -> Bound:
    """The field of x alone."""
    return Bound(field.field.field, field.args)
