"""What a file may unpack to, and what readers may hold in memory: one rule for all formats."""

from __future__ import annotations

import bz2
import gzip
import os
import socket
import sys
import zipfile

import pytest

from gridslam.errors import InputError
from gridslam.io.log import open_log
from gridslam.io.results.record import read_arrays
from gridslam.io.text import open_for_reading
from gridslam.io.trajectories import read_tum

LINE = "PARAM laser_front_laser_resolution 1.0 nohost 0\n"


@pytest.mark.parametrize(
    ("compress", "filling", "problem"),
    [
        (gzip.compress, b"\n", "blank lines"),
        (bz2.compress, b"\n", "blank lines"),
        (bz2.compress, b" ", "blank lines|a line of"),
        (gzip.compress, b"# none\n", "unpack to more"),
    ],
)
def test_text_that_unpacks_to_far_more_is_refused(tmp_path, compress, filling, problem):
    path = tmp_path / "log.clf.z"
    path.write_bytes(compress(LINE.encode() + (filling * (20 << 20))[: 34 << 20]))
    with pytest.raises(InputError, match=problem):
        list(open_log(path))


@pytest.mark.skipif(sys.platform == "win32", reason="no such files there")
def test_pipes_sockets_and_devices_are_refused_by_name(tmp_path):
    os.mkfifo(tmp_path / "pipe")  # to open one waits for a writer
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(tmp_path / "socket"))
        for name, what in (("pipe", "a pipe"), ("socket", "a socket")):
            with pytest.raises(InputError, match=f"{name}: expected a file, got {what}"):
                open_log(tmp_path / name)
    with pytest.raises(InputError, match="got a device"):
        read_tum("/dev/zero")
    with pytest.raises(InputError, match="cannot be opened"):
        open_for_reading("a\0b")


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
