"""Balls that fly to and fro between two walls, one row each, with a schedule: the example of `lh.Schedule`."""

import jax.numpy as jnp

import lyaphybrid as lh

START = [[0.5, 1.0], [0.25, -1.0]]  # position and velocity


def _wall_ahead(t, y):
    q, v = y[:, 0] + t * y[:, 1], y[:, 1]
    return t + jnp.where(v > 0, 1 - q, -q) / v


def between_walls(**labels) -> lh.EventDriven:
    """The system, with names and units."""
    return lh.EventDriven(
        flow=lambda dt, y, args: jnp.stack([y[:, 0] + dt * y[:, 1], y[:, 1]], axis=1),
        next_event=None,
        jump=lambda t, rows, args, which: jnp.stack([rows[:, 0] + 2 * t * rows[:, 1], -rows[:, 1]], axis=1),
        guard=lambda t, rows, args, which: (rows[0, 0] + t * rows[0, 1]) * (1 - rows[0, 0] - t * rows[0, 1]),
        schedule=lh.Schedule(
            init=lambda t, y, args: _wall_ahead(t, y),
            next=lambda times: (jnp.min(times), jnp.argmin(times)),
            update=lambda times, t, y, args, which: times.at[which].set(_wall_ahead(t, y)[which]),
            shift=lambda times, dt: times - dt,
            touch=lambda which: which[None],
        ),
        **labels,
    )
