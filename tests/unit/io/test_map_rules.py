"""The rules by which map_server and nav2 read a pixel, said once more with exact fractions and without arrays."""

from fractions import Fraction

import numpy as np
import pytest
from PIL import Image

from gridslam.errors import InputError
from gridslam.io.maps import (
    MapDescription,
    MapImage,
    occupancy_percent,
    read_map,
)

THRESHOLDS = [(0.65, 0.196), (0.65, 0.25), (0.51, 0.49), (1.0, 0.0), (0.8, 0.2)]
EVERY = np.arange(256)


def rule(pixel, transparent, mode, negate, occupied_thresh, free_thresh, strict):
    """What a cell is, by the documentation of map_server: 0 to 100, or -1."""
    if mode == "raw":
        return pixel if pixel <= 100 else -1
    if transparent:
        return -1
    p = Fraction(int(pixel) if negate else 255 - int(pixel), 255)
    # The thresholds are what the file says in decimals, so that 51/255 is neither above nor below 0.2.
    occupied, free = Fraction(str(occupied_thresh)), Fraction(str(free_thresh))
    if mode == "trinary" and not strict and not negate and pixel == 205:
        return -1
    if p > occupied:
        return 100
    if p < free:
        return 0
    return -1 if mode == "trinary" else round(100 * (p - free) / (occupied - free))


@pytest.mark.parametrize("strict", [False, True])
@pytest.mark.parametrize("negate", [False, True])
@pytest.mark.parametrize("mode", ["trinary", "scale", "raw"])
@pytest.mark.parametrize("thresholds", THRESHOLDS)
def test_every_pixel_is_read_by_the_rule(thresholds, mode, negate, strict):
    image = MapImage(np.stack([EVERY, EVERY]).astype(float), np.stack([EVERY >= 0, EVERY < 0]))
    description = MapDescription("m.png", 0.05, (0.0, 0.0), negate, *thresholds, mode)
    lower, upper = occupancy_percent(image, description, strict_thresholds=strict)
    assert upper.tolist() == [rule(v, False, mode, negate, *thresholds, strict) for v in EVERY]
    assert lower.tolist() == [rule(v, True, mode, negate, *thresholds, strict) for v in EVERY]


def saved(folder, image, mode="trinary", thresholds=(0.65, 0.25), suffix="png", more=""):
    image.save(folder / f"m.{suffix}")
    occupied, free = thresholds
    (folder / "m.yaml").write_text(
        f"image: m.{suffix}\nmode: {mode}\nresolution: 0.05\norigin: [0, 0, 0]\nnegate: 0\n"
        f"occupied_thresh: {occupied}\nfree_thresh: {free}\n{more}"
    )
    return folder / "m.yaml"


def test_what_nav2_saves_in_trinary_mode_comes_back(tmp_path):
    cells = np.random.default_rng(0).choice([-1, 0, 100], (7, 9))
    pixels = np.select([cells < 0, cells == 0], [205, 254], 0).astype(np.uint8)
    for suffix in ("pgm", "png", "bmp"):
        path = saved(tmp_path, Image.fromarray(pixels), suffix=suffix)  # nav2 writes free_thresh 0.25
        grid = read_map(path)
        assert (np.where(grid.known, np.where(grid.log_odds > 0, 100, 0), -1) == cells[::-1]).all()


def test_what_nav2_saves_in_scale_mode_comes_back(tmp_path):
    cells = np.arange(-1, 101)[None]
    grey = np.where(cells < 0, 127, np.rint(255 * (100 - cells) / 100)).astype(np.uint8)
    alpha = np.where(cells < 0, 0, 255).astype(np.uint8)
    image = Image.fromarray(np.stack([grey, grey, grey, alpha], axis=-1))
    grid = read_map(saved(tmp_path, image, "scale", (1.0, 0.0)))
    assert (grid.known == (cells >= 0)).all()
    np.testing.assert_allclose(grid.probability[0, 1:], 0.01 + 0.0098 * cells[0, 1:], atol=1e-6)


def test_what_nav2_saves_in_raw_mode_comes_back(tmp_path):
    cells = np.arange(-1, 101)[None]
    grid = read_map(saved(tmp_path, Image.fromarray(np.where(cells < 0, 255, cells).astype(np.uint8)), "raw"))
    assert (grid.known == (cells >= 0)).all()
    np.testing.assert_allclose(grid.probability[0, 1:], 0.01 + 0.0098 * cells[0, 1:], atol=1e-6)


def test_colours_are_refused(tmp_path):
    path = saved(tmp_path, Image.fromarray(np.array([[[0, 0, 0], [9, 9, 8]]], np.uint8)))
    with pytest.raises(InputError, match="expected a grey image, got colours in 1 of 2 pixels"):
        read_map(path)


def test_whatever_happens_to_the_files_it_is_told_in_one_line(tmp_path):
    """Bytes changed, cut out and put in: a map, or one line that names the file."""
    rng, good = np.random.default_rng(0), saved(tmp_path, Image.fromarray(np.full((9, 9), 205, np.uint8)))
    files = [good, tmp_path / "m.png"]
    texts, told = [file.read_bytes() for file in files], list[str]()
    for _ in range(400):
        for file, text in zip(files, texts, strict=True):
            changed = bytearray(text)
            for _ in range(rng.integers(0, 4)):
                at, kind = rng.integers(len(changed)), rng.integers(3)
                changed[at : at + (0, 1, 5)[kind]] = rng.integers(32, 127, (2, 1, 0)[kind], np.uint8).tobytes()
            file.write_bytes(changed)
        try:
            read_map(good)
        except InputError as error:
            told.append(str(error))
    assert 100 < len(told) < 400
    assert all(line.startswith(str(tmp_path)) and "\n" not in line for line in told)
