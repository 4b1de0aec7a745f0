"""Open image files, in this one place, by formats that are safe to read."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from gridslam.errors import InputError
from gridslam.io.limits import require_memory
from gridslam.io.text import open_for_reading, refuse_unreadable

if TYPE_CHECKING:
    from PIL.Image import Image

FORMATS = "PNG", "PPM", "BMP", "TIFF", "JPEG", "GIF"
"""Formats of maps and pictures. Pillow detects fifty by the content, of which EPS starts Ghostscript."""

LONGEST_SIDE_PX = 1 << 16
"""3.3 km in cells of 5 cm. Images are read some rows at a time, of which there are not 10^8."""

_PORTABLE = {"ppm", "ppm_plain"}
_MOST_SLOW_PX = 10_000_000  # a microsecond each: Pillow decodes them in Python


@contextmanager
def open_image(path: str | Path, bytes_per_pixel: int) -> Iterator[Image]:
    """Open an image, whose pixels are not read yet.

    Parameters
    ----------
    path : str or Path
        The file; its name does not matter.
    bytes_per_pixel : int
        What the caller makes of a pixel takes of memory.

    Yields
    ------
    PIL.Image.Image
        The first one, where the file holds several.

    Raises
    ------
    InputError
        There is no such file, it is none of `FORMATS`, has a side longer than `LONGEST_SIDE_PX`, or takes more memory
        than readers are allowed; also for whatever a decoder comes across within the context.
    """
    from PIL import Image  # only readers of images pay for its import

    with open_for_reading(path) as file, warnings.catch_warnings(), refuse_unreadable(path, "an image"):
        warnings.simplefilter("ignore")
        with Image.open(file, formats=FORMATS) as image:
            width, height = image.size
            if max(width, height) > LONGEST_SIDE_PX:
                problem = f"expected an image of at most {LONGEST_SIDE_PX} pixels a side, got {width} x {height}"
                raise InputError(path, problem)
            slow = {tile[0] for tile in getattr(image, "tile", ()) if tile[0] in Image.DECODERS}
            if slow - _PORTABLE:
                problem = "expected an encoding that is decoded fast, such as that of a PNG, got"
                raise InputError(path, f"{problem} {', '.join(sorted(slow))}")
            if slow and width * height > _MOST_SLOW_PX:
                problem = f"expected at most {_MOST_SLOW_PX} pixels in this encoding, got {width} x {height}"
                raise InputError(path, f"{problem} (a PNG, or a PGM whose largest value is 255, may have more)")
            depth = bytes_per_pixel + (4 if len(image.getbands()) > 1 or image.mode == "P" else 1)
            depth += 8 * (image.mode == "I" or image.mode.startswith("I;16"))
            require_memory(path, f"the image of {width} x {height} pixels", width * height * depth)
            yield image
