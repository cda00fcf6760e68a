"""How Sphinx makes pages of what `building/assembling.py` put together."""

from pathlib import Path

import lyaphybrid
from docs.building import docstrings, films, flowcharts

DOCS = Path(__file__).parent

project = "lyaphybrid"
author = "The lyaphybrid developers"
project_copyright = author
version = release = lyaphybrid.__version__

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.mathjax",
    "sphinx.ext.napoleon",
    "sphinx_design",
    "sphinx_gallery.gen_gallery",
    "myst_nb",
]
exclude_patterns = ["gallery/*.py", "gallery/*.ipynb", "gallery/*.py.md5"]

# Formulas: MathJax lies in _static, pages need no network.
mathjax_path = "mathjax/tex-svg.js"
myst_enable_extensions = ["amsmath", "attrs_inline", "colon_fence", "deflist", "dollarmath"]
myst_dmath_double_inline = True
myst_heading_anchors = 3

# Notebooks: as they are committed; `tests/run_notebooks.py` runs them.
nb_execution_mode = "off"
nb_merge_streams = True

# Reference: docstrings are of Google's style.
autosummary_generate = True
templates_path = [str(DOCS / "_templates")]
autodoc_default_options = {"members": True, "inherited-members": False}
autodoc_typehints = "none"
autodoc_member_order = "bysource"
autodoc_inherit_docstrings = False
napoleon_numpy_docstring = False
napoleon_custom_sections = [("Attributes", "params_style")]
napoleon_use_rtype = False
add_module_names = False
python_use_unqualified_type_names = True

sphinx_gallery_conf = {
    "examples_dirs": [str(DOCS / "gallery")],
    "gallery_dirs": ["gallery"],
    "filename_pattern": "/plot_",
    "download_all_examples": False,
    "show_memory": False,
    "show_signature": False,
    "min_reported_time": 1e9,  # times are of this machine
    "write_computation_times": False,
    "within_subsection_order": "FileNameSortKey",
    "thumbnail_size": (480, 360),
    "image_srcset": ["2x"],
    "matplotlib_animations": (True, "jshtml"),
}

html_theme = "pydata_sphinx_theme"
html_title = "lyaphybrid"
html_static_path = [str(DOCS / "_static")]
html_css_files = ["site.css"]
html_show_sourcelink = False
html_copy_source = False
html_sidebars = {"index": [], "help/changelog": []}
html_theme_options = {
    "logo": {"text": "lyaphybrid"},
    "navbar_align": "left",
    "header_links_before_dropdown": 5,
    "navigation_with_keys": False,
    "show_prev_next": True,
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": ["copyright"],
    "footer_end": [],
    "pygments_light_style": "a11y-high-contrast-light",
    "pygments_dark_style": "a11y-high-contrast-dark",
}


def setup(app) -> None:
    """Flowcharts; docstrings made plain, before napoleon reads their sections; short signatures."""
    app.add_directive("flowchart", flowcharts.Flowchart)
    app.connect("autodoc-process-docstring", docstrings.process, priority=400)
    app.connect("html-page-context", films.own_icons)
    app.connect("autodoc-process-signature", docstrings.signature)
