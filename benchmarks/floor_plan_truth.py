"""The walls, doors and rooms of a simulated building, which of them a drive has seen, and how a floor plan compares."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import ndimage

from gridslam.geometry import se2
from gridslam.plan import FloorPlan, Segments
from gridslam.plan.rasters import Raster, fill_polygons
from gridslam.types import FloatArray

THICKEST_M = 0.2
LONGEST_FURNITURE_M = 3.4
SHORTEST_WALL_M = 1.0
CELL_M = 0.05
LEAST_SEEN_ROOM_M2 = 4.0
NEAR_M = 0.1
NEAR_RAD = np.deg2rad(5)


@dataclass(frozen=True)
class Truth:
    """Sides of walls (S, 2, 2) and of furniture, outlines of walls, and doors (D, 2, 2), jamb to jamb; m."""

    walls: FloatArray
    furniture: FloatArray
    solid: list[FloatArray]
    doors: FloatArray


def read_truth(segments: FloatArray) -> Truth:
    """Sort the segments (S, 4) of a world: four that close are a wall where they are thin, else mostly furniture."""
    walls, furniture, solid, centres = [], [], [], []
    k = 0
    while k < len(segments):
        box = segments[k : k + 4]
        if len(box) == 4 and np.allclose(box[:, 2:], np.roll(box[:, :2], -1, axis=0)) and _is_rectangle(box):
            sides = box.reshape(4, 2, 2)
            lengths = np.hypot(*(sides[:, 1] - sides[:, 0]).T)
            if lengths.min() < THICKEST_M:
                walls += list(sides)
                solid.append(box[:, :2])
                short = np.argsort(lengths)[:2]
                centres.append(sides[short].mean(axis=1))
            else:
                (furniture if lengths.max() < LONGEST_FURNITURE_M else walls).extend(sides)
            k += 4
        else:
            side = segments[k].reshape(2, 2)
            (walls if np.hypot(*(side[1] - side[0])) > 0.5 else furniture).append(side)
            k += 1
    return Truth(np.array(walls), np.array(furniture).reshape(-1, 2, 2), solid, _find_doors(np.array(centres)))


def _is_rectangle(box: FloatArray) -> bool:
    along = box[:, 2:] - box[:, :2]
    return bool(np.allclose((along * np.roll(along, -1, axis=0)).sum(axis=1), 0, atol=1e-6))


def _find_doors(centres: FloatArray) -> FloatArray:
    """Gaps of 0.5 to 2.6 m between the ends of walls in one line, without a wall in between."""
    lines = Segments.of(centres)
    found: list[FloatArray] = []
    for side, sign in ((1, 1), (0, -1)):  # walls are built from left to right, and from right to left
        for end, along in zip(lines.ends[:, side], sign * lines.alongs, strict=True):
            steps, offsets = lines.locate(end, along)
            ahead = (np.abs(offsets).max(axis=1) < 0.01) & (steps.min(axis=1) > -0.01) & (steps.max(axis=1) > 0.01)
            gap = steps.min(axis=1)[ahead].min(initial=np.inf)
            if 0.5 < gap < 2.6:
                door = end + np.outer([0, gap], along)
                if all(np.hypot(*(door - other).mean(axis=0)) >= 0.1 for other in found):
                    found.append(door)
    return np.array(found).reshape(-1, 2, 2)


@dataclass(frozen=True)
class Seen:
    """End points (N, 2) of all beams at the true poses, cells that beams passed through, and their raster."""

    ends: FloatArray
    free: np.ndarray
    raster: Raster


def look(truth: Truth, origins: FloatArray, ends: list[FloatArray]) -> Seen:
    """See a building from true poses: where beams ended, and which cells they passed through."""
    corners = truth.walls.reshape(-1, 2)
    low = corners.min(axis=0) - 0.5
    width, height = np.ceil((corners.max(axis=0) + 0.5 - low) / CELL_M).astype(int)
    empty = np.zeros((height, width), np.bool_)
    raster = Raster(empty, empty, empty, CELL_M, low)
    free = empty.copy()
    shares = np.linspace(0, 1, 400)[:-3]
    for origin, own in list(zip(origins, ends, strict=True))[::3]:
        places = origin + shares[:, None, None] * (own - origin)
        free[raster.cells(places.reshape(-1, 2))] = True
    return Seen(np.concatenate(ends), ndimage.binary_closing(free, np.ones((5, 5))), raster)


def _runs(is_in: np.ndarray, most_gap: int) -> list[tuple[int, int]]:
    """First and last of runs with gaps of at most `most_gap`."""
    chosen = np.flatnonzero(is_in)
    if not len(chosen):
        return []
    parts = np.split(chosen, np.flatnonzero(np.diff(chosen) > most_gap + 1) + 1)
    return [(int(part[0]), int(part[-1])) for part in parts]


def seen_walls(truth: Truth, seen: Seen, shortest_m: float = SHORTEST_WALL_M) -> FloatArray:
    """The parts (P, 2, 2) of walls of 1 m and more where beams have ended, with gaps of at most 0.3 m."""
    parts = []
    for begin, end in truth.walls:
        along = end - begin
        length = float(np.hypot(*along))
        along = along / length
        apart = seen.ends - begin
        near = np.abs(apart @ np.array([-along[1], along[0]])) < 0.04
        bins = np.floor((apart @ along)[near] / 0.05).astype(int)
        count = max(1, int(length / 0.05))
        hits = np.bincount(bins[(bins >= 0) & (bins < count)], minlength=count)
        for first, last in _runs(hits > 0, 6):
            if (last + 1 - first) * 0.05 >= shortest_m:
                parts.append(begin + np.outer([first * 0.05, (last + 1) * 0.05], along))
    return np.array(parts).reshape(-1, 2, 2)


def plan_sides(plan: FloorPlan) -> FloatArray:
    """Seen sides (S, 2, 2) of a plan's walls: both of those with a thickness."""
    sides = []
    for wall in plan.walls:
        outline = wall.outline
        sides += [wall.ends] if wall.thickness_m is None else [outline[:2], outline[2:][::-1]]
    return np.array(sides).reshape(-1, 2, 2)


def cover(part: FloatArray, lines: Segments) -> tuple[float, FloatArray, FloatArray]:
    """Share of a segment (2, 2) near lines in its direction; distances there, m, and angles of those lines, rad."""
    (begin, end), length = part, float(np.hypot(*(part[1] - part[0])))
    along = (end - begin) / length
    normal = np.array([-along[1], along[0]])
    places = np.linspace(0.025, length - 0.025, max(2, int(length / 0.05)))
    sines = lines.alongs @ normal * np.sign(lines.alongs @ along)
    near = np.abs(sines) < np.sin(NEAR_RAD)
    offsets = np.full(len(places), np.inf)
    angles = np.zeros(len(places))
    for ends, sine in zip(lines.ends[near], sines[near], strict=True):
        steps, across = (ends - begin) @ along, (ends - begin) @ normal
        order = np.argsort(steps)
        inside = (places > steps[order[0]] - 0.1) & (places < steps[order[1]] + 0.1)
        here = np.interp(places, steps[order], across[order])
        closer = inside & (np.abs(here) < np.abs(offsets))
        offsets[closer], angles[closer] = here[closer], np.arcsin(sine)
    found = np.abs(offsets) < NEAR_M
    return float(found.mean()), offsets[found], angles[found]


def compare_walls(sides: FloatArray, truth: Truth, seen: Seen) -> dict[str, Any]:
    """Seen walls of 1 m and more, found ones, and which of both are right; offsets and directions at all places."""
    parts = seen_walls(truth, seen)
    lines = Segments.of(sides)
    shares, offsets, angles = zip(*(cover(part, lines) for part in parts), strict=True)
    true = Segments.of(truth.walls)
    long = sides[Segments.of(sides).lengths >= SHORTEST_WALL_M]
    right = [cover(side, true)[0] >= 0.8 for side in long]
    return {
        "seen": len(parts),
        "found_of_seen": int(sum(share >= 0.8 for share in shares)),
        "found": len(long),
        "right_of_found": int(sum(right)),
        "offset_m": float(np.median(np.abs(np.concatenate(offsets)))),
        "direction_deg": float(np.rad2deg(np.median(np.abs(np.concatenate(angles))))),
    }


def compare_doors(openings: list[FloatArray], truth: Truth, seen: Seen) -> dict[str, Any]:
    """Doors of which both jambs and a place behind were seen; found ones, surplus ones, and errors of their widths."""
    known = [door for door in truth.doors if _is_seen(door, seen)]
    middles = np.array([opening.mean(axis=0) for opening in openings]).reshape(-1, 2)
    errors = []
    for door in known:
        apart = np.hypot(*(middles - door.mean(axis=0)).T)
        if len(apart) and apart.min() < 0.3:
            found = openings[int(np.argmin(apart))]
            errors.append(float(np.hypot(*(found[1] - found[0])) - np.hypot(*(door[1] - door[0]))))
    every = truth.doors.mean(axis=1)
    surplus = sum(not len(every) or np.hypot(*(every - middle).T).min() > 0.3 for middle in middles)
    return {"seen": len(known), "found": len(errors), "surplus": int(surplus), "width_errors_m": errors}


def _is_seen(door: FloatArray, seen: Seen) -> bool:
    ends = [np.hypot(*(seen.ends - jamb).T) < 0.12 for jamb in door]
    across = np.array([-(door[1] - door[0])[1], (door[1] - door[0])[0]])
    behind = door.mean(axis=0) + np.outer([-0.8, 0.8], across / np.hypot(*across))
    return all(near.sum() >= 5 for near in ends) and bool(seen.free[seen.raster.cells(behind)].all())


def compare_rooms(plan: FloorPlan, truth: Truth, seen: Seen, pose: FloatArray) -> dict[str, Any]:
    """Intersection over union of rooms, and whether none is missing, surplus, divided or joined with another one.

    Due are rooms of which 4 m² and more were seen; of those that were seen by half and more the first figure is taken.
    """
    lines = [*truth.walls, *truth.doors]
    solid = fill_polygons(seen.raster, [*truth.solid, *lines])
    labels, _ = ndimage.label(~solid)
    labels[labels == labels[0, 0]] = 0
    furniture = (
        fill_polygons(seen.raster, [box[:, 0] for box in truth.furniture.reshape(-1, 4, 2, 2)])
        if (len(truth.furniture) % 4 == 0)
        else np.zeros_like(solid)
    )
    visible = ndimage.binary_fill_holes(seen.free | furniture)
    regions = [(labels == k) & visible for k in range(1, labels.max() + 1)]
    found = []
    for room in plan.rooms:
        mask = fill_polygons(seen.raster, [se2.transform_points(pose, room.outline)])
        for hole in room.holes:
            mask &= ~fill_polygons(seen.raster, [se2.transform_points(pose, hole)])
        found.append(mask & (labels > 0))
    cell = CELL_M**2
    overlaps = np.array([[float((a & b).sum()) for b in found] for a in regions]).reshape(len(regions), -1)
    areas = [np.array([float(mask.sum()) for mask in masks]) for masks in (regions, found)]
    ious = overlaps / np.maximum(np.add.outer(*areas) - overlaps, 1)
    due = [k for k, region in enumerate(regions) if region.sum() * cell >= LEAST_SEEN_ROOM_M2]
    visited = [k for k in due if 2 * regions[k].sum() > (labels == k + 1).sum()]
    owners = [int(np.argmax(overlaps[:, j])) for j in range(len(found))]
    purity = [overlaps[owners[j], j] / max(1.0, found[j].sum()) for j in range(len(found))]
    is_right = all(owners.count(k) == 1 for k in due) and len(set(owners)) == len(owners)
    return {
        "due": len(due),
        "found": len(found),
        "ious": [float(ious[k].max(initial=0.0)) for k in visited],
        "ious_glimpsed": [float(ious[k].max(initial=0.0)) for k in due if k not in visited],
        "number_right": bool(is_right and all(share > 0.5 for share in purity)),
    }
