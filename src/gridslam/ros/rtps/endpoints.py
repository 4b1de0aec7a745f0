"""What is known of the endpoints and participants of others, and how something is sent to them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple, TypeAlias, final

from gridslam.ros.rtps.qos import Qos
from gridslam.ros.rtps.wire import Address

Guid: TypeAlias = bytes
"""Prefix of the participant (12 bytes), then the entity (4 bytes)."""

Send: TypeAlias = Callable[[Sequence[bytes], bytes, Address], None]
"""Sends submessages to the participant with this prefix at an address."""

ANY: Final = bytes(4)
"""All entities of a participant."""


@final
class Sample(NamedTuple):
    """One sample that has come.

    Attributes
    ----------
    payload : bytes
        With its encapsulation header.
    writer : bytes
        GUID (16 bytes) of its writer.
    sequence : int
        Its sequence number.
    vendor : bytes
        Vendor (2 bytes) of the writer.
    related : bytes
        Identity of a related sample: GUID, then sequence number (24 bytes); empty without.
    is_gone : bool
        Whether it states that its instance is disposed or unregistered.
    """

    payload: bytes
    writer: Guid
    sequence: int
    vendor: bytes
    related: bytes = b""
    is_gone: bool = False


@final
class RemoteEndpoint(NamedTuple):
    """A reader or writer of another participant, with the vendor (2 bytes) of that."""

    guid: Guid
    topic: str
    type_name: str
    qos: Qos
    address: Address
    user_data: bytes = b""
    vendor: bytes = b""


@final
@dataclass(slots=True)
class RemoteParticipant:
    """Another participant.

    Attributes
    ----------
    prefix, vendor : bytes
        Prefix (12 bytes) of its GUIDs; its vendor (2 bytes).
    discovery, user : (str, int)
        Addresses for discovery and for samples.
    lease_s, seen_s : float, s
        It is gone if nothing comes of it for the former; when something came last, monotonic.
    endpoints : int
        Bits of its discovery endpoints (9.3.2.11).
    """

    prefix: bytes
    vendor: bytes
    discovery: Address
    user: Address
    lease_s: float
    seen_s: float
    endpoints: int
