"""Papers: their tables and figures, computed and compared. One module each, with the same two functions.

`reproduce(quick=…)` computes and returns a result that prints as the paper's table and says whether it
`passed`; `write(result, folder)` puts figures and numbers into files.
"""

import importlib

__all__ = ["AVAILABLE", "ANNOUNCED", "get"]

AVAILABLE = ("dinius", "fu", "skokos")
ANNOUNCED = ("linh",)  # of later versions


def get(name: str):
    """The module of a paper.

    Args:
        name: one of `AVAILABLE`.

    Raises:
        ValueError: on another name.
    """
    if name in ANNOUNCED:
        raise ValueError(f"The paper {name!r} is not in this version; there are: {', '.join(AVAILABLE)}.")
    if name not in AVAILABLE:
        raise ValueError(f"There is no paper {name!r}; there are: {', '.join(AVAILABLE)}.")
    return importlib.import_module(f"{__name__}.{name}")
