"""gridslam plan, changes, mask and align: options and help."""

from __future__ import annotations

from typing import Any

import click

from gridslam.cli.option_types import PATH, Number
from gridslam.cli.options import json_option, out_option

_floor_option = click.option(
    "--floor", metavar="NAME", help="Of a session: the map that is taken.  [default: the newest drive's]"
)


@click.command("plan")
@click.argument("source", type=PATH)
@_floor_option
@out_option
@click.option(
    "--scale",
    type=click.IntRange(1, 10_000),
    default=100,
    show_default=True,
    metavar="N",
    help="Scale 1:N of the SVG.",
)
@click.option("--straighten", is_flag=True, help="Turn the plan so that most walls run along its axes.")
@json_option
def plan_command(**options: Any) -> None:  # noqa: ANN401
    """Make a floor plan of SOURCE: walls, doors, rooms and their measures (extra: map).

    SOURCE is a map's YAML file, its edits (see `gridslam mask`), the folder OUT of `gridslam map`, or a session. Where
    there are scans the walls are fitted to their end points, and otherwise to the map's cells.

    Writes to OUT: plan.svg (to scale), plan.png, plan.dxf (CAD), plan.geojson and plan.json.
    """
    from gridslam.cli.plan import plan_to_folder

    plan_to_folder(**options)


@click.command("changes")
@click.argument("first", type=PATH)
@click.argument("second", type=PATH)
@_floor_option
@out_option
@click.option("--same-frame", is_flag=True, help="Both maps have one frame; do not align them by their walls.")
@json_option
def changes_command(**options: Any) -> None:  # noqa: ANN401
    """Show the objects removed from a building and the new ones, by two maps.

    FIRST and SECOND are each a map's YAML file, the folder OUT of `gridslam map`, or a session. What either has not
    seen is left open.

    Writes to OUT: changes.png, changes.geojson (in the frame of FIRST) and changes.json.
    """
    from gridslam.cli.plan import changes_to_folder

    changes_to_folder(**options)


@click.command("mask")
@click.argument("map_path", metavar="MAP", type=PATH)
@click.argument("edits", type=PATH)
@out_option
@click.option(
    "--mode",
    type=click.Choice(["scale", "raw"]),
    default="scale",
    show_default=True,
    help="How pixels encode values: scale, white is 0 and black 100; raw, a pixel is its value.",
)
@click.option(
    "--off-lane",
    "off_lane_percent",
    type=click.IntRange(0, 99),
    default=50,
    show_default=True,
    metavar="PERCENT",
    help="Cost beside preferred lanes, in percent of a lethal one.",
)
@json_option
def mask_command(**options: Any) -> None:  # noqa: ANN401
    """Apply EDITS to a map: the edited map, and masks of nav2's keep-out and speed filters.

    MAP is a map's YAML file, or the folder OUT of `gridslam map`. EDITS is a GeoJSON file of layers in metres of the
    map's frame: walls, erased, rooms, keep_out, no_go, speed and lanes, as `gridslam view OUT --edit` writes it.

    Writes to OUT: map.yaml and map.pgm (edited), keepout_mask.yaml and speed_mask.yaml with their images,
    nav2_filters.yaml (parameters to paste) and edits.geojson (as they lie on this map).
    """
    from gridslam.cli.mask import mask_to_folder

    mask_to_folder(**options)


def _read_pairs(ctx: click.Context, param: click.Parameter, texts: tuple[str, ...]) -> Any:  # noqa: ANN401
    """Read pairs X,Y=U,V (P, 4): none, or two to six at distinct places."""
    import numpy as np

    try:
        numbers = [[float(n) for n in text.replace("=", ",", 1).split(",")] for text in texts]
        pairs = np.array(numbers).reshape(len(texts), 4)
    except ValueError:
        raise click.BadParameter(f"expected X,Y=U,V, got {' '.join(texts)[:100]!r}", ctx, param) from None
    if not (np.isfinite(pairs).all() and len(pairs) in (0, 2, 3, 4, 5, 6)):
        raise click.BadParameter(f"expected two to six pairs of finite numbers, got {len(pairs)}", ctx, param)
    for side in (pairs[:, :2], pairs[:, 2:]):
        if len(pairs) and np.ptp(side, axis=0).max() == 0:
            raise click.BadParameter("expected places that are apart, got one place", ctx, param)
    return pairs


@click.command("align")
@click.argument("source", metavar="MAP", type=PATH)
@click.argument("plan", type=PATH)
@_floor_option
@out_option
@click.option(
    "--pair",
    "pairs",
    multiple=True,
    callback=_read_pairs,
    metavar="X,Y=U,V",
    help="A place of the map, m, and the same in PLAN; two to six times.",
)
@click.option("--unit", "unit_m", type=Number(1e-6, 1e4), metavar="METRES", help="Length of PLAN's pixel or unit.")
@click.option("--by-pairs", is_flag=True, help="Align by pairs alone; do not match walls.")
@json_option
def align_command(pairs: Any, by_pairs: bool, **options: Any) -> None:  # noqa: ANN401
    """Align MAP with an architect's plan or another map.

    MAP is a map's YAML file, the folder OUT of `gridslam map`, or a session; PLAN an image (dark walls), a DXF,
    or another map. Places in images are counted from the left and the top. Walls are matched, from the place of
    the pairs or without a first guess.

    Writes to OUT: align.json (with residuals), map.yaml (in the plan's frame, with a rotated origin) and align.png.
    """
    from gridslam.cli.align import align_to_folder

    if by_pairs and not len(pairs):
        raise click.UsageError("expected two to six --pair with --by-pairs")
    align_to_folder(pairs=pairs, by_pairs=by_pairs, **options)
