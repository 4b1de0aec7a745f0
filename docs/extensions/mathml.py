"""Formulas as MathML, which browsers show by themselves: the pages need no script and no internet."""

from __future__ import annotations

import html
import re
from xml.etree import ElementTree

from docutils import nodes
from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.util.typing import ExtensionMetadata
from sphinx.writers.html5 import HTML5Translator

_LOGGER = logging.getLogger(__name__)
_MATHML = "http://www.w3.org/1998/Math/MathML"
_ACCENTS = set("ˆˉ˜˙¨→")
_OF_HTML = re.compile(r"&(?!(?:lt|gt|amp|quot|apos);)\w+;")
"""Entities that docutils writes, and XML does not know."""

ElementTree.register_namespace("", _MATHML)


def _as_tex_sets_it(text: str) -> str:
    """Put subscripts of accented letters beside them, as of \\hat{z}_t, which docutils has below; 1:t without gaps."""
    tree = ElementTree.fromstring(_OF_HTML.sub(lambda entity: html.unescape(entity[0]), text))
    for element in tree.iter(f"{{{_MATHML}}}munderover"):
        base, below, above = element
        if above.text in _ACCENTS:
            accented = ElementTree.Element(f"{{{_MATHML}}}mover", accent="true")
            accented.extend([base, above])
            element.tag, element[:] = f"{{{_MATHML}}}msub", [accented, below]
    for name in ("msub", "msup", "msubsup"):
        for element in tree.iter(f"{{{_MATHML}}}{name}"):
            for script in element[1:]:
                for sign in script.iter(f"{{{_MATHML}}}mo"):
                    sign.set("lspace", "0")
                    sign.set("rspace", "0")
    return ElementTree.tostring(tree, encoding="unicode")


def _converted(node: nodes.math | nodes.math_block, as_block: bool) -> str:
    try:
        return _as_tex_sets_it(tex2mathml(node.astext(), as_block=as_block))
    except MathError as error:
        _LOGGER.warning("%s in the formula %s", error, node.astext(), location=node)
        return ""


def _visit_math(translator: HTML5Translator, node: nodes.math) -> None:
    translator.body.append(_converted(node, as_block=False))
    raise nodes.SkipNode


def _visit_math_block(translator: HTML5Translator, node: nodes.math_block) -> None:
    translator.body.append(f'<div class="math">{_converted(node, as_block=True)}</div>\n')
    raise nodes.SkipNode


def setup(app: Sphinx) -> ExtensionMetadata:
    """Offer this as a way to render formulas."""
    app.add_html_math_renderer("mathml", (_visit_math, None), (_visit_math_block, None))
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
