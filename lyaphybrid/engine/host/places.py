"""The present state of runs in words, for messages about runs that ended early."""

from typing import Any, NamedTuple

import numpy as np

from ...statuses import STATUS, gravest, verdicts
from ..problems import mode_names, mode_of
from ..states import LoopState

__all__ = ["Place", "account", "place_of"]

COMPONENTS_SHOWN = 6  # most components of a state that are printed


class Place(NamedTuple):
    """Time, state and mode of one run, or of several (leading axis m)."""

    t: Any
    x: Any  # (n,)
    mode: Any  # its index
    names: tuple[str, ...]  # of all modes

    @classmethod
    def of(cls, t, x, mode, names: tuple[str, ...]) -> "Place":
        """From arrays of any kind; a scalar mode holds for all runs."""
        return cls(np.asarray(t), np.asarray(x), np.broadcast_to(np.asarray(mode), np.shape(t)), names)

    def of_run(self, run: int) -> "Place":
        """The place of one run among several."""
        return Place(self.t[run], self.x[run], self.mode[run], self.names)

    def __str__(self) -> str:
        """For example ``t = 1.5, x = [0.25 -1], mode 'up'``."""
        x = np.asarray(self.x, float).ravel()
        state = " ".join(f"{component:.6g}" for component in x[:COMPONENTS_SHOWN])
        more = f" … ({len(x)} components)" if len(x) > COMPONENTS_SHOWN else ""
        mode, known = int(self.mode), range(len(self.names))
        named = f"{self.names[mode]!r}" if mode in known else f"{mode}, which is none of {list(self.names)}"
        said = f", mode {named}" if len(self.names) > 1 or mode not in known else ""
        return f"t = {float(self.t):.10g}, x = [{state}{more}]{said}"


def place_of(loop_state: LoopState, system) -> Place:
    """The place of a loop's state."""
    carry = loop_state.carry
    t = loop_state.base[..., 0] + loop_state.base[..., 1] + carry.s
    return Place.of(t, carry.x, mode_of(carry, np), mode_names(system))


def account(codes, place: Place, accumulation: Any = None, why: str = "") -> str:
    """A message with the place where a run failed; of several runs, that of the first with the gravest status.

    Args:
        codes: the status code, or those of several runs (m,).
        place: of each run.
        accumulation: the time at which its events seem to accumulate; nan if unknown.
        why: the reason, if a run has stalled.
    """
    codes = np.asarray(codes)
    if codes.ndim == 0:
        return f"It stood at {place}.{_accumulates(codes, accumulation)}{_besides(codes, why)}"
    code = gravest(codes)
    run = int(np.argmax(codes == code))
    first = None if accumulation is None else np.asarray(accumulation)[run]
    where = f"Run {run} stood at {place.of_run(run)}.{_accumulates(code, first)}{_besides(code, why)}"
    return f"Of {len(codes)} runs: {verdicts(codes)}. {where}"


def _besides(code, why: str) -> str:
    return f" {why}" if int(code) == STATUS.stalled and why else ""


def _accumulates(code, time) -> str:
    if time is None or int(code) != STATUS.zeno or not np.isfinite(time):
        return ""
    return f" The events seem to accumulate at t = {float(time):.10g}."
