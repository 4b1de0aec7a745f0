"""Options that several commands share; importing this module is cheap, so that help is quick."""

from __future__ import annotations

import functools
import importlib
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar

import click

from gridslam.cli.option_types import OUT, OUTPUT_FILE, PATH, SECONDS, SEED, THREADS, Number
from gridslam.errors import ArgumentError

if TYPE_CHECKING:
    from gridslam.cli.session_options import SessionOptions
    from gridslam.config import Configuration
    from gridslam.io.log import LogOptions
    from gridslam.live.options import LiveOptions

_Command = TypeVar("_Command", bound=Callable[..., Any])


SETTINGS = {"help_option_names": ["-h", "--help"], "max_content_width": 100}

out_option = click.option("-o", "--out", type=OUT, required=True, help="Output folder; created if missing.")
seed_option = click.option(
    "--seed", type=SEED, default=0, show_default=True, help="Random seed; the same seed gives identical output files."
)
threads_option = click.option(
    "--threads", type=THREADS, default=1, show_default=True, help="Number of threads; does not affect the results."
)
assignment_option = functools.partial(click.option, "--set", "assignments", multiple=True, metavar="NAME=VALUE")
repair_option = functools.partial(
    click.option, "--repair", type=click.Choice(["needed", "none"]), default="needed", show_default=True
)
json_option = click.option(
    "--json", "as_json", is_flag=True, help="Print one JSON object instead of text, and no progress."
)
history_option = click.option("--no-history", is_flag=True, help="Do not record the past of the run for gridslam view.")

_LOG_OPTIONS = (
    click.option("--scan", "scan_topics", multiple=True, metavar="TOPIC", help="Topic of the scans; may be repeated."),
    click.option("--odom", "odometry_topic", metavar="TOPIC", help="Topic of the odometry."),
    click.option("--odom-frame", "odometry_frame", metavar="FRAME", help="Odometry frame; take the odometry from /tf."),
    click.option("--base-frame", metavar="FRAME", help="Base frame of the robot (REP-105 base_link)."),
    click.option("--no-odometry", is_flag=True, help="Ignore the odometry."),
    click.option("--keep-truncated", is_flag=True, help="Accept a truncated log and read the part that exists."),
    click.option(
        "--start", "start_s", type=SECONDS, default=0, metavar="S", help="Skip the first S seconds of the log."
    ),
    click.option("--duration", "duration_s", type=SECONDS, metavar="S", help="Read only S seconds."),
    click.option("--every", type=click.IntRange(min=1), default=1, metavar="N", help="Use only every N-th scan."),
)
_LOG_FIELDS = (
    "scan_topics",
    "odometry_topic",
    "odometry_frame",
    "base_frame",
    "no_odometry",
    "keep_truncated",
    "start_s",
    "duration_s",
    "every",
)
_LIVE_OPTION = click.option("--live", is_flag=True, help="Show the run live in the browser.")
_PAGE_OPTIONS = (
    click.option("--live-port", type=int, metavar="PORT", help="Port of the page; 0: any free one.  [default: 8642]"),
    click.option(
        "--live-host",
        metavar="HOST",
        help="Address of the page; any other than 127.0.0.1 opens it to the network.",
    ),
    click.option("--open", "live_opens", is_flag=True, help="Open the page in the default browser."),
)
_LIVE_NAMES = {
    "live_port": "--live-port",
    "live_host": "--live-host",
    "live_opens": "--open",
    "live_speed": "--live-speed",
}
_SPEED_OPTION = click.option(
    "--live-speed", type=Number(), metavar="FACTOR", help="Maximum speed, a factor on real time."
)


def calls(target: str) -> Callable[[Callable[[], None]], Callable[..., Any]]:
    """Decorate the help of a command whose code, "module:function" of `gridslam.cli`, is imported when it runs."""
    module, _, function = target.partition(":")

    def decorate(command: Callable[[], None]) -> Callable[..., Any]:
        @functools.wraps(command)
        def run(**options: Any) -> Any:  # noqa: ANN401
            return getattr(importlib.import_module(f"gridslam.cli.{module}"), function)(**options)

        return run

    return decorate


def _gather(
    command: _Command, options: Sequence[Callable[..., Any]], into: str, names: Sequence[str], make: Callable[..., Any]
) -> _Command:
    """Add options to a command, which gets those of these names as one argument, an object that `make` returns."""

    @functools.wraps(command)
    def wrapper(**given: Any) -> Any:  # noqa: ANN401
        gathered = make(**{name: given.pop(name) for name in names if name in given})
        return command(**{into: gathered}, **given)

    return add_options(wrapper, options)  # type: ignore[return-value]


def log_options(command: _Command) -> _Command:
    """Add the options that select the data of a log; a command receives them as ``options``: LogOptions."""
    return _gather(command, _LOG_OPTIONS, "options", _LOG_FIELDS, _make_log_options)


def to_words(options: LogOptions) -> list[str]:
    """Return the words of a command line that select the same data of a log."""
    words = []
    for option in click.command(log_options(lambda **given: None)).params:
        value = getattr(options, str(option.name))
        if value is True:
            words.append(option.opts[0])
        elif value is not False and value is not None:
            words += [f"{option.opts[0]}={one}" for one in (value if option.multiple else [value])]
    return words


def _make_log_options(**given: Any) -> LogOptions:  # noqa: ANN401
    from gridslam.io.log import LogOptions

    with name_option(start_s="--start", duration_s="--duration"):
        return LogOptions(**given)


def live_options(command: _Command) -> _Command:
    """Add --live and the options of its page to a command, which gets them as ``live``: LiveOptions, or None."""
    return _gather_live(command, _LIVE_OPTION, *_PAGE_OPTIONS, _SPEED_OPTION)


def robot_live_options(command: _Command) -> _Command:
    """Add the options of `live_options` without the speed, as no robot waits."""
    return _gather_live(command, _LIVE_OPTION, *_PAGE_OPTIONS)


def host_options(command: _Command) -> _Command:
    """Add the options of the page to a command that serves one anyway, and gets them as ``live``."""
    return _gather_live(command, *_PAGE_OPTIONS, _SPEED_OPTION)


def _gather_live(command: _Command, *options: Callable[..., Any]) -> _Command:
    return _gather(command, options, "live", ("live", *_LIVE_NAMES), _make_live_options)


def _make_live_options(*, live: bool = True, **given: Any) -> LiveOptions | None:  # noqa: ANN401
    from gridslam.live.options import LiveOptions

    chosen = {name: value for name, value in given.items() if value is not None and value is not False}
    if not live:
        for name in chosen:
            raise click.UsageError(f"{_LIVE_NAMES[name]} needs --live")
        return None
    fields = {name.removeprefix("live_"): value for name, value in chosen.items()}
    with name_option(port="--live-port", host="--live-host", speed="--live-speed"):
        return LiveOptions(**fields)


def read_pose(ctx: click.Context, param: click.Parameter, text: str | None) -> tuple[float, float, float] | None:
    """Read an option's pose, X,Y,THETA in m and rad; its default means that there is none."""
    if text is None or text == param.default:
        return None
    try:
        x, y, theta = (float(number) for number in text.split(","))
    except ValueError:
        x = y = theta = math.nan
    if not math.isfinite(x + y + theta):
        other = f" or {param.default}" if isinstance(param.default, str) else ""
        raise click.BadParameter(f"expected X,Y,THETA (m, rad){other}, got {text!r}", ctx, param)
    return x, y, theta


@contextmanager
def name_option(**options: str) -> Iterator[None]:
    """Report an invalid argument under the name of its option: `pose="--initial-pose"`."""
    try:
        yield
    except ArgumentError as error:
        if error.argument not in options:
            raise
        raise click.ClickException(str(error).replace(error.argument, options[error.argument], 1)) from None


def add_options(command: Callable[..., Any], options: Sequence[Callable[..., Any]]) -> Callable[..., Any]:
    """Decorate a command with options, which help lists in this order."""
    for option in reversed(options):
        command = option(command)
    return command


@dataclass(frozen=True)
class MapOptions:
    """The options that determine the result of `gridslam map`; `options` select the data of the log."""

    particles: int | None
    seed: int
    threads: int
    preset: str
    laser: str | None
    config: Path | None
    assignments: tuple[str, ...]
    no_loop_closure: bool
    repair: Literal["needed", "none"]
    options: LogOptions

    def configuration(self) -> Configuration:
        """Build the configuration; --particles and --no-loop-closure override preset, laser, file and assignments."""
        from gridslam.config import apply_laser, load, override, preset

        config = preset(self.preset, self.particles)
        config = config if self.laser is None else apply_laser(config, self.laser)
        if self.config is not None:
            config = load(self.config, config)
        if self.particles is not None:
            config = override(config, f"particles={self.particles}")
        config = override(config, *self.assignments)
        return replace(config, loop_closure=None) if self.no_loop_closure else config


def map_options(command: _Command) -> _Command:
    """Add the options that determine the result of `gridslam map`, which a command gets as ``given``: MapOptions."""
    return _gather(command, _MAP_OPTIONS, "given", [each.name for each in fields(MapOptions)], MapOptions)


def session_options(command: _Command) -> _Command:
    """Add the options of sessions to a command that maps, which gets them as ``session``: SessionOptions."""
    return _gather(command, _SESSION_OPTIONS, "session", _SESSION_FIELDS, _make_session_options)


def _make_session_options(**given: Any) -> SessionOptions:  # noqa: ANN401
    from gridslam.cli.session_options import SessionOptions

    options = SessionOptions(**given)
    options.check(click.get_current_context())
    return options


def localize_options(command: _Command) -> _Command:
    """Add the options that determine the result of `gridslam localize`."""
    return add_options(command, _LOCALIZE_OPTIONS)  # type: ignore[return-value]


_MAP_OPTIONS = (
    click.option("--particles", type=int, help="Greatest number of particles.  [default: the preset's, 30]"),
    seed_option,
    threads_option,
    click.option("--preset", default="default", show_default=True, help="Preset: default or gmapping."),
    click.option(
        "--laser", metavar="NAME", help="Laser model; sets range limits and cells (listed by gridslam map --help)."
    ),
    click.option("--config", type=PATH, help="TOML file with parameters; overrides the preset."),
    assignment_option(help="Set one parameter (listed by gridslam map --help)."),
    click.option("--no-loop-closure", is_flag=True, help="Disable loop closure."),
    repair_option(help="Faults to correct before mapping; needed: those that make any map unusable."),
    log_options,
)
_SESSION_OPTIONS = (
    click.option("--save", type=OUTPUT_FILE, metavar="FILE", help="Save the session to this file (NAME.gridslam)."),
    click.option("--continue", "continued", type=PATH, metavar="FILE", help="Continue a saved session."),
    click.option(
        "--same-place", is_flag=True, help="LOG begins where the session ended.  [default: decided by the data]"
    ),
    click.option("--elsewhere", is_flag=True, help="LOG begins elsewhere; relocalize the robot in the map."),
    click.option(
        "--pose",
        metavar="X,Y,THETA",
        callback=read_pose,
        help="About where LOG begins in the session's map (m, rad), within 5 m; searched for there alone.",
    ),
    click.option(
        "--frozen", is_flag=True, help="What the session has mapped stays where it is; LOG is aligned with it."
    ),
    click.option("--name", metavar="NAME", help="Name of the drive, such as the robot's.  [default: that of LOG]"),
)
_SESSION_FIELDS = ("save", "continued", "same_place", "elsewhere", "pose", "frozen", "name")
_LOCALIZE_OPTIONS = (
    click.option("--map", "map_path", type=PATH, required=True, help="Map YAML file (map_server or nav2)."),
    click.option(
        "--initial-pose",
        metavar="X,Y,THETA",
        callback=read_pose,
        default="global",
        show_default=True,
        help="Initial pose, m and rad; global: unknown.",
    ),
    seed_option,
    click.option("--particles", type=click.IntRange(min=1), help="Maximum number of particles.  [default: 20000]"),
    threads_option,
    click.option(
        "--preset",
        type=click.Choice(["default", "amcl", "nav2"]),
        default="default",
        show_default=True,
        help="Base parameters: gridslam's, or the AMCL defaults of ROS 1 or nav2.",
    ),
    click.option("--config", type=PATH, help="Parameter file of AMCL, nav2 or Beluga (YAML); overrides the preset."),
    assignment_option(help="Set one parameter, by its gridslam or AMCL name."),
    click.option(
        "--strict-thresholds", is_flag=True, help="Apply the map's thresholds literally, also to pixel value 205."
    ),
    repair_option(help="Faults corrected before the log is used, as in gridslam map."),
    log_options,
)
