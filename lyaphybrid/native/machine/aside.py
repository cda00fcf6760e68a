"""Object code made in a process beside this one, which does not wait for it.

LLVM lets one thread of a process in at a time. An optimisation takes seconds; made here, it would hold up whoever
calls a new program meanwhile, and the end of the process.
"""

import contextlib
import os
import subprocess
import sys
from collections.abc import Callable

from . import emission

_LOOK = 0.1  # seconds between two looks at whether the code is still wanted


class GivenUpError(Exception):
    """The code is not wanted any more, or the other process failed."""


def object_code_aside(
    text: str, level: int, scattered: bool, loops: bool, is_wanted: Callable[[], bool] = lambda: True
) -> bytes:
    """`emission.object_code`, in a process of its own where this system has them.

    Args:
        text: the module.
        level: LLVM's optimisation level, 0 to 3.
        scattered: whether to search for vectors among scalar instructions.
        loops: whether loops become vectors and are unrolled.
        is_wanted: asked from time to time; the process is ended where it says no.

    Raises:
        GivenUpError: the code is not wanted any more, or the process failed.
    """
    process = _begun(str(level), str(int(scattered)), str(int(loops)))
    if process is None:
        return emission.object_code(text, level, scattered, loops)
    with process:
        _give(process, text)
        while True:
            try:
                code, _ = process.communicate(timeout=_LOOK)
            except subprocess.TimeoutExpired:
                if not is_wanted():
                    process.kill()
                    raise GivenUpError from None
            else:
                break
    if process.returncode != 0 or not code:
        raise GivenUpError
    return code


def _give(process: subprocess.Popen, text: str) -> None:
    """Write the module before its code is read: a `communicate` that is called again would leave the rest unwritten."""
    assert process.stdin is not None
    with contextlib.suppress(OSError), process.stdin:  # the other end has failed: its exit status says so
        process.stdin.write(text.encode())
    process.stdin = None  # nothing more is written


def _begun(*options: str) -> subprocess.Popen | None:
    """The process; None where there can be none."""
    if not sys.executable:
        return None
    # -P: the names of files beside the program are not those of modules. LLVM is found where this process found it.
    command = [sys.executable, "-P", emission.__file__, *options]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    try:
        return subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=environment,
            start_new_session=True,  # Ctrl-C is not for it
            creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
        )
    except OSError:
        return None
