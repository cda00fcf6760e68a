"""Perturbations of a part of a system: of what another part drives, or across a subspace in which the motion stays."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .checking import differ
from .skew_products import Cocycle, GuardJump

__all__ = ["Across", "Inside", "Response"]

LEAST_LEFT = 1e-9  # relative: less than this outside a subspace is rounding


class Response(Cocycle):
    """Perturbations of some components, the response; all others, the drive, go on as they are.

    Attributes:
        of: indices of the response.
        n: dimension of x.
    """

    of: tuple[int, ...] = eqx.field(static=True)
    n: int = eqx.field(static=True)

    @property
    def size(self) -> int:
        """How many components the response has."""
        return len(self.of)

    def vectors(self, xi):
        """(n, 1): zero in the drive."""
        return jnp.zeros((self.n, 1), xi.dtype).at[np.array(self.of), 0].set(xi)

    def components(self, vectors):
        """The response alone."""
        return vectors[np.array(self.of), 0]

    def allows(self, jump: GuardJump, t, x, new, args, *which):
        """Not where the response decides when the drive is moved."""
        drive, slopes = np.setdiff1d(np.arange(self.n), self.of), jax.grad(lambda x: jump.guard(t, x, args, *which))(x)
        before, after = jump.before(t, x, args), jump.after(t, x, new, args, *which)
        moved = differ(x[drive], new[drive]) | differ(before[drive], after[drive])
        return ~(moved & jnp.any(slopes[np.array(self.of)] != 0))


class Inside(eqx.Module):
    """A function (t, x, args, …) -> (n,) whose values are kept in a subspace, against rounding."""

    function: Callable
    basis: Float[Array, "n m"]  # orthonormal

    def __call__(self, t, x, args, *which):
        """Its value, without what is outside."""
        return self.basis @ (self.basis.T @ self.function(t, x, args, *which))


class Across(Cocycle):
    """Perturbations modulo a subspace in which x stays: their components orthogonal to it.

    Attributes:
        basis: (n, m) orthonormal, of the subspace.
        rest: (n, n − m) orthonormal, of its complement.
    """

    basis: Float[Array, "n m"]
    rest: Float[Array, "n size"]

    @property
    def size(self) -> int:
        """The dimension of the complement, n − m."""
        return self.rest.shape[1]

    def vectors(self, xi):
        """(n, 1) in the complement."""
        return (self.rest @ xi)[:, None]

    def components(self, vectors):
        """The components in the complement."""
        return self.rest.T @ vectors[:, 0]

    def base(self, function):
        """The function kept in the subspace."""
        return Inside(function, self.basis)

    def off(self, vector):
        """The size of a vector outside the subspace, beyond rounding; 0 where there is none."""
        off = jnp.max(jnp.abs(self.rest.T @ vector))
        return jnp.where(off > LEAST_LEFT * (1 + jnp.max(jnp.abs(vector))), off, 0.0)

    def allows(self, jump: GuardJump, t, x, new, args, *which):
        """Not where a jump leaves the subspace."""
        del jump, t, x, args, which
        return self.off(new) == 0
