"""Landmarks as text: one in each row, with its covariance."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from gridslam.errors import InputError
from gridslam.io.text import read_text
from gridslam.slam.landmarks.report import LandmarkMap

__all__ = ["LANDMARKS_HEADER", "read_landmarks", "write_landmarks"]

LANDMARKS_HEADER = "landmark,x_m,y_m,cov_xx_m2,cov_xy_m2,cov_yy_m2,observations"
"""First line: the columns with their units."""


def write_landmarks(path: str | Path, landmarks: LandmarkMap) -> None:
    """Write landmarks in their order; positions have nine decimals, covariances nine significant digits."""
    with Path(path).open("w", encoding="ascii", newline="\n") as file:
        file.write(LANDMARKS_HEADER + "\n")
        parts = (landmarks.names, landmarks.positions, landmarks.covariances, landmarks.observations)
        for name, (x, y), ((xx, xy), (_, yy)), seen in zip(*(part.tolist() for part in parts), strict=True):
            file.write(f"{name},{x:.9f},{y:.9f},{xx:.9g},{xy:.9g},{yy:.9g},{seen}\n")


def read_landmarks(path: str | Path) -> LandmarkMap:
    """Read landmarks, in file order.

    Raises
    ------
    InputError
        Where the file cannot be read, its first line is not `LANDMARKS_HEADER`, or a line is not seven finite numbers,
        the first and the last of them whole.
    """
    header, *lines = read_text(path).splitlines() or [""]
    if header != LANDMARKS_HEADER:
        raise InputError(path, f"expected the columns {LANDMARKS_HEADER}, got {header!r:.200}", 1)
    rows, counts = list[list[float]](), list[tuple[int, int]]()
    for number, line in enumerate(lines, 2):
        words = line.split(",")
        try:
            counts.append((int(words[0]), int(words[-1])))
            rows.append([float(word) for word in words[1:-1]])
        except ValueError:
            raise InputError(path, f"expected numbers ({LANDMARKS_HEADER}), got {line!r:.200}", number) from None
        if len(rows[-1]) != 5 or not all(map(math.isfinite, rows[-1])):
            raise InputError(path, f"expected seven finite numbers ({LANDMARKS_HEADER}), got {line!r:.200}", number)
    values = np.array(rows).reshape(-1, 5)
    names, observations = np.array(counts, np.int64).reshape(-1, 2).T
    return LandmarkMap(names, values[:, :2], values[:, [2, 3, 3, 4]].reshape(-1, 2, 2), observations)
