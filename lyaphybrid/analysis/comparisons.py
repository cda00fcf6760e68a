"""The largest exponent without derivatives, from the separation of two trajectories."""

import math
import warnings
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array

from .. import plots
from .._arguments import Key, Real, State, flag, positive, random_key, real, require, whole
from .._jax.tracing import array, as_jax, numpy_for, traced
from .._keywords import explains_keywords, user_level
from .._text import Table, with_error, with_unit
from ..engine import preparation, problems
from ..engine.blocks import check_counts
from ..engine.host.places import Place, account
from ..errors import RunFailedError
from ..integrators.base import Method
from ..results.errors import standard_error
from ..results.result import Data, RunResult, in_time, per_time, states_along
from ..results.spectrum import History
from ..statuses import STATUS, nan_if_failed
from ..systems.event_driven import EventDriven
from ..systems.hybrid import Hybrid
from ..systems.kinds import iterates, unit_of
from ..systems.labels import Labels, labels_of
from ..systems.smooth import Flow, Map
from . import pairs
from .orbits.motion.motions import velocity
from .orbits.periods import depends_on_time

__all__ = ["TwoTrajectories", "two_trajectories"]

SKIPPED = 0.01  # fraction of skipped intervals above which a warning is given
FAINT = 0.2  # of the intervals: so many may end with a separation that is rounding, as where chaotic maps fold
SMALL_SEPARATION = 1e-4  # a larger part of the motion is no small separation
CLEAR = 100.0  # separations below this many roundings are refused at the start, or noted if states grow so large


class TwoTrajectories(RunResult, eqx.Module):
    """The largest Lyapunov exponent, from two neighbouring trajectories.

    Attributes:
        exponent: () per unit of time (per iteration of a map); -inf where the trajectories met.
        stderr: () one standard error, from the blocks.
        time: () length after the transient.
        intervals: () number of renormalisations; skipped: () number of intervals that did not count.
        history: time, exponents (running) and growth of the blocks, each (blocks,); nan where not reached.
        x, t, mode: the state of the first trajectory at the end.
        separation: the distance at which the second trajectory restarts after each interval.
        status: how the run ended, an `lh.STATUS`.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> henon = lh.Map(lambda n, x, a: jnp.stack([1 - a * x[0] ** 2 + x[1], 0.3 * x[0]]))
        >>> found = lh.two_trajectories(henon, [0.1, 0.2], 1.4, t1=2000)
        >>> bool(abs(found.exponent - 0.4192) < 5 * found.stderr)
        True
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

    state_labels: Labels = eqx.field(static=True, default=Labels())

    def plot(self, ax: plots.Axes | None = None, **style: Any) -> plots.Axes:
        """The running exponent against time, with the final value as a band of one standard error to each side.

        `style` goes to what it draws.
        """
        history = self.history
        found = np.atleast_1d(self.exponent), np.atleast_1d(self.stderr)
        return plots.running(history.time, np.asarray(history.exponents)[:, None], *found, self.unit, ax, **style)

    def _table(self) -> Table:
        value = with_error(float(self.exponent), float(self.stderr))
        time = with_unit(f"{float(self.time):.6g}", self.unit)
        return Table(
            f"λ1 {value} per {self.unit}, from two trajectories {float(self.separation):.2g} apart",
            notes=[
                f"t = {time}, {int(self.intervals)} intervals, {int(self.skipped)} of them skipped; "
                f"status {self.status}"
            ],
        )

    def _data(self) -> Data:
        per = per_time(self.unit)
        variables: dict[str, Any] = {
            "exponent": ((), self.exponent, per),
            "stderr": ((), self.stderr, per),
            "history": ("block", self.history.exponents, per),
            "growth": ("block", self.history.growth),
            "mode": ((), self.mode),
            "x": (("body", "state") if self.state_labels.rows else ("state",), self.x),
        }
        names = ("time", "intervals", "skipped", "t", "separation")
        attributes = {name: np.asarray(getattr(self, name)).item() for name in names}
        coordinates = {
            "time": ("block", np.asarray(self.history.time), in_time(self.unit)),
            **states_along(self.state_labels, self.x.shape[-1]),
        }
        return Data(variables, coordinates, attributes | {"unit": self.unit})


@explains_keywords
def two_trajectories(
    system: Flow | Map | Hybrid | EventDriven,
    x0: State,
    args: Any = None,
    *,
    t1: Real,
    t0: Real = 0.0,
    transient: Real = 0.0,
    separation: Any = 1e-8,
    renormalise_every: Real | None = None,
    mode: str | int | None = None,
    method: Method | None = None,
    blocks: int = 64,
    key: Key = None,
    throw: bool = True,
) -> TwoTrajectories:
    """The largest Lyapunov exponent from two trajectories, with no derivative: an independent check.

    λ₁ ≈ Σ_i ln(d_i / d₀) / Σ_i τ_i: after each interval τ_i the distance d_i is read, and the second
    trajectory is brought back to the distance d₀ along the present separation.

    Nothing of the tangent dynamics is used, no Jacobian and no saltation matrix; each trajectory meets
    its events at its own times. An interval that ends when one has jumped and the other has not is
    lengthened until both have made the same jumps. Where they never do (one grazes, the other passes), or the
    distance leaves the linear regime, d_i > √(d₀ max |x|), the interval does not count and the second trajectory
    starts anew.

    Args:
        system: an `lh.Flow`, `lh.Map`, `lh.Hybrid` or `lh.EventDriven`.
        x0: (n,) start.
        args: pytree of parameters.
        t1: length after the transient (iterations for a map).
        t0: time at the start.
        transient: length before growth is counted.
        separation: d₀, in units of x (Euclidean norm): small against the attractor (a warning says where it is not),
            large against rounding (likewise: of x, and of t in a system that jumps and depends on time).
        renormalise_every: τ, at most t1; None: adapted to the observed growth.
        mode: mode at the start, where there are several.
        method: `lh.RungeKutta` (default) or `lh.Diffrax`; None for maps and event-driven systems.
        blocks: number of blocks in which the run is recorded, at least 2; they give the error.
        key: a `jax.random.key` for the direction of the first separation; None: a fixed one.
        throw: raise where the run failed; False returns the result with its status. Under a transformation, as in a
            sweep, exponent and stderr are nan instead.

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
    flag("throw", throw)
    random_key("key", key)
    _require_numbers(t1, transient, separation, renormalise_every, blocks)
    problem, x0, t0, mode = preparation.prepare(system, x0, args, t0, method, mode)
    _require_start(x0, separation)
    check_counts(system, t1=t1, transient=transient, renormalise_every=renormalise_every)
    whole = iterates(system)
    length, xp = array(t1, x0.dtype), numpy_for(t1)
    recipe = pairs.recipe_of(whole, length / int(blocks), separation, renormalise_every)
    pair = pairs.start(problem, t0, x0, mode, jax.random.key(0) if key is None else key, recipe)
    why = ""
    if traced(transient) or float(transient) > 0:
        quiet = array(transient, x0.dtype)
        quiet = array(numpy_for(quiet).ceil(quiet - 1e-9), x0.dtype) if whole else quiet
        pair, why = pairs.finished(problem, recipe, t0, pair, quiet, quiet if whole else array(math.inf, x0.dtype))
        pair = pairs.restarted(pair)
    ends = length * np.arange(1, int(blocks) + 1, dtype=x0.dtype) / int(blocks)
    ends = array(pair.elapsed, x0.dtype) + (xp.ceil(ends - 1e-9) if whole else ends)
    pair, records, why = pairs.all_blocks(problem, recipe, t0, pair, ends, why)
    pair = pair._replace(x=problems.in_rows(problem, pair.x))
    result = _summarise(t0, pair, records, recipe.separation, unit_of(system), labels_of(system, problem.shape))
    if not traced(result) and not result.status.failed:
        _note_size(separation, float(pair.reach))
        _note_rounding(problem, result, x0)
        _note_faint(int(np.sum(records[-1])), int(result.intervals))
    return _deliver(result, problems.mode_names(system), throw, why)


def _require_numbers(t1, transient, separation, every, blocks) -> None:
    positive("t1", t1)
    positive("separation", separation)
    if every is not None:
        positive("renormalise_every", every)
        known = not traced((every, t1))
        require(not known or every <= t1, f"renormalise_every must be at most t1 = {t1!r}; got {every!r}.")
    real("transient, a length,", transient)
    require(traced(transient) or transient >= 0, f"transient, a length, must not be negative; got {transient!r}.")
    whole("blocks", blocks, least=2, each=1)


def _require_start(x0, separation) -> None:
    if x0.ndim != 1:
        raise ValueError(f"x0 must have shape (n,) here; got {x0.shape}. Use jax.vmap for several starts.")
    if traced(x0) or traced(separation):
        return
    rounding = float(np.finfo(x0.dtype).eps * np.max(np.abs(x0)))
    if separation < CLEAR * rounding:
        raise ValueError(f"separation must be large against the rounding of x0, {rounding:.1e}; got {separation!r}.")


def _note_size(separation, reach: float) -> None:
    """Warn where the separation is not small against the motion."""
    if separation > SMALL_SEPARATION * reach:
        warnings.warn(
            f"the separation, {float(separation):.2g}, is not small against the motion, which stays within "
            f"{reach:.2g}, so that λ1 is not that of small perturbations: give a smaller separation.",
            stacklevel=user_level(),
        )


def _note_rounding(problem: problems.RunProblem, result: TwoTrajectories, x0) -> None:
    """Warn where the separation is not large against rounding: of the state, and of the time where both jump.

    After jumps at different times the forcing acts on each trajectory with its own rounding of the time, eps t, and so
    displaces it by about eps t |f|.
    """
    eps, separation, x = float(np.finfo(x0.dtype).eps), float(result.separation), result.x.reshape(-1)
    system, t, size = problem.system, float(result.t), float(max(np.max(np.abs(x0)), np.max(np.abs(x))))
    shift = _shift_by_time(problem, result, x)
    if separation >= CLEAR * eps * shift or not depends_on_time(system, x, problem.args):
        shift = 0.0
    if separation < CLEAR * eps * max(size, shift):
        warnings.warn(
            f"the separation, {separation:.2g}, is not large against rounding, {eps * size:.1e} of the state (up to "
            f"{size:.3g}) and {eps * shift:.1e} by that of the time (t = {t:.6g}), so that λ1 is partly that of "
            "rounding: (a) give a larger separation; (b) keep angles and times small, start at a t0 near 0.",
            stacklevel=user_level(),
        )


def _note_faint(faint: int, intervals: int) -> None:
    """Warn where the separation often shrinks to rounding within an interval."""
    if faint > FAINT * intervals:
        warnings.warn(
            f"in {faint} of {intervals} intervals the separation falls to that of rounding and the errors of steps, so "
            "that λ1 is partly theirs: shorten renormalise_every, or give a larger separation.",
            stacklevel=user_level(),
        )


def _shift_by_time(problem: problems.RunProblem, result: TwoTrajectories, x) -> float:
    """|t| |f| at the end of a run with jumps between flows; else 0."""
    if not isinstance(problem.system, Hybrid) or not problem.system.fields:
        return 0.0
    speed = velocity(problem.system, result.t, x, problem.args, int(result.mode))
    return abs(float(result.t)) * float(np.max(np.abs(speed)))


@np.errstate(all="ignore")  # as JAX does
def _summarise(t0, pair: pairs.TrajectoryPair, records, separation, unit: str, labels: Labels) -> TwoTrajectories:
    """The exponent and its standard error from the sums of the blocks."""
    xp = numpy_for(records, t0, pair.elapsed)
    elapsed, growth, length, intervals, skipped, _ = jax.tree.map(xp.asarray, records)
    before = xp.concatenate([elapsed[:1] - length[:1], elapsed[:-1]])
    reached = elapsed > before
    total = xp.sum(length)
    running = xp.cumsum(growth) / xp.where(xp.cumsum(length) == 0, xp.nan, xp.cumsum(length))
    exponent, count = running[-1], xp.maximum(xp.sum(reached), 2).astype(growth.dtype)
    found = TwoTrajectories(
        exponent=exponent,
        stderr=standard_error(xp, growth, length, exponent, count, total),
        time=total,
        intervals=xp.sum(intervals),
        skipped=xp.sum(skipped),
        history=History(
            xp.where(reached, xp.cumsum(length), xp.nan),
            xp.where(reached, running, xp.nan),
            xp.where(reached, growth, xp.nan),
        ),
        x=pair.x,
        t=xp.asarray(t0) + xp.asarray(pair.elapsed),
        mode=pair.mode,
        separation=separation,
        status_code=pair.status,
        unit=unit,
        state_labels=labels,
    )
    return as_jax(found)


def _deliver(result: TwoTrajectories, names: tuple[str, ...], throw: bool, why: str) -> TwoTrajectories:
    """Raise or warn on the host, where the values are known."""
    status = result.status
    if not isinstance(status, STATUS):
        return nan_if_failed(result.status_code, result, "exponent", "stderr") if throw else result
    if throw and status.failed:
        place = Place.of(result.t, result.x, result.mode, names)
        raise RunFailedError(status, account(status, place, why=why), result)
    if int(result.skipped) > max(2, SKIPPED * int(result.intervals)):
        warnings.warn(
            f"{int(result.skipped)} of {int(result.intervals)} intervals did not count: (a) the distance "
            "leaves the linear regime within one, shorten renormalise_every; (b) the motion often grazes.",
            stacklevel=user_level(),
        )
    return result
