"""The results of the runs of a sweep, as named arrays."""

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .._arguments import require
from ..results.spectrum import Spectrum, guard_unreached, step_too_long, unresolved
from ..statuses import STATUS, gravest, verdicts

__all__ = ["NOTE_NAMES", "dims_of", "missing", "named", "outcome", "spectra_in"]

NOTE_NAMES = (
    "grazing", "simultaneous", "interrupted", "unresolved", "rank_lost", "step_too_long", "guard_unreached",
    "identity_reset", "beyond_guard",
)  # fmt: skip
KNOWN = {"exponents": "exponent", "stderr": "exponent", "finite_exponents": "exponent", "losses": "exponent"}


def named(result: Any) -> dict[str, Any]:
    """Arrays by name: the main fields of a `Spectrum`, nan if its run failed; the leaves of any other pytree."""
    if isinstance(result, Spectrum):
        return _of_spectrum(result)
    found = {}
    for path, leaf in jax.tree_util.tree_leaves_with_path(result, is_leaf=lambda one: isinstance(one, Spectrum)):
        name = jax.tree_util.keystr(path, simple=True, separator=".")
        if isinstance(leaf, Spectrum):
            found |= {f"{name}.{own}": value for own, value in _of_spectrum(leaf).items()}
        else:
            found[name or "value"] = jnp.asarray(leaf)
    require(bool(found), f"A run must return a Spectrum or a pytree of arrays; got {result!r}.")
    return found


def spectra_in(result: Any) -> list[Spectrum]:
    """The spectra among what a run returns."""
    leaves = jax.tree.leaves(result, is_leaf=lambda one: isinstance(one, Spectrum))
    return [leaf for leaf in leaves if isinstance(leaf, Spectrum)]


def _of_spectrum(spectrum: Spectrum) -> dict[str, Any]:
    status = gravest(spectrum.status_code)
    failed = (status != int(STATUS.ok)) & (status != int(STATUS.terminated))
    flags = jnp.any(jnp.atleast_2d(spectrum.flags), axis=0)
    lost, too_long = jnp.any(jnp.isneginf(spectrum.exponents)), jnp.asarray(step_too_long(spectrum))
    *flags, beyond = flags
    seen = [*flags, jnp.any(unresolved(spectrum.spread)), lost, too_long, jnp.asarray(guard_unreached(spectrum))]
    seen += [jnp.asarray(spectrum.identity_reset), beyond]
    return {
        "exponents": jnp.where(failed, jnp.nan, spectrum.exponents),
        "stderr": jnp.where(failed, jnp.nan, spectrum.stderr),
        "finite_exponents": jnp.where(failed, jnp.nan, spectrum.finite_exponents),
        "losses": spectrum.losses,
        "status": status.astype(jnp.int8),
        "notes": sum(one.astype(jnp.int16) << i for i, one in enumerate(seen)),
        "time": jnp.mean(spectrum.time),
        "jumps": jnp.mean(spectrum.jumps),
    }


def dims_of(name: str, ndim: int) -> tuple[str, ...]:
    """Names of the dimensions of a variable at one point; ndim: their number."""
    last = name.rpartition(".")[2]
    if last in KNOWN and ndim == 1:
        return (KNOWN[last],)
    return tuple(f"{name}_{i}" for i in range(ndim))


def missing(kind: np.dtype) -> Any:
    """The fill value for points that were not computed."""
    if np.issubdtype(kind, np.complexfloating) or np.issubdtype(kind, np.floating):
        return np.nan
    return False if kind == np.bool_ else -1 if np.issubdtype(kind, np.signedinteger) else np.iinfo(kind).max


def outcome(variables: Mapping[str, Any]) -> str:
    """How the runs of all spectra ended, and their notes, as in ``8 ok, 2 zeno; notes: 3 grazing``; "" without spectra.

    Args:
        variables: the arrays of a sweep by name.
    """
    paths = [name.removesuffix("losses") for name in variables if dims_of(name, 1) == ("exponent",)]
    own = [path for path in dict.fromkeys(paths) if {f"{path}losses", f"{path}status", f"{path}notes"} <= {*variables}]
    if not own:
        return ""

    def together(name: str) -> np.ndarray:
        return np.concatenate([np.ravel(variables[f"{one}{name}"]) for one in own])

    status, notes = together("status"), together("notes")
    there = status >= 0
    ended = [verdicts(status[there])] if np.any(there) else []
    ended += [f"{np.sum(~there)} not computed"] if not np.all(there) else []
    counts = {name: np.sum(notes[there] >> i & 1) for i, name in enumerate(NOTE_NAMES)}
    seen = ", ".join(f"{count} {name}" for name, count in counts.items() if count)
    return ", ".join(ended) + (f"; notes: {seen}" if seen else "")
