"""gridslam batch and tune: options and help."""

from __future__ import annotations

from typing import Any

import click

from gridslam.cli.option_types import OUTPUT_FILE, OUTPUT_FOLDER, TIME_LIMIT
from gridslam.cli.options import json_option, map_options


class _BatchCommand(click.Command):
    """Command that passes the arguments after ``--`` to the command that it runs."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse the arguments before ``--``."""
        at = args.index("--") if "--" in args else len(args)
        ctx.meta["gridslam.batch"] = args[at + 1 :]
        return super().parse_args(ctx, args[:at])

    def format_usage(self, context: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the usage."""
        formatter.write_usage(context.command_path, "LOGS... -o OUT [OPTIONS] [-- OPTIONS OF THE COMMAND]")


@click.command("batch", cls=_BatchCommand)
@click.argument("logs", nargs=-1, required=True)
@click.option("-o", "--out", type=OUTPUT_FOLDER, required=True, help="Output folder; created if missing.")
@click.option(
    "--command",
    type=click.Choice(["map", "doctor", "localize"]),
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
@click.option("--timeout", "timeout_s", type=TIME_LIMIT, metavar="S", help="Time limit for a log, s.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object a line for each log, and no progress.")
def batch_command(**options: Any) -> int:  # noqa: ANN401
    """Map many logs, or run another command over them, each in a process of its own.

    LOGS are files, folders, patterns in quotes ('logs/**/*.bag') or manifests: CSV files with a column log and
    optionally name, reference and options of the command (seed, preset, ...), a line for each log.

    \b
      gridslam batch logs -o OUT --workers 4 --timeout 600 -- --particles 15
      gridslam batch logs -o OUT --command doctor

    Writes to OUT a folder for each log, with the files of the command and run.json, and runs.sqlite with a row for each
    log. The same command again runs what is missing, and what failed. Exit status: 1 if a log failed.
    """
    from gridslam.cli.batch import run_batch

    return run_batch(**options, words=click.get_current_context().meta["gridslam.batch"])


@click.command("tune")
@click.argument("logs", nargs=-1, required=True)
@click.option(
    "-o",
    "--out",
    type=OUTPUT_FILE,
    required=True,
    metavar="BEST.toml",
    help="Configuration to use; details in BEST.tune.",
)
@click.option(
    "--trials",
    type=click.IntRange(1, 100_000),
    default=60,
    show_default=True,
    metavar="N",
    help="Configurations to try.",
)
@click.option(
    "--reference",
    metavar="PATTERN",
    help="File of relations (.relations) or true trajectory of each log, with {name}, {stem} or {parent}.  [default: "
    "NAME.relations, NAME.truth.tum or NAME.ref.tum beside it; where there is none its self-consistency is the score]",
)
@click.option("--held-out", multiple=True, metavar="LOG", help="Log that judges the best and is not searched on.")
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

    LOGS are what gridslam batch accepts. Configurations that Optuna proposes are tried on them. The best is then
    compared with the start on held-out logs, or with other seeds. It is written only if it is better beyond the noise
    of seeds and logs; else the start is, and the exit status is 0 as well.

    \b
      gridslam tune logs/*.clf -o best.toml --trials 30 --held-out other.clf
      gridslam map log.clf -o out --config best.toml

    The same command again continues an interrupted search. Needs the extra: tune.
    """
    from gridslam.cli.tune import TuneOptions, run_tune

    shared = {name: options.pop(name) for name in ("logs", "out", "given", "as_json")}
    run_tune(**shared, tune=TuneOptions(**options))
