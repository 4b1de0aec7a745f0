"""The wire protocol: samples arrive in order and once whatever is lost, late readers get what is latched."""

import random
import struct
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gridslam.errors import ConfigurationError
from gridslam.ros.rtps import wire
from gridslam.ros.rtps.endpoints import RemoteEndpoint
from gridslam.ros.rtps.participant import Participant
from gridslam.ros.rtps.qos import Qos, find_mismatch
from gridslam.ros.rtps.reader import Reader
from gridslam.ros.rtps.sockets import Sockets, find_addresses
from gridslam.ros.rtps.writer import FRAGMENT_BYTES
from support.dds_peer import free_domain
from support.ros_node import until

LOCAL = ["127.0.0.1"]
KIND = "std_msgs::msg::dds_::String_"


@pytest.fixture
def pair():
    """Two participants, and what passes between them."""
    domain = free_domain()
    mismatches = []
    both = [Participant(domain, LOCAL, on_mismatch=lambda *what: mismatches.append(what)) for _ in range(2)]
    for one in both:
        one.start()
    yield (*both, mismatches)
    for one in both:
        one.close()


def payload(number, size=8):
    return b"\0\1\0\0" + struct.pack("<I", number) + bytes(size - 4)


def number_of(sample):
    return struct.unpack_from("<I", sample.payload, 4)[0]


@pytest.mark.parametrize("size", [8, 5 * FRAGMENT_BYTES + 17])
def test_reliable_samples_arrive_in_order_and_once_though_a_fifth_is_lost(pair, monkeypatch, size):
    sender, receiver, _ = pair
    lucky, send = random.Random(size), Sockets.send
    got = []
    receiver.add_reader("rt/a", KIND, Qos(depth=100), got.append)
    writer = sender.add_writer("rt/a", KIND, Qos(depth=100))
    assert until(lambda: bool(writer.readers))
    monkeypatch.setattr(Sockets, "send", lambda self, *values: lucky.random() < 0.2 or send(self, *values))
    count = 100 if size < 100 else 6
    for number in range(count):
        sender.write(writer, payload(number, size))
    assert until(lambda: len(got) >= count), len(got)
    monkeypatch.undo()
    assert until(lambda: writer.is_acknowledged)
    assert list(map(number_of, got)) == list(range(count))
    assert {len(sample.payload) for sample in got} == {size + 4}


def test_a_best_effort_reader_gets_no_repetition(pair, monkeypatch):
    sender, receiver, _ = pair
    got = []
    receiver.add_reader("rt/a", KIND, Qos(reliable=False), got.append)
    writer = sender.add_writer("rt/a", KIND, Qos())
    assert until(lambda: bool(writer.readers))
    send = Sockets.send
    lost = iter([True, False, True, False])
    monkeypatch.setattr(Sockets, "send", lambda self, *values: next(lost) or send(self, *values))
    for number in range(4):
        sender.write(writer, payload(number))
    monkeypatch.undo()
    assert until(lambda: len(got) == 2)
    assert list(map(number_of, got)) == [1, 3]


def test_a_late_reader_gets_the_last_latched_sample_and_nothing_that_is_not(pair):
    sender, receiver, _ = pair
    latched = sender.add_writer("rt/map", KIND, Qos(latched=True, depth=1))
    volatile = sender.add_writer("rt/a", KIND, Qos())
    for number in range(3):
        sender.write(latched, payload(number))
        sender.write(volatile, payload(number))
    maps, others, volatile_maps = [], [], []
    receiver.add_reader("rt/map", KIND, Qos(latched=True), maps.append)
    receiver.add_reader("rt/map", KIND, Qos(), volatile_maps.append)
    receiver.add_reader("rt/a", KIND, Qos(), others.append)
    assert until(lambda: len(latched.readers) == 2 and len(volatile.readers) == 1 and bool(maps))
    sender.write(volatile, payload(3))
    sender.write(latched, payload(4))
    assert until(lambda: bool(others) and bool(volatile_maps) and len(maps) == 2)
    assert [list(map(number_of, one)) for one in (maps, others, volatile_maps)] == [[2, 4], [3], [4]]


def test_what_does_not_fit_is_named(pair):
    sender, receiver, mismatches = pair
    sender.add_writer("rt/a", KIND, Qos(reliable=False))
    receiver.add_reader("rt/a", KIND, Qos(), lambda sample: None)
    receiver.add_reader("rt/a", "std_msgs::msg::dds_::Float64_", Qos(), lambda sample: None)
    assert until(lambda: len(mismatches) >= 3)
    texts = " ".join(" ".join(what) for what in mismatches)
    assert "quality of service rt/a a publisher offers less reliability" in texts
    assert "quality of service rt/a a subscriber asks for more reliability" in texts
    assert f"a publisher sends {KIND}, this node expects std_msgs::msg::dds_::Float64_" in texts


@pytest.mark.parametrize(
    ("offered", "requested", "policy"),
    [
        (Qos(), Qos(), ""),
        (Qos(), Qos(reliable=False), ""),
        (Qos(reliable=False), Qos(), "reliability"),
        (Qos(), Qos(latched=True), "durability"),
        (Qos(latched=True), Qos(), ""),
        (Qos(), Qos(deadline_s=1.0), "deadline"),
    ],
)
def test_a_writer_must_offer_what_a_reader_asks_for(offered, requested, policy):
    assert find_mismatch(offered, requested) == policy


def test_one_that_was_lost_for_a_while_is_found_again_and_lost_samples_are_repeated(pair, monkeypatch):
    """As by a network that was away: only one of the two has noticed it."""
    sender, receiver, _ = pair
    got = []
    receiver.add_reader("rt/a", KIND, Qos(), lambda sample: got.append(number_of(sample)))
    writer = sender.add_writer("rt/a", KIND, Qos())
    assert until(lambda: bool(writer.readers))
    for number in range(5):
        sender.write(writer, payload(number))
    assert until(lambda: len(got) == 5)
    with receiver._lock:
        receiver._lose(sender.guid[:12])
    assert until(lambda: any(reader.writers for reader in receiver._readers.values() if reader.topic), 10.0)
    send, lost = Sockets.send, []

    def lose_first(self, data, address):
        if b"\x15" in data and not lost and self is sender._sockets:
            lost.append(data)
        else:
            send(self, data, address)

    sender.write(writer, payload(5))
    assert until(lambda: got[-1:] == [5])
    monkeypatch.setattr(Sockets, "send", lose_first)
    sender.write(writer, payload(6))
    assert until(lambda: got[-1:] == [6])
    assert lost


def test_interfaces_are_looked_up():
    assert find_addresses(["lo", "127.0.0.1"]) == ["127.0.0.1", "127.0.0.1"]
    assert find_addresses([])
    with pytest.raises(ConfigurationError, match="interface nonsense0: there is no such"):
        find_addresses(["nonsense0"])
    with pytest.raises(ConfigurationError, match="ROS_DOMAIN_ID: expected a number from 0 to 232"):
        Sockets(233)


@settings(max_examples=300, deadline=None)
@given(st.binary(max_size=200), st.integers(0, 255), st.integers(0, 255))
def test_no_bytes_end_the_thread(data, kind, flags):
    """Neither random ones after a header nor a submessage that is cut or wrong."""
    participant = _silent()
    for message in (
        data,
        b"RTPS\2\3\1\x0f" + b"q" * 12 + data,
        wire.encode_message(b"q" * 12, [struct.pack("<BBH", kind, flags, len(data)) + data]),
        wire.encode_message(b"q" * 12, [wire.encode_data(b"\0\1\0\xc7", b"\0\1\0\xc2", 1, b"\0\3\0\0" + data)]),
    ):
        participant._take(message, "127.0.0.1")


_SILENT = []


def _silent():
    if not _SILENT:
        _SILENT.append(Participant(free_domain(), LOCAL))
        _SILENT[0].add_reader("rt/a", KIND, Qos(), lambda sample: None)
    return _SILENT[0]


def test_promises_of_huge_samples_cost_nothing():
    sent = []
    reader = Reader(b"r" * 16, "rt/a", KIND, Qos(), lambda *what: sent.append(what), lambda sample: None)
    writer = b"w" * 16
    reader.match(RemoteEndpoint(writer, "rt/a", KIND, Qos(), ("127.0.0.1", 1)))
    begin = time.thread_time()
    reader.on_heartbeat(writer, 1, 1 << 50, 1, final=False)
    reader.on_gap(writer, 3, 1 << 50, [])
    for sequence in range(2, 40):
        huge = wire.Data(b"", b"", sequence, {}, b"x", False, 1, 1, 1 << 31)
        assert reader.on_data(writer, huge, b"\0\0") == []
    assert time.thread_time() - begin < 0.5
    assert len(sent) == 2  # the first word, and one request of no more than 256 samples


def test_fragments_may_come_in_any_order_and_twice():
    rng = np.random.default_rng(0)
    data = b"\0\1\0\0" + rng.bytes(10_000)
    reader = Reader(b"r" * 16, "rt/a", KIND, Qos(reliable=False), lambda *what: None, lambda sample: None)
    writer = b"w" * 16
    reader.match(RemoteEndpoint(writer, "rt/a", KIND, Qos(), ("127.0.0.1", 1)))
    found = []
    for number in (3, 1, 8, 3, 2, 5, 4, 7, 6, 8):
        message = wire.encode_message(b"", [wire.encode_data_frag(b"", b"", 5, data, number, 1300)])
        part = wire.Data(b"", b"", 5, {}, data[(number - 1) * 1300 : number * 1300], False, number, 1300, len(data))
        assert len(message) > len(part.payload)
        found += reader.on_data(writer, part, b"\0\0")
    assert [sample.payload for sample in found] == [data]
