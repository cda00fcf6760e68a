"""From the records of a run to exponents: means, weights, error bars, history."""

import equinox as eqx
import jax
import jax.numpy as jnp

from . import runs
from .propagation import Journey, Record
from .results import History, Spectrum

__all__ = ["summarise"]


def summarise(outcomes: list[runs.Outcome], problem, clock: str, initial, averaging: str) -> Spectrum:
    """The spectrum of one run, or of several at once (leading axis m), continued over several outcomes.

    Args:
        outcomes: of successive calls of `runs.drive`.
        problem: what was run.
        clock: "time", "jumps" or "hybrid".
        initial: (k,) ln R_ii of the initial frame, to be counted.
        averaging: "uniform", "birkhoff" or "birkhoff-regular".
    """
    last = outcomes[-1]
    records = tuple(outcome.records for outcome in outcomes)
    names, interrupted = runs.mode_names(problem.system), jnp.asarray(last.interrupted)
    return _summary(records, last.journey, last.status, interrupted, initial, clock, averaging, names)


@eqx.filter_jit
def _summary(records, journey, status, interrupted, initial, clock, averaging, names) -> Spectrum:
    batched = journey.carry.x.ndim == 2
    chain = [_chained(part, batched) for part in records]
    blocks = jax.tree.map(lambda *parts: jnp.concatenate(parts, axis=1 if batched else 0), *chain)
    end = _end(journey, status, interrupted)
    if not batched:
        run = _one_run(blocks, clock, initial, averaging)
        return _spectrum(run, run["stderr"], None, end, "blocks", clock, names)
    run = jax.vmap(lambda r: _one_run(r, clock, initial, averaging))(blocks)
    m, replicates = run["exponents"].shape[0], run["exponents"]
    spread = jnp.std(run["finite"], axis=0, ddof=1) / m**0.5 if m > 1 else jnp.full_like(run["finite"][0], jnp.nan)
    mean = {name: jnp.mean(value, axis=0) for name, value in run.items()}
    first = jnp.min(jnp.where(jnp.isnan(run["first"]), jnp.inf, run["first"]), axis=0)
    mean |= {"losses": jnp.sum(run["losses"], axis=0), "first": jnp.where(jnp.isinf(first), jnp.nan, first)}
    return _spectrum(mean, spread, replicates, end, "replicates", clock, names)


def _chained(records: Record, batched: bool) -> Record:
    """Jumps and losses are counted from the start of a run: here, those of each block."""
    axis = 1 if batched else 0

    def per_block(total):
        return (
            None
            if total is None
            else jnp.diff(total, axis=axis, prepend=jnp.zeros_like(jnp.take(total, jnp.array([0]), axis)))
        )

    return records._replace(jumps=per_block(records.jumps), losses=per_block(records.losses))


def _one_run(records: Record, clock: str, initial, averaging: str) -> dict:
    """Exponents, errors and history of one run from its blocks."""
    valid = records.valid
    growth = jnp.where(valid[:, None], records.growth, 0.0)
    duration = jnp.where(valid, records.duration, 0.0)
    jumps = jnp.where(valid, records.jumps, 0).astype(duration.dtype)
    time, jumped = jnp.cumsum(duration), jnp.cumsum(jumps)
    reading = {"time": time, "jumps": jumped, "hybrid": jnp.maximum(time, jumped)}[clock]
    length = jnp.diff(reading, prepend=0.0)
    totals = _running_totals(growth, records.order, valid, initial)
    running = totals / _or_nan(reading)[:, None]
    if averaging == "uniform":
        finite = running[-1]
    else:
        finite = _birkhoff(growth, length, reading, valid, regular=averaging == "birkhoff-regular")
    losses = (
        jnp.zeros(finite.shape)
        if records.losses is None
        else jnp.sum(jnp.where(valid[:, None], records.losses, 0), axis=0)
    )
    count = jnp.maximum(jnp.sum(valid), 2).astype(growth.dtype)
    scatter = jnp.sum(jnp.where(valid[:, None], growth - finite[None, :] * length[:, None], 0.0) ** 2, axis=0)
    stderr = jnp.sqrt(scatter * count / (count - 1)) / _or_nan(reading[-1])
    late = (reading >= 0.5 * reading[-1]) & (valid | ~jnp.any(valid))
    volume = None if records.volume is None else jnp.sum(jnp.where(valid, records.volume, 0.0))
    residual = None if volume is None else jnp.abs(jnp.sum(growth) - volume) / _or_nan(reading[-1])
    run = {
        "exponents": jnp.where(losses > 0, -jnp.inf, finite),
        "finite": finite,
        "stderr": jnp.where(losses > 0, jnp.nan, stderr),
        "upper": jnp.max(jnp.where(late[:, None], running, -jnp.inf), axis=0),
        "lower": jnp.min(jnp.where(late[:, None], running, jnp.inf), axis=0),
        "losses": losses,
        "first": _first_losses(records, losses),
        "time": time[-1],
        "jumps": jumped[-1],
        "history_time": jnp.where(valid, reading, jnp.nan),
        "history": jnp.where(valid[:, None], running, jnp.nan),
        "growth": jnp.where(valid[:, None], growth, jnp.nan),
    }
    return run if residual is None else run | {"residual": residual}


def _first_losses(records: Record, losses):
    return jnp.full(losses.shape, jnp.nan) if records.collected is None else records.collected[-1]


def _safe(length):
    return jnp.where(length == 0, 1.0, length)


def _or_nan(length):
    """Without a length there is no answer."""
    return jnp.where(length == 0, jnp.nan, length)


def _running_totals(growth, order, valid, initial):
    """Σ growth up to each block; where columns changed places the sums change places with them."""
    if order is None:
        return initial[None, :] + jnp.cumsum(growth, axis=0)

    def add(total, block):
        gained, source, good = block
        total = jnp.where(good, total[source] + gained, total)
        return total, total

    return jax.lax.scan(add, initial, (growth, order, valid))[1]


def _birkhoff(growth, length, reading, valid, regular: bool):
    """Means with the weights w ∝ exp(-1/(s(1-s))), s the fraction of the run, at the middle of each block.

    S. Das, Y. Saiki, E. Sander & J. Yorke, Nonlinearity 30 (2017) 4111, doi:10.1088/1361-6544/aa84c2. For
    conservative regular motion the growth is linear in time, so the local exponent is 1/t, and is subtracted.
    """
    s = (reading - 0.5 * length) / _safe(reading[-1])
    inside = valid & (s > 1e-3) & (s < 1 - 1e-3)
    s = jnp.where(inside, s, 0.5)
    weight = jnp.where(inside, jnp.exp(-1 / (s * (1 - s))), 0.0) * length
    local = growth / _safe(length)[:, None]
    if regular:
        earlier = reading - length
        slope = jnp.log(_safe(reading) / jnp.where(earlier > 0, earlier, 1.0)) / _safe(length)
        local = local - jnp.sign(local) * jnp.where(earlier > 0, slope, 0.0)[:, None]
    return jnp.sum(weight[:, None] * local, axis=0) / _or_nan(jnp.sum(weight))


def _end(journey: Journey, status, interrupted) -> dict:
    """What is known where the run stands."""
    transversality, grazing, simultaneous, accumulation = runs.summary_of(journey)
    flags = [grazing, simultaneous, jnp.full_like(grazing, interrupted)]
    return {
        "x": journey.carry.x,
        "t": journey.base[..., 0] + journey.base[..., 1],
        "mode": runs.mode_of(journey.carry),
        "frame": journey.carry.frame,
        "min_transversality": jnp.min(transversality),
        "accumulation_time": accumulation,
        "status_code": status,
        "flags": jnp.stack(flags, axis=-1),
        "spread": journey.spread,
    }


def _spectrum(run: dict, stderr, replicates, end: dict, error_kind, clock, names) -> Spectrum:
    """Assemble the result, exponents descending."""
    rank = jnp.argsort(-jnp.where(jnp.isfinite(run["exponents"]), run["exponents"], -1e300), stable=True)
    return Spectrum(
        exponents=run["exponents"][rank],
        stderr=stderr[rank],
        finite_exponents=run["finite"][rank],
        time=run["time"],
        jumps=run["jumps"],
        upper=run["upper"][rank],
        lower=run["lower"][rank],
        losses=run["losses"][rank],
        first_loss=run["first"][rank],
        history=History(run["history_time"], run["history"][:, rank], run["growth"][:, rank]),
        replicates=None if replicates is None else replicates[:, rank],
        residual=run.get("residual"),
        error_kind=error_kind,
        clock=clock,
        mode_names=names,
        **end,
    )
