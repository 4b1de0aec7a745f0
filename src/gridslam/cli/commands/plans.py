"""gridslam plan, changes, mask and align: options and help."""

from __future__ import annotations

import click

from gridslam.cli.option_types import PATH, Number
from gridslam.cli.options import calls, json_option, out_option


@click.command("plan")
@click.argument("source", type=PATH)
@out_option
@click.option(
    "--scale",
    type=click.IntRange(1, 10_000),
    default=100,
    show_default=True,
    metavar="N",
    help="Scale 1:N of the SVG.",
)
@json_option
@calls("plan:plan_to_folder")
def plan_command() -> None:
    """Make a floor plan of SOURCE: walls, doors, rooms and their measures (extra: map).

    SOURCE is a map's YAML file, or the folder OUT of `gridslam map`. Where there are scans the walls are
    fitted to their end points, and otherwise to the map's cells. Rooms have the names in edits.geojson beside the map.

    Writes to OUT: plan.svg (to scale, its walls along the sheet), plan.geojson and plan.json.
    """


@click.command("changes")
@click.argument("first", type=PATH)
@click.argument("second", type=PATH)
@out_option
@click.option("--same-frame", is_flag=True, help="Both maps have one frame; do not align them by their walls.")
@json_option
@calls("plan:changes_to_folder")
def changes_command() -> None:
    """Show the objects removed from a building and the new ones, by two maps (extra: map).

    FIRST and SECOND are each a map's YAML file, or the folder OUT of `gridslam map`. What either has not
    seen is left open.

    Writes to OUT: changes.png and changes.json (with outlines in the frame of FIRST).
    """


@click.command("mask")
@click.argument("map_path", metavar="MAP", type=PATH)
@click.argument("edits", type=PATH)
@out_option
@json_option
@calls("mask:mask_to_folder")
def mask_command() -> None:
    """Apply EDITS to a map: the edited map, and masks of nav2's keep-out and speed filters.

    MAP is a map's YAML file, or the folder OUT of `gridslam map`. EDITS is a GeoJSON file of layers in metres of the
    map's frame: walls, erased, rooms, keep_out, no_go and speed.

    Writes to OUT: map.yaml and map.pgm (edited), keepout_mask.yaml and speed_mask.yaml with their images,
    and edits.geojson (as they lie on this map).
    """


@click.command("align")
@click.argument("source", metavar="MAP", type=PATH)
@click.argument("plan", type=PATH)
@out_option
@click.option(
    "--unit",
    "unit_m",
    type=Number(1e-6, 1e4),
    metavar="METRES",
    help="Length of a pixel of PLAN, an image.",
)
@json_option
@calls("align:align_to_folder")
def align_command() -> None:
    """Align MAP with an architect's plan or another map.

    MAP is a map's YAML file, or the folder OUT of `gridslam map`; PLAN an image (dark walls) or
    another map. Walls are matched without a first guess; --unit may be off by a few percent.

    Writes to OUT: align.json (with residuals), map.yaml (in the plan's frame, with a rotated origin) and align.png.
    """
