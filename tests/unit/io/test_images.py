"""Images are opened in one place: of few formats, whatever their names are, and of bounded sides."""

from __future__ import annotations

import struct
import zlib

import numpy as np
import pytest
from PIL import Image

from gridslam.errors import InputError
from gridslam.io.images import LONGEST_SIDE_PX, open_image
from gridslam.io.maps import read_map
from support.fuzz_images import MAP_YAML
from support.house import PACKAGE

EPS = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 50 50\n%%EndComments\nnewpath\nshowpage\n%%EOF\n"


def test_only_one_module_lets_pillow_open_files():
    found = {path for path in PACKAGE.rglob("*.py") if "Image.open" in path.read_text(encoding="utf-8")}
    assert found == {PACKAGE / "io" / "images.py"}


@pytest.mark.parametrize("name", ["map.eps", "map.pgm", "map.png"])
def test_a_map_never_starts_a_program(tmp_path, monkeypatch, name):
    """Pillow asks `gs` to draw an EPS, whatever its file is called."""
    program = tmp_path / "gs"
    program.write_text(f"#!/bin/sh\ntouch '{tmp_path / 'started'}'\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    (tmp_path / name).write_bytes(EPS)
    (tmp_path / "map.yaml").write_text(MAP_YAML.replace("map.pgm", name))
    with pytest.raises(InputError, match=f"{name}: expected an image, got: cannot identify"):
        read_map(tmp_path / "map.yaml")
    assert not (tmp_path / "started").exists()


@pytest.mark.parametrize("form", ["WEBP", "TGA", "ICO", "PCX"])
def test_other_formats_are_refused(tmp_path, form):
    Image.fromarray(np.zeros((16, 16), np.uint8)).convert("RGB").save(tmp_path / "map.png", form)
    with pytest.raises(InputError, match=r"map\.png: expected an image"), open_image(tmp_path / "map.png", 1):
        pass


@pytest.mark.parametrize("size", [(1, 10**8), (10**8, 1), (LONGEST_SIDE_PX + 1, 2)])
def test_a_side_that_no_map_has_is_refused_before_anything_is_decoded(tmp_path, size):
    def chunk(kind: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    header = chunk(b"IHDR", struct.pack(">IIBBBBB", *size, 8, 0, 0, 0, 0))
    (tmp_path / "map.png").write_bytes(b"\x89PNG\r\n\x1a\n" + header + chunk(b"IDAT", b"") + chunk(b"IEND", b""))
    (tmp_path / "map.yaml").write_text(MAP_YAML.replace("map.pgm", "map.png"))
    with pytest.raises(InputError, match=f"at most 65536 pixels a side, got {size[0]} x {size[1]}"):
        read_map(tmp_path / "map.yaml")


def test_a_large_image_that_python_would_decode_is_refused(tmp_path):
    """A million pixels take Pillow a second where a PGM's largest value is not 255, and 20 ms where it is."""
    head = b"P5\n4000 3000\n100\n"
    (tmp_path / "map.pgm").write_bytes(head)
    with (
        pytest.raises(InputError, match="at most 10000000 pixels in this encoding"),
        open_image(tmp_path / "map.pgm", 1),
    ):
        pass
    (tmp_path / "map.pgm").write_bytes(head.replace(b"100", b"255"))
    with open_image(tmp_path / "map.pgm", 1) as image:
        assert image.size == (4000, 3000)


def test_a_bitmap_encoded_in_runs_is_refused_before_it_is_decoded(tmp_path):
    """Pillow decodes it in Python, two bytes at a time, whatever comes of them: 30 s for one column of 65,536."""
    header = struct.pack("<IiiHHIIiiII", 40, 1, 65536, 1, 8, 1, 4, 0, 0, 256, 0)
    palette = bytes(1024)
    start = 14 + len(header) + len(palette)
    file = b"BM" + struct.pack("<IHHI", start + 4, 0, 0, start) + header + palette + b"\x05\x01\x00\x01"
    (tmp_path / "map.bmp").write_bytes(file)
    with pytest.raises(InputError, match="decoded fast, such as that of a PNG, got bmp_rle"):
        open_image(tmp_path / "map.bmp", 1).__enter__()
