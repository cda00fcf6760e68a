"""Papers: their tables and figures, computed and compared. A folder each, with the same two functions.

In its `reproduction`, `reproduce(quick=…)` computes and returns a result that prints as the paper's table and says
whether it `passed`; `write(result, folder)` puts figures and numbers into files.
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
