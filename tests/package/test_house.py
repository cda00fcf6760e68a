"""How the package is laid out and named: what `CONTRIBUTING.md` asks of every file."""

import ast
import inspect
import re
from collections import defaultdict
from pathlib import Path

import pytest

import lyaphybrid as lh

ROOT = Path(lh.__file__).parent
FILES = {path.relative_to(ROOT).as_posix(): path.read_text() for path in sorted(ROOT.rglob("*.py"))}
TREES = {name: ast.parse(text) for name, text in FILES.items()}
LINES_OF_FILE, LINES_OF_FUNCTION, FILES_OF_FOLDER = 450, 60, 12

# Names that several files may have, because they mean the same in all of them.
OF_EACH_PAPER = {
    "FULL",
    "QUICK",
    "HEADS",
    "WIDTHS",
    "METHODS",
    "FIGURES",
    "WITHIN",
    "STEP",
    "PERIOD",
    "Lengths",
    "Reproduction",
}
SAME_MEANING = OF_EACH_PAPER | {
    "P", "T",  # type variables
    "PLAN", "RunEnd",
    "FORMAT", "VARIABLE", "SECONDS_PER_CALL", "HALVINGS", "EVENT_LOG_ROWS",
    "NEWTON_ITERATIONS", "WORST_CONDITION", "STAGES",
}  # fmt: skip
# Names of before, which no longer stand in the package.
BEFORE = (
    "Journey Carry BLUR _felt Seen Watch Cadence harvest _tidy does_little kept_stages blank_way Aim return_along "
    "Wiring Alignment Growth RunFailed NoPeriodicOrbit"
).split()
ALIASES = {"__init__.py", "errors.py"}  # say which new name an old public one has
TIMING = re.compile(r"\b\d[\d.]* ?(ms|seconds|minutes|hours)\b")


def defined():
    """(name, file) of each constant and class at the top of a file."""
    for file, tree in TREES.items():
        for node in tree.body:
            if isinstance(node, ast.ClassDef):
                yield node.name, file
            for target in getattr(node, "targets", [getattr(node, "target", None)]):
                for name in getattr(target, "elts", [target]):
                    if (
                        isinstance(name, ast.Name)
                        and name.id.isupper()
                        and isinstance(node, ast.Assign | ast.AnnAssign)
                    ):
                        yield name.id, file


def test_a_name_has_one_meaning():
    files = defaultdict(set)
    for name, file in defined():
        files[name].add(file)
    several = {name: sorted(where) for name, where in files.items() if len(where) > 1 and name not in SAME_MEANING}
    assert not several


def test_files_and_folders_are_short():
    assert [file for file, text in FILES.items() if len(text.splitlines()) > LINES_OF_FILE] == []
    count = defaultdict(int)
    for file in FILES:
        count[file.rpartition("/")[0]] += not file.endswith("__init__.py")
    assert {folder for folder, files in count.items() if files > FILES_OF_FOLDER} == set()


def test_functions_are_short_or_say_why_not():
    """Lines of code; docstrings do not count. A longer one has a comment `# Long: …` as its first line."""
    long = []
    for file, tree in TREES.items():
        lines = FILES[file].splitlines()
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef):
                described = isinstance(node.body[0], ast.Expr) and isinstance(node.body[0].value, ast.Constant)
                first = node.body[0].end_lineno + 1 if described else node.body[0].lineno
                explained = "# Long:" in "".join(lines[first - 2 : first])
                if node.end_lineno - first + 1 > LINES_OF_FUNCTION and not explained:
                    long.append(f"{file}: {node.name}")
    assert long == []


@pytest.mark.slow
def test_no_name_of_before_is_left():
    found = []
    for file, tree in TREES.items():
        for node in ast.walk(tree):
            name = getattr(node, "id", None) or getattr(node, "attr", None) or getattr(node, "name", None)
            if name in BEFORE and file not in ALIASES:
                found.append((file, name))
    assert found == []


@pytest.mark.slow
def test_no_docstring_has_a_timing():
    found = []
    for file, tree in TREES.items():
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef | ast.ClassDef | ast.Module):
                found += [(file, match[0]) for match in TIMING.finditer(ast.get_docstring(node) or "")]
    assert found == []


@pytest.mark.parametrize("name", [name for name in lh.__all__ if inspect.isfunction(getattr(lh, name))])
def test_public_functions_are_annotated(name):
    signature = inspect.signature(getattr(lh, name))
    missing = [one.name for one in signature.parameters.values() if one.annotation is inspect.Parameter.empty]
    assert missing == []
    assert signature.return_annotation is not inspect.Signature.empty
