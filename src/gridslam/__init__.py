"""gridslam: 2D lidar SLAM with grid-based FastSLAM (GMapping), loop closure and GraphSLAM.

Names are imported when they are first used, so that ``import gridslam`` itself is quick. Which there are stands in
``__init__.pyi``, and nowhere else.
"""

from __future__ import annotations

from importlib import import_module

__version__ = "0.1.0"


def _read_homes() -> dict[str, str]:
    """Module of each public name, from the lines ``from MODULE import NAME as NAME`` of the stub beside this file."""
    with open(f"{__file__.rpartition('.')[0]}.pyi", encoding="utf-8") as stub:
        words = [line.split() for line in stub if line.startswith("from ")]
    return {name: module for _, module, _, name, _, _ in words}


_HOMES = _read_homes()

__all__ = sorted([*_HOMES, "__version__"])  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module 'gridslam' has no attribute {name!r}")
    value: object = getattr(import_module(_HOMES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
