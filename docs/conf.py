"""Settings of the documentation; build it with ``sphinx-build -W --keep-going -b html docs docs/_build``."""

import sys
from pathlib import Path

import contactimg

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "_ext"))

project = "contactimg"
author = "The contactimg developers"
copyright = author  # noqa: A001  Sphinx reads this name
version = release = contactimg.__version__

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "numpydoc",
    "myst_parser",
    "sphinx_design",
    "reference_pages",
    "architecture_rooms",
    "notebook_gallery",
    "mathml_formulas",
]
exclude_patterns = ["_build", "reference/generated/*.md"]
templates_path = ["_templates"]
default_role = "py:obj"
smartquotes = False  # options begin with two hyphens

autodoc_typehints = "none"  # the docstrings give type, shape and unit
autosummary_generate = True
numpydoc_show_class_members = False
myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3

html_math_renderer = "mathml"
html_theme = "pydata_sphinx_theme"
html_title = "contactimg"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_sourcelink = False
html_theme_options = {
    "navbar_end": ["theme-switcher"],
    "footer_start": ["copyright"],
    "footer_end": [],
    "show_prev_next": True,
    "show_toc_level": 2,
}
html_sidebars = {"index": []}
