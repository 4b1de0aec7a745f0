"""All parameters of a run in one tree, TOML in and out, and the filter that is built from them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Final, Literal, NamedTuple, final

from gridslam.checked import checked
from gridslam.config.tables import nest, parse_toml, read_assignments, replace_parameters
from gridslam.errors import ConfigurationError
from gridslam.kernels import MOST_BEAM_CELLS
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.models.beam import BeamRangeFinder
from gridslam.models.endpoint import CauchyEndPoint, GMappingEndPoint, LikelihoodField
from gridslam.models.motion import DiffusionMotion, GMappingMotion, OdometryMotion
from gridslam.parameters import Kind, bounded, parameters, to_table
from gridslam.particles.policies import AlwaysResample, EffectiveSampleSizeBelow, MotionThreshold, NeverResample
from gridslam.particles.resampling import Multinomial, ResamplingWheel, Residual, Stratified, Systematic
from gridslam.scan import Thinning
from gridslam.slam.grid_fastslam.grid_fastslam import GridFastSlam
from gridslam.slam.grid_fastslam.map_limit import MapLimit
from gridslam.slam.grid_fastslam.proposals import ImprovedProposal, MotionModelProposal, ScanMatchedProposal
from gridslam.slam.grid_fastslam.report_builder import ReportBuilder
from gridslam.slam.loop_closure.loop_closure import LoopClosure
from gridslam.tracking.tracker import OdometryTracker, Tracker
from gridslam.types import Resampler


@final
class Search(NamedTuple):
    """Where `gridslam tune` looks for a parameter: from `low` to `high`, evenly in its logarithm or in itself.

    Values outside are valid, but no log is known on which they would be better.
    """

    low: float
    high: float
    log: bool = True


@final
class Parameter(NamedTuple):
    """A parameter for users: its dotted name, its description, and the range in which it is tuned, or None."""

    path: str
    description: str
    search: Search | None = None


_SWITCH = Search(0, 1, log=False)

PARAMETERS: Final[Mapping[str, Parameter]] = {
    # Not tuned: more particles are never worse, and cost in proportion.
    "particles": Parameter("particles", "greatest number of particles"),
    "resolution_m": Parameter("mapper.resolution_m", "map resolution, m per cell", Search(0.025, 0.15)),
    # Not tuned: a matter of the robot.
    "range_min_m": Parameter("range_min_m", "shorter beams are ignored: they hit the robot itself"),
    "range_max_m": Parameter("range_max_m", "beams of this range or more are ignored", Search(5.0, 80.0)),
    "key_scan_m": Parameter("when_to_update.translation_m", "distance between key scans", Search(0.1, 2.0)),
    "key_scan_rad": Parameter("when_to_update.rotation_rad", "... or after this much rotation", Search(0.1, 1.0)),
    "insert_m": Parameter(
        "tracker.insert_m",
        "distance between the scans that the tracker inserts into its local map",
        Search(0.05, 1.0),
    ),
    "insert_rad": Parameter("tracker.insert_rad", "... or after this much rotation", Search(0.03, 0.5)),
    "beam_sigma_m": Parameter(
        "tracker.beam_sigma_m",
        "standard deviation of a beam; larger values favour the odometry",
        Search(0.0005, 0.02),
    ),
    "noise_m": Parameter(
        "motion.sigma_xy_m", "standard deviation of the position per sqrt metre of tracked motion", Search(0.003, 0.2)
    ),
    "noise_rad": Parameter("motion.sigma_theta_rad", "... and of the heading", Search(0.002, 0.1)),
    "tempering": Parameter(
        "sensor.tempering",
        "exponent of the likelihood (0 to 1); accounts for correlated beams",
        Search(0.003, 0.3),
    ),
    "resample_below": Parameter(
        "when_to_resample.fraction",
        "resample if N_eff falls below this fraction of the particles",
        Search(0.1, 0.9, log=False),
    ),
    # Not tuned: it changes what is reported, and no pose.
    "lost_below": Parameter("reports.lost_below", "inlier ratio with the map below which the robot is lost"),
    "loop_closure": Parameter(
        "loop_closure", "detect loop closures and correct the trajectory; false: filter only", _SWITCH
    ),
}
"""The parameters that face the user, by their short names."""

_LARGEST_TEXT: Final = 1 << 20  # characters
_RESAMPLERS: Final[Mapping[str, type[Resampler]]] = {
    "systematic": Systematic,
    "stratified": Stratified,
    "residual": Residual,
    "multinomial": Multinomial,
    "wheel": ResamplingWheel,
}


@final
@parameters(frozen=True)
class Configuration:
    """All parameters of a run; those of a part are explained at its class.

    Parameters
    ----------
    particles : int, [1, 100000]
        Greatest number of particles; 30 hold the loops of an office floor, and each costs 50 to 100 us a key scan.
    particles_min : int, [1, 100000]
        Least number of particles, where all agree on where the robot is within half a metre and ten degrees; if it is
        not below `particles`, their number is fixed. With 8 dense real logs come out as with 30 all the time; where
        scans are far apart, there are always `particles`.
    range_min_m, range_max_m : float, m
        Beams outside are not used (see `GridFastSlam`). At most 21,000 cells, 1050 m in cells of 5 cm; but a beam frees
        1664 cells at most, 83 m, so longer ones call for larger cells.
    thinning : Thinning
        How many beams of a dense scan are used.
    resampler : str
        "systematic" (the least variance), "stratified", "residual", "multinomial" or "wheel".
    tracker, motion, sensor, proposal, mapper, when_to_update, when_to_resample, map_limit, reports
        The parts of `GridFastSlam`.
    loop_closure : LoopClosure or None
        How loop closures are detected and the trajectory is corrected while the robot drives; None for the filter only.
    """

    particles: int = bounded(30, ge=1, le=100_000)
    particles_min: int = bounded(8, ge=1, le=100_000)
    range_min_m: float = bounded(0.05, ge=0, le=1e4)
    range_max_m: float = bounded(30.0, ge=1e-6, le=1e4)
    thinning: Thinning = Thinning()
    resampler: Literal["systematic", "stratified", "residual", "multinomial", "wheel"] = "systematic"
    tracker: Annotated[Tracker | OdometryTracker, Kind()] = Tracker()
    motion: Annotated[DiffusionMotion | OdometryMotion | GMappingMotion, Kind()] = DiffusionMotion()
    sensor: Annotated[CauchyEndPoint | GMappingEndPoint | LikelihoodField | BeamRangeFinder, Kind()] = CauchyEndPoint()
    proposal: Annotated[ScanMatchedProposal | MotionModelProposal | ImprovedProposal, Kind()] = ScanMatchedProposal()
    mapper: OccupancyGridMapping = OccupancyGridMapping()
    when_to_update: MotionThreshold = MotionThreshold()
    when_to_resample: Annotated[EffectiveSampleSizeBelow | AlwaysResample | NeverResample, Kind()] = (
        EffectiveSampleSizeBelow()
    )
    map_limit: MapLimit = MapLimit()
    reports: ReportBuilder = ReportBuilder()
    loop_closure: Annotated[LoopClosure | None, Kind()] = LoopClosure()

    def __post_init__(self) -> None:
        """Refuse parameters that do not go together."""
        cell_m = self.mapper.resolution_m
        if not self.range_max_m <= MOST_BEAM_CELLS * cell_m:
            expected = f"at most {MOST_BEAM_CELLS * cell_m:g} m, {MOST_BEAM_CELLS} cells of {cell_m:g} m"
            raise ValueError(f"range_max_m: expected {expected}, got {self.range_max_m:g}")


@checked
def build(config: Configuration, threads: int = 1) -> GridFastSlam:
    """Assemble the filter; `threads` is not a parameter, since it does not affect the results."""
    return GridFastSlam(
        tracker=config.tracker,
        motion=config.motion,
        sensor=config.sensor,
        proposal=config.proposal,
        mapper=config.mapper,
        resampler=_RESAMPLERS[config.resampler](),
        when_to_update=config.when_to_update,
        when_to_resample=config.when_to_resample,
        map_limit=config.map_limit,
        reports=config.reports,
        loop_closure=config.loop_closure,
        range_min_m=config.range_min_m,
        range_max_m=config.range_max_m,
        thinning=config.thinning,
        particles=config.particles,
        particles_min=config.particles_min,
        threads=threads,
    )


@checked
def dumps(config: Configuration) -> str:
    """TOML text from which `loads` gives an equal configuration."""
    import tomli_w  # only who writes TOML pays for its import

    return tomli_w.dumps(to_table(config))


@checked
def loads(text: str, base: Configuration | None = None, *, ignore_unknown: bool = False) -> Configuration:
    """Read TOML; parameters that it does not contain stay as in `base`, or at the defaults.

    With `ignore_unknown` parameters of earlier versions that are constants now are left out.

    Raises
    ------
    ConfigurationError
        The text is no TOML, or a parameter is unknown, of a wrong type or out of range.
    """
    return replace_parameters(base or Configuration(), parse_toml(text), ignore_unknown=ignore_unknown)


@checked
def load(path: str | Path, base: Configuration | None = None) -> Configuration:
    """Read a TOML file as `loads` does; errors name the file, and one that cannot be read is a ConfigurationError."""
    try:
        with Path(path).open(encoding="utf-8") as file:
            text = file.read(_LARGEST_TEXT + 1)
        if len(text) > _LARGEST_TEXT:
            raise ConfigurationError(f"expected TOML of at most {_LARGEST_TEXT} characters, got more")
        return loads(text, base)
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise ConfigurationError(f"{path}: expected a text file, got binary data") from None
    except ConfigurationError as error:
        raise ConfigurationError(f"{path}: {error}") from None


@checked
def override(config: Configuration, *assignments: str) -> Configuration:
    """Change parameters by ``name=value``, names short (see `PARAMETERS`) or dotted; checked when all are made.

    Raises
    ------
    ConfigurationError
        An assignment is malformed, or a parameter is unknown, of a wrong type or out of range.
    """
    values = read_assignments(assignments)
    return replace_parameters(
        config,
        nest({PARAMETERS[name].path if name in PARAMETERS else name: value for name, value in values.items()}),
        PARAMETERS,
    )
