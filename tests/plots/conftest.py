"""Every figure that a test of plots makes is drawn once."""

import pytest
from matplotlib import pyplot


@pytest.fixture(autouse=True)
def _figures_drawn():
    yield
    for number in pyplot.get_fignums():
        pyplot.figure(number).canvas.draw()  # a warning here (a missing glyph, a failed layout) is an error
