"""The commands and their options; what a command does is imported when it runs, so that help comes at once."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from gridslam import __version__
from gridslam.cli.family_commands import FAMILY_COMMANDS
from gridslam.cli.live import host_options, live_options
from gridslam.cli.log_options import log_options
from gridslam.cli.node_commands import NODE_COMMANDS
from gridslam.cli.options import PATH, SEED, SETTINGS, json_option
from gridslam.cli.rerun import rerun_option

__all__ = ["gridslam"]


@click.group(context_settings=SETTINGS, no_args_is_help=False)
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
@click.argument("log", type=PATH)
@click.option("-o", "--out", type=PATH, required=True, help="Folder for the results; made if need be.")
@click.option("--particles", type=int, help="Number of particles.  [default: the preset's, 30]")
@click.option("--seed", type=SEED, default=0, show_default=True, help="The same seed gives the same bytes.")
@click.option("--threads", type=click.IntRange(1, 256), default=1, show_default=True, help="Never changes a result.")
@click.option("--preset", default="default", show_default=True, help="default, fast, accurate or gmapping.")
@click.option("--laser", metavar="NAME", help="What the laser is: limits and cells that suit it (see below).")
@click.option("--config", type=PATH, help="TOML file with parameters, over the preset's.")
@click.option("--set", "assignments", multiple=True, metavar="NAME=VALUE", help="Set one parameter (see below).")
@click.option("--no-loop-closure", is_flag=True, help="The filter alone.")
@click.option(
    "--repair", type=click.Choice(["needed", "all", "none"]), default="needed", show_default=True,
    help="What is taken out of a log first: what would spoil any map, all that gridslam doctor can measure, nothing.",
)  # fmt: skip
@log_options
@live_options
@rerun_option
@json_option
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
@click.argument("log", type=PATH)
@click.option("-o", "--out", type=PATH, help="Folder for pictures of what was found; made if need be.")
@log_options
@json_option
def doctor_command(**options: Any) -> Any:  # noqa: ANN401
    """Tell what is in LOG, and what is wrong with it, in plain words.

    LOG is a CARMEN log, a ROS 1 or ROS 2 bag, or a CSV of scans. Exit status: 3 where something would spoil the map.
    """
    from gridslam.cli.doctor import doctor_log

    return doctor_log(**options)


@gridslam.command("convert")
@click.argument("log", metavar="IN", type=PATH)
@click.argument("out", type=PATH)
@click.option("--to", type=click.Choice(["carmen", "csv", "tum", "ros1", "ros2", "mcap"]), help="Format of OUT.")
@log_options
@json_option
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
@json_option
def dataset_list_command(**options: Any) -> None:  # noqa: ANN401
    """List the logs that there are, with their credit and licence."""
    from gridslam.cli.dataset import list_datasets

    list_datasets(**options)


@dataset_group.command("get")
@click.argument("name")
@click.option("-o", "--out", type=PATH, default=Path("."), help="Folder for the log; made if need be.  [default: .]")
@click.option("--url", help="Where the files lie, if not at the public place or at GRIDSLAM_DATASETS_URL.")
@json_option
def dataset_get_command(**options: Any) -> None:  # noqa: ANN401
    """Get the log NAME, unless it is there already; its SHA-256 is checked."""
    from gridslam.cli.dataset import get_dataset

    get_dataset(**options)


@gridslam.command("demo")
@click.option("-o", "--out", type=PATH, default=Path("gridslam-demo"), show_default=True, help="Folder of results.")
@click.option("--seed", type=SEED, default=0, show_default=True, help="Of the simulation and of the filter.")
@live_options
@rerun_option
@json_option
def demo_command(**options: Any) -> None:  # noqa: ANN401
    """Simulate a robot in a small office, and map it; needs no data.

    OUT gets what `gridslam map` writes, and demo.clf.gz (the log) and truth.tum.
    """
    from gridslam.cli.demo import demo

    demo(**options)


@gridslam.command("view")
@click.argument("out", type=PATH)
@host_options
def view_command(**options: Any) -> None:  # noqa: ANN401
    """Show the results in OUT in the browser, with a time line."""
    from gridslam.cli.view import view

    view(**options)


for command in (*NODE_COMMANDS, *FAMILY_COMMANDS):
    gridslam.add_command(command)
