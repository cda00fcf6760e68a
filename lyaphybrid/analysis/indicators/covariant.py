"""Covariant Lyapunov vectors: forwards by orthonormalisations, backwards through their triangular factors.

Forwards Q_n R_n = Φ_n Q_{n-1}. A vector V_n = Q_n C_n with C_n upper triangular is carried along by the flow if
R_n C_{n-1} = C_n up to lengths; going backwards any C converges to the covariant one. Where a jump destroys directions
R_n has rows of zeros: the vectors that go on span its image, the destroyed ones its kernel. Errors of the first Q, and
of the last C, shrink with the ratio of neighbouring entries of the diagonals of R_n.
"""

import dataclasses
import math
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ... import plots
from ..._arguments import Frame, Progress, Real, State, flag, positive, require_one_start, shape, whole
from ..._jax.engines import compiled
from ..._jax.tracing import as_jax, numpy_for
from ..._keywords import explains_keywords
from ..._text import UNIT, Table, numbered
from ...engine.blocks import check_counts
from ...engine.preparation import grown_columns
from ...engine.states import BlockRecord, Orthonormalisation, StepState
from ...integrators.base import Method
from ...results.result import Data, RunResult, exponents_along, in_time, per_time
from ...statuses import OK
from ...systems.daes.semi_linear import degrees_of_freedom
from ...systems.event_driven import EventDriven
from ...systems.hybrid import Hybrid
from ...systems.kinds import has_rows, unit_of
from ...systems.labels import Labels, labels_of
from ...systems.smooth import Flow, Map
from .following import IndicatorRun, follow, verdict_of

__all__ = ["UNSETTLED", "CovariantVectors", "angles_of_split", "covariant_vectors", "forwards"]

UNSETTLED = 1e-3  # what the remainder of the first errors is to be below
LOG_OF_ZERO = -1e30  # finite stand-in for ln 0
LARGEST_GROWTH = 80.0  # of a later row over an earlier one, ln: columns that have settled are in order


class BlockProduct(NamedTuple):
    """The product R = diag(e^logs) r of a block, in echelon form: its rows may differ by more than numbers can."""

    r: Array  # (k, k) rows whose largest entry is ±1, or of zeros
    logs: Array  # (k,)
    pivot: Array  # (k,) column of each row's first nonzero entry; k for a row of zeros


def _product(upper, r, logs):
    """The rows and logs of `upper` diag(e^logs) r."""
    logs = jnp.where(jnp.any(r != 0, axis=1), logs, LOG_OF_ZERO)
    there = upper != 0
    most = jnp.max(jnp.where(there, logs[None, :], LOG_OF_ZERO), axis=1)
    rows = jnp.where(there, upper * jnp.exp(jnp.where(there, logs[None, :] - most[:, None], 0.0)), 0.0) @ r
    size = jnp.max(jnp.abs(rows), axis=1)
    some = size > 0
    size = jnp.where(some, size, 1.0)
    return rows / size[:, None], jnp.where(some, most + jnp.log(size), 0.0)


@dataclasses.dataclass(frozen=True)
class FactorObserver:
    """The `states.Observer` that multiplies the factors R of each block."""

    def init(self, t, frame) -> BlockProduct:
        """R is the identity at the start."""
        del t
        return _identity(frame.shape[1], frame.dtype)

    def update(self, state: BlockProduct, seen: Orthonormalisation) -> BlockProduct:
        """R ← R' R; a lost column becomes a row of zeros."""
        r, logs = _product(jnp.triu(seen.frame.T @ seen.before), state.r, state.logs)
        gone = seen.lost | (state.pivot == len(state.pivot))
        r, logs = jnp.where(gone[:, None], 0.0, r), jnp.where(gone, 0.0, logs)
        return BlockProduct(r, logs, jnp.where(gone, len(state.pivot), state.pivot))

    def moved(self, state: BlockProduct, source) -> BlockProduct:
        """Reorder the rows like the columns of the frame: columns that are not lost come first."""
        return BlockProduct(state.r[source], state.logs[source], state.pivot[source])

    def next_block(self, state: BlockProduct) -> BlockProduct:
        """Start the product of the next block."""
        return _identity(len(state.pivot), state.r.dtype)


def _identity(k: int, dtype) -> BlockProduct:
    return BlockProduct(jnp.eye(k, dtype=dtype), jnp.zeros(k, dtype), jnp.arange(k, dtype=jnp.int32))


def _least(values: np.ndarray) -> float:
    """The least that is a number; nan where none is."""
    return float(np.min(values[~np.isnan(values)])) if np.any(~np.isnan(values)) else math.nan


def _frame_and_factor(t, carry: StepState):
    del t
    return carry.frame, carry.observer, carry.x


class CovariantVectors(RunResult, eqx.Module):
    """Covariant Lyapunov vectors along an orbit.

    Attributes:
        time: (times,) since the end of the transient.
        x: (times, n) the orbit, or (times, N, d).
        vectors: (times, n, k) unit vectors, the first for the largest exponent; up to their signs.
        growth: (times − 1, k) ln of the growth of each vector from one time to the next; -inf where it is destroyed.
        exponents: (k,) the mean growth per `unit`.
        angles: (times, k(k−1)/2) in [0, π/2] between the lines of vectors i < j: (1,2), (1,3), …, (2,3), ….
        remainders: (2, times, k − 1) what is left of the first errors of the directions, for vectors i and i + 1: of
            those at the start of the transient, and of those at the end of the settling stretch. It is exp(−gap), with
            gap the growth of direction i less that of i + 1, as recorded from there; 1 if nothing has converged, as
            for equal exponents. An angle (rad) is off by about the first, times 1/sin of the angle at most, and its
            cotangent by the second, relatively. Of k < n vectors the last one also needs λ_k > λ_{k+1} in the
            transient, of which nothing is known here. nan where the run failed.
        remainder: (times, k − 1) the larger of the two.
        status: how the run ended, an `lh.STATUS`.
        unit: of time, "unit of time" or what the system gives, or "iteration".

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> henon = lh.Map(lambda n, x, a: jnp.stack([1 - a * x[0] ** 2 + x[1], 0.3 * x[0]]))
        >>> found = lh.covariant_vectors(henon, [0.1, 0.2], 1.4, t1=20, blocks=20)
        >>> found.vectors.shape, found.angles.shape
        ((21, 2, 2), (21, 1))
        >>> jnp.linalg.norm(found.vectors[3], axis=0).round(6).tolist()
        [1.0, 1.0]
    """

    time: Array
    x: Array
    vectors: Array
    growth: Array
    remainders: Array
    status_code: Array
    state_labels: Labels = eqx.field(static=True, default=Labels())
    unit: str = eqx.field(static=True, default=UNIT["time"])

    @property
    def exponents(self) -> Array:
        """(k,) per unit of time; of a map per iteration."""
        return jnp.sum(self.growth, axis=0) / (self.time[-1] - self.time[0])

    @property
    def angles(self) -> Array:
        """(times, k(k−1)/2) in [0, π/2]."""
        i, j = np.triu_indices(self.vectors.shape[-1], 1)
        a, b = self.vectors[:, :, i], self.vectors[:, :, j]
        along = jnp.sum(a * b, axis=1)
        # From sine and cosine: arccos alone loses half of the digits for small angles.
        across = jnp.linalg.norm(a - along[:, None, :] * b, axis=1)
        return jnp.arctan2(across, jnp.abs(along))

    @property
    def remainder(self) -> Array:
        """(times, k − 1) what is left of the first errors."""
        return jnp.max(self.remainders, axis=0)

    def plot(self, ax: plots.Axes | None = None, **style: Any) -> plots.Axes:
        """The angles between the vectors against time. `style` goes to what it draws."""
        return plots.angles(self, ax, **style)

    def _pairs(self) -> list[str]:
        return [f"{i + 1},{j + 1}" for i, j in zip(*np.triu_indices(self.vectors.shape[-1], 1), strict=True)]

    def _neighbours(self) -> list[str]:
        return [f"{i + 1},{i + 2}" for i in range(self.remainders.shape[-1])]

    def _unsettled(self) -> list[str]:
        """A note on the vectors that have not converged, and what to do."""
        late = np.any(np.asarray(self.remainders) > UNSETTLED, axis=1)  # (2, k − 1)
        if not np.any(late):
            return []
        pairs = [pair for pair, own in zip(self._neighbours(), np.any(late, axis=0), strict=True) if own]
        longer = [name for name, own in zip(("transient=", "settle="), np.any(late, axis=1), strict=True) if own]
        shown = "; ".join([*pairs[:8], *(["…"] if len(pairs) > 8 else [])])
        return [
            f"not converged: vectors {shown}, remainder above {UNSETTLED}; their angles and exponents are not known",
            f"take a longer {' and a longer '.join(longer)}; equal exponents have no covariant vectors of their own",
        ]

    def _table(self) -> Table:
        exponents, angles = np.asarray(self.exponents), np.asarray(self.angles)
        left = [*(f"{value:.2g}" for value in np.max(self.remainder, axis=0)), ""]
        names = numbered("λ", len(exponents))
        rows = [(name, f"{own:.6g}", rest) for name, own, rest in zip(names, exponents, left, strict=True)]
        least = [f"{pair}: {_least(own):.3g}" for pair, own in zip(self._pairs(), angles.T, strict=True)][:8]
        notes = [f"least angles between vectors {', '.join(least)}"] if least else []
        title = f"Covariant vectors at {len(self.time)} times; their growth per {self.unit}"
        heads = ("", "growth", "remainder to the next" if len(left) > 1 else "")
        return Table(title, rows, [*notes, *self._unsettled(), f"status {self.status}"], heads)

    def _data(self) -> Data:
        n, k = self.vectors.shape[1:]
        variables = {
            "vectors": (("sample", "state", "exponent"), self.vectors),
            "x": (("sample", "state"), np.reshape(self.x, (len(self.time), n))),
            "growth": (("interval", "exponent"), self.growth),
            "exponents": ("exponent", self.exponents, per_time(self.unit)),
            "angles": (("sample", "pair"), self.angles),
            "remainders": (("end", "sample", "neighbours"), self.remainders),
            "remainder": (("sample", "neighbours"), self.remainder),
        }
        names = {
            "state": [self.state_labels.name(i) for i in range(n)],
            "pair": self._pairs(),
            "neighbours": self._neighbours(),
            "end": ["transient", "settle"],
        }
        time = ("sample", np.asarray(self.time), in_time(self.unit))
        return Data(variables, {"time": time, **exponents_along(k), **names})


@explains_keywords
def covariant_vectors(
    system: Flow | Map | Hybrid | EventDriven,
    x0: State,
    args: Any = None,
    *,
    t1: Real,
    k: int | None = None,
    t0: Any = 0.0,
    transient: Any = None,
    settle: Any = None,
    mode: str | int | None = None,
    frame: Frame = None,
    method: Method | None = None,
    blocks: int = 256,
    max_steps: int | None = None,
    progress: Progress = None,
    throw: bool = True,
) -> CovariantVectors:
    """The k leading covariant Lyapunov vectors, by the method of Ginelli and others.

    Vectors of unit length that the tangent flow carries into each other, jumps included.

    Args:
        system: an `lh.Flow`, `lh.Hamiltonian`, `lh.Map`, `lh.Hybrid` or `lh.EventDriven`.
        x0: (n,) start; (N, d) where the state has a row for each body, with n = N d.
        args: pytree of parameters.
        t1: length of the part of the orbit on which vectors are wanted (iterations for a map).
        k: number of vectors; None: n.
        t0: time at the start.
        transient: length of the run before it, in which the frame converges; at least one piece, None: half of t1.
        settle: length of the run after it, over which the backward vectors converge; None: half of t1.
        mode: mode at the start, where there are several.
        frame: (n, k) columns at the start; None: orthonormal vectors in generic directions.
        method: as for `lh.lyapunov_spectrum`, except `lh.ContinuousQR`.
        blocks: number of equal pieces of that part; vectors are given at its start and at the end of each piece.
        max_steps: most attempts of a step.
        progress: True for a bar, or a function of the fraction done.
        throw: raise where the run failed.

    Returns:
        `CovariantVectors` with `.time` (blocks + 1,), `.vectors` (blocks + 1, n, k), `.exponents`, `.angles`, `.x`,
        `.growth`, `.remainder` and `.status`. It says in print where vectors have not converged.

    Raises:
        ValueError: on arguments that do not fit.
        RunFailedError: where the run failed and `throw`.

    Source:
        F. Ginelli, P. Poggi, A. Turchi, H. Chaté, R. Livi & A. Politi, Phys. Rev. Lett. 99 (2007) 130601,
        doi:10.1103/PhysRevLett.99.130601.

    Example:
        >>> import jax.numpy as jnp, lyaphybrid as lh
        >>> cat = lh.Map(lambda n, x, args: jnp.stack([3 * x[0] + 2 * x[1], x[0] + x[1]]) % 1.0)
        >>> found = lh.covariant_vectors(cat, [0.1, 0.2], t1=100, blocks=100)
        >>> round(float(jnp.rad2deg(found.angles[0, 0])), 8)
        73.89788625
    """
    flag("throw", throw)
    whole("blocks", blocks, least=2, each=1)
    positive("t1, a length,", t1)
    check_counts(system, t1=t1, transient=transient, settle=settle)
    require_one_start("covariant_vectors", x0, has_rows(system))
    of_state = shape("x0", x0)
    n = math.prod(of_state)
    number = degrees_of_freedom(system, n) if k is None else k
    whole("k", number, least=1)
    transient, settle = (0.5 * t1 if length is None else length for length in (transient, settle))
    piece = t1 / blocks
    after = max(1, int(np.ceil(float(settle) / float(piece))))
    found = forwards(
        system, x0, args, k=number, piece=piece, pieces=blocks + after, transient=transient, t0=t0, mode=mode,
        frame=frame, method=grown_columns("covariant_vectors", method), max_steps=max_steps, progress=progress,
    )  # fmt: skip
    xp = numpy_for(found.time, found.collected, found.status)
    frames, factors, x = found.collected
    backwards = _backwards(frames, factors, _gaps_of(found.quiet, number))
    time, x, status, vectors, growth, remainders = map(xp.asarray, (found.time, x, found.status, *backwards))
    wanted = slice(0, blocks + 1)
    result = CovariantVectors(
        time[wanted] - time[0],
        x[wanted].reshape(-1, *of_state),
        vectors[wanted],
        growth[:blocks],
        xp.where(status == OK, remainders[:, wanted], xp.nan),  # vectors that no settling stretch follows have none
        status,
        labels_of(system, of_state),
        unit_of(system),
    )
    return verdict_of(found, as_jax(result), throw)


def forwards(system, x0, args, *, k, piece, pieces, transient, **how) -> IndicatorRun:
    """Run forwards; frame, factor and x at the end of the transient, at least one piece, and of each piece after it."""
    return follow(
        FactorObserver(), _frame_and_factor, system, x0, args, k=k, t1=piece * (1 + pieces), times=None,
        transient=max(0.0, transient - piece), blocks=1 + pieces, **how,
    )  # fmt: skip


def _gaps_of(quiet: BlockRecord | None, k: int):
    """(k − 1,) how much more than the next one each column has grown in the unrecorded part of a transient."""
    if quiet is None:
        return np.zeros(k - 1)
    xp = numpy_for(quiet.growth)
    first, last = quiet.growth
    first = first if quiet.order is None else first[quiet.order[1]]
    growth = first + last
    if quiet.losses is not None:
        growth = xp.where(quiet.losses[1] > 0, -xp.inf, growth)
    return _less(growth[:-1], growth[1:], xp)


def _less(a, b, xp=jnp):
    """The difference; zero where both are infinite: of two directions that are destroyed none grows more."""
    same = a == b
    return xp.where(same, 0.0, xp.where(same, 0.0, a) - xp.where(same, 0.0, b))


@compiled()
def _backwards(frames, factors: BlockProduct, gaps):
    """V_n = Q_n C_n (blocks, n, k), ln of their growth from n to n + 1 (blocks − 1, k), and their `_remainders`."""
    columns, growth = _coefficients(factors)
    return frames @ columns, growth, _remainders(factors, gaps)


def _coefficients(factors: BlockProduct):
    """The upper triangular C_n (blocks, k, k) with unit columns, and ln of the growth of the vectors."""
    # Orthogonal vectors at the end: their error is the cotangent of the true angle, and not one of ours.
    last = jnp.eye(factors.r.shape[1], dtype=factors.r.dtype)

    def back(c, factor):
        earlier, growth = _before(factor, c)
        return earlier, (earlier, growth)

    _, (columns, growth) = jax.lax.scan(back, last, jax.tree.map(lambda leaf: leaf[1:], factors), reverse=True)
    return jnp.concatenate([columns, last[None]]), growth


def _remainders(factors: BlockProduct, gaps) -> Array:
    """(2, blocks, k − 1) exp(−gap) over the past, which begins with `gaps`, and over the future.

    A gap begins anew between two directions that are destroyed together; it is infinite between one that goes on and
    one that is destroyed.
    """
    most = factors.r.shape[-1] - 2
    if most < 0:
        return jnp.zeros((2, len(factors.r), 0), factors.r.dtype)

    def past(gap, factor):
        live = factor.pivot < most + 2
        rows = jnp.where(live, _stretches(factor), -jnp.inf)
        gap = jnp.where(live[1:], gap[jnp.minimum(factor.pivot[:-1], most)], 0.0)
        gap = _sum(gap, _less(rows[:-1], rows[1:]))
        return gap, gap

    def future(gap, factor):
        stands_at = _stands_at(factor.pivot)
        live, row = jnp.any(stands_at, axis=1), jnp.argmax(stands_at, axis=1)
        columns = jnp.where(live, _stretches(factor)[row], -jnp.inf)
        gap = jnp.where(live[1:], gap[jnp.minimum(row[:-1], most)], 0.0)
        gap = jnp.where(live[:-1], _sum(gap, _less(columns[:-1], columns[1:])), 0.0)
        return gap, gap

    _, before = jax.lax.scan(past, jnp.asarray(gaps, factors.r.dtype), factors)
    none = jnp.zeros(most + 1, factors.r.dtype)
    _, after = jax.lax.scan(future, none, jax.tree.map(lambda leaf: leaf[1:], factors), reverse=True)
    return jnp.exp(-jnp.stack([before, jnp.concatenate([after, none[None]])]))


def _sum(a, b):
    """The sum; zero for ∞ − ∞: then what had converged is determined no more."""
    return jnp.where(jnp.isinf(a) & (a == -b), 0.0, a + b)


def _stretches(factor: BlockProduct) -> Array:
    """(k,) ln of the first entry of each row that is not zero."""
    at = jnp.minimum(factor.pivot, len(factor.pivot) - 1)
    return jnp.log(jnp.abs(jnp.take_along_axis(factor.r, at[:, None], axis=1)[:, 0])) + factor.logs


def angles_of_split(factors: BlockProduct, split: int, times: slice) -> tuple[Array, Array]:
    """The smallest angle between the spans of the first `split` vectors and of the others at some times.

    In coordinates of Q the first span is that of the first axes, since C is upper triangular; the other one is a graph
    [G; 1] over the other axes, with G = C₁₂ C₂₂⁻¹. The cotangent of the smallest angle is the largest singular value
    of G. With it what remains of the first errors of both spans: exp(−gap), where gap = ∫ (λ_split − λ_{split+1}) over
    the past or over the future, the smaller one.
    """
    columns = _coefficients(factors)[0][times]
    upper, lower = columns[:, :split, split:], columns[:, split:, split:]
    graph = jax.scipy.linalg.solve_triangular(jnp.swapaxes(lower, 1, 2), jnp.swapaxes(upper, 1, 2), lower=True)
    order = None if 1 in graph.shape[1:] else 2  # of one row or column the Frobenius norm is the singular value
    remainders = jnp.max(_remainders(factors, jnp.zeros(factors.r.shape[-1] - 1)), axis=0)
    return jnp.arctan2(1.0, jnp.linalg.norm(graph, order, axis=(1, 2))), remainders[times, split - 1]


def _stands_at(pivot):
    """(k, k) whether column i is the pivot of row j."""
    return pivot[None, :] == jnp.arange(len(pivot), dtype=pivot.dtype)[:, None]


def _before(factor: BlockProduct, c):
    """C_{n-1} with unit columns from R_n and C_n, and ln of their growth.

    Column p is determined by the row whose pivot is p; without such a row it is a vector of the kernel. It is found
    times e^logs of that row, next to which those above it are large.
    """
    r, logs, pivot, k = factor.r, factor.logs, factor.pivot, c.shape[0]
    columns = jnp.arange(k, dtype=pivot.dtype)
    stands_at = _stands_at(pivot)
    goes_on = jnp.any(stands_at, axis=1)
    own = jnp.argmax(stands_at, axis=1)
    scaled = c[:, own] * jnp.exp(jnp.minimum(logs[own][None, :] - logs[:, None], LARGEST_GROWTH))
    wanted = jnp.where(goes_on[None, :], scaled, 0.0)
    known = jnp.where(goes_on[None, :], 0.0, jnp.eye(k, dtype=c.dtype))

    def solve(i, solution):
        row = k - 1 - i
        at = jnp.minimum(pivot[row], k - 1)
        entry = r[row, at]
        rest = wanted[row] - (r[row] @ solution - entry * solution[at])
        new = rest / jnp.where(entry == 0, 1.0, entry)
        return jnp.where((pivot[row] < k) & (columns == at)[:, None], new[None, :], solution)

    solution = jax.lax.fori_loop(0, k, solve, known)
    length = jnp.linalg.norm(solution, axis=0)
    return solution / length[None, :], jnp.where(goes_on, logs[own] - jnp.log(length), -jnp.inf)
