"""gridslam map, demo, session and merge: options and help."""

from __future__ import annotations

from pathlib import Path

import click

from gridslam.cli.option_types import OUT, OUTPUT_FILE, OUTPUT_FOLDER, PATH, SEED
from gridslam.cli.options import (
    calls,
    history_option,
    json_option,
    live_options,
    map_options,
    out_option,
    session_options,
    threads_option,
)


class _MapCommand(click.Command):
    """Command that lists the parameters in its help, and imports them only then."""

    def format_epilog(self, context: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the parameters that face the user."""
        from gridslam.config import LASERS, PARAMETERS, Configuration
        from gridslam.config.tables import value_of

        defaults = Configuration()
        rows = [
            (name, f"{known.description} [{str(value_of(defaults, known.path)).lower()}]")
            for name, known in PARAMETERS.items()
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


@click.command("map", cls=_MapCommand)
@click.argument("log", type=PATH)
@out_option
@map_options
@session_options
@live_options
@history_option
@json_option
@calls("map:map_to_folder")
def map_command() -> None:
    """Map LOG with grid-based FastSLAM and loop closure.

    LOG is a CARMEN log, a ROS 1 or ROS 2 bag, or a CSV of scans.

    Writes to OUT: map.yaml, map.pgm and map.png, trajectory.tum (full SLAM: a pose for every scan), trajectory.csv
    (with covariances), trajectory_online.tum (the online pose estimates), graph.g2o (key scans and constraints),
    history.npz (the past of the run) and run.json (counts, times, parameters).

    With --save and --continue a map grows over several logs, days and robots: where the robot was not moved in between
    the filter continues as if there had been one log; otherwise the robot is relocalized in the map first. Then
    trajectory_NAME.tum is the trajectory of each drive, and map_2.yaml, ... are pieces in which it was not found.
    """


@click.command("demo")
@click.option(
    "-o", "--out", type=OUTPUT_FOLDER, default=Path("gridslam-demo"), show_default=True, help="Output folder."
)
@click.option(
    "--seed", type=SEED, default=0, show_default=True, help="Random seed of the simulation and of the filter."
)
@live_options
@history_option
@json_option
@calls("simulate:demo")
def demo_command() -> None:
    """Simulate a robot in a small office, and map it; needs no data.

    Writes to OUT the files of `gridslam map`, demo.clf.gz (the log) and truth.tum (the true trajectory).
    """


@click.command("session")
@click.argument("file", type=PATH)
@click.option("-o", "--out", type=OUT, help="Write each map to this folder: NAME.yaml, NAME.pgm.")
@json_option
@calls("sessions:show_session")
def session_command() -> None:
    """Show the content of a session FILE: maps by name, drives, logs, dates and sizes."""


@click.command("merge")
@click.argument("files", type=PATH, nargs=-1, required=True, metavar="FILE FILE...")
@out_option
@click.option("--save", type=OUTPUT_FILE, metavar="FILE", help="Save the merged session to this file.")
@threads_option
@json_option
@calls("sessions:merge_to_folder")
def merge_command() -> None:
    """Merge sessions of several robots or days into one map.

    Places that several of them show are recognized and decided on jointly; the order of the files changes nothing.
    Pieces that have nothing in common stay apart; the exit status is 1 if nothing was joined.

    Writes to OUT: map.yaml, map.pgm and map.png (each drive in a colour), trajectory.tum and trajectory.csv of all
    drives by their stamps, trajectory_NAME.tum of each, graph.g2o, run.json; of further pieces map_2.yaml, ...
    """
