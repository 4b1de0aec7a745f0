"""Nodes, arrows and measurements of a graphical model as SVG."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape

PAPER, INK, FAINT, LINE = "#fbfaf7", "#222936", "#68717e", "#4a5361"
KINDS = {  # fill, outline, and what it says
    "given": ("#d5d9df", INK, "given"),
    "sought": ("#ffdfae", "#b3500a", "sought"),
    "sampled": ("#ffdfae", "#b3500a", "sought, by particles"),
    "closed": ("#c4e8e2", "#00796b", "sought, in closed form"),
    "out": (PAPER, "#8a929d", "integrated out"),
}
RADIUS, FACTOR = 25.0, 6.5
SERIF = "font-family:'STIX Two Text','Times New Roman',Times,serif"
SANS = "font-family:system-ui,'Segoe UI',Helvetica,Arial,sans-serif"


@dataclass(frozen=True)
class Node:
    """A variable: its name as in ``x_{t-1}``, where it is, and its kind."""

    name: str
    x: float
    y: float
    kind: str


@dataclass
class Picture:
    """Nodes and what joins them; `formula` stands above, the key and `note` below."""

    formula: str
    note: str
    size: tuple[float, float]
    nodes: list[Node] = field(default_factory=list)
    arrows: list[tuple[str, str]] = field(default_factory=list)
    factors: list[tuple[tuple[str, ...], str]] = field(default_factory=list)
    dots: list[tuple[float, float]] = field(default_factory=list)

    def add(self, name: str, x: float, y: float, kind: str) -> None:
        """Add a node."""
        self.nodes.append(Node(name, x, y, kind))

    def svg(self) -> str:
        """Give the picture's text."""
        width, height = self.size
        at = {node.name: node for node in self.nodes}
        parts = [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {height + 62:g}" width="{width:g}"'
            f' height="{height + 62:g}" role="img"><title>{escape(plain(self.formula or self.note))}</title>',
            '<defs><marker id="head" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="8" markerHeight="8"'
            f' orient="auto"><path d="M0 1L9.5 5L0 9z" fill="{LINE}"/></marker></defs>',
            f'<rect width="{width:g}" height="{height + 62:g}" rx="8" fill="{PAPER}"/>',
        ]
        if self.formula:
            parts.append(text(width / 2, 34, self.formula, 21, SERIF, INK, italic=True))
        parts += [arrow(at[a], at[b]) for a, b in self.arrows]
        parts += [factor([at[name] for name in names], colour) for names, colour in self.factors]
        parts += [text(x, y + 6, "· · ·", 26, SERIF, FAINT) for x, y in self.dots]
        parts += [circle(node) for node in self.nodes]
        parts += self._key(width, height + 8)
        parts.append(text(width / 2, height + 46, self.note, 15, SANS, FAINT))
        return "\n".join([*parts, "</svg>\n"])

    def _key(self, width: float, y: float) -> list[str]:
        kinds = [kind for kind in KINDS if any(node.kind == kind for node in self.nodes)]
        widths = [30 + 7.4 * len(KINDS[kind][2]) + 22 for kind in kinds]
        x, parts = (width - sum(widths) + 22) / 2, []
        for kind, wide in zip(kinds, widths, strict=True):
            fill, outline, says = KINDS[kind]
            dashes = ' stroke-dasharray="4 3"' if kind == "out" else ""
            parts.append(f'<circle cx="{x + 9:g}" cy="{y:g}" r="8" fill="{fill}" stroke="{outline}"{dashes}/>')
            parts.append(text(x + 24, y + 5, says, 15, SANS, INK, anchor="start"))
            x += wide
        return parts


def plain(formula: str) -> str:
    """Take the marks of subscripts out."""
    return re.sub(r"[_{}]", "", formula)


def text(
    x: float, y: float, words: str, size: float, face: str, colour: str, *, anchor: str = "middle", italic: bool = False
) -> str:
    """Text in which ``_{...}`` and ``_c`` are lowered."""
    spans, low = [], f"{0.28 * size:.3g}"
    for part in re.split(r"(_\{[^}]*\}|_.)", words):
        if part.startswith("_"):
            below = escape(part[1:].strip("{}"))
            spans.append(f'<tspan dy="{low}" font-size="{0.72 * size:.3g}">{below}</tspan>')
            spans.append(f'<tspan dy="-{low}">&#8203;</tspan>')
        elif part:
            spans.append(escape(part))
    style = f"{face};font-style:italic" if italic else face
    place = f'x="{x:g}" y="{y:g}" font-size="{size:g}" fill="{colour}" text-anchor="{anchor}"'
    return f'<text {place} style="{style}">{"".join(spans)}</text>'


def circle(node: Node) -> str:
    """A node with its name."""
    fill, outline, _ = KINDS[node.kind]
    dashes = ' stroke-dasharray="5 4"' if node.kind == "out" else ""
    colour = FAINT if node.kind == "out" else INK
    place = f'cx="{node.x:g}" cy="{node.y:g}" r="{RADIUS:g}"'
    ring = f'<circle {place} fill="{fill}" stroke="{outline}" stroke-width="1.8"{dashes}/>'
    return ring + text(node.x, node.y + 6, node.name, 20, SERIF, colour, italic=True)


def towards(a: Node, b: Node, gap: float) -> tuple[float, float]:
    """The point at the rim of `a`, on the way to `b`."""
    far = math.hypot(b.x - a.x, b.y - a.y)
    share = (RADIUS + gap) / far
    return a.x + share * (b.x - a.x), a.y + share * (b.y - a.y)


def arrow(a: Node, b: Node) -> str:
    """An arrow from rim to rim."""
    (x0, y0), (x1, y1) = towards(a, b, 1), towards(b, a, 3)
    line = f'<line x1="{x0:.1f}" y1="{y0:.1f}" x2="{x1:.1f}" y2="{y1:.1f}"'
    return f'{line} stroke="{LINE}" stroke-width="1.6" marker-end="url(#head)"/>'


def factor(nodes: Sequence[Node], colour: str) -> str:
    """A measurement that joins nodes: a small square between them, or beside a single one."""
    x, y = sum(node.x for node in nodes) / len(nodes), sum(node.y for node in nodes) / len(nodes)
    x -= 52 if len(nodes) == 1 else 0
    lines = "".join(
        f'<line x1="{x:.1f}" y1="{y:.1f}" x2="{node.x:g}" y2="{node.y:g}" stroke="{colour}" stroke-width="1.8"/>'
        for node in nodes
    )
    box = f'x="{x - FACTOR:.1f}" y="{y - FACTOR:.1f}" width="{2 * FACTOR:g}" height="{2 * FACTOR:g}"'
    return f'{lines}<rect {box} fill="{colour}"/>'
