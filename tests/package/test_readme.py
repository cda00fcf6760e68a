"""The README is short, its example draws a figure; lanes of `jax.vmap` are single runs; documents name what is there.

That the code of the README and of the pages runs and prints what they show is tested in `test_pages.py`.
"""

import re
from pathlib import Path

import jax
import numpy as np
import pytest
from matplotlib import pyplot
from numpy.testing import assert_allclose

import lyaphybrid as lh
import pages

ROOT = Path(__file__).parents[2]
PLACES = ("lyaphybrid", "lyaphybrid/native", ".")  # from which paths are written in ARCHITECTURE.md


def test_the_readme_is_short_and_its_pictures_are_there():
    text = (ROOT / "README.md").read_text()
    assert len(text.splitlines()) <= 150
    shown = re.findall(r"!\[[^\]]+\]\(([^)]+)\)", text)
    assert len(shown) == 2
    for picture in shown:
        assert 0 < (ROOT / picture).stat().st_size < 200_000


@pytest.mark.slow
def test_the_example_of_the_readme_draws_its_figure():
    (example,) = pages.blocks((ROOT / "README.md").read_text())
    names = {}
    pages.run(example, names)
    (path,) = names["motion"].figure.axes
    assert path.get_ylabel() == "x"
    (ax,) = pyplot.gcf().axes
    drawn = [line.get_ydata() for line in ax.lines if len(line.get_ydata()) == 64]
    assert_allclose(drawn, names["spectrum"].history.exponents.T)
    assert names["spectrum"].status == lh.STATUS.ok


@pytest.mark.slow
def test_lanes_are_single_runs():
    names = {}
    for block in pages.blocks((ROOT / "docs/start/jax_for_physicists.md").read_text()):
        printed = pages.run(block, names)
        if "jax.vmap" in block.code:
            lanes = np.fromstring(printed.strip(" []\n"), sep=" ")
    with jax.numpy_dtype_promotion("standard"):
        alone = [float(names["largest"](restitution)) for restitution in (0.5, 0.6, 0.7, 0.8)]
    assert lanes.shape == (4,)
    assert_allclose(lanes, alone, rtol=0, atol=1e-7)


def missing(document: Path) -> list[str]:
    """The files that a document names and that are not there."""
    named = set(re.findall(r"((?:\w+/)+\w+\.(?:py|json))", document.read_text()))
    return [name for name in named if not any((ROOT / place / name).exists() for place in PLACES)]


@pytest.mark.parametrize(("document", "least"), [("ARCHITECTURE.md", 20), ("CONTRIBUTING.md", 2)])
def test_documents_name_files_that_are_there(document, least):
    assert len(re.findall(r"(?:\w+/)+\w+\.py", (ROOT / document).read_text())) > least
    assert missing(ROOT / document) == []


@pytest.mark.parametrize(
    "page", [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))], ids=lambda page: page.stem
)
def test_the_pages_name_files_that_are_there(page):
    assert missing(page) == []
