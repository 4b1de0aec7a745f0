"""What a file may unpack to, and what readers may hold in memory: one rule for all formats."""

import bz2
import gzip
import os
import resource
import socket
import sys
import zipfile

import numpy as np
import pytest
from PIL import Image

from gridslam.errors import ArgumentError, InputError
from gridslam.io.limits import (
    describe_bytes,
    limit_memory,
    max_memory_bytes,
    require_memory,
)
from gridslam.io.log import open_log
from gridslam.io.maps import read_map
from gridslam.io.sessions.archive_file import read_arrays
from gridslam.io.text import open_for_reading, read_text
from gridslam.io.trajectories import read_tum

LINE = "PARAM laser_front_laser_resolution 1.0 nohost 0\n"


def test_memory_is_limited_within_a_context():
    before = max_memory_bytes()
    require_memory("file", "its content", before)
    with (
        limit_memory(10**6),
        pytest.raises(InputError, match=r"takes 1\.5 MB of memory, more than the 1 MB of --max-m"),
    ):
        require_memory("file", "its content", 1_500_000)
    assert max_memory_bytes() == before
    with pytest.raises(ArgumentError, match="size"), limit_memory(999):
        pass
    assert [describe_bytes(size) for size in (12, 1500, 2 * 10**6, 3 * 10**9)] == ["12 bytes", "1.5 KB", "2 MB", "3 GB"]


@pytest.mark.parametrize(
    ("compress", "filling", "problem"),
    [
        (gzip.compress, b"\n", "blank lines"),
        (bz2.compress, b"\n", "blank lines"),
        (bz2.compress, b" ", "blank lines|a line of"),
        (gzip.compress, b"# none\n", "unpack to more"),
    ],
)
def test_text_that_unpacks_to_far_more_is_refused(tmp_path, monkeypatch, compress, filling, problem):
    monkeypatch.setattr("gridslam.io.limits.ALWAYS_ALLOWED_BYTES", 3 << 20)
    path = tmp_path / "log.clf.z"
    path.write_bytes(compress(LINE.encode()) + 4 * compress(filling * ((1 << 20) // len(filling))))
    with pytest.raises(InputError, match=problem):
        list(open_log(path))


def test_a_sparse_text_file_is_no_text(tmp_path):
    log = tmp_path / "log.clf"
    log.write_text(LINE)
    os.truncate(log, 3 << 30)
    with pytest.raises(InputError, match=r"got binary data|a line of more than"):
        list(open_log(log))
    with pytest.raises(InputError, match=r"at most 67\.1 MB"):
        read_text(log)
    yaml = tmp_path / "map.yaml"
    yaml.write_text("image: map.pgm\n")
    os.truncate(yaml, 3 << 30)
    with pytest.raises(InputError, match=r"at most 65\.5 KB"):
        read_map(yaml)


@pytest.mark.skipif(sys.platform == "win32", reason="no such files there")
def test_pipes_sockets_and_devices_are_refused_by_name(tmp_path):
    os.mkfifo(tmp_path / "pipe")  # to open one waits for a writer
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(tmp_path / "socket"))
        for name in ("pipe", "socket"):
            with pytest.raises(InputError, match=f"{name}: expected a file, got a pipe or a device"):
                open_log(tmp_path / name)
    with pytest.raises(InputError, match="got a pipe or a device"):
        read_tum("/dev/zero")
    with pytest.raises(InputError, match="cannot be opened"):
        open_for_reading("a\0b")


def test_an_archive_that_claims_too_much_is_refused(tmp_path):
    path = tmp_path / "state.npz"
    with path.open("wb") as file:
        np.savez_compressed(file, schema=np.array("a/1"), zeros=np.zeros(10**8, np.uint8))
    with pytest.raises(InputError, match="unpack to more than"):
        read_arrays(path, "a/1", "a state")
    with limit_memory(10**6), pytest.raises(InputError, match="--max-memory"):
        read_arrays(path, "a/1", "a state")


@pytest.mark.parametrize(
    "header",
    [
        "{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000,), }",
        "{'descr': '<f8', 'fortran_order': False, 'shape': (-1,), }",
        "{'descr': '<f8', 'fortran_order': False, 'shape': (2, 2**70), }",
        "{'descr': '|O', 'fortran_order': False, 'shape': (1,), }",
        "{'descr': '<f8', 'fortran_order': False, 'shape': 'a', }",
        "(" * 200,
    ],
)
def test_an_array_whose_header_lies_is_refused(tmp_path, header):
    path = tmp_path / "state.npz"
    text = header.encode().ljust(117) + b"\n"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("schema.npy", b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text + bytes(8))
    with pytest.raises(InputError, match="expected a state"):
        read_arrays(path, "a/1", "a state")


def test_an_image_of_a_few_bytes_and_many_pixels_is_refused_before_it_is_unpacked(tmp_path):
    Image.new("L", (4000, 4000)).save(tmp_path / "map.png")
    text = "image: map.png\nresolution: 0.05\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.2\n"
    (tmp_path / "map.yaml").write_text(text)
    with limit_memory(10**8), pytest.raises(InputError, match=r"4000 x 4000 pixels takes 144 MB of memory"):
        read_map(tmp_path / "map.yaml")
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    read_map(tmp_path / "map.yaml")
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 160_000  # KB
