"""How hard LLVM tries, and when: code that is ready at once, and better code for what goes on running.

To optimise takes LLVM ten times as long as to translate, and the code is then 1.5 times as fast, or 8 times where it
loops over arrays (a pendulum with dry friction: 2.1 and 0.3 s of LLVM; four hard disks: 1.1 and 0.07 s). Most programs
run for less time than that. So what is called again and again is only translated at first. Where there is much left
to run, a thread makes better code, which the calls after that use. Both give the same bits: no flag lets LLVM change
the order of a sum.
"""

import ctypes
import threading
import time
import zlib

from .cache import if_kept, kept
from .code import Linked, describe, object_code

AT_ONCE = 0  # LLVM's level of code that is needed at once
SECONDS_A_LINE = 1e-4  # of a module: about what LLVM takes to optimise it
WORTH_IT = 2  # so many times as long must be left to run …
AT_LAST = 3  # … or be behind
PATIENCE = 2.0  # seconds of LLVM that one long call waits for at most
THREAD = "lyaphybrid optimises"


class _Code:
    """A module as machine code, linked."""

    def __init__(self, code: bytes):
        linked = Linked(code, ["call", "handler"])
        self.address = linked.address
        self.call = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p)(self.address("call"))


class Tiers:
    """A module's code, which becomes better while it is in use."""

    def __init__(self, text: str, level: int, scattered: bool, at_once: bool):
        """`level`, `scattered`: of the best code; `at_once`: code that takes LLVM little time comes first."""
        self._text, self._best = zlib.compress(text.encode(), 1), (level, scattered)
        self._cost, self._spent = cost(text), 0.0  # seconds: to optimise it, of running
        self._lock, self._asked = threading.Lock(), False
        self._fixed: list[_Code] = []  # which others know the addresses of
        best = if_kept(_description(text, *self._best)) if at_once else _made(text, *self._best)
        self.is_best = best is not None
        self._code = _Code(_made(text, AT_ONCE, False) if best is None else best)

    def __call__(self, inputs, outputs) -> None:
        """Run "call"; other threads of Python run meanwhile."""
        code = self._code  # alive while it runs, even if better code comes
        if self.is_best:
            code.call(inputs, outputs)
            return
        begun = time.perf_counter()
        code.call(inputs, outputs)
        self._spent += time.perf_counter() - begun
        if self._spent > AT_LAST * self._cost:
            self._improve_aside()

    def ahead(self, seconds: float) -> None:
        """So much is left to run, at the speed of the last call."""
        if seconds > WORTH_IT * self._cost:
            self._improve_aside()

    def _improve_aside(self) -> None:
        if not self.is_best and not self._asked:
            self._asked = True
            threading.Thread(target=self._improve, name=THREAD).start()

    def _improve(self) -> None:
        with self._lock:
            if not self.is_best:
                self._code = _Code(_made(zlib.decompress(self._text).decode(), *self._best))
                self._text, self.is_best = b"", True

    def address(self, function: str, patience: float) -> int:
        """Where a function of the code begins; it stays there as long as this object lives.

        Of the best code, if LLVM takes no more than `patience` seconds for that.
        """
        if self._cost <= patience:
            self._improve()
        self._fixed.append(self._code)
        return self._code.address(function)


def cost(text: str) -> float:
    """About how many seconds LLVM takes to optimise a module."""
    return SECONDS_A_LINE * text.count("\n")


def _description(text: str, level: int, scattered: bool) -> str:
    return f"{describe()}, level {level}, scattered {scattered}\n{text}"


def _made(text: str, level: int, scattered: bool) -> bytes:
    return kept(_description(text, level, scattered), lambda: object_code(text, level, scattered))
