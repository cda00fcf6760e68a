"""Systems without events: a flow and an iterated map."""

from collections.abc import Callable
from typing import Any, ClassVar

import equinox as eqx

from .bound import require_callable
from .labels import check_labels, time_word, words
from .membership import Membership, membership

__all__ = ["Flow", "Map"]


class Flow(eqx.Module):
    """A smooth flow, dx/dt = field(t, x, args).

    A term of diffrax is ``lh.Flow(term.vector_field)``. A right side f(t, y) as SciPy takes it, if it is written with
    `jax.numpy`, is ``lh.Flow(lambda t, x, args: jnp.stack(f(t, x)))``, and f(t, y, a, b) is
    ``lh.Flow(lambda t, x, args: jnp.stack(f(t, x, *args)))`` with args=(a, b).

    Args:
        field: ``(t, x, args) -> dx/dt``, x and dx/dt of shape (n,).
        names: what the components of x are called, such as ("x", "v"); None: x0, x1, …. Tables, axes of pictures and
            datasets use them; nothing that is computed depends on them.
        units: in which they are measured, likewise, such as ("m", "m/s").
        time_unit: in which time is measured, such as "ms": axes, tables and datasets say it.

    Raises:
        ValueError: if ``field`` is not callable; on names that are not strings, or units that are not as many; on a
            `time_unit` that is no string.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> lh.Flow(lambda t, x, args: -args * x)  # doctest: +ELLIPSIS
        Flow(...)
        >>> swing = lh.Flow(lambda t, x, args: jnp.stack([x[1], -x[0]]), names=("x", "v"), units=("m", "m/s"))
        >>> lh.trajectory(swing, [1.0, 0.0], t1=1.0, n=4).to_xarray().state.values.tolist()
        ['x', 'v']
        >>> def right_side(t, y, k):  # of scipy.integrate.solve_ivp
        ...     return [y[1], -k * y[0]]
        >>> spring = lh.Flow(lambda t, x, args: jnp.stack(right_side(t, x, *args)))
        >>> round(float(lh.trajectory(spring, [1.0, 0.0], (4.0,), t1=1.0).x[-1, 0]), 6)  # cos 2
        -0.416147
    """

    field: Callable
    names: tuple[str, ...] | None = eqx.field(static=True, default=None, converter=words, kw_only=True)
    units: tuple[str, ...] | None = eqx.field(static=True, default=None, converter=words, kw_only=True)
    time_unit: str | None = eqx.field(static=True, default=None, converter=time_word, kw_only=True)

    def __check_init__(self):
        check_labels(self.names, self.units)
        require_callable("field", self.field, "(t, x, args) -> dx/dt")

    def contains(self, x: Any, args: Any = None, *, t: Any = 0.0) -> Membership:
        """Whether x (n,) is in the flow set, the whole space (always true), and in the jump set, which is empty.

        For a flow neither depends on `args` or on the time `t`: they are there as for `Hybrid.contains`.
        """
        return membership(self, x, args, t, None)


class Map(eqx.Module):
    """An iterated map, x⁺ = rule(n, x, args), where n is the iteration number as a float.

    Args:
        rule: ``(n, x, args) -> x⁺``, both of shape (n,).
        names: what the components of x are called, as for `lh.Flow`.
        units: in which they are measured, likewise.

    Raises:
        ValueError: if ``rule`` is not callable; on names that are not strings, or units that are not as many.

    Example:
        >>> import lyaphybrid as lh
        >>> logistic = lh.Map(lambda n, x, r: r * x * (1 - x))
    """

    rule: Callable
    names: tuple[str, ...] | None = eqx.field(static=True, default=None, converter=words, kw_only=True)
    units: tuple[str, ...] | None = eqx.field(static=True, default=None, converter=words, kw_only=True)
    time_unit: ClassVar[None] = None  # time is the number of iterations

    def __check_init__(self):
        check_labels(self.names, self.units)
        require_callable("rule", self.rule, "(n, x, args) -> next x")

    def contains(self, x: Any, args: Any = None, *, t: Any = 0.0) -> Membership:
        """Whether x (n,) is in the flow set, which is empty, and in the jump set, the whole space (always true).

        For a map neither depends on `args` or on the iteration `t`: they are there as for `Hybrid.contains`.
        """
        return membership(self, x, args, t, None)
