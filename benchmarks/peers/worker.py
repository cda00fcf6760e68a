"""One program with one workload in a process of its own, which runs when it is told: a JSON object a line.

``python -m benchmarks.peers.worker PEER WORKLOAD``. It says how long the import took; told {"length": l} it makes the
first call, from nothing; then it answers each {"setting": i, "length": l}, and with {"repeated": seconds} the last of
runs that go on for so long.
"""

import json
import os
import sys
import threading
import time
from typing import Any

import numpy as np

from benchmarks.harness import peak_memory
from benchmarks.peers.adapters import PEERS, Bound
from benchmarks.peers.workloads import WORKLOADS

OPTIMISES = "lyaphybrid optimises"  # the name of our threads that do; our package is not imported for other programs


def peak_mb() -> float:
    """Peak memory of this process; on Linux without what its parent had when it began it."""
    try:
        with open("/proc/self/status") as status:
            return next(int(line.split()[1]) for line in status if line.startswith("VmHWM")) / 1e3
    except OSError:
        return peak_memory()


def timed(bound: Bound, setting: int, length: float) -> dict[str, Any]:
    """One run."""
    chosen = list(bound.ladder.values())[setting]
    began = time.perf_counter()
    found = np.asarray(bound.run(chosen, length), float)  # waits for it
    seconds = time.perf_counter() - began
    return {"seconds": seconds, "exponents": np.sort(found)[::-1].tolist()}


def repeated(bound: Bound, setting: int, length: float, seconds: float) -> dict[str, Any]:
    """The last of runs that go on for so long, after which our optimising threads have ended their work."""
    spent, found = 0.0, timed(bound, setting, length)
    while spent < seconds:
        found = timed(bound, setting, length)
        spent += found["seconds"]
    for thread in threading.enumerate():
        if thread.name == OPTIMISES:  # threads of a pool never end
            thread.join()
    return found


def main() -> None:
    """Speak to the parent; what the programs print goes elsewhere."""
    out = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)

    def say(what: dict[str, Any]) -> None:
        print(json.dumps(what), file=out, flush=True)

    peer, name = sys.argv[1:]
    workload = WORKLOADS[name]
    began = time.perf_counter()
    adapter = PEERS[peer].adapter()
    say({"import": time.perf_counter() - began})
    length = json.loads(sys.stdin.readline())["length"]
    began = time.perf_counter()
    bound = adapter.KINDS[workload.kind](workload)
    timed(bound, bound.typical, length)
    first = time.perf_counter() - began
    frame = None if bound.frame is None else np.asarray(bound.frame).tolist()
    say({"first": first, "memory": peak_mb(), "frame": frame, "ladder": list(bound.ladder), "typical": bound.typical})
    for line in sys.stdin:
        asked = json.loads(line)
        seconds = asked.pop("repeated", 0.0)
        say(repeated(bound, **asked, seconds=seconds) if seconds else timed(bound, **asked))


if __name__ == "__main__":
    main()
