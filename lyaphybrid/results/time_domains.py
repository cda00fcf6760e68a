"""Hybrid time domains: the pairs (t, j) of times and numbers of jumps over which a solution is defined."""

from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Float

from .. import plots
from .._text import Table, with_unit
from ..statuses import STATUS
from .result import Data, Result, in_time

__all__ = ["TimeDomain", "time_domain"]

NUMBERS = {"eventually continuous": 1, "eventually discrete": 2, "hybrid": 3, "continuous": 4, "discrete": 5}
GONE_ON = (STATUS.ok, STATUS.max_steps, STATUS.interrupted)  # the run ended, but the solution could go on
INTERVALS_SHOWN = 3  # number of intervals printed at each end
ZENO_INTERVAL = 1e-3  # the last interval of a Zeno solution is shorter than this times the longest


class TimeDomain(Result, eqx.Module):
    """The hybrid time domain of a trajectory as far as it was computed, E = ∪ⱼ I^j × {j}.

    I^j = [τ_j, τ_{j+1}] is the interval between the jumps j and j + 1; in a cascade it is a single point. Exponents are
    limits over the *complete* domain, where t or j grows without bound, and `case` says which kind it seems to be:

    ======================  =  ====================================================================
    case                    №
    ======================  =  ====================================================================
    eventually continuous   1  after the last jump it only flows: here, for longer than before it
    eventually discrete     2  after the last flow it only jumps: a cascade without end
    hybrid                  3  it flows and jumps for ever
    continuous              4  it only flows
    discrete                5  it only jumps
    zeno                       infinitely many jumps in a finite time
    incomplete                 it ended: a deadlock, an escape to infinity, a terminal transition …
    ======================  =  ====================================================================

    The computed part of a domain is finite: it shows the domain so far and proves nothing about the rest.

    Attributes:
        starts, ends: (J + 1,) times at which the intervals I^0 … I^J start and end.
        case: see the table above.
        time_unit: the unit of time, "" where the system has none.

    Source:
        J. Dinius, Computing Lyapunov Exponents of Hybrid Dynamical Systems (2011), section II.C, properties 1 to 5 (the
        numbers above; Zeno solutions are complete, too, and he has none for them); R. Goebel, R. Sanfelice & A. Teel,
        IEEE Control Systems 29 (2009) 28, doi:10.1109/MCS.2008.931718.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> ball = lh.Hybrid(
        ...     lambda t, x, args: jnp.array([x[1], -1.0]),
        ...     lh.Transition(lambda t, x, args: x[0], lambda t, x, args: jnp.array([x[0], -x[1]])),
        ... )
        >>> domain = lh.trajectory(ball, [0.5, 0.0], t1=4.0).domain
        >>> domain
        TimeDomain(sup t = 4, sup j = 2: hybrid, Dinius' case 3)
          I^0 = [0, 1]
          I^1 = [1, 3]
          I^2 = [3, 4]
    """

    starts: Float[np.ndarray, " intervals"]
    ends: Float[np.ndarray, " intervals"]
    case: str = eqx.field(static=True)
    time_unit: str = eqx.field(static=True, default="")

    @property
    def sup_t(self) -> float:
        """The largest time reached."""
        return float(self.ends[-1])

    @property
    def sup_j(self) -> int:
        """The number of jumps made."""
        return len(self.ends) - 1

    @property
    def number(self) -> int | None:
        """Dinius' number of the case, 1 to 5; None for the cases that he does not list."""
        return NUMBERS.get(self.case)

    @property
    def complete(self) -> bool:
        """Whether the solution did not end."""
        return self.case != "incomplete"

    def plot(self, ax: plots.Axes | None = None, **style: Any) -> plots.Axes:
        """The number of jumps against time, a step at each jump. `style` goes to what it draws."""
        return plots.time_domain(self, ax, **style)

    def _table(self) -> Table:
        number = "" if self.number is None else f", Dinius' case {self.number}"
        sup_t = with_unit(f"{self.sup_t:.10g}", self.time_unit)
        title = f"TimeDomain(sup t = {sup_t}, sup j = {self.sup_j}: {self.case}{number})"
        count, lines = len(self.ends), []
        hidden = range(INTERVALS_SHOWN, count - INTERVALS_SHOWN) if count > 2 * INTERVALS_SHOWN + 1 else range(0)
        for j in range(count):
            if j not in hidden:
                lines.append(f"I^{j} = [{self.starts[j]:.10g}, {self.ends[j]:.10g}]")
            elif j == hidden.start:
                lines.append(f"… {len(hidden)} more")
        return Table(title, notes=lines)

    def _data(self) -> Data:
        variables = {name: ("interval", getattr(self, name), in_time(self.time_unit)) for name in ("starts", "ends")}
        attributes = {"case": self.case, "number": self.number, "sup_t": self.sup_t, "sup_j": self.sup_j}
        attributes["time_unit"] = self.time_unit or None
        return Data(variables, {"interval": np.arange(len(self.ends))}, attributes)


def time_domain(start: float, jumps, end: float, status: STATUS, time_unit: str = "") -> TimeDomain:
    """The domain of a run from `start` to `end` with jumps at the times `jumps` (J,)."""
    times = np.concatenate([[start], np.asarray(jumps, float), [end]])
    starts, ends = times[:-1], np.maximum(times[1:], times[:-1])
    return TimeDomain(starts, ends, _case(ends - starts, status), time_unit)


def _case(lengths, status: STATUS) -> str:
    """The case that the lengths of the intervals and the status of the run indicate."""
    flows = lengths[lengths > 0]
    if status == STATUS.zeno:  # either intervals shrink to zero, or a cascade does not end
        return "zeno" if len(flows) and flows[-1] < ZENO_INTERVAL * np.max(flows) else _of_jumps(len(flows) > 0)
    if status not in GONE_ON:
        return "incomplete"
    if len(lengths) == 1:
        return "continuous"
    if not len(flows):
        return _of_jumps(False)
    return "eventually continuous" if lengths[-1] > np.sum(lengths[:-1]) else "hybrid"


def _of_jumps(flowed: bool) -> str:
    return "eventually discrete" if flowed else "discrete"
