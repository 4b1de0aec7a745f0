"""Films: frames of one size, written as an animation that repeats and a still."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from panels import GAP, HEAD, Panel
from PIL import Image, ImageDraw

from gridslam.viz.canvas import FAINT, OCCUPIED, UNKNOWN, Colour, font

DOCS = Path(__file__).parents[1]
FRAME_MS, HOLD_MS = 90, 1800
"""How long a frame is shown, and one at which something has happened."""


class Film:
    """Frames of one size and how long each is shown; the still is the frame chosen last."""

    def __init__(self, name: str, key: Sequence[tuple[str, Colour]], quality: int = 62) -> None:
        self.name, self.key = name, key
        self.frames: list[Image.Image] = []
        self.durations: list[int] = []
        self.still = 0
        self.quality = quality

    def add(self, panels: Sequence[Panel], hold: bool = False) -> None:
        """Add a frame of panels side by side, their heads above, and the key below; hold one that matters."""
        width = sum(panel.page.width + GAP for panel in panels) + GAP
        height = HEAD + max(panel.page.height for panel in panels) + 34
        page = Image.new("RGB", (width, height), UNKNOWN)
        draw, x = ImageDraw.Draw(page), GAP
        for panel in panels:
            draw.text((x, 27), panel.head, fill=OCCUPIED, font=font(17, 1.0), anchor="ls")
            page.paste(panel.page, (x, HEAD))
            x += panel.page.width + GAP
        x = GAP
        for name, colour in self.key:
            draw.rectangle((x, height - 21, x + 20, height - 13), fill=colour)
            draw.text((x + 28, height - 12), name, fill=FAINT, font=font(15, 1.0), anchor="ls")
            x += 56 + round(font(15, 1.0).getlength(name))
        self.frames.append(page)
        self.durations.append(HOLD_MS if hold else FRAME_MS)

    def save(self) -> None:
        """Write the animation, which repeats, and its still."""
        path = DOCS / "animations" / f"{self.name}.webp"
        first, *others = self.frames
        first.save(
            path, save_all=True, append_images=others, duration=self.durations, loop=0, quality=self.quality, method=4
        )
        still = self.frames[self.still].quantize(128, Image.Quantize.MAXCOVERAGE, kmeans=3, dither=Image.Dither.NONE)
        still.save(DOCS / "_static" / "stills" / f"{self.name}.png", optimize=True)
        print(
            f"{path.name}: {len(self.frames)} frames, {sum(self.durations) / 1000:.1f} s, {path.stat().st_size} bytes"
        )
