"""A pair of trajectories: both go on by the one loop and are compared at the ends of intervals."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._jax.engines import compiled
from .._jax.precision import digits
from .._jax.tracing import array, as_jax, numpy_for, traced
from ..engine import beginning, binding, loop, problems, states
from ..engine.host import driver
from ..engine.host.paces import ATTEMPTS_BETWEEN_CHECKS, why_stalled
from ..statuses import RUNNING, STATUS

__all__ = ["TrajectoryPair", "Renormalisation", "all_blocks", "finished", "recipe_of", "restarted", "start"]

PLAN = problems.RunPlan()
SHORTEST_INTERVAL, LONGEST_INTERVAL = 1e-6, 0.5  # of renormalisations, as fractions of a block; first the shortest
GOLDEN = 0.6180339887498949  # the first interval is this part of a fixed one: its ends then miss events at round times
WANTED, SHORTER, LONGER = 1.0, 0.5, 1.2  # target ln of the growth in an interval; limits of an interval's change
# Factor by which attempts are raised for an interval that does not end within `ATTEMPTS_BETWEEN_CHECKS` of them.
MORE = 8
NOT_CANCELLED = 0.1  # the part of a step's absolute tolerance that the difference of both trajectories may have
MOST_LENGTHENINGS = 4  # attempts to lengthen an interval until both trajectories have made the same jumps


class TrajectoryPair(NamedTuple):
    """Two trajectories between renormalisations, and the sums of the present block."""

    elapsed: Array  # since the start of the run
    x: Array  # (n,) state of the first trajectory
    direction: Array  # (n,) unit vector towards the second trajectory
    mode: Array
    h: Array | None  # step size of the controller
    interval: Array
    growth: Array  # Σ ln(d_i / d₀) over the intervals that count
    length: Array  # total time of these intervals
    intervals: Array
    skipped: Array
    faint: Array  # intervals that count, at whose end the distance may be that of rounding
    status: Array
    budget: Array  # remaining attempts of a step
    begun: Array  # time reached in an interval that could not be finished within the attempts
    reach: Array  # the largest |x| at ends of intervals


class Renormalisation(NamedTuple):
    """When and to which distance the second trajectory is brought back."""

    whole: bool  # time is counted in iterations
    separation: Array
    every: Array | None  # fixed interval; None: chosen from the observed growth
    shortest: Array
    longest: Array


def recipe_of(whole: bool, block, separation, every) -> Renormalisation:
    """How a pair is followed; `whole`: intervals are counted in iterations or jumps."""
    xp = numpy_for(block)
    shortest, longest = SHORTEST_INTERVAL * block, LONGEST_INTERVAL * block
    if whole:
        shortest, longest = xp.ones_like(block), xp.maximum(xp.floor(longest), 1.0)
    limits = (array(each, block.dtype) for each in (shortest, longest))
    every = None if every is None else array(every, block.dtype)
    return Renormalisation(whole, array(separation, block.dtype), every, *limits)


def _begin(problem: problems.RunProblem, t, x, mode, h) -> states.LoopState:
    """One trajectory at its start, without a frame."""
    settings = binding.settings_of(problem, PLAN, t, x)
    none = jnp.zeros((x.shape[0], 0), x.dtype)
    return beginning.initial_loop_state(settings, t, x, none, mode, h, jnp.ones_like(t))


@compiled()
def start(problem: problems.RunProblem, t0, x0, mode, key, recipe: Renormalisation) -> TrajectoryPair:
    """The pair at its start, in a random direction."""
    carry = _begin(problem, t0, x0, mode, None).carry
    direction = jax.random.normal(key, x0.shape, x0.dtype)
    direction = direction / _length(direction)
    zero, none = jnp.zeros_like(t0), jnp.asarray(0, jnp.int32)
    interval = recipe.shortest if recipe.every is None else recipe.every * GOLDEN
    interval = jnp.maximum(jnp.round(interval), 1.0) if recipe.whole else interval
    step = getattr(carry.solver_state, "h", None)
    sums = zero, zero, none, none, none
    return TrajectoryPair(
        zero, x0, direction, problems.mode_of(carry), step, interval, *sums, none + RUNNING, none, zero, _length(x0)
    )


def _length(x):
    """The Euclidean norm."""
    return jnp.sqrt(jnp.sum(x**2))


def restarted(pair: TrajectoryPair) -> TrajectoryPair:
    """The pair with new sums."""
    xp = numpy_for(pair)
    zero, none = (as_jax(xp.zeros_like(xp.asarray(sums))) for sums in (pair.growth, pair.intervals))
    return pair._replace(growth=zero, length=zero, intervals=none, skipped=none, faint=none)


def all_blocks(problem: problems.RunProblem, recipe: Renormalisation, t0, pair: TrajectoryPair, ends, why: str):
    """Run all blocks: one compiled loop under a transformation; else a loop on the host, so that Ctrl-C works.

    `why` is the reason why the run has stalled, in the transient or later; empty if it has not.
    """
    last = ends[-1]

    def one(pair, end):
        stop = end if recipe.whole else last
        pair, why = finished(problem, recipe, t0, restarted(pair), end, stop)
        return pair, (pair.elapsed, pair.growth, pair.length, pair.intervals, pair.skipped, pair.faint), why

    leaves = jax.tree.leaves((problem, recipe, t0, pair, ends))
    if traced(leaves):
        return *jax.lax.scan(lambda pair, end: one(pair, end)[:2], pair, ends), why
    records = []
    for end in np.asarray(ends):
        pair, record, said = one(pair, np.asarray(end))
        records.append(record)
        why = why or said
    return pair, jax.tree.map(lambda *parts: np.stack(parts), *records), why


def finished(
    problem: problems.RunProblem, recipe: Renormalisation, t0, pair: TrajectoryPair, end, stop
) -> tuple[TrajectoryPair, str]:
    """Run a block; also returns why the run has stalled, or "".

    On the host an interval that does not end within its attempts is repeated with more of them, or the run is given up.
    """
    if traced((problem, recipe, t0, pair, end, stop)):
        pair = _block(problem, recipe, t0, pair, end, stop, np.int32(driver.FOREVER))
        spent = (pair.budget <= 0) & (pair.status == RUNNING)
        return pair._replace(status=jnp.where(spent, int(STATUS.max_steps), pair.status)), ""
    attempts, limit = ATTEMPTS_BETWEEN_CHECKS, float(stop) if np.isfinite(float(stop)) else float(end)
    while True:
        before = float(pair.elapsed)
        pair = _block(problem, recipe, t0, pair, end, stop, np.int32(attempts))
        if int(pair.budget) > 0 or int(pair.status) != RUNNING:
            return pair, ""
        whole_intervals = float(pair.elapsed) - before
        moved = whole_intervals + float(pair.begun)
        ahead = attempts * (limit - before) / moved if moved > 0 else np.inf
        why = why_stalled(
            attempts, moved, ahead, lambda pair=pair: driver.rates_at(problem, t0 + pair.elapsed, pair.x, pair.mode)
        )
        if why:
            stalled = jnp.full_like(pair.status, STATUS.stalled)
            return pair._replace(status=stalled), f"{attempts:.1e} attempts moved the time by {moved:.3g}: {why}"
        if whole_intervals == 0:
            attempts = min(MORE * attempts, driver.FOREVER)


@compiled()
def _block(
    problem: problems.RunProblem, recipe: Renormalisation, t0, pair: TrajectoryPair, end, stop, attempts
) -> TrajectoryPair:
    """Whole intervals until the end of the block is passed; only at `stop`, the end of the run, one is cut short.

    Ends of blocks are round times, where clocks often have their events, and a trajectory that restarts on a guard
    would miss the event. So no interval is cut short at the end of a block. An interval in which the attempts are used
    up is undone.
    """

    def goes_on(pair):
        left = end - pair.elapsed > digits(1e-12, end) * end
        return left & (pair.status == RUNNING) & (pair.budget > 0)

    pair = pair._replace(budget=jnp.asarray(attempts, jnp.int32), begun=jnp.zeros_like(pair.begun))
    return jax.lax.while_loop(goes_on, lambda pair: _interval(problem, recipe, t0, pair, stop), pair)


def _interval(problem: problems.RunProblem, recipe: Renormalisation, t0, pair: TrajectoryPair, stop) -> TrajectoryPair:
    """Both trajectories over one interval, and the second one brought back."""
    t, rest, separation = t0 + pair.elapsed, stop - pair.elapsed, recipe.separation
    length = jnp.where(rest <= pair.interval * (1 + digits(1e-9, rest)), rest, pair.interval)
    starts = jnp.stack([pair.x, pair.x + separation * pair.direction])
    # Both start with the same step size, so that their integration errors nearly cancel in the difference.
    loop_states = jax.vmap(lambda x, mode: _begin(problem, t, x, mode, pair.h))(
        starts, _modes(problem, t, pair, starts)
    )
    loop_states, budget = _until_they_agree(problem, loop_states, length, pair.budget)
    first, modes = loop_states.carry, problems.mode_of(loop_states.carry)
    status = jnp.max(first.status)
    apart = first.x[1] - first.x[0]
    distance, reach = _length(apart), jnp.maximum(pair.reach, _length(first.x[0]))
    good = _agree(loop_states) & (status == RUNNING) & (distance <= jnp.sqrt(separation * reach))
    growth = jnp.log(distance / separation)
    met = distance == 0
    faint = good & ~met & (distance < _noise(problem, first.x[0]))
    interval = recipe.every
    if interval is None:
        interval = _adapted(recipe, pair.interval, jnp.where(good, jnp.abs(growth), jnp.inf))
    step = getattr(first.solver_state, "h", None)
    after = TrajectoryPair(
        pair.elapsed + loop_states.elapsed[0],
        first.x[0],
        jnp.where(good & ~met, apart / jnp.where(met, 1.0, distance), pair.direction),
        jnp.broadcast_to(modes, (2,))[0],
        None if step is None else step[0],
        interval,
        pair.growth + jnp.where(good, growth, 0.0),
        pair.length + jnp.where(good, loop_states.elapsed[0], 0.0),
        pair.intervals + 1,
        pair.skipped + jnp.where(good, 0, 1),
        pair.faint + jnp.where(faint, 1, 0),
        status,
        budget,
        pair.begun,
        reach,
    )
    undone = pair._replace(budget=budget, begun=jnp.min(loop_states.elapsed + first.s))
    return states.select(_any_short(loop_states), undone, after)


def _noise(problem: problems.RunProblem, x):
    """A distance that rounding, or errors of the steps that do not cancel, may have made."""
    rounding = jnp.finfo(x.dtype).eps * jnp.max(jnp.abs(x))
    return jnp.maximum(rounding, NOT_CANCELLED * jnp.asarray(getattr(problem.method, "atol", 0.0), x.dtype))


def _any_short(loop_states: states.LoopState):
    """Whether a flight used up its attempts before its end."""
    return jnp.any((loop_states.block == 0) & (loop_states.carry.status == RUNNING))


def _modes(problem: problems.RunProblem, t, pair: TrajectoryPair, starts):
    """The modes (2,) of both: next to a point on a surface the neighbour may be in another mode."""
    mode = jnp.asarray(pair.mode, jnp.int32)
    if getattr(problem.system, "initial_mode", None) is None:
        return jnp.stack([mode, mode])
    settings = binding.settings_of(problem, PLAN, t, starts[1])
    return jnp.stack([mode, settings.evolver.initial_mode(t, starts[1])])


def _adapted(recipe: Renormalisation, interval, seen):
    """The next interval, chosen from the observed growth."""
    wanted = WANTED * interval / jnp.maximum(seen, 1e-3)
    longer = jnp.maximum(LONGER * interval, interval + 1) if recipe.whole else LONGER * interval
    wanted = jnp.clip(jnp.clip(wanted, SHORTER * interval, longer), recipe.shortest, recipe.longest)
    return jnp.round(wanted) if recipe.whole else wanted


def _agree(loop_states):
    """Whether both trajectories have made the same number of jumps and are in the same mode."""
    modes, jumps = jnp.broadcast_to(problems.mode_of(loop_states.carry), (2,)), loop_states.carry.jumps
    return (jumps[0] == jumps[1]) & (modes[0] == modes[1])


def _until_they_agree(problem: problems.RunProblem, loop_states: states.LoopState, length, budget):
    """Advance both by `length`; while their jumps or modes differ, go on by 0.01, 0.1 and 1 times `length`.

    Returns the states and the remaining attempts: 0 if a trajectory did not finish its flight.
    """

    def fly(loop_state, until, budget):
        settings = binding.settings_of(problem, PLAN, loop_state.base[0], loop_state.carry.x)
        loop_state = loop_state._replace(block=jnp.zeros_like(loop_state.block))
        ends = until[None]
        return loop.advance(settings, loop_state, ends, ends, budget)[0]

    def goes_on(state):
        loop_states, _, tries, budget = state
        apart = (tries == 0) | ~_agree(loop_states)
        return apart & (tries < MOST_LENGTHENINGS) & jnp.all(loop_states.carry.status == RUNNING) & (budget > 0)

    def go(state):
        loop_states, until, tries, budget = state
        more = jnp.where(tries == 0, 1.0, 10.0 ** (tries - MOST_LENGTHENINGS + 1).astype(length.dtype))
        until = until + length * more
        if jax.default_backend() == "cpu":  # in turn: under vmap both sides of each branch would be computed
            loop_states = jax.lax.map(lambda loop_state: fly(loop_state, until, budget), loop_states)
        else:
            loop_states = jax.vmap(lambda loop_state: fly(loop_state, until, budget))(loop_states)
        left = jnp.where(_any_short(loop_states), 0, budget - jnp.max(budget - loop_states.carry.budget))
        return loop_states, until, tries + 1, left

    loop_states, _, _, left = jax.lax.while_loop(
        goes_on, go, (loop_states, jnp.zeros_like(length), jnp.asarray(0, jnp.int32), budget)
    )
    return loop_states, left
