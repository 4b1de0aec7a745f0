"""Maps with their edits, walls drawn and areas erased, which follow the map when its trajectory is corrected."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TypeAlias, final

import numpy as np
from numpy.typing import NDArray

from gridslam.errors import InputError
from gridslam.geometry import se2
from gridslam.io.edits import Edit, Edits, read_edits
from gridslam.io.maps import read_map, read_map_description
from gridslam.io.text import compute_digest
from gridslam.io.trajectories import read_tum
from gridslam.types import OccupancyGrid, Trajectory

_BoolArray: TypeAlias = NDArray[np.bool_]
SUFFIX = ".geojson"
_SURE_LOG_ODDS = 4.6  # of probability 0.99, as maps are read
_CONNECTED = 0.7072  # of a cell, from a line: cells whose middles are no farther from it touch each other
_NEAR_NS = 1_000_000


def read_edited_map(
    path: str | Path, *, strict_thresholds: bool = False, on_remark: Callable[[str], None] = lambda remark: None
) -> OccupancyGrid:
    """Read a map; of edits (``.geojson``) the map that they name, with its walls drawn and its areas erased.

    Raises
    ------
    InputError
        As `read_map`, `read_edits` and `MapEdits.carry`.
    """
    if Path(path).suffix != SUFFIX:
        return read_map(path, strict_thresholds=strict_thresholds, on_remark=on_remark)
    grid, edits, _ = read_map_of_edits(path, strict_thresholds=strict_thresholds, on_remark=on_remark)
    return apply_edits(grid, edits)


def read_map_of_edits(
    path: str | Path, *, strict_thresholds: bool = False, on_remark: Callable[[str], None] = lambda remark: None
) -> tuple[OccupancyGrid, Edits, Path]:
    """Read edits and the map that they name: as it is, the edits where they lie on it, and its YAML file."""
    edits = read_edits(path)
    own = Path(path).parent / edits.map_name
    if own.suffix not in (".yaml", ".yml"):
        raise InputError(path, f"expected the YAML file of a map in its member map, got {edits.map_name or 'none'!r}")
    grid = read_map(own, strict_thresholds=strict_thresholds, on_remark=on_remark)
    return grid, MapEdits.of(own).carry(edits, path, grid), own


@final
class MapEdits:
    """The map that edits are of: its digest, and the drives whose scans they may follow.

    Parameters
    ----------
    path : str or Path
        The map's YAML file, or the session that holds it.
    sha256 : str
        Digest of the map's image; empty for a session, whose edits always follow their scans.
    trajectories : mapping of str to Trajectory
        Of each drive of the map, by its name; the name is empty in the folder of a run.
    is_newest : bool
        Whether it is the newest map of a session, whose edits without a scan and without a drive are its.
    """

    def __init__(
        self, path: str | Path, sha256: str, trajectories: Mapping[str, Trajectory], *, is_newest: bool = True
    ) -> None:
        self.path = Path(path)
        self._is_newest = is_newest
        self.sha256 = sha256
        self.trajectories = trajectories

    @classmethod
    def of(cls, map_yaml: str | Path) -> MapEdits:
        """Compute the digest of a map's image, and read ``trajectory.tum`` beside it, if there is one."""
        path = Path(map_yaml)
        beside = path.parent / "trajectory.tum"
        digest = compute_digest(path.parent / read_map_description(path).image)
        return cls(path, digest, {"": read_tum(beside)} if beside.is_file() else {})

    def split(self, edits: Edits) -> tuple[Edits, tuple[Edit, ...]]:
        """Move each edit with the scan that it follows, where the map is no longer the one that it was drawn on.

        Returns
        -------
        edits : Edits
            Those of this map; without a scan where they were drawn.
        others : tuple of Edit
            Those of another map, as they are: it, too, is not the one that they were drawn on, or they follow a scan
            that this one has not.
        """
        if self.sha256 and edits.map_sha256 == self.sha256:
            return edits, ()
        own, others = [], []
        for edit in edits.edits:
            is_here = edit.drive in self.trajectories if edit.drive else self._is_newest
            stays = not edits.map_sha256 if self.sha256 else edit.anchor is None and is_here
            moved = follow_scan(edit, self.trajectories) or (edit if stays else None)
            own.append(moved) if moved is not None else others.append(edit)
        return replace(edits, edits=tuple(own), map_sha256=self.sha256), tuple(others)

    def carry(self, edits: Edits, path: str | Path, grid: OccupancyGrid) -> Edits:
        """Move edits as `split`, and check that all are of this map; `path` names their file.

        Raises
        ------
        InputError
            The edits are another map's: the image has changed, and its trajectory has not their scans; or one lies
            outside the map.
        """
        own, others = self.split(edits)
        if others:
            problem = (
                f"expected edits of {self.path}, got those of another map: {len(others)} of {len(edits.edits)} follow"
            )
            raise InputError(path, f"{problem} none of its scans, and its image is not the one that they were drawn on")
        self.require_inside(own, path, grid)
        return own

    def require_inside(self, edits: Edits, path: str | Path, grid: OccupancyGrid) -> None:
        """Raise InputError, with the number of the feature, where an edit lies outside the map."""
        low = np.array(grid.origin)
        high = low + np.array(grid.shape[::-1]) * grid.resolution_m
        for number, edit in enumerate(edits.edits, start=1):
            if (edit.points.max(axis=0) < low).any() or (edit.points.min(axis=0) > high).any():
                x, y = edit.points[0].tolist()
                problem = f"expected places in {self.path}, {low[0]:g} to {high[0]:g} and {low[1]:g} to {high[1]:g} m"
                raise InputError(path, f"feature {number}: {problem}, got {x:g}, {y:g}")


def follow_scan(edit: Edit, trajectories: Mapping[str, Trajectory]) -> Edit | None:
    """Move an edit as its scan's pose has; None where none of the drives has this scan."""
    if edit.anchor is None:
        return None
    drives = [edit.drive] if edit.drive and "" not in trajectories else [*trajectories]
    stamp_ns = round(1e9 * float(edit.anchor[0]))
    found = None
    nearest_ns = _NEAR_NS + 1
    for drive in drives:
        trajectory = trajectories.get(drive)
        gaps = np.abs(trajectory.stamps_ns - stamp_ns) if trajectory is not None else np.zeros(0, np.int64)
        if len(gaps) and trajectory is not None and gaps.min() < nearest_ns:
            nearest_ns = int(gaps.min())
            found = drive, trajectory.poses[int(gaps.argmin())]
    if found is None:
        return None
    motion = se2.compose(found[1], se2.inverse(edit.anchor[1:]))
    anchor = np.array([edit.anchor[0], *found[1]])
    return replace(edit, points=se2.transform_points(motion, edit.points), anchor=anchor, drive=edit.drive or found[0])


def anchor_edits(edits: Edits, trajectories: Mapping[str, Trajectory]) -> Edits:
    """Let each edit without an anchor follow the scan, of any of the drives, that was nearest to its middle."""
    return replace(
        edits,
        edits=tuple(edit if edit.anchor is not None else anchor_edit(edit, trajectories) for edit in edits.edits),
    )


def anchor_edit(edit: Edit, trajectories: Mapping[str, Trajectory]) -> Edit:
    """Let an edit follow the scan, of any of the drives, that was nearest to its middle, if there is one."""
    found, nearest_m2 = edit, np.inf
    for drive, trajectory in trajectories.items():
        apart_m2 = np.square(trajectory.poses[:, :2] - edit.points.mean(axis=0)).sum(axis=1)
        if len(apart_m2) and apart_m2.min() < nearest_m2:
            nearest, nearest_m2 = int(apart_m2.argmin()), float(apart_m2.min())
            stamp_s = float(trajectory.stamps_ns[nearest]) * 1e-9
            found = replace(edit, anchor=np.array([stamp_s, *trajectory.poses[nearest]]), drive=drive)
    return found


def apply_edits(grid: OccupancyGrid, edits: Edits) -> OccupancyGrid:
    """Make erased areas free, and then the walls that were drawn occupied; parts outside the map are left out."""
    log_odds, known = grid.log_odds.copy(), grid.known.copy()
    for layer, value in (("erased", -_SURE_LOG_ODDS), ("walls", _SURE_LOG_ODDS)):
        for edit in edits.of(layer):
            window, inside = cells_of(edit, grid)
            log_odds[window][inside] = value
            known[window][inside] = True
    return OccupancyGrid(log_odds, known, grid.resolution_m, grid.origin)


def cells_of(edit: Edit, grid: OccupancyGrid) -> tuple[tuple[slice, slice], _BoolArray]:
    """Cells of a map that an edit covers.

    A polygon has the cells whose middles are in it. A line has those whose middles are within half its width, at least
    a row of cells that touch each other.

    Returns
    -------
    window : (slice, slice)
        Rows and columns about the edit.
    inside : (h, w) bool
        Of the window.
    """
    places = (edit.points - np.array(grid.origin)) / grid.resolution_m - 0.5  # in cells, from the middle of the first
    reach = max(0.5 * edit.width_m / grid.resolution_m, _CONNECTED) if edit.geometry == "LineString" else 0.0
    low = np.clip(np.ceil(places.min(axis=0) - reach), 0, grid.shape[::-1]).astype(np.int64)
    high = np.clip(np.floor(places.max(axis=0) + reach) + 1, low, grid.shape[::-1]).astype(np.int64)
    window = slice(int(low[1]), int(high[1])), slice(int(low[0]), int(high[0]))
    shape = tuple((high - low)[::-1].tolist())
    if edit.geometry == "Polygon":
        return window, _fill(places - low, shape)
    inside = np.zeros(shape, np.bool_)
    for begin, end in zip(places[:-1] - low, places[1:] - low, strict=True):
        inside |= _is_near(begin, end, reach, shape)
    return window, inside


def _fill(ring: NDArray[np.float64], shape: tuple[int, ...]) -> _BoolArray:
    """Cells (h, w) whose middles are in a ring (K, 2): each side changes the cells to its right."""
    height, width = shape
    changes = np.zeros((height, width + 1), np.bool_)
    for (x, y), (other_x, other_y) in zip(ring.tolist(), np.roll(ring, -1, axis=0).tolist(), strict=True):
        first, last = (int(np.clip(np.ceil(end), 0, height)) for end in sorted((y, other_y)))
        rows = np.arange(first, last)
        if len(rows):
            columns = np.ceil(x + (rows - y) * ((other_x - x) / (other_y - y)))
            changes[rows, np.clip(columns, 0, width).astype(np.int64)] ^= True
    return np.logical_xor.accumulate(changes, axis=1)[:, :width]


def _is_near(begin: NDArray[np.float64], end: NDArray[np.float64], reach: float, shape: tuple[int, ...]) -> _BoolArray:
    """Cells (h, w) whose middles are within a reach of a line."""
    rows, columns = np.ogrid[: shape[0], : shape[1]]
    along = end - begin
    steps = ((columns - begin[0]) * along[0] + (rows - begin[1]) * along[1]) / max(float(along @ along), 1e-12)
    steps = np.clip(steps, 0, 1)
    apart = np.square(columns - begin[0] - steps * along[0]) + np.square(rows - begin[1] - steps * along[1])
    return np.asarray(apart <= reach**2)
