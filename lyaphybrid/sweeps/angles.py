"""`angle_field`: the angle between unstable and stable directions over a grid of starts."""

import warnings
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from .. import plots
from .._arguments import Progress, Real, positive, real, require, require_values, whole
from .._keywords import explains_keywords, user_level
from .._text import Table
from ..analysis.indicators.covariant import UNSETTLED, angles_of_split, forwards
from ..analysis.indicators.following import follow
from ..engine import preparation, problems
from ..engine.blocks import check_counts
from ..engine.preparation import grown_columns
from ..integrators.base import Method
from ..results.result import Data, RunResult, in_time, states_along
from ..statuses import OK
from ..systems.event_driven import EventDriven
from ..systems.hybrid import Hybrid
from ..systems.kinds import iterates
from ..systems.labels import Labels
from ..systems.smooth import Flow, Map
from .starts import Starts, starts_of, status_lines

__all__ = ["AngleField", "angle_field"]

PIECES_OF_FLOW = 64  # in which the frame of a flow is kept, where the user does not say


class AngleField(RunResult, eqx.Module):
    """The smallest angle between the spans of the first covariant vectors and of the others, for a grid of starts.

    Attributes:
        angles: (…) radians in [0, π/2], in the shape of the grid; nan where a run failed.
        where: (…, n) the point of the orbit where the angle is found.
        time: (…) when the orbit is there, since the beginning of the part that is looked at.
        remainder: (…) what is left of the errors with which the two spans begin, the larger one: exp(−gap), where gap
            is how much more the last vector of the first span grows than the first of the others, in the past and in
            the future. Those errors are of order one, or larger near a tangency.
        missed: (…) how far from the start that part begins, of a run with `inverse`: rounding; None without it.
        axes: the varied components, by index, and their values.
        status_code: (…) how each run ended; status: the gravest.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> henon = lh.Map(lambda n, x, a: jnp.stack([1 - a * x[0] ** 2 + x[1], 0.3 * x[0]]))
        >>> field = lh.angle_field(henon, [[-0.1, -0.1], [0.1, 0.1]], 1.4, shape=(4, 3), transient=40)
        >>> field.angles.shape, field.where.shape, field.status.name
        ((4, 3), (4, 3, 2), 'ok')
    """

    angles: np.ndarray
    where: np.ndarray
    time: np.ndarray
    remainder: np.ndarray
    missed: np.ndarray | None
    axes: dict[int, np.ndarray]
    status_code: np.ndarray
    state_labels: Labels = eqx.field(static=True)

    def plot(self, ax: plots.Axes | None = None, *, within: float = UNSETTLED, **style: Any) -> plots.Axes:
        """The angles of a grid of two components: with `inverse` over the starts, without it at the points `where`.

        Angles with a larger remainder than `within` are left out. `style` goes to what it draws.
        """
        require(len(self.axes) == 2, f"A picture needs a grid of two components; this one has {len(self.axes)}.")
        return plots.angle_field(self, ax, within, **style)

    def _table(self) -> Table:
        known = self.angles[np.isfinite(self.angles)]
        found = (f"{one:.6g}" for one in (np.min(known), np.median(known), np.max(known))) if len(known) else "———"
        notes = status_lines(self)
        if unsettled := int(np.sum(self.remainder > UNSETTLED)):
            notes.append(
                f"{unsettled} angles with a remainder above {UNSETTLED}: equal exponents, or a short transient"
            )
        if self.missed is not None and len(known):
            notes.append(f"the starts were met again to {np.nanmax(self.missed):.2g}")
        title = f"Angles between covariant vectors, of {self.angles.size} starts"
        return Table(title, [("angle (rad)", *found)], notes, ("", "least", "median", "greatest"))

    def _data(self) -> Data:
        along = tuple(self.state_labels.name(i) for i in self.axes)
        variables = {
            "angles": (along, self.angles, {"units": "rad"}),
            "where": ((*along, "state"), self.where),
            "time": (along, self.time, in_time(self.state_labels.time_unit)),
            "remainder": (along, self.remainder),
            "missed": None if self.missed is None else (along, self.missed),
            "status_code": (along, self.status_code),
        }
        axes = {self.state_labels.name(i): values for i, values in self.axes.items()}
        return Data(variables, {**states_along(self.state_labels, self.where.shape[-1]), **axes})


@explains_keywords
def angle_field(
    system: Flow | Map | Hybrid | EventDriven,
    x0: Any,
    args: Any = None,
    *,
    shape: Any,
    transient: Real,
    settle: Real | None = None,
    t1: Real = 0.0,
    split: int = 1,
    inverse: Flow | Map | Hybrid | EventDriven | None = None,
    t0: Real = 0.0,
    mode: str | int | None = None,
    method: Method | None = None,
    blocks: int | None = None,
    max_steps: int | None = None,
    chunk: int | None = None,
    store: Any = None,
    client: Any = None,
    progress: Progress = None,
) -> AngleField:
    """The smallest angle between unstable and stable directions over a grid of starts, through jumps.

    It is the angle between the span of the first `split` covariant Lyapunov vectors and the span of the others, as
    `covariant_vectors` finds them; near zero the two touch, as at a homoclinic tangency. The first span is determined
    by the past of a point, and a start has none. So the angle is not that at the start, but that at the point which
    the motion from the start reaches after `transient`, or the smallest one on the length t1 from there on; `.where` is
    that point. With `inverse` each start is first carried back by `transient`, and the angle is that at the
    start.

    Args:
        system: an `lh.Flow`, `lh.Map`, `lh.Hybrid` or `lh.EventDriven`.
        x0: (2, n) corners of the box of starts; components that are equal in both corners are not varied.
        args: pytree of parameters.
        shape: numbers of cells along the varied components: starts are the cells' middles.
        transient: length over which the first span converges, rounded up to whole pieces. Where λ_split and λ_{split+1}
            are equal, as in islands of regular motion, there are no two spans, and `.remainder` is not small.
        settle: length of the run after t1, over which the other span converges backwards; None: as `transient`.
        t1: length of the part of the orbit on which the smallest angle is sought (iterations for a map); 0: one point.
        split: number of vectors in the first span, 1 to n − 1.
        inverse: the system that undoes `system`, with the same args and modes, and on the clock −t: of a flow f it is
            the flow of −f(−t, x, args); of a map it leads from x at iteration −n back to the state at n − 1. Rounding
            grows like 1e-16 exp(λ₁ transient) until the start is met again: `.missed`.
        t0: time at the start; with `inverse` time of the grid.
        mode: mode at the start, where there are several and the system does not determine it.
        method: as for `lh.lyapunov_spectrum`, except `lh.ContinuousQR`.
        blocks: number of equal pieces of t1 + `settle`, at whose ends in t1 angles are looked at; None: each iteration
            of a map, and 64 for others. In a piece vectors may grow by e^300.
        max_steps: most attempts of a step in one run.
        chunk: as for `lh.sweep`.
        store: path of a zarr store, where each chunk is kept as soon as it is computed; the same call goes on with it.
        client: a `dask.distributed.Client`, as for `lh.sweep`.
        progress: True for a bar, or a function of the fraction done.

    Returns:
        An `AngleField` with `.angles`, `.remainder`, `.where`, `.time`, `.missed`, `.status_code`, `.plot()`. It warns
        if starts are missed by more than a cell: shorten `transient`, or see whether `inverse` is the inverse.

    Raises:
        ValueError: on arguments that do not fit, before any computing.
        StoreFailedError: if the store cannot be written.
        ImportError: without the extra "sweep".

    Source:
        F. Ginelli, P. Poggi, A. Turchi, H. Chaté, R. Livi & A. Politi, Phys. Rev. Lett. 99 (2007) 130601,
        doi:10.1103/PhysRevLett.99.130601; angles between subspaces as a test of hyperbolicity: P. V. Kuptsov,
        arXiv:1111.4828 (2011), doi:10.48550/arXiv.1111.4828.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> cat = lh.Map(lambda n, x, args: jnp.stack([3 * x[0] + 2 * x[1], x[0] + x[1]]) % 1.0)
        >>> field = lh.angle_field(cat, [[0.0, 0.0], [1.0, 1.0]], shape=(3, 2), transient=20)
        >>> jnp.rad2deg(field.angles[0]).round(8).tolist()
        [73.89788625, 73.89788625]
    """
    settle = transient if settle is None else settle
    piece, before, after, looks = _pieces(system, transient, settle, t1, blocks)
    starts = starts_of("angle_field", system, x0, args, shape, t0=t0, method=method, mode=mode, max_steps=max_steps)
    n = starts.grid.shape[1]
    whole("split", split, least=1)
    require(split < n, f"split must be at most {n - 1}, for {n} vectors in two spans; got {split}.")
    grown_columns("angle_field", method)
    if inverse is not None:
        _check_inverse(system, inverse)
        preparation.prepare(inverse, starts.grid[0], args, -t0, method, mode)
    how = {"frame": None, "method": method, "max_steps": max_steps, "progress": None}

    def run(args, x0):
        begin, begin_mode, clock, status = x0, mode, t0, OK
        if inverse is not None:
            back = follow(
                None, problems.point, inverse, x0, args, k=0, t1=before * piece, t0=-t0, transient=0.0, times=None,
                blocks=2, mode=mode, **how,
            )  # fmt: skip
            _, x, modes, _ = back.collected
            begin, begin_mode, clock = x[-1], None if mode is None else modes[-1], t0 - before * piece
            status = back.status
        lengths = {"piece": piece, "pieces": before - 1 + after, "transient": piece}
        found = forwards(system, begin, args, k=n, t0=clock, mode=begin_mode, **lengths, **how)
        looked_at = slice(before - 1, before - 1 + looks)
        angles, remainders = angles_of_split(found.collected[1], split, looked_at)
        x, time = found.collected[2][looked_at], found.time[looked_at]
        least = jnp.argmin(jnp.where(jnp.isnan(angles), jnp.inf, angles))
        return {
            "angles": angles[least],
            "where": x[least],
            "time": time[least] - time[0],
            "remainder": remainders[least],
            "missed": jnp.linalg.norm(x[0] - x0),
            "status_code": jnp.where(status == OK, found.status, status),
        }

    found = starts.swept(run, args, chunk=chunk, store=store, client=client, progress=progress)
    return _field(starts, found, inverse is not None)


def _pieces(system, transient, settle, t1, blocks) -> tuple[float, int, int, int]:
    """The length of a piece, how many are before and after, and at how many times the angle is looked at."""
    require_values("angle_field", transient, settle, t1)
    for name, length in (("transient", transient), ("settle", settle)):
        positive(f"{name}, a length,", length)
    real("t1", t1)
    require(t1 >= 0, f"t1, a length, must be zero or positive; got {t1!r}.")
    check_counts(system, transient=transient, settle=settle, t1=t1)
    length = float(t1) + float(settle)
    if blocks is None:
        blocks = int(length) if isinstance(system, Flow | Map | Hybrid) and iterates(system) else PIECES_OF_FLOW
    whole("blocks", blocks, least=1, each=1)
    piece = length / blocks
    lengths: dict[str, Any] = {"a piece, (t1 + settle)/blocks,": piece}
    check_counts(system, **lengths)
    before = max(1, int(np.ceil(float(transient) / piece - 1e-9)))
    whole("the number of pieces", before + blocks, least=1, each=1)
    return piece, before, blocks, 1 + int(np.floor(float(t1) / piece + 1e-9))


def _check_inverse(system, inverse) -> None:
    """Require that it is a system of the same kind of time and modes."""
    good = isinstance(inverse, Flow | Map | Hybrid | EventDriven) and iterates(inverse) == iterates(system)
    kind = "one that iterates" if iterates(system) else "one that flows"
    require(good, f"inverse must be a system like the first, {kind}; got {type(inverse).__name__}.")
    ours, theirs = problems.mode_names(system), problems.mode_names(inverse)
    require(ours == theirs, f"inverse must have the modes of the system, {list(ours)}; it has {list(theirs)}.")


def _field(starts: Starts, found: dict[str, np.ndarray], returns: bool) -> AngleField:
    """The field of what was found; nan where a run did not end well."""
    status = found.pop("status_code")

    def shaped(values: np.ndarray) -> np.ndarray:
        good = (status == OK).reshape(-1, *[1] * (values.ndim - 1))
        return np.where(good, values, np.nan).reshape(*starts.cells, *values.shape[1:])

    kept: dict[str, Any] = {name: shaped(values) for name, values in found.items()}
    if returns:
        _warn_of_missed(kept["missed"], starts.axes)
    else:
        kept["missed"] = None
    return AngleField(axes=starts.axes, status_code=status.reshape(starts.cells), state_labels=starts.labels, **kept)


def _warn_of_missed(missed: np.ndarray, axes: dict[int, np.ndarray]) -> None:
    """Warn of starts that are missed by more than the narrowest cell."""
    cell = min((np.ptp(values) / (len(values) - 1) for values in axes.values() if len(values) > 1), default=np.inf)
    count = int(np.sum(missed > cell))
    if count:
        warnings.warn(
            f"{count} starts were not met again: their angles belong to other points, {np.nanmax(missed):.2g} away at "
            "most. (a) transient is too long for rounding; (b) inverse is not the inverse of the system; (c) the start "
            "is not in the image of a map with mod.",
            stacklevel=user_level(),
        )
