"""Messages of RTPS as bytes: submessages, sets of sequence numbers, parameter lists and locators.

Section numbers are those of the specification (see the package).
"""

from __future__ import annotations

import socket
import struct
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Final, NamedTuple, TypeAlias, final

PAD, ACKNACK, HEARTBEAT, GAP, INFO_TS, INFO_SRC, INFO_DST = 0x01, 0x06, 0x07, 0x08, 0x09, 0x0C, 0x0E
NACK_FRAG, DATA, DATA_FRAG = 0x12, 0x15, 0x16
SENTINEL: Final = 0x01
VENDOR: Final = b"\0\0"  # unknown: the OMG has assigned none
VERSION: Final = b"\x02\x03"
_UDP_V4: Final = 1
_LITTLE: Final = 1
_MAX_BITS: Final = 256

Address: TypeAlias = tuple[str, int]
"""IPv4 address and port."""

Parameters: TypeAlias = Mapping[int, Sequence[bytes]]
"""Values of a parameter list by their identifier."""


class WireError(ValueError):
    """Bytes that are not what RTPS expects."""


@final
class Submessage(NamedTuple):
    """One submessage, and what the message before it states.

    Attributes
    ----------
    kind, flags : int
        Its identifier and flags.
    order : str
        Byte order, "<" or ">".
    body : memoryview
        What follows its header.
    prefix, vendor : bytes
        Prefix (12 bytes) of the sender's GUIDs, and its vendor (2 bytes).
    destination : bytes
        Prefix of the receiver; zeros: everybody.
    """

    kind: int
    flags: int
    order: str
    body: memoryview
    prefix: bytes
    vendor: bytes
    destination: bytes


@final
class Data(NamedTuple):
    """A DATA submessage, or a part of a sample.

    Attributes
    ----------
    reader, writer : bytes
        Entities (4 bytes).
    sequence : int
        Sequence number of the sample.
    parameters : mapping
        Inline QoS.
    payload : bytes
        With its encapsulation header; empty without data.
    is_key : bool
        Whether the payload is only the key of an instance.
    fragment, fragment_size, size : int
        Of a part: number of the first fragment from 1 on, bytes of each fragment, and of the sample; 0 for a whole one.
    """

    reader: bytes
    writer: bytes
    sequence: int
    parameters: Parameters
    payload: bytes
    is_key: bool = False
    fragment: int = 0
    fragment_size: int = 0
    size: int = 0


def parse_message(data: bytes) -> Iterator[Submessage]:
    """Split a datagram (8.3.4); raises WireError where it is none of RTPS."""
    if len(data) < 20 or data[:4] != b"RTPS":
        raise WireError("no RTPS header")
    vendor, prefix = data[6:8], data[8:20]
    destination = bytes(12)
    view = memoryview(data)
    at = 20
    while at + 4 <= len(data):
        kind, flags = data[at], data[at + 1]
        order = "<" if flags & _LITTLE else ">"
        (length,) = struct.unpack_from(f"{order}H", data, at + 2)
        end = at + 4 + length if length or kind in (PAD, INFO_TS) else len(data)  # 9.4.5.1.3: to the end
        if end > len(data):
            raise WireError("a submessage ends after its message")
        body = view[at + 4 : end]
        if kind == INFO_DST:
            destination = bytes(body[:12])
        elif kind == INFO_SRC and len(body) >= 20:
            vendor, prefix = bytes(body[6:8]), bytes(body[8:20])
        else:
            yield Submessage(kind, flags, order, body, prefix, vendor, destination)
        at = end


def parse_data(submessage: Submessage) -> Data:
    """Parse DATA or DATA_FRAG (9.4.5.3, 9.4.5.4); raises WireError, or struct.error where it ends too early."""
    body, order, flags = submessage.body, submessage.order, submessage.flags
    is_part = submessage.kind == DATA_FRAG
    (skip,) = struct.unpack_from(f"{order}H", body, 2)
    fragment, _, fragment_size, size = struct.unpack_from(f"{order}IHHI", body, 20) if is_part else (0, 0, 0, 0)
    if is_part and not (fragment and fragment_size):
        raise WireError("fragments are numbered from 1 on, and not empty")
    at = 4 + skip
    parameters: Parameters = {}
    if flags & 2:
        parameters, at = parse_parameters(body, at, order)
    payload = bytes(body[at:]) if is_part or flags & 0xC else b""
    ends, sequence = (bytes(body[4:8]), bytes(body[8:12])), parse_sequence(body, 12, order)
    return Data(
        *ends, sequence, parameters, payload, bool(flags & (4 if is_part else 8)), fragment, fragment_size, size
    )


def parse_parameters(data: memoryview, at: int, order: str) -> tuple[dict[int, list[bytes]], int]:
    """Parse a parameter list (9.4.2.11); return it and where it ends."""
    found: dict[int, list[bytes]] = {}
    while True:
        if at + 4 > len(data):
            raise WireError("a parameter list without an end")
        name, length = struct.unpack_from(f"{order}HH", data, at)
        at += 4
        if name == SENTINEL:
            return found, at
        if at + length > len(data):
            raise WireError("a parameter ends after its list")
        found.setdefault(name & 0xFFFF, []).append(bytes(data[at : at + length]))
        at += length


def parse_set(body: memoryview, at: int, order: str, *, wide: bool = True) -> tuple[int, list[int], int]:
    """Parse a set of sequence numbers, or of fragment numbers; return its base, its members, and where it ends."""
    base = parse_sequence(body, at, order) if wide else struct.unpack_from(f"{order}I", body, at)[0]
    at += 8 if wide else 4
    (bits,) = struct.unpack_from(f"{order}I", body, at)
    if bits > _MAX_BITS:
        raise WireError(f"a set of {bits} numbers")
    words = (bits + 31) // 32
    bitmap = struct.unpack_from(f"{order}{words}I", body, at + 4)
    members = [base + k for k in range(bits) if bitmap[k // 32] >> (31 - k % 32) & 1]
    return base, members, at + 4 + 4 * words


def parse_sequence(body: memoryview, at: int, order: str) -> int:
    """Return the sequence number at a place."""
    high, low = struct.unpack_from(f"{order}iI", body, at)
    return int(high << 32 | low)


def parse_locator(value: bytes, order: str) -> Address | None:
    """Return the address of a locator; None if it is none of UDP on IPv4."""
    if len(value) < 24:
        return None
    kind, port = struct.unpack_from(f"{order}iI", value)
    return (socket.inet_ntoa(value[20:24]), port) if kind == _UDP_V4 and 0 < port < 65536 else None


def encode_message(prefix: bytes, submessages: Iterable[bytes], destination: bytes | None = None) -> bytes:
    """Join submessages to a datagram, for one participant or for all."""
    parts = [b"RTPS", VERSION, VENDOR, prefix]
    if destination is not None:
        parts.append(_submessage(INFO_DST, 0, destination))
    return b"".join((*parts, *submessages))


def encode_data(
    reader: bytes, writer: bytes, sequence: int, payload: bytes, parameters: bytes = b"", *, is_key: bool = False
) -> bytes:
    """Encode DATA; `parameters` is an encoded list, the inline QoS."""
    flags = (8 if is_key else 4) | (2 if parameters else 0)
    head = struct.pack("<HH", 0, 16) + reader + writer + _pack_sequence(sequence)
    return _submessage(DATA, flags, head, parameters, payload)


def encode_data_frag(
    reader: bytes, writer: bytes, sequence: int, payload: bytes, number: int, size: int, parameters: bytes = b""
) -> bytes:
    """Encode fragment `number` from 1 on, of `size` bytes each, of a payload."""
    part = payload[(number - 1) * size : number * size]
    head = struct.pack("<HH", 0, 28) + reader + writer + _pack_sequence(sequence)
    head += struct.pack("<IHHI", number, 1, size, len(payload))
    return _submessage(DATA_FRAG, 2 if parameters else 0, head, parameters, part)


def encode_heartbeat(reader: bytes, writer: bytes, first: int, last: int, count: int, *, final: bool) -> bytes:
    """Encode HEARTBEAT: which samples there are."""
    body = reader + writer + _pack_sequence(first) + _pack_sequence(last) + struct.pack("<I", count & 0x7FFFFFFF)
    return _submessage(HEARTBEAT, 2 if final else 0, body)


def encode_acknack(
    reader: bytes, writer: bytes, base: int, missing: Sequence[int], count: int, *, final: bool
) -> bytes:
    """Encode ACKNACK: all before `base` has come, of the others those in `missing` are requested."""
    body = reader + writer + _pack_set(base, missing) + struct.pack("<I", count & 0x7FFFFFFF)
    return _submessage(ACKNACK, 2 if final else 0, body)


def encode_nack_frag(reader: bytes, writer: bytes, sequence: int, missing: Sequence[int], count: int) -> bytes:
    """Encode NACK_FRAG: the fragments of a sample that are requested."""
    body = reader + writer + _pack_sequence(sequence) + _pack_set(missing[0], missing, wide=False)
    return _submessage(NACK_FRAG, 0, body + struct.pack("<I", count & 0x7FFFFFFF))


def encode_gap(reader: bytes, writer: bytes, start: int, end: int) -> bytes:
    """Encode GAP: the samples from `start` to before `end` will not come."""
    return _submessage(GAP, 0, reader + writer + _pack_sequence(start) + _pack_set(end, ()))


def encode_parameters(values: Iterable[tuple[int, bytes]]) -> bytes:
    """Encode a parameter list."""
    parts = []
    for name, value in values:
        padded = value + bytes(-len(value) % 4)
        parts.append(struct.pack("<HH", name, len(padded)) + padded)
    return b"".join((*parts, struct.pack("<HH", SENTINEL, 0)))


def encode_locator(address: Address) -> bytes:
    """Encode an address of UDP on IPv4."""
    return struct.pack("<iI", _UDP_V4, address[1]) + bytes(12) + socket.inet_aton(address[0])


def _submessage(kind: int, flags: int, *parts: bytes) -> bytes:
    body = b"".join(parts)
    body += bytes(-len(body) % 4)
    # A longer one extends to the end of its message.
    length = len(body) if len(body) < 0x10000 else 0
    return struct.pack("<BBH", kind, flags | _LITTLE, length) + body


def _pack_sequence(sequence: int) -> bytes:
    return struct.pack("<iI", sequence >> 32, sequence & 0xFFFFFFFF)


def _pack_set(base: int, members: Sequence[int], *, wide: bool = True) -> bytes:
    kept = [member - base for member in members if 0 <= member - base < _MAX_BITS]
    bits = max(kept, default=-1) + 1
    words = [0] * ((bits + 31) // 32)
    for member in kept:
        words[member // 32] |= 1 << (31 - member % 32)
    head = _pack_sequence(base) if wide else struct.pack("<I", base)
    return head + struct.pack(f"<I{len(words)}I", bits, *words)
