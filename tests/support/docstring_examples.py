"""The examples of docstrings: found in every module, and run as a user runs them."""

import doctest
import importlib
import pkgutil
from collections.abc import Iterator
from typing import Any

import jax

import lyaphybrid as lh

MODULES = [m.name for m in pkgutil.walk_packages(lh.__path__, "lyaphybrid.") if not m.name.endswith("__main__")]


def examples() -> Iterator[doctest.DocTest]:
    """Those of every module, by name."""
    finder = doctest.DocTestFinder(exclude_empty=True)
    for name in MODULES:
        yield from (test for test in finder.find(importlib.import_module(name), name) if test.examples)


def run(test: doctest.DocTest) -> tuple[int, dict[str, Any]]:
    """How many of its lines print something else than they say, and the names that it leaves.

    A user's promotion of types is not strict.
    """
    names = dict(test.globs)
    copy = doctest.DocTest(test.examples, names, test.name, test.filename, test.lineno, test.docstring)
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        failed, _ = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE).run(copy, clear_globs=False)
    return failed, copy.globs


def made_by_example(kind: type) -> Any:
    """The instance that the example in the docstring of a class makes, under whatever name."""
    (test,) = doctest.DocTestFinder(recurse=False, exclude_empty=True).find(kind, kind.__name__)
    failed, names = run(test)
    assert not failed
    made = [value for value in names.values() if type(value) is kind]
    assert made, f"The docstring of {kind.__name__} needs an example that makes one."
    return made[-1]
