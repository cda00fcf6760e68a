"""Whether an event-driven system predicts the same event from everywhere on the way to it, and only once.

A flight may be interrupted anywhere, by an orthonormalisation or the end of a block, and `next_event` is asked again.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..._jax.engines import for_once
from ..._jax.precision import is_short
from ...statuses import STATUS
from ...systems.event_driven import EventDriven
from ..spectra import lyapunov_spectrum
from ..trajectories import Trajectory
from .report import Finding, right, wrong

__all__ = ["check_instants", "check_predictions"]

FLIGHTS = 12  # looked at: from the start, and from the first events
PARTS = (0.5, 1e-3)  # of a flight that are left
LAST_DIGITS = (64.0, 16.0, 4.0)  # the same, in last digits of the time
BEGINS, AT_ONCE_WITHIN = (-4.0, -2.0, -1.0, 0.0), 64.0  # a flight may begin, a second event may come: last digits


class _Flight(NamedTuple):
    """A flight from (t, x) to the next event: after the time dt, called `which`."""

    t: float
    x: np.ndarray
    dt: float
    which: list


def check_instants(system: Any, args: Any, run: Trajectory, start: tuple) -> list[Finding]:
    """Whether a perturbation passes the events of a run from `start`, (t, x), of a system with a schedule."""
    t, x = start
    length = float(run.t[-1]) - float(t)
    if not isinstance(system, EventDriven) or system.schedule is None or is_short(x) or not 0 < length < np.inf:
        return []
    passed = lyapunov_spectrum(system, x, args, t0=float(t), t1=length, transient=0.0, k=1, throw=False)
    if passed.status is not STATUS.nonfinite:
        return [right("instants", f"no event of {len(run.events)} was brought about by another one's jump")]
    at = f"An event at t = {float(passed.t):.6g} comes at once after another, whose jump brought it about."
    return [wrong("instants", f"{at} With a schedule perturbations cannot pass it: give next_event instead.")]


def check_predictions(system: Any, args: Any, run: Trajectory, start: tuple) -> list[Finding]:
    """What `next_event` says along the first flights of a run from `start`, (t, x), if it is asked again."""
    if not isinstance(system, EventDriven) or system.schedule is not None or is_short(start[1]):
        return []

    def asked(t, x):
        dt, which = system.next_event(t, x, args)
        return [jnp.asarray(dt), jnp.concatenate([jnp.ravel(leaf) for leaf in jax.tree.leaves(which)])]

    t, x = (np.asarray(one) for one in start)
    ask = for_once(asked, t, x)
    fly = for_once(lambda dt, t, x: [system.flow(dt, t, x, args)], t, t, x)

    def event(t, x, flown=0.0) -> _Flight:
        """The flight that begins after the time `flown` of the flight from (t, x)."""
        flown, t = np.asarray(flown, x.dtype), np.asarray(t, x.dtype)
        if flown > 0:  # a flow over no time may round
            t, x = t + flown, np.asarray(fly(flown, t, x)[0])
        dt, which = (np.asarray(one) for one in ask(t, x))
        return _Flight(float(t), x, float(dt), which.tolist())

    e = run.events
    leaves = (np.asarray(leaf) for leaf in jax.tree.leaves(e.which))
    labels = np.concatenate([leaf.reshape(len(leaf), -1) for leaf in leaves], axis=1).tolist()
    begun = [(t, x, None), *zip(np.asarray(e.t), np.asarray(e.x_after), labels, strict=True)][:FLIGHTS]
    for t, x, last in begun:
        digit = float(np.spacing(np.abs(t)))
        for late in BEGINS:
            flight = event(t + late * digit, x)
            if flight.which == last and 0 <= flight.dt <= AT_ONCE_WITHIN * digit:
                return [wrong("prediction", _TWICE.format(last[0], t, flight.dt))]
    flights = [event(t, x) for t, x, _ in begun]
    return _from_midway(flights, event) or [
        right("prediction", f"next_event gives the same events from midway, over {len(flights)} flights")
    ]


def _from_midway(flights: list[_Flight], event) -> list[Finding]:
    """What is said from midway, where it is another event."""
    for t, x, dt, which in flights:
        if not np.isfinite(dt) or dt <= 0 or which[0] < 0:  # nothing but a new prediction is due there
            continue
        digit = float(np.spacing(max(abs(t + dt), dt, 1.0)))
        for left in (*(part * dt for part in PARTS), *(count * digit for count in LAST_DIGITS)):
            again = event(t, x, dt - left)
            if left > dt or abs(again.dt - left) <= 1e-6 * left + AT_ONCE_WITHIN * digit:
                continue
            near, found = left <= LAST_DIGITS[0] * digit, (which[0], t, dt, left, again.dt, again.which[0])
            return [wrong("prediction", (_SKIPPED if near else _ANOTHER).format(*found))]
    return []


_TWICE = (
    "next_event gives event {} once more, just after it has happened at t = {:.6g}: in {:.1e}. A time that is computed "
    "as the next multiple of a period is off by rounding; keep a timer in the state, or take lh.Hybrid with "
    "lh.Transition(every=…)."
)
_ANOTHER = (
    "Asked at the start of a flight, next_event gives event {} (from t = {:.6g} in {:.6g}); asked {:.3g} before that, "
    "it gives {:.6g} and event {}. It must give the same event from everywhere on the way: a run is interrupted by "
    "orthonormalisations and ends of blocks."
)
_SKIPPED = (
    "Asked at the start of a flight, next_event gives event {} (from t = {:.6g} in {:.6g}); asked {:.1e} before that, "
    "it steps over it ({:.6g}, event {}). Where an orthonormalisation or the end of a block comes as near, the event "
    "is lost: keep a timer in the state, or take lh.Hybrid with lh.Transition(every=…)."
)
