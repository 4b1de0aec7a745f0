"""Landmarks as text: one in each row, with its covariance."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gridslam.io.tables import check_rows, read_rows, symmetric_of_upper, upper_of_symmetric
from gridslam.slam.landmarks.report import LandmarkMap

LANDMARKS_HEADER = "landmark,x_m,y_m,cov_xx_m2,cov_xy_m2,cov_yy_m2,observations"
"""First line: the columns with their units."""


def write_landmarks(path: str | Path, landmarks: LandmarkMap) -> None:
    """Write landmarks in their order; positions have nine decimals, covariances nine significant digits."""
    upper = upper_of_symmetric(landmarks.covariances)
    parts = (landmarks.names, landmarks.positions, upper, landmarks.observations)
    with Path(path).open("w", encoding="ascii", newline="\n") as file:
        file.write(LANDMARKS_HEADER + "\n")
        for name, (x, y), (xx, xy, yy), seen in zip(*(part.tolist() for part in parts), strict=True):
            file.write(f"{name},{x:.9f},{y:.9f},{xx:.9g},{xy:.9g},{yy:.9g},{seen}\n")


def read_landmarks(path: str | Path) -> LandmarkMap:
    """Read landmarks, in file order.

    Raises
    ------
    InputError
        Where the file cannot be read, its first line is not `LANDMARKS_HEADER`, or a line is not seven finite numbers,
        the first and the last of them whole.
    """
    rows = list(read_rows(path, LANDMARKS_HEADER))
    values = np.array([row.values for row in rows]).reshape(-1, 7)
    counts = values[:, [0, -1]]
    whole = ((counts == np.rint(counts)) & (np.abs(counts) < 2**53)).all(axis=1)
    expected = "expected whole numbers of a landmark and of its observations"
    check_rows(path, [row.line for row in rows], whole, lambda row: f"{expected}, got {counts[row]}")
    names, observations = counts.astype(np.int64).T
    return LandmarkMap(names, values[:, 1:3], symmetric_of_upper(values[:, 3:6]), observations)
