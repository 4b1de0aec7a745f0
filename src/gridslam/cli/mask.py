"""gridslam mask."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import numpy as np

from gridslam.cli.output import counted, open_output, print_result, warn
from gridslam.io.edited_maps import apply_edits, check_edits, compute_image_digest
from gridslam.io.edits import Edits, read_edits, write_edits
from gridslam.io.maps import read_map, write_map
from gridslam.plan.masks import Mask, make_keepout_mask, make_speed_mask, write_mask
from gridslam.types import OccupancyGrid

_NAMES = (
    "map.yaml", "map.pgm", "keepout_mask.yaml", "keepout_mask.pgm", "speed_mask.yaml", "speed_mask.pgm",
    "edits.geojson", "mask.json"
)  # fmt: skip


def mask_to_folder(
    map_path: Path,
    edits: Path,
    out: Path,
    as_json: bool,
) -> None:
    """Apply edits to a map, write it and its masks to a folder and print a summary."""
    map_yaml = map_path / "map.yaml" if map_path.is_dir() else map_path
    if out.resolve() == map_yaml.resolve().parent:
        problem = "expected another folder than that of the map, whose files would be replaced"
        raise click.BadParameter(problem, param_hint="'-o'")
    grid = read_map(map_yaml, on_remark=warn)
    read = read_edits(edits)
    check_edits(read, edits, map_yaml, grid, warn)
    name = os.path.relpath(map_yaml.resolve(), out.resolve())
    drawn = replace(read, map_name=name, map_sha256=compute_image_digest(map_yaml))
    edited = apply_edits(grid, drawn)
    masks = _make_masks(grid, drawn)
    with open_output(out, _NAMES) as folder:
        write_map(folder.file("map.yaml"), edited)
        for name, mask in masks.items():
            write_mask(folder.file(f"{name}_mask.yaml"), mask, grid)
        write_edits(folder.file("edits.geojson"), drawn)
        document = _describe(map_yaml, edits, drawn, masks, grid, edited)
        folder.write_json("mask.json", document)
    print_result(document, _summarize(document, out), as_json)


def _make_masks(grid: OccupancyGrid, edits: Edits) -> dict[str, Mask]:
    masks = {}
    if edits.of("keep_out", "no_go"):
        masks["keepout"] = make_keepout_mask(grid, edits)
    if edits.of("speed"):
        masks["speed"] = make_speed_mask(grid, edits)
    return masks


def _describe(
    map_yaml: Path, path: Path, edits: Edits, masks: dict[str, Mask], grid: OccupancyGrid, edited: OccupancyGrid
) -> dict[str, Any]:
    changed = (grid.log_odds > 0) != (edited.log_odds > 0)
    return {
        "schema": "gridslam.mask/1",
        "map": str(map_yaml),
        "edits": str(path),
        "layers": dict(Counter(edit.layer for edit in edits.edits)),
        "changed_cells": int(changed.sum()),
        "masks": {
            name: {
                "type": mask.kind,
                "area_m2": float(np.count_nonzero(mask.values)) * grid.resolution_m**2,
            }
            for name, mask in masks.items()
        },
    }


def _summarize(document: dict[str, Any], out: Path) -> Iterator[str]:
    layers = ", ".join(f"{layer} {count}" for layer, count in document["layers"].items())
    yield f"{counted(sum(document['layers'].values()), 'edit')}: {layers or 'none'}"
    yield f"map, {document['changed_cells']} cells changed: {out / 'map.yaml'}"
    for name, mask in document["masks"].items():
        yield f"{name} mask, {mask['area_m2']:.1f} m\u00b2: {out / f'{name}_mask.yaml'}"
