"""The earliest of many predicted events, at a cost that grows with the logarithm of their number."""

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

__all__ = ["EventQueue"]

GROUP = 8  # times compared at once: as many as fit into a vector or two


class EventQueue(eqx.Module):
    """Times of the next events of n bodies, one a body, of which the earliest is known at any time.

    A tree: the earliest of every 8 times, the earliest of every 8 of those, and so on. A new time changes one
    number a level, log₈ n in all. It is made for the cache of an `lh.Schedule`: `next` is then
    ``lambda queue: queue.first()`` and `shift` is ``lambda queue, dt: queue.earlier(dt)``.

    Args:
        times: (n,) time of each body's next event; inf: none.

    Attributes:
        levels: the times, padded with inf to a multiple of 8, then the levels above them.

    Raises:
        ValueError: if times is not (n,) with n ≥ 1.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> queue = lh.EventQueue(jnp.array([3.0, 1.0, 2.0]))
        >>> [one.item() for one in queue.first()]
        [1.0, 1]
        >>> [one.item() for one in queue.replaced(jnp.array([1]), jnp.array([5.0])).first()]
        [2.0, 2]
    """

    levels: tuple[Array, ...]

    def __init__(self, times: Float[Array, " n"]):
        times = jnp.asarray(times)
        if times.ndim != 1 or times.shape[0] == 0:
            raise ValueError(f"times must have the shape (n,), a time for each of n ≥ 1 bodies; got {times.shape}.")
        levels = [_padded(times)]
        while levels[-1].shape[0] > GROUP:
            levels.append(_padded(jnp.min(levels[-1].reshape(-1, GROUP), axis=1)))
        self.levels = tuple(levels)

    def first(self) -> tuple[Array, Array]:
        """The earliest time and the number of its body, an int32; of several the first."""
        body = jnp.asarray(0, jnp.int32)
        for level in reversed(self.levels):
            group = lax.dynamic_slice(level, (GROUP * body,), (GROUP,))
            body = GROUP * body + jnp.argmin(group).astype(jnp.int32)
        return self.levels[0][body], body

    def replaced(self, bodies: Int[Array, " m"], times: Float[Array, " m"]) -> "EventQueue":
        """The queue with new times of these bodies, which are all different."""
        levels, places, values = [], bodies, times
        for level in self.levels:
            level = level.at[places].set(values)
            places = places // GROUP
            values = jnp.min(level.reshape(-1, GROUP)[places], axis=1)
            levels.append(level)
        return self._of(levels)

    def earlier(self, dt: Float[Array, ""]) -> "EventQueue":
        """The queue with all times earlier by dt, as after a rebasing."""
        return self._of([level - dt for level in self.levels])

    def _of(self, levels: list[Array]) -> "EventQueue":
        return eqx.tree_at(lambda queue: queue.levels, self, tuple(levels))


def _padded(times: Array) -> Array:
    """The times with as many inf after them as fill the last group."""
    return jnp.concatenate([times, jnp.full(-times.shape[0] % GROUP, jnp.inf, times.dtype)])
