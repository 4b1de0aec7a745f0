"""On which floor a robot is: it is localized in the map of each."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from gridslam.api.localization import localize
from gridslam.errors import InputError
from gridslam.io.log import Log
from gridslam.localization.state import LocalizationReport

_LEAST_SHARE = 0.3
_CLEAR = 2.0
"""Ratio of the shares of the best floor and of any other one, from which on the floor is reported."""


def compare_floors(open_log: Callable[[], Log], maps: Sequence[Path], **options: Any) -> dict[Path, float]:  # noqa: ANN401
    """Return at which share of the scans of a log the robot is localized in each map; `options` are `localize`'s.

    Raises
    ------
    InputError
        The log or a map cannot be read.
    """
    shares = {}
    for path in maps:
        is_lost: list[bool] = []

        def note(report: LocalizationReport, state: object, seconds: float, is_lost: list[bool] = is_lost) -> None:
            is_lost.append(report.lost)

        try:
            localize(open_log(), path, observers=[note], **options)
        except InputError:
            if not is_lost:
                raise
            is_lost = [True]  # the log does not fit this map
        shares[path] = is_lost.count(False) / len(is_lost)
    return shares


def choose_floor(shares: Mapping[Path, float]) -> tuple[Path | None, str]:
    """Return the map of the floor on which the robot was; None, and the reason, where that is not known."""
    best, *others = sorted(shares, key=lambda path: -shares[path])
    if shares[best] < _LEAST_SHARE:
        return None, f"the robot is localized at less than {_LEAST_SHARE:.0%} of the scans in each"
    if any(shares[best] < _CLEAR * shares[other] for other in others):
        return None, "the maps do not differ enough"
    return best, ""
