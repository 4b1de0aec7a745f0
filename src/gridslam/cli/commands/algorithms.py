"""gridslam landmarks, grid, localize and graph: options and help."""

from __future__ import annotations

import click

from gridslam.cli.option_types import OUT, PATH, SECONDS, Number
from gridslam.cli.options import (
    calls,
    history_option,
    json_option,
    live_options,
    localize_options,
    log_options,
    out_option,
    read_pose,
    repair_option,
    seed_option,
    threads_option,
)


@click.command("landmarks")
@click.argument("log", type=PATH)
@out_option
@click.option(
    "--method",
    type=click.Choice(["ekf", "fastslam1", "fastslam2", "graph", "ekf-localization"]),
    default="fastslam2",
    show_default=True,
    help="EKF SLAM, FastSLAM 1.0 or 2.0, GraphSLAM, or EKF localization in a known landmark map.",
)
@click.option(
    "--particles",
    type=click.IntRange(1, 100_000),
    metavar="N",
    help="Number of FastSLAM particles.  [default: 100 for 1.0, 20 for 2.0, 200 with --unknown]",
)
@seed_option
@click.option("--unknown", is_flag=True, help="Estimate the correspondences, even if LOG contains them.")
@click.option(
    "--landmarks", type=PATH, help="Landmark map to localize in, a landmarks.csv.  [default: the true landmarks of LOG]"
)
@click.option(
    "--initial-pose",
    metavar="X,Y,THETA",
    callback=read_pose,
    help="Initial pose, m and rad.  [default: the true pose; with --landmarks the origin]",
)
@json_option
@calls("landmarks:landmarks_to_folder")
def landmarks_command() -> None:
    """Estimate the landmarks and the trajectory of LOG.

    LOG is an odometry file of UTIAS MRCLAM (Robot1_Odometry.dat in the folder of the dataset), or a Victoria Park file
    with ODOMETRY and LANDMARK lines.

    Writes to OUT: landmarks.csv (except for ekf-localization) and trajectory.csv, both with covariances, landmarks.png,
    trajectory.tum, trajectory_online.tum (SLAM filters only: the online pose estimates) and run.json.
    """


@click.command("grid")
@click.argument("log", type=PATH)
@click.option("--trajectory", type=PATH, required=True, help="Trajectory of the robot, a file in TUM format.")
@out_option
@click.option(
    "--model",
    type=click.Choice(["bayes", "counting"]),
    default="bayes",
    show_default=True,
    help="Inverse sensor model with log-odds (bayes), or reflection probability per cell (counting).",
)
@click.option(
    "--resolution", "resolution_m", type=Number(), metavar="M", help="Map resolution, m per cell.  [default: 0.05]"
)
@click.option("--laser", metavar="NAME", help="Laser model; sets range limits and map resolution (see gridslam map).")
@click.option(
    "--max-gap",
    "max_gap_s",
    type=SECONDS,
    default=1.0,
    show_default=True,
    metavar="S",
    help="Longest gap between poses to interpolate across, s.",
)
@click.option("--no-deskew", is_flag=True, help="Ignore the beam times; do not deskew.")
@repair_option(help="Faults corrected before the log is used, as in gridslam map.")
@threads_option
@log_options
@json_option
@calls("grid:grid_to_folder")
def grid_command() -> None:
    """Map LOG with known poses.

    Scans are inserted at the poses of the trajectory, without scan matching. The pose of each scan is interpolated at
    its stamp; scans outside the trajectory are skipped and counted.

    Writes map.yaml, map.pgm, map.png and run.json to OUT.
    """


@click.command("localize")
@click.argument("log", type=PATH)
@click.option("-o", "--out", type=OUT, help="Output folder; created if missing.")
@localize_options
@live_options
@history_option
@json_option
@calls("localize:localize_to_folder")
def localize_command() -> None:
    """Localize a robot in a known map.

    Monte Carlo localization. LOG is a CARMEN log, a ROS 1 or ROS 2 bag, or a CSV of scans, with odometry.

    Writes to OUT: trajectory.tum (the online pose estimate of every scan), trajectory.csv (with covariances),
    belief.csv (lost flag and lost probability per scan), localization.png and run.json.
    """


@click.command("graph")
@click.argument("file", type=PATH)
@out_option
@click.option("--robust", is_flag=True, help="Reject outlier loop closures by graduated non-convexity.")
@click.option("--no-guess", is_flag=True, help="Ignore the poses in FILE; compute the initial guess from the edges.")
@click.option("--skip-unknown", is_flag=True, help="Skip lines with unknown tags and report their number.")
@click.option(
    "--max-iterations",
    type=click.IntRange(min=1),
    default=100,
    show_default=True,
    metavar="N",
    help="Maximum number of iterations per initial guess.",
)
@json_option
@calls("graph:graph_to_folder")
def graph_command() -> None:
    """Solve FILE, a pose graph, by GraphSLAM.

    FILE is in g2o format, plain or compressed (.gz, .bz2).

    Writes to OUT: graph.g2o (the optimized poses), graph.png and graph.json (with --robust the
    weights, too).
    """
