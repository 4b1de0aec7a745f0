"""Quality of service: what a writer offers and a reader asks for, and whether they fit (DDS 1.4, section 2.2.3)."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Final, final

from gridslam.ros.rtps.wire import Parameters

DURABILITY, DEADLINE, LIVELINESS, RELIABILITY, HISTORY, PARTITION = 0x1D, 0x23, 0x1B, 0x1A, 0x40, 0x29
_INFINITE: Final = struct.pack("<iI", 0x7FFFFFFF, 0xFFFFFFFF)
_BLOCKING: Final = struct.pack("<iI", 0, 100_000_000)


@final
@dataclass(frozen=True, slots=True)
class Qos:
    """Quality of service of an endpoint.

    Attributes
    ----------
    reliable : bool
        Whether lost samples are sent again.
    latched : bool
        Whether late readers get the last samples (transient local).
    depth : int
        Samples that are kept.
    deadline_s : float, s
        Longest time between two samples that is offered or asked for; infinite: any.
    """

    reliable: bool = True
    latched: bool = False
    depth: int = 10
    deadline_s: float = float("inf")

    def parameters(self) -> list[tuple[int, bytes]]:
        """Return the policies as parameters."""
        return [
            (RELIABILITY, struct.pack("<I", 2 if self.reliable else 1) + _BLOCKING),
            (DURABILITY, struct.pack("<I", int(self.latched))),
            (HISTORY, struct.pack("<II", 0, self.depth)),
            (LIVELINESS, struct.pack("<I", 0) + _INFINITE),
            (DEADLINE, _INFINITE),
        ]


def parse_qos(parameters: Parameters, order: str, *, of_reader: bool) -> Qos:
    """Read the policies of a remote endpoint; those that are missing have DDS's defaults."""
    reliable, latched, deadline_s = not of_reader, False, float("inf")
    if value := parameters.get(RELIABILITY):
        reliable = struct.unpack_from(f"{order}I", value[0])[0] >= 2
    if value := parameters.get(DURABILITY):
        latched = struct.unpack_from(f"{order}I", value[0])[0] >= 1
    if (value := parameters.get(DEADLINE)) and len(value[0]) >= 8:
        seconds, fraction = struct.unpack_from(f"{order}iI", value[0])
        deadline_s = float("inf") if seconds == 0x7FFFFFFF else seconds + fraction * 2.0**-32
    return Qos(reliable, latched, 1, deadline_s)


def find_mismatch(offered: Qos, requested: Qos) -> str:
    """Return the policy of which a writer offers less than a reader asks for; empty if they fit."""
    if requested.latched and not offered.latched:
        return "durability"
    if requested.reliable and not offered.reliable:
        return "reliability"
    return "deadline" if offered.deadline_s > requested.deadline_s else ""
