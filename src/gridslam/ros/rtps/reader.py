"""A reader: puts fragments together, asks for what is missing, and delivers samples in their order (8.4.12)."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from typing import Final, final

from gridslam.ros.rtps.endpoints import Guid, RemoteEndpoint, Sample, Send
from gridslam.ros.rtps.qos import Qos
from gridslam.ros.rtps.wire import Data, encode_acknack, encode_nack_frag

RELATED: Final = (0x0083, 0x800F)
"""Identity of a related sample: of DDS-RPC, and of eProsima before."""

_FIRST_BASES: Final = {b"\1\x0f": 0}
"""Base of the first acknowledgement by vendor, where it is not 1: eProsima's writers answer only to 0 before their next
heartbeat, 3 s later. The standard has 1 as the least (8.3.5.5)."""

_STATUS: Final = 0x71
_MAX_SAMPLE_BYTES: Final = 1 << 26
_MAX_ASSEMBLIES: Final = 8
_MAX_FRAGMENTS: Final = 1 << 16
_MAX_PENDING: Final = 4096
_MAX_MISSING: Final = 256


class _Assembly:
    """A sample of which fragments have come."""

    __slots__ = ("buffer", "count", "missing", "size")

    def __init__(self, data: Data) -> None:
        self.size = data.fragment_size
        self.count = -(-data.size // data.fragment_size)
        self.buffer = bytearray(data.size)
        self.missing = set(range(1, self.count + 1))

    def add(self, data: Data) -> bool:
        """Add fragments; return whether the sample is complete."""
        at = (data.fragment - 1) * self.size
        end = min(at + len(data.payload), len(self.buffer))
        if data.fragment_size != self.size or at >= len(self.buffer):
            return False
        self.buffer[at:end] = data.payload[: end - at]
        whole = (end - at) // self.size + (end == len(self.buffer) and (end - at) % self.size != 0)
        self.missing.difference_update(range(data.fragment, data.fragment + whole))
        return not self.missing


class _Proxy:
    """A writer, and what has come of it."""

    __slots__ = ("assemblies", "endpoint", "expected", "has_begun", "heartbeats", "pending", "prefix")

    def __init__(self, endpoint: RemoteEndpoint) -> None:
        self.endpoint = endpoint
        self.prefix = endpoint.guid[:12]
        self.expected = 1
        self.has_begun = False
        self.heartbeats = -1
        self.pending: dict[int, Sample | None] = {}  # None: it will not come
        self.assemblies: OrderedDict[int, _Assembly] = OrderedDict()


@final
class Reader:
    """A reader of one topic; the participant's lock protects it.

    Parameters
    ----------
    guid : bytes
        Its GUID.
    topic, type_name : str
        As DDS has them.
    qos : Qos
        What it asks for.
    send : callable
        Sends submessages.
    handle : callable
        Called with each sample, without the lock.

    Attributes
    ----------
    writers : dict
        Matched writers by GUID.
    """

    def __init__(
        self, guid: Guid, topic: str, type_name: str, qos: Qos, send: Send, handle: Callable[[Sample], None]
    ) -> None:
        self.guid, self.topic, self.type_name, self.qos, self.handle = guid, topic, type_name, qos, handle
        self.writers: dict[Guid, _Proxy] = {}
        self._entity = guid[12:]
        self._send = send
        self._count = 0  # of all acknowledgements: a writer that was lost and found again ignores smaller ones

    def match(self, endpoint: RemoteEndpoint) -> None:
        """Add a writer."""
        if endpoint.guid in self.writers:
            return
        proxy = self.writers[endpoint.guid] = _Proxy(endpoint)
        if self._is_reliable(proxy):
            self._acknowledge(proxy, _FIRST_BASES.get(endpoint.vendor, 1), [], final=False)

    def unmatch(self, guid: Guid) -> None:
        """Remove a writer."""
        self.writers.pop(guid, None)

    def on_data(self, guid: Guid, data: Data, vendor: bytes) -> list[Sample]:
        """Take a sample or fragments of one; return the samples that can be delivered."""
        proxy = self.writers.get(guid)
        if proxy is None or self._is_old(proxy, data.sequence):
            return []
        payload = data.payload
        if data.fragment:
            whole = self._assemble(proxy, data)
            if whole is None:
                return []
            payload = whole
        status = data.parameters.get(_STATUS)
        related = next((data.parameters[name][0] for name in RELATED if name in data.parameters), b"")
        is_gone = data.is_key or (status is not None and bool(status[0][-1:] > b"\0"))
        sample = Sample(payload, guid, data.sequence, vendor, related[:24], is_gone)
        if not self._is_reliable(proxy):
            proxy.expected = data.sequence + 1
            return [sample]
        if not proxy.has_begun and not self.qos.latched:
            proxy.expected = data.sequence  # before the first heartbeat: what was before does not matter
            proxy.has_begun = True
        if len(proxy.pending) < _MAX_PENDING:
            proxy.pending[data.sequence] = sample
        return self._deliver(proxy)

    def on_heartbeat(self, guid: Guid, first: int, last: int, count: int, *, final: bool) -> list[Sample]:
        """Ask for what is missing; return what can be delivered as older samples are gone."""
        proxy = self.writers.get(guid)
        if proxy is None or not self._is_reliable(proxy) or count <= proxy.heartbeats:
            return []
        proxy.heartbeats = count
        if not proxy.has_begun:
            proxy.has_begun = True
            skips = proxy.endpoint.qos.latched and not self.qos.latched
            proxy.expected = last + 1 if skips else max(first, 1)
        proxy.expected = max(proxy.expected, first)
        proxy.pending = {number: sample for number, sample in proxy.pending.items() if number >= proxy.expected}
        for number in [number for number in proxy.assemblies if number < proxy.expected]:
            del proxy.assemblies[number]
        found = self._deliver(proxy)
        end = min(last + 1, proxy.expected + _MAX_MISSING)
        missing = [number for number in range(proxy.expected, end) if number not in proxy.pending]
        partial = [number for number in missing if number in proxy.assemblies]
        for number in partial:
            lacking = sorted(proxy.assemblies[number].missing)
            self._count += 1
            message = encode_nack_frag(self._entity, guid[12:], number, lacking, self._count)
            self._send([message], proxy.prefix, proxy.endpoint.address)
        requested = [number for number in missing if number not in proxy.assemblies]
        if requested or partial or not final:
            self._acknowledge(proxy, proxy.expected, requested, final=True)
        return found

    def on_gap(self, guid: Guid, start: int, end: int, others: list[int]) -> list[Sample]:
        """Wait no longer for samples from `start` to before `end`, and others."""
        proxy = self.writers.get(guid)
        if proxy is None or not self._is_reliable(proxy):
            return []
        if start <= proxy.expected < end:
            proxy.expected = end
        for number in (*range(max(start, proxy.expected), min(end, proxy.expected + _MAX_PENDING)), *others):
            if number >= proxy.expected:
                proxy.pending.setdefault(number, None)
        return self._deliver(proxy)

    def _is_reliable(self, proxy: _Proxy) -> bool:
        return self.qos.reliable and proxy.endpoint.qos.reliable

    def _is_old(self, proxy: _Proxy, sequence: int) -> bool:
        return sequence < proxy.expected or sequence in proxy.pending

    def _deliver(self, proxy: _Proxy) -> list[Sample]:
        found = []
        while proxy.expected in proxy.pending:
            sample = proxy.pending.pop(proxy.expected)
            proxy.assemblies.pop(proxy.expected, None)
            proxy.expected += 1
            if sample is not None:
                found.append(sample)
        return found

    def _assemble(self, proxy: _Proxy, data: Data) -> bytes | None:
        """Add a fragment; return the payload when it is complete."""
        if not 0 < data.size <= min(_MAX_SAMPLE_BYTES, _MAX_FRAGMENTS * data.fragment_size):
            return None
        assembly = proxy.assemblies.get(data.sequence)
        if assembly is None:
            assembly = proxy.assemblies[data.sequence] = _Assembly(data)
            if len(proxy.assemblies) > _MAX_ASSEMBLIES:
                proxy.assemblies.popitem(last=False)
        if not assembly.add(data):
            return None
        proxy.assemblies.pop(data.sequence, None)
        return bytes(assembly.buffer)

    def _acknowledge(self, proxy: _Proxy, base: int, missing: list[int], *, final: bool) -> None:
        self._count += 1
        message = encode_acknack(self._entity, proxy.endpoint.guid[12:], base, missing, self._count, final=final)
        self._send([message], proxy.prefix, proxy.endpoint.address)
