"""The reference values in tests/data: independent ground truth, by programs that share no code with ours.

Sources: event-driven C, Taylor integrators, 60- and 84-digit arithmetic, closed forms. A standard error is
one standard deviation; exponents of minus infinity are exact. What is loaded is shared: do not write into it.
"""

import functools
import json
import lzma
from pathlib import Path

import numpy as np

DATA = Path(__file__).parents[1] / "data"
_DTYPES = {"mask": bool} | dict.fromkeys(("tgt", "q", "j", "mode", "casc"), int)  # others: float


@functools.cache
def load_automata() -> dict:
    """400 random hybrid automata with closed-form flows: `groups`, `systems` (a list), `meta`.

    groups["n_m_K"] holds padded arrays, first axis the member: system s is row s["pos"] of
    groups[s["group"]]. In mode q x' = A[q] x + b[q]; transition j of mode q (where mask[q, j]) has the guard
    c·x + d + a sin(w t + p), the direction dir, the reset R x + r + s cos(u t) and the target mode tgt.

    A system's `ev` has one array a quantity, one row an event: t, q (mode before), j, mode (after),
    xm (x before), xp (x after), trans, sep_pre, sep_post, marg (NaN: none), casc (position in a cascade,
    0 outside). Where `ev_idx` exists only these events are stored.
    """
    data = _read("automata.json.xz")
    for group in data["groups"].values():
        for name, values in group.items():
            if isinstance(values, list) and name != "ids":
                group[name] = np.array(values, _DTYPES.get(name, float))
    for system in data["systems"]:
        event = system["ev"]
        event.setdefault("casc", [0] * len(event["t"]))
        system["ev"] = {k: np.array(v, _DTYPES.get(k, float)) for k, v in event.items()}
        for name in ("x0", "xT", "M"):
            system[name] = np.array(system[name], float)
        if "M20" in system:
            system["M20"]["M"] = np.array(system["M20"]["M"], float)
        extra = system.setdefault("extra", {})
        if "exponents" in extra:
            extra["exponents"] = np.array([-np.inf if e is None else e for e in extra["exponents"]])
    return data


@functools.cache
def load_event_driven() -> dict:
    """Hard disks, billiards, impacts, firing neurons.

    `hard_disks` by name; `billiards` by (system, parameter); `computed` by system; `exact` by id;
    `conventions`. The 60-digit case keeps its digits as strings.
    """
    data = _read("event_driven.json")
    data["billiards"] = {(e["sys"], e["par"]): e for e in data["billiards"]}
    data["computed"] = {e["system"]: e for e in data["computed"]}
    data["exact"] = _by_id(data["exact"])
    return data


@functools.cache
def load_nonsmooth() -> dict:
    """Dry friction, Filippov systems, relay, walkers, buck converter, by id."""
    return _by_id(_read("nonsmooth.json")["entries"])


@functools.cache
def load_maps_and_flows() -> dict:
    """Maps and smooth flows (`gt.…`), `megno`, `clv`, by id; numbers under `value` and `se`."""
    return _by_id(_read("maps_and_flows.json"))


@functools.cache
def load_gradients() -> dict:
    """Derivatives of exponents with known answers, by id."""
    return _by_id(_read("gradients.json")["entries"])


@functools.cache
def load_tangent_dynamics() -> dict:
    """Exponents and GALIs of orbits of Skokos & Gerlach at τ = 0.05, by (orbit, method, t); a C program."""
    return {(e["orbit"], e["method"], e["t"]): e["found"] for e in _read("tangent_dynamics.json")}


def _by_id(entries: list) -> dict:
    return {e["id"]: e for e in entries}


def _read(name: str):
    raw = (DATA / name).read_bytes()
    return _with_infinities(json.loads(lzma.decompress(raw) if name.endswith(".xz") else raw))


def _with_infinities(value):
    match value:
        case dict():
            return {k: _with_infinities(v) for k, v in value.items()}
        case list():
            return [_with_infinities(v) for v in value]
        case "-inf":
            return -np.inf
    return value


def assert_agrees(spectrum, reference, gate):
    """Within 5 standard errors, and these below the gate."""
    values, errors = np.asarray(spectrum.exponents), np.asarray(spectrum.stderr)
    finite = np.isfinite(reference.exponents)
    assert np.array_equal(np.isneginf(values), ~finite)
    known, known_errors = np.array(reference.exponents)[finite], np.array(reference.stderr)[finite]
    off = np.abs(values[finite] - known) / np.maximum(np.hypot(errors[finite], known_errors), 1e-9)
    print(spectrum, f"reference {reference}", f"off by {off} standard errors", sep="\n")
    assert np.max(errors[finite]) <= gate
    assert np.all(off <= 5)
