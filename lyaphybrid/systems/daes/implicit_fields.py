"""The field of a fully implicit DAE, and whether the kernel of ∂F/∂x' is still the one with which it was built."""

import textwrap
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .semi_linear import Constrained

__all__ = ["KERNEL_CHANGE", "ImplicitField", "in_few_words"]

KERNEL_CHANGE = 1e-8  # a component of ∂F/∂x' outside the row space of P counts from this part of its row on …
MIXED_ROWS = 1e-12  # … and from this part of the largest entry on: rows may be mixed, and terms in them cancel


class ImplicitField(Constrained):
    """The field of a DAE whose state is [x, v].

    Attributes:
        n: components of x.
        equations: ``(t, x, x', args) -> F`` (n,).
        built_with: the args with which P was determined, in few words.
        guessed: (d,) the guess of v that goes with x alone, from the slope with which P was determined.
    """

    n: int = eqx.field(static=True)
    equations: Callable
    built_with: str = eqx.field(static=True)
    guessed: tuple[float, ...] = eqx.field(static=True)

    def whole_guess(self, x):
        """The guess [x, v] for x (n,) alone; a whole state (n + d,) stays as it is."""
        return jnp.concatenate([x, jnp.asarray(self.guessed, x.dtype)]) if x.shape[0] == self.n else x

    def slope_matrices(self, t, x, args) -> tuple[Any, Any]:
        """At a state [x, v]: ∂F/∂x' Pᵀ (n, d), and the part of ∂F/∂x' (n, n) outside the row space of P."""
        back = jnp.asarray(self.rows(t, args)[:, : self.n].T, x.dtype)
        whole = jax.jacfwd(lambda dx: self.equations(t, x[: self.n], dx, args))(back @ x[self.n :])
        inside, size = whole @ back, jnp.abs(whole)
        outside = whole - inside @ back.T
        counts = KERNEL_CHANGE * jnp.max(size, axis=1, keepdims=True), MIXED_ROWS * jnp.max(size)
        return inside, jnp.where((jnp.abs(outside) > counts[0]) & (jnp.abs(outside) > counts[1]), outside, 0.0)

    def singularities(self, t, x, args):
        """As of any field; and whether F contains other components of x' than v."""
        _, outside = self.slope_matrices(t, x, args)
        more, (nearly, singular) = jnp.any(outside != 0), super().singularities(t, x, args)
        return nearly | more, singular | more


def in_few_words(args: Any) -> str:
    """Parameters as they stand in a message."""

    def plain(leaf):
        return np.asarray(leaf).tolist() if np.size(leaf) < 10 else f"an array {np.shape(leaf)}"

    return textwrap.shorten(repr(jax.tree.map(plain, args)), 160, placeholder=" …")
