"""All solutions of a start that has several, and the exponents of each."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from .._arguments import Frame, State, attempts, require, require_one_start, require_values, whole
from .._jax.engines import compiled
from .._jax.tracing import array
from .._linalg import frames
from ..engine import preparation, problems
from ..engine.blocks import ends_of_blocks, qr_schedule_for, targets_for
from ..engine.evolvers.trials import Choices
from ..engine.host import driver
from ..integrators.base import Method
from ..results import averages
from ..results.solution_sets import Choice, Solution, Solutions
from ..results.spectrum import About
from ..statuses import STATUS
from ..systems.contacts.surfaces import InitialMode
from ..systems.hybrid import Hybrid
from ..systems.labels import labels_of
from .spectra import initial_frame

__all__ = ["solutions"]

MOST_INSTANTS = 64  # of one solution: times at which the order of events is chosen
SINE_IN_SURFACE = 1e-9  # a perturbation lies in a surface if the sine of its angle with it is below this


class PendingPart(NamedTuple):
    """A part of a solution that has yet to be run."""

    before: tuple[driver.Outcome, ...]
    choices: tuple[Choice, ...]  # made in earlier parts
    picks: tuple[int, ...]  # prescribed choices of the order of events
    t: Any
    x: Any
    frame: Any
    mode: Any
    length: float  # remaining time
    leaves: float | None = None  # time after which it leaves the surface; None: it does not choose to


def solutions(
    system: Hybrid,
    x0: State,
    args: Any = None,
    *,
    t1: float,
    t0: float = 0.0,
    mode: str | int | None = None,
    k: int | None = None,
    frame: Frame = None,
    method: Method | None = None,
    every: Any = None,
    blocks: int = 64,
    most: int = 64,
    departures: int = 0,
    max_steps: int | None = None,
) -> Solutions:
    """The solutions from a start that has several, and the exponents of each: a set, or an interval.

    A solution can go on in several ways

    - where the flow brings several guards to zero at one instant, and their order matters for the state or for the
      saltation matrix: each of the events comes first in turn;
    - on the surface of an `lh.filippov` system, where both fields point away: to either side, or along it;
    - at a two-fold, where both are tangent to it: to the sides to which they curve away.

    A solution that cannot go on ends with status deadlock. Each solution is computed by the loop of
    `lh.lyapunov_spectrum`, with its own choices. At a choice of the mode no derivative exists: the frame is unchanged.

    Args:
        system: an `lh.Hybrid` with fields.
        x0: start, shape (n,).
        args: pytree of parameters handed to the user's functions.
        t1: length of the run, in time.
        t0: time at the start.
        mode: name or index of the mode at the start, as for `lh.lyapunov_spectrum`.
        k: number of exponents; None: n.
        frame: (n, k) initial columns; None: as for `lh.lyapunov_spectrum`.
        method: None: adaptive `lh.RungeKutta`.
        every: as for `lh.lyapunov_spectrum`.
        blocks: as for `lh.lyapunov_spectrum`, for each part between two choices of the mode.
        most: largest number of solutions; the search stops there.
        departures: number of evenly spaced times at which a solution that slides on a repelling surface may leave it.
        max_steps: most attempts of a step in each part; None: no limit.

    Returns:
        `Solutions`. Failures are not raised: each solution has a status.

    Raises:
        ValueError: on a system without fields, several starts at once, or under jit, vmap or grad.

    Source:
        R. Goebel, R. Sanfelice & A. Teel, IEEE Control Systems 29 (2009) 28, doi:10.1109/MCS.2008.931718; A. F.
        Filippov, Differential Equations with Discontinuous Righthand Sides (Kluwer 1988),
        doi:10.1007/978-94-015-7793-9; for exponents of unique solutions J. Dinius, Computing Lyapunov Exponents of
        Hybrid Dynamical Systems (2011), who leaves the others open.

    Example:
        Two clocks strike together. One turns w by a right angle, the other doubles its first component, as
        perturbations see it, too: the order tells which component is doubled.

        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> turn = lh.Transition(
        ...     lambda t, x, args: 1 - x[0], lambda t, x, args: jnp.stack([0 * x[0], x[1], x[3], -x[2]]))
        >>> double = lh.Transition(
        ...     lambda t, x, args: 1 - x[1], lambda t, x, args: jnp.stack([x[0], 0 * x[1], 2 * x[2], x[3]]))
        >>> clocks = lh.Hybrid(lambda t, x, args: jnp.array([1.0, 1.0, 0.0, 0.0]), [turn, double])
        >>> found = lh.solutions(clocks, [0.0, 0.0, 1.0, 0.0], t1=1.5)
        >>> [one.spectrum.x[2:].tolist() for one in found.solutions]
        [[0.0, -1.0], [0.0, -2.0]]
        >>> found.complete
        True
    """
    whole("most", most, least=1)
    whole("departures", departures, least=0)
    whole("blocks", blocks, least=2, each=1)
    attempts(max_steps)
    flows = isinstance(system, Hybrid) and system.fields is not None
    require(flows, f"solutions needs an lh.Hybrid with fields; got {type(system).__name__}. Others have one solution.")
    problem, x0, t0, mode = preparation.prepare(system, x0, args, t0, method, mode)
    require_one_start("solutions", x0)
    require_values("solutions", problem, x0, t0, t1)
    ends_of_blocks(t1, blocks, None, "t1")  # checks the arguments before anything is computed
    frame, initial = initial_frame(problem, t0, x0, frame, k)
    qr_schedule, interval = qr_schedule_for(problem, every)
    plan = problems.RunPlan(
        qr_schedule=qr_schedule, kind=frames.kind_for(frame.shape[1]), collect=problems.first_losses
    )
    labels = labels_of(system, problem.shape)
    search = _Search(problem, plan, interval, 0.0 * initial, blocks, departures, max_steps, labels)
    search.follow(PendingPart((), (), (), t0, x0, frame, mode, float(t1)), most)
    return Solutions(tuple(search.found), search.complete, problems.mode_names(system))


class _Search:
    """Depth-first search; each alternative is run again from the last choice of the mode."""

    def __init__(self, problem, plan, interval, growth, blocks, departures, max_steps, labels):
        self.problem, self.plan, self.interval, self.growth = problem, plan, interval, growth
        self.blocks, self.departures, self.max_steps = blocks, departures, max_steps
        self.labels = labels
        self.found: list[Solution] = []
        self.complete = True

    def follow(self, part: PendingPart, most: int) -> None:
        """Find up to `most` solutions that begin with this part."""
        open_ends = [part]
        while open_ends and len(self.found) < most:
            part = open_ends.pop()
            outcome = self._run(part)
            others, part = self._orders(part, outcome)
            ways = self._ways(part, outcome)
            if not ways:
                self.found.append(self._solution(part, outcome))
            open_ends += [*others, *reversed(ways)]
            if outcome.interrupted:
                break
        self.complete = self.complete and not open_ends

    def _run(self, part: PendingPart) -> driver.Outcome:
        dtype = part.x.dtype
        loop_state = driver.start(
            self.problem, self.plan, part.t, part.x, part.frame, part.mode, array(self.interval, dtype)
        )
        picks = np.zeros(MOST_INSTANTS, np.int32)
        picks[: len(part.picks)] = part.picks
        choices = Choices(
            picks, np.zeros_like(picks), np.zeros(MOST_INSTANTS, dtype), np.zeros((), np.int32), np.zeros((), bool)
        )
        if loop_state.carry.solver_state.memory is not None:
            own = loop_state.carry.solver_state._replace(choices=choices)
            loop_state = loop_state._replace(carry=loop_state.carry._replace(solver_state=own))
        length = part.length if part.leaves is None else part.leaves
        targets = targets_for(ends_of_blocks(length, self.blocks, None, "t1"), "time", False, dtype)
        return driver.drive(self.problem, self.plan, loop_state, *targets, self.max_steps)

    def _orders(self, part: PendingPart, outcome: driver.Outcome) -> tuple[list[PendingPart], PendingPart]:
        """Parts with other orders of events, from the first free choice on; and this part with its choices recorded."""
        met = outcome.loop_state.carry.solver_state.choices
        if met is None:
            return [], part
        count = min(int(met.count), MOST_INSTANTS)
        self.complete = self.complete and int(met.count) <= MOST_INSTANTS and not bool(met.others)
        picks = (*part.picks, *(0,) * (count - len(part.picks)))
        options = np.asarray(met.options)[:count]
        others = [  # the last choice is changed first
            part._replace(picks=(*picks[:i], other))
            for i in range(len(part.picks), count)
            for other in reversed(range(1, int(options[i])))
        ]
        made = []
        for t, number, pick in zip(np.asarray(met.times), options, picks, strict=False):
            names = tuple(f"event {i + 1} first" for i in range(number))
            made.append(Choice(float(t), "order", names, names[pick]))
        return others, part._replace(choices=(*part.choices, *made))

    def _ways(self, part: PendingPart, outcome: driver.Outcome) -> list[PendingPart]:
        """Parts that continue this one, one for each possible mode; none at the end of the run or in a deadlock."""
        carry, leaves = outcome.loop_state.carry, part.leaves is not None
        if int(outcome.status) != (STATUS.ok if leaves else STATUS.deadlock):
            return []
        start = self.problem.system.initial_mode
        if not isinstance(start, InitialMode):
            return []
        t, mode = problems.time_of(outcome.loop_state), problems.mode_of(carry)
        possible, undecided = _continuations(start, t, carry.x, self.problem.args, mode)
        modes = [int(i) for i in np.flatnonzero(np.asarray(possible)) if not (leaves and i >= start.regions)]
        self.complete = self.complete and not bool(undecided) and not any(i >= start.regions for i in modes)
        left = part.length - float(t - part.t)
        if not modes or left <= 0:
            return []
        names = problems.mode_names(self.problem.system)
        options = tuple(names[i] for i in modes)
        ways = []
        for i in modes:
            choice = Choice(float(t), "mode", options, names[i])
            way = PendingPart(
                (*part.before, outcome),
                (*part.choices, choice),
                (),
                t,
                carry.x,
                carry.frame,
                jnp.asarray(i, jnp.int32),
                left,
            )
            slides = i >= start.regions
            times = left * np.arange(1, self.departures + 1) / (self.departures + 1) if slides else ()
            ways += [way, *(way._replace(leaves=float(time)) for time in times)]
        return ways

    def _solution(self, part: PendingPart, outcome: driver.Outcome) -> Solution:
        outcomes = [*part.before, outcome]
        spectrum = averages.summarise(outcomes, self.problem, "time", self.growth, "uniform", self.labels, About())
        exponents = np.array(spectrum.exponents)
        if self._is_pushed_off(part, outcome):
            within = exponents[: len(exponents) - int(np.sum(np.all(np.asarray(spectrum.frame) == 0, axis=0)))]
            exponents = np.concatenate([[np.inf], within])[: len(exponents)]
        return Solution(part.choices, spectrum, exponents)

    def _is_pushed_off(self, part: PendingPart, outcome: driver.Outcome) -> bool:
        """Whether the run ends on a repelling surface and its frame has a column that does not lie in the surface."""
        start, end = self.problem.system.initial_mode, outcome.loop_state
        if not isinstance(start, InitialMode) or int(outcome.status) != STATUS.ok:
            return False
        args, mode = self.problem.args, problems.mode_of(end.carry)
        repels, normal = _along(start, problems.time_of(end), end.carry.x, args, mode)
        across = np.abs(np.asarray(normal) @ np.asarray(part.frame))
        return bool(repels) and bool(np.max(across) > SINE_IN_SURFACE * np.linalg.norm(np.asarray(normal)))


@compiled()
def _continuations(start: InitialMode, t, x, args, mode):
    return start.continuations(t, x, args, mode)


@compiled()
def _along(start: InitialMode, t, x, args, mode):
    return start.repels(t, x, args, mode), start.normal(t, x, args, mode)
