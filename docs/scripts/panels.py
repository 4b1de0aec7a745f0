"""What the pictures are made of: panels that show a part of the world, charts, and pages of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from gridslam import OccupancyGrid
from gridslam.types import FloatArray
from gridslam.viz.canvas import (
    FAINT,
    FREE,
    OCCUPIED,
    RULE,
    TIME_ENDS,
    UNKNOWN,
    Colour,
    disc,
    dots,
    font,
    stroke,
    time_colours,
)

IMAGES = Path(__file__).parents[1] / "images"
VIOLET, ORANGE = TIME_ENDS
SIDE, HEAD, GAP = 420, 40, 14
"""Pixels of a panel, of the line above it, and between two."""


class Panel:
    """A part of the world, [x0, y0, x1, y1] in m, drawn with y up; SIDE px wide."""

    def __init__(self, head: str, box: Sequence[float], wide: int = SIDE, tall: int | None = None) -> None:
        self.head, self.box = head, box
        x0, y0, x1, y1 = box
        self.scale = wide / (x1 - x0), (tall or round(wide * (y1 - y0) / (x1 - x0))) / (y1 - y0)
        self.page = Image.new("RGB", (wide, round(self.scale[1] * (y1 - y0))), UNKNOWN)

    def pixels(self, points: FloatArray) -> FloatArray:
        """Page coordinates (N, 2) of points (N, 2)."""
        return np.stack([(points[:, 0] - self.box[0]) * self.scale[0], (self.box[3] - points[:, 1]) * self.scale[1]], 1)

    def cells(self, shades: NDArray[np.uint8], origin: tuple[float, float], cell: float) -> None:
        """Paint cells [row = y, column = x] of RGB."""
        height, width = shades.shape[:2]
        size = max(1, round(width * cell * self.scale[0])), max(1, round(height * cell * self.scale[1]))
        kept = Image.Resampling.BOX if size[0] < width else Image.Resampling.NEAREST
        corner = self.pixels(np.array([[origin[0], origin[1] + height * cell]]))[0].round().astype(int).tolist()
        self.page.paste(Image.fromarray(shades[::-1]).resize(size, kept), tuple(corner))

    def grid(self, grid: OccupancyGrid) -> None:
        """Paint a map: unknown, free, occupied."""
        share = np.where(grid.known, np.clip(grid.probability, 0, 1), 0.5)[..., None]
        shades = (1 - share) * np.array(FREE) + share * np.array(OCCUPIED)
        self.cells(np.where(grid.known[..., None], shades, UNKNOWN).astype(np.uint8), grid.origin, grid.resolution_m)

    def line(self, points: FloatArray, colour: Colour, width: float = 2.0) -> None:
        """Draw a path (N, 2)."""
        at = self.pixels(points)
        stroke(self.page, np.concatenate([at[:-1], at[1:]], axis=1), colour, width)

    def timed(self, points: FloatArray, width: float = 2.0) -> None:
        """Draw a path (N, 2) in the colours of time."""
        at = self.pixels(points)
        colours = time_colours(np.linspace(0, 1, len(at) - 1))
        stroke(self.page, np.concatenate([at[:-1], at[1:]], axis=1), colours, width)

    def dots(self, points: FloatArray, colours: list[Colour] | Colour, width: float = 4.0) -> None:
        """Draw points (N, 2)."""
        dots(self.page, self.pixels(points), colours, width)

    def ring(self, mean: FloatArray, covariance: FloatArray, colour: Colour, sigmas: float = 2.0) -> None:
        """Draw an ellipse about (2,) of a covariance (2, 2)."""
        angles = np.linspace(0, math.tau, 60)
        values, vectors = np.linalg.eigh(covariance)
        arms = vectors * np.sqrt(np.maximum(values, 0))
        self.line(mean + sigmas * np.stack([np.cos(angles), np.sin(angles)], 1) @ arms.T, colour)

    def robot(self, pose: FloatArray, colour: Colour = ORANGE, length: float = 0.6, radius_px: int = 6) -> None:
        """Mark a pose (3,) by a disc and its heading."""
        tip = pose[:2] + length * np.array([math.cos(pose[2]), math.sin(pose[2])])
        self.line(np.stack([pose[:2], tip]), colour, 3.0)
        disc(self.page, self.pixels(pose[None, :2]), radius_px, FREE, colour)


class Chart(Panel):
    """Values over an axis: a panel of the box's shape with round values written at its rim."""

    def __init__(self, head: str, box: Sequence[float], wide: int = SIDE, tall: int = SIDE) -> None:
        super().__init__(head, box, wide, tall)
        self.page.paste(FREE, (0, 0, *self.page.size))

    def values(self, xs: Sequence[float], ys: Sequence[float], x_name: str = "", y_name: str = "") -> None:
        """Rule the chart at values of both axes, and name these."""
        draw, small = ImageDraw.Draw(self.page), font(15, 1.0)
        x0, y0, x1, y1 = self.box
        for x in xs:
            self.line(np.array([[x, y0], [x, y1]]), RULE, 1.0)
            draw.text(
                (self.pixels(np.array([[x, y0]]))[0, 0] + 4, self.page.height - 6),
                f"{x:g}",
                fill=FAINT,
                font=small,
                anchor="ls",
            )
        for y in ys:
            self.line(np.array([[x0, y], [x1, y]]), RULE, 1.0)
            draw.text((6, self.pixels(np.array([[x0, y]]))[0, 1] - 4), f"{y:g}", fill=FAINT, font=small, anchor="ls")
        draw.text((self.page.width - 8, self.page.height - 26), x_name, fill=FAINT, font=small, anchor="rs")
        draw.text((8, 18), y_name, fill=FAINT, font=small, anchor="ls")

    def curve(self, x: FloatArray, y: FloatArray, colour: Colour, width: float = 2.0) -> None:
        """Draw y over x."""
        self.line(np.stack([x, y], 1), colour, width)


def row_of(panels: Sequence[Panel]) -> Panel:
    """Several panels with their heads as a single one."""
    wide, tall = sum(panel.page.width + GAP for panel in panels) - GAP, max(panel.page.height for panel in panels)
    row = Panel("", [0, 0, 1, 1], wide, tall + HEAD)
    draw, x = ImageDraw.Draw(row.page), 0
    for panel in panels:
        draw.text((x, 27), panel.head, fill=OCCUPIED, font=font(19, 1.0), anchor="ls")
        row.page.paste(panel.page, (x, HEAD))
        x += panel.page.width + GAP
    return row


def save(name: str, panels: Sequence[Panel], columns: int, key: Sequence[tuple[str, Colour]] = ()) -> None:
    """Lay panels side by side, their heads above and a key below, and write a small PNG."""
    rows = [panels[k : k + columns] for k in range(0, len(panels), columns)]
    width = max(sum(panel.page.width + GAP for panel in row) + GAP for row in rows)
    heads = [HEAD if any(panel.head for panel in row) else 0 for row in rows]
    height = sum(max(panel.page.height for panel in row) + GAP for row in rows) + sum(heads) + (34 if key else 0)
    page = Image.new("RGB", (width, height), UNKNOWN)
    draw, y = ImageDraw.Draw(page), 0
    for row, head in zip(rows, heads, strict=True):
        x = GAP
        for panel in row:
            draw.text((x, y + 27), panel.head, fill=OCCUPIED, font=font(19, 1.0), anchor="ls")
            page.paste(panel.page, (x, y + head))
            x += panel.page.width + GAP
        y += max(panel.page.height for panel in row) + head + GAP
    x = GAP
    for says, colour in key:
        draw.rectangle((x, y + 6, x + 26, y + 14), fill=colour)
        draw.text((x + 36, y + 16), says, fill=FAINT, font=font(17, 1.0), anchor="ls")
        x += 36 + round(font(17, 1.0).getlength(says)) + 36
    keep(name, page)


def keep(name: str, picture: Image.Image, width: int | None = None) -> None:
    """Write a picture of the pages, in 128 colours that cover those of thin lines, too."""
    if width is not None:
        picture = picture.resize((width, round(width * picture.height / picture.width)), Image.Resampling.LANCZOS)
    few = picture.convert("RGB").quantize(128, Image.Quantize.MAXCOVERAGE, kmeans=3, dither=Image.Dither.NONE)
    few.save(IMAGES / f"{name}.png", optimize=True)
    print(f"{name}.png: {(IMAGES / f'{name}.png').stat().st_size // 1000} kB")
