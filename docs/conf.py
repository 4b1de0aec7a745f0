"""How Sphinx builds these pages: ``sphinx-build -W -n docs OUT``, with the extra ``docs`` installed."""

from __future__ import annotations

import itertools
import re
import sys
from pathlib import Path

from sphinx.application import Sphinx

from gridslam import __version__

sys.path.insert(0, str(Path(__file__).parent))  # mathml

project = "gridslam"
author = "The gridslam developers"
copyright = "the gridslam developers, BSD-3-Clause"
release = version = __version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "mathml"]
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
napoleon_google_docstring = False
napoleon_use_param = napoleon_use_rtype = False  # types are told in words: shape, unit, range
napoleon_use_ivar = True
nitpicky = True
nitpick_ignore_regex = [("py:.*", r"(?!gridslam\.).*")]  # names of ours must lead somewhere; others' need not

LONGEST_SIGNATURE = 260


def _source_first(app: Sphinx, what: str, name: str, thing: object, options: object, lines: list[str]) -> None:
    """Tell the source before the sections; below them napoleon takes it for one more parameter."""
    sections = [k for k, line in enumerate(lines[1:]) if re.fullmatch("-{3,}", line)]
    begin = next((k for k, line in enumerate(lines) if line.startswith("Source: ")), -1)
    if sections and begin > sections[0]:
        source = list(itertools.takewhile(str.strip, lines[begin:]))
        del lines[begin : begin + len(source)]
        lines[sections[0] : sections[0]] = [*source, ""]


def _one_name_a_line(app: Sphinx, what: str, name: str, thing: object, options: object, lines: list[str]) -> None:
    """Tell attributes that numpydoc names together, as in "seed, threads : int", one by one, as Sphinx wants them."""
    separate: list[str] = []
    for k, line in enumerate(lines):
        together = re.fullmatch(r"(\w+(?:, \w+)+) : (.*)", line)
        if together:
            told = list(itertools.takewhile(lambda below: below.startswith(" "), lines[k + 1 :]))
            for one in together[1].split(", ")[:-1]:
                separate += [f"{one} : {together[2]}", *told]
            line = f"{together[1].split(', ')[-1]} : {together[2]}"
        separate.append(line)
    lines[:] = separate


def _short(
    app: Sphinx, what: str, name: str, thing: object, options: object, signature: str | None, returns: str | None
) -> tuple[str | None, str | None]:
    """Leave out signatures that are too long to be read; the docstring tells the parameters."""
    return ("(...)" if signature and len(signature) > LONGEST_SIGNATURE else signature), returns


def setup(app: Sphinx) -> None:
    """Listen to Sphinx."""
    app.connect("autodoc-process-docstring", _source_first, priority=400)
    app.connect("autodoc-process-docstring", _one_name_a_line, priority=400)  # before napoleon
    app.connect("autodoc-process-signature", _short)
