"""What the transports share: who looks on, the service that saves, and the end."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TypeAlias

from gridslam.errors import GridslamError
from gridslam.io.output import OutputFolder
from gridslam.ros.core import NodeCore
from gridslam.ros.messages import Level

__all__ = ["Watch", "check_folder", "closed", "saved", "waiting_for"]

Watch: TypeAlias = Callable[[NodeCore], AbstractContextManager[object]]
"""Entered with the core before it is started, and left when it has ended: where those who look on come in."""


def check_folder(out: Path | None) -> None:
    """Raise OutputError if results cannot be written, before the run rather than after it."""
    if out is not None:
        with OutputFolder(out):
            pass


def waiting_for(scans: str, core: NodeCore) -> str:
    """List the subscriptions of a node."""
    base, odom = core.settings.base_frame, core.settings.odom_frame
    return f"waiting for scans on {scans}" + ("" if core.settings.odometry == "none" else f" and for {base} in {odom}")


def saved(core: NodeCore, folder: Path) -> tuple[bool, str]:
    """Save; return whether it succeeded, and a message."""
    try:
        document = core.save(folder)
    except GridslamError as error:
        return False, str(error)
    return True, f"{document['scans']['read']} scans: {folder.resolve()}"


def closed(core: NodeCore, out: Path | None, say: Callable[[Level, str], None]) -> None:
    """End the node; what it has mapped is written to `out`, where that is given and there is anything."""
    taken = core.close()
    if out is not None and taken is not None:
        say(Level.OK, f"{taken.log.scan_count} scans, which are written to {out.resolve()}")
        taken.save(out)
