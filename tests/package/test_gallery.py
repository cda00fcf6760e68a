"""The scripts of the gallery run without a display, and each makes one figure that fits a page."""

import runpy
from pathlib import Path

import pytest
from matplotlib import animation, colors, pyplot, rcParams

SCRIPTS = sorted((Path(__file__).parents[2] / "docs" / "gallery").glob("plot_*.py"))
QUICK = ("plot_spiking_network", "plot_wedge_billiard")
WIDTHS = (3.4, 7.0)  # of one and of two columns, inches


@pytest.fixture(autouse=True)
def no_display(monkeypatch):
    monkeypatch.setattr(pyplot, "show", lambda: None)


def test_the_gallery_has_at_least_24_pictures():
    assert len(SCRIPTS) >= 24


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda script: script.stem)
def test_a_script_is_short_and_begins_with_its_title(script):
    lines = script.read_text().splitlines()
    assert len(lines) <= 40
    assert set(lines[2]) == {"="}
    assert len(lines[2]) >= len(lines[1])


@pytest.mark.slow
@pytest.mark.parametrize("script", SCRIPTS, ids=lambda script: script.stem)
def test_a_script_makes_one_figure(script, tmp_path, capsys):
    settings = dict(rcParams)
    names = runpy.run_path(str(script))
    assert dict(rcParams) == settings
    assert capsys.readouterr().out.strip()
    (number,) = pyplot.get_fignums()
    figure = pyplot.figure(number)
    for film in [value for value in names.values() if isinstance(value, animation.FuncAnimation)]:
        film.save(tmp_path / "film.gif", writer="pillow", dpi=20)
    drawn = tmp_path / "figure.png"
    figure.savefig(drawn)
    pixels = pyplot.imread(drawn)[:, :, :3].reshape(-1, 3)
    assert len({colors.to_hex(colour) for colour in pixels[:: max(1, len(pixels) // 5000)]}) > 2
    assert any(abs(figure.get_figwidth() - width) < 1e-6 for width in WIDTHS)
