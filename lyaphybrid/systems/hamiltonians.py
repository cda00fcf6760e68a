"""Hamiltonian systems, x = (q, p): equations of motion by automatic differentiation of H.

`Hamiltonian(kinetic, potential)` keeps the two parts of H = T(p) + V(q), which symplectic schemes integrate
alternately. `canonical_flow(energy)` takes any H(q, p).
"""

from collections.abc import Callable, Sequence
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._jax.jaxprs import is_affine
from .bound import require_callable
from .labels import time_word, words
from .smooth import Flow

__all__ = ["Hamiltonian", "HamiltonianField", "SeparableField", "canonical_flow"]


def halves(x: Float[Array, " 2m"]) -> tuple[Float[Array, " m"], Float[Array, " m"]]:
    """The positions q and the momenta p of a state x = (q, p)."""
    m = x.shape[0] // 2
    return x[:m], x[m:]


class SeparableField(eqx.Module):
    """The field of H = T(p) + V(q), and its parts.

    Attributes:
        kinetic: ``(p, args) -> T``.
        potential: ``(q, args) -> V``.
    """

    kinetic: Callable
    potential: Callable

    def __call__(self, t, x, args):
        """(dq/dt, dp/dt) = (∂T/∂p, −∂V/∂q)."""
        del t
        q, p = halves(x)
        return jnp.concatenate([self.velocity(p, args), self.force(q, args)])

    def velocity(self, p, args):
        """∂T/∂p (m,)."""
        return jax.grad(self.kinetic)(p, args)

    def force(self, q, args):
        """−∂V/∂q (m,)."""
        return -jax.grad(self.potential)(q, args)

    def energy(self, x, args):
        """H = T(p) + V(q)."""
        q, p = halves(x)
        return self.kinetic(p, args) + self.potential(q, args)

    def require_quadratic(self, args, p, name: str) -> None:
        """Raise a ValueError unless the jaxpr of ∂T/∂p shows that T is quadratic in p (m,)."""
        if not is_affine(lambda p: self.velocity(p, args), p):
            raise ValueError(
                f"{name} needs a kinetic energy that is quadratic in p; this one is not seen to be. Take a scheme "
                "without a corrector, such as 'ABA864'."
            )

    def slope_of_bracket(self, q, args):
        """∂(C/2)/∂q (m,) of C = {{T, V}, V} = ∇Vᵀ T'' ∇V, where T is quadratic in p: D²V T'' ∇V."""
        force, along = jax.linearize(lambda q: self.force(q, args), q)
        return along(jax.jvp(lambda p: self.velocity(p, args), (jnp.zeros_like(force),), (force,))[1])


class Hamiltonian(Flow):
    """H = kinetic(p, args) + potential(q, args), x = (q, p) with n = 2m components.

    The field is (∂T/∂p, −∂V/∂q), by `jax.grad`. Runs start from the paired frame e_q1 … e_qm, e_pm … e_p1, with which
    λ_i + λ_{2m+1−i} = 0 up to rounding at all times under a symplectic method.

    Args:
        kinetic: ``(p, args) -> number``, p (m,).
        potential: ``(q, args) -> number``, q (m,).
        names: what the 2m components of x are called, as for `lh.Flow`.
        units: in which they are measured, likewise.
        time_unit: in which time is measured, as for `lh.Flow`.

    Raises:
        ValueError: if one of them is not callable.

    Source:
        Ch. Skokos & E. Gerlach, Numerical integration of variational equations, Phys. Rev. E 82 (2010) 036704,
        doi:10.1103/PhysRevE.82.036704.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> pendulum = lh.Hamiltonian(lambda p, args: jnp.sum(p**2) / 2, lambda q, args: -jnp.sum(jnp.cos(q)))
        >>> float(pendulum.energy(jnp.array([0.0, 2.0]), None))
        1.0
    """

    canonical: ClassVar[bool] = True

    def __init__(
        self,
        kinetic: Callable,
        potential: Callable,
        *,
        names: Sequence[str] | None = None,
        units: Sequence[str] | None = None,
        time_unit: str | None = None,
    ):
        require_callable("kinetic", kinetic, "(p, args) -> number")
        require_callable("potential", potential, "(q, args) -> number")
        self.field = SeparableField(kinetic, potential)
        self.names, self.units, self.time_unit = words(names), words(units), time_word(time_unit)

    def energy(self, x: Any, args: Any = None) -> Float[Array, ""]:
        """The value of H at a state x (2m,) with the parameters args."""
        return self.field.energy(x, args)  # pyright: ignore[reportFunctionMemberAccess]


class HamiltonianField(eqx.Module):
    """The field J ∇H of any Hamiltonian."""

    hamiltonian: Callable

    def __call__(self, t, x, args):
        """(dq/dt, dp/dt) = (∂H/∂p, −∂H/∂q)."""
        del t
        by_q, by_p = jax.grad(self.hamiltonian, argnums=(0, 1))(*halves(x), args)
        return jnp.concatenate([by_p, -by_q])

    def energy(self, x, args):
        """H(q, p)."""
        return self.hamiltonian(*halves(x), args)


class _CanonicalFlow(Flow):
    """An `lh.Flow` that is canonical: it conserves dq∧dp."""

    canonical: ClassVar[bool] = True

    def energy(self, x, args: Any = None):
        """The value of H at a state x (2m,)."""
        return self.field.energy(x, args)  # pyright: ignore[reportFunctionMemberAccess]


def canonical_flow(
    energy: Callable,
    *,
    names: Sequence[str] | None = None,
    units: Sequence[str] | None = None,
    time_unit: str | None = None,
) -> Flow:
    """The flow of any Hamiltonian H(q, p), for Runge–Kutta methods or an `lh.Splitting`.

    Args:
        energy: ``(q, p, args) -> number``, q and p (m,).
        names: what the 2m components of x are called, as for `lh.Flow`.
        units: in which they are measured, likewise.
        time_unit: in which time is measured, as for `lh.Flow`.

    Returns:
        An `lh.Flow` with x = (q, p), whose runs start from the paired frame; its ``energy(x, args)`` is H.

    Raises:
        ValueError: if `energy` is not callable.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> rotor = lh.canonical_flow(lambda q, p, args: jnp.sum(p**2) / 2 + jnp.sum(q * p))
        >>> rotor.field(0.0, jnp.array([1.0, 2.0]), None).tolist()
        [3.0, -2.0]
    """
    require_callable("energy", energy, "(q, p, args) -> number")
    return _CanonicalFlow(HamiltonianField(energy), names=names, units=units, time_unit=time_unit)
