"""The closing table of capabilities: two of its rows, the command, what is recorded, and the page."""

import json
from pathlib import Path
from types import SimpleNamespace

import pytest

from benchmarks.capabilities import CAPABILITIES, curves, noise, tables
from benchmarks.capabilities import __main__ as command
from benchmarks.capabilities.rows import Row, Stopwatch, measure
from docs.building.pages import evidence

ROOT = Path(__file__).parents[2]
RECORDED = json.loads(command.DATA.read_text())["capabilities"]


@pytest.mark.parametrize("row", [curves.border, noise.additive], ids=lambda row: row.__name__)
def test_a_row_finds_less_than_the_error_that_is_wanted(row):
    found = measure(row)
    assert found["passed"], found
    assert found["error"] <= found["wanted"] <= 1e-9
    assert 0 < found["second"] < found["first"]


def test_what_is_recorded_has_all_rows_and_none_missed():
    assert list(RECORDED) == list(CAPABILITIES)
    for name, module in CAPABILITIES.items():
        rows = RECORDED[name]["rows"]
        assert [row["row"] for row in rows] == [row.__name__ for row in module.ROWS]
        assert len(rows) >= 3
        for row in rows:
            assert row["passed"], row
            assert 0 <= row["error"] <= row["wanted"], row


def test_the_page_has_a_line_for_each_row():
    page = evidence.pages(ROOT)["evidence/capabilities.md"]
    lines = page.splitlines()
    for one in RECORDED.values():
        assert f"## {one['title']}" in lines
        for row in one["rows"]:
            assert tables.cells(row).strip() in lines
    assert "**" not in page


def near(clock: Stopwatch) -> Row:
    return Row("near", "closed form", clock(lambda: 1e-4), 1e-3, "m", "a | remark")


def far(clock: Stopwatch) -> Row:
    return Row("far", "closed form", clock(lambda: 1e-2), 1e-3)


def unknown(clock: Stopwatch) -> Row:
    return Row("unknown", "closed form", float("nan"), 1e-3)


def breaks(clock: Stopwatch) -> Row:
    raise ValueError("no such\nthing")


@pytest.mark.parametrize(("row", "passed"), [(near, True), (far, False), (unknown, False), (breaks, False)])
def test_a_row_passes_only_below_what_is_wanted(row, passed):
    found = measure(row)
    assert found["passed"] is passed
    assert ("MISSED" in tables.line(found)) is not passed
    assert ("**" in tables.cells(found)) is not passed


def test_a_row_that_fails_says_why_and_bars_have_no_meaning():
    assert measure(breaks)["remark"] == "ValueError: no such thing"
    assert tables.cells(measure(near)).startswith("| near: a \\| remark | closed form | 0.0001 m | 0.001 m |")


def test_the_command_ends_with_one_where_a_row_is_missed(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(command, "DATA", tmp_path / "capabilities.json")
    monkeypatch.setenv("LYAPHYBRID_CACHE", "off")  # given back at the end
    for rows, status in (((near,), 0), ((near, far), 1)):
        monkeypatch.setattr(command, "CAPABILITIES", {"one": SimpleNamespace(TITLE="One", ROWS=rows)})
        assert command.main(["--only", "one"]) == status
        assert not command.DATA.exists()
    assert "2 rows in 0 s of CPU, 1 missed" in capsys.readouterr().out
    with pytest.raises(SystemExit):
        command.main(["--record", "--only", "one"])
    assert command.main(["--record"]) == 1
    results = json.loads(command.DATA.read_text())
    assert [row["row"] for row in results["capabilities"]["one"]["rows"]] == ["near", "far"]
    assert "1 with an error above what is wanted" in tables.page(results).replace("\n", " ")
