"""Commands and their options; the implementation of a command is imported when it runs, to keep help fast."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from gridslam import __version__
from gridslam.cli.option_types import (
    LOG,
    MEMORY,
    OUT,
    OUTPUT_FILE,
    OUTPUT_FOLDER,
    PATH,
    SECONDS,
    SEED,
    THREADS,
    TIME_LIMIT,
    UPLOAD,
    Number,
)
from gridslam.cli.options import (
    SETTINGS,
    add_options,
    assignment_option,
    evaluate_options,
    history_option,
    host_options,
    json_option,
    live_options,
    localize_options,
    log_options,
    map_options,
    out_option,
    read_pose,
    repair_option,
    rerun_option,
    robot_live_options,
    seed_option,
    session_options,
    threads_option,
)

__all__ = ["gridslam"]


@click.group(context_settings=SETTINGS, no_args_is_help=False)
@click.version_option(__version__, prog_name="gridslam", message="%(prog)s %(version)s")
@click.option(
    "--max-memory",
    type=Number(0.01, 1e6),
    default=1.0,
    show_default=True,
    metavar="GB",
    help="Refuse input of which a part takes more memory than this when it is read.",
)
@click.pass_context
def gridslam(context: click.Context, max_memory: float) -> None:
    """2D lidar SLAM: from a robot's laser scans and odometry to a map and a trajectory.

    Start with `gridslam demo`, which needs no data.
    """
    from gridslam.io.limits import limit_memory

    context.with_resource(limit_memory(round(1e9 * max_memory)))


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


@gridslam.command("map", cls=_MapCommand)
@click.argument("log", type=LOG)
@out_option
@map_options
@session_options
@live_options
@history_option
@rerun_option
@json_option
def map_command(**options: Any) -> None:  # noqa: ANN401
    """Map LOG with grid-based FastSLAM and loop closure.

    LOG is a CARMEN log, a ROS 1 or ROS 2 bag, or a CSV of scans.

    Writes to OUT: map.yaml, map.pgm and map.png, trajectory.tum (full SLAM: a pose for every scan), trajectory.csv
    (with covariances), trajectory_online.tum (the online pose estimates), graph.g2o (key scans and constraints),
    record.npz (the particles at each key scan) and run.json (counts, times, parameters).

    With --save and --continue a map grows over several logs, days and robots: where the robot was not moved in between
    the filter goes on as if there had been one log; else it is found again in the map first. Then trajectory_NAME.tum
    is the trajectory of each drive, and map_2.yaml, ... are pieces in which it was not found.
    """
    from gridslam.cli.map import map_to_folder

    map_to_folder(**options)


@gridslam.command("session")
@click.argument("file", type=PATH)
@click.option("--picture", type=OUTPUT_FILE, metavar="PNG", help="Write the map of the newest drive as a picture.")
@json_option
def session_command(**options: Any) -> None:  # noqa: ANN401
    """Show what is in a session FILE: drives, logs, dates, sizes, and a picture."""
    from gridslam.cli.sessions import show_session

    show_session(**options)


@gridslam.command("merge")
@click.argument("files", type=PATH, nargs=-1, required=True, metavar="FILE FILE...")
@out_option
@click.option("--save", type=OUTPUT_FILE, metavar="FILE", help="Save the merged session to this file.")
@threads_option
@json_option
def merge_command(**options: Any) -> None:  # noqa: ANN401
    """Merge sessions of several robots or days into one map.

    Places that several of them show are recognized and decided on jointly; the order of the files changes nothing.
    Pieces that have nothing in common stay apart.

    Writes to OUT: map.yaml, map.pgm and map.png (each drive in a colour), trajectory.tum and trajectory.csv of all
    drives by their stamps, trajectory_NAME.tum of each, graph.g2o, run.json; of further pieces map_2.yaml, ...
    """
    from gridslam.cli.sessions import merge_to_folder

    merge_to_folder(**options)


@gridslam.command("doctor")
@click.argument("log", type=LOG)
@click.option("-o", "--out", type=OUT, help="Folder for the report and its figures; created if missing.")
@log_options
@json_option
def doctor_command(**options: Any) -> Any:  # noqa: ANN401
    """Check LOG and report its content and its faults.

    LOG is a CARMEN log, a ROS 1 or ROS 2 bag, or a CSV of scans. Exit status: 3 if a fault makes the map unusable.
    """
    from gridslam.cli.logs import doctor_log

    return doctor_log(**options)


@gridslam.command("convert")
@click.argument("log", metavar="IN", type=LOG)
@click.argument("out", type=OUTPUT_FILE)
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
    from gridslam.cli.logs import convert

    convert(**options)


@gridslam.group("dataset")
def dataset_group() -> None:
    """Download public logs."""


@dataset_group.command("list")
@json_option
def dataset_list_command(**options: Any) -> None:  # noqa: ANN401
    """List the available logs with their credit and licence."""
    from gridslam.cli.logs import list_datasets

    list_datasets(**options)


@dataset_group.command("get")
@click.argument("name")
@click.option(
    "-o", "--out", type=OUTPUT_FOLDER, default=Path("."), help="Output folder; created if missing.  [default: .]"
)
@click.option("--url", help="Base URL of the files.  [default: GRIDSLAM_DATASETS_URL or the public mirror]")
@json_option
def dataset_get_command(**options: Any) -> None:  # noqa: ANN401
    """Download the log NAME if it is missing, and verify its SHA-256."""
    from gridslam.cli.logs import get_dataset

    get_dataset(**options)


@gridslam.command("demo")
@click.option(
    "-o", "--out", type=OUTPUT_FOLDER, default=Path("gridslam-demo"), show_default=True, help="Output folder."
)
@click.option(
    "--seed", type=SEED, default=0, show_default=True, help="Random seed of the simulation and of the filter."
)
@live_options
@history_option
@rerun_option
@json_option
def demo_command(**options: Any) -> None:  # noqa: ANN401
    """Simulate a robot in a small office, and map it; needs no data.

    Writes to OUT the files of `gridslam map`, demo.clf.gz (the log) and truth.tum (the true trajectory).
    """
    from gridslam.cli.simulate import demo

    demo(**options)


@gridslam.command("view")
@click.argument("out", type=PATH)
@click.option(
    "--beside",
    type=PATH,
    metavar="PATH",
    help="Compare with another OUT, map.yaml or trajectory.tum.  [default: OUT/truth.tum, if there is one]",
)
@host_options
def view_command(**options: Any) -> None:  # noqa: ANN401
    """Replay the results in OUT in the browser."""
    from gridslam.cli.live import view

    view(**options)


@gridslam.command("landmarks")
@click.argument("log", type=LOG)
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
def landmarks_command(**options: Any) -> None:  # noqa: ANN401
    """Estimate the landmarks and the trajectory of LOG.

    LOG is an odometry file of UTIAS MRCLAM (Robot1_Odometry.dat in the folder of the dataset), or a Victoria Park file
    with ODOMETRY and LANDMARK lines.

    Writes to OUT: landmarks.csv (except for ekf-localization) and trajectory.csv, both with covariances, landmarks.png,
    trajectory.tum, trajectory_online.tum (SLAM filters only: the online pose estimates) and run.json.
    """
    from gridslam.cli.landmarks import landmarks_to_folder

    landmarks_to_folder(**options)


@gridslam.command("grid")
@click.argument("log", type=LOG)
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
    "--decay",
    "half_life_scans",
    type=Number(),
    metavar="N",
    help="Half-life of the evidence of a cell, in scans that observe it.  [default: infinite]",
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
def grid_command(**options: Any) -> None:  # noqa: ANN401
    """Map LOG with known poses.

    Scans are inserted at the poses of the trajectory, without scan matching. The pose of each scan is interpolated at
    its stamp; scans outside the trajectory are skipped and counted.

    Writes map.yaml, map.pgm, map.png and run.json to OUT.
    """
    from gridslam.cli.grid import grid_to_folder

    grid_to_folder(**options)


@gridslam.command("localize")
@click.argument("log", type=LOG)
@click.option("-o", "--out", type=OUT, help="Output folder; created if missing.")
@localize_options
@live_options
@history_option
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


@gridslam.command("graph")
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
def graph_command(**options: Any) -> None:  # noqa: ANN401
    """Solve FILE, a pose graph, by GraphSLAM.

    FILE is in g2o format, plain or compressed (.gz, .bz2).

    Writes to OUT: graph.g2o (the optimized poses), graph.png (before and after), graph.json and, with --robust,
    weights.csv.
    """
    from gridslam.cli.graph import graph_to_folder

    graph_to_folder(**options)


@gridslam.command("evaluate")
@click.argument("trajectory", type=PATH)
@click.argument("reference", type=PATH)
@evaluate_options
@json_option
def evaluate_command(**options: Any) -> None:  # noqa: ANN401
    """Compute the errors of TRAJECTORY with respect to REFERENCE.

    TRAJECTORY is in TUM format, stamp x y z qx qy qz qw, or EuRoC's.

    REFERENCE is a file of true relative poses (Kuemmerle et al. 2009) if its name ends in .relations; otherwise a true
    trajectory in the format of TUM, EuRoC or KITTI (a pose for each of TRAJECTORY), for which the absolute (ATE,
    aligned) and relative (RPE) errors are reported; or, where there is no truth, the log itself: how well its scans,
    drawn along TRAJECTORY, agree with each other.
    """
    from gridslam.cli.evaluate import evaluate

    evaluate(**options)


@gridslam.command("regress")
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
def regress_command(**options: Any) -> Any:  # noqa: ANN401
    """Compare NEW with OLD, two output folders of gridslam batch, and report what became worse beyond noise.

    Runs are paired by log and seed (the folders of their results). Errors, CPU time, memory and failures of each log
    and of all logs together are tested by permutation, which assumes no distribution; --level bounds the probability
    of any false alarm over all of them. At least five pairs are needed, such as five seeds of a log.

    Exit status: 1 if something became worse.
    """
    from gridslam.cli.regress import regress

    return regress(**options)


@gridslam.command("simulate")
@click.argument("world")
@click.option("-o", "--out", type=OUTPUT_FILE, required=True, help="Output log, .clf, .clf.gz or .clf.bz2.")
@click.option("--seed", type=SEED, default=0, show_default=True, help="Random seed of the noise and of random worlds.")
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
@click.option("--duration", "duration_s", type=SECONDS, metavar="S", help="Duration of the log, s.")
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


class _BatchCommand(click.Command):
    """Command that hands on what follows ``--``: the options of the command that it runs."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse what precedes ``--``."""
        at = args.index("--") if "--" in args else len(args)
        ctx.meta["gridslam.batch"] = args[at + 1 :]
        return super().parse_args(ctx, args[:at])

    def format_usage(self, context: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the usage."""
        formatter.write_usage(context.command_path, "LOGS... -o OUT [OPTIONS] [-- OPTIONS OF THE COMMAND]")


@gridslam.command("batch", cls=_BatchCommand)
@click.argument("logs", nargs=-1)
@click.option("-o", "--out", type=OUTPUT_FOLDER, required=True, help="Output folder; created if missing.")
@click.option(
    "--command",
    type=click.Choice(["map", "doctor", "localize", "evaluate"]),
    default="map",
    show_default=True,
    help="What to do with each log.",
)
@click.option(
    "--reference",
    metavar="PATTERN",
    help="File of relations (.relations) or true trajectory of each log, with {name}, {stem} or {parent} for the log's "
    "name, its file's and its folder's: results are scored against it.",
)
@click.option(
    "--workers", type=click.IntRange(1, 256), metavar="N", help="Logs at a time.  [default: number of processors]"
)
@click.option(
    "--scheduler",
    metavar="ADDRESS|FILE",
    help="Run on a Dask cluster: address of its scheduler (tcp://, tls://), its scheduler file, or a configuration of "
    "dask-jobqueue, YAML, from which --workers are started (extra: cluster).",
)
@click.option("--timeout", "timeout_s", type=TIME_LIMIT, metavar="S", help="Time limit for a log, s.")
@click.option(
    "--memory",
    "memory_mb",
    type=MEMORY,
    metavar="MB|auto",
    help="Limit of the address space for a log, MB (Linux only); auto: four times what it is estimated to need.",
)
@click.option(
    "--retries",
    type=click.IntRange(0, 100),
    default=1,
    show_default=True,
    metavar="N",
    help="Run a log whose worker is lost again elsewhere, at most N times.",
)
@click.option(
    "--suite",
    metavar="NAME|FILE",
    help="Map the logs of a suite, public or a TOML file, by each of its variants and seeds; LOGS are folders with "
    "them, or none: then public logs are downloaded (extra: datasets).",
)
@click.option("--parquet", is_flag=True, help="Write runs.parquet, too (extra: parquet).")
@click.option("--upload", type=UPLOAD, metavar="URL", help="Copy all results to this URL, too (extra: remote).")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object a line for each log, and no progress.")
def batch_command(**options: Any) -> int:  # noqa: ANN401
    """Map many logs, or run another command over them, each in a process of its own.

    LOGS are files, folders, URLs, patterns in quotes ('logs/**/*.bag') or manifests: CSV files with a column log and
    optionally name, reference and options of the command (seed, preset, ...), a line for each log.

    \b
      gridslam batch logs -o OUT --workers 4 --timeout 600 -- --preset fast
      gridslam batch logs -o OUT --command doctor

    Writes to OUT a folder for each log, with the files of the command and run.json, report.html, the page of all of
    them, and runs.sqlite with a row for each log. The same command again runs what is missing. Exit status: 1 if a log
    failed.
    """
    from gridslam.cli.batch import run_batch

    if not options["logs"] and options["suite"] is None:
        raise click.UsageError("Missing argument 'LOGS...'.", click.get_current_context())
    return run_batch(**options, words=click.get_current_context().meta["gridslam.batch"])


@gridslam.command("tune")
@click.argument("logs", nargs=-1, required=True)
@click.option(
    "-o",
    "--out",
    type=OUTPUT_FILE,
    required=True,
    metavar="BEST.toml",
    help="Configuration to use; details in BEST.tune.",
)
@click.option("--trials", type=click.IntRange(1, 100_000), metavar="N", help="Configurations to try.  [default: 60]")
@click.option("--budget", metavar="TIME", help="Wall time that it may take, as 90s, 15m or 1h, instead of --trials.")
@click.option(
    "--reference",
    metavar="PATTERN",
    help="File of relations (.relations) or true trajectory of each log, with {name}, {stem} or {parent}.  [default: "
    "NAME.relations, NAME.truth.tum or NAME.ref.tum beside it; where there is none its self-consistency is the score]",
)
@click.option("--held-out", multiple=True, metavar="LOG", help="Log that judges the best and is not searched on.")
@click.option("--split", type=Number(0, 0.9), metavar="SHARE", help="Hold out this share of LOGS, from the end.")
@click.option("--without-reference", is_flag=True, help="Score by self-consistency also where there is a reference.")
@click.option("--tune", "names", multiple=True, metavar="NAME", help="Parameter to search.  [default: all that are]")
@click.option(
    "--judging-seeds",
    type=click.IntRange(2, 1000),
    default=5,
    show_default=True,
    metavar="N",
    help="Seeds of the comparison between the best and the start.",
)
@click.option(
    "--workers", type=click.IntRange(1, 256), default=1, show_default=True, metavar="N", help="Logs mapped at a time."
)
@click.option("--timeout", "timeout_s", type=TIME_LIMIT, metavar="S", help="Time limit of one run, s.")
@map_options
@json_option
def tune_command(**options: Any) -> None:  # noqa: ANN401
    """Search parameters that suit LOGS better than those given by --preset, --config and --set.

    LOGS are what gridslam batch accepts. Many configurations are tried on parts of the logs, the better ones on longer
    parts (successive halving), and about the best one more are tried on whole logs (CMA-ES). The best is then compared
    with the start on held-out logs, or with other seeds. It is written only if it is better beyond the noise of seeds
    and logs; else the start is, and the exit status is 0 as well.

    \b
      gridslam tune logs/*.clf -o best.toml --budget 1h --split 0.3
      gridslam map log.clf -o out --config best.toml

    The same command again goes on where it was interrupted. Needs the extra: tune.
    """
    from gridslam.cli.tune import run_tune

    run_tune(**options)


_NODE_OPTIONS = (
    click.argument("arguments", nargs=-1, type=click.UNPROCESSED),
    click.option("--preset", help="Preset: default, fast, accurate or gmapping."),
    click.option("--particles", type=int, help="Number of particles."),
    click.option("--seed", type=SEED, help="Random seed; equal seeds and scans give equal results."),
    click.option("--threads", type=THREADS, help="Number of threads; does not affect the results."),
    click.option("--config", type=PATH, help="TOML file with parameters; overrides the preset."),
    assignment_option(help="Set one parameter (see map)."),
    click.option("--map", "map_file", type=PATH, help="Map YAML file; localize in this map instead of mapping."),
    click.option("-o", "--out", type=OUTPUT_FOLDER, help="Output folder of the node."),
    click.option(
        "--record", type=OUTPUT_FILE, metavar="FILE", help="Record the accepted scans to FILE for offline mapping."
    ),
    click.option("--save", type=OUTPUT_FILE, metavar="FILE", help="Save the session to this file at the end."),
    click.option("--continue", "continued", type=PATH, metavar="FILE", help="Go on from this session file."),
    click.option("--same-place", is_flag=True, help="The robot is where the session has ended."),
    click.option("--elsewhere", is_flag=True, help="The robot is elsewhere in the session's map, or beside it."),
    click.option(
        "--pose", "begin_pose", callback=read_pose, metavar="X,Y,THETA", help="About where in that map, m, rad."
    ),
    click.option(
        "--autosave",
        type=Number(0),
        metavar="MINUTES",
        help="Minutes between two saves to autosave.gridslam in OUT; 0: none.  [default: 5]",
    ),
)
_NODE_SETTINGS = {**SETTINGS, "ignore_unknown_options": True}


def node_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of a node to its command."""
    return add_options(robot_live_options(rerun_option(command)), _NODE_OPTIONS)


@gridslam.command("ros1", context_settings=_NODE_SETTINGS)
@node_options
def ros1_command(**options: Any) -> None:  # noqa: ANN401
    """Run the ROS 1 node, a drop-in replacement for slam_gmapping: subscribes to /scan and /tf, publishes /map.

    ARGUMENTS are ROS arguments: _name:=value sets a parameter, name:=other remaps a topic.
    """
    from gridslam.cli.ros import ros1

    ros1(**options)


@gridslam.command("ros2", context_settings=_NODE_SETTINGS)
@node_options
@click.option(
    "--transport",
    type=click.Choice(["auto", "rclpy", "dds"]),
    default="auto",
    show_default=True,
    help="rclpy of a sourced ROS 2, or DDS without any ROS.",
)
@click.option("--interface", "interfaces", multiple=True, help="Network interface of DDS; repeatable.")
def ros2_command(**options: Any) -> None:  # noqa: ANN401
    """Run the ROS 2 node: subscribes to /scan and /tf, publishes /map.

    ARGUMENTS are ROS arguments after --ros-args.
    """
    from gridslam.cli.ros import ros2

    ros2(**options)
