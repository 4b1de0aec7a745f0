"""Draws the graphical models of the pages: ``python docs/figures/draw.py`` writes an SVG for each into this folder.

An arrow leads from what causes to what is caused. A node's fill says what is known of it: given, sought by sampling,
sought in closed form, or integrated out.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path

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
            spans.append(f'<tspan dy="{low}" font-size="{0.72 * size:.3g}">{below}</tspan><tspan dy="-{low}">&#8203;</tspan>')
        elif part:
            spans.append(escape(part))
    style = f"{face};font-style:italic" if italic else face
    return f'<text x="{x:g}" y="{y:g}" font-size="{size:g}" fill="{colour}" text-anchor="{anchor}" style="{style}">{"".join(spans)}</text>'


def circle(node: Node) -> str:
    """A node with its name."""
    fill, outline, _ = KINDS[node.kind]
    dashes = ' stroke-dasharray="5 4"' if node.kind == "out" else ""
    colour = FAINT if node.kind == "out" else INK
    ring = f'<circle cx="{node.x:g}" cy="{node.y:g}" r="{RADIUS:g}" fill="{fill}" stroke="{outline}" stroke-width="1.8"{dashes}/>'
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


TIMES = ("t-2", "t-1", "t")
COLUMNS = (170.0, 320.0, 470.0)
ROW_U, ROW_X, ROW_Z, ROW_M = 90.0, 175.0, 260.0, 350.0


def chain(
    formula: str, note: str, *, past: str, now: str, landmarks: Iterable[tuple[str, float, str, Sequence[int]]],
    controls: bool = True,
) -> Picture:  # fmt: skip
    """A robot's way through time: controls above poses, measurements below, and what these show at the bottom.

    Each of `landmarks` is a name, its place across, its kind, and at which of the three times it is seen.
    """
    up = 0 if controls else ROW_X - ROW_U
    picture = Picture(formula, note, (600, ROW_M + RADIUS + 22 - up))
    for k, (time, x) in enumerate(zip(TIMES, COLUMNS, strict=True)):
        if controls:
            picture.add(f"u_{{{time}}}", x, ROW_U, "given")
            picture.arrows.append((f"u_{{{time}}}", f"x_{{{time}}}"))
        picture.add(f"x_{{{time}}}", x, ROW_X - up, now if k == 2 else past)
        picture.add(f"z_{{{time}}}", x, ROW_Z - up, "given")
        picture.arrows.append((f"x_{{{time}}}", f"z_{{{time}}}"))
        if k and controls:
            picture.arrows.append((f"x_{{{TIMES[k - 1]}}}", f"x_{{{time}}}"))
    for name, x, kind, seen in landmarks:
        picture.add(name, x, ROW_M - up, kind)
        picture.arrows += [(name, f"z_{{{TIMES[k]}}}") for k in seen]
    picture.dots += [(80, ROW_X - up), (80, ROW_Z - up)]
    return picture


def one_map(kind: str) -> list[tuple[str, float, str, Sequence[int]]]:
    """A map that every measurement shows."""
    return [("m", COLUMNS[1], kind, (0, 1, 2))]


def two_landmarks(kind: str) -> list[tuple[str, float, str, Sequence[int]]]:
    """Two landmarks, one of them seen twice."""
    return [("m_1", 245.0, kind, (0, 1)), ("m_2", 435.0, kind, (2,))]


def pose_graph() -> Picture:
    """Poses around a block, joined by increments and one closure."""
    picture = Picture("x_{1:t}  =  argmin  Σ e′ Ω e", "squares are measurements: increments, and a loop closure in blue", (600, 330))  # fmt: skip
    places = [(130, 260), (130, 160), (215, 90), (330, 90), (430, 125), (455, 225), (350, 275), (240, 275)]
    for k, (x, y) in enumerate(places):
        picture.add(f"x_{k}", x, y, "sought" if k else "given")
    picture.factors += [((f"x_{k}", f"x_{k + 1}"), INK) for k in range(len(places) - 1)]
    picture.factors.append((("x_0", "x_7"), "#1e88d2"))
    return picture


def landmark_graph() -> Picture:
    """Poses in a row, and landmarks that several of them see."""
    picture = Picture("x_{1:t}, m  =  argmin  Σ e′ Ω e", "squares are measurements: increments, and sightings in blue", (600, 300))  # fmt: skip
    for k in range(4):
        picture.add(f"x_{k}", 110 + 127 * k, 115, "sought" if k else "given")
    for k, x in enumerate((175, 300, 425), 1):
        picture.add(f"m_{k}", x, 240, "sought")
    picture.factors += [((f"x_{k}", f"x_{k + 1}"), INK) for k in range(3)]
    for pose, landmark in ((0, 1), (1, 1), (1, 2), (2, 2), (2, 3), (3, 3)):
        picture.factors.append(((f"x_{pose}", f"m_{landmark}"), "#1e88d2"))
    return picture


def matching() -> Picture:
    """One step of a scan matcher."""
    picture = Picture("x_t*  =  argmax  p(z_t | x_t, m) p(x_t | u_t, x_{t-1})", "the map is that of the scans before; one pose is sought", (600, 372))  # fmt: skip
    picture.add("u_t", 400, 90, "given")
    picture.add("x_{t-1}", 200, 175, "given")
    picture.add("x_t", 400, 175, "sought")
    picture.add("z_t", 400, 260, "given")
    picture.add("m", 200, 330, "given")
    picture.arrows += [("u_t", "x_t"), ("x_{t-1}", "x_t"), ("x_t", "z_t"), ("m", "z_t")]
    return picture


def closing() -> Picture:
    """A drive that comes back, and the measurement that says so."""
    picture = Picture("p(x_{1:t} | z_{1:t}, u_{1:t}, z_{ij})", "the closure is one more measurement: the new place seen from the old one", (600, 312))  # fmt: skip
    places = {
        "x_1": (120, 95), "x_i": (260, 95), "x_{i+1}": (400, 95),
        "x_{j-1}": (400, 265), "x_j": (260, 265), "x_t": (120, 265),
    }  # fmt: skip
    for name, (x, y) in places.items():
        picture.add(name, x, y, "sought")
    picture.add("z_{ij}", 260, 180, "given")
    picture.dots += [(190, 95), (480, 180), (190, 265)]
    picture.arrows += [("x_i", "x_{i+1}"), ("x_{j-1}", "x_j"), ("x_i", "z_{ij}"), ("x_j", "z_{ij}")]
    return picture


def cells() -> Picture:
    """Mapping with known poses, cell by cell."""
    seen = [("m_1", 170.0, "closed", (0,)), ("m_2", 270.0, "closed", (0, 1)), ("m_3", 370.0, "closed", (1, 2)), ("m_4", 470.0, "closed", (2,))]  # fmt: skip
    return chain(
        "p(m | x_{1:t}, z_{1:t})  ≈  Π_i p(m_i | x_{1:t}, z_{1:t})", "the poses are known; each cell is a binary Bayes filter of its own",
        past="given", now="given", landmarks=seen, controls=False,
    )  # fmt: skip


PICTURES = {
    "online_slam": chain(
        "p(x_t, m | z_{1:t}, u_{1:t})", "earlier poses are integrated out: what they knew stays in the belief",
        past="out", now="sought", landmarks=one_map("sought"),
    ),
    "full_slam": chain(
        "p(x_{1:t}, m | z_{1:t}, u_{1:t})", "every pose is sought, and may still change when a loop closes",
        past="sought", now="sought", landmarks=one_map("sought"),
    ),
    "localization": chain(
        "p(x_t | z_{1:t}, u_{1:t}, m)", "the map is given; earlier poses are integrated out",
        past="out", now="sought", landmarks=one_map("given"),
    ),
    "ekf_localization": chain(
        "p(x_t | z_{1:t}, u_{1:t}, m)", "the landmarks are given; one Gaussian of three numbers is carried on",
        past="out", now="sought", landmarks=two_landmarks("given"),
    ),
    "mapping": cells(),
    "grid_fastslam": chain(
        "p(x_{1:t} | z_{1:t}, u_{1:t}) · p(m | x_{1:t}, z_{1:t})", "a particle is a whole trajectory, and its map follows from it",
        past="sampled", now="sampled", landmarks=one_map("closed"),
    ),
    "ekf_slam": chain(
        "p(x_t, m_{1:n} | z_{1:t}, u_{1:t})", "one Gaussian over all; earlier poses leave correlations behind",
        past="out", now="sought", landmarks=two_landmarks("sought"),
    ),
    "fastslam": chain(
        "p(x_{1:t} | z_{1:t}, u_{1:t}) · Π_j p(m_j | x_{1:t}, z_{1:t})", "given the trajectory nothing joins the landmarks any more",
        past="sampled", now="sampled", landmarks=two_landmarks("closed"),
    ),
    "pose_graph": pose_graph(),
    "landmark_graph": landmark_graph(),
    "scan_matching": matching(),
    "loop_closure": closing(),
}  # fmt: skip

if __name__ == "__main__":
    for name, picture in PICTURES.items():
        Path(__file__).with_name(f"{name}.svg").write_text(picture.svg(), encoding="utf-8")
