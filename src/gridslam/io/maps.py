"""Maps as ROS's map_server reads and writes them: an image, and a small YAML file that describes it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path, PureWindowsPath
from typing import TYPE_CHECKING, Any, TypeAlias, final

import numpy as np
from numpy.typing import NDArray

from gridslam.checked import checked
from gridslam.errors import ArgumentError, InputError
from gridslam.geometry import se2
from gridslam.io.images import open_image
from gridslam.io.limits import require_memory
from gridslam.io.text import read_text, refuse_unreadable
from gridslam.io.turned_maps import count_turned_cells, turn_cells
from gridslam.io.yaml import parse_yaml
from gridslam.types import GridRows, OccupancyGrid

if TYPE_CHECKING:
    from PIL.Image import Image

OCCUPIED_THRESH = 0.65
FREE_THRESH = 0.196

_OCCUPIED = 0  # what map savers write in trinary mode
_FREE = 254
_UNKNOWN = 205
_BAND = 64  # rows turned to pixels, or back, at a time
_BYTES_PER_PIXEL = 8  # of a map as it is read, beside the image as Pillow has it
_LARGEST_YAML_BYTES = 1 << 16
_EVEN = 50  # percent
_MOST_OCCUPIED = 2.0  # cells for each free one, from which on black may mean free
_SURE = 0.98  # an image represents probabilities 0.01 to 0.99, so that log-odds stay finite
_REQUIRED = ("image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh")
_MODES = ("trinary", "scale", "raw")
_FARTHEST_CELL = 1 << 30  # rows and columns of cells are numbers of 32 bits
_FINEST_M = 0.001  # what lies outside is another unit, or a slip
_COARSEST_M = 10.0
_USUAL_M = 1.0  # at most, of maps of buildings
_TRUE, _FALSE = ("1", "true", "yes", "on"), ("0", "false", "no", "off")
_TINY_YAW_RAD = 1e-3  # half a cell of 5 cm in 25 m
_ROUNDED_RAD = 1e-9  # less comes of arithmetic
_NO_NUMBERS = ("nan", "+nan", "-nan", ".nan", "null", "~", "nan(ind)", "-nan(ind)", "1.#qnan", "-1.#ind")
"""Spellings of no number in YAML, Python and C, those of Microsoft included."""
_Fields: TypeAlias = Mapping[str, tuple[Any, int]]


@final
@dataclass(frozen=True, slots=True)
class MapDescription:
    """Content of map.yaml.

    Attributes
    ----------
    image : str
        Path of the image, relative to the YAML file. One that is not there is replaced by the file of the same name
        beside the YAML file, if there is one.
    resolution_m : float
        Side of a cell.
    origin : (float, float), m
        Lower left corner of the map.
    negate : bool
        Whether white is occupied.
    occupied_thresh, free_thresh : float
        Probabilities above and below which a pixel is occupied and free.
    mode : str
        "trinary", "scale" or "raw".
    remarks : tuple of str
        What was made of odd values, a sentence each.
    yaw_rad : float, rad
        By how much the map is turned to the left about its lower left corner.
    """

    image: str
    resolution_m: float
    origin: tuple[float, float]
    negate: bool = False
    occupied_thresh: float = OCCUPIED_THRESH
    free_thresh: float = FREE_THRESH
    mode: str = "trinary"
    remarks: tuple[str, ...] = ()
    yaw_rad: float = 0.0

    def to_yaml(self) -> str:
        """Return text of the YAML file."""
        plain = self.image.replace(".", "").replace("_", "").replace("-", "").isalnum()
        name = self.image if plain else "'" + self.image.replace("'", "''") + "'"
        return (
            f"image: {name}\nmode: {self.mode}\nresolution: {self.resolution_m!r}\n"
            f"origin: [{self.origin[0]!r}, {self.origin[1]!r}, {self.yaw_rad!r}]\nnegate: {int(self.negate)}\n"
            f"occupied_thresh: {self.occupied_thresh!r}\nfree_thresh: {self.free_thresh!r}\n"
        )


@final
@dataclass(frozen=True, slots=True, eq=False)
class MapImage:
    """A grey image.

    Attributes
    ----------
    brightness : (H, W) uint8 or float64
        0 black to 255 white; uint8 where a pixel has 8 bits. The first row is the top one.
    opaque : (H, W) bool
        Which pixels are not transparent in the least.
    """

    brightness: NDArray[np.uint8] | NDArray[np.float64]
    opaque: NDArray[np.bool_]


@checked
def write_map(
    yaml_path: str | Path, grid: GridRows, pose: NDArray[np.float64] | None = None, scale: float = 1.0
) -> None:
    """Write a map in trinary form: occupied above probability 0.65, free below 0.196, unknown otherwise.

    The image has its first row at the top, where y is largest. free_thresh lies below the 0.19608 that the pixel 205
    means, so that unknown stays unknown for every reader.

    Parameters
    ----------
    yaml_path : str or Path
        The file to write; its image is a binary PGM of the same name beside it.
    grid : OccupancyGrid, or another that gives rows
        The map, at least one cell.
    pose : (3,) float64, m and rad, optional
        Of the map's frame in the one that the file is for: its origin is rotated.
    scale : float
        Length in that frame of 1 m of the map.
    """
    height, width = grid.shape
    if height == 0 or width == 0:
        raise ArgumentError("grid", "at least one cell", grid.shape)
    image_path = Path(yaml_path).with_suffix(".pgm")
    with image_path.open("wb") as file:
        file.write(f"P5\n{width} {height}\n255\n".encode())
        for top in range(height, 0, -_BAND):
            file.write(map_pixels(grid.rows(max(top - _BAND, 0), top))[::-1].tobytes())
    corner = scale * np.array(grid.origin, np.float64)
    x, y = (corner if pose is None else se2.transform_points(pose, corner[None])[0]).tolist()
    yaw = 0.0 if pose is None else float(pose[2])
    description = MapDescription(image_path.name, scale * float(grid.resolution_m), (x, y), yaw_rad=yaw)
    Path(yaml_path).write_text(description.to_yaml(), encoding="utf-8")


def map_pixels(grid: OccupancyGrid) -> NDArray[np.uint8]:
    """Return pixels (H, W) of a trinary map: 0 occupied, 254 free, 205 unknown; the first row is the lowest one."""
    pixels = np.full(grid.shape, _UNKNOWN, dtype=np.uint8)
    pixels[grid.known & (grid.log_odds > _log_odds(OCCUPIED_THRESH))] = _OCCUPIED
    pixels[grid.known & (grid.log_odds < _log_odds(FREE_THRESH))] = _FREE
    return pixels


@checked
def read_map(
    yaml_path: str | Path, *, strict_thresholds: bool = False, on_remark: Callable[[str], None] = lambda remark: None
) -> OccupancyGrid:
    """Read a map as map_server and nav2 do, modes trinary, scale and raw (`occupancy_percent` has the rules).

    Occupied cells get probability 0.99, free ones 0.01, and percentages between get probabilities between. A map
    that is turned is sampled along the axes (see `turn_cells`), with a remark.

    Parameters
    ----------
    yaml_path : str or Path
        The YAML file; its image is named relative to it.
    strict_thresholds : bool
        Apply the thresholds literally. Otherwise the pixel 205 of a trinary map that is not negated is unknown for any
        free_thresh: every map saver writes it for unknown, and a free_thresh of 0.25, as nav2's saver writes it, would
        turn all unobserved cells into free space. If it would, a remark is issued.
    on_remark : callable
        Gets what is odd about the file, and what was made of it: a remark of one sentence each.

    Raises
    ------
    InputError
        The YAML file or the image cannot be read, a value is missing or out of range, or the image is not grey.
    """
    description = read_map_description(yaml_path)
    for remark in description.remarks:
        on_remark(remark)
    image = read_map_image(Path(yaml_path).parent / description.image)
    percent = occupancy_percent(image, description, strict_thresholds=strict_thresholds)
    origin = description.origin
    if description.yaw_rad:
        cells = count_turned_cells(percent.shape, description.yaw_rad)
        what = f"the map of {percent.shape[1]} x {percent.shape[0]} cells, turned by {description.yaw_rad:g} rad,"
        require_memory(yaml_path, what, cells * _BYTES_PER_PIXEL)
        percent, origin = turn_cells(percent, description.resolution_m, origin, description.yaw_rad, -1)
    _remark_on(percent, on_remark)
    grid = grid_of_percent(percent, description.resolution_m, origin)
    spared = 0 if strict_thresholds else int(unknown_read_as_free(image, description).sum())
    if spared:
        on_remark(
            f"free_thresh {description.free_thresh:g} makes the pixel 205 free, by which map savers mean unknown: "
            f"its {spared} cells are taken as unknown (--strict-thresholds reads literally)"
        )
    return grid


def grid_of_percent(percent: NDArray[np.int8], resolution_m: float, origin: tuple[float, float]) -> OccupancyGrid:
    """Return the map of occupancies 0 to 100 %, probabilities of 0.01 to 0.99; -1 is unknown."""
    probability = (1 - _SURE) / 2 + _SURE * np.arange(101) / 100.0
    log_odds = np.append(np.log(probability / (1 - probability)), 0.0).astype(np.float32)  # the last: of -1, unknown
    return OccupancyGrid(log_odds[percent], percent >= 0, resolution_m, origin)


def _remark_on(percent: NDArray[np.int8], on_remark: Callable[[str], None]) -> None:
    """Remark on a map without known cells, or with black and white probably exchanged."""
    occupied, free = int((percent > _EVEN).sum()), int(((percent >= 0) & (percent < _EVEN)).sum())
    if not occupied and not free:
        on_remark("no cell is known: all pixels are transparent, or between the thresholds")
    elif occupied > _MOST_OCCUPIED * free:
        on_remark(f"{occupied} cells are occupied and {free} are free: negate, or the mode, may be wrong")


def read_map_description(path: str | Path) -> MapDescription:
    """Read a map's YAML file; keys that map_server does not know are left out, as there.

    Raises
    ------
    InputError
        With the line, where a value is not what its key needs or the file is no YAML; where a key is missing.
    """
    fields = _read_fields(path)
    missing = [key for key in _REQUIRED if key not in fields]
    if missing:
        raise InputError(path, f"expected the keys {', '.join(_REQUIRED)}, got none named {', '.join(missing)}")
    image, line = fields["image"]
    if not isinstance(image, str):
        raise InputError(path, f"expected the name of an image, got {image!r}", line)
    remarks: list[str] = []
    image = _find_image(Path(path), image, line, remarks)
    resolution = _finite(path, "resolution", *fields["resolution"])
    if not _FINEST_M <= resolution <= _COARSEST_M:
        problem = f"expected a resolution from {_FINEST_M:g} to {_COARSEST_M:g} m, got {resolution:g}"
        raise InputError(path, problem, fields["resolution"][1])
    if resolution > _USUAL_M:
        remarks.append(f"the cells have sides of {resolution:g} m: the resolution may be in centimetres")
    low = _finite(path, "free_thresh", *fields["free_thresh"])
    high = _finite(path, "occupied_thresh", *fields["occupied_thresh"])
    if not 0 <= low < high <= 1:
        problem = f"expected 0 <= free_thresh < occupied_thresh <= 1, got {low:g} and {high:g}"
        raise InputError(path, problem, fields["free_thresh"][1])
    mode, line = fields.get("mode", ("trinary", 0))
    if str(mode).lower() not in _MODES:
        raise InputError(path, f"expected the mode {', '.join(_MODES)}, got {mode!r}", line)
    negate, line = fields["negate"]
    if str(negate).lower() not in (*_FALSE, *_TRUE):
        raise InputError(path, f"expected negate 0 or 1, got {negate!r}", line)
    origin, line = fields["origin"]
    if not (isinstance(origin, list) and len(origin) == 3):
        raise InputError(path, f"expected origin: [x, y, yaw], got {origin!r}", line)
    x, y = (_finite(path, "origin", word, line) for word in origin[:2])
    yaw = _read_yaw(path, origin[2], line, remarks)
    if not max(abs(x), abs(y)) <= _FARTHEST_CELL * resolution:
        problem = f"expected an origin within {_FARTHEST_CELL * resolution:g} m (2^30 cells) of 0, got [{x:g}, {y:g}]"
        raise InputError(path, problem, line)
    negated = negate.lower() in _TRUE
    return MapDescription(image, resolution, (x, y), negated, high, low, mode.lower(), tuple(remarks), yaw)


def _find_image(path: Path, name: str, line: int, remarks: list[str]) -> str:
    """Return the image as it is named; where it is not there, the one of its name beside the YAML file, with a remark.

    Maps are often moved with an absolute path, one of Windows or one from the home folder in them.
    """
    beside = PureWindowsPath(name).name  # which knows both separators
    try:
        if (path.parent / name).exists():
            return name
        if not path.with_name(beside).is_file():
            raise InputError(path, f"the image {name} is not there, nor {beside} beside this file", line)
    except (OSError, ValueError):  # no name that a file can have
        return name
    remarks.append(f"the image {name} is not there: {beside} beside the YAML file is read")
    return beside


def _read_yaw(path: str | Path, word: str, line: int, remarks: list[str]) -> float:
    """The yaw, with a remark where there is one; 0 for one that is no number, or turns no map visibly."""
    is_number = word.lower() not in _NO_NUMBERS
    yaw = _finite(path, "origin", word, line) if is_number else 0.0
    if abs(yaw) > math.tau + _TINY_YAW_RAD:
        raise InputError(path, f"expected the yaw of the origin in rad, got {yaw:g}: it looks like degrees", line)
    yaw = math.remainder(yaw, math.tau)
    if abs(yaw) > _TINY_YAW_RAD:
        remarks.append(f"the map is turned by {math.degrees(yaw):.4g} degrees about its corner, as its origin states")
        return yaw
    if abs(yaw) > _ROUNDED_RAD or not is_number:
        remarks.append(f"the yaw {word} of the origin is taken as 0")
    return 0.0


def _read_fields(path: str | Path) -> _Fields:
    """Return text of each key's value as it stands there, or texts of a list; and the line."""
    with refuse_unreadable(path, "'key: value' in YAML"):
        text = read_text(path, _LARGEST_YAML_BYTES).replace("\t", " ")  # which PyYAML refuses between key and value
        tree = parse_yaml(text, as_nodes=True)
    if getattr(tree, "id", None) != "mapping":
        raise InputError(path, "expected 'key: value' in each line, got none")
    fields: dict[str, tuple[Any, int]] = {}
    for key, value in tree.value:
        line = key.start_mark.line + 1
        items = value.value if value.id == "sequence" else [value]
        if key.id == "scalar" and key.value not in (*_REQUIRED, "mode"):
            continue
        if any(node.id != "scalar" for node in (key, *items)):
            raise InputError(
                path, "expected a text, a number or a list of numbers for each key, got another value", line
            )
        if key.value in fields:
            raise InputError(path, f"expected each key once, got {key.value} again", line)
        fields[key.value] = [item.value for item in items] if value.id == "sequence" else value.value, line
    return fields


def _finite(path: str | Path, key: str, text: Any, line: int) -> float:  # noqa: ANN401
    try:
        number = float(text)
    except (TypeError, ValueError):
        number = math.nan
    if not math.isfinite(number):
        raise InputError(path, f"expected a number for {key}, got {text!r}", line)
    return number


def read_map_image(path: str | Path) -> MapImage:
    """Read an image of any of `gridslam.io.images.FORMATS`, PGM and PNG among them.

    Raises
    ------
    InputError
        There is no such file, it is no image, one with colours, or larger than `open_image` allows.
    """
    brightness: NDArray[Any] | None = None
    coloured = 0
    with open_image(path, _BYTES_PER_PIXEL) as image:
        width, height = image.size
        transparent = "A" in image.getbands() or "transparency" in image.info
        opaque = np.ones((height, width), np.bool_)
        for top in range(0, height, _BAND):
            band = image.crop((0, top, width, min(top + _BAND, height)))
            band.info = image.info
            if transparent:
                opaque[top : top + _BAND] = np.asarray(band.convert("RGBA"))[:, :, 3] == 255
            grey, colours = _brightness(band)
            coloured += colours
            if brightness is None:
                brightness = np.empty((height, width), grey.dtype)
            brightness[top : top + _BAND] = grey
    if coloured:
        raise InputError(path, f"expected a grey image, got colours in {coloured} of {width * height} pixels")
    if brightness is None:
        raise InputError(path, "expected an image with pixels, got one without")
    return MapImage(brightness, opaque)


def _brightness(image: Image) -> tuple[NDArray[Any], int]:
    """Return brightness (H, W) from 0 to 255, and in how many pixels there are colours."""
    if image.mode == "I" or image.mode.startswith("I;16"):  # Pillow would cut 16 bits off at 255
        return np.asarray(image).astype(np.float64) / 257, 0
    if image.mode in ("1", "L", "LA"):
        return np.asarray(image.convert("L")), 0
    red, green, blue = (np.asarray(band) for band in image.convert("RGB").split())
    return red, int(((red != green) | (green != blue)).sum())


def occupancy_percent(
    image: MapImage, description: MapDescription, *, strict_thresholds: bool = False
) -> NDArray[np.int8]:
    """Return how occupied each cell is (H, W), 0 to 100, and -1 where that is unknown: the data of a ROS OccupancyGrid.

    The first row is the lowest one. The rules are those of map_server and nav2:

    - trinary: occupied (100) where a pixel is darker than occupied_thresh, free (0) where it is less dark than
      free_thresh, else unknown. The pixel 205 is unknown for any free_thresh, unless `strict_thresholds`.
    - scale: between the thresholds the percentage rises linearly, and nothing opaque is unknown.
    - raw: the pixel is the percentage, unknown above 100, for any negate and thresholds.

    A transparent pixel is unknown, but for raw.
    """
    percent = np.empty(image.opaque.shape, np.int8)
    for top in range(0, len(percent), _BAND):
        rows = slice(top, top + _BAND)
        band = MapImage(image.brightness[rows], image.opaque[rows])
        percent[rows] = _band_percent(band, description, strict_thresholds)
    return percent[::-1]


def _band_percent(image: MapImage, description: MapDescription, strict_thresholds: bool) -> NDArray[np.float64]:
    """`occupancy_percent` of some rows, the first row on top."""
    if description.mode == "raw":
        percent = np.rint(image.brightness)
        return np.where(percent <= 100, percent, -1)
    brightness = image.brightness.astype(np.float64)
    darkness = (brightness if description.negate else 255 - brightness) / 255  # 1 as an occupied one
    low = description.free_thresh
    high = description.occupied_thresh
    between = -1.0 if description.mode == "trinary" else np.rint(100 * (darkness - low) / (high - low))
    percent = np.where(darkness > high, 100, np.where(darkness < low, 0, between))
    if not strict_thresholds:
        percent[unknown_read_as_free(image, description)] = -1
    percent[~image.opaque] = -1
    return percent


def unknown_read_as_free(image: MapImage, description: MapDescription) -> NDArray[np.bool_]:
    """Return which pixels (H, W) savers write for unknown, but the file's thresholds, read literally, make free."""
    is_read_as_free = description.free_thresh > (255 - _UNKNOWN) / 255
    if description.mode == "trinary" and not description.negate and is_read_as_free:
        return np.asarray(image.opaque & (image.brightness == _UNKNOWN))
    return np.zeros(image.opaque.shape, np.bool_)


def _log_odds(probability: float) -> float:
    return math.log(probability / (1 - probability))
