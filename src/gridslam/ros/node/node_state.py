"""The state of the node in words: the page, the log and the diagnostics all report this one."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import NamedTuple, final

from gridslam.messages import Level

_SILENT_S = 5.0


class NodeState(NamedTuple):
    """A state of the node.

    Attributes
    ----------
    name : str
        One of "waiting", "running", "paused", "looking", "lost", "no scans", "no transforms", "failed" and
        "finished".
    level : Level
        OK where nothing has to be done.
    text : str
        What people are told; the same as long as the state lasts.
    """

    name: str
    level: Level
    text: str


@final
@dataclass(slots=True)
class NodeFacts:
    """Facts from which the state is found.

    Attributes
    ----------
    now_s : float, s
        Time since 1970.
    awaited : str
        What the node waits for: topic and frames.
    scans_on : str
        The topic of the scans.
    received_s, accepted_s : float or None, s
        When the last scan came, and when the last one that was given to the filter came; None if there was none.
    missing_transform : str
        The transform without which the last scan was refused; empty if that was not the reason.
    is_paused, localizes, lost, looking, is_closed : bool
        Of the node: whether scans are left out on request, it needs a map, the map is known, the robot is lost, or its
        pose has not been found yet, and whether the node has ended.
    failure : str
        Why the filter ended; empty while it runs.
    """

    now_s: float = 0.0
    awaited: str = "scans"
    scans_on: str = "scan"
    received_s: float | None = None
    accepted_s: float | None = None
    missing_transform: str = ""
    is_paused: bool = False
    localizes: bool = False
    lost: bool = False
    looking: bool = False
    is_closed: bool = False
    failure: str = ""


def find_state(facts: NodeFacts) -> NodeState:
    """Return the state of the node: of several that hold the most urgent one."""
    if facts.failure:
        return NodeState("failed", Level.ERROR, f"the filter failed: {facts.failure}")
    if facts.is_closed:
        return NodeState("finished", Level.OK, "finished")
    if facts.is_paused:
        return NodeState("paused", Level.OK, "paused")
    return _find_input_state(facts) or _find_filter_state(facts)


def _find_input_state(facts: NodeFacts) -> NodeState | None:
    """Return the fault of the input; None if scans come."""
    if facts.accepted_s is not None and facts.now_s - facts.accepted_s <= _SILENT_S:
        return None
    still_come = facts.received_s is not None and facts.now_s - facts.received_s <= _SILENT_S
    if still_come and facts.missing_transform:
        return NodeState("no transforms", Level.WARN, facts.missing_transform)
    if facts.accepted_s is None:
        return NodeState("waiting", Level.WARN, f"waiting for {facts.awaited}")
    since = datetime.fromtimestamp(facts.accepted_s).strftime("%H:%M:%S")
    what = "no scan accepted" if still_come else "no scans"
    return NodeState("no scans", Level.WARN, f"{what} on {facts.scans_on} since {since}")


def _find_filter_state(facts: NodeFacts) -> NodeState:
    """Return how the filter is doing."""
    if facts.looking:
        return NodeState("looking", Level.OK, "looking for the robot in the whole map")
    if facts.lost:
        why = "the pose or the map may be wrong" if facts.localizes else "the scan does not match the map"
        return NodeState("lost", Level.WARN, f"lost: {why}")
    return NodeState("running", Level.OK, "localizing" if facts.localizes else "mapping")
