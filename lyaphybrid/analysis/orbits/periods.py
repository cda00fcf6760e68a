"""Which functions of a system depend on time, and whether they repeat after a given period; if not, their period.

The user's functions are evaluated at some times and states, and again one or many periods later: after many periods the
shift by a wrong period is large, so that jumps between samples are seen too. If the functions do not repeat, their
period is searched: autocorrelations on windows of many lengths give it roughly, growing multiples of it precisely.
"""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..._arguments import require
from ..._jax.engines import compiled
from ..._jax.jaxprs import needed
from ..._jax.tracing import array, traced
from ...engine.binding import number
from ...systems.daes.semi_linear import Constrained
from ...systems.event_driven import EventDriven
from ...systems.hybrid import Hybrid, Transition
from ...systems.kinds import iterates
from ...systems.smooth import Flow, Map
from ...systems.validation import check_functions

__all__ = ["check_period", "depends_on_time", "seeming_period", "uses_time"]

TIMES_COMPARED = np.array(
    [0.0, 0.1234, 1.3, 17.7]
)  # times at which the functions are compared for a dependence on time
TIMES_CHECKED = 64  # number of times at which a period is checked
SPREAD = np.modf(np.arange(1, TIMES_CHECKED + 1) * np.sqrt(2))[0]  # in periods; jumps there are unlikely
PERIODS_CHECKED = np.round(
    1 + 4000 * (np.arange(TIMES_CHECKED) / TIMES_CHECKED) ** 2
)  # number of periods after which each is checked
MOST_TICKS = 1e6  # of a clock in one period
EQUAL_VALUES = 1e-9  # relative tolerance for times and for values of functions
CONTACTS = 8  # components of a vector guard whose resets are checked
SECOND_STATE_DISTANCE = 0.1  # relative distance of a second state
SCALES = 4.0 ** np.arange(-6, 9)  # windows of the search, in units of the given period
LARGEST_DISTANCE = 0.1  # largest `_distance` of values a period apart
SHARES = np.linspace(-1, 1, 33)  # trial periods within a bracket
MULTIPLES = 4.0 ** np.arange(11)  # numbers of periods for the refinement
PRIMES = (2, 3, 5, 7, 11, 13)
COLUMNS = 16  # largest number of values that are compared through a window
MINIMA = 20  # largest number of minima that are tried in a window


class Misfit(NamedTuple):
    """A function that does not repeat, with the place of its largest difference."""

    name: str
    t: float
    turns: float
    difference: float
    size: float


def check_period(system: Any, period: Any, x, args, t=0.0, *, where: str = "", strobe: bool = False) -> None:
    """Raise a ValueError unless fields, guards, resets and clocks repeat after the period.

    Args:
        system: any; a system with a schedule does not depend on time.
        period: a number; multiples of the system's own period are right. Traced values are not checked.
        x: (n,) a state.
        args: pytree of parameters.
        t: time from which on the functions must repeat.
        where: what to add to "period", such as " at omega = 2".
        strobe: the period is only an interval of sampling: any is right where frequencies have no common period.
    """
    if traced((period, x, args, t)):
        return
    x, period, t = np.asarray(x), float(period), float(t)
    _check_ticks(system, period, args, where)
    found = _misfit(system, period, x, args, t)
    if found is None:
        return
    own = seeming_period(system, period, x, args, t)
    if own is None and strobe:
        return
    advice = (
        "No period was found: (a) there are several frequencies without a common period; (b) something grows or decays "
        "with t, make it a component of x; (c) the period is longer than thousands of the given ones."
        if own is None
        else f"They seem to repeat after {own:.8g}: give that or a multiple of it. Likely causes: (a) a frequency ω in "
        "place of the period 2π/ω; (b) a period for other args, give a function args -> period; (c) the period of only "
        "a part of what depends on time."
    )
    raise ValueError(
        f"period{where} must be one after which all functions of time are as before; got {period:.9g}, but at the same "
        f"state the {found.name} at t = {found.t:.6g} and {found.turns:.0f} × {period:.6g} later differ by "
        f"{found.difference:.3g} (size {found.size:.3g}). {advice}"
    )


def _check_ticks(system: Any, period: float, args, where: str) -> None:
    """Require that a period has no more ticks of a clock than can be run."""
    for j, transition in enumerate(getattr(system, "transitions", ())):
        if transition.every is None:
            continue
        every = float(number(transition.every, args))
        require(
            period <= MOST_TICKS * every,
            f"period{where} is to be a time; got {period:.9g}, in which the clock of transition {j} ticks "
            f"{period / every:.3g} times (every {every:.6g}). Is it a frequency? Then the period is its reciprocal.",
        )


def depends_on_time(system: Any, x, args) -> bool:
    """Whether a field, guard or reset depends on time, or there is a clock.

    A function that uses t may still be constant in time, like a forcing of amplitude 0: unless the values are traced,
    values at several times are compared.
    """
    x = jnp.asarray(x)
    if traced((x, args)):
        return bool(_timed(system, x, args))
    values = _values(system, array(TIMES_COMPARED, x.dtype), np.asarray(x)[None], args)
    return any(not np.array_equal(row, rows[0], equal_nan=True) for rows in values.values() for row in rows)


def uses_time(system: Any, x, args) -> bool:
    """Whether a field, guard or reset takes time, whatever it makes of it, or there is a clock."""
    return bool(_timed(system, jnp.asarray(x), args))


def seeming_period(system: Any, period: float, x, args, t: float) -> float | None:
    """The least period that the functions of time seem to have, searched around the given one; None: none found."""
    count, discrete = TIMES_CHECKED * len(SHARES), iterates(system)
    half = count // 2
    for step in [1.0] if discrete else period * SCALES / count:
        values = _followed(system, t + step * np.arange(count), x, args)
        apart = np.append(_distances(values, half), np.inf)
        middle = apart[2:-1]  # without the shift by 0 or 1 step, where values have hardly changed
        least = (middle <= apart[1:-2]) & (middle <= apart[3:]) & (middle < LARGEST_DISTANCE)
        for k in 2 + np.flatnonzero(least)[:MINIMA]:
            own = float(k) if discrete else _refined(system, k * step, step, x, args, t)
            if own is not None and _misfit(system, own, x, args, t) is None:
                return _least(own, lambda part: _misfit(system, part, x, args, t) is None, discrete)
    return None


def _least(period: float, repeats: Callable[[float], bool], discrete: bool) -> float:
    """The least of the fractions of a period after which all repeats: several clocks are found at a multiple."""
    for prime in PRIMES:
        while (not discrete or period % prime == 0) and repeats(period / prime):
            period /= prime
    return period


def _refined(system, period: float, bracket: float, x, args, t: float) -> float | None:
    """A period in a bracket, refined by growing multiples of it in narrower brackets; None if there is none."""
    times = t + period * SPREAD
    for turns in MULTIPLES:
        tried = period + bracket * SHARES
        later = times + turns * tried[:, None]
        values = _followed(system, np.append(times, later), x, args).reshape(1 + len(tried), TIMES_CHECKED, -1)
        apart = np.array([_distance(one, values[0]) for one in values[1:]])
        if not np.min(apart) < LARGEST_DISTANCE:
            return None
        best = tried[apart == np.min(apart)]  # several are equal while all jumps lie between samples
        period, bracket = float(np.mean(best)), np.ptp(best) / 2 + bracket / 8
    return period


def _misfit(system, period: float, x, args, t: float) -> Misfit | None:
    """The largest difference after some periods beyond that of a shift by rounding errors; None: none."""
    rounding = 64 * float(np.finfo(x.dtype).eps)
    same, discrete, misfits = max(EQUAL_VALUES, rounding), iterates(system), []
    times = t + (np.arange(TIMES_CHECKED) if discrete else period * SPREAD)
    later = times + PERIODS_CHECKED * period
    shift = 0.0 if discrete else same * (np.abs(times) + PERIODS_CHECKED * period)
    values = _values(system, np.concatenate([times, later, later - shift, later + shift]), _states(x), args)
    values = {name: np.where(np.isfinite(rows), rows, np.nan) for name, rows in values.items()}
    # Where large terms cancel, the remainder is as uncertain as the rounding of the terms.
    largest = max((np.max(np.abs(np.nan_to_num(rows)), initial=0.0) for rows in values.values()), default=0.0)
    for name, rows in values.items():
        now, then, before, after = np.split(rows, 4)
        size = np.nan_to_num(np.maximum(np.abs(now), np.abs(then))).max(axis=0)
        difference = np.nan_to_num(np.abs(then - now))
        beyond = difference - np.nan_to_num(np.abs(after - before)) - same * size - rounding * largest
        i, j = np.unravel_index(np.argmax(beyond), beyond.shape)
        if beyond[i, j] > 0:
            misfits.append(Misfit(name, times[i], PERIODS_CHECKED[i], difference[i, j], size[j]))
    return max(misfits, key=lambda found: found.difference / found.size, default=None)


def _distance(a: np.ndarray, b: np.ndarray) -> float:
    """Half the mean square difference of values, 1 for unrelated ones."""
    return float(np.mean((a - b) ** 2) / 2) if a.size else np.inf


def _distances(values: np.ndarray, half: int) -> np.ndarray:
    """`_distance` of the first `half` values from those as many steps later: (half,), for 0, 1, … steps."""
    if not values.size:
        return np.full(half, np.inf)
    products = sum(np.correlate(column[: 2 * half - 1], column[:half], "valid") for column in values.T)
    sums = np.cumsum(np.append(0.0, np.sum(values[: 2 * half - 1] ** 2, axis=1)))
    squares = sums[half:] - sums[: len(sums) - half]
    apart = (squares[0] + squares - 2 * products) / (2 * half * values.shape[1])
    return np.round(apart, 9)  # rounded, so that distances that differ by rounding are equal


def _followed(system, times: np.ndarray, x, args) -> np.ndarray:
    """Some of the values that change with time (times, numbers), scaled to mean 0 and variance 1."""
    rows = _values(system, times, _states(x), args).values()
    values = np.nan_to_num(np.concatenate([np.asarray(one, float) for one in rows], axis=1), posinf=0.0, neginf=0.0)
    spread = np.std(values, axis=0)
    values = values[:, spread > 1e-6 * np.max(np.abs(values), axis=0)]
    values = values[:, np.unique(np.linspace(0, max(values.shape[1] - 1, 0), COLUMNS).astype(int))[: values.shape[1]]]
    return (values - np.mean(values, axis=0)) / np.std(values, axis=0)


def _states(x: np.ndarray) -> np.ndarray:
    """The state and a second one: at a single state a factor of t may vanish."""
    size = np.abs(x) + 0.1 * np.max(np.abs(x))
    aside = np.where(size > 0, size, 1.0) * np.random.default_rng(0).normal(size=x.shape)
    return np.stack([x, x + SECOND_STATE_DISTANCE * aside]).astype(x.dtype)


@compiled()
def _values(system, times, states, args) -> dict[str, Any]:
    """Values of the functions of time by name, each (times, numbers) with all states in one row."""

    def rows(function):
        def at(t, x):
            return jnp.ravel(jnp.asarray(function(t, x, args))).astype(states.dtype)

        return jax.lax.map(lambda t: jax.lax.map(lambda x: at(t, x), states).ravel(), times.astype(states.dtype))

    return {name: rows(function) for name, function in _timed(system, states[0], args).items()}


def _timed(system: Any, x, args) -> dict[str, Callable]:
    """The functions of (t, x, args) whose result uses t."""
    check_functions(system, jax.ShapeDtypeStruct(x.shape, x.dtype), args)

    def takes_time(function) -> bool:
        closed = jax.make_jaxpr(lambda t: function(t, x, args))(jnp.zeros((), x.dtype))
        return closed.jaxpr.invars[0] in needed(closed)

    return {name: function for name, function in _functions(system, x, args) if takes_time(function)}


def _functions(system: Any, x, args) -> Iterator[tuple[str, Callable]]:
    """All functions of (t, x, args) that determine the motion, with their names."""
    if isinstance(system, Flow):
        yield from _of_field("field", system.field)
    elif isinstance(system, Map):
        yield "rule", system.rule
    elif isinstance(system, EventDriven):
        yield "velocity", system.velocity
        yield "time to the next event", lambda t, x, args: system.next_event(t, x, args)[0]
    elif isinstance(system, Hybrid):
        for name, field, project in zip(system.mode_names, system.fields or (None,), system.tangent, strict=True):
            if field is not None:
                yield from _of_field(f"field of mode {name!r}", field)
            if project is not None:
                yield f"tangent of mode {name!r}", lambda t, x, args, project=project: project(t, x, args, x)
        for j, transition in enumerate(system.transitions):
            yield from _of_transition(f" of transition {j}", transition, x, args)


def _of_field(name: str, field: Callable) -> Iterator[tuple[str, Callable]]:
    if not isinstance(field, Constrained):
        yield name, field
        return
    yield f"residual of the {name}", field.residual
    yield f"leading of the {name}", lambda t, x, args: field.leading(t, args)


def _of_transition(name: str, transition: Transition, x, args) -> Iterator[tuple[str, Callable]]:
    if transition.guard is None:
        yield f"clock{name}", lambda t, x, args: _hand(t, transition, args)
        shape = ()
    else:
        yield f"guard{name}", transition.guard
        shape = jax.eval_shape(transition.guard, jnp.zeros((), x.dtype), x, args).shape
    if transition.when is not None:
        yield f"when{name}", transition.when
    for word, function in (("reset", transition.reset), ("target", transition.target)):
        if callable(function):
            yield f"{word}{name}", _of_contacts(function, shape)


def _of_contacts(function: Callable, shape: tuple[int, ...]) -> Callable:
    """The function; for a vector guard its values for the first components."""
    if not shape:
        return function
    which = jnp.arange(min(*shape, CONTACTS), dtype=jnp.int32)
    return lambda t, x, args: jax.lax.map(lambda i: function(t, x, args, i), which)


def _hand(t, transition: Transition, args):
    """Phase of a clock as a point (2,) on the unit circle; one turn from tick to tick."""
    angle = 2 * jnp.pi * t / number(transition.every, args)
    return jnp.stack([jnp.cos(angle), jnp.sin(angle)])
