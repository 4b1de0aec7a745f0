"""Pictures for notebooks."""

from __future__ import annotations

import io
from typing import TypeAlias

from PIL import Image

Picture: TypeAlias = Image.Image
"""Return type of the functions that draw."""

_MOST_PX = 1000


def encode_png(picture: Picture) -> bytes:
    """Return a picture as PNG, made smaller where a side has more than 1000 px; the picture is changed."""
    picture.thumbnail((_MOST_PX, _MOST_PX))
    file = io.BytesIO()
    picture.save(file, "png")
    return file.getvalue()
