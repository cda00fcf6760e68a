"""tests/papers.md, the table of the papers' items: what it names is there."""

import ast
import re
from pathlib import Path

import pytest

import lyaphybrid as lh
from lyaphybrid import papers

ROOT = Path(__file__).parents[2]
PACKAGE, TESTS = ROOT / "lyaphybrid", ROOT / "tests"
WITHOUT_A_TEST = {  # items for which a paper has no number
    "§III.B: the values of references [2] and [4]",
    "§1, §4: precision and speed against reference [4]",
}


def rows():
    """(item, where, test, where a user sees it) of all tables."""
    lines = (TESTS / "papers.md").read_text().splitlines()
    cells = [re.split(r"(?<!\\) \| ", line.strip("| ")) for line in lines if line.startswith("| ")]
    return [row for row in cells if row[0] != "item"]


def quoted(text):
    return re.findall(r"`([^`]+)`", text)


def defined(path):
    """Names of functions, classes, methods and values in a file."""
    tree = ast.parse(path.read_text())
    found = {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.ClassDef)}
    return found | {
        node.id for node in ast.walk(tree) if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)
    }


FILES_OF_TESTS = sorted(TESTS.rglob("test_*.py"))
FUNCTIONS = {name for path in FILES_OF_TESTS for name in defined(path) if name.startswith("test_")}


@pytest.mark.parametrize("row", rows(), ids=lambda row: row[0][:40])
def test_a_row_names_what_is_there(row):
    assert len(row) == 4, row
    item, where, test, seen = row
    files = [name for name in quoted(where) if name.endswith(".py")]
    for name in files:
        assert (PACKAGE / name).is_file(), name
    known = {name for path in files for name in defined(PACKAGE / path)}
    for name in quoted(where):
        if name.startswith("lh."):
            assert hasattr(lh, name[3:]), name
        elif name.isidentifier():
            assert name in known, name
        else:  # a file, an argument, or what JAX has
            assert name.endswith(".py") or "=" in name or name in ("jax.grad", "jax.jvp", "jax.vmap"), name
    names = [name for name in quoted(test) if re.match(r"test_|tests/|…", name)]
    assert names or item in WITHOUT_A_TEST
    for name in names:
        if name.endswith(".py"):
            assert [path for path in FILES_OF_TESTS if path.as_posix().endswith("/" + name)], name
        else:
            assert any(one.endswith(name.lstrip("…")) if name[0] == "…" else one == name for one in FUNCTIONS), name
    for name in quoted(seen):
        for attribute in re.findall(r"\blh\.(\w+)", name):
            assert hasattr(lh, attribute), name
        for problem in re.findall(r"\bzoo\.(\w+)", name):
            assert hasattr(lh.zoo, problem), name
        for paper in re.findall(r"lyaphybrid papers (\w+)", name):
            assert paper in papers.AVAILABLE, name


def test_every_paper_has_its_items():
    text = (TESTS / "papers.md").read_text()
    named = set(re.findall(r"lyaphybrid papers (\w+)", text))
    assert named == set(papers.AVAILABLE)
