"""``python -m tests.fuzz KIND --seeds A:B`` runs the random cases of a kind; the exit status is 1 where one is wrong.

Kinds: see `kinds.KINDS`. Each seed is one case. Anything but a right answer, a documented exception or a STATUS is a
failure, and its seed is printed: the same seed gives the same case again.
"""

import argparse
import os
import sys
import time
from pathlib import Path

AT_ONCE = 200  # cases after which what was found is printed


def main(argv=None) -> int:
    """Run the cases; print failures as they come."""
    from .kinds import KINDS

    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("kind", choices=[*KINDS, "all"])
    parser.add_argument("--seeds", default="0:1000", metavar="A:B", help="from A to B, B left out")
    options = parser.parse_args(argv)
    first, last = map(int, options.seeds.split(":"))
    wrong = 0
    for kind in KINDS if options.kind == "all" else (options.kind,):
        start = time.process_time()
        for begin in range(first, last, AT_ONCE):
            found = KINDS[kind](range(begin, min(begin + AT_ONCE, last)))
            wrong += len(found)
            for seed, what in found.items():
                print(f"{kind} {seed}: {what}", flush=True)
        print(f"{kind} {first}:{last}: {time.process_time() - start:.0f} s of a processor, {wrong} wrong", flush=True)
    return int(wrong > 0)


if __name__ == "__main__":
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    os.environ.setdefault("LYAPHYBRID_ENGINE", "auto")  # hostile arguments may ask for what only XLA compiles
    sys.path[:0] = [str(Path(__file__).parents[1]), str(Path(__file__).parents[1] / "support")]
    import jax

    jax.config.update("jax_enable_x64", True)
    sys.exit(main())
