"""The commands and their options; what a command does is imported when it runs, so that help comes at once."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from gridslam import __version__
from gridslam.cli.live import live_options, place_options
from gridslam.cli.log_options import log_options

__all__ = ["gridslam"]

_PATH = click.Path(path_type=Path)
_SETTINGS = {"help_option_names": ["-h", "--help"], "max_content_width": 100}
_SEED = click.IntRange(min=0)

_json = click.option("--json", "as_json", is_flag=True, help="Print one JSON object instead of text, and no progress.")


@click.group(context_settings=_SETTINGS, no_args_is_help=False)
@click.version_option(__version__, prog_name="gridslam", message="%(prog)s %(version)s")
def gridslam() -> None:
    """2D lidar SLAM: from a robot's laser scans and odometry to a map and a trajectory.

    Start with `gridslam demo`, which needs no data.
    """


class _MapCommand(click.Command):
    """Lists the parameters in its help; only then they are imported."""

    def format_epilog(self, context: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the parameters that face the user."""
        from gridslam.config import LASERS, PARAMETERS, Configuration
        from gridslam.config.tables import value_of

        defaults = Configuration()
        rows = [
            (name, f"{what} [{str(value_of(defaults, path)).lower()}]") for name, (path, what) in PARAMETERS.items()
        ]
        with formatter.section("Lasers for --laser"):
            formatter.write_dl([(name, laser.says) for name, laser in LASERS.items()])
        with formatter.section("Parameters for --set (m, rad) [default]"):
            formatter.write_dl(rows)
        formatter.write_paragraph()
        formatter.write_text(
            "Every other parameter goes by its dotted name, as run.json and --config have it: "
            "--set tracker.map_scans=30 --set motion.kind=OdometryMotion."
        )


@gridslam.command("map", cls=_MapCommand)
@click.argument("log", type=_PATH)
@click.option("-o", "--out", type=_PATH, required=True, help="Folder for the results; made if need be.")
@click.option("--particles", type=int, help="Number of particles.  [default: the preset's, 30]")
@click.option("--seed", type=_SEED, default=0, show_default=True, help="The same seed gives the same bytes.")
@click.option("--threads", type=click.IntRange(1, 256), default=1, show_default=True, help="Never changes a result.")
@click.option("--preset", default="default", show_default=True, help="default, fast, accurate or gmapping.")
@click.option("--laser", metavar="NAME", help="What the laser is: limits and cells that suit it (see below).")
@click.option("--config", type=_PATH, help="TOML file with parameters, over the preset's.")
@click.option("--set", "assignments", multiple=True, metavar="NAME=VALUE", help="Set one parameter (see below).")
@click.option("--no-loop-closure", is_flag=True, help="The filter alone.")
@click.option(
    "--repair", type=click.Choice(["needed", "all", "none"]), default="needed", show_default=True,
    help="What is taken out of a log first: what would spoil any map, all that gridslam doctor can measure, nothing.",
)  # fmt: skip
@log_options
@live_options
@_json
def map_command(**options: Any) -> None:  # noqa: ANN401
    """Map LOG with grid-based FastSLAM and loop closure.

    LOG is a CARMEN log, a ROS 1 or ROS 2 bag, or a CSV of scans.

    OUT gets map.yaml, map.pgm and map.png, trajectory.tum (a pose for every scan, told from the end), trajectory.csv
    (with covariances), trajectory_online.tum (what was said at the time), graph.g2o (the key scans and what ties them),
    record.npz (the particles at each key scan) and run.json (counts, times, parameters).
    """
    from gridslam.cli.map import map_to_folder

    map_to_folder(**options)


@gridslam.command("doctor")
@click.argument("log", type=_PATH)
@click.option("-o", "--out", type=_PATH, help="Folder for pictures of what was found; made if need be.")
@log_options
@_json
def doctor_command(**options: Any) -> Any:  # noqa: ANN401
    """Tell what is in LOG, and what is wrong with it, in plain words.

    LOG is a CARMEN log, a ROS 1 or ROS 2 bag, or a CSV of scans. Exit status: 3 where something would spoil the map.
    """
    from gridslam.cli.doctor import doctor_log

    return doctor_log(**options)


@gridslam.command("convert")
@click.argument("log", metavar="IN", type=_PATH)
@click.argument("out", type=_PATH)
@click.option("--to", type=click.Choice(["carmen", "csv", "tum", "ros1", "ros2", "mcap"]), help="Format of OUT.")
@log_options
@_json
def convert_command(**options: Any) -> None:  # noqa: ANN401
    """Write the log IN in another format.

    \b
    The name of OUT tells the format, unless --to does:
      .clf, .log, .carmen   CARMEN
      .csv                  a row for each scan (columns: docs/logs.md)
      .tum                  the odometry alone
      .bag                  ROS 1
      .mcap, .db3, a name without suffix (a folder)   ROS 2

    CARMEN and CSV are compressed where .gz or .bz2 follows. What OUT cannot hold is told.
    """
    from gridslam.cli.convert import convert

    convert(**options)


@gridslam.group("dataset")
def dataset_group() -> None:
    """Get public logs to try things on."""


@dataset_group.command("list")
@_json
def dataset_list_command(**options: Any) -> None:  # noqa: ANN401
    """List the logs that there are, with their credit and licence."""
    from gridslam.cli.dataset import list_datasets

    list_datasets(**options)


@dataset_group.command("get")
@click.argument("name")
@click.option("-o", "--out", type=_PATH, default=Path("."), help="Folder for the log; made if need be.  [default: .]")
@click.option("--url", help="Where the files lie, if not at the public place or at GRIDSLAM_DATASETS_URL.")
@_json
def dataset_get_command(**options: Any) -> None:  # noqa: ANN401
    """Get the log NAME, unless it is there already; its SHA-256 is checked."""
    from gridslam.cli.dataset import get_dataset

    get_dataset(**options)


@gridslam.command("demo")
@click.option("-o", "--out", type=_PATH, default=Path("gridslam-demo"), show_default=True, help="Folder of results.")
@click.option("--seed", type=_SEED, default=0, show_default=True, help="Of the simulation and of the filter.")
@live_options
@_json
def demo_command(**options: Any) -> None:  # noqa: ANN401
    """Simulate a robot in a small office, and map it; needs no data.

    OUT gets what `gridslam map` writes, and demo.clf.gz (the log) and truth.tum.
    """
    from gridslam.cli.demo import demo

    demo(**options)


@gridslam.command("view")
@click.argument("out", type=_PATH)
@place_options
def view_command(**options: Any) -> None:  # noqa: ANN401
    """Show OUT, the results of `gridslam map`, in the browser, with a time line."""
    from gridslam.cli.view import view

    view(**options)


_NODE = (
    click.argument("arguments", nargs=-1, type=click.UNPROCESSED),
    click.option("--preset", help="default, fast, accurate or gmapping."),
    click.option("--particles", type=int, help="Number of particles."),
    click.option("--seed", type=_SEED, help="The same seed and scans give the same bytes."),
    click.option("--threads", type=click.IntRange(1, 256), help="Never changes a result."),
    click.option("--config", type=_PATH, help="TOML file with parameters, over the preset's."),
    click.option("--set", "assignments", multiple=True, metavar="NAME=VALUE", help="Set one parameter (see map)."),
    click.option("-o", "--out", type=_PATH, help="Folder that the node saves its results in."),
    click.option("--record", type=_PATH, metavar="FILE", help="Keep the accepted scans, to be mapped again."),
)
_NODE_SETTINGS = {**_SETTINGS, "ignore_unknown_options": True}


def _node_options(command: Callable[..., Any]) -> Callable[..., Any]:
    for option in reversed(_NODE):
        command = option(command)
    return command


@gridslam.command("ros1", context_settings=_NODE_SETTINGS)
@_node_options
def ros1_command(**options: Any) -> None:  # noqa: ANN401
    """Be a node in ROS 1, in the place of slam_gmapping: /scan and /tf in, /map out.

    ARGUMENTS are ROS's own: _name:=value for a parameter, name:=other to remap a topic.
    """
    from gridslam.cli.ros import ros1

    ros1(**options)


@gridslam.command("ros2", context_settings=_NODE_SETTINGS)
@_node_options
@click.option(
    "--transport", type=click.Choice(["auto", "rclpy", "dds"]), default="auto", show_default=True,
    help="rclpy of a sourced ROS 2, or Cyclone DDS, which needs no ROS (extra: ros2).",
)  # fmt: skip
@click.option("--interface", "interfaces", multiple=True, help="Network interface for DDS; may be repeated.")
def ros2_command(**options: Any) -> None:  # noqa: ANN401
    """Be a node in ROS 2: /scan and /tf in, /map out.

    ARGUMENTS are ROS's own, after --ros-args.
    """
    from gridslam.cli.ros import ros2

    ros2(**options)


@gridslam.command("graph")
@click.argument("file", type=_PATH)
@click.option("-o", "--out", type=_PATH, required=True, help="Folder for the results; made if need be.")
@click.option("--robust", is_flag=True, help="Find the loop closures that are false, and leave them out.")
@click.option("--no-guess", is_flag=True, help="Take no notice of the poses in FILE: guess them from the edges.")
@click.option("--skip-unknown", is_flag=True, help="Pass over lines with unknown tags, and count them.")
@click.option("--max-iterations", type=click.IntRange(min=1), default=100, show_default=True, help="From one guess.")
@_json
def graph_command(**options: Any) -> None:  # noqa: ANN401
    """Solve FILE, a pose graph in g2o's form (plain, .gz or .bz2), by GraphSLAM.

    OUT gets graph.g2o (the poses found), graph.png (before and after), graph.json and, with --robust, weights.csv.
    """
    from gridslam.cli.graph import graph_to_folder

    graph_to_folder(**options)


@gridslam.command("evaluate")
@click.argument("trajectory", type=_PATH)
@click.argument("reference", type=_PATH)
@click.option("--distance", "distance_m", type=float, default=1.0, show_default=True, help="Of the RPE's pairs, m.")
@_json
def evaluate_command(**options: Any) -> None:  # noqa: ANN401
    """Compare TRAJECTORY (TUM) with REFERENCE.

    A REFERENCE named *.relations holds true relative poses (Kuemmerle et al. 2009); any other is a trajectory (TUM),
    and the absolute (ATE, aligned) and relative (RPE) errors are told.
    """
    from gridslam.cli.evaluate import evaluate

    evaluate(**options)


@gridslam.command("simulate")
@click.argument("world")
@click.option("-o", "--out", type=_PATH, required=True, help="The log; compressed if named .gz or .bz2.")
@click.option("--seed", type=_SEED, default=0, show_default=True, help="Of the noise, and of a world that is drawn.")
@click.option("--beams", type=click.IntRange(min=2), default=180, show_default=True, help="Beams of a scan.")
@click.option("--fov", "fov_deg", type=float, default=180.0, show_default=True, help="Field of view, degrees.")
@click.option("--range-max", "range_max_m", type=float, default=30.0, show_default=True, help="No return beyond, m.")
@click.option("--rate", "rate_hz", type=float, default=5.0, show_default=True, help="Scans a second.")
@click.option("--people", type=click.IntRange(min=0), default=0, show_default=True, help="People who walk about.")
@click.option("--duration", "duration_s", type=float, help="End the log after so many seconds.")
@_json
def simulate_command(**options: Any) -> None:  # noqa: ANN401
    """Simulate a robot in WORLD and write its log.

    \b
    WORLD is
      always the same: demo, loop, rooms, hall or corridor
      drawn from the seed: random
        made to deceive loop closure: equal_rooms, symmetric, bare_corridors, moved_furniture
        large: campus (2 km), fleet (10 km)

    Beside LOG.clf goes LOG.truth.tum, the true trajectory.
    """
    from gridslam.cli.simulate import simulate_to_log

    simulate_to_log(**options)
