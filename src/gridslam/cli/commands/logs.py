"""gridslam doctor, convert, dataset and simulate: options and help."""

from __future__ import annotations

from pathlib import Path

import click

from gridslam.cli.option_types import OUT, OUTPUT_FILE, OUTPUT_FOLDER, PATH, SEED, TIME_LIMIT, Number
from gridslam.cli.options import calls, json_option, log_options


@click.command("doctor")
@click.argument("log", type=PATH)
@click.option("-o", "--out", type=OUT, help="Folder for the report; created if missing.")
@log_options
@json_option
@calls("logs:doctor_log")
def doctor_command() -> None:
    """Check LOG and report its content and its faults.

    LOG is a CARMEN log, a ROS 1 or ROS 2 bag, or a CSV of scans. Exit status: 3 if a fault makes the map unusable.
    """


@click.command("convert")
@click.argument("log", metavar="IN", type=PATH)
@click.argument("out", type=OUTPUT_FILE)
@log_options
@json_option
@calls("logs:convert")
def convert_command() -> None:
    """Write the log IN in another format.

    \b
    The format follows from the suffix of OUT:
      .csv                  a row for each scan (columns: docs/logs.md)
      .bag                  ROS 1
      .mcap, .db3, a name without suffix (a folder)   ROS 2

    CSV is compressed if the name ends in .gz or .bz2.
    """


@click.group("dataset", no_args_is_help=False)
def dataset_command() -> None:
    """Download public logs."""


@dataset_command.command("list")
@json_option
@calls("logs:list_datasets")
def dataset_list_command() -> None:
    """List the available logs with their credit and licence."""


@dataset_command.command("get")
@click.argument("name")
@click.option(
    "-o", "--out", type=OUTPUT_FOLDER, default=Path("."), help="Output folder; created if missing.  [default: .]"
)
@click.option("--url", help="Base URL of the files.  [default: GRIDSLAM_DATASETS_URL or the public mirror]")
@json_option
@calls("logs:get_dataset")
def dataset_get_command() -> None:
    """Download the log NAME if it is missing, and verify its SHA-256."""


@click.command("simulate")
@click.argument("world")
@click.option("-o", "--out", type=OUTPUT_FILE, required=True, help="Output log, .clf, .clf.gz or .clf.bz2.")
@click.option("--seed", type=SEED, default=0, show_default=True, help="Random seed of the noise and of random worlds.")
@click.option("--world-seed", type=SEED, help="Seed of the world alone: drive one random world again, by another way.")
@click.option("--beams", type=click.IntRange(min=2), default=180, show_default=True, help="Beams per scan.")
@click.option(
    "--fov",
    "fov_deg",
    type=Number(0, 360, above=True),
    default=180.0,
    show_default=True,
    metavar="DEG",
    help="Field of view, degrees.",
)
@click.option(
    "--range-max",
    "range_max_m",
    type=Number(0, above=True),
    default=30.0,
    show_default=True,
    metavar="M",
    help="Maximum range, m.",
)
@click.option(
    "--rate",
    "rate_hz",
    type=Number(0, 1000, above=True),
    default=5.0,
    show_default=True,
    metavar="HZ",
    help="Scan rate, Hz.",
)
@click.option("--people", type=click.IntRange(min=0), default=0, show_default=True, help="Number of walking people.")
@click.option("--duration", "duration_s", type=TIME_LIMIT, metavar="S", help="Duration of the log, s.")
@json_option
@calls("simulate:simulate_to_log")
def simulate_command() -> None:
    """Simulate a robot in WORLD and write the log.

    \b
    WORLD is
      fixed: demo, loop, rooms, hall or corridor
      random, generated from the seed: random

    Also writes LOG.truth.tum, the true trajectory.
    """
