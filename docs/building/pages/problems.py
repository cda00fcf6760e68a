"""The page of the zoo's problems with their references."""

from pathlib import Path

from lyaphybrid import zoo

HEAD = """# The problems and their references

Each is `lh.zoo.NAME(…)`; `print(lh.zoo.NAME().spectrum())` computes its exponents. References are known independently
of this package: in closed form, or computed by other programs; digits in brackets are one standard error.

| problem | what | reference |
|---|---|---|
"""


def summary(function) -> str:
    """The first line of a docstring."""
    return (function.__doc__ or "").strip().splitlines()[0].replace("|", "\\|")


def row(name: str) -> str:
    """The line of a problem."""
    function = getattr(zoo, name)
    reference = function().reference
    values = "none" if reference is None else str(reference).replace("|", "\\|")
    return f"| [`{name}`](api/lyaphybrid.zoo.{name}.rst) | {summary(function)} | {values} |\n"


def pages(root: Path) -> dict[str, str]:
    """The one page."""
    return {"reference/problems.md": HEAD + "".join(map(row, zoo.names()))}
