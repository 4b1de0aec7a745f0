"""Named configurations: presets, and settings for known lasers from their data sheets."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Final, NamedTuple

from gridslam.checked import checked
from gridslam.config.configuration import Configuration
from gridslam.config.tables import replace_parameters, suggest_names
from gridslam.errors import ConfigurationError
from gridslam.matching.gauss_newton import GaussNewton
from gridslam.matching.hill_climbing import HillClimbing
from gridslam.models.endpoint import GMappingEndPoint
from gridslam.models.motion import GMappingMotion
from gridslam.parameters import Table
from gridslam.particles.policies import EffectiveSampleSizeBelow, MotionThreshold
from gridslam.slam.grid_fastslam.proposals import ScanMatchedProposal
from gridslam.tracking.tracker import OdometryTracker


def _gmapping() -> Configuration:
    """Decides as GMapping does with the defaults of its ROS node, but for its range, which is the laser's.

    The particles close loops, and nothing else does.
    """
    return Configuration(
        particles=30,
        particles_min=100_000,
        range_min_m=0.0,
        range_max_m=80.0,
        tracker=OdometryTracker(),
        motion=GMappingMotion(),
        sensor=GMappingEndPoint(),
        proposal=ScanMatchedProposal(matcher=HillClimbing()),
        when_to_update=MotionThreshold(1.0, 0.5),
        when_to_resample=EffectiveSampleSizeBelow(0.5),
        loop_closure=None,
    )


PRESETS: Final[Mapping[str, Callable[[], Configuration]]] = {
    "default": Configuration,
    "gmapping": _gmapping,
}


@checked
def preset(name: str, particles: int | None = None) -> Configuration:
    """Configuration of that name, with a number of particles or the preset's own.

    GMapping divides log weights by 3 for each particle, so in the preset `gmapping` the number decides that, too.

    Raises
    ------
    ConfigurationError
        There is no such preset, or the number is out of range.
    """
    if name not in PRESETS:
        raise ConfigurationError(f"preset: expected {', '.join(PRESETS)}, got {name!r}{suggest_names(name, PRESETS)}")
    config = PRESETS[name]()
    if particles is not None:
        config = replace_parameters(config, {"particles": particles})
    return (
        replace_parameters(config, {"sensor": {"likelihood_gain": 3.0 * config.particles}})
        if name == "gmapping"
        else config
    )


_FINE_CELL_M = 0.03
_FINE_CAUCHY_M = 0.05


class Laser(NamedTuple):
    """A laser by name.

    Attributes
    ----------
    description : str
        Which one it is, and its data sheet's figures.
    range_min_m, range_max_m : float
        Ranges outside are ignored, even within the log's limits: nearer ones hit the robot, farther ones are noise, or
        the driver's value where nothing returned. 30 m at most, as beyond it beams are wider than what they hit.
    fine : bool
        Its ranges are exact enough, and its beams dense enough, for cells of 3 cm and ends that belong to a wall 5 cm
        about it. In six simulated buildings the error of the trajectory fell by a fifth to a third, at 1.4 times the
        cost; with the noise of cheaper lasers it did not fall.
    """

    description: str
    range_min_m: float
    range_max_m: float
    fine: bool = False


LASERS: Final[Mapping[str, Laser]] = MappingProxyType(
    {
        # LMS 200 / 211 / 220 / 221 / 291 technical description: 361 readings of 0.5 or 181 of 1 degree, the mirror
        # turns 75 times a second; 81.91 m is the largest reading in units of 10 mm; statistical error 5 to 10 mm.
        "sick-lms": Laser("SICK LMS 200 or 291: 180 degrees, up to 80 m, 10 mm", 0.05, 30.0),
        # PLS technical description.
        "sick-pls": Laser("SICK PLS: 180 degrees, up to 50 m, noise of centimetres", 0.05, 30.0),
        # SCIP 2.0 specification C-42-03320B, answer to the command PP: DMIN 20 mm, DMAX 5600 mm, steps 44 to 725 of
        # 1024 a turn, 600 turns a minute.
        "hokuyo-urg-04lx": Laser("Hokuyo URG-04LX: 240 degrees, 0.02 to 5.6 m, 10 mm or 1 %", 0.02, 5.6, fine=True),
        # UTM-30LX-EW specification: accuracy 30 mm up to 10 m and 50 mm up to 30 m, 40 scans a second; SCIP 2.0
        # specification C-42-03320B: steps 0 to 1080 of 1440 a turn.
        "hokuyo-utm-30lx": Laser("Hokuyo UTM-30LX: 270 degrees, 0.1 to 30 m, 30 to 50 mm", 0.1, 30.0, fine=True),
        # RPLIDAR A1M8 data sheet, measurement performance: resolution below 0.5 mm up to 1.5 m and 1 % of the distance
        # beyond; 5.5 scans a second of 1 degree steps.
        "rplidar-a1": Laser("Slamtec RPLIDAR A1 (TurtleBot 4): 360 degrees, 0.15 to 12 m, 1 %", 0.15, 12.0),
        # RPLIDAR A2M8 data sheet, rev. 2.5: 12 m (8 m up to hardware revision 3); 10 scans a second of 0.45 degree
        # steps; triangulation as in the A1.
        "rplidar-a2": Laser("Slamtec RPLIDAR A2M8: 360 degrees, 0.15 to 12 m, 1 %", 0.15, 12.0),
        # LD19 data sheet, optical performance: 4500 ranges a second, 10 scans a second; from 0.3 m on a standard
        # deviation of 10 mm about a mean that is within 45 mm.
        "ld19": Laser("LDROBOT LD19: 360 degrees, 0.02 to 12 m, noise of 10 mm", 0.02, 12.0, fine=True),
        # X4 data sheet, performance parameters, and the maker's ROS 2 driver: 0.12 to 10 m, 5000 ranges a second,
        # triangulated.
        "ydlidar-x4": Laser("YDLIDAR X4: 360 degrees, 0.12 to 10 m, percents", 0.12, 10.0),
        # TurtleBot3 e-Manual, LDS-01: precision 3.5 % from 0.5 m on; 5 scans a second of 1 degree steps.
        "lds-01": Laser("LDS-01 (TurtleBot3 until 2021): 360 degrees, 0.12 to 3.5 m, 3.5 %", 0.12, 3.5),
        # TurtleBot3 e-Manual, LDS-02: accuracy 10 mm up to 0.3 m and 3 % up to 6 m, precision 5 % beyond; 5 scans a
        # second or more of 1 degree steps.
        "lds-02": Laser("LDS-02 (TurtleBot3 since 2022): 360 degrees, 0.16 to 8 m, 3 to 5 %", 0.16, 8.0),
    }
)
"""Lasers of which the maker's figures are known."""


@checked
def apply_laser(config: Configuration, name: str) -> Configuration:
    """Lay a laser's limits, and cells as fine as it deserves, over a configuration.

    Where scans are not matched by Gauss-Newton, as in the preset `gmapping`, only the limits.

    Raises
    ------
    ConfigurationError
        There is no such laser.
    """
    if name not in LASERS:
        raise ConfigurationError(f"laser: expected {', '.join(LASERS)}, got {name!r}{suggest_names(name, LASERS)}")
    laser = LASERS[name]
    changes: Table = {"range_min_m": laser.range_min_m, "range_max_m": laser.range_max_m}
    matchers = {part: getattr(getattr(config, part), "matcher", None) for part in ("tracker", "proposal")}
    matching = [part for part, matcher in matchers.items() if isinstance(matcher, GaussNewton)]
    if laser.fine and len(matching) == 2:
        changes["mapper"] = {"resolution_m": _FINE_CELL_M}
        changes |= {part: {"matcher": {"cauchy_m": _FINE_CAUCHY_M}} for part in matching}
    return replace_parameters(config, changes)
