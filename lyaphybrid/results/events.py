"""The list of the events of a trajectory."""

from collections.abc import Iterator
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array

from .._jax.tracing import traced
from .._text import Table, as_html, as_text
from ..systems.labels import Labels

__all__ = ["Events"]

PRINTED_COLUMNS = 13  # of a table of events: those of systems of up to four components


class Events(eqx.Module):
    """The jumps of a trajectory, in order.

    Attributes:
        t: (e,) times.
        transition: (e,) index of the transition; `which`: (e,) component of a vector guard (0 for a scalar one).
        mode_before, mode_after: (e,) indices of modes.
        x_before, x_after: (e, n).
        state_labels: names and units of the components of a state, and the unit of time.

    It prints as a table of the first and the last events. Iterating gives a dictionary of single numbers for each
    event, so that ``pandas.DataFrame(events)`` is a table, too.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> ball = lh.Hybrid(
        ...     lambda t, x, args: jnp.stack([x[1], 0 * x[1] - 1.0]),
        ...     lh.Transition(lambda t, x, args: x[0], lambda t, x, args: jnp.stack([x[0], -x[1]])),
        ...     names=("height", "speed"),
        ... )
        >>> events = lh.trajectory(ball, [0.5, 0.0], t1=4.0, n=8).events
        >>> [(round(event["t"], 6), round(event["speed_after"], 6)) for event in events]
        [(1.0, 1.0), (3.0, 1.0)]
    """

    t: Array
    transition: Array
    which: Any
    mode_before: Array
    mode_after: Array
    x_before: Array
    x_after: Array
    state_labels: Labels = eqx.field(static=True, default=Labels())

    def __len__(self) -> int:
        return self.t.shape[0]

    def __iter__(self) -> Iterator[dict[str, Any]]:
        columns = {"t": self.t, "transition": self.transition}
        parts = jax.tree.leaves(self.which)  # of some systems several numbers say which guard it was
        columns |= {"which": parts[0]} if len(parts) == 1 else {f"which_{i}": part for i, part in enumerate(parts)}
        columns |= {"mode_before": self.mode_before, "mode_after": self.mode_after}
        for side, states in (("before", self.x_before), ("after", self.x_after)):
            flat = np.reshape(states, (len(self), int(np.prod(np.shape(states)[1:]))))
            columns |= {f"{self.state_labels.name(i)}_{side}": column for i, column in enumerate(flat.T)}
        lists = [np.asarray(column).tolist() for column in columns.values()]
        return (dict(zip(columns, row, strict=True)) for row in zip(*lists, strict=True))

    def _shown(self) -> Table:
        if traced(self):
            return Table("Events(under a transformation)")
        rows = list(self)
        names = tuple(rows[0]) if rows else ()
        kept, left = names[:PRINTED_COLUMNS], len(names[PRINTED_COLUMNS:])
        cells = [[f"{row[name]:.6g}" for name in kept] for row in rows]
        more = (f"and {left} more columns: pandas.DataFrame(events) has all of them",) if left else ()
        return Table(f"{len(rows)} events", cells, more, kept)

    def _repr_html_(self) -> str:
        """What a notebook shows."""
        return as_html(self._shown())

    def __str__(self) -> str:
        return as_text(self._shown())

    __repr__ = __str__
