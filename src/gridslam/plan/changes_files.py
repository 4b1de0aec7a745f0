"""Changes between two maps as a picture and as GeoJSON."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw

from gridslam.plan.changes import Changes
from gridslam.types import FloatArray
from gridslam.viz.canvas import FREE, OCCUPIED, UNKNOWN, Colour, fit_page, paint_footer

_ONE_DAY: Colour = (244, 238, 214)
_COLOURS: dict[str, Colour] = {"gone": (214, 40, 40), "new": (0, 130, 90)}
_LONGEST_PX = 4000


def describe_changes(changes: Changes) -> list[dict[str, Any]]:
    """Each change: kind, area and middle."""
    return [
        {"kind": c.kind, "area_m2": round(c.area_m2, 3), "middle_m": np.round(c.outline.mean(axis=0), 3).tolist()}
        for c in changes.changes
    ]


def write_changes_geojson(path: Path, changes: Changes) -> None:
    """Write the outlines as GeoJSON in metres of the first map's frame; layers "gone" and "new"."""
    features = []
    for change in changes.changes:
        ring = np.round(np.concatenate([change.outline, change.outline[:1]]), 3).tolist()
        properties = {"layer": change.kind, "area_m2": round(change.area_m2, 3)}
        geometry = {"type": "Polygon", "coordinates": [ring]}
        features.append({"type": "Feature", "properties": properties, "geometry": geometry})
    document = {"type": "FeatureCollection", "units": "m", "features": features}
    path.write_text(json.dumps(document, allow_nan=False, indent=1) + "\n", encoding="utf-8")


def write_changes_png(path: Path, changes: Changes) -> None:
    """Paint both maps over one another: gone red, new green, cells seen by one alone yellow; keys below."""
    first, second = changes.first, changes.second
    known = [raster.free | raster.occupied for raster in (first, second)]
    pixels = np.full((*first.free.shape, 3), UNKNOWN, np.uint8)
    pixels[known[0] ^ known[1]] = _ONE_DAY
    pixels[known[0] & known[1]] = FREE
    pixels[(first.occupied & ~second.free) | (second.occupied & ~first.free)] = OCCUPIED
    height, width = first.free.shape
    scale = max(1, min(4, _LONGEST_PX // max(height, width)))
    unit = max(1.0, max(width, height) * scale / 1300)
    size, (left, top, _, bottom) = fit_page(width * scale, height * scale, unit, "", ())
    page = Image.new("RGB", size, UNKNOWN)
    cells = Image.fromarray(pixels[::-1]).resize((width * scale, height * scale), Image.Resampling.NEAREST)
    page.paste(cells, (left, top))
    draw = ImageDraw.Draw(page)

    def place(points: FloatArray) -> list[tuple[float, float]]:
        at = (points - first.origin) / first.cell_m * scale
        return [(float(left + x), float(bottom - y)) for x, y in at]

    for change in changes.changes:
        colour = _COLOURS[change.kind]
        for x, y in place(change.cells):
            draw.rectangle((x - scale / 2, y - scale / 2, x + scale / 2, y + scale / 2), fill=colour)
        draw.polygon(place(change.outline), outline=colour, width=2)
    keys = [*_COLOURS.items(), ("seen in one map alone", _ONE_DAY)]
    paint_footer(page, bottom, unit, "", (), keys, px_per_m=scale / first.cell_m)
    page.save(path, compress_level=3)
