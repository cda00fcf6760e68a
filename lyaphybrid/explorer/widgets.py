"""The explorer as widgets of a notebook; what it computes is in `views.py`."""

import io
import math
from typing import TYPE_CHECKING, Any

from .._text import as_html
from .figures import figure_of
from .knobs import Knob

if TYPE_CHECKING:
    from .exploring import Explorer

__all__ = ["panel_of"]

SLIDER_STEPS = 200  # of a slider
WIDGETS_NEEDED = "The sliders of lh.explore need ipywidgets: pip install 'lyaphybrid[notebooks]'."


def panel_of(explorer: "Explorer") -> Any:
    """The widget: sliders at the left, the figure and the exponents at the right.

    Raises:
        ImportError: without ipywidgets (extra "notebooks").
    """
    try:
        import ipywidgets
    except ImportError as error:
        raise ImportError(WIDGETS_NEEDED) from error
    return _Panel(explorer, ipywidgets).whole


class _Panel:
    """The widgets of one explorer, and what they do."""

    def __init__(self, explorer: "Explorer", widgets: Any):
        self.explorer = explorer
        self.sliders = {knob.name: _slider(knob, widgets) for knob in explorer.knobs}
        self.picture = widgets.Image(format="png", layout={"max_width": "100%"})
        self.words = widgets.HTML()
        self.back = widgets.Button(description="back to the start", tooltip="All sliders to their first values")
        self.kind = widgets.ToggleButtons(options=["phase plane", "in time"], style={"button_width": "auto"})
        self.moving = False
        for slider in self.sliders.values():
            slider.observe(self.moved, "value")
        self.back.on_click(self.reset)
        self.kind.observe(lambda change: self.draw(), "value")
        left = widgets.VBox(list(self.sliders.values()), layout={"max_height": "420px", "overflow": "hidden auto"})
        left = widgets.VBox([left, self.back], layout={"min_width": "330px"})
        right = widgets.VBox([self.kind, self.picture, self.words], layout={"flex": "1 1 auto", "min_width": "0"})
        self.whole = widgets.HBox([left, right])
        self.draw()

    def moved(self, change: Any) -> None:
        """Compute again after a slider was moved; once, where `reset` moves all of them."""
        if self.moving:
            return
        self.explorer.move({name: slider.value for name, slider in self.sliders.items()})
        self.draw()

    def reset(self, button: Any) -> None:
        """All sliders back."""
        self.moving = True
        try:
            for knob in self.explorer.knobs:
                self.sliders[knob.name].value = knob.value
        finally:
            self.moving = False
        self.explorer.reset()
        self.draw()

    def draw(self) -> None:
        """Show what the explorer sees."""
        view = self.explorer.view
        picture = io.BytesIO()
        figure_of(view, self.kind.value == "phase plane", self.explorer.components).savefig(picture, dpi=100)
        self.picture.value = picture.getvalue()
        self.words.value = as_html(view.table())


def _slider(knob: Knob, widgets: Any) -> Any:
    look = {
        "description": knob.label,
        "readout_format": ".4g",
        "continuous_update": False,
        "style": {"description_width": "110px"},
        "layout": {"width": "320px"},
    }
    if knob.logarithmic:
        low, high = math.log10(knob.low), math.log10(knob.high)
        step = (high - low) / SLIDER_STEPS
        return widgets.FloatLogSlider(value=knob.value, base=10.0, min=low, max=high, step=step, **look)
    return widgets.FloatSlider(
        value=knob.value, min=knob.low, max=knob.high, step=(knob.high - knob.low) / SLIDER_STEPS, **look
    )
