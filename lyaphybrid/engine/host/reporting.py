"""Progress of a run: a bar, or a function of the fraction done."""

import contextlib
import time
import warnings
from collections.abc import Callable, Iterator
from typing import TextIO

__all__ = ["line_of_progress", "reporter"]

SHARE_OF_A_LINE = 0.1  # where lines cannot be written over, one for each so much that is done


def reporter(progress, total: int = 100, unit: str = "%"):
    """A function to call with the fraction done, and with None at the end.

    `progress`: None for no report, True for a bar, or the user's function of the fraction done.
    """
    if progress is None or progress is False:
        return lambda fraction: None
    if callable(progress):
        return lambda fraction: None if fraction is None else progress(fraction)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # in a notebook without ipywidgets the bar is text
        from tqdm.auto import tqdm

    rate = "" if unit == "%" else ", {rate_fmt}"
    bar = tqdm(total=total, unit=unit, bar_format=f"{{l_bar}}{{bar}}| {{elapsed}}<{{remaining}}{rate}")

    def report(fraction):
        if fraction is None:
            bar.close()
        else:
            bar.update(round(total * fraction) - bar.n)

    return report


@contextlib.contextmanager
def line_of_progress(name: str, stream: TextIO) -> Iterator[Callable[[float], None]]:
    """A function to call with the fraction done, which says it on a stream: on a terminal in one line, written over.

    Args:
        name: of what is computed.
        stream: standard error, for example.
    """
    began, terminal, said = time.monotonic(), stream.isatty(), -1.0

    def write(text: str) -> None:
        stream.write(f"\r{text}\x1b[K" if terminal else f"{text}\n")
        stream.flush()

    def report(fraction: float) -> None:
        nonlocal said
        if fraction >= said + (0.01 if terminal else SHARE_OF_A_LINE) or (fraction >= 1.0 > said):
            said = fraction
            write(f"{name}: {100 * fraction:.0f} % after {time.monotonic() - began:.0f} s")

    write(f"{name}: compiling")
    try:
        yield report
    finally:
        if terminal:
            write("")
            stream.write("\r")
            stream.flush()
