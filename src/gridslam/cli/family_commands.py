"""Commands for localization, mapping with known poses, landmarks, pose graphs, evaluation and simulation."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from gridslam.cli.live import live_options
from gridslam.cli.log_options import log_options
from gridslam.cli.options import PATH, SEED, json_option, read_pose
from gridslam.cli.rerun import rerun_option

__all__ = ["FAMILY_COMMANDS"]


@click.command("landmarks")
@click.argument("log", type=PATH)
@click.option("-o", "--out", type=PATH, required=True, help="Output folder; created if missing.")
@click.option(
    "--method", type=click.Choice(["ekf", "fastslam1", "fastslam2", "graph", "ekf-localization"]), default="fastslam2",
    show_default=True, help="EKF SLAM, FastSLAM 1.0 or 2.0, GraphSLAM, or EKF localization in a known landmark map.",
)  # fmt: skip
@click.option("--particles", type=click.IntRange(1, 100_000), metavar="N",
              help="Number of FastSLAM particles.  [default: 100 for 1.0, 20 for 2.0, 200 with --unknown]")  # fmt: skip
@click.option(
    "--seed", type=SEED, default=0, show_default=True, help="Random seed; the same seed gives identical output files."
)
@click.option("--unknown", is_flag=True, help="Estimate the correspondences, even if LOG contains them.")
@click.option(
    "--landmarks", type=PATH, help="Landmark map to localize in, a landmarks.csv.  [default: the true landmarks of LOG]"
)
@click.option(
    "--initial-pose", metavar="X,Y,THETA", callback=read_pose,
    help="Initial pose, m and rad.  [default: the true pose; with --landmarks the origin]",
)  # fmt: skip
@json_option
def landmarks_command(
    landmarks: Path | None,
    initial_pose: tuple[float, float, float] | None,
    **options: Any,  # noqa: ANN401
) -> None:
    """Estimate the landmarks and the trajectory of LOG.

    LOG is an odometry file of UTIAS MRCLAM (Robot1_Odometry.dat in the folder of the dataset), or a Victoria Park file
    with ODOMETRY and LANDMARK lines.

    Writes to OUT: landmarks.csv (except for ekf-localization) and trajectory.csv, both with covariances, landmarks.png,
    trajectory.tum, trajectory_online.tum (SLAM filters only: the online pose estimates) and run.json.
    """
    if options["method"] == "ekf-localization":
        from gridslam.cli.landmark_localization import localize_to_folder

        localize_to_folder(landmarks=landmarks, initial_pose=initial_pose, **options)
        return
    from gridslam.cli.landmarks import landmarks_to_folder

    if landmarks is not None or initial_pose is not None:
        raise click.ClickException("--landmarks and --initial-pose: only valid with --method ekf-localization")
    landmarks_to_folder(**options)


@click.command("grid")
@click.argument("log", type=PATH)
@click.option("--trajectory", type=PATH, required=True, help="Trajectory of the robot, a file in TUM format.")
@click.option("-o", "--out", type=PATH, required=True, help="Output folder; created if missing.")
@click.option(
    "--model", type=click.Choice(["bayes", "counting"]), default="bayes", show_default=True,
    help="Inverse sensor model with log-odds (bayes), or reflection probability per cell (counting).",
)  # fmt: skip
@click.option(
    "--decay", "half_life_scans", type=float, metavar="N",
    help="Half-life of the evidence of a cell, in scans that observe it.  [default: infinite]",
)  # fmt: skip
@click.option(
    "--resolution", "resolution_m", type=float, metavar="M", help="Map resolution, m per cell.  [default: 0.05]"
)
@click.option("--laser", metavar="NAME", help="Laser model; sets range limits and map resolution (see gridslam map).")
@click.option("--max-gap", "max_gap_s", type=float, default=1.0, show_default=True, metavar="S",
              help="Longest gap between poses to interpolate across, s.")  # fmt: skip
@click.option("--no-deskew", is_flag=True, help="Ignore the beam times; do not deskew.")
@click.option(
    "--repair", type=click.Choice(["needed", "all", "none"]), default="needed", show_default=True,
    help="Faults corrected before the log is used, as in gridslam map.",
)  # fmt: skip
@click.option(
    "--threads", type=click.IntRange(1, 256), default=1, show_default=True,
    help="Number of threads; does not affect the results.",
)  # fmt: skip
@log_options
@json_option
def grid_command(**options: Any) -> None:  # noqa: ANN401
    """Map LOG with known poses.

    Scans are inserted at the poses of the trajectory, without scan matching. The pose of each scan is interpolated at
    its stamp; scans outside the trajectory are skipped and counted.

    Writes map.yaml, map.pgm, map.png and run.json to OUT.
    """
    from gridslam.cli.grid import grid_to_folder

    grid_to_folder(**options)


@click.command("localize")
@click.argument("log", type=PATH)
@click.option("--map", "map_path", type=PATH, required=True, help="Map YAML file (map_server or nav2).")
@click.option("-o", "--out", type=PATH, help="Output folder; created if missing.")
@click.option(
    "--initial-pose", metavar="X,Y,THETA", callback=read_pose, default="global", show_default=True,
    help="Initial pose, m and rad; global: unknown.",
)  # fmt: skip
@click.option(
    "--seed", type=SEED, default=0, show_default=True, help="Random seed; the same seed gives identical output files."
)
@click.option("--particles", type=click.IntRange(min=1), help="Maximum number of particles.  [default: 20000]")
@click.option(
    "--threads", type=click.IntRange(1, 256), default=1, show_default=True,
    help="Number of threads; does not affect the results.",
)  # fmt: skip
@click.option(
    "--preset", type=click.Choice(["default", "amcl", "nav2"]), default="default", show_default=True,
    help="Base parameters: gridslam's, or the AMCL defaults of ROS 1 or nav2.",
)  # fmt: skip
@click.option(
    "--set", "assignments", multiple=True, metavar="NAME=VALUE", help="Set one parameter, by its gridslam or AMCL name."
)
@click.option(
    "--strict-thresholds", is_flag=True, help="Apply the map's thresholds literally, also to pixel value 205."
)
@click.option(
    "--repair", type=click.Choice(["needed", "all", "none"]), default="needed", show_default=True,
    help="Faults corrected before the log is used, as in gridslam map.",
)  # fmt: skip
@log_options
@live_options
@rerun_option
@json_option
def localize_command(**options: Any) -> None:  # noqa: ANN401
    """Localize a robot in a known map.

    Monte Carlo localization. LOG is a CARMEN log, a ROS 1 or ROS 2 bag, or a CSV of scans, with odometry.

    Writes to OUT: trajectory.tum (the online pose estimate of every scan), trajectory.csv (with covariances),
    belief.csv (lost flag and lost probability per scan), localization.png and run.json.
    """
    from gridslam.cli.localize import localize_to_folder

    localize_to_folder(**options)


@click.command("graph")
@click.argument("file", type=PATH)
@click.option("-o", "--out", type=PATH, required=True, help="Output folder; created if missing.")
@click.option("--robust", is_flag=True, help="Reject outlier loop closures by graduated non-convexity.")
@click.option("--no-guess", is_flag=True, help="Ignore the poses in FILE; compute the initial guess from the edges.")
@click.option("--skip-unknown", is_flag=True, help="Skip lines with unknown tags and report their number.")
@click.option("--max-iterations", type=click.IntRange(min=1), default=100, show_default=True, metavar="N",
              help="Maximum number of iterations per initial guess.")  # fmt: skip
@json_option
def graph_command(**options: Any) -> None:  # noqa: ANN401
    """Solve FILE, a pose graph, by GraphSLAM.

    FILE is in g2o format, plain or compressed (.gz, .bz2).

    Writes to OUT: graph.g2o (the optimized poses), graph.png (before and after), graph.json and, with --robust,
    weights.csv.
    """
    from gridslam.cli.graph import graph_to_folder

    graph_to_folder(**options)


@click.command("evaluate")
@click.argument("trajectory", type=PATH)
@click.argument("reference", type=PATH)
@click.option("--distance", "distance_m", type=float, default=1.0, show_default=True, metavar="M",
              help="Path length between the pose pairs of the RPE, m.")  # fmt: skip
@json_option
def evaluate_command(**options: Any) -> None:  # noqa: ANN401
    """Compute the errors of TRAJECTORY with respect to REFERENCE.

    TRAJECTORY is in TUM format: stamp x y z qx qy qz qw.

    REFERENCE is a file of true relative poses (Kuemmerle et al. 2009) if its name ends in .relations; otherwise a true
    trajectory in TUM format, for which the absolute (ATE, aligned) and relative (RPE) errors are reported.
    """
    from gridslam.cli.evaluate import evaluate

    evaluate(**options)


@click.command("simulate")
@click.argument("world")
@click.option("-o", "--out", type=PATH, required=True, help="Output log, .clf, .clf.gz or .clf.bz2.")
@click.option("--seed", type=SEED, default=0, show_default=True, help="Random seed of the noise and of random worlds.")
@click.option("--beams", type=click.IntRange(min=2), default=180, show_default=True, help="Beams per scan.")
@click.option("--fov", "fov_deg", type=click.FloatRange(0, 360, min_open=True), default=180.0, show_default=True,
              metavar="DEG", help="Field of view, degrees.")  # fmt: skip
@click.option("--range-max", "range_max_m", type=click.FloatRange(0, min_open=True), default=30.0, show_default=True,
              metavar="M", help="Maximum range, m.")  # fmt: skip
@click.option("--rate", "rate_hz", type=click.FloatRange(0, 1000, min_open=True), default=5.0, show_default=True,
              metavar="HZ", help="Scan rate, Hz.")  # fmt: skip
@click.option("--people", type=click.IntRange(min=0), default=0, show_default=True, help="Number of walking people.")
@click.option("--duration", "duration_s", type=float, metavar="S", help="Duration of the log, s.")
@json_option
def simulate_command(**options: Any) -> None:  # noqa: ANN401
    """Simulate a robot in WORLD and write the log.

    \b
    WORLD is
      fixed: demo, loop, rooms, hall or corridor
      random, generated from the seed: random
        with perceptual aliasing: equal_rooms, symmetric, bare_corridors, moved_furniture
        large: campus (2 km), fleet (10 km)

    Also writes LOG.truth.tum, the true trajectory.
    """
    from gridslam.cli.simulate import simulate_to_log

    simulate_to_log(**options)


FAMILY_COMMANDS = (localize_command, grid_command, landmarks_command, graph_command, evaluate_command, simulate_command)
