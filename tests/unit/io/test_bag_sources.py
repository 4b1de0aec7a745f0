"""Bags give the messages that rosbags finds in them, in the order of their recording, whatever form they have."""

import bz2
import importlib
import itertools
import shutil
import sqlite3
import sys
from contextlib import nullcontext

import lz4.frame
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gridslam.errors import InputError
from gridslam.io.bags.chunks import DamageError, merge_chunks
from gridslam.io.bags.source import BagSource
from gridslam.io.limits import limit_memory
from support import ros_bags

zstd = importlib.import_module("compression.zstd" if sys.version_info >= (3, 14) else "backports.zstd")

FORMS = [
    *itertools.product(["ros1"], ["", "bz2", "lz4"]),
    *itertools.product(["db3"], ["", "file", "message"]),
    *itertools.product(["mcap"], ["", "file", "message", "storage"]),
]


def by_rosbags(path):
    from rosbags import rosbag1, rosbag2

    with (rosbag1 if path.suffix == ".bag" else rosbag2).Reader(path) as reader:
        return [(time_ns, connection.topic, bytes(data)) for connection, time_ns, data in reader.messages()]


@pytest.mark.parametrize(("kind", "compression"), FORMS)
def test_messages_are_those_of_rosbags(tmp_path, kind, compression):
    path = ros_bags.write(tmp_path, kind, ros_bags.drive(40.0), compression)  # several chunks
    bag = BagSource(path)
    for topics in (set(bag.topics), {"/odom"}, {"/scan", "/tf_static"}, set(), {"/none"}):
        expected = [message for message in by_rosbags(path) if message[1] in topics]
        assert sorted(bag.messages(topics)) == sorted(expected)
        assert [time_ns for time_ns, _, _ in bag.messages(topics)] == sorted(time_ns for time_ns, _, _ in expected)
    assert {name: topic.messages for name, topic in bag.topics.items()} == {"/scan": 400, "/odom": 801, "/tf_static": 1}
    assert bag.bytes_read == bag.total_bytes > 0
    assert not bag.is_truncated


def split_bag(folder):
    """A bag of two files, with the metadata that lists both."""
    said = ros_bags.drive(2.0)
    whole = ros_bags.write(folder, "db3", said)
    (whole / "log.db3").rename(whole / "log_0.db3")
    text = (whole / "metadata.yaml").read_text()
    assert text.count("- log.db3") == 1
    (whole / "metadata.yaml").write_text(text.replace("- log.db3", "- log_0.db3\n  - log_1.db3"))
    return whole


def test_a_file_of_a_bag_that_is_not_there_is_named(tmp_path):
    folder = split_bag(tmp_path)
    assert BagSource(folder).missing_files == ("log_1.db3",)
    shutil.copy(folder / "log_0.db3", folder / "log_1.db3")
    assert BagSource(folder).missing_files == ()


@given(st.lists(st.lists(st.integers(0, 20), min_size=1, max_size=5), max_size=6))
def test_chunks_are_merged_by_time_and_stay_in_order_within_one_time(chunks):
    messages = [[(time, f"{n}", b"") for time in times] for n, times in enumerate(chunks)]
    given_chunks = sorted(((min(each)[0], each) for each in messages), key=lambda chunk: chunk[0])
    expected = sorted((message for _, each in given_chunks for message in each), key=lambda message: message[0])
    assert list(merge_chunks(given_chunks)) == expected


def test_the_index_of_a_ros1_bag_may_be_wrong(tmp_path):
    path = ros_bags.write(tmp_path, "ros1", ros_bags.drive(40.0), "lz4")
    bag = BagSource(path)
    whole, data = list(bag.messages(bag.topics)), path.read_bytes()
    last_info = data.rindex(b"op=\x06")
    path.write_bytes(data[:last_info] + b"op=\x09" + data[last_info + 4 :])
    with pytest.raises(InputError, match="unknown kind 9"):  # at the very end: some of the index is lost
        BagSource(path)
    found = BagSource(path, keep_truncated=True)
    assert list(found.messages(found.topics)) == whole
    assert found.is_truncated
    place = data.index(b"chunk_pos=")
    path.write_bytes(data[: place + 10] + bytes(8) + data[place + 18 :])
    found = BagSource(path)  # all of the file can be walked through: only the index is wrong
    assert list(found.messages(found.topics)) == whole
    assert not found.is_truncated


def test_a_ros1_bag_that_was_not_closed(tmp_path):
    path = ros_bags.write(tmp_path, "ros1", ros_bags.drive(40.0))
    data = path.read_bytes()
    place = data.index(b"index_pos=") + 10
    path.write_bytes(data[:place] + bytes(8) + data[place + 8 :])
    with pytest.raises(InputError, match=r"not closed.*--keep-truncated"):
        BagSource(path)
    bag = BagSource(path, keep_truncated=True)
    assert bag.is_truncated
    assert sum(1 for _ in bag.messages(bag.topics)) == 1202


@pytest.mark.parametrize("compression", ["", "bz2", "lz4"])
def test_of_a_ros1_bag_that_is_cut_off_all_before_the_cut_is_kept(tmp_path, compression):
    path = ros_bags.write(tmp_path, "ros1", ros_bags.drive(200.0), compression)  # four chunks, compressed one by one
    whole, data = list(BagSource(path).messages({"/odom"})), path.read_bytes()
    before = 0
    for share in (0.4, 0.7, 0.95):
        path.write_bytes(data[: int(share * len(data))])
        with pytest.raises(InputError, match=r"cut off.*--keep-truncated"):
            BagSource(path)
        bag = BagSource(path, keep_truncated=True)
        kept = list(bag.messages({"/odom"}))
        assert kept == whole[: len(kept)]
        assert before < len(kept) < len(whole)
        before = len(kept)


@pytest.mark.parametrize(
    ("kind", "compression", "share"),
    # Compressed chunk by chunk, of which there are three; the page of SQLite that leads to all rows lies at 0.86.
    [
        ("mcap", "", 0.8),
        ("mcap", "storage", 0.8),
        ("mcap", "message", 0.8),
        ("db3", "", 0.95),
        ("db3", "file", 0.95),
        ("db3", "message", 0.95),
    ],
)
def test_of_a_ros2_file_that_is_cut_off_all_before_the_cut_is_kept(tmp_path, kind, compression, share):
    folder = ros_bags.write(tmp_path, kind, ros_bags.drive(150.0), compression)
    whole = list(BagSource(folder).messages({"/odom"}))
    (path,) = (path for path in folder.iterdir() if path.name != "metadata.yaml")
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    with pytest.raises(InputError, match=r"--keep-truncated reads what is there"):
        BagSource(folder)
    bag = BagSource(folder, keep_truncated=True)
    kept = list(bag.messages({"/odom"}))
    assert kept == whole[: len(kept)]
    assert len(whole) / 3 < len(kept) < len(whole)
    assert bag.is_truncated


def test_a_database_that_is_no_bag(tmp_path):
    path = tmp_path / "other.db3"
    with sqlite3.connect(path) as connection:
        connection.execute("CREATE TABLE things (id INTEGER)")
    connection.close()
    with pytest.raises(InputError, match="no such table: topics"):
        BagSource(path)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"#ROSBAG V1.2\n" + bytes(100), r"a ROS 1 bag, .* got one that begins with b'#ROSBAG V1.2"),
        (b"#ROSBAG V2.0\n", "was not closed"),
        (b"#ROSBAG V2.0\n" + b"\xff" * 99, r"damaged or cut off \(there is no record at byte 13"),
    ],
)
def test_what_is_no_ros1_bag(tmp_path, content, message):
    path = tmp_path / "log.bag"
    path.write_bytes(content)
    with pytest.raises(InputError, match=message):
        BagSource(path)


RECURSIVE = "WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM c) SELECT x, 1, x, zeroblob(9) FROM c"


@pytest.mark.parametrize(
    ("sql", "got"),
    [
        (f"CREATE VIEW messages (id, topic_id, timestamp, data) AS {RECURSIVE}", "got .CREATE VIEW"),
        (f"CREATE VIEW Messages (id, topic_id, timestamp, data) AS {RECURSIVE}", "got .CREATE VIEW"),
        ("CREATE VIRTUAL TABLE messages USING fts4(id, topic_id, timestamp, data)", "got .CREATE VIRTUAL TABLE"),
        (
            "CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, "
            "data BLOB AS (zeroblob(1000000000)))",
            "computed columns",
        ),
    ],
)
@pytest.mark.parametrize("keep", [True, False])
def test_a_database_that_computes_its_messages_is_refused(tmp_path, sql, got, keep):
    (path,) = ros_bags.write(tmp_path, "db3", ros_bags.drive(1.0)).glob("*.db3")
    with sqlite3.connect(path) as connection:
        connection.execute("DROP TABLE messages")
        connection.execute(sql)
    connection.close()
    if keep:
        bag = BagSource(path, keep_truncated=True)
        assert not list(bag.messages({"/scan"}))
    else:
        with pytest.raises(InputError, match=got):
            BagSource(path)


@pytest.mark.parametrize(
    "row",
    [
        ("table", "other", "other", 0, f"CREATE VIEW messages (id, topic_id, timestamp, data) AS {RECURSIVE}"),
        ("table", "messages", "messages", 0, f"CREATE/**/VIEW MESSAGES (id, topic_id, timestamp, data) AS {RECURSIVE}"),
        ("table", "messages", "messages", 0, f"CREATE VIEW messages (id, timestamp) AS {RECURSIVE}".encode()),
    ],
)
def test_a_row_of_the_schema_is_what_its_statement_says(tmp_path, row):
    (path,) = ros_bags.write(tmp_path, "db3", ros_bags.drive(1.0)).glob("*.db3")
    with sqlite3.connect(path) as connection:
        connection.execute("DROP TABLE messages")
        connection.execute("PRAGMA writable_schema=ON")
        connection.execute("INSERT INTO sqlite_master VALUES (?, ?, ?, ?, ?)", row)
    connection.close()
    with pytest.raises(InputError, match="expected tables and their indices"):
        BagSource(path)


def test_rows_that_share_bytes_are_not_read_again_and_again(tmp_path):
    """Each of many short rows ends early, so that its data are the megabyte of the schema."""
    (path,) = ros_bags.write(tmp_path, "db3", ros_bags.drive(1.0)).glob("*.db3")
    with sqlite3.connect(path) as connection:
        connection.execute("CREATE TABLE short (id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER)")
        connection.executemany("INSERT INTO short VALUES (?, 1, ?)", [(k, k) for k in range(10_000)])
        connection.execute(f"ALTER TABLE short ADD COLUMN data BLOB DEFAULT x'{'00' * 400_000}'")
        connection.execute("DROP TABLE messages")
        connection.execute("ALTER TABLE short RENAME TO messages")
    connection.close()
    with pytest.raises(InputError, match="more rows than the file has room for"):
        BagSource(path)
    bag = BagSource(path, keep_truncated=True)
    assert sum(len(data) for _, _, data in bag.messages({*bag.topics})) <= path.stat().st_size


def record(content, **fields):
    """A record of a ROS 1 bag."""
    pairs = [name.encode() + b"=" + value for name, value in fields.items()]
    header = b"".join(len(pair).to_bytes(4, "little") + pair for pair in pairs)
    return len(header).to_bytes(4, "little") + header + len(content).to_bytes(4, "little") + content


def packed_ros1(compression, packed, claimed, chunks=1):
    """A ROS 1 bag without indices, whose chunks hold `packed` and claim a size."""
    chunk = record(packed, op=b"\5", compression=compression, size=claimed.to_bytes(4, "little"))
    sizes = {"index_pos": b"\1" + bytes(7), "conn_count": bytes(4), "chunk_count": bytes(4)}
    return b"#ROSBAG V2.0\n" + record(b"", op=b"\3", **sizes) + chunks * chunk


LARGE = record(bytes(10 << 20), op=b"\2", conn=bytes(4), time=bytes(8))


@pytest.mark.parametrize("keep", [True, False])
@pytest.mark.parametrize(
    ("compression", "content", "claimed", "chunks"),
    [
        (b"bz2", bytes(40 << 20), 40 << 20, 1),
        (b"lz4", bytes(10 << 20), 3 << 30, 1),
        (b"bz2", LARGE, len(LARGE), 40),  # small ones, that are many
    ],
    ids=["large", "claims", "many"],
)
def test_chunks_that_unpack_to_far_more_than_the_file_are_refused(
    tmp_path, compression, content, claimed, chunks, keep
):
    packed = bz2.compress(content) if compression == b"bz2" else lz4.frame.compress(content)
    path = tmp_path / "log.bag"
    path.write_bytes(packed_ros1(compression, packed, claimed, chunks))
    with nullcontext() if keep else pytest.raises(InputError, match=r"unpack to more than 33\.6 MB"):
        BagSource(path, keep_truncated=keep)


def test_a_compressed_file_or_message_that_unpacks_to_far_more_is_refused(tmp_path):
    path = tmp_path / "log.db3.zst"
    path.write_bytes(zstd.compress(b"SQLite format 3\0" + bytes(40 << 20)))
    with pytest.raises(InputError, match=r"unpack to more than 33\.6 MB"):
        BagSource(path)
    (path,) = ros_bags.write(tmp_path, "db3", ros_bags.drive(1.0)).glob("*.db3")
    with sqlite3.connect(path) as connection:
        connection.execute("UPDATE messages SET data = ?", (zstd.compress(bytes(20 << 20)),))
    connection.close()
    with pytest.raises(InputError, match=r"unpack to more than 33\.6 MB"):
        list(BagSource(path).messages({"/scan"}))


def test_chunks_that_overlap_in_time_are_held_as_far_as_memory_is_allowed(tmp_path):
    chunks = [(0, [(k, "/scan", bytes(100_000))]) for k in range(30)]
    assert len(list(merge_chunks(chunks))) == 30
    with limit_memory(1_000_000), pytest.raises(DamageError, match="1 MB of --max-memory"):
        list(merge_chunks(chunks))


def test_what_is_no_ros2_bag(tmp_path):
    with pytest.raises(InputError, match=r"without .db3 or .mcap"):
        BagSource(tmp_path)
    (tmp_path / "log.db3").write_bytes(b"something else")
    with pytest.raises(InputError, match="begins with b'something"):
        BagSource(tmp_path)
