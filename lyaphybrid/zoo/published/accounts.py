"""What is known of a published flow, in words: the recorded spectrum, how it was found, and what was published."""

import numpy as np

from ..._text import with_error
from .spectra import AGREE, Known, Recorded, recorded
from .table import IN_ZOO, Entry, entry_of, flow

__all__ = ["account", "as_data", "cells", "published_deviation", "summary"]

COMPUTE = "python -m benchmarks.reference_flows {}"


def account(name: str) -> str:
    """The recorded spectrum of a flow with its errors, its source, and the command that computes it again.

    Args:
        name: one of `zoo.flow_names()`.

    Raises:
        ValueError: on an unknown name.

    Example:
        >>> from lyaphybrid.zoo.published.accounts import account
        >>> print(account("sprott_s").splitlines()[0])
        sprott_s: chaos
    """
    if name in IN_ZOO:
        problem = flow(name)
        lines = [f"{name}", f"  exponents   {problem.reference}", f"  source      {problem.source}"]
        return "\n".join([*lines, f"  compute     lyaphybrid spectrum {name}"])
    entry = entry_of(name)
    found = recorded().get(name)
    parameters = ", ".join(f"{key} = {value:.10g}" for key, value in entry.parameters.items()) or "none"
    lines = [f"{name}: {found.kind if found else 'not computed'}", f"  parameters  {parameters}"]
    if found:
        lines += _of_spectrum(found)
    if entry.known:
        lines += [f"  published   {_values(entry.known.exponents)} ({entry.known.source})"]
    if found and entry.known:
        lines += [f"              {_comparison(entry.known, found)}"]
    lines += [f"  note        {note}" for note in _notes(entry)]
    return "\n".join([*lines, f"  source      {entry.source}", f"  compute     {COMPUTE.format(name)}"])


def summary(name: str) -> str:
    """One line: what a recorded flow does, and its exponents with their errors."""
    found = recorded()[name]
    return f"{name:<26}  {found.kind:<12}  {_with_errors(found.exponents, found.stderr)}"


def cells(name: str) -> tuple[str, str, str, str]:
    """A recorded flow as a row of a table: kind, exponents, published λ₁ and its deviation, other starts."""
    entry, found = entry_of(name), recorded()[name]
    kind = f"{found.kind}, driven" if entry.driven else found.kind
    kind = f"{kind}, after chaos that ends" if found.transient else kind
    known = "" if entry.known is None else f"{entry.known.exponents[0]:g}, {_comparison(entry.known, found)}"
    return kind, _with_errors(found.exponents, found.stderr), known, ", ".join(_led_to(*one) for one in found.starts)


def as_data(name: str) -> dict:
    """The same for another program: parameters, start, source, the recorded row, the published exponents.

    Raises:
        ValueError: on an unknown name, or one of a problem that has a reference but no recorded row.
    """
    if name in IN_ZOO:
        raise ValueError(f"{name} has its reference in `lyaphybrid spectrum {name} --json`.")
    entry, found = entry_of(name), recorded().get(name)
    return {
        "name": name,
        "parameters": entry.parameters,
        "start": list(entry.start),
        "driven": entry.driven,
        "conservative": entry.conservative,
        "note": entry.note,
        "source": entry.source,
        "published": None if entry.known is None else vars(entry.known),
        "recorded": None if found is None else vars(found),
    }


def published_deviation(known: Known, found: Recorded) -> float:
    """By how many combined errors the recorded λ₁ is off the published one."""
    return abs(found.exponents[0] - known.exponents[0]) / float(np.hypot(found.stderr[0], known.error))


def _of_spectrum(found: Recorded) -> list[str]:
    lines = [f"  exponents   {_with_errors(found.exponents, found.stderr)} per unit of time"]
    for i, one in enumerate(found.runs):
        values = _with_errors(one["exponents"], one["stderr"])
        lines.append(f"  {'by' if i == 0 else '  '}          {one['method']}: {values} over {one['time']:g}")
    differ = f"{found.deviation:.1f} combined standard errors{'' if found.agrees else ': they DISAGREE'}"
    off = max(one["sum_rule"] for one in found.runs)
    lines.append(f"              the two differ by {differ}; their sums are within {off:.1g} of the mean divergence")
    if found.transient:
        until, largest = found.transient["until"], found.transient["largest"]
        lines.append(
            f"  transient   chaos from the start, with λ₁ = {largest:.3g} on average, had ended by {until:.3g}"
        )
    if found.starts:
        lines.append(f"  starts      {', '.join(_led_to(*one) for one in found.starts)}")
    return lines


def _led_to(count: int, what: str, largest: float | None) -> str:
    return f"{count} {what}" + (f" (λ₁ = {largest:g})" if largest is not None else "")


def _values(values: tuple[float, ...]) -> str:
    return ", ".join(f"{value:g}" for value in values)


def _with_errors(values, errors) -> str:
    return ", ".join(with_error(value, error) for value, error in zip(values, errors, strict=True))


def _comparison(known: Known, found: Recorded) -> str:
    deviation = published_deviation(known, found)
    verdict = "agrees" if deviation <= AGREE else "DIFFERS"
    return f"{verdict}: off by {deviation:.1f} combined errors"


def _notes(entry: Entry) -> list[str]:
    notes = [entry.note] if entry.note else []
    if entry.driven:
        notes.append("driven by time: the exponent 0 of the phase is left out")
    if entry.conservative:
        notes.append("conserves volume: the exponents are those of the chaotic sea that the start lies in")
    return notes
