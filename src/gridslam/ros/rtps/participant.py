"""A participant: sockets, discovery, and the readers and writers of a process."""

from __future__ import annotations

import os
import selectors
import struct
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Final, final

from gridslam.ros.rtps import discovery
from gridslam.ros.rtps.endpoints import ANY, Guid, RemoteEndpoint, RemoteParticipant, Sample
from gridslam.ros.rtps.qos import Qos, find_mismatch
from gridslam.ros.rtps.reader import Reader
from gridslam.ros.rtps.sockets import Sockets
from gridslam.ros.rtps.wire import (
    ACKNACK,
    DATA,
    DATA_FRAG,
    GAP,
    HEARTBEAT,
    NACK_FRAG,
    VENDOR,
    Address,
    Submessage,
    WireError,
    encode_data,
    encode_message,
    encode_parameters,
    parse_data,
    parse_message,
    parse_sequence,
    parse_set,
)
from gridslam.ros.rtps.writer import Writer

_SPDP_WRITER, _SPDP_READER = b"\0\1\0\xc2", b"\0\1\0\xc7"
_PUBLICATIONS, _SUBSCRIPTIONS = (b"\0\0\3\xc2", b"\0\0\3\xc7"), (b"\0\0\4\xc2", b"\0\0\4\xc7")
_HAS_PUBLICATIONS, _HAS_SUBSCRIPTIONS = (4, 8), (16, 32)
"""Writer and reader of each: their entities, and their bits among the builtin endpoints."""

_ANNOUNCE_S: Final = 2.0
_FIRST_ANNOUNCEMENTS: Final = 5  # sooner, one after the other
_TIMER_S: Final = 0.05
_MAX_DATAGRAM: Final = 1 << 16
_MAX_PARTICIPANTS, _MAX_ENDPOINTS = 1000, 50_000
_LINGER_S: Final = 1.0

Mismatch = Callable[[str, str, str], None]


@final
class Participant:
    """A participant; one thread receives, and calls the readers' handlers.

    Parameters
    ----------
    domain : int
        ROS_DOMAIN_ID, from 0 to 232.
    interfaces : sequence of str
        Network interfaces by name or address; if empty, all.
    peers : sequence of str
        Addresses of other machines that multicast does not reach.
    name : str
        Of the participant, for tools.
    on_mismatch : callable
        Called with "quality of service" or "message type", a topic, and why no sample passes; with "message" for a
        sample at which a handler raised an exception.

    Attributes
    ----------
    guid : bytes
        Its GUID.

    Raises
    ------
    ConfigurationError
        An interface does not exist, or no port is free.
    """

    def __init__(
        self,
        domain: int,
        interfaces: Sequence[str] = (),
        name: str = "gridslam",
        on_mismatch: Mismatch = lambda *unused: None,
        peers: Sequence[str] = (),
    ) -> None:
        self._sockets = Sockets(domain, interfaces, peers)
        self._prefix = VENDOR + struct.pack("<I", os.getpid()) + os.urandom(6)
        self.guid: Guid = self._prefix + b"\0\0\1\xc1"
        self._on_mismatch = on_mismatch
        addresses = self._sockets.discovery, self._sockets.user
        self._announcement = discovery.encode_participant(self._prefix, domain, name, *addresses)
        self._lock = threading.RLock()
        self._closed = threading.Event()
        self._others: dict[bytes, RemoteParticipant] = {}
        self._known: dict[Guid, tuple[RemoteEndpoint, bool]] = {}  # and whether it is a reader
        self._writers: dict[bytes, Writer] = {}
        self._readers: dict[bytes, Reader] = {}
        self._filters: dict[Guid, Callable[[RemoteEndpoint], bool]] = {}
        self._entities = 0
        self._announced = 0
        self._due_s = 0.0
        qos = Qos(latched=True, depth=10_000)
        self._publications, self._subscriptions = (
            self._add_builtin(entities, qos, of_reader=of_reader)
            for entities, of_reader in ((_PUBLICATIONS, False), (_SUBSCRIPTIONS, True))
        )
        self._thread = threading.Thread(target=self._run, name="gridslam-dds", daemon=True)

    def add_writer(
        self,
        topic: str,
        type_name: str,
        qos: Qos,
        only: Callable[[RemoteEndpoint], bool] = lambda reader: True,
        user_data: bytes = b"",
    ) -> Writer:
        """Add a writer and announce it; `only` decides which of the readers that fit get its samples."""
        with self._lock:
            writer = Writer(self._next_guid(3), topic, type_name, qos, self._send)
            self._writers[writer.guid[12:]] = writer
            self._filters[writer.guid] = only
            self._announce(self._publications, writer, user_data)
        return writer

    def add_reader(
        self, topic: str, type_name: str, qos: Qos, handle: Callable[[Sample], None], user_data: bytes = b""
    ) -> Reader:
        """Add a reader and announce it."""
        with self._lock:
            reader = Reader(self._next_guid(4), topic, type_name, qos, self._send, handle)
            self._readers[reader.guid[12:]] = reader
            self._announce(self._subscriptions, reader, user_data)
        return reader

    def write(self, writer: Writer, payload: bytes, parameters: Sequence[tuple[int, bytes]] = ()) -> None:
        """Write a sample with its encapsulation header, and parameters of its inline QoS."""
        with self._lock:
            sequence = writer.store(payload, encode_parameters(parameters) if parameters else b"")
            datagrams = writer.datagrams(sequence)
        writer.send_all(datagrams)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def close(self) -> None:
        """Wait a little until all is acknowledged, state that the participant is gone, and close the sockets."""
        if self._thread.ident is not None and not self._closed.is_set():
            end_s = time.monotonic() + _LINGER_S
            while time.monotonic() < end_s and not all(writer.is_acknowledged for writer in self._writers.values()):
                time.sleep(0.01)
            key, parameters = discovery.encode_gone(self.guid)
            gone = encode_data(_SPDP_READER, _SPDP_WRITER, 2, key, parameters, is_key=True)
            self._broadcast(gone)
        self._closed.set()
        if self._thread.ident is not None:
            self._thread.join(timeout=5)
        self._sockets.close()

    def _run(self) -> None:
        selector = selectors.DefaultSelector()
        for one in self._sockets.receivers:
            selector.register(one, selectors.EVENT_READ)
        while not self._closed.is_set():
            ready = selector.select(_TIMER_S)
            for key, _ in ready:
                with suppress(OSError):
                    while not self._closed.is_set():
                        data, source = key.fileobj.recvfrom(_MAX_DATAGRAM)  # type: ignore[union-attr]
                        self._take(data, source[0])
            with self._lock:
                self._run_timers(time.monotonic())
        selector.close()

    def _take(self, data: bytes, source: str) -> None:
        """Process a datagram, then call the handlers."""
        found: list[tuple[Reader, Sample]] = []
        try:
            with self._lock:
                for submessage in parse_message(data):
                    own = submessage.prefix == self._prefix
                    if not own and submessage.destination in (self._prefix, bytes(12)):
                        found += self._process(submessage, source)
        except (ValueError, IndexError, OverflowError, struct.error):  # WireError, too: of who knows whom
            pass
        for reader, sample in found:
            self._call(reader, sample)

    def _call(self, reader: Reader, sample: Sample) -> None:
        try:
            reader.handle(sample)
        except Exception as error:  # the thread goes on, whatever the bytes were
            self._on_mismatch("message", reader.topic, f"a sample is left out: {type(error).__name__}: {error}")

    def _process(self, submessage: Submessage, source: str) -> list[tuple[Reader, Sample]]:
        """Process a submessage; return the samples that can be delivered, with their readers."""
        if (other := self._others.get(submessage.prefix)) is not None:
            other.seen_s = time.monotonic()
        if submessage.kind in (DATA, DATA_FRAG):
            return self._take_data(submessage, source)
        if submessage.kind in (HEARTBEAT, GAP):
            return self._take_state(submessage)
        if submessage.kind in (ACKNACK, NACK_FRAG):
            self._take_acknowledgement(submessage)
        return []

    def _take_data(self, submessage: Submessage, source: str) -> list[tuple[Reader, Sample]]:
        data = parse_data(submessage)
        guid = submessage.prefix + data.writer
        if data.writer == _SPDP_WRITER:
            self._take_participant(Sample(data.payload, guid, 0, submessage.vendor), data.is_key, source)
            return []
        readers = self._addressed(data.reader, guid)
        return [(reader, one) for reader in readers for one in reader.on_data(guid, data, submessage.vendor)]

    def _take_state(self, submessage: Submessage) -> list[tuple[Reader, Sample]]:
        """Take what a writer states of its samples: which there are, or which will not come."""
        guid = submessage.prefix + bytes(submessage.body[4:8])
        found = []
        for reader in self._addressed(bytes(submessage.body[:4]), guid):
            if submessage.kind == HEARTBEAT:
                samples = reader.on_heartbeat(guid, *_heartbeat(submessage), final=bool(submessage.flags & 2))
            else:
                samples = reader.on_gap(guid, *_gap(submessage))
            found += [(reader, sample) for sample in samples]
        return found

    def _take_acknowledgement(self, submessage: Submessage) -> None:
        body, order = submessage.body, submessage.order
        guid, writer = submessage.prefix + bytes(body[:4]), self._writers.get(bytes(body[4:8]))
        if writer is None:
            return
        if submessage.kind == ACKNACK:
            base, missing, at = parse_set(body, 8, order)
            (count,) = struct.unpack_from(f"{order}I", body, at)
            writer.on_acknack(guid, base, missing, count, final=bool(submessage.flags & 2))
        else:
            _, missing, _ = parse_set(body, 16, order, wide=False)
            writer.on_nack_frag(guid, parse_sequence(body, 8, order), missing)

    def _addressed(self, entity: bytes, writer: Guid) -> list[Reader]:
        """Readers that a submessage is for."""
        if entity != ANY:
            reader = self._readers.get(entity)
            return [] if reader is None else [reader]
        return [reader for reader in self._readers.values() if writer in reader.writers]

    def _run_timers(self, now_s: float) -> None:
        for writer in self._writers.values():
            writer.remind(now_s)
        if now_s >= self._due_s:
            self._announced += 1
            self._due_s = now_s + (_ANNOUNCE_S if self._announced > _FIRST_ANNOUNCEMENTS else 0.2)
            self._broadcast(encode_data(_SPDP_READER, _SPDP_WRITER, 1, self._announcement))
            for prefix in [prefix for prefix, one in self._others.items() if now_s - one.seen_s > one.lease_s]:
                self._lose(prefix)

    def _broadcast(self, submessage: bytes) -> None:
        self._sockets.announce(encode_message(self._prefix, [submessage]))

    def _send(self, submessages: Sequence[bytes], prefix: bytes, address: Address) -> None:
        self._sockets.send(encode_message(self._prefix, submessages, prefix), address)

    # Discovery

    def _take_participant(self, sample: Sample, is_key: bool, source: str) -> None:
        if not sample.payload:
            return
        if is_key:
            parameters, _ = discovery.decode_list(sample.payload)
            self._lose(parameters.get(discovery.PARTICIPANT_GUID, [b""])[0][:12])
            return
        found = discovery.parse_participant(sample.payload, sample.vendor, source)
        known = self._others.get(found.prefix)
        if found.prefix == self._prefix or (known is None and len(self._others) >= _MAX_PARTICIPANTS):
            return
        if known is not None:
            known.seen_s = time.monotonic()
            return
        self._others[found.prefix] = found
        self._send([encode_data(_SPDP_READER, _SPDP_WRITER, 1, self._announcement)], found.prefix, found.discovery)
        for (writer, reader), (writes, reads) in (
            (_PUBLICATIONS, _HAS_PUBLICATIONS),
            (_SUBSCRIPTIONS, _HAS_SUBSCRIPTIONS),
        ):
            qos = Qos(latched=True)
            if found.endpoints & reads:
                endpoint = RemoteEndpoint(found.prefix + reader, "", "", qos, found.discovery)
                self._writers[writer].match(endpoint)
            if found.endpoints & writes:
                endpoint = RemoteEndpoint(found.prefix + writer, "", "", qos, found.discovery, vendor=found.vendor)
                self._readers[reader].match(endpoint)

    def _lose(self, prefix: bytes) -> None:
        """Forget a participant with its endpoints."""
        if self._others.pop(prefix, None) is None:
            return
        builtin = [prefix + entity for entity in (*_PUBLICATIONS, *_SUBSCRIPTIONS)]
        for guid in [*(guid for guid in self._known if guid[:12] == prefix), *builtin]:
            self._forget(guid)

    def _forget(self, guid: Guid) -> None:
        self._known.pop(guid, None)
        for writer in self._writers.values():
            writer.unmatch(guid)
        for reader in self._readers.values():
            reader.unmatch(guid)

    def _add_builtin(self, entities: tuple[bytes, bytes], qos: Qos, *, of_reader: bool) -> Writer:
        """Add the writer and the reader that exchange publications or subscriptions."""
        writer, reader = entities
        self._writers[writer] = Writer(self._prefix + writer, "", "", qos, self._send)

        def handle(sample: Sample) -> None:
            with self._lock, suppress(WireError, struct.error):
                self._take_endpoint(sample, of_reader=of_reader)

        self._readers[reader] = Reader(self._prefix + reader, "", "", qos, self._send, handle)
        return self._writers[writer]

    def _take_endpoint(self, sample: Sample, *, of_reader: bool) -> None:
        if sample.is_gone:
            if len(sample.payload) > 4:
                parameters, _ = discovery.decode_list(sample.payload)
                self._forget(parameters.get(discovery.ENDPOINT_GUID, [b""])[0])
            return
        endpoint = discovery.parse_endpoint(sample.payload, self._others, of_reader=of_reader)
        is_new = endpoint is not None and endpoint.guid not in self._known
        if endpoint is None or (is_new and len(self._known) >= _MAX_ENDPOINTS):
            return
        self._known[endpoint.guid] = endpoint, of_reader
        mine: Mapping[bytes, Writer | Reader] = self._writers if of_reader else self._readers
        for own in list(mine.values()) if is_new else ():
            self._match(own, endpoint)

    def _match(self, own: Writer | Reader, other: RemoteEndpoint) -> None:
        """Match an endpoint with one of another program, or report why no sample passes."""
        if not own.topic or own.topic != other.topic:
            return
        reads = isinstance(own, Reader)
        if own.type_name != other.type_name:
            if reads:
                problem = f"a publisher sends {other.type_name}, this node expects {own.type_name}"
                self._on_mismatch("message type", own.topic, problem)
        elif reads or self._filters[own.guid](other):
            if policy := find_mismatch(*((other.qos, own.qos) if reads else (own.qos, other.qos))):
                who = "a publisher offers less" if reads else "a subscriber asks for more"
                problem = f"{who} {policy} than this node, so no message passes"
                self._on_mismatch("quality of service", own.topic, problem)
                return
            own.match(other)

    def _announce(self, announcer: Writer, own: Writer | Reader, user_data: bytes) -> None:
        """Announce an endpoint, and match it with those that are known."""
        ends = own.guid, own.topic, own.type_name, own.qos
        sequence = announcer.store(discovery.encode_endpoint(*ends, self._sockets.user, user_data))
        announcer.send_all(announcer.datagrams(sequence))
        for endpoint, is_reader in list(self._known.values()):
            if is_reader is isinstance(own, Writer):
                self._match(own, endpoint)

    def _next_guid(self, kind: int) -> Guid:
        self._entities += 1
        return self._prefix + struct.pack(">I", self._entities)[1:] + bytes([kind])


def _heartbeat(submessage: Submessage) -> tuple[int, int, int]:
    """First and last sequence number, and count."""
    body, order = submessage.body, submessage.order
    (count,) = struct.unpack_from(f"{order}I", body, 24)
    return parse_sequence(body, 8, order), parse_sequence(body, 16, order), count


def _gap(submessage: Submessage) -> tuple[int, int, list[int]]:
    """First sequence number of a gap, the one after it, and others."""
    end, others, _ = parse_set(submessage.body, 16, submessage.order)
    return parse_sequence(submessage.body, 8, submessage.order), end, others
