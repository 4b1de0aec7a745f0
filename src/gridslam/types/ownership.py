"""States of filters that have one owner, and that a step consumes."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TypeVar

from gridslam.errors import ConsumedStateError
from gridslam.serialization import NOT_SAVED

_State = TypeVar("_State", bound="OwnedState")


@dataclass(slots=True, eq=False)
class OwnedState:
    """A state that a step consumes: so two steps never write to one state.

    Attributes
    ----------
    consumed : bool
        Whether a step has taken the contents over.
    """

    consumed: bool = field(default=False, kw_only=True, metadata=NOT_SAVED)

    def take(self: _State) -> _State:
        """Hand the contents over to a new owner; this one raises ConsumedStateError from now on."""
        self.require_owned()
        owner = replace(self)
        self.consumed = True
        return owner

    def require_owned(self) -> None:
        """Raise ConsumedStateError where a step has consumed this state."""
        if self.consumed:
            raise ConsumedStateError
