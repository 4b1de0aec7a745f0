"""The services of a managed node, by which `ros2 lifecycle` and nav2's lifecycle_manager start and stop it.

Source: https://design.ros2.org/articles/node_lifecycle.html and the interfaces of the package lifecycle_msgs.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final, final

from gridslam.io.bags.encoder import Values

_STATES: Final = {
    0: "unknown",
    1: "unconfigured",
    2: "inactive",
    3: "active",
    4: "finalized",
    10: "configuring",
    11: "cleaningup",
    12: "shuttingdown",
    13: "activating",
    14: "deactivating",
    15: "errorprocessing",
}
_ERROR: Final = 15
_REQUESTS: Final = (
    (1, "configure", 1, 10),
    (2, "cleanup", 2, 11),
    (3, "activate", 2, 13),
    (4, "deactivate", 3, 14),
    (5, "shutdown", 1, 12),
    (6, "shutdown", 2, 12),
    (7, "shutdown", 3, 12),
)
"""Transitions that can be asked for: number, label, and the states from and to which they lead."""

_ENDS: Final = {10: (10, 2, 1), 11: (20, 1, 2), 12: (50, 4, 4), 13: (30, 3, 2), 14: (40, 2, 3), _ERROR: (60, 1, 4)}
"""For each state in between the number of the transition that ends it well, and the states after that and a failure."""

_RESULTS: Final = tuple(
    (number + k, label, state, end)
    for state, (number, well, badly) in _ENDS.items()
    for k, (label, end) in enumerate(
        (
            ("transition_success", well),
            ("transition_failure", badly),
            ("transition_error", 4 if state == _ERROR else _ERROR),
        )
    )
)


@final
class LifecycleServices:
    """The state of a managed node, and the answers of its services.

    Parameters
    ----------
    activate : callable
        Called with whether the node becomes active.
    clean_up : callable
        Called when the node is to forget what it has.
    publish : callable
        Called with the values of lifecycle_msgs/TransitionEvent after its stamp at each transition.
    """

    def __init__(
        self, activate: Callable[[bool], None], clean_up: Callable[[], None], publish: Callable[[Values], None]
    ) -> None:
        self._activate = activate
        self._clean_up = clean_up
        self._publish = publish
        self._state = 1

    def services(self) -> dict[str, tuple[str, Callable[[Any], Sequence[Any]]]]:
        """Return type and answer of each service, by its name below the node's."""
        transitions = "lifecycle_msgs/GetAvailableTransitions"
        return {
            "get_state": ("lifecycle_msgs/GetState", lambda request: (_describe(self._state),)),
            "get_available_states": (
                "lifecycle_msgs/GetAvailableStates",
                lambda request: ([_describe(state) for state in _STATES],),
            ),
            "get_available_transitions": (transitions, lambda request: (self._list_transitions(self._state),)),
            "get_transition_graph": (transitions, lambda request: (self._list_transitions(None),)),
            "change_state": ("lifecycle_msgs/ChangeState", lambda request: (self._change(request.transition),)),
        }

    def _list_transitions(self, state: int | None) -> list[Values]:
        return [
            ((number, label), _describe(begin), _describe(end))
            for number, label, begin, end in (*_REQUESTS, *_RESULTS)
            if state in (None, begin)
        ]

    def _change(self, wanted: Any) -> bool:  # noqa: ANN401
        """Make a transition, which is given by its number or its label; return whether it is possible."""
        for number, label, begin, between in _REQUESTS:
            if begin != self._state or not (wanted.id == number or (not wanted.id and wanted.label == label)):
                continue
            self._enter(between, number, label)
            if label == "cleanup":
                self._clean_up()
            else:
                self._activate(label == "activate")
            number, well, _ = _ENDS[between]
            self._enter(well, number, "transition_success")
            return True
        return False

    def _enter(self, state: int, number: int, label: str) -> None:
        """Enter a state, and report the transition to it."""
        before, self._state = self._state, state
        self._publish(((number, label), _describe(before), _describe(state)))


def _describe(state: int) -> Values:
    """Return the fields of lifecycle_msgs/State."""
    return state, _STATES[state]
