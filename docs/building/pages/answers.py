"""The page of mistakes and answers: each mistake of the table that is a test is made, and its answer written down."""

import importlib.util
import re
import sys
import warnings
from pathlib import Path

import jax

TABLE = "tests/package/mistakes.py"
SUPPORT = "tests/support"  # on the path of the tests: the table imports from there
HEAD = """# Mistakes and answers

What the package answers to {count} mistakes: what was given, what was wanted, what to do. A test makes each of
them; the answers here are what it said when these pages were built.
"""
PARTS = {"FUNCTIONS": "In a function of the system", "ARGUMENTS": "In what a call is given"}


def table(root: Path):
    """The module that holds the mistakes, of a checkout at `root`."""
    spec = importlib.util.spec_from_file_location("mistakes_of_users", root / TABLE)
    assert spec is not None
    assert spec.loader is not None
    module = sys.modules[spec.name] = importlib.util.module_from_spec(spec)
    sys.path.insert(0, str(root / SUPPORT))
    try:
        spec.loader.exec_module(module)
    finally:
        sys.path.remove(str(root / SUPPORT))
    return module


def answer(call) -> str:
    """What a call says that cannot be answered."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            call()
    except Exception as error:
        said = re.sub(r" at 0x[0-9a-f]+", "", str(error))
        return f"{type(error).__name__}: {said}"
    raise AssertionError(f"{call} was answered")


def prose(message: str) -> str:
    """A message as Markdown: what it has in backticks is code, all else is plain."""
    parts = message.split("`")
    if len(parts) % 2 == 0:  # a backtick of its own
        return f"`` {message} ``"
    parts[::2] = [re.sub(r"([\\*_\[\]<>$|#])", r"\\\1", part) for part in parts[::2]]
    return "`".join(parts)


def section(title: str, mistakes) -> str:
    """A part of the page."""
    lines = [f"{prose(name)}\n: {prose(answer(mistake.call))}\n" for name, mistake in mistakes.items()]
    return f"\n## {title}\n\n" + "\n".join(lines)


def pages(root: Path) -> dict[str, str]:
    """The one page."""
    jax.config.update("jax_enable_x64", True)
    module = table(root)
    parts = {title: getattr(module, name) for name, title in PARTS.items()}
    count = sum(map(len, parts.values()))
    return {"help/answers.md": HEAD.format(count=count) + "".join(section(*part) for part in parts.items())}
