"""Events as SBML defines them, as one `lh.Hybrid` whose parameters are the model: one program for all models.

An event of SBML is triggered when its condition turns from false to true, and is carried out after its delay: with the
values of the one instant or of the other, in the order of the priorities, and not at all if the condition turns false
before and the event is not persistent. So each event has three guards: it is triggered, its condition turns false, it
is due. They come in this order, events by falling priority: of several guards that are beyond zero the first fires.

The state is (quantities (N,), then of each event: armed, pending, time until due, values that it will assign (N,)).
"""

import dataclasses
import re

import jax.numpy as jnp
import numpy as np

import lyaphybrid as lh

QUANTITIES, EVENTS, REACTIONS = 4, 4, 4  # of the largest model
TERMS = QUANTITIES + 2  # of a linear expression: quantities, 1, time


@dataclasses.dataclass(frozen=True)
class Event:
    """`trigger`: "S1 < 0.1", two conditions joined by "and"; `assign`: {"S1": "S2 + 0.5 time"}."""

    trigger: str
    assign: dict[str, str]
    delay: float = 0.0
    persistent: bool = True
    at_trigger: bool = True  # the values assigned are those of the instant of the trigger
    initially: bool = True  # what the condition counts as before the start


@dataclasses.dataclass(frozen=True)
class Model:
    """`reactions`: "0.75: S1 + 2 S2 -> S3" has the rate 0.75 S1 S2; events by falling priority."""

    start: dict[str, float]
    reactions: list[str]
    events: list[Event]


# --- the system ----------------------------------------------------------------------------------------------------


def _parts(x):
    events = x[QUANTITIES:].reshape(EVENTS, 3 + QUANTITIES)
    return x[:QUANTITIES], events[:, 0] > 0.5, events[:, 1] > 0.5, events[:, 2], events[:, 3:]


def _joined(quantities, armed, pending, due, values):
    columns = [armed.astype(due.dtype)[:, None], pending.astype(due.dtype)[:, None], due[:, None], values]
    return jnp.concatenate([quantities, jnp.concatenate(columns, axis=1).ravel()])


def _terms(t, quantities):
    return jnp.concatenate([quantities, jnp.stack([jnp.ones_like(t), t])])


def _margins(t, quantities, p):
    """(EVENTS,) positive where the condition of an event is true."""
    terms = _terms(t, quantities)
    return (p["trigger"] @ terms) * (p["also"] @ terms)


def _field(t, x, p):
    quantities, armed, pending, due, values = _parts(x)
    terms = _terms(t, quantities)
    rates = (p["first"] @ terms) * (p["second"] @ terms)
    still = jnp.zeros_like(due)
    return _joined(p["change"] @ rates, still, still, -pending.astype(due.dtype), jnp.zeros_like(values))


def _guards(t, x, p):
    """(3 EVENTS,) falling through zero: an event is triggered, its condition turns false, it is due."""
    quantities, armed, pending, due, _ = _parts(x)
    margins = _margins(t, quantities, p)
    remaining = jnp.where(p["delay"] > 0, due, -1.0)
    return jnp.concatenate(
        [jnp.where(armed, -margins, 1.0), jnp.where(armed, 1.0, margins), jnp.where(pending, remaining, 1.0)]
    )


def _reset(t, x, p, which):
    quantities, armed, pending, due, values = _parts(x)
    kind, event = which // EVENTS, which % EVENTS
    this = jnp.arange(EVENTS, dtype=which.dtype) == event
    now = jnp.where(p["assigned"] > 0.5, p["values"] @ _terms(t, quantities), quantities[None, :])
    margins = _margins(t, quantities, p)
    # All that are triggered at this instant, before any is carried out.
    triggered = (kind == 0) & armed & (margins >= jnp.minimum(margins[event], 0.0))
    ended, done = (kind == 1) & this, (kind == 2) & this
    chosen = jnp.where(p["at_trigger"][event] > 0.5, values[event], now[event])
    quantities = jnp.where((kind == 2) & (p["assigned"][event] > 0.5), chosen, quantities)
    cancelled = done | (ended & (p["persistent"] < 0.5))
    return _joined(
        quantities,
        (armed | ended) & ~triggered,
        (pending & ~cancelled) | triggered,
        jnp.where(triggered, p["delay"], due),
        jnp.where(triggered[:, None], now, values),
    )


SYSTEM = lh.Hybrid(_field, lh.Transition(_guards, _reset), max_cascade=32)


# --- its parameters --------------------------------------------------------------------------------------------------


def _linear(text: str, names: list[str]) -> np.ndarray:
    """(TERMS,) coefficients of a sum such as "0.25 time + S1 - 2"."""
    row = np.zeros(TERMS)
    for term in text.replace("- ", "+ -").split("+"):
        words = term.strip().removeprefix("-").split()
        factor = np.prod([float(word) for word in words if word[0].isdigit()])
        name = [word for word in words if not word[0].isdigit()]
        where = QUANTITIES if not name else QUANTITIES + 1 if name == ["time"] else names.index(name[0])
        row[where] += -factor if term.strip().startswith("-") else factor
    return row


def _condition(text: str, names: list[str]) -> np.ndarray:
    left, sign, right = re.fullmatch(r"(.*?)\s*([<>])=?\s*(.*)", text).groups()
    return (_linear(left, names) - _linear(right, names)) * (1.0 if sign == ">" else -1.0)


def _side(text: str) -> list[tuple[float, str]]:
    """The reactants or products "S1 + 2 S2": numbers and names."""
    words = [term.split() for term in text.split("+") if term.strip()]
    return [(float(word[0]) if len(word) > 1 else 1.0, word[-1]) for word in words]


def translated(model: Model):
    """The start (n,) and the parameters of `SYSTEM`."""
    names, one = list(model.start), np.eye(TERMS)[QUANTITIES]
    p = {
        "first": np.zeros((REACTIONS, TERMS)),
        "second": np.tile(one, (REACTIONS, 1)),
        "change": np.zeros((QUANTITIES, REACTIONS)),
        "trigger": np.tile(-one, (EVENTS, 1)),  # never
        "also": np.tile(one, (EVENTS, 1)),
        "values": np.zeros((EVENTS, QUANTITIES, TERMS)),
        "assigned": np.zeros((EVENTS, QUANTITIES)),
        "delay": np.zeros(EVENTS),
        "persistent": np.ones(EVENTS),
        "at_trigger": np.ones(EVENTS),
    }
    for j, reaction in enumerate(model.reactions):
        factor, left, right = re.fullmatch(r"(.*):(.*)->(.*)", reaction).groups()
        reactants = [np.eye(TERMS)[names.index(name)] for _, name in _side(left)]
        p["first"][j], p["second"][j] = [*reactants, one, one][:2]
        p["first"][j] *= float(factor)
        for sign, side in ((-1, left), (1, right)):
            for number, name in _side(side):
                p["change"][names.index(name), j] += sign * number
    x0 = np.zeros((EVENTS, 3 + QUANTITIES))
    for i, event in enumerate(model.events):
        conditions = event.trigger.split(" and ")
        p["trigger"][i] = _condition(conditions[0], names)
        if len(conditions) == 2:
            p["also"][i] = _condition(conditions[1], names)
        for name, value in event.assign.items():
            p["values"][i, names.index(name)] = _linear(value, names)
            p["assigned"][i, names.index(name)] = 1
        p["delay"][i], p["persistent"][i], p["at_trigger"][i] = event.delay, event.persistent, event.at_trigger
    x0[:, 0] = _begun(p, model)
    quantities = np.zeros(QUANTITIES)
    quantities[: len(names)] = list(model.start.values())
    return np.concatenate([quantities, x0.ravel()]), p


def _begun(p, model: Model) -> np.ndarray:
    """(EVENTS,) whether each event is armed at the start; one that is triggered there waits for time to be positive."""
    terms = np.zeros(TERMS)
    terms[: len(model.start)], terms[QUANTITIES] = list(model.start.values()), 1.0
    margins = (p["trigger"] @ terms) * (p["also"] @ terms)
    armed = margins < 0
    for i, event in enumerate(model.events):
        armed[i] |= not event.initially
        if not event.initially and margins[i] > 0:
            p["also"][i] = np.eye(TERMS)[-1]
    return armed
