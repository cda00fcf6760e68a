"""The largest exponent without derivatives, from the separation of two trajectories."""

import warnings
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._arguments import positive, real, require, whole
from .._jax.engines import compiled
from .._jax.precision import digits
from .._jax.tracing import traced
from .._text import UNIT, with_error
from ..engine import beginning, binding, loop, preparation, problems, states
from ..engine.blocks import check_counts
from ..engine.host import driver
from ..engine.host.places import Place, account
from ..errors import RunFailedError
from ..integrators.base import Method
from ..results.spectrum import History
from ..statuses import RUNNING, STATUS
from ..systems.event_driven import EventDriven
from ..systems.hybrid import Hybrid
from ..systems.kinds import iterates
from ..systems.smooth import Flow, Map

__all__ = ["TwoTrajectories", "two_trajectories"]

PLAN = problems.Plan()
SHORTEST, LONGEST = 1e-6, 0.5  # renormalisation interval, as a fraction of a block; the first one is SHORTEST
GOLDEN = 0.6180339887498949  # the first interval is this part of a fixed one: its ends then miss events at round times
WANTED, SHORTER, LONGER = 1.0, 0.5, 1.2  # target ln of the growth in an interval; limits of an interval's change
PATIENCE = 4  # attempts to lengthen an interval until both trajectories have made the same jumps
SKIPPED = 0.01  # fraction of skipped intervals above which a warning is given


class TwoTrajectories(eqx.Module):
    """The largest Lyapunov exponent, from two neighbouring trajectories.

    Attributes:
        exponent: () per unit of time (per iteration of a map); -inf where the trajectories met.
        stderr: () one standard error, from the blocks.
        time: () length after the transient.
        intervals: () number of renormalisations; skipped: () number of intervals that did not count.
        history: time, exponents (running) and growth of the blocks, each (blocks,); nan where not reached.
        x, t, mode: the state of the first trajectory at the end.
        separation: the distance at which the second trajectory restarts after each interval.
    """

    exponent: Array
    stderr: Array
    time: Array
    intervals: Array
    skipped: Array
    history: History
    x: Array
    t: Array
    mode: Array
    separation: Array
    status_code: Array
    unit: str = eqx.field(static=True)

    @property
    def status(self) -> STATUS | Array:
        """How the run ended; under a JAX transformation the integer code."""
        code = self.status_code
        return code if traced(code) else STATUS(int(code))

    def __str__(self) -> str:
        if traced(self):
            return "TwoTrajectories(under a transformation)"
        value = with_error(float(self.exponent), float(self.stderr))
        return (
            f"λ1 {value} per {self.unit}, from two trajectories {float(self.separation):.2g} apart\n"
            f"  t = {float(self.time):.6g}, {int(self.intervals)} intervals, {int(self.skipped)} of them "
            f"skipped; status {self.status}"
        )

    __repr__ = __str__


class Pair(NamedTuple):
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
    status: Array


class Recipe(NamedTuple):
    """When and to which distance the second trajectory is brought back."""

    whole: bool  # time is counted in iterations
    separation: Array
    every: Array | None  # fixed interval; None: chosen from the observed growth
    shortest: Array
    longest: Array


def two_trajectories(
    system: Flow | Map | Hybrid | EventDriven,
    x0,
    args: Any = None,
    *,
    t1,
    t0=0.0,
    transient=0.0,
    separation: Any = 1e-8,
    renormalise_every=None,
    mode: str | int | None = None,
    method: Method | None = None,
    blocks: int = 64,
    key=None,
    throw: bool = True,
) -> TwoTrajectories:
    """The largest Lyapunov exponent from two trajectories, with no derivative: an independent check.

    λ₁ ≈ Σ_i ln(d_i / d₀) / Σ_i τ_i: after each interval τ_i the distance d_i is read, and the second
    trajectory is brought back to the distance d₀ along the present separation.

    Nothing of the tangent dynamics is used, no Jacobian and no saltation matrix; each trajectory meets
    its events at its own times. An interval that ends when one has jumped and the other has not is
    lengthened until both have made the same jumps. Where they never do (one grazes, the other passes), or the
    distance leaves the linear regime, d_i > √(d₀ max(1, |x|)), the interval does not count and the second
    trajectory starts anew.

    Args:
        system: an `lh.Flow`, `lh.Map`, `lh.Hybrid` or `lh.EventDriven`.
        x0: (n,) start.
        args: pytree of parameters.
        t1: length after the transient (iterations for a map).
        t0: time at the start.
        transient: length before growth is counted.
        separation: d₀, in units of x (Euclidean norm): small against the attractor, large against rounding.
        renormalise_every: τ; None: adapted to the observed growth.
        mode: mode at the start, where there are several.
        method: `lh.RungeKutta` (default) or `lh.Diffrax`; None for maps and event-driven systems.
        blocks: the run is recorded in so many blocks, at least 2; they give the error.
        key: a `jax.random.key` for the direction of the first separation; None: a fixed one.
        throw: raise where the run failed; False returns the result with its status.

    Returns:
        A `TwoTrajectories` with `.exponent`, `.stderr`, `.history`, `.status`.

    Raises:
        ValueError: on arguments that do not fit, before any computing.
        RunFailedError: where the run failed and `throw`; it carries the result so far.

    Source:
        G. Benettin, L. Galgani & J.-M. Strelcyn, Phys. Rev. A 14 (1976) 2338, doi:10.1103/PhysRevA.14.2338.

    Example:
        >>> import lyaphybrid as lh
        >>> s = lh.two_trajectories(lh.Map(lambda n, x, r: r * x * (1 - x)), [0.3], 4.0, t1=20_000)
        >>> abs(float(s.exponent) - 0.6931) < 0.01
        True
    """
    _require_numbers(t1, transient, separation, renormalise_every, blocks)
    problem, x0, t0, mode = preparation.prepare(system, x0, args, t0, method, mode)
    _require_start(x0, separation)
    check_counts(system, t1=t1, transient=transient, renormalise_every=renormalise_every)
    whole = iterates(system)
    length = jnp.asarray(t1, x0.dtype)
    recipe = _recipe(whole, length / blocks, separation, renormalise_every)
    pair = _start(problem, t0, x0, mode, jax.random.key(0) if key is None else key, recipe)
    if traced(transient) or float(transient) > 0:
        quiet = jnp.asarray(transient, x0.dtype)
        quiet = jnp.ceil(quiet - 1e-9) if whole else quiet
        pair = _restarted(_block(problem, recipe, t0, pair, quiet, quiet if whole else jnp.inf * quiet))
    ends = length * jnp.arange(1, blocks + 1, dtype=x0.dtype) / blocks
    ends = pair.elapsed + (jnp.ceil(ends - 1e-9) if whole else ends)
    pair, records = _all_blocks(problem, recipe, t0, pair, ends)
    pair = pair._replace(x=problems.in_rows(problem, pair.x))
    return _deliver(_summarise(t0, pair, records, recipe.separation, whole), problems.mode_names(system), throw)


def _require_numbers(t1, transient, separation, every, blocks) -> None:
    positive("t1", t1)
    positive("separation", separation)
    if every is not None:
        positive("renormalise_every", every)
    real("transient, a length,", transient)
    require(traced(transient) or transient >= 0, f"transient, a length, must not be negative; got {transient!r}.")
    whole("blocks", blocks, least=2)


def _require_start(x0, separation) -> None:
    if x0.ndim != 1:
        raise ValueError(f"x0 must have shape (n,) here; got {x0.shape}. Use jax.vmap for several starts.")
    if traced(x0) or traced(separation):
        return
    rounding = float(jnp.finfo(x0.dtype).eps * jnp.max(jnp.abs(x0)))
    if separation < 100 * rounding:
        raise ValueError(f"separation must be large against the rounding of x0, {rounding:.1e}; got {separation!r}.")


def _recipe(whole: bool, block, separation, every) -> Recipe:
    shortest, longest = SHORTEST * block, LONGEST * block
    if whole:
        shortest, longest = jnp.ones_like(block), jnp.maximum(jnp.floor(longest), 1.0)
    every = None if every is None else jnp.asarray(every, block.dtype)
    return Recipe(whole, jnp.asarray(separation, block.dtype), every, shortest, longest)


def _begin(problem: problems.Problem, t, x, mode, h) -> states.LoopState:
    """One trajectory at its start, without a frame."""
    settings = binding.settings_of(problem, PLAN, t, x)
    none = jnp.zeros((x.shape[0], 0), x.dtype)
    return beginning.begin(settings, t, x, none, mode, h, jnp.ones_like(t))


@compiled()
def _start(problem: problems.Problem, t0, x0, mode, key, recipe: Recipe) -> Pair:
    """The pair at its start, in a random direction."""
    carry = _begin(problem, t0, x0, mode, None).carry
    direction = jax.random.normal(key, x0.shape, x0.dtype)
    direction = direction / jnp.sqrt(jnp.sum(direction**2))
    zero, none = jnp.zeros_like(t0), jnp.asarray(0, jnp.int32)
    interval = recipe.shortest if recipe.every is None else recipe.every * GOLDEN
    interval = jnp.maximum(jnp.round(interval), 1.0) if recipe.whole else interval
    step = getattr(carry.solver_state, "h", None)
    return Pair(zero, x0, direction, problems.mode_of(carry), step, interval, zero, zero, none, none, none + RUNNING)


def _restarted(pair: Pair) -> Pair:
    """The pair with new sums."""
    zero, none = jnp.zeros_like(pair.growth), jnp.zeros_like(pair.intervals)
    return pair._replace(growth=zero, length=zero, intervals=none, skipped=none)


def _all_blocks(problem: problems.Problem, recipe: Recipe, t0, pair: Pair, ends):
    """Run all blocks: one compiled loop under a transformation; else a loop on the host, so that Ctrl-C works."""
    last = ends[-1]

    def one(pair, end):
        stop = end if recipe.whole else last
        pair = _block(problem, recipe, t0, _restarted(pair), end, stop)
        return pair, (pair.elapsed, pair.growth, pair.length, pair.intervals, pair.skipped)

    leaves = jax.tree.leaves((problem, recipe, t0, pair, ends))
    if traced(leaves):
        return jax.lax.scan(one, pair, ends)
    records = []
    for end in np.asarray(ends):
        pair, record = one(pair, jnp.asarray(end))
        records.append(record)
    return pair, jax.tree.map(lambda *parts: jnp.stack(parts), *records)


@compiled()
def _block(problem: problems.Problem, recipe: Recipe, t0, pair: Pair, end, stop) -> Pair:
    """Whole intervals until the end of the block is passed; only at `stop`, the end of the run, one is cut short.

    Ends of blocks are round times, where clocks often have their events, and a trajectory that restarts on a guard
    would miss the event. So no interval is cut short at the end of a block.
    """

    def goes_on(pair):
        return (end - pair.elapsed > digits(1e-12, end) * end) & (pair.status == RUNNING)

    return jax.lax.while_loop(goes_on, lambda pair: _interval(problem, recipe, t0, pair, stop), pair)


def _interval(problem: problems.Problem, recipe: Recipe, t0, pair: Pair, stop) -> Pair:
    """Both trajectories over one interval, and the second one brought back."""
    t, rest, separation = t0 + pair.elapsed, stop - pair.elapsed, recipe.separation
    length = jnp.where(rest <= pair.interval * (1 + digits(1e-9, rest)), rest, pair.interval)
    starts = jnp.stack([pair.x, pair.x + separation * pair.direction])
    # Both start with the same step size, so that their integration errors nearly cancel in the difference.
    loop_states = jax.vmap(lambda x, mode: _begin(problem, t, x, mode, pair.h))(
        starts, _modes(problem, t, pair, starts)
    )
    loop_states = _until_they_agree(problem, loop_states, length)
    first, modes = loop_states.carry, problems.mode_of(loop_states.carry)
    status = jnp.max(first.status)
    apart = first.x[1] - first.x[0]
    distance = jnp.sqrt(jnp.sum(apart**2))
    size = jnp.maximum(1.0, jnp.sqrt(jnp.sum(first.x[0] ** 2)))
    good = _agree(loop_states) & (status == RUNNING) & (distance <= jnp.sqrt(separation * size))
    growth = jnp.log(distance / separation)
    met = distance == 0
    interval = recipe.every
    if interval is None:
        interval = _adapted(recipe, pair.interval, jnp.where(good, jnp.abs(growth), jnp.inf))
    step = getattr(first.solver_state, "h", None)
    return Pair(
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
        status,
    )


def _modes(problem: problems.Problem, t, pair: Pair, starts):
    """The modes (2,) of both: next to a point on a surface the neighbour may be in another mode."""
    mode = jnp.asarray(pair.mode, jnp.int32)
    if getattr(problem.system, "initial_mode", None) is None:
        return jnp.stack([mode, mode])
    settings = binding.settings_of(problem, PLAN, t, starts[1])
    return jnp.stack([mode, settings.evolver.initial_mode(t, starts[1])])


def _adapted(recipe: Recipe, interval, seen):
    """The next interval, chosen from the observed growth."""
    wanted = WANTED * interval / jnp.maximum(seen, 1e-3)
    longer = jnp.maximum(LONGER * interval, interval + 1) if recipe.whole else LONGER * interval
    wanted = jnp.clip(jnp.clip(wanted, SHORTER * interval, longer), recipe.shortest, recipe.longest)
    return jnp.round(wanted) if recipe.whole else wanted


def _agree(loop_states):
    """Whether both trajectories have made the same number of jumps and are in the same mode."""
    modes, jumps = jnp.broadcast_to(problems.mode_of(loop_states.carry), (2,)), loop_states.carry.jumps
    return (jumps[0] == jumps[1]) & (modes[0] == modes[1])


def _until_they_agree(problem: problems.Problem, loop_states: states.LoopState, length):
    """Advance both by `length`; while their jumps or modes differ, go on by 0.01, 0.1 and 1 times `length`."""
    forever = jnp.asarray(driver.FOREVER, jnp.int32)

    def fly(loop_state, until):
        settings = binding.settings_of(problem, PLAN, loop_state.base[0], loop_state.carry.x)
        loop_state = loop_state._replace(block=jnp.zeros_like(loop_state.block))
        ends = until[None]
        return loop.advance(settings, loop_state, ends, ends, forever)[0]

    def goes_on(state):
        loop_states, _, tries = state
        apart = (tries == 0) | ~_agree(loop_states)
        return apart & (tries < PATIENCE) & jnp.all(loop_states.carry.status == RUNNING)

    def go(state):
        loop_states, until, tries = state
        more = jnp.where(tries == 0, 1.0, 10.0 ** (tries - PATIENCE + 1).astype(length.dtype))
        until = until + length * more
        if jax.default_backend() == "cpu":  # in turn: under vmap both sides of each branch would be computed
            loop_states = jax.lax.map(lambda loop_state: fly(loop_state, until), loop_states)
        else:
            loop_states = jax.vmap(lambda loop_state: fly(loop_state, until))(loop_states)
        return loop_states, until, tries + 1

    start = (loop_states, jnp.zeros_like(length), jnp.asarray(0, jnp.int32))
    return jax.lax.while_loop(goes_on, go, start)[0]


def _summarise(t0, pair: Pair, records, separation, whole: bool) -> TwoTrajectories:
    """The exponent and its standard error from the sums of the blocks."""
    elapsed, growth, length, intervals, skipped = records
    before = jnp.concatenate([elapsed[:1] - length[:1], elapsed[:-1]])
    reached = elapsed > before
    total = jnp.sum(length)
    running = jnp.cumsum(growth) / jnp.where(jnp.cumsum(length) == 0, jnp.nan, jnp.cumsum(length))
    exponent, count = running[-1], jnp.maximum(jnp.sum(reached), 2).astype(growth.dtype)
    scatter = jnp.sum((growth - exponent * length) ** 2)
    return TwoTrajectories(
        exponent=exponent,
        stderr=jnp.sqrt(scatter * count / (count - 1)) / total,
        time=total,
        intervals=jnp.sum(intervals),
        skipped=jnp.sum(skipped),
        history=History(
            jnp.where(reached, jnp.cumsum(length), jnp.nan),
            jnp.where(reached, running, jnp.nan),
            jnp.where(reached, growth, jnp.nan),
        ),
        x=pair.x,
        t=t0 + pair.elapsed,
        mode=pair.mode,
        separation=separation,
        status_code=pair.status,
        unit="iteration" if whole else UNIT["time"],
    )


def _deliver(result: TwoTrajectories, names: tuple[str, ...], throw: bool) -> TwoTrajectories:
    """Raise or warn on the host, where the values are known."""
    status = result.status
    if not isinstance(status, STATUS):
        return result
    if throw and status.failed:
        place = Place.of(result.t, result.x, result.mode, names)
        raise RunFailedError(status, account(status, place), result)
    if int(result.skipped) > max(2, SKIPPED * int(result.intervals)):
        warnings.warn(
            f"{int(result.skipped)} of {int(result.intervals)} intervals did not count: (a) the distance "
            "leaves the linear regime within one, shorten renormalise_every; (b) the motion often grazes.",
            stacklevel=3,
        )
    return result
