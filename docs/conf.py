"""How Sphinx builds these pages: ``sphinx-build -W -n docs OUT``, with the extra ``docs`` installed."""

from __future__ import annotations

import sys
from pathlib import Path

from gridslam import __version__

sys.path.insert(0, str(Path(__file__).parent / "extensions"))

project = "gridslam"
author = "The gridslam developers"
copyright = "the gridslam developers, BSD-3-Clause"
release = version = __version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "numpydoc", "mathml"]
myst_enable_extensions = ["dollarmath", "amsmath", "colon_fence"]
myst_heading_anchors = 3
exclude_patterns = ["_build"]

html_theme = "furo"
html_title = "gridslam"
html_static_path = ["_static"]
html_math_renderer = "mathml"
html_css_files = ["gridslam.css"]
html_copy_source = html_show_sourcelink = False

default_role = "code"
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
autodoc_typehints = "none"
autodoc_typehints_format = "short"
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 100
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False
nitpicky = True
nitpick_ignore_regex = [("py:.*", r"(?!gridslam\.).*")]  # names of ours must lead somewhere; others' need not
