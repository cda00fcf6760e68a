"""The other end of a worker."""

import json
import os
import select
import subprocess
import sys
import tempfile
from typing import Any

PATIENCE = 60.0  # seconds for one answer


class FailedError(Exception):
    """A worker ended, or did not answer in time; the text says which."""


class Conversation:
    """A worker that does one thing at a time: `with Conversation(peer, workload) as worker`."""

    def __init__(self, peer: str, workload: str):
        self._folder = tempfile.TemporaryDirectory()  # our machine code, so that the first call is one
        environment = os.environ | {"JAX_PLATFORMS": "cpu", "LYAPHYBRID_CACHE": self._folder.name}
        for name in ("PYTHONDONTWRITEBYTECODE", "OPENBLAS_CORETYPE", "OPENBLAS_L2_SIZE"):
            environment.pop(name, None)
        self._errors = tempfile.TemporaryFile("w+")  # noqa: SIM115  closed by __exit__
        self._process = subprocess.Popen(
            [sys.executable, "-m", "benchmarks.peers.worker", peer, workload],
            env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._errors, text=True,
        )  # fmt: skip

    def __enter__(self) -> "Conversation":
        return self

    def __exit__(self, *_) -> None:
        self._process.kill()
        self._process.communicate()
        self._errors.close()
        self._folder.cleanup()

    def listen(self) -> dict[str, Any]:
        """Its next answer."""
        assert self._process.stdout is not None
        if not select.select([self._process.stdout], [], [], PATIENCE)[0]:
            raise FailedError(f"no answer in {PATIENCE:g} s")
        line = self._process.stdout.readline()
        if not line:
            self._errors.seek(0)
            said = [line for line in self._errors.read().splitlines() if any(map(str.isalpha, line))]
            last = said[-1] if said else "without a word"
            raise FailedError(f"ended: {last}")
        return json.loads(line)

    def ask(self, **what) -> dict[str, Any]:
        """Tell it to run, and wait."""
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(json.dumps(what) + "\n")
            self._process.stdin.flush()
        except BrokenPipeError:
            pass  # what it said last is the answer
        return self.listen()
