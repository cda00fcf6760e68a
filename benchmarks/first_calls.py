"""First calls: for every problem of the zoo the first and the second call of its spectrum, and what the first one does.

`python -m benchmarks.first_calls [NAME …]`; `--help` lists the names. Each problem has a process of its own, first with
an empty folder for machine code, then ("again") with the one that the first process has filled. Times in seconds,
imports not counted. "Tracing" is all that is neither compiling nor running: mostly JAX's tracing.
"""

import argparse
import collections
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time

SHARES = ("lowering", "LLVM", "XLA")


def measured(name: str) -> dict[str, float]:
    """First and second call of one problem, in this process."""
    began = time.perf_counter()
    import jax

    jax.config.update("jax_enable_x64", True)
    import lyaphybrid as lh
    from lyaphybrid.engine.blocks import part_of
    from lyaphybrid.native import DURATION_PREFIX

    seconds: dict[str, float] = collections.defaultdict(float)
    seconds["import"] = time.perf_counter() - began

    def listen(event: str, duration: float, **kwargs) -> None:
        if event.startswith(DURATION_PREFIX):
            seconds[event.rpartition("/")[2]] += duration
        elif event == "/jax/core/compile/backend_compile_duration":
            seconds["XLA"] += duration

    jax.monitoring.register_event_duration_secs_listener(listen)
    problem = getattr(lh.zoo, name)()
    lengths = {"t1": problem.t1, "transient": problem.transient}
    short = {name: part_of(problem.system, problem.clock, length, 0.01) for name, length in lengths.items()}
    for call in ("first", "second"):
        clock = time.perf_counter()
        problem.spectrum(**short, throw=False)
        seconds[call] = time.perf_counter() - clock
    return dict(seconds)


def in_a_process(name: str, folder: str, byte_code: str) -> dict[str, float]:
    """The same in a process of its own, which keeps machine code in one folder, and Python's byte code in another."""
    code = f"import json; from benchmarks.first_calls import measured; print(json.dumps(measured({name!r})))"
    done = subprocess.run(
        [sys.executable, "-c", code], env=_environment(folder, byte_code), capture_output=True, text=True, check=True
    )
    return json.loads(done.stdout.splitlines()[-1])


def _environment(folder: str, byte_code: str) -> dict[str, str]:
    """As on a user's machine, where byte code is kept: without it the import takes longer."""
    own = os.environ | {"LYAPHYBRID_CACHE": folder, "JAX_PLATFORMS": "cpu", "PYTHONPYCACHEPREFIX": byte_code}
    own.pop("PYTHONDONTWRITEBYTECODE", None)
    return own


def main(argv: list[str] | None = None) -> None:
    """Measure, and print a line for each problem when it is done."""
    from lyaphybrid import zoo

    parser = argparse.ArgumentParser(
        "python -m benchmarks.first_calls",
        description="What a user waits for at first: the first and the second call of the spectrum of each problem.",
        epilog="example: python -m benchmarks.first_calls lorenz63 chua",
    )
    parser.add_argument("names", metavar="NAME", nargs="*", help=f"problems (default: all): {', '.join(zoo.names())}")
    names = parser.parse_args(argv).names or list(zoo.names())
    unknown = [name for name in names if name not in zoo.names()]
    if unknown:
        parser.error(f"no problem is called {', '.join(unknown)}; --help lists them.")
    with tempfile.TemporaryDirectory() as byte_code:
        in_a_process(names[0], byte_code, byte_code)  # writes the byte code
        table(names, byte_code)


def table(names: list[str], byte_code: str) -> None:
    """A line for each problem, the median and the largest."""
    columns = ("first", *SHARES, "tracing", "second", "import")
    print(f"{'problem':24}" + "".join(f"{column:>10}" for column in (*columns, "again")))
    found = collections.defaultdict(list)
    for name in names:
        with tempfile.TemporaryDirectory() as folder:
            one, again = (in_a_process(name, folder, byte_code) for _ in range(2))
        one = collections.defaultdict(float, one)
        one["tracing"] = one["first"] - one["second"] - sum(one[share] for share in SHARES)
        one["again"] = again["first"]
        for column in (*columns, "again"):
            found[column].append(one[column])
        print(f"{name:24}" + "".join(f"{one[column]:10.2f}" for column in (*columns, "again")), flush=True)
    for label, of in (("median", statistics.median), ("largest", max)):
        print(f"{label:24}" + "".join(f"{of(found[column]):10.2f}" for column in (*columns, "again")))


if __name__ == "__main__":
    main()
