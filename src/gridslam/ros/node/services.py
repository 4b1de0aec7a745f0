"""Shared by the transports: viewers, the save service, and shutdown."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TypeAlias

from gridslam.errors import GridslamError
from gridslam.io.output import OutputFolder
from gridslam.ros.node.core import NodeCore
from gridslam.ros.node.messages import Level

__all__ = ["ViewerOpener", "check_folder", "close_node", "describe_topics", "save_results"]

ViewerOpener: TypeAlias = Callable[[NodeCore], AbstractContextManager[object]]
"""Opens the viewers of a core: a context entered before the core starts and left after it has stopped."""


def check_folder(out: Path | None) -> None:
    """Raise OutputError if results cannot be written, before the run rather than after it."""
    if out is not None:
        with OutputFolder(out):
            pass


def describe_topics(scans: str, core: NodeCore) -> str:
    """List the subscriptions of a node."""
    base, odom = core.settings.base_frame, core.settings.odom_frame
    return f"waiting for scans on {scans}" + ("" if core.settings.odometry == "none" else f" and for {base} in {odom}")


def save_results(core: NodeCore, folder: Path) -> tuple[bool, str]:
    """Save; return whether it succeeded, and a message."""
    try:
        document = core.save(folder)
    except GridslamError as error:
        return False, str(error)
    return True, f"{document['scans']['read']} scans: {folder.resolve()}"


def close_node(core: NodeCore, out: Path | None, log: Callable[[Level, str], None]) -> None:
    """Stop the node, and write its map to `out` if given and if there is a map."""
    session = core.close()
    if out is not None and session is not None:
        log(Level.OK, f"writing {session.log.scan_count} scans to {out.resolve()}")
        session.save(out)
