"""The code on the pages of the site and in the README runs, and prints what they show."""

from pathlib import Path

import pytest

import pages

ROOT = Path(__file__).parents[2]
WITH_CODE = [
    path.relative_to(ROOT).as_posix()
    for path in [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
    if pages.blocks(path.read_text())
]


@pytest.mark.slow
@pytest.mark.parametrize("page", WITH_CODE)
def test_the_code_of_a_page_runs_and_prints_what_it_shows(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert pages.faults((ROOT / page).read_text()) == []


PAGE = """
```python
x = 0.5
print(f"λ1 {x}(12)")
```

```text
λ1 %s
```

```python
y = x + 1
```
"""


@pytest.mark.parametrize("shown", ["0.5(12)", "0.9(11)"])
def test_numbers_agree_within_their_errors(shown):
    assert pages.faults(PAGE % shown) == []


@pytest.mark.parametrize("shown", ["9.5(12)", "0.5(2)", "0.5", "0.5(12) x"])
def test_what_is_not_so_is_found(shown):
    assert len(pages.faults(PAGE % shown)) == 1


def test_code_that_does_not_run_is_found():
    with pytest.raises(NameError):
        pages.faults("```python\nnot_there\n```\n")


@pytest.mark.parametrize(
    ("found", "shown", "agree"),
    [
        ("9793 jumps", "9801 jumps", True),
        ("9793 jumps", "8801 jumps", False),
        ("to 3.6e-16", "to 1e-13", True),
        ("-0.5", "0.5", False),
        ("1.0000001", "1", True),
        ("t1=5, x1", "t1=5, x1", True),
    ],
)
def test_numbers_without_errors(found, shown, agree):
    assert (pages.differences(found, shown) == []) is agree
