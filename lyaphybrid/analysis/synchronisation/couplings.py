"""Perturbations of identical systems, coupled, along one mode of their coupling.

    xᵢ' = f(xᵢ) + s Σⱼ Gᵢⱼ H(xⱼ),   Σⱼ Gᵢⱼ = 0

has the solution x₁ = … = x_N = x(t) of one system alone. Along an eigenvector of G with the eigenvalue γ a perturbation
moves as ξ' = (Df + α DH) ξ, α = s γ. At a jump each system meets its guard at its own instant; in between some have
jumped and some have not, and what these do to each other depends on their order, unless

    H(x⁺) = H(x⁻),   and, where guard or reset depend on the input of the coupling, DH f⁺ = DH f⁻.

Then S is the saltation matrix of one system, with the input α DH ξ. Clocks tick for all at once, and ask nothing.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from ..._jax.columns import linear_at
from .checking import differ
from .skew_products import Cocycle, Columns, GuardJump

__all__ = ["CoupledMode", "order_of_jumps"]


class CoupledMode(Cocycle):
    """ξ along a mode of the coupling; the parameters are (those of the system, (Re α, Im α)).

    Attributes:
        coupling: H, ``(t, x, args) -> (m,)``.
        enters: ``(args, input) -> args`` puts the input of a system into its parameters; None: it is added to fields.
        n: dimension of x.
        parts: 1, or 2 for complex α: the real and the imaginary part of ξ.
    """

    coupling: Callable
    enters: Callable | None
    n: int = eqx.field(static=True)
    parts: int = eqx.field(static=True)

    @property
    def size(self) -> int:
        """n, or 2 n."""
        return self.n * self.parts

    def vectors(self, xi):
        """(n, parts)."""
        return xi.reshape(self.parts, self.n).T

    def components(self, vectors):
        """(parts n,)."""
        return vectors.T.reshape(-1)

    def own(self, args):
        """The parameters of the system."""
        return args[0]

    def inputs(self, t, x, args, vectors: Columns):
        """α DH ξ."""
        own, strength = args
        return _times(strength, linear_at(lambda x: self.coupling(t, x, own), x)(vectors))

    def allows(self, jump: GuardJump, t, x, new, args, *which):
        """Not where it matters which of two systems jumps first."""
        order = order_of_jumps(self.coupling, self.enters, args, jump, t, x, new, *which)
        return ~(differ(order.before, order.after) | (order.depends & differ(*order.rates)))

    def of_inputs(self, function, args, resets: bool):
        """The function with c in its parameters; or, of a field or the rule of a map, plus c."""
        own = args[0]

        def of_both(t, both, *which):
            x, c = both[: self.n], both[self.n :]
            if self.enters is not None:
                return function(t, x, self.enters(own, c), *which)
            return function(t, x, own, *which) if resets else function(t, x, own) + c

        return of_both


class JumpOrder(NamedTuple):
    """What decides whether the order matters in which two systems jump."""

    before: Any  # (m,) the output of the coupling
    after: Any
    depends: Any  # whether guard or reset depend on the input
    rates: tuple[Any, Any]  # (m,) of the output, before and after


def order_of_jumps(coupling, enters, args, jump: GuardJump, t, x, new, *which) -> JumpOrder:
    """Of a jump from x to `new`."""
    before, after = (coupling(t, one, args) for one in (x, new))
    if enters is None:
        return JumpOrder(before, after, jnp.asarray(False), (before, before))
    none = jnp.zeros_like(before)
    slopes = [
        jax.jacfwd(lambda c, one=one: one(t, x, enters(args, c), *which))(none) for one in (jump.guard, jump.reset)
    ]
    flows = (x, jump.before(t, x, args)), (new, jump.after(t, x, new, args, *which))
    rates = [jax.jvp(lambda t, x: coupling(t, x, args), (t, one), (jnp.ones_like(t), f))[1] for one, f in flows]
    return JumpOrder(before, after, jnp.any(jnp.stack([jnp.any(one != 0) for one in slopes])), tuple(rates))


def _times(strength, inputs):
    """(Re α + i Im α) times the inputs (m, parts), of two parts the real and the imaginary one."""
    real, imaginary = strength
    if inputs.shape[1] == 1:
        return real * inputs
    return real * inputs + imaginary * jnp.stack([-inputs[:, 1], inputs[:, 0]], axis=1)
