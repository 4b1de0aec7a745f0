"""Public logs: their content, authors and licences, and their download."""

from __future__ import annotations

import difflib
import os
import shutil
from dataclasses import dataclass
from http.client import HTTPException
from pathlib import Path
from typing import final
from urllib.request import urlopen

from gridslam.errors import ArgumentError, GridslamError
from gridslam.io.output import OutputFolder
from gridslam.io.text import compute_digest

PUBLIC = "https://raw.githubusercontent.com/MOLAorg/mola_test_datasets/HEAD/datasets/radish"
"""Where the files lie, each by its own name."""

MIRROR = "GRIDSLAM_DATASETS_URL"
"""Variable of the environment that names another place for them."""

_TIMEOUT_S = 30
_CC_BY = "CC BY 3.0 (https://creativecommons.org/licenses/by/3.0/)"
_BENCHMARK = "the Freiburg SLAM benchmark, http://ais.informatik.uni-freiburg.de/slamevaluation/"


class DatasetError(GridslamError):
    """A dataset cannot be got: no connection, or not the file that it should be."""


@final
@dataclass(frozen=True, slots=True)
class Dataset:
    """A public log.

    Attributes
    ----------
    name, file : str
        What it is asked for by, and the name of its file.
    sha256 : str
        Of the file, in hexadecimal.
    size : int
        Of the file, bytes.
    about, credit, licence : str
        What it is, who is to be named, and under which terms it may be used.
    """

    name: str
    file: str
    sha256: str
    size: int
    about: str
    credit: str
    licence: str = _CC_BY


DATASETS = (
    Dataset(
        "intel",
        "intel.clf.bz2",
        "d9ce4addefc9405d5e78fd883d2214766552537d262009f8e6f0137885f9f72a",
        2_277_279,
        "Intel Research Lab, Seattle: 13631 scans of 180 beams, 45 min, 508 m",
        f"D. Haehnel; {_BENCHMARK}",
    ),
    Dataset(
        "aces",
        "aces.clf.bz2",
        "b663e2976ed0621c2bec0cc20c4e7cc117b88db5bac6f921d3fbaa9685d2232a",
        839_027,
        "ACES building, Austin: 7374 scans of 180 beams, 23 min, 325 m",
        f"P. Beeson; {_BENCHMARK}",
    ),
    Dataset(
        "mit-csail",
        "mit-csail.clf.bz2",
        "e010703e450a20e71a97b0e8de88d9474040c8106e547ff894d885e67a309b47",
        539_615,
        "MIT CSAIL, Cambridge: 1988 scans of 361 beams, 7 min, 374 m",
        f"C. Stachniss; {_BENCHMARK}",
    ),
)


def find_dataset(name: str) -> Dataset:
    """Return the dataset of this name; raises ArgumentError, with the names that there are."""
    names = [dataset.name for dataset in DATASETS]
    if name not in names:
        near = difflib.get_close_matches(name, names, 1)
        meant = f"; did you mean {near[0]}?" if near else ""
        raise ArgumentError("name", ", ".join(names), f"{name!r}{meant}")
    return DATASETS[names.index(name)]


def fetch_dataset(name: str, folder: str | Path = ".", *, url: str | None = None) -> Path:
    """Get a dataset, unless it is there already; its SHA-256 is checked before it appears under its name.

    Parameters
    ----------
    name : str
        One of those in `DATASETS`.
    folder : str or Path
        Output folder; created if missing.
    url : str, optional
        Base URL of the files; if not given, the environment variable `MIRROR`, or else `PUBLIC`.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    ArgumentError
        There is no dataset of this name.
    DatasetError
        The file cannot be got, or it is not the one that it should be.
    OutputError
        The folder cannot be written.
    """
    dataset = find_dataset(name)
    file = Path(folder) / dataset.file
    if file.is_file() and file.stat().st_size == dataset.size and compute_digest(file) == dataset.sha256:
        return file
    source = f"{(url or os.environ.get(MIRROR) or PUBLIC).rstrip('/')}/{dataset.file}"
    with OutputFolder(folder) as out:
        _retrieve(source, dataset, out.file(dataset.file))
    return file


def _retrieve(source: str, dataset: Dataset, file: Path) -> None:
    """Write the file at an URL, if it is the right one."""
    try:
        with urlopen(source, timeout=_TIMEOUT_S) as answer, file.open("wb") as copy:
            shutil.copyfileobj(answer, copy)
    except (OSError, HTTPException, ValueError) as error:
        raise DatasetError(f"{source}: cannot be got: {getattr(error, 'reason', error)}") from None
    if (digest := compute_digest(file)) != dataset.sha256:
        raise DatasetError(f"{source}: expected the file of SHA-256 {dataset.sha256}, got {digest}")
