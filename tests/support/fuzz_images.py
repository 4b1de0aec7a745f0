"""Images of maps: of every format that Pillow writes, by any name, of odd modes, huge by their headers, or cut off."""

from __future__ import annotations

import io
import os
import struct
import zlib
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path

import numpy as np
from PIL import Image

from gridslam.errors import ArgumentError
from gridslam.io.maps import read_map
from gridslam.localization import KnownMap

MAP_YAML = (
    "image: map.pgm\nresolution: 0.05\norigin: [-1.0, -2.0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
)

_NAMES = ("map.pgm", "map.png", "map.eps", "map.jpg", "map", "map.yaml.png", "map.gif")
_MODES = ("1", "L", "LA", "P", "PA", "RGB", "RGBA", "CMYK", "YCbCr", "I", "F", "I;16", "HSV", "LAB")
_SIDES = (0, 1, 2, 255, 65_535, 65_536, 65_537, 10**6, 10**8, 2**31 - 1, 2**32 - 1)
_EPS = (
    b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 50 50\n%%EndComments\nnewpath\nshowpage\n%%EOF\n",
    b"\xc5\xd0\xd3\xc6" + struct.pack("<7i", 32, 90, 0, 0, 0, 0, 0) + b"\n%!PS-Adobe-3.0 EPSF-3.0\n%%EOF\n",
)


def images(folder: Path) -> Iterator[tuple[str, Callable[..., None], Callable[[Path], object], float]]:
    """Name, the two functions and the weight of the family."""
    cells = np.random.default_rng(0).choice([0, 205, 254], (60, 70)).astype(np.uint8)
    Image.init()
    written: dict[str, bytes] = {}
    for form in sorted(Image.SAVE):
        for mode in _MODES:
            with suppress(Exception):  # of a mode that the format does not have
                image = Image.fromarray(cells).convert("L" if mode == "I;16" else mode)
                image = image.convert("I").convert("I;16") if mode == "I;16" else image
                file = io.BytesIO()
                image.save(file, form)
                written[f"{form} {mode}"] = file.getvalue()
    frames = [Image.fromarray(cells), Image.fromarray(cells.T.copy())]
    for form in ("GIF", "PNG", "TIFF"):
        file = io.BytesIO()
        frames[0].save(file, form, save_all=True, append_images=frames[1:] * 20)
        written[f"{form} frames"] = file.getvalue()
    yield "images", partial(_prepare, written), _read, 2.0


def _prepare(written: dict[str, bytes], to: Path, rng: np.random.Generator) -> None:
    name = _NAMES[rng.integers(len(_NAMES))]
    what = rng.integers(5)
    if what == 0:
        content = _claim(*(int(_SIDES[k]) for k in rng.integers(len(_SIDES), size=2)), rng)
    elif what == 1:
        content = _EPS[rng.integers(len(_EPS))]
    else:
        content = written[sorted(written)[rng.integers(len(written))]]
    if what == 2:
        content = content[: int(rng.integers(1, len(content) + 1))]
    elif what == 3:
        changed = bytearray(content)
        for _ in range(rng.integers(1, 8)):
            changed[rng.integers(min(len(changed), 200))] = rng.integers(256)
        content = bytes(changed)
    (to / name).write_bytes(content)
    if what == 0 and rng.integers(2):
        os.truncate(to / name, len(content) + int(rng.choice([1000, 10**8])))  # zeros that are there
    (to / "map.yaml").write_text(MAP_YAML.replace("map.pgm", name))
    program = to / "bin" / "gs"
    program.parent.mkdir()
    program.write_text(f"#!/bin/sh\ntouch '{to / 'started'}'\n")
    program.chmod(0o755)


def _claim(width: int, height: int, rng: np.random.Generator) -> bytes:
    """An image of a few bytes whose header states these sides."""

    def chunk(kind: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    depth, largest = int(rng.choice([1, 8, 16])), int(rng.choice([1, 100, 255, 65_535]))
    if rng.integers(2):
        sides = struct.pack(">II", width & 0xFFFFFFFF, height & 0xFFFFFFFF)
        header = sides + bytes([depth, int(rng.choice([0, 3, 6])), 0, 0, int(rng.integers(2))])
        content = chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(bytes(1000))) + chunk(b"IEND", b"")
        return b"\x89PNG\r\n\x1a\n" + content
    return b"P%d\n%d %d\n%d\n" % (rng.integers(1, 7), width, height, largest)


def _read(where: Path) -> None:
    os.environ["PATH"] = f"{where / 'bin'}:{os.environ['PATH']}"
    try:
        grid = read_map(where / "map.yaml")
        with suppress(ArgumentError):  # a map without walls, which the command refuses by its file
            KnownMap(grid)
    finally:
        assert not (where / "started").exists(), "Ghostscript was started"
