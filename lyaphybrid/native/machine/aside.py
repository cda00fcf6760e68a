"""Object code made in a process beside this one, which does not wait for it.

LLVM lets one thread of a process in at a time. An optimisation takes seconds; made here, it would hold up whoever
calls a new program meanwhile, and the end of the process.
"""

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable

from . import emission

_LOOK = 0.1  # seconds between two looks at whether the code is still wanted


class GivenUpError(Exception):
    """The code is not wanted any more, or the other process failed."""


def object_code_aside(text: str, level: int, scattered: bool, loops: bool, is_wanted: Callable[[], bool]) -> bytes:
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
    process = _begun(text, str(level), str(int(scattered)), str(int(loops)))
    if process is None:
        return emission.object_code(text, level, scattered, loops)
    with process:
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


def _begun(text: str, *options: str) -> subprocess.Popen | None:
    """The process, which reads the module; None where there can be none."""
    if not sys.executable:
        return None
    # -P: the names of files beside the program are not those of modules. LLVM is found where this process found it.
    command = [sys.executable, "-P", emission.__file__, *options]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    try:
        # From a file: to write into a pipe may block, and a `communicate` that is called again leaves the rest of its
        # input unwritten.
        with tempfile.TemporaryFile() as module:
            module.write(text.encode())
            module.seek(0)
            return subprocess.Popen(
                command,
                stdin=module,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                env=environment,
                start_new_session=True,  # Ctrl-C is not for it
                creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
            )
    except OSError:
        return None
