"""A writer: keeps its last samples, sends them to its readers, and again where a reliable one misses them (8.4.9)."""

from __future__ import annotations

import time
from collections import OrderedDict, defaultdict
from collections.abc import Sequence
from typing import Final, NamedTuple, final

from gridslam.ros.rtps.endpoints import ANY, Guid, RemoteEndpoint, Send
from gridslam.ros.rtps.qos import Qos
from gridslam.ros.rtps.wire import (
    Address,
    encode_data,
    encode_data_frag,
    encode_gap,
    encode_heartbeat,
)

FRAGMENT_BYTES: Final = 32_000
"""Larger samples are sent in fragments: few losses where a network splits datagrams, and few datagrams."""

_PACE_EVERY, _PACE_S = 8, 0.0005  # a pause between fragments, so that they fit into the buffer of a receiver
_HEARTBEAT_S: Final = 0.1
_MAX_HEARTBEAT_S: Final = 2.0
_RESEND_S: Final = 0.03


class _Stored(NamedTuple):
    payload: bytes
    parameters: bytes


class _Proxy:
    """A reader, and what it has acknowledged."""

    __slots__ = ("acked", "count", "due_s", "endpoint", "interval_s", "prefix", "sent_s", "start")

    def __init__(self, endpoint: RemoteEndpoint, start: int) -> None:
        self.endpoint = endpoint
        self.prefix = endpoint.guid[:12]
        self.start = start
        self.acked = start - 1
        self.count = -1
        self.due_s = 0.0
        self.interval_s = _HEARTBEAT_S
        self.sent_s: dict[int, float] = {}


@final
class Writer:
    """A writer of one topic; the participant's lock protects it.

    Parameters
    ----------
    guid : bytes
        Its GUID.
    topic, type_name : str
        As DDS has them.
    qos : Qos
        What it offers; late readers get the last `depth` samples if it is latched.
    send : callable
        Sends submessages.

    Attributes
    ----------
    readers : dict
        Matched readers by GUID.
    """

    def __init__(self, guid: Guid, topic: str, type_name: str, qos: Qos, send: Send) -> None:
        self.guid, self.topic, self.type_name, self.qos = guid, topic, type_name, qos
        self.readers: dict[Guid, _Proxy] = {}
        self._entity = guid[12:]
        self._send = send
        self._last = 0
        self._heartbeats = 0
        self._history: OrderedDict[int, _Stored] = OrderedDict()

    def match(self, endpoint: RemoteEndpoint) -> None:
        """Add a reader; a late one gets what is kept if both are latched."""
        if endpoint.guid in self.readers:
            return
        is_late = self.qos.latched and endpoint.qos.latched
        proxy = _Proxy(endpoint, self._first() if is_late else self._last + 1)
        self.readers[endpoint.guid] = proxy
        if self._is_reliable(proxy):
            self._send_to(proxy, [self._heartbeat(proxy, final=False)])
        elif is_late:
            for sequence in self._history:
                self._resend(proxy, sequence)

    def unmatch(self, guid: Guid) -> None:
        """Remove a reader."""
        self.readers.pop(guid, None)

    def store(self, payload: bytes, parameters: bytes = b"") -> int:
        """Keep a new sample, and return its sequence number."""
        self._last += 1
        self._history[self._last] = _Stored(payload, parameters)
        while len(self._history) > self.qos.depth:
            self._history.popitem(last=False)
        return self._last

    def datagrams(self, sequence: int, only: Guid | None = None) -> list[tuple[list[bytes], bytes, Address]]:
        """Return what is to be sent for a stored sample, to all readers or to one."""
        stored = self._history.get(sequence)
        groups: dict[tuple[bytes, Address], list[_Proxy]] = defaultdict(list)
        for guid, proxy in self.readers.items() if stored is not None else ():
            if only is None or guid == only:
                groups[proxy.prefix, proxy.endpoint.address].append(proxy)
        found = []
        for (prefix, address), proxies in groups.items():
            assert stored is not None
            reader = proxies[0].endpoint.guid[12:] if len(proxies) == 1 else ANY
            parts = [[part] for part in self._encode(reader, sequence, stored)]
            if any(self._is_reliable(proxy) for proxy in proxies):
                beat = encode_heartbeat(reader, self._entity, self._first(), self._last, self._beat(), final=False)
                parts[-1].append(beat)
            found += [(part, prefix, address) for part in parts]
        return found

    def send_all(self, datagrams: Sequence[tuple[list[bytes], bytes, Address]]) -> None:
        """Send datagrams, fragments at a pace; the lock need not be held."""
        for number, (parts, prefix, address) in enumerate(datagrams):
            if number % _PACE_EVERY == _PACE_EVERY - 1 and len(parts[0]) >= FRAGMENT_BYTES:
                time.sleep(_PACE_S)
            self._send(parts, prefix, address)

    def on_acknack(self, guid: Guid, base: int, missing: Sequence[int], count: int, *, final: bool) -> None:
        """Send again what a reader misses."""
        proxy = self.readers.get(guid)
        if proxy is None or count <= proxy.count:
            return
        proxy.count = count
        proxy.interval_s = _HEARTBEAT_S
        if base - 1 > proxy.acked:
            proxy.acked = base - 1
            proxy.sent_s = {sequence: at for sequence, at in proxy.sent_s.items() if sequence >= base}
        for sequence in missing:
            if sequence <= self._last:
                self._resend(proxy, sequence)
        if not final:
            self._send_to(proxy, [self._heartbeat(proxy, final=True)])

    def on_nack_frag(self, guid: Guid, sequence: int, missing: Sequence[int]) -> None:
        """Send fragments again."""
        proxy, stored = self.readers.get(guid), self._history.get(sequence)
        if proxy is None or stored is None:
            return
        parts = self._encode(guid[12:], sequence, stored)
        for number in missing:
            if 0 < number <= len(parts):
                self._send_to(proxy, [parts[number - 1]])
        self._send_to(proxy, [self._heartbeat(proxy, final=False)])

    def remind(self, now_s: float) -> None:
        """Remind reliable readers of what they have not acknowledged, less and less often."""
        for proxy in self.readers.values():
            if self._is_reliable(proxy) and proxy.acked < self._last and now_s >= proxy.due_s:
                proxy.due_s = now_s + proxy.interval_s
                proxy.interval_s = min(2 * proxy.interval_s, _MAX_HEARTBEAT_S)
                self._send_to(proxy, [self._heartbeat(proxy, final=False)])

    @property
    def is_acknowledged(self) -> bool:
        """Whether all reliable readers have all samples."""
        return all(proxy.acked >= self._last for proxy in self.readers.values() if self._is_reliable(proxy))

    def _is_reliable(self, proxy: _Proxy) -> bool:
        return self.qos.reliable and proxy.endpoint.qos.reliable

    def _first(self) -> int:
        return next(iter(self._history), self._last + 1)

    def _beat(self) -> int:
        self._heartbeats += 1
        return self._heartbeats

    def _heartbeat(self, proxy: _Proxy, *, final: bool) -> bytes:
        first = min(max(self._first(), proxy.start), self._last + 1)
        return encode_heartbeat(proxy.endpoint.guid[12:], self._entity, first, self._last, self._beat(), final=final)

    def _encode(self, reader: bytes, sequence: int, stored: _Stored) -> list[bytes]:
        payload, parameters = stored
        if len(payload) <= FRAGMENT_BYTES:
            return [encode_data(reader, self._entity, sequence, payload, parameters)]
        count = -(-len(payload) // FRAGMENT_BYTES)
        return [
            encode_data_frag(reader, self._entity, sequence, payload, number, FRAGMENT_BYTES, parameters)
            for number in range(1, count + 1)
        ]

    def _resend(self, proxy: _Proxy, sequence: int) -> None:
        entity = proxy.endpoint.guid[12:]
        if sequence < proxy.start or sequence not in self._history:
            self._send_to(proxy, [encode_gap(entity, self._entity, sequence, sequence + 1)])
            return
        now_s = time.monotonic()
        if now_s - proxy.sent_s.get(sequence, 0.0) < _RESEND_S:
            return
        proxy.sent_s[sequence] = now_s
        self.send_all(self.datagrams(sequence, proxy.endpoint.guid))

    def _send_to(self, proxy: _Proxy, parts: list[bytes]) -> None:
        self._send(parts, proxy.prefix, proxy.endpoint.address)
