"""The hot loops: stateless functions over arrays, compiled where possible, in plain NumPy otherwise.

`backend` is the module in use: `_compiled` (C++), or its NumPy twin `reference` where no compiler was at hand when the
package was installed, or where the environment variable GRIDSLAM_KERNELS is ``reference``. Both have the same functions
with the same arguments; bounds are the caller's contract.
"""

from __future__ import annotations

import os
import warnings
from typing import Any

from gridslam.kernels.reference_maps import MOST_BEAM_CELLS, NO_ROOM, OUTSIDE
from gridslam.kernels.reference_update import FARTHEST, FREE_CELLS, PAGE, TILE, UNKNOWN

__all__ = [
    "FARTHEST",
    "FREE_CELLS",
    "MOST_BEAM_CELLS",
    "NO_ROOM",
    "OUTSIDE",
    "PAGE",
    "TILE",
    "UNKNOWN",
    "backend",
    "compiled",
]


def _load() -> tuple[Any, bool]:
    if os.environ.get("GRIDSLAM_KERNELS", "compiled") != "reference":
        try:
            from gridslam.kernels import _compiled  # type: ignore[attr-defined]

            return _compiled, True
        except ImportError:
            warnings.warn(
                "gridslam was installed without its compiled kernels and runs on NumPy, many times slower; "
                "install a C++20 compiler and reinstall",
                RuntimeWarning,
                stacklevel=2,
            )
    from gridslam.kernels import reference

    return reference, False


backend, compiled = _load()
