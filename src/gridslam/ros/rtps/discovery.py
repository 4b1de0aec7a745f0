"""Discovery data as parameter lists: of participants (SPDP) and of endpoints (SEDP), sections 8.5 and 9.6.2.2."""

from __future__ import annotations

import struct
import time
from collections.abc import Mapping, Sequence
from typing import Final

from gridslam.ros.rtps.endpoints import Guid, RemoteEndpoint, RemoteParticipant
from gridslam.ros.rtps.qos import PARTITION, Qos, parse_qos
from gridslam.ros.rtps.wire import (
    VENDOR,
    VERSION,
    Address,
    Parameters,
    WireError,
    encode_locator,
    encode_parameters,
    parse_locator,
    parse_parameters,
)

LEASE_S: Final = 10
PL_CDR_LE: Final = b"\0\3\0\0"
PARTICIPANT_GUID, ENDPOINT_GUID = 0x50, 0x5A
_STATUS: Final = 0x71
_TOPIC, _TYPE, _USER_DATA, _NAME = 0x05, 0x07, 0x2C, 0x62
_LEASE, _DOMAIN, _VERSION, _VENDOR, _ENDPOINTS = 0x02, 0x0F, 0x15, 0x16, 0x58
_LOCATOR, _USER_LOCATOR, _DISCOVERY_LOCATOR = 0x2F, 0x31, 0x32
_REPRESENTATION: Final = 0x73
_BUILTIN: Final = 0x3F  # announcer and detector of participants, publications and subscriptions
_DEFAULT_LEASE_S: Final = 100.0
_MAX_TEXT: Final = 512


def encode_participant(
    prefix: bytes, domain: int, name: str, discovery: Sequence[Address], user: Sequence[Address]
) -> bytes:
    """Return the payload by which a participant announces itself; ROS's enclave is its user data."""
    values = [
        (_VERSION, VERSION),
        (_VENDOR, VENDOR),
        (PARTICIPANT_GUID, prefix + b"\0\0\1\xc1"),
        (_DOMAIN, struct.pack("<I", domain)),
        (_ENDPOINTS, struct.pack("<I", _BUILTIN)),
        (_LEASE, struct.pack("<iI", LEASE_S, 0)),
        (_NAME, _text(name)),
        (_USER_DATA, _octets(b"enclave=/;")),
        *((_DISCOVERY_LOCATOR, encode_locator(address)) for address in discovery),
        *((_USER_LOCATOR, encode_locator(address)) for address in user),
    ]
    return PL_CDR_LE + encode_parameters(values)


def encode_endpoint(
    guid: Guid, topic: str, type_name: str, qos: Qos, user: Sequence[Address], user_data: bytes = b""
) -> bytes:
    """Return the payload by which a reader or writer is announced."""
    values = [
        (ENDPOINT_GUID, guid),
        (PARTICIPANT_GUID, guid[:12] + b"\0\0\1\xc1"),
        (_TOPIC, _text(topic)),
        (_TYPE, _text(type_name)),
        (_REPRESENTATION, struct.pack("<Ihxx", 1, 0)),
        *qos.parameters(),
        (_USER_DATA, _octets(user_data)),
        *((_LOCATOR, encode_locator(address)) for address in user),
    ]
    return PL_CDR_LE + encode_parameters(values)


def encode_gone(guid: Guid) -> tuple[bytes, bytes]:
    """Return payload and inline QoS that state that a participant is gone."""
    key = PL_CDR_LE + encode_parameters([(PARTICIPANT_GUID, guid)])
    return key, encode_parameters([(0x70, guid), (_STATUS, b"\0\0\0\3")])


def decode_list(payload: bytes) -> tuple[dict[int, list[bytes]], str]:
    """Return the parameters of a payload, and its byte order; raises WireError."""
    if len(payload) < 4 or payload[1] not in (2, 3):
        raise WireError("no parameter list")
    order = "<" if payload[1] == 3 else ">"
    return parse_parameters(memoryview(payload), 4, order)[0], order


def parse_participant(payload: bytes, vendor: bytes, source: str) -> RemoteParticipant:
    """Return the participant that announces itself, from an address; raises WireError or struct.error."""
    parameters, order = decode_list(payload)
    guid = _guid(parameters, PARTICIPANT_GUID)
    lease_s = _DEFAULT_LEASE_S
    if _LEASE in parameters:
        seconds, fraction = struct.unpack_from(f"{order}iI", parameters[_LEASE][0])
        lease_s = min(seconds + fraction * 2.0**-32, 1e9)
    endpoints = struct.unpack_from(f"{order}I", parameters.get(_ENDPOINTS, [b"\0\0\0\0"])[0])[0]
    discovery = _best(parameters, _DISCOVERY_LOCATOR, order, source)
    user = _best(parameters, _USER_LOCATOR, order, source)
    if discovery is None:
        raise WireError("a participant without an address of UDP on IPv4")
    vendor = parameters.get(_VENDOR, [vendor])[0][:2]
    now_s = time.monotonic()
    return RemoteParticipant(guid[:12], vendor, discovery, user or discovery, lease_s, now_s, endpoints)


def parse_endpoint(
    payload: bytes, participants: Mapping[bytes, RemoteParticipant], *, of_reader: bool
) -> RemoteEndpoint | None:
    """Return an announced endpoint; None if its participant is unknown, or it is in a partition.

    Raises WireError or struct.error.
    """
    parameters, order = decode_list(payload)
    guid = _guid(parameters, ENDPOINT_GUID)
    participant = participants.get(guid[:12])
    if participant is None:
        return None
    if _TOPIC not in parameters or _TYPE not in parameters:
        raise WireError("an endpoint without topic or type")
    topic, type_name = (_parse_text(parameters[name][0], order) for name in (_TOPIC, _TYPE))
    qos = parse_qos(parameters, order, of_reader=of_reader)
    partitions = struct.unpack_from(f"{order}I", parameters.get(PARTITION, [b"\0\0\0\0"])[0])[0]
    if partitions and _parse_text(parameters[PARTITION][0][4:], order):
        return None
    address = _best(parameters, _LOCATOR, order, participant.user[0]) or participant.user
    user_data = parameters.get(_USER_DATA, [b""])[0][4:]
    return RemoteEndpoint(guid, topic, type_name, qos, address, user_data, participant.vendor)


def _best(parameters: Parameters, name: int, order: str, source: str) -> Address | None:
    """Return the address at which the sender was seen, or the first one."""
    found = [address for value in parameters.get(name, ()) if (address := parse_locator(value, order))]
    return next((address for address in found if address[0] == source), found[0] if found else None)


def _guid(parameters: Parameters, name: int) -> bytes:
    value = parameters.get(name, [b""])[0]
    if len(value) != 16:
        raise WireError("discovery data without a GUID")
    return value


def _text(value: str) -> bytes:
    return _octets(value.encode() + b"\0")


def _octets(value: bytes) -> bytes:
    return struct.pack("<I", len(value)) + value


def _parse_text(value: bytes, order: str) -> str:
    (length,) = struct.unpack_from(f"{order}I", value)
    return value[4 : 4 + min(length, _MAX_TEXT)].rstrip(b"\0").decode(errors="replace")
