"""Systems whose flow and whose next event are known in closed form."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from .bound import require_callable
from .labels import check_labels, time_word, words
from .membership import Membership, membership

__all__ = ["EventDriven", "Schedule"]


class Schedule(eqx.Module):
    """Event prediction for a system of many bodies that does not recompute all predictions after each event.

    The state has one row per body and is held in comoving coordinates, which are constant between events. An event
    changes only the rows that it touches, and only predictions that involve them are renewed. Time counts from the
    last rebasing, at which comoving and ordinary coordinates are equal; so the motion must not depend on the time
    explicitly. No event may bring the guard of another one beyond zero: perturbations of such a run end as nonfinite.

    Args:
        init: ``(t, y, args) -> cache``, all predictions, a pytree of arrays.
        next: ``cache -> (t, which)``, time and label of the next event.
        update: ``(cache, t, y, args, which) -> cache`` after the event, y the state after it.
        shift: ``(cache, dt) -> cache`` for a rebasing by dt: all times in the cache decrease by dt.
        touch: ``which -> rows`` (r,), indices of the rows that the event changes, all different; r is fixed.
        flat: the state is (n,) instead of (N, d), and `touch` gives indices of its components.

    Raises:
        ValueError: if one of the five is not callable.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> def wall_ahead(t, y):  # balls (q, v) between two walls, 0 and 1, that do not see each other
        ...     q, v = y[:, 0] + t * y[:, 1], y[:, 1]
        ...     return t + jnp.where(v > 0, 1 - q, -q) / v
        >>> balls = lh.EventDriven(
        ...     flow=lambda dt, y, args: jnp.stack([y[:, 0] + dt * y[:, 1], y[:, 1]], axis=1),
        ...     next_event=None,
        ...     jump=lambda t, rows, args, which: jnp.stack([rows[:, 0] + 2 * t * rows[:, 1], -rows[:, 1]], axis=1),
        ...     guard=lambda t, rows, args, which: (rows[0, 0] + t * rows[0, 1]) * (1 - rows[0, 0] - t * rows[0, 1]),
        ...     schedule=lh.Schedule(
        ...         init=lambda t, y, args: wall_ahead(t, y),
        ...         next=lambda times: (jnp.min(times), jnp.argmin(times)),
        ...         update=lambda times, t, y, args, which: times.at[which].set(wall_ahead(t, y)[which]),
        ...         shift=lambda times, dt: times - dt,
        ...         touch=lambda which: which[None],
        ...     ),
        ... )
        >>> lh.trajectory(balls, [[0.5, 1.0], [0.25, -1.0]], t1=0.75, n=1).x[-1].round(12).tolist()
        [[0.75, -1.0], [0.5, 1.0]]

    Source:
        B. D. Lubachevsky, How to simulate billiards and similar systems, J. Comput. Phys. 94 (1991) 255,
        doi:10.1016/0021-9991(91)90222-7.
    """

    init: Callable
    next: Callable
    update: Callable
    shift: Callable
    touch: Callable
    flat: bool = eqx.field(static=True, default=False)

    def __check_init__(self):
        require_callable("init", self.init, "(t, y, args) -> cache")
        require_callable("next", self.next, "cache -> (t, which)")
        require_callable("update", self.update, "(cache, t, y, args, which) -> cache")
        require_callable("shift", self.shift, "(cache, dt) -> cache")
        require_callable("touch", self.touch, "which -> row indices")


class EventDriven(eqx.Module):
    """A system whose flow is known in closed form and whose next event is known exactly.

    Args:
        flow: ``(dt, t, x, args) -> x`` after the time dt without an event, from state x at time t.
        next_event: ``(t, x, args) -> (dt, which)``: the time to the next event (inf: none) and what it is, an
            integer or any pytree of integers (which pair, which wall). If its first leaf is negative, nothing happens
            at that time except that the prediction is renewed; this is not counted as a jump. It is asked again in the
            middle of a flight, also within rounding of the event, which it must not step over, and just after the
            event: a time that is computed as the next multiple of a period may do either; keep a timer in the state.
            Of events at one instant it chooses the first; that another order would lead elsewhere is not noted. An
            event that is due at once because a jump has brought its guard beyond zero, as the spike of a neuron that
            is lifted over its threshold, belongs to the instant of that jump. More than 64 at one instant, or than n if
            that is more, end the run as ``zeno``.
        jump: ``(t, x, args, which) -> x⁺``.
        guard: ``(t, x, args, which) -> scalar`` that falls through zero at the event: it gives the derivative of the
            event time with respect to the state.
        schedule: an `lh.Schedule`, for many bodies. The state is then (N, d), and x0 (N, d), or (m, N, d) for m runs
            at once; `flow` is ``(dt, y, args) -> x`` from comoving coordinates to ordinary ones; `jump` and `guard`
            get only the touched rows of the comoving state, in the order of `touch`; `next_event` is None.
        canonical: whether x = (q, p), and flow and jump conserve dq∧dp. Runs then start from the paired frame e_q1 …
            e_qn, e_pn … e_p1, with which λ_i + λ_{2n+1−i} = 0 up to rounding at all times, and no direction is lost.
        invertible: whether no event destroys a direction, as is promised by `canonical`, too: a run does not look then
            for directions that are lost, which costs r³ operations an event that touches r components.
        names: what the components of x are called, as for `lh.Flow`; of many bodies, x (N, d), the d columns.
        units: in which they are measured, likewise.
        time_unit: in which time is measured, as for `lh.Flow`.

    Raises:
        ValueError: if a function is not callable, or `next_event` and `schedule` are both given or both missing.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> ball = lh.EventDriven(
        ...     flow=lambda dt, t, x, g: jnp.array([x[0] + x[1] * dt - g * dt**2 / 2, x[1] - g * dt]),
        ...     next_event=lambda t, x, g: ((x[1] + jnp.sqrt(x[1] ** 2 + 2 * g * x[0])) / g, 0),
        ...     jump=lambda t, x, g, which: jnp.array([0 * x[0], -0.8 * x[1]]),
        ...     guard=lambda t, x, g, which: x[0],
        ... )
    """

    flow: Callable
    next_event: Any  # a function; None if there is a schedule
    jump: Callable
    guard: Callable
    schedule: Any = None
    canonical: bool = eqx.field(static=True, default=False)
    invertible: bool = eqx.field(static=True, default=False, kw_only=True)
    names: tuple[str, ...] | None = eqx.field(static=True, default=None, converter=words, kw_only=True)
    units: tuple[str, ...] | None = eqx.field(static=True, default=None, converter=words, kw_only=True)
    time_unit: str | None = eqx.field(static=True, default=None, converter=time_word, kw_only=True)

    def __check_init__(self):
        check_labels(self.names, self.units)
        if (self.next_event is None) == (self.schedule is None):
            raise ValueError(
                "EventDriven needs exactly one of next_event (a function) and schedule (an lh.Schedule, for many "
                f"bodies); got next_event={self.next_event!r}, schedule={self.schedule!r}."
            )
        if self.schedule is None:
            require_callable("flow", self.flow, "(dt, t, x, args) -> x")
            require_callable("next_event", self.next_event, "(t, x, args) -> (dt, which)")
        else:
            require_callable("flow", self.flow, "(dt, y, args) -> x")
            if not isinstance(self.schedule, Schedule):
                raise ValueError(f"schedule must be an lh.Schedule; got {self.schedule!r}.")
        require_callable("jump", self.jump, "(t, x, args, which) -> x")
        require_callable("guard", self.guard, "(t, x, args, which) -> scalar")

    @property
    def has_rows(self) -> bool:
        """Whether a state is (N, d), a row for each body, and not (n,)."""
        return self.schedule is not None and not self.schedule.flat

    def velocity(self, t: Any, x: Any, args: Any = None) -> Array:
        """The velocity dx/dt (n,) at the time t and the state x (n,), with the parameters args.

        It is the derivative of the flow at dt = 0; not for a system with a schedule.
        """
        zero = jnp.zeros_like(t)
        return jax.jvp(lambda dt: self.flow(dt, t, x, args), (zero,), (jnp.ones_like(t),))[1]

    def contains(self, x: Any, args: Any = None, *, t: Any = 0.0) -> Membership:
        """Whether x is in the flow set, the whole space, and in the jump set, where the time to the next event is 0.

        Args:
            x: state, (n,) or of many bodies (N, d).
            args: pytree of parameters.
            t: the time.

        Returns:
            As `Hybrid.contains`: `flow` and `jump`, up to rounding; `.where` is "C" or "both".
        """
        return membership(self, x, args, t, None)
