"""NumPy twins of the kernels that write maps; see `gridslam.kernels.reference` for the maps' layout."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

TILE = 32
"""Rows and columns of cells in a tile."""

PAGE = 16
"""Rows and columns of tiles in a page."""

UNKNOWN = -(2**15)
"""Log-odds of a cell of which nothing is known, as int16; see `unknown_of`."""

OCCUPIED = 255
"""Value of the distance field at an occupied cell."""

FARTHEST = 2**30
"""Cells from the world's origin beyond which nothing is mapped, so that indices fit 32 bits."""

FREE_CELLS = 1664
"""Cells of a beam, from the laser on, that it frees at most: 83.2 m in cells of 5 cm. Its end counts at any range."""

FloatArray = NDArray[np.float64]
Int32Array = NDArray[np.int32]
IntArray = NDArray[np.int64]
LogOdds = NDArray[np.signedinteger[Any]]  # int8 or int16

# Shifts and masks: NumPy's floor division of signed integers takes several times as long.
_TILE_BITS = TILE.bit_length() - 1
_PAGE_BITS = PAGE.bit_length() - 1
_BLOCK = 512  # changed cells whose windows are in memory at once


def unknown_of(log_odds: LogOdds) -> int:
    """Stored log-odds of a cell of which nothing is known: the least value of their type."""
    return int(np.iinfo(log_odds.dtype).min)


def transform_to_world(poses: FloatArray, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """World coordinates x, y (K, B) in m of points (B, 2) of the base frame seen from poses (K, 3).

    Sine and cosine are the C library's, as in the kernels: NumPy's differ in the last bit, and so would a cell.
    """
    headings = np.where(np.isfinite(poses[:, 2]), poses[:, 2], np.nan).tolist()  # of an infinite one, math raises
    c = np.array([math.cos(theta) for theta in headings])[:, None]
    s = np.array([math.sin(theta) for theta in headings])[:, None]
    px = points[:, 0]
    py = points[:, 1]
    return poses[:, :1] + c * px - s * py, poses[:, 1:2] + s * px + c * py


def cells_within(cells: FloatArray, most: float = FARTHEST) -> FloatArray:
    """Numbers of cells within `most` of 0, so that an integer holds them; a NaN becomes the least."""
    return np.fmin(np.fmax(cells, -most), most)


def _cells(poses: FloatArray, points: FloatArray, resolution: float) -> IntArray:
    """Cells (K, B, 2) = [y, x] that hold points (B, 2) of the base frame."""
    x, y = transform_to_world(poses, points)
    scale = 1.0 / resolution
    return cells_within(np.stack([np.floor(y * scale), np.floor(x * scale)], axis=-1)).astype(np.int64)


def cell_addresses(
    roots: Int32Array,
    first: tuple[int, int],
    pages: Int32Array,
    rows: NDArray[np.integer] | int,
    y: IntArray,
    x: IntArray,
) -> IntArray:
    """Positions (...) of cells y, x (...) of maps `rows` (...), or of one, in the flattened tiles.

    That of tile 0 where there is none.
    """
    ty = y >> _TILE_BITS
    tx = x >> _TILE_BITS
    py = (ty >> _PAGE_BITS) - first[0]
    px = (tx >> _PAGE_BITS) - first[1]
    inside = (py >= 0) & (py < roots.shape[1]) & (px >= 0) & (px < roots.shape[2])
    page = np.where(inside, roots[rows, np.where(inside, py, 0), np.where(inside, px, 0)], 0)
    tile = pages[page, ty & (PAGE - 1), tx & (PAGE - 1)].astype(np.int64)
    return np.asarray((((tile << _TILE_BITS) + (y & (TILE - 1))) << _TILE_BITS) + (x & (TILE - 1)))


def ray_cells(start: IntArray, ends: IntArray) -> IntArray:
    """Cells (N, 2) of the 8-connected lines from the cell `start` (2,) to just before each of `ends` (B, 2).

    Of a line longer than `FREE_CELLS` the first of them alone.

    Cell i of n = max(abs(d)) lies at start + floor((2 i d + n) / (2 n)): the line's cell nearest to its ideal.

    Source: Bresenham, Algorithm for computer control of a digital plotter (1965).
    """
    difference = ends - start
    lengths = np.abs(difference).max(axis=1)
    steps = np.minimum(lengths, FREE_CELLS)
    i = np.arange(steps.sum()) - np.repeat(np.cumsum(steps) - steps, steps)
    n = np.repeat(lengths, steps)[:, None]
    return np.asarray(start + (2 * i[:, None] * np.repeat(difference, steps, axis=0) + n) // (2 * n))


def tiles_on_rays(
    rows: Int32Array, poses: FloatArray, ends: FloatArray, origin: FloatArray, resolution: float, threads: int
) -> Int32Array:
    """Tiles that the rays from `origin` (2,) to `ends` (B, 2) cross where they free cells, and those of the ends.

    They are seen from poses (K, 3).

    Returns
    -------
    (N, 3) int32
        [row, tile y, tile x], each tile of a row once; grouped by pose, ascending within.
    """
    starts = _cells(poses, origin[None], resolution)[:, 0]
    tips = _cells(poses, ends, resolution)
    tiles_to_write = [np.zeros((0, 3), np.int32)]
    for row, start, tip in zip(rows, starts, tips, strict=True):
        tiles = np.concatenate([ray_cells(start, tip), tip]) // TILE
        if not len(tiles):
            continue
        low = tiles.min(axis=0)
        marked = np.zeros(tiles.max(axis=0) - low + 1, bool)
        marked[tuple((tiles - low).T)] = True
        found = np.argwhere(marked) + low
        tiles_to_write.append(np.column_stack([np.full(len(found), row), found]).astype(np.int32))
    return np.concatenate(tiles_to_write)


def tiles_near_cells(cells: Int32Array, reach: int) -> Int32Array:
    """Tiles within `reach` cells (1 to 15) of changed `cells` (M, 4) = [row, y, x, occupied], grouped by row.

    Returns
    -------
    (N, 3) int32
        [row, tile y, tile x], ascending, each once. A window of at most a tile's side lies in its four corners' tiles.
    """
    corners = np.array([[0, dy, dx] for dy in (-reach, reach) for dx in (-reach, reach)])
    around = cells[:, None, :3].astype(np.int64) + corners
    around[..., 1:] //= TILE
    return np.unique(around.reshape(-1, 3), axis=0).astype(np.int32)


def make_tiles_writable(
    roots: Int32Array,
    first: tuple[int, int],
    pages: Int32Array,
    log_odds: LogOdds,
    field: NDArray[np.uint8],
    page_refs: Int32Array,
    tile_refs: Int32Array,
    free_pages: Int32Array,
    free_tiles: Int32Array,
    tiles_to_write: Int32Array,
) -> tuple[int, int, int]:
    """Copy on write: give every touched tile (N, 3) = [row, tile y, tile x] to its map alone, in order.

    A page or tile that is empty or that more than one owner uses is copied to the last free id not yet taken. A table
    entry counts as one use of its page, a page's entry as one use of its tile, however many maps share the page.

    Parameters
    ----------
    page_refs, tile_refs : (K,), (T,) int32
        How often each id is used; changed in place, as are `roots`, `pages`, `log_odds` and `field`.
    free_pages, free_tiles : (F,), (G,) int32
        Ids that nothing uses; where they do not suffice, the caller makes more and goes on from there.

    Returns
    -------
    (int, int, int)
        How many free pages and tiles were taken, and how many of the touched tiles are owned now.
    """
    pages_left = len(free_pages)
    tiles_left = len(free_tiles)
    done = 0
    for row, ty, tx in tiles_to_write.tolist():
        at = row, ty // PAGE - first[0], tx // PAGE - first[1]
        page = roots[at]
        if page == 0 or page_refs[page] > 1:
            if pages_left == 0:
                break
            pages_left -= 1
            fresh = free_pages[pages_left]
            pages[fresh] = pages[page]
            if page != 0:
                page_refs[page] -= 1
                tile_refs[pages[page][pages[page] > 0]] += 1  # no tile is twice in a page
            page_refs[fresh] = 1
            roots[at] = page = fresh
        tile = pages[page, ty % PAGE, tx % PAGE]
        if tile == 0 or tile_refs[tile] > 1:
            if tiles_left == 0:
                break
            tiles_left -= 1
            fresh = free_tiles[tiles_left]
            log_odds[fresh] = log_odds[tile]
            field[fresh] = field[tile]
            if tile != 0:
                tile_refs[tile] -= 1
            tile_refs[fresh] = 1
            pages[page, ty % PAGE, tx % PAGE] = fresh
        done += 1
    return len(free_pages) - pages_left, len(free_tiles) - tiles_left, done


def _count_cells(cells: IntArray) -> tuple[IntArray, IntArray, IntArray]:
    """Count cells (N, 2): each distinct one as a sortable number, as [y, x], and how often it occurs."""
    keys, counts = np.unique((cells[:, 0] << 32) + (cells[:, 1] + (1 << 31)), return_counts=True)
    return keys, np.stack([keys >> 32, (keys & 0xFFFFFFFF) - (1 << 31)], axis=1), counts


def update_log_odds(
    roots: Int32Array,
    first: tuple[int, int],
    pages: Int32Array,
    log_odds: LogOdds,
    field: NDArray[np.uint8],
    rows: Int32Array,
    poses: FloatArray,
    ends: FloatArray,
    origin: FloatArray,
    resolution: float,
    hit: int,
    miss: int,
    min: int,
    max: int,
    occupied_above: int,
    threads: int,
) -> Int32Array:
    """Binary Bayes filter along the rays of a scan, in place, in maps that own all touched tiles.

    Each ray adds `miss` < 0 to the cells before its end, `FREE_CELLS` of them at most, down to `min`, and `hit` > 0 to
    the cell at its end, up to `max`; a cell in which any ray of the scan ends is missed by none of them. An unknown
    cell starts from 0.

    Returns
    -------
    (M, 4) int32
        [row, y, x, occupied] of the cells that came above `occupied_above` (1) or fell to it or below (0), by pose.

    References
    ----------
    Probabilistic Robotics, Table 9.1.
    """
    starts = _cells(poses, origin[None], resolution)[:, 0]
    tips = _cells(poses, ends, resolution)
    stored = log_odds.reshape(-1)
    changed = [np.zeros((0, 4), np.int32)]
    for row, start, tip in zip(rows, starts, tips, strict=True):
        end_keys, end_cells, hits = _count_cells(tip)
        keys, free_cells, misses = _count_cells(ray_cells(start, tip))
        free = ~np.isin(keys, end_keys, assume_unique=True)
        cells = np.concatenate([free_cells[free], end_cells])
        evidence = np.concatenate([misses[free] * miss, hits * hit])
        at = cell_addresses(roots, first, pages, row, cells[:, 0], cells[:, 1])
        before = np.where(stored[at] == unknown_of(log_odds), 0, stored[at]).astype(np.int64)
        after = before + evidence
        after = np.where(evidence < 0, np.maximum(after, min), np.minimum(after, max))
        stored[at] = after
        occupied = after > occupied_above
        flipped = occupied != (before > occupied_above)
        table = np.column_stack([np.full(len(cells), row), cells, occupied])
        changed.append(table[flipped].astype(np.int32))
    return np.concatenate(changed)


def update_field(
    roots: Int32Array,
    first: tuple[int, int],
    pages: Int32Array,
    log_odds: LogOdds,
    field: NDArray[np.uint8],
    cells: Int32Array,
    cone: NDArray[np.uint8],
    threads: int,
) -> None:
    """Let the distance field follow changed `cells` (M, 4) = [row, y, x, occupied], grouped by row, in place.

    The field is the grey dilation of the occupied cells, those at 255, by the `cone` (2 r + 1, 2 r + 1). Around a cell
    that became free it is recomputed; then each new obstacle lifts its surroundings to its cone.
    """
    values = field.reshape(-1)
    reach = len(cone) // 2
    side = len(cone)

    def windows(part: Int32Array, around: int) -> IntArray:
        d = np.arange(-around, around + 1)
        row, y, x = (part[:, c, None, None].astype(np.int64) for c in range(3))
        return cell_addresses(roots, first, pages, row, *np.broadcast_arrays(y + d[:, None], x + d))

    values[windows(cells, 0)[:, 0, 0]] = np.where(cells[:, 3] != 0, OCCUPIED, 0)
    freed = cells[cells[:, 3] == 0]
    met = cells[cells[:, 3] != 0]
    for part in (freed[i : i + _BLOCK] for i in range(0, len(freed), _BLOCK)):
        occupied = (values[windows(part, 2 * reach)] == OCCUPIED).astype(np.uint8)
        dilated = np.zeros((len(part), side, side), np.uint8)
        for (dy, dx), height in np.ndenumerate(cone):
            if height:
                np.maximum(dilated, height * occupied[:, dy : dy + side, dx : dx + side], out=dilated)
        values[windows(part, reach)] = dilated
    for part in (met[i : i + _BLOCK] for i in range(0, len(met), _BLOCK)):
        at = windows(part, reach)
        for (dy, dx), height in np.ndenumerate(cone):  # cells of one offset do not coincide
            values[at[:, dy, dx]] = np.maximum(values[at[:, dy, dx]], height)
