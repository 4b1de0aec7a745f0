"""The commands of the family around the filter, of evaluation and of simulation, and their options."""

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
@click.option("-o", "--out", type=PATH, required=True, help="Folder for the results; made if need be.")
@click.option(
    "--method", type=click.Choice(["ekf", "fastslam1", "fastslam2", "graph", "ekf-localization"]), default="fastslam2",
    show_default=True, help="EKF SLAM, FastSLAM 1.0 or 2.0, GraphSLAM; or localization where the landmarks are known.",
)  # fmt: skip
@click.option("--particles", type=click.IntRange(1, 100_000), metavar="N",
              help="Of FastSLAM.  [default: 100 for 1.0, 20 for 2.0, 200 with --unknown]")  # fmt: skip
@click.option("--seed", type=SEED, default=0, show_default=True, help="The same seed gives the same bytes.")
@click.option("--unknown", is_flag=True, help="Find out which landmark was seen, even where LOG tells it.")
@click.option("--landmarks", type=PATH, help="What to localize by: a landmarks.csv.  [default: LOG's true ones]")
@click.option(
    "--initial-pose", metavar="X,Y,THETA", callback=read_pose,
    help="Where to begin to localize, m and rad.  [default: the true pose; with --landmarks the origin]",
)  # fmt: skip
@json_option
def landmarks_command(
    landmarks: Path | None, initial_pose: tuple[float, float, float] | None, **options: Any  # noqa: ANN401
) -> None:
    """Map the landmarks that LOG tells of, and where the robot was.

    LOG is an odometry file of UTIAS MRCLAM (Robot1_Odometry.dat, its other files beside it), or the lines ODOMETRY and
    LANDMARK that Victoria Park comes in.

    OUT gets landmarks.csv (not where they are known) and trajectory.csv, both with covariances, landmarks.png,
    trajectory.tum, of SLAM by a filter also trajectory_online.tum (what was said at the time), and run.json.
    """
    if options["method"] == "ekf-localization":
        from gridslam.cli.landmark_localization import localize_to_folder

        localize_to_folder(landmarks=landmarks, initial_pose=initial_pose, **options)
        return
    from gridslam.cli.landmarks import landmarks_to_folder

    if landmarks is not None or initial_pose is not None:
        raise click.ClickException("--landmarks and --initial-pose: expected with --method ekf-localization alone")
    landmarks_to_folder(**options)


@click.command("grid")
@click.argument("log", type=PATH)
@click.option("--trajectory", type=PATH, required=True, help="Where the robot was: a file in TUM's form.")
@click.option("-o", "--out", type=PATH, required=True, help="Folder for the results; made if need be.")
@click.option(
    "--model", type=click.Choice(["bayes", "counting"]), default="bayes", show_default=True,
    help="The binary Bayes filter, or the share of the beams that each cell reflects.",
)  # fmt: skip
@click.option(
    "--decay", "half_life_scans", type=float, metavar="N",
    help="Half-life: what is told of a cell counts half after N more scans that see it.  [default: for ever]",
)  # fmt: skip
@click.option("--resolution", "resolution_m", type=float, metavar="M", help="Side of a cell, m.  [default: 0.05]")
@click.option("--laser", metavar="NAME", help="What the laser is: limits and cells that suit it (see gridslam map).")
@click.option("--max-gap", "max_gap_s", type=float, default=1.0, show_default=True, metavar="S",
              help="Interpolate between poses at most so many seconds apart.")  # fmt: skip
@click.option("--no-deskew", is_flag=True, help="Take no notice of the times of beams.")
@click.option(
    "--repair", type=click.Choice(["needed", "all", "none"]), default="needed", show_default=True,
    help="What is taken out of the log first, as for gridslam map.",
)  # fmt: skip
@click.option("--threads", type=click.IntRange(1, 256), default=1, show_default=True, help="Never changes a result.")
@log_options
@json_option
def grid_command(**options: Any) -> None:  # noqa: ANN401
    """Map LOG with known poses.

    Scans are drawn where the trajectory says, and nothing is matched. Each scan gets the pose at
    its own stamp, interpolated; scans outside the trajectory are left out and counted.

    OUT gets map.yaml, map.pgm, map.png and run.json.
    """
    from gridslam.cli.grid import grid_to_folder

    grid_to_folder(**options)


@click.command("localize")
@click.argument("log", type=PATH)
@click.option("--map", "map_path", type=PATH, required=True, help="The map's YAML file, of map_server or nav2.")
@click.option("-o", "--out", type=PATH, help="Folder for the results; made if need be.")
@click.option(
    "--initial-pose", metavar="X,Y,THETA", callback=read_pose, default="global", show_default=True,
    help="Where the robot is at first, m and rad, or global: anywhere.",
)  # fmt: skip
@click.option("--seed", type=SEED, default=0, show_default=True, help="The same seed gives the same bytes.")
@click.option("--particles", type=click.IntRange(min=1), help="Greatest number of particles.  [default: 20000]")
@click.option("--threads", type=click.IntRange(1, 256), default=1, show_default=True, help="Never changes a result.")
@click.option(
    "--preset", type=click.Choice(["default", "amcl", "nav2"]), default="default", show_default=True,
    help="Parameters to begin with: gridslam's, or the defaults of AMCL in ROS 1 or in nav2.",
)  # fmt: skip
@click.option("--set", "assignments", multiple=True, metavar="NAME=VALUE", help="Set one, by its name here or in AMCL.")
@click.option("--strict-thresholds", is_flag=True, help="Read the map's thresholds literally, even for the pixel 205.")
@click.option(
    "--repair", type=click.Choice(["needed", "all", "none"]), default="needed", show_default=True,
    help="What is taken out of the log first, as for gridslam map.",
)  # fmt: skip
@log_options
@live_options
@rerun_option
@json_option
def localize_command(**options: Any) -> None:  # noqa: ANN401
    """Localize a robot in a known map.

    Monte Carlo localization: by particles. LOG is a CARMEN log, a ROS 1 or ROS 2 bag, or a CSV of scans, with odometry.

    OUT gets trajectory.tum (a pose for every scan, as it was told at the time), trajectory.csv (with covariances),
    belief.csv (at which scans the robot was lost, and how sure that is), localization.png and run.json.
    """
    from gridslam.cli.localize import localize_to_folder

    localize_to_folder(**options)


@click.command("graph")
@click.argument("file", type=PATH)
@click.option("-o", "--out", type=PATH, required=True, help="Folder for the results; made if need be.")
@click.option("--robust", is_flag=True, help="Find the loop closures that are false, and leave them out.")
@click.option("--no-guess", is_flag=True, help="Take no notice of the poses in FILE: guess them from the edges.")
@click.option("--skip-unknown", is_flag=True, help="Pass over lines with unknown tags, and count them.")
@click.option("--max-iterations", type=click.IntRange(min=1), default=100, show_default=True, metavar="N",
              help="End the search from each first guess after so many steps.")  # fmt: skip
@json_option
def graph_command(**options: Any) -> None:  # noqa: ANN401
    """Solve FILE, a pose graph, by GraphSLAM.

    FILE is in g2o's form: plain, .gz or .bz2.

    OUT gets graph.g2o (the poses found), graph.png (before and after), graph.json and, with --robust, weights.csv.
    """
    from gridslam.cli.graph import graph_to_folder

    graph_to_folder(**options)


@click.command("evaluate")
@click.argument("trajectory", type=PATH)
@click.argument("reference", type=PATH)
@click.option("--distance", "distance_m", type=float, default=1.0, show_default=True, metavar="M",
              help="Way between the two poses that the RPE compares, m.")  # fmt: skip
@json_option
def evaluate_command(**options: Any) -> None:  # noqa: ANN401
    """Tell the errors of TRAJECTORY against REFERENCE.

    TRAJECTORY is in TUM's form: stamp x y z qx qy qz qw.

    REFERENCE is true relative poses (Kuemmerle et al. 2009), if it is named *.relations; else a true trajectory in
    TUM's form, and the absolute (ATE, aligned) and the relative (RPE) errors are told.
    """
    from gridslam.cli.evaluate import evaluate

    evaluate(**options)


@click.command("simulate")
@click.argument("world")
@click.option("-o", "--out", type=PATH, required=True, help="The log, a .clf; compressed if .gz or .bz2 follows.")
@click.option("--seed", type=SEED, default=0, show_default=True, help="Of the noise, and of a world that is drawn.")
@click.option("--beams", type=click.IntRange(min=2), default=180, show_default=True, help="Beams of a scan.")
@click.option("--fov", "fov_deg", type=click.FloatRange(0, 360, min_open=True), default=180.0, show_default=True,
              metavar="DEG", help="Field of view, degrees.")  # fmt: skip
@click.option("--range-max", "range_max_m", type=click.FloatRange(0, min_open=True), default=30.0, show_default=True,
              metavar="M", help="Beyond it nothing returns, m.")  # fmt: skip
@click.option("--rate", "rate_hz", type=click.FloatRange(0, 1000, min_open=True), default=5.0, show_default=True,
              metavar="HZ", help="Scans a second.")  # fmt: skip
@click.option("--people", type=click.IntRange(min=0), default=0, show_default=True, help="People who walk about.")
@click.option("--duration", "duration_s", type=float, metavar="S", help="End the log after so many seconds.")
@json_option
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


FAMILY_COMMANDS = (localize_command, grid_command, landmarks_command, graph_command, evaluate_command, simulate_command)
