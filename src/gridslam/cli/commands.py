"""Commands and their options; the implementation of a command is imported when it runs, to keep help fast."""

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
    """Command that lists the parameters in its help, and imports them only then."""

    def format_epilog(self, context: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the parameters that face the user."""
        from gridslam.config import LASERS, PARAMETERS, Configuration
        from gridslam.config.tables import value_of

        defaults = Configuration()
        rows = [
            (name, f"{what} [{str(value_of(defaults, path)).lower()}]") for name, (path, what) in PARAMETERS.items()
        ]
        with formatter.section("Lasers for --laser"):
            formatter.write_dl([(name, laser.description) for name, laser in LASERS.items()])
        with formatter.section("Parameters for --set (m, rad) [default]"):
            formatter.write_dl(rows)
        formatter.write_paragraph()
        formatter.write_text(
            "Set any other parameter by its dotted name, as in run.json and --config: "
            "--set tracker.map_scans=30 --set motion.kind=OdometryMotion."
        )


@gridslam.command("map", cls=_MapCommand)
@click.argument("log", type=PATH)
@click.option("-o", "--out", type=PATH, required=True, help="Output folder; created if missing.")
@click.option("--particles", type=int, help="Number of particles.  [default: the preset's, 30]")
@click.option(
    "--seed", type=SEED, default=0, show_default=True, help="Random seed; the same seed gives identical output files."
)
@click.option(
    "--threads", type=click.IntRange(1, 256), default=1, show_default=True,
    help="Number of threads; does not affect the results.",
)  # fmt: skip
@click.option("--preset", default="default", show_default=True, help="Preset: default, fast, accurate or gmapping.")
@click.option("--laser", metavar="NAME", help="Laser model; sets its range limits and map resolution (see below).")
@click.option("--config", type=PATH, help="TOML file with parameters; overrides the preset.")
@click.option("--set", "assignments", multiple=True, metavar="NAME=VALUE", help="Set one parameter (see below).")
@click.option("--no-loop-closure", is_flag=True, help="Disable loop closure.")
@click.option(
    "--repair", type=click.Choice(["needed", "all", "none"]), default="needed", show_default=True,
    help="Faults to correct before mapping; needed: those that make any map unusable, all: all measurable ones.",
)  # fmt: skip
@log_options
@live_options
@rerun_option
@json_option
def map_command(**options: Any) -> None:  # noqa: ANN401
    """Map LOG with grid-based FastSLAM and loop closure.

    LOG is a CARMEN log, a ROS 1 or ROS 2 bag, or a CSV of scans.

    Writes to OUT: map.yaml, map.pgm and map.png, trajectory.tum (full SLAM: a pose for every scan), trajectory.csv
    (with covariances), trajectory_online.tum (the online pose estimates), graph.g2o (key scans and constraints),
    record.npz (the particles at each key scan) and run.json (counts, times, parameters).
    """
    from gridslam.cli.map import map_to_folder

    map_to_folder(**options)


@gridslam.command("doctor")
@click.argument("log", type=PATH)
@click.option("-o", "--out", type=PATH, help="Folder for the report and its figures; created if missing.")
@log_options
@json_option
def doctor_command(**options: Any) -> Any:  # noqa: ANN401
    """Check LOG and report its content and its faults.

    LOG is a CARMEN log, a ROS 1 or ROS 2 bag, or a CSV of scans. Exit status: 3 if a fault makes the map unusable.
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
    The format follows from the suffix of OUT unless --to is given:
      .clf, .log, .carmen   CARMEN
      .csv                  a row for each scan (columns: docs/logs.md)
      .tum                  the odometry alone
      .bag                  ROS 1
      .mcap, .db3, a name without suffix (a folder)   ROS 2

    CARMEN and CSV are compressed if the name ends in .gz or .bz2. Data that the format of OUT cannot represent is
    reported.
    """
    from gridslam.cli.convert import convert

    convert(**options)


@gridslam.group("dataset")
def dataset_group() -> None:
    """Download public logs."""


@dataset_group.command("list")
@json_option
def dataset_list_command(**options: Any) -> None:  # noqa: ANN401
    """List the available logs with their credit and licence."""
    from gridslam.cli.dataset import list_datasets

    list_datasets(**options)


@dataset_group.command("get")
@click.argument("name")
@click.option("-o", "--out", type=PATH, default=Path("."), help="Output folder; created if missing.  [default: .]")
@click.option("--url", help="Base URL of the files.  [default: GRIDSLAM_DATASETS_URL or the public mirror]")
@json_option
def dataset_get_command(**options: Any) -> None:  # noqa: ANN401
    """Download the log NAME if it is missing, and verify its SHA-256."""
    from gridslam.cli.dataset import get_dataset

    get_dataset(**options)


@gridslam.command("demo")
@click.option("-o", "--out", type=PATH, default=Path("gridslam-demo"), show_default=True, help="Output folder.")
@click.option(
    "--seed", type=SEED, default=0, show_default=True, help="Random seed of the simulation and of the filter."
)
@live_options
@rerun_option
@json_option
def demo_command(**options: Any) -> None:  # noqa: ANN401
    """Simulate a robot in a small office, and map it; needs no data.

    Writes to OUT the files of `gridslam map`, demo.clf.gz (the log) and truth.tum (the true trajectory).
    """
    from gridslam.cli.demo import demo

    demo(**options)


@gridslam.command("view")
@click.argument("out", type=PATH)
@host_options
def view_command(**options: Any) -> None:  # noqa: ANN401
    """Replay the results in OUT in the browser."""
    from gridslam.cli.view import view

    view(**options)


for command in (*NODE_COMMANDS, *FAMILY_COMMANDS):
    gridslam.add_command(command)
