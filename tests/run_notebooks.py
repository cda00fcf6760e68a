"""Execute the notebooks, each in a fresh kernel, two at a time: `python tests/run_notebooks.py [NAME …] [--write]`.

Exit status 1 where a cell fails. Names are parts of file names; none: all.
"""

import argparse
import asyncio
import itertools
import os
import sys
import time
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError, CellTimeoutError, DeadKernelError

os.environ.setdefault("LYAPHYBRID_ENGINE", "native")  # what only XLA can compile is an error

FOLDER = Path(__file__).parent.parent / "notebooks"
TIMEOUT = 600  # seconds a notebook
AT_ONCE = 2


async def execute(notebook: nbformat.NotebookNode) -> None:
    """Fill in the outputs of `notebook`."""
    client = NotebookClient(
        notebook,
        kernel_name="python3",
        timeout=TIMEOUT,
        record_timing=False,  # this and the next: outputs differ only where results do
        coalesce_streams=True,
        resources={"metadata": {"path": str(FOLDER)}},
    )
    await asyncio.wait_for(client.async_execute(), TIMEOUT)


async def passes(path: Path, room: asyncio.Semaphore, write: bool) -> bool:
    """Execute the notebook of a path, and say how it went."""
    async with room:
        notebook = nbformat.read(path, as_version=4)
        checks = sum("check" in cell.metadata.get("tags", ()) for cell in notebook.cells)
        start, verdict = time.perf_counter(), "ok"
        try:
            await execute(notebook)
        except (CellExecutionError, CellTimeoutError, DeadKernelError, TimeoutError) as error:
            print(f"{path.name}: {error or f'more than {TIMEOUT} s'}", file=sys.stderr)
            verdict = "FAILED"
        else:
            if write:
                nbformat.write(notebook, path)
        print(f"{path.name}: {verdict}, {checks} checks, {time.perf_counter() - start:.1f} s", flush=True)
        return verdict == "ok"


async def run_all(paths: list[Path], write: bool) -> list[bool]:
    """Which of the notebooks pass. They begin at both ends: two with sweeps would be slow together."""
    room, there_and_back = asyncio.Semaphore(AT_ONCE), zip(paths, reversed(paths), strict=True)
    order = list(itertools.chain.from_iterable(there_and_back))[: len(paths)]
    return await asyncio.gather(*(passes(path, room, write) for path in order))


def main() -> int:
    """Run the notebooks asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*")
    parser.add_argument("--write", action="store_true", help="store the outputs in place")
    options = parser.parse_args()
    names = options.names or [""]
    paths = [p for p in sorted(FOLDER.glob("*.ipynb")) if any(n in p.name for n in names)]
    passed = sum(asyncio.run(run_all(paths, options.write)))
    print(f"notebooks: {passed} passed, {len(paths) - passed} failed")
    return 0 if paths and passed == len(paths) else 1


if __name__ == "__main__":
    sys.exit(main())
