"""What the transports share: the service that saves, and the end."""

from __future__ import annotations

from pathlib import Path

from gridslam.errors import GridslamError
from gridslam.ros.core import NodeCore

__all__ = ["closed", "saved"]


def saved(core: NodeCore, folder: Path) -> tuple[bool, str]:
    """Save, and tell whether that went well and what came of it."""
    try:
        document = core.save(folder)
    except GridslamError as error:
        return False, str(error)
    return True, f"{document['scans']['read']} scans: {folder.resolve()}"


def closed(core: NodeCore, out: Path | None) -> None:
    """End the node; what it has mapped is written to `out`, where that is given and there is anything."""
    taken = core.close()
    if out is not None and taken is not None:
        taken.save(out)
