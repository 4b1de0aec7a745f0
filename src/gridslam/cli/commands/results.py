"""gridslam view, evaluate and regress: options and help."""

from __future__ import annotations

import click

from gridslam.cli.option_types import PATH, Number
from gridslam.cli.options import calls, host_options, json_option


@click.command("view")
@click.argument("out", type=PATH)
@host_options
@calls("live:view")
def view_command() -> None:
    """Show the results in OUT in the browser.

    A run of map, localize or demo is replayed; of grid and merge the map is shown.
    """


@click.command("evaluate")
@click.argument("trajectory", type=PATH)
@click.argument("reference", type=PATH)
@click.option(
    "--distance",
    "distance_m",
    type=Number(0, above=True),
    default=1.0,
    show_default=True,
    metavar="M",
    help="Path length between the pose pairs of the RPE, m.",
)
@click.option("--part", "is_part", is_flag=True, help="Score only the relations within the time of TRAJECTORY.")
@json_option
@calls("evaluate:evaluate")
def evaluate_command() -> None:
    """Compute the errors of TRAJECTORY with respect to REFERENCE.

    TRAJECTORY is in TUM format, stamp x y z qx qy qz qw, or EuRoC's.

    REFERENCE is a file of true relative poses (Kuemmerle et al. 2009) if its name ends in .relations; otherwise a true
    trajectory in the format of TUM or EuRoC, for which the absolute (ATE, aligned) and relative (RPE) errors are
    reported; or, where there is no truth, the log itself: how well its scans,
    drawn along TRAJECTORY, agree with each other.
    """


@click.command("regress")
@click.argument("old", type=PATH)
@click.argument("new", type=PATH)
@click.option(
    "--level",
    type=Number(1e-3, 0.5),
    default=0.05,
    show_default=True,
    metavar="P",
    help="Probability of any false alarm.",
)
@click.option(
    "--error-margin",
    type=Number(0, 1000),
    default=1.0,
    show_default=True,
    metavar="PERCENT",
    help="By how much errors may grow.",
)
@click.option(
    "--cost-margin",
    type=Number(0, 1000),
    default=10.0,
    show_default=True,
    metavar="PERCENT",
    help="By how much CPU time and memory may grow.",
)
@json_option
@calls("regress:regress")
def regress_command() -> None:
    """Compare NEW with OLD, two output folders of gridslam batch, and report changes for the worse beyond noise.

    Runs are paired by log and seed (the folders of their results). Errors, CPU time, memory and failures of each log
    and of all logs together are tested by Student's t; --level bounds the probability of any false alarm over all of
    them. At least five pairs are needed, such as five seeds of a log.

    Exit status: 1 if something became worse.
    """
