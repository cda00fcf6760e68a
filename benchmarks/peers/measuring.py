"""One workload with all its programs: first calls one after the other, then the ladders, then warm runs in turn."""

import contextlib
from typing import Any

import numpy as np

from benchmarks.peers import converged
from benchmarks.peers.adapters import PEERS
from benchmarks.peers.conversation import Conversation, FailedError
from benchmarks.peers.precision import ENOUGH, TARGETS, wanted
from benchmarks.peers.workloads import WORKLOADS

QUICK = 4  # times shorter runs
ROUNDS, QUICK_ROUNDS = 7, 3
SHARE = 0.3  # seconds that the warm runs of one setting may take, after which it is left out of the rounds


def able(name: str) -> list[str]:
    """The installed programs that can do a workload, ours first."""
    return [peer for peer, one in PEERS.items() if one.can(WORKLOADS[name]) and one.version is not None]


def measure(name: str, quick: bool) -> dict[str, Any]:
    """The row of a workload: by program what `begin`, `climb` and the rounds found, or why it failed."""
    rows: dict[str, dict[str, Any]] = {peer: {} for peer in able(name)}
    length = WORKLOADS[name].long / (QUICK if quick else 1)
    with contextlib.ExitStack() as stack:
        workers = {}
        for peer, row in rows.items():
            try:
                worker = stack.enter_context(Conversation(peer, name))
                row.update(begin(worker, length))
                row["points"] = climb(worker, name, row)
                workers[peer] = worker
            except FailedError as failed:
                row["failed"] = str(failed)
        run_in_turn(workers, rows, length, quick)
    return {"length": length, "unit": WORKLOADS[name].unit, "title": WORKLOADS[name].title, "peers": rows}


def begin(worker: Conversation, length: float) -> dict[str, Any]:
    """The import and the first call, in seconds; the peak of memory after it in MB."""
    imported = worker.listen()["import"]
    return {"import": imported, **worker.ask(length=length)}


def climb(worker: Conversation, name: str, row: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """The error of each setting over the short length; `frame` is then said in words."""
    workload, frame = WORKLOADS[name], row.pop("frame")
    columns = workload.frame if frame is None else np.array(frame)
    row["frame"] = "identity" if frame is None else "its own"
    exact = converged.exponents(workload, columns)
    points = {}
    for i, label in enumerate(row.pop("ladder")):
        found = np.array(worker.ask(setting=i, length=workload.short)["exponents"])
        error = float(np.max(np.abs(found - exact)))
        points[label] = {"error": error if np.isfinite(error) else None, "seconds": []}
    return points


def run_in_turn(workers: dict[str, Conversation], rows: dict[str, Any], length: float, quick: bool) -> None:
    """Warm runs, A B A B …, of the settings that the targets need; each point gets its seconds and its length."""
    turns, spent = [], {}
    for peer in workers:
        points = rows[peer]["points"]
        errors = {label: np.inf if one["error"] is None else one["error"] for label, one in points.items()}
        turns += [(peer, i, list(points)[i]) for i in wanted(errors, TARGETS)]
    for turn in range(QUICK_ROUNDS if quick else ROUNDS):
        for peer, i, label in turns:
            row = rows[peer]
            if "failed" in row or spent.get((peer, i), 0.0) >= SHARE:
                continue
            with noted(row):
                point = row["points"][label]
                if turn == 0:
                    point["length"], seconds = long_enough(workers[peer], peer, i, length)
                else:
                    seconds = workers[peer].ask(setting=i, length=point["length"])["seconds"]
                point["seconds"].append(seconds)
                spent[peer, i] = spent.get((peer, i), 0.0) + seconds


def long_enough(worker: Conversation, peer: str, setting: int, length: float) -> tuple[float, float]:
    """The length, or ten or a hundred times as much where a run is shorter than `ENOUGH`; and the seconds of a run."""
    for longer in (1, 10, 100):
        if PEERS[peer].by_length:
            worker.ask(setting=setting, length=longer * length, repeated=PEERS[peer].repeated)
        seconds = worker.ask(setting=setting, length=longer * length)["seconds"]
        if seconds >= ENOUGH:
            break
    return longer * length, seconds


@contextlib.contextmanager
def noted(row: dict[str, Any]):
    """A failure is written down and ends nothing else."""
    try:
        yield
    except FailedError as failed:
        row["failed"] = str(failed)


def missing() -> list[str]:
    """The programs that are not installed."""
    return [peer for peer, one in PEERS.items() if one.version is None]


def versions() -> dict[str, str]:
    """Of the installed ones."""
    return {peer: one.version for peer, one in PEERS.items() if one.version is not None}
