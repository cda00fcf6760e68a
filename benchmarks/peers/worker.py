"""One program with one workload in a process of its own, which runs when it is told: a JSON object a line.

``python -m benchmarks.peers.worker PEER WORKLOAD``. It says how long the import took; told {"length": l} it makes the
first call, from nothing; then it answers each {"setting": i, "length": l}.
"""

import json
import os
import sys
import time
from typing import Any

import numpy as np

from benchmarks.harness import peak_memory
from benchmarks.peers.adapters import PEERS, Bound
from benchmarks.peers.workloads import WORKLOADS


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
        say(timed(bound, **json.loads(line)))


if __name__ == "__main__":
    main()
