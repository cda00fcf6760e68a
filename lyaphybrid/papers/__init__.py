"""Papers: their tables and figures, computed and compared. Each has a folder with the same two functions.

In its `reproduction`, `reproduce(quick=…)` computes and returns a `reproductions.Reproduction`, which prints as the
paper's tables and says whether it `passed`; `write(result, folder)` puts figures and numbers into files.
"""

import importlib

__all__ = ["AVAILABLE", "get"]

AVAILABLE = ("dinius", "fu", "linh", "skokos")


def get(name: str):
    """The module that reproduces a paper.

    Args:
        name: one of `AVAILABLE`.

    Raises:
        ValueError: on another name.
    """
    if name not in AVAILABLE:
        raise ValueError(f"There is no paper {name!r}; there are: {', '.join(AVAILABLE)}.")
    return importlib.import_module(f"{__name__}.{name}.reproduction")
