"""Tiered compilation: code that is ready at once, and better code for programs that run for long.

LLVM needs much longer to optimise a module than to translate it, and most programs run for less time than the
optimisation would take (`benchmarks.first_calls` measures LLVM's part of a first call). So there are three codes:

- translated code, in which every number lies in memory: ready at once;
- code with numbers in registers: LLVM takes two to four times as long, nine times with many loops over memory, and the
  code 0.3 to 0.7 of the time;
- optimised code: LLVM takes twice as long again, and seven times with such loops, which become vectors and are written
  out. Only with them is it much faster than the second, by two to four times.

A program that is called repeatedly is only translated at first. If much is left to run, better code is made beside it,
in a process of its own, and later calls use it. Where runs are repeated it is made when they have taken as long as it
will take, and where nothing is known, when calls have taken three times as long: who has gone on for so long may go on.
A program that is one long call has no better code later: it gets what is made in a few seconds.
All codes give the same bits: no flag allows LLVM to change the order of a sum.
"""

import contextlib
import ctypes
import functools
import threading
import time
import zlib
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

from .aside import GivenUpError, object_code_aside
from .cache import if_kept, kept
from .code import Linked
from .emission import describe, object_code

FIRST_LEVEL, MIDDLE_LEVEL = 0, 1  # of `emission.object_code`, of the first code and of the second
MIDDLE_SECONDS_A_LINE = 4e-5  # estimated time for LLVM to make the second code of a line of a module, in seconds …
SECONDS_A_LINE = 1e-4  # … and the optimised one, …
SECONDS_A_BLOCK = 3e-3  # … which takes at least this for a block
WORTH_IT = 2  # better code is made if the remaining run time exceeds the time for making it by this factor …
AT_LAST = 3  # … or, where nobody says how much is left, if the past run time does by this factor …
REPEATED = 1.0  # … or by this one where runs are repeated; …
THIRD_CODE = 3  # … the optimised code only by so many times these, for it gains less
ONCE = 2  # a transient and a run
LONGEST_OPTIMISATION = 2.0  # longest optimisation, in seconds, that one long call waits for
THREAD = "lyaphybrid optimises"
_one_at_a_time = threading.Lock()


class _Code:
    """The linked machine code of a module."""

    def __init__(self, code: bytes, filled: Mapping[str, Sequence[int]]):
        linked = Linked(code, ["call", "handler"], filled)
        self.address = linked.address
        self.call = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p)(self.address("call"))


class _Effort(NamedTuple):
    """How hard LLVM tries: its level, and whether it makes vectors of scattered instructions, and of loops."""

    level: int
    scattered: bool = False
    loops: bool = False


_MIDDLE = _Effort(MIDDLE_LEVEL)


class Tiers:
    """A module's machine code, which is replaced by better code while it is in use."""

    def __init__(self, text: str, level: int, scattered: bool, patience: float, filled: Mapping[str, Sequence[int]]):
        """Compile the text, or take its code from the disk.

        Args:
            text: the module in LLVM IR, with the functions "call" and "handler".
            level: of the optimised code.
            scattered: whether vectors are made of scattered instructions in it.
            patience: seconds that the first code may take.
            filled: int32 values of globals of the module, by name, which its text does not tell.
        """
        self._filled = filled
        self._best, lines = _Effort(level, scattered, loops=True), text.count("\n")
        self._costs = {  # estimated times for LLVM, in seconds
            _MIDDLE: MIDDLE_SECONDS_A_LINE * lines,
            self._best: max(SECONDS_A_LINE * lines, SECONDS_A_BLOCK * text.count(":\n")),
        }
        self._spent, self._runs = 0.0, 0  # past run time, in seconds; runs that have ended
        self._lock, self._told = threading.Lock(), False
        self._asked: set[_Effort] = set()
        self._fixed: list[_Code] = []  # codes whose addresses were given out, and which must stay alive
        self._effort = self._within(patience) or _Effort(FIRST_LEVEL)
        for better in (self._best, _MIDDLE):
            if code := if_kept(_description(text, better)):
                self._effort = better
                break
        else:
            code = _made(text, self._effort, object_code)
        self._text = b"" if self.is_best else zlib.compress(text.encode(), 1)  # for better code
        self._code = _Code(code, filled)

    @property
    def is_best(self) -> bool:
        """Whether the code is the optimised one."""
        return self._effort == self._best

    def _within(self, patience: float) -> _Effort | None:
        """The greatest effort that takes no more than about `patience` seconds."""
        return self._greatest(lambda effort: self._costs[effort] <= patience)

    def _worth(self, seconds: float, factor: float) -> _Effort | None:
        """The greatest effort that is worth it for a run time, which must exceed its cost by the factor."""
        return self._greatest(lambda e: seconds > (THIRD_CODE if e == self._best else 1) * factor * self._costs[e])

    def _greatest(self, holds: Callable[[_Effort], bool]) -> _Effort | None:
        return next((effort for effort in (self._best, _MIDDLE) if holds(effort)), None)

    def __call__(self, inputs, outputs) -> None:
        """Run the function "call"; Python's lock is released meanwhile."""
        code = self._code  # this reference keeps the code alive if a thread replaces it meanwhile
        if self.is_best:
            code.call(inputs, outputs)
            return
        begun = time.perf_counter()
        code.call(inputs, outputs)
        self._spent += time.perf_counter() - begun
        if not self._told and self._spent > AT_LAST * self._costs[_MIDDLE]:
            self._improve_aside(self._worth(self._spent, AT_LAST))

    def ahead(self, seconds: float) -> None:
        """Report the estimated remaining run time in seconds; better code is made if that is long enough."""
        self._told = True
        self._improve_aside(self._worth(seconds, WORTH_IT))

    def ended(self) -> None:
        """Report the end of a run, which may have consisted of several calls."""
        self._runs += 1
        if self._runs > ONCE:
            self._improve_aside(self._worth(self._spent, REPEATED))

    def _improve_aside(self, effort: _Effort | None) -> None:
        if effort is None or self.is_best or self._asked & {effort, self._best}:
            return
        self._asked.add(effort)
        threading.Thread(target=self._improve_in_turn, args=(effort,), name=THREAD).start()

    def _improve_in_turn(self, effort: _Effort) -> None:
        """Wait for the codes that were begun earlier; where Python has begun to end meanwhile, leave it."""
        with _one_at_a_time, contextlib.suppress(GivenUpError):  # Python ends after all threads: none may hold it up
            if _goes_on():
                self._improve(effort, functools.partial(object_code_aside, is_wanted=_goes_on))

    def _improve(self, effort: _Effort, make: Callable[..., bytes]) -> None:
        with self._lock:
            if self._effort not in (effort, self._best):
                self._code = _Code(_made(zlib.decompress(self._text).decode(), effort, make), self._filled)
                self._effort = effort
                if self.is_best:
                    self._text = b""

    def address(self, function: str, patience: float) -> int:
        """The address of a function, valid as long as this object lives.

        The code is optimised first if that takes no more than about `patience` seconds.
        """
        if effort := self._within(patience):
            self._improve(effort, object_code)
        self._fixed.append(self._code)
        return self._code.address(function)


def _description(text: str, effort: _Effort) -> str:
    return f"{describe()}, level {effort.level}, scattered {effort.scattered}, loops {effort.loops}\n{text}"


def _made(text: str, effort: _Effort, make: Callable[..., bytes]) -> bytes:
    return kept(_description(text, effort), lambda: make(text, *effort))


def _goes_on() -> bool:
    """Whether Python has not begun to end."""
    return threading.main_thread().is_alive()
