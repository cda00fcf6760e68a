"""Hybrid time domains: the pairs (t, j) of times and numbers of jumps over which a solution is defined."""

import equinox as eqx
import numpy as np
from jaxtyping import Float

from ..statuses import STATUS

__all__ = ["TimeDomain", "time_domain"]

NUMBERS = {"eventually continuous": 1, "eventually discrete": 2, "hybrid": 3, "continuous": 4, "discrete": 5}
GONE_ON = (STATUS.ok, STATUS.max_steps, STATUS.interrupted)  # nothing in the motion itself ended the run
SHOWN = 3  # intervals at either end of what is printed
SHRUNK = 1e-3  # the last interval of a Zeno solution is shorter than this part of the longest


class TimeDomain(eqx.Module):
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

    A computed part is finite: it shows what the domain looks like so far, and proves nothing of what follows.

    Attributes:
        starts, ends: (J + 1,) of the intervals I^0 … I^J, in time.
        case: see above.

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
        >>> lh.trajectory(ball, [0.5, 0.0], t1=4.0).domain
        TimeDomain(sup t = 4, sup j = 2: hybrid, Dinius' case 3)
          I^0 = [0, 1]
          I^1 = [1, 3]
          I^2 = [3, 4]
    """

    starts: Float[np.ndarray, " intervals"]
    ends: Float[np.ndarray, " intervals"]
    case: str = eqx.field(static=True)

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
        """Dinius' number of the case, 1 to 5; None of what he does not list."""
        return NUMBERS.get(self.case)

    @property
    def complete(self) -> bool:
        """Whether nothing was met that ends the solution."""
        return self.case != "incomplete"

    def __repr__(self) -> str:
        number = "" if self.number is None else f", Dinius' case {self.number}"
        lines = [f"TimeDomain(sup t = {self.sup_t:.10g}, sup j = {self.sup_j}: {self.case}{number})"]
        count = len(self.ends)
        hidden = range(SHOWN, count - SHOWN) if count > 2 * SHOWN + 1 else range(0)
        for j in range(count):
            if j not in hidden:
                lines.append(f"  I^{j} = [{self.starts[j]:.10g}, {self.ends[j]:.10g}]")
            elif j == hidden.start:
                lines.append(f"  … {len(hidden)} more")
        return "\n".join(lines)

    __str__ = __repr__


def time_domain(start: float, jumps, end: float, status: STATUS) -> TimeDomain:
    """The domain of a run from `start` to `end` with jumps at the times `jumps` (J,)."""
    times = np.concatenate([[start], np.asarray(jumps, float), [end]])
    starts, ends = times[:-1], np.maximum(times[1:], times[:-1])
    return TimeDomain(starts, ends, _case(ends - starts, status))


def _case(lengths, status: STATUS) -> str:
    """What intervals of these lengths, and how the run ended, look like."""
    flows = lengths[lengths > 0]
    if status == STATUS.zeno:  # intervals that shrink to nothing, or a cascade after one that did not
        return "zeno" if len(flows) and flows[-1] < SHRUNK * np.max(flows) else _of_jumps(len(flows) > 0)
    if status not in GONE_ON:
        return "incomplete"
    if len(lengths) == 1:
        return "continuous"
    if not len(flows):
        return _of_jumps(False)
    return "eventually continuous" if lengths[-1] > np.sum(lengths[:-1]) else "hybrid"


def _of_jumps(flowed: bool) -> str:
    return "eventually discrete" if flowed else "discrete"
