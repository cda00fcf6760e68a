"""Exponents from the block records of a run: means, weights, standard errors, history."""

from collections.abc import Sequence
from types import ModuleType
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from .._jax.engines import compiled
from .._jax.tracing import traced
from ..engine import problems
from ..engine.host import driver
from ..engine.states import BlockRecord, LoopState
from ..native import on_device
from ..systems.hybrid import Hybrid
from ..systems.labels import Labels
from ..systems.validation import has_identity_reset
from .errors import standard_error
from .spectrum import About, History, Spectrum
from .volumes import volume_error

__all__ = ["birkhoff_weights", "empty_columns", "one_run", "places", "summarise"]

T = TypeVar("T")


class RunOutput(NamedTuple):
    """The records and the final state of a run."""

    records: tuple[BlockRecord, ...]  # of successive calls of `driver.drive`
    loop_state: LoopState
    status: Any
    interrupted: Any
    initial: Any  # (k,) ln R_ii of the initial frame


def summarise(
    outcomes: Sequence[driver.Outcome],
    problem: problems.RunProblem,
    clock: str,
    initial: Any,
    averaging: str,
    labels: Labels,
    about: About,
) -> Spectrum:
    """The spectrum of one run, or of several at once (leading axis m), continued over several outcomes.

    Args:
        outcomes: of successive calls of `driver.drive`.
        problem: what was run.
        clock: "time", "jumps" or "hybrid".
        initial: (k,) ln R_ii of the initial frame, which are added to the growth.
        averaging: "uniform", "birkhoff" or "birkhoff-regular".
        labels: of the state.
        about: what was run, in words.
    """
    last = outcomes[-1]
    records = tuple(outcome.records for outcome in outcomes)
    found = RunOutput(records, last.loop_state, last.status, np.asarray(last.interrupted), initial)
    several = last.loop_state.carry.x.ndim == 2
    if several or traced(found):
        fields = _together(found, clock, averaging)
    else:
        # One run on the host is averaged with NumPy: compiling the same for a single use would take longer.
        with np.errstate(all="ignore"):
            fields = _of_one(np, jax.tree.map(np.asarray, found), clock, averaging)
        fields = _on_device(fields, last.loop_state.carry.x.dtype)
    words = {
        "error_kind": "replicates" if several else "blocks",
        "clock": clock,
        "mode_names": problems.mode_names(problem.system),
        "state_labels": labels,
        "about": about,
        "name": "",
    }
    fields["history"] = _module(History, fields["history"])
    return _module(Spectrum, fields | _of_problem(problem, fields) | words)


def _module(kind: type[T], fields: dict[str, Any]) -> T:
    """An equinox module with all its fields, made as from its leaves: its constructor takes as long as a short run."""
    made = object.__new__(kind)
    for name, value in fields.items():
        object.__setattr__(made, name, value)
    return made


def _of_problem(problem: problems.RunProblem, fields: dict[str, Any]) -> dict[str, Any]:
    """The fields of a result that depend on the problem, and the final state in the user's shape."""
    step = None if problem.method is None else problem.method.fixed_step
    step = None if step is None else jnp.asarray(step)
    guards = isinstance(problem.system, Hybrid) and any(
        transition.guard is not None and not transition.terminal for transition in problem.system.transitions
    )
    x = fields["x"]
    volume = None
    if step is not None and fields["residual"] is None:
        volume = volume_error(problem, fields["t"], x, fields["mode"])
    return {
        "x": x if len(problem.shape) == 1 else problems.in_rows(problem, x),
        "step": step,
        "volume_error": volume,
        "has_guards": guards and problem.system.fields is not None,
        "identity_reset": has_identity_reset(problem.system, jax.ShapeDtypeStruct(x.shape[-1:], x.dtype), problem.args),
    }


def _on_device(fields: dict[str, Any], dtype: np.dtype) -> dict[str, Any]:
    """NumPy's arrays as JAX arrays, floats in the given type."""
    leaves, tree = jax.tree.flatten(fields)
    arrays = [np.array(leaf, dtype if leaf.dtype.kind == "f" else leaf.dtype) for leaf in leaves]
    return jax.tree.unflatten(tree, on_device(arrays))


@compiled()
def _together(found: RunOutput, clock: str, averaging: str) -> dict[str, Any]:
    several = found.loop_state.carry.x.ndim == 2
    return _of_several(found, clock, averaging) if several else _of_one(jnp, found, clock, averaging)


def _of_one(xp: ModuleType, found: RunOutput, clock: str, averaging: str) -> dict[str, Any]:
    records, loop_state, status, interrupted, initial = found
    chain = [_chained(xp, part, 0) for part in records]
    blocks = chain[0] if len(chain) == 1 else jax.tree.map(lambda *parts: xp.concatenate(parts), *chain)
    run = one_run(xp, blocks, empty_columns(xp, loop_state), clock, initial, averaging)
    return _fields(xp, run, run["stderr"], None, _final_state_fields(xp, loop_state, status, interrupted))


def _of_several(found: RunOutput, clock: str, averaging: str) -> dict[str, Any]:
    records, loop_state, status, interrupted, initial = found
    chain = [_chained(jnp, part, 1) for part in records]
    blocks = jax.tree.map(lambda *parts: jnp.concatenate(parts, axis=1), *chain)
    end = _final_state_fields(jnp, loop_state, status, interrupted)
    empty = empty_columns(jnp, loop_state)
    run = jax.vmap(lambda r, empty: one_run(jnp, r, empty, clock, initial, averaging))(blocks, empty)
    m, replicates = run["exponents"].shape[0], run["exponents"]
    spread = jnp.std(run["finite"], axis=0, ddof=1) / m**0.5 if m > 1 else jnp.full_like(run["finite"][0], jnp.nan)
    mean = {name: jnp.mean(value, axis=0) for name, value in run.items()}
    first = jnp.min(jnp.where(jnp.isnan(run["first"]), jnp.inf, run["first"]), axis=0)
    mean |= {"losses": jnp.sum(run["losses"], axis=0), "first": jnp.where(jnp.isinf(first), jnp.nan, first)}
    return _fields(jnp, mean, spread, replicates, end)


def _chained(xp: ModuleType, records: BlockRecord, axis: int) -> BlockRecord:
    """Convert the jumps and losses of the records from totals since the start of the run to counts per block."""

    def before(total):
        start = xp.zeros_like(xp.take(total, np.array([0]), axis))
        return xp.concatenate([start, xp.take(total, np.arange(total.shape[axis] - 1), axis)], axis)

    records = records._replace(jumps=records.jumps - before(records.jumps))
    if records.losses is None:
        return records
    # Earlier losses must be permuted like the columns within the block.
    return records._replace(losses=records.losses - xp.take_along_axis(before(records.losses), records.order, -1))


def empty_columns(xp: ModuleType, loop_state: LoopState):
    """(k,) which columns are empty at the end: the tangent space of the final mode has fewer dimensions."""
    x, frame = loop_state.carry.x, loop_state.carry.frame
    return xp.all(frame == 0, axis=-2) & xp.all(xp.isfinite(x), axis=-1)[..., None]


def one_run(xp: ModuleType, records: BlockRecord, empty, clock: str, initial, averaging: str) -> dict:
    """Exponents, errors and history of one run; `empty` (k,): columns that are empty at its end."""
    valid = records.valid
    growth = xp.where(valid[:, None], records.growth, 0.0)
    duration = xp.where(valid, records.duration, 0.0)
    jumps = xp.where(valid, records.jumps, 0).astype(duration.dtype)
    time, jumped = xp.cumsum(duration), xp.cumsum(jumps)
    reading = {"time": time, "jumps": jumped, "hybrid": xp.maximum(time, jumped)}[clock]
    length = xp.diff(reading, prepend=0.0)
    losses, counts = xp.zeros(growth.shape[1:]), xp.zeros(growth.shape)
    if records.order is not None:  # sort the columns of all blocks in their final order
        where = places(xp, records.order, valid)
        growth = xp.take_along_axis(growth, where, 1)
        counts = xp.take_along_axis(xp.where(valid[:, None], records.losses, 0), where, 1)
        losses = xp.sum(counts, axis=0).astype(growth.dtype)
        initial = initial[xp.where(valid[0], records.order[0][where[0]], where[0])]
    running = (initial[None, :] + xp.cumsum(growth, axis=0)) / _or_nan(xp, reading)[:, None]
    finite, weights = running[-1], xp.ones_like(length)
    if averaging != "uniform":
        finite, weights = _birkhoff(xp, growth, length, reading, valid, regular=averaging == "birkhoff-regular")
    first = _first_losses(xp, records, losses)
    # Lost before growth was counted: never replaced, or, where the mode of the start had no room for it, later.
    before = empty | (xp.isfinite(first) & (losses == 0))
    gone = (losses > 0) | (before & xp.any(valid))
    course = xp.where((xp.cumsum(counts, axis=0) > 0) | before[None, :], -xp.inf, running)
    count = xp.maximum(xp.sum(valid), 2).astype(growth.dtype)
    whole = _or_nan(xp, reading[-1] if averaging == "uniform" else xp.sum(weights * length))
    stderr = standard_error(xp, weights[:, None] * growth, weights * length, finite, count, whole)
    late = (reading >= 0.5 * reading[-1]) & (valid | ~xp.any(valid))
    volume = None if records.log_volume is None else xp.sum(xp.where(valid, records.log_volume, 0.0))
    residual = None if volume is None else xp.abs(xp.sum(growth) - volume) / _or_nan(xp, reading[-1])
    run = {
        "exponents": xp.where(gone, -xp.inf, finite),
        "finite": finite,
        "stderr": xp.where(gone, xp.nan, stderr),
        "upper": xp.max(xp.where(late[:, None], course, -xp.inf), axis=0),
        "lower": xp.min(xp.where(late[:, None], course, xp.inf), axis=0),
        "losses": losses,
        "first": first,
        "time": time[-1],
        "jumps": jumped[-1],
        "history_time": xp.where(valid, reading, xp.nan),
        "history": xp.where(valid[:, None], course, xp.nan),
        "growth": xp.where(valid[:, None], growth, xp.nan),
        "history_losses": counts,
        "history_elapsed": xp.where(valid, time, xp.nan),
        "history_weights": xp.where(valid, weights, xp.nan),
    }
    return run if residual is None else run | {"residual": residual}


def _first_losses(xp: ModuleType, records: BlockRecord, losses):
    return xp.full(losses.shape, xp.nan) if records.collected is None else records.collected[-1]


def _nonzero(xp: ModuleType, length):
    return xp.where(length == 0, 1.0, length)


def _or_nan(xp: ModuleType, length):
    """The length, with 0 replaced by nan: a run of length 0 has no mean."""
    return xp.where(length == 0, xp.nan, length)


def places(xp: ModuleType, order, valid):
    """(blocks, k) for each column of the final frame, its index at the end of each block."""

    def before(place, block):
        source, good = block
        return xp.where(good, source[place], place), place

    place = np.arange(order.shape[1], dtype=order.dtype)
    if xp is np and bool(np.all(order == place)):
        return order
    if xp is jnp:
        return jax.lax.scan(before, jnp.asarray(place), (order, valid), reverse=True)[1]
    found = np.empty_like(order)
    for i in reversed(range(len(order))):
        place, found[i] = before(place, (order[i], valid[i]))
    return found


def _birkhoff(xp: ModuleType, growth, length, reading, valid, regular: bool):
    """Weighted Birkhoff averages, with the weights at the middle of each block; and these (blocks,).

    For regular motion in conservative systems (`regular`) columns grow like a power of the time, so the local exponent
    is that power divided by t; it is subtracted.
    """
    s = (reading - 0.5 * length) / _nonzero(xp, reading[-1])
    weights = xp.where(valid, birkhoff_weights(xp, s), 0.0)
    local = growth / _nonzero(xp, length)[:, None]
    if regular:
        earlier = reading - length
        slope = xp.log(_nonzero(xp, reading) / xp.where(earlier > 0, earlier, 1.0)) / _nonzero(xp, length)
        power = _growth_power(xp, growth, reading, valid)
        local = local - power * xp.where(earlier > 0, slope, 0.0)[:, None]
    each = weights * length
    return xp.sum(each[:, None] * local, axis=0) / _or_nan(xp, xp.sum(each)), weights


def birkhoff_weights(xp: ModuleType, s):
    """The weights w ∝ exp(-1/(s(1-s))) at fractions s of a run.

    S. Das, Y. Saiki, E. Sander & J. Yorke, Nonlinearity 30 (2017) 4111, doi:10.1088/1361-6544/aa84c2.
    """
    inside = (s > 1e-3) & (s < 1 - 1e-3)
    s = xp.where(inside, s, 0.5)
    return xp.where(inside, xp.exp(-1 / (s * (1 - s))), 0.0)


def _growth_power(xp: ModuleType, growth, reading, valid):
    """(k,) the integer p for which each column grows like t^p: 1, −1, or 0 in special directions."""
    log_time = xp.log(_nonzero(xp, reading))
    count = xp.maximum(xp.sum(valid), 1)
    log_time = xp.where(valid, log_time - xp.sum(xp.where(valid, log_time, 0.0)) / count, 0.0)
    return xp.round(log_time @ xp.cumsum(growth, axis=0) / _nonzero(xp, xp.sum(log_time**2)))


def _final_state_fields(xp: ModuleType, loop_state: LoopState, status, interrupted) -> dict:
    """The fields of the result that describe the final state."""
    transversality, grazing, simultaneous, accumulation, doubtful = problems.summary_of(loop_state, xp)
    flags = [grazing, simultaneous, xp.full_like(grazing, interrupted), problems.beyond_guard(loop_state, xp)]
    return {
        "x": loop_state.carry.x,
        "t": loop_state.base[..., 0] + loop_state.base[..., 1] + loop_state.carry.s,
        "mode": problems.mode_of(loop_state.carry, xp),
        "frame": loop_state.carry.frame,
        "min_transversality": xp.min(transversality),
        "accumulation_time": accumulation,
        "status_code": status,
        "flags": xp.stack(flags, axis=-1),
        "spread": xp.where(doubtful > 0, xp.inf, loop_state.spread),
    }


def _fields(xp: ModuleType, run: dict, stderr, replicates, end: dict) -> dict[str, Any]:
    """The arrays of the result, with the exponents in descending order."""
    rank = xp.argsort(-xp.where(xp.isfinite(run["exponents"]), run["exponents"], -xp.inf), stable=True)
    return {
        "exponents": run["exponents"][rank],
        "stderr": stderr[rank],
        "finite_exponents": run["finite"][rank],
        "time": run["time"],
        "jumps": run["jumps"],
        "upper": run["upper"][rank],
        "lower": run["lower"][rank],
        "losses": run["losses"][rank],
        "first_loss": run["first"][rank],
        "history": {
            "time": run["history_time"],
            "exponents": run["history"][:, rank],
            "growth": run["growth"][:, rank],
            "losses": run["history_losses"][:, rank],
            "elapsed": run["history_elapsed"],
            "weights": run["history_weights"],
        },
        "replicates": None if replicates is None else replicates[:, rank],
        "residual": run.get("residual"),
        **end,
    }
