"""A sheet of paper with a plan to scale, in mm, written as SVG or PNG."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import final
from xml.sax.saxutils import escape

import numpy as np
from PIL import Image, ImageDraw

from gridslam.types import FloatArray
from gridslam.viz.canvas import Colour, font

_DASH_MM = (1.2, 0.8)
_PNG_PX_PER_MM = 8.0
_MOST_PNG_PX = 6000


@final
@dataclass(frozen=True, slots=True, eq=False)
class Mark:
    """A polygon, a line or a text on a sheet.

    Attributes
    ----------
    layer : str
    points : (K, 2) float64, mm
        From the lower left corner of the sheet; of a text its middle.
    fill, stroke : Colour or None
        Of the inside, of a polygon alone; and of the line.
    width_mm : float
        Of the line; of a text its size.
    dashed, closed : bool
    text : str
    upright : bool
        Whether a text is turned by 90 degrees, anticlockwise.
    """

    layer: str
    points: FloatArray
    fill: Colour | None = None
    stroke: Colour | None = None
    width_mm: float = 0.25
    dashed: bool = False
    closed: bool = False
    text: str = ""
    upright: bool = False


@final
@dataclass(slots=True, eq=False)
class Sheet:
    """Shapes to be drawn, in their order.

    Attributes
    ----------
    size_mm : (float, float)
        Width and height.
    title : str
    marks : list of Mark
    """

    size_mm: tuple[float, float]
    title: str
    marks: list[Mark] = field(default_factory=list)

    def layers(self) -> Iterator[tuple[str, list[Mark]]]:
        """Runs of marks of one layer, in their order."""
        run: list[Mark] = []
        for mark in self.marks:
            if run and run[-1].layer != mark.layer:
                yield run[-1].layer, run
                run = []
            run.append(mark)
        if run:
            yield run[-1].layer, run


def write_svg(path: Path, sheet: Sheet) -> None:
    """Write a sheet as SVG: one unit is 1 mm, each layer a group of its name."""
    width, height = sheet.size_mm
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.2f}mm" height="{height:.2f}mm" '
        f'viewBox="0 0 {width:.2f} {height:.2f}">',
        f"<title>{escape(sheet.title)}</title>",
        f'<rect width="{width:.2f}" height="{height:.2f}" fill="#ffffff"/>',
    ]
    for layer, marks in sheet.layers():
        lines.append(f'<g class="{escape(layer)}">')
        lines += [_to_svg(mark, height) for mark in marks]
        lines.append("</g>")
    path.write_text("\n".join([*lines, "</svg>", ""]), encoding="utf-8")


def _to_svg(mark: Mark, height: float) -> str:
    points = np.column_stack([mark.points[:, 0], height - mark.points[:, 1]])
    if mark.text:
        x, y = points[0]
        turn = f' transform="rotate(-90 {x:.2f} {y:.2f})"' if mark.upright else ""
        return (
            f'<text x="{x:.2f}" y="{y:.2f}" font-family="Helvetica, Arial, sans-serif" font-size="{mark.width_mm:.2f}" '
            f'text-anchor="middle" dominant-baseline="central" fill="{_hex(mark.fill)}"{turn}>'
            f"{escape(mark.text)}</text>"
        )
    dash = f' stroke-dasharray="{_DASH_MM[0]} {_DASH_MM[1]}"' if mark.dashed else ""
    line = f' stroke="{_hex(mark.stroke)}" stroke-width="{mark.width_mm:.2f}"{dash}' if mark.stroke else ""
    corners = " ".join(f"{x:.2f},{y:.2f}" for x, y in points.tolist())
    return f'<{"polygon" if mark.closed else "polyline"} points="{corners}" fill="{_hex(mark.fill)}"{line}/>'


def _hex(colour: Colour | None) -> str:
    return "none" if colour is None else "#{:02x}{:02x}{:02x}".format(*colour)


def write_png(path: Path, sheet: Sheet) -> None:
    """Write a sheet as PNG, 8 pixels a mm, or as many as its longer side needs to have 6000."""
    scale = min(_PNG_PX_PER_MM, _MOST_PNG_PX / max(sheet.size_mm))
    width, height = (max(1, round(side * scale)) for side in sheet.size_mm)
    page = Image.new("RGB", (width, height), "white")
    draw = ImageDraw.Draw(page)
    for mark in sheet.marks:
        places = np.column_stack([mark.points[:, 0] * scale, height - mark.points[:, 1] * scale])
        points = [tuple(place) for place in places.tolist()]
        line = max(1, round(mark.width_mm * scale))
        if mark.text:
            _paint_text(page, draw, mark, points[0], scale)
        elif mark.closed and mark.fill is not None:
            draw.polygon(points, fill=mark.fill, outline=mark.stroke, width=line)
        elif mark.stroke is not None:
            draw.line([*points, points[0]] if mark.closed else points, fill=mark.stroke, width=line, joint="curve")
    page.save(path, compress_level=3)


def _paint_text(page: Image.Image, draw: ImageDraw.ImageDraw, mark: Mark, place: Sequence[float], scale: float) -> None:
    letters = font(mark.width_mm, scale)
    text = mark.text.replace("\u00b2", "2")  # which Pillow's typeface lacks
    if not mark.upright:
        draw.text((place[0], place[1]), text, fill=mark.fill, font=letters, anchor="mm")
        return
    left, top, right, bottom = draw.textbbox((0, 0), text, font=letters)
    patch = Image.new("L", (int(right - left) + 2, int(bottom - top) + 2))
    ImageDraw.Draw(patch).text((1 - left, 1 - top), text, fill=255, font=letters)
    turned = patch.rotate(90, expand=True)
    page.paste(mark.fill or (0, 0, 0), (int(place[0] - turned.width / 2), int(place[1] - turned.height / 2)), turned)
