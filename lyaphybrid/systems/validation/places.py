"""Where in the user's own files an error arose, or an equation of a traced function was written."""

import linecache
import sys
import sysconfig
import traceback
from pathlib import Path
from types import TracebackType
from typing import NamedTuple

__all__ = ["SourcePlace", "place_of_equation", "place_of_error"]

PACKAGE_FOLDER = str(Path(__file__).parents[2])  # of this package
BETWEEN = ("jax", "jaxlib", "equinox", "diffrax", "optimistix", "lineax", "jaxtyping", "numpy", "scipy")
LONGEST_QUOTATION = 120  # characters of a quotation


class SourcePlace(NamedTuple):
    """A place in a file of the user."""

    file: str
    line: int
    text: str  # what stands there

    def __str__(self) -> str:
        """For example ``at `np.cos(x[0])` (oscillator.py, line 12)``."""
        quoted = f"at `{self.text}` " if self.text else ""
        cell = "ipykernel_" in self.file or self.file.startswith("<ipython")
        return f"{quoted}({'this cell' if cell else Path(self.file).name}, line {self.line})"


def place_of_error(trace: TracebackType | None) -> SourcePlace | None:
    """The innermost place of a traceback that is the user's; None if there is none."""
    own = [frame for frame in traceback.extract_tb(trace) if _is_own(frame.filename)]
    return SourcePlace(own[-1].filename, own[-1].lineno or 0, _expression(own[-1])) if own else None


def place_of_equation(eqn) -> SourcePlace | None:
    """The line of the user that an equation of a jaxpr comes from; None if JAX does not tell."""
    frames = getattr(getattr(eqn.source_info, "traceback", None), "frames", ())
    own = next((frame for frame in frames if _is_own(frame.file_name)), None)
    return own and SourcePlace(own.file_name, own.line_num, _shortened(linecache.getline(own.file_name, own.line_num)))


def _is_own(file: str) -> bool:
    """Whether a file is the user's: neither of this package, nor of what lies between it and the user's function."""
    modules = (sys.modules.get(name) for name in BETWEEN)
    roots = [str(Path(module.__file__).parent) for module in modules if module is not None and module.__file__]
    standard = sysconfig.get_path("stdlib")
    if file.startswith("<frozen") or (file.startswith(standard) and "site-packages" not in file):
        return False
    return not any(file.startswith(root) for root in [PACKAGE_FOLDER, *roots])


def _expression(frame: traceback.FrameSummary) -> str:
    """The expression of a frame; the whole line where Python does not know which one."""
    line = linecache.getline(frame.filename, frame.lineno or 0)
    if frame.colno is None or frame.end_colno is None:
        return _shortened(line)
    single = frame.lineno == frame.end_lineno
    bytes_of_line = line.encode()[frame.colno : frame.end_colno if single else None]
    return _shortened(bytes_of_line.decode(errors="replace") + ("" if single else " …"))


def _shortened(line: str) -> str:
    line = " ".join(line.split())
    return line if len(line) <= LONGEST_QUOTATION else f"{line[: LONGEST_QUOTATION - 2]} …"
