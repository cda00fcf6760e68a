"""Perturbations of identical systems, coupled, along one mode of their coupling.

    xᵢ' = f(xᵢ) + s Σⱼ Gᵢⱼ H(xⱼ),   Σⱼ Gᵢⱼ = 0

has the solution x₁ = … = x_N = x(t) of one system alone. Along an eigenvector of G with the eigenvalue γ a perturbation
moves as ξ' = (Df + α DH) ξ, α = s γ. At a jump each system meets its guard at its own instant; in between some have
jumped and some have not, and what these do to each other depends on their order, unless

    H(x⁺) = H(x⁻),   and, where guard or reset depend on the input of the coupling, DH f⁺ = DH f⁻.

Then S is the saltation matrix of one system, with the input α DH ξ. Clocks tick for all at once, and ask nothing.
"""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp

from ..._jax.columns import linear_at
from .skew_products import Cocycle, Columns

__all__ = ["CoupledMode"]


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

    def of_inputs(self, function, args, resets: bool):
        """The function with c in its parameters; or, of a field or the rule of a map, plus c."""
        own = args[0]

        def of_both(t, both, *which):
            x, c = both[: self.n], both[self.n :]
            if self.enters is not None:
                return function(t, x, self.enters(own, c), *which)
            return function(t, x, own, *which) if resets else function(t, x, own) + c

        return of_both


def _times(strength, inputs):
    """(Re α + i Im α) times the inputs (m, parts), of two parts the real and the imaginary one."""
    real, imaginary = strength
    if inputs.shape[1] == 1:
        return real * inputs
    return real * inputs + imaginary * jnp.stack([-inputs[:, 1], inputs[:, 0]], axis=1)
