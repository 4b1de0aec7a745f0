"""What the transports share: who looks on, the service that saves, and the end."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TypeAlias

from gridslam.errors import GridslamError
from gridslam.ros.core import NodeCore

__all__ = ["Watch", "closed", "saved"]

Watch: TypeAlias = Callable[[NodeCore], AbstractContextManager[object]]
"""Entered with the core before it is started, and left when it has ended: where those who look on come in."""


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
