"""The documentation site: every public name has its page; what the build would not notice is noticed by its checks."""

import json
from collections import Counter
from pathlib import Path

import pytest

import lyaphybrid as lh
import portability
from docs import reproduced
from docs.building import checks, docstrings, links
from docs.building.pages import answers, claims, command_line, evidence, reference, words
from lyaphybrid import plots, zoo

ROOT = Path(__file__).parents[2]


def names_of(module: str) -> list[str]:
    return [name for task in reference.TASKS.values() if task.module == module for name in task.names]


@pytest.mark.parametrize(
    ("module", "wanted"),
    [
        ("lyaphybrid", [name for name in lh.__all__ if name != "zoo"]),
        ("lyaphybrid.plots", plots.__all__),
        ("lyaphybrid.zoo", zoo.__all__),
    ],
)
def test_every_public_name_stands_once_in_the_reference(module, wanted):
    assert sorted(names_of(module)) == sorted(wanted)


def test_every_task_is_in_the_reference_s_contents():
    contents = (ROOT / "docs" / "reference" / "index.md").read_text().splitlines()
    assert set(reference.TASKS) <= set(contents)


def write(folder: Path, name: str, body: str) -> Path:
    path = folder / name
    path.write_text(f"<html><head></head><body>{body}</body></html>")
    return path


@pytest.mark.parametrize(
    ("body", "fault"),
    [
        ("<p>the rate $\\lambda_1$ is</p>", "not drawn"),
        ("<p>a display $$x^2$$ here</p>", "not drawn"),
        ("<p>half a formula \\frac{1}{2}</p>", "not drawn"),
        ('<a href="gone.html">x</a>', "no such file: gone.html"),
        ('<a href="other.html#gone">x</a>', "no such place: other.html#gone"),
        ('<a href="#gone">x</a>', "no such place: #gone"),
        ('<img src="gone.png">', "no such file: gone.png"),
        ('<script src="https://example.org/x.js"></script>', "from elsewhere"),
    ],
)
def test_faults_of_a_page_are_found(tmp_path, body, fault):
    write(tmp_path, "other.html", '<p id="here">x</p>')
    write(tmp_path, "page.html", body)
    found = [one for one in checks.faults(tmp_path) if "no page for" not in one]
    assert len(found) == 1
    assert fault in found[0]


def test_a_good_page_has_no_faults(tmp_path):
    write(tmp_path, "other.html", '<p id="a%20b">x</p><span class="math notranslate">\\(\\lambda\\)</span>')
    good = '<a href="other.html#a%2520b">1</a> <a href="https://example.org">2</a> <code>$HOME $x$</code><br> costs 5$'
    write(tmp_path, "page.html", good + '<div class="math">\\[\\frac{1}{2}\\]</div>')
    assert [one for one in checks.faults(tmp_path) if "no page for" not in one] == []


def test_missing_pages_of_names_are_found(tmp_path):
    missing = checks.missing_names(tmp_path)
    assert "lyaphybrid.lyapunov_spectrum" in missing
    (tmp_path / "reference" / "api").mkdir(parents=True)
    (tmp_path / "reference" / "api" / "lyaphybrid.lyapunov_spectrum.html").touch()
    assert set(missing) - set(checks.missing_names(tmp_path)) == {"lyaphybrid.lyapunov_spectrum"}


@pytest.mark.parametrize(
    ("line", "plain"),
    [
        ("|Σ λ| of x_ and a*b", "\\|Σ λ\\| of x\\_ and a\\*b"),
        ("an `lh.Flow`, `x_*|y`", "an :obj:`lh.Flow <lyaphybrid.Flow>`, ``x_*|y``"),
        ("``**kwargs``", "``**kwargs``"),
        ("a_b stays", "a_b stays"),
    ],
)
def test_docstrings_hold_no_markup_but_code(line, plain):
    assert docstrings.plain(line) == plain


def test_examples_in_docstrings_stay_as_they_are():
    lines = ["a|b", "", ">>> a | b", "c|d", "", "e|f"]
    docstrings.process(None, None, None, None, None, lines)
    assert lines == ["a\\|b", "", ">>> a | b", "c|d", "", "e\\|f"]


def test_written_pages_say_all_there_is():
    (statuses,) = words.pages(ROOT).values()
    assert [status.name for status in lh.STATUS if f"## {status.name}\n" not in statuses] == []
    assert "   - rank" not in words.listed("plain")
    assert words.listed("why: (a) one; (b) two") == "why:\n\n   - one\n   - two"
    (commands,) = command_line.pages(ROOT).values()
    assert [
        name for name in ("list", "spectrum", "sweep", "validate", "papers") if f"lyaphybrid {name}\n" not in commands
    ] == []


def test_the_page_of_automata_counts_them():
    assert "holds 400 random hybrid automata" in evidence.automata(ROOT)


@pytest.mark.parametrize("path", sorted((ROOT / "docs").rglob("*.md")), ids=lambda path: path.name)
def test_pages_are_short(path):
    assert len(path.read_text().splitlines()) <= 450


@pytest.mark.parametrize(
    ("text", "linked"),
    [
        ("`lh.Flow` flows", "[`lh.Flow`](/reference/api/lyaphybrid.Flow.rst) flows"),
        ("`lh.Map(rule)`", "[`lh.Map(rule)`](/reference/api/lyaphybrid.Map.rst)"),
        ("`lh.zoo.stadium`", "[`lh.zoo.stadium`](/reference/api/lyaphybrid.zoo.stadium.rst)"),
        ("[`lh.sweep`](sweeps.md) `lh.nothing`", "[`lh.sweep`](sweeps.md) `lh.nothing`"),
        (
            "```{flowchart}\n=> `lh.Map`\n```\n",
            "```{flowchart}\n=> [`lh.Map`](/reference/api/lyaphybrid.Map.rst)\n```\n",
        ),
        ("a\n```python\n`lh.Flow`\n```\nb", "a\n```python\n`lh.Flow`\n```\nb"),
    ],
)
def test_names_on_pages_lead_to_the_reference(text, linked):
    assert links.linked(text) == linked


def test_an_answer_is_what_a_mistake_says():
    assert answers.answer(lambda: lh.Flow(None)).startswith("ValueError: ")
    with pytest.raises(AssertionError, match="was answered"):
        answers.answer(lambda: None)
    assert len(answers.table(ROOT).FUNCTIONS) > 40
    assert answers.prose("a_b of `x*y` | 2") == "a\\_b of `x*y` \\| 2"
    assert answers.prose("half a ` code") == "`` half a ` code ``"


def test_the_page_of_the_zoo_says_what_missed(tmp_path):
    run = {"way": "rk4", "exponents": [1.0], "stderr": [0.1], "known": [1.0], "has_reference": True, "seconds": 1.0}
    runs = [run | {"problem": "chua", "deviation": 0.5, "status": "ok"}]
    runs += [run | {"problem": "adex", "deviation": 9.25, "status": "ok"}]
    runs += [run | {"problem": "adex", "deviation": "inf", "status": "zeno", "has_reference": False}]
    path = tmp_path / "docs" / "evidence" / "validation.json"
    path.parent.mkdir(parents=True)
    path.write_text(json.dumps(runs))
    page = evidence.validation(tmp_path)
    assert "3 runs of 2 problems, 2 missed." in page
    assert "| rk4 | 9.2 | ok | its reference |" in page
    assert "| rk4 | inf | zeno | the first way |" in page


def test_the_page_of_grazing_counts_what_is_silently_wrong(tmp_path):
    row = {"method": "rk4", "cases": 9, "noted": 0, "without": 2e-7, "with": 0.0}
    rows = [row | {"decade": 1}, row | {"decade": 2, "noted": 6, "without": 0.03, "with": 0.5}]
    rows += [row | {"decade": 3, "noted": 9, "without": 0.0, "with": 40.0}]
    (tmp_path / "tests").mkdir()
    (tmp_path / "tests" / "near_grazing.json").write_text(json.dumps(rows))
    page = evidence.grazing(tmp_path)
    assert "by more than 1e-02: 3 of 27 results" in page
    assert "| rk4 | 2e-07 | 3e-02, 5e-01 (6 noted) | 4e+01 (9 noted) |" in page
    assert " 0 of 594 " in evidence.grazing(ROOT)


def test_the_matrix_that_is_kept_is_green():
    """The rows that were run so far, those of the first two Pythons among them."""
    rows = json.loads(portability.TABLE.read_text())
    asked = [(python, jax) for python in portability.PYTHONS for jax in portability.JAXS]
    assert [(row["python"], row["jax"]) for row in rows] == asked[: max(len(rows), 6)]
    for row in rows:
        assert row["versions"]["python"].startswith(f"{row['python']}.")
        assert row["jax"] in {"newest", row["versions"]["jax"]}
        assert row["ways"].keys() == portability.WAYS.keys()
        assert all(cell["green"] and cell["passed"] > 4 for cell in row["ways"].values())


def test_the_page_of_portability_is_the_matrix(tmp_path):
    green, red = {"green": True, "passed": 40}, {"green": False, "passed": 30, "failed": 2}
    rows = [
        {"python": "3.11", "jax": "newest", "versions": {"python": "3.11.7", "jax": "0.10.1"}, "ways": {"a": green}}
    ]
    rows += [{"python": "3.12", "jax": "0.8.0", "ways": {"a": red, "b": green}}]
    rows += [{"python": "3.13", "jax": "0.8.0", "missing": "no wheel"}]
    (tmp_path / "tests").mkdir()
    (tmp_path / "tests" / "portability.json").write_text(json.dumps(rows))
    page = evidence.portability(tmp_path)
    assert "| 3.11.7 | 0.10.1 | 40 | – |" in page
    assert "| 3.12 | 0.8.0 | **red**, 2 failed | 40 |" in page
    assert "| 3.13 | 0.8.0 | – | – |" in page


def test_the_page_of_claims_says_which_checks_fail():
    claim = {"item": "(1)", "says": "a|b", "found": "c_d", "outcome": "agreed", "why": None}
    page = claims.section({"paper": "P", "checks": {"one": True, "two": False}, "claims": [claim]})
    assert "1 of 2 checks hold; claims: 1 agreed." in page
    assert "**not found again**: two" in page
    assert "| (1) | a\\|b | c\\_d | agreed |  |" in page


@pytest.mark.parametrize("checks", [{"one": True}, [{"name": "one", "holds": True}]])
def test_checks_of_papers_are_kept_in_one_form(checks):
    report = {"paper": "P", "checks": checks, "claims": [], "more": 1}
    assert reproduced.kept(report) == {"paper": "P", "checks": {"one": True}, "claims": []}


def test_folders_of_the_site_are_short():
    """But for the gallery, where each script is a picture."""
    files = [path for path in (ROOT / "docs").rglob("*.*") if path.is_file() and path.suffix != ".pyc"]
    count = Counter(path.parent for path in files if path.name != "__init__.py")
    assert [folder for folder, files in count.items() if files > 12 and folder.name != "gallery"] == []
