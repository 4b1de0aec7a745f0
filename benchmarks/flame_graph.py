"""Where the time of a run goes, as a picture: python benchmarks/flame_graph.py OUT.svg -- map LOG -o FOLDER ...

A timer interrupts the command every few milliseconds of CPU, and the stack of gridslam's own functions is counted. A
box is a function, as wide as its share of all samples with what it calls, which stands on it; kernels belong to the
function that calls them. A sample is taken at the next bytecode, so a kernel counts as its caller.
"""

from __future__ import annotations

import html
import signal
import sys
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from types import FrameType

import gridslam
from gridslam.cli.main import main as run_command

__all__ = ["main"]

_PACKAGE = str(Path(gridslam.__file__).parent)
_PERIOD_S = 0.001
_WIDTH, _ROW, _LETTER, _LEAST = 1200.0, 17.0, 6.3, 1.5  # pixels; boxes below the least width are left out
_COLOURS = ("#e8743b", "#f0a04b", "#f3c567", "#d9885b", "#eeb479")

_Stack = tuple[str, ...]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command that follows `--`, and write the picture; returns the command's status."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    if len(given) < 3 or given[1] != "--":
        print(__doc__)
        return 2
    samples: Counter[_Stack] = Counter()

    def take_sample(number: int, frame: FrameType | None) -> None:
        samples[_stack(frame)] += 1

    signal.signal(signal.SIGPROF, take_sample)
    signal.setitimer(signal.ITIMER_PROF, _PERIOD_S, _PERIOD_S)
    sys.argv = ["gridslam", *given[2:]]
    try:
        run_command()
        status = 0
    except SystemExit as exit_:
        status = int(exit_.code or 0)
    signal.setitimer(signal.ITIMER_PROF, 0)
    words = " ".join(Path(word).name if "/" in word else word for word in sys.argv)
    Path(given[0]).write_text(draw(samples, f"{words}: {time.process_time():.2f} s of CPU"), encoding="utf-8")
    return status


def _stack(frame: FrameType | None) -> _Stack:
    """gridslam's functions on the stack, outermost first; at its top the one of another package that runs, if any."""
    names: list[str] = []
    while frame is not None:
        code = frame.f_code
        if code.co_filename.startswith(_PACKAGE):
            module = code.co_filename[len(_PACKAGE) + 1 : -3].replace("/", ".")
            names.append(f"{module}.{code.co_qualname if sys.version_info >= (3, 11) else code.co_name}")
        elif not names and not code.co_filename.startswith("<"):
            names.append(f"({Path(code.co_filename).stem}.{code.co_name})")
        frame = frame.f_back
    return tuple(reversed(names))


def draw(samples: Counter[_Stack], title: str) -> str:
    """The picture as SVG; the samples that a box holds are its tooltip."""
    total = samples.total()
    widths: Counter[_Stack] = Counter()
    for stack, count in samples.items():
        for depth in range(1, len(stack) + 1):
            widths[stack[:depth]] += count
    left: dict[_Stack, float] = {(): 0.0}
    boxes: list[str] = []
    deepest = 0
    for stack in sorted(widths):  # a box comes after the one on which it stands
        x = left[stack[:-1]]
        width = _WIDTH * widths[stack] / total
        left[stack[:-1]] = x + width
        left[stack] = x
        if width >= _LEAST:
            deepest = max(deepest, len(stack))
            boxes.append(_box(stack, x, width, widths[stack] / total))
    height = _ROW * (deepest + 2)
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{_WIDTH:g}" height="{height:g}" '
            f'font-family="monospace" font-size="10.5">',
            f'<text x="4" y="12">{html.escape(title)}</text>',
            f'<g transform="translate(0 {height:g})">',
            *boxes,
            "</g>",
            "</svg>\n",
        ]
    )


def _box(stack: _Stack, x: float, width: float, share: float) -> str:
    name = stack[-1]
    text = name.rpartition(".")[2] if name.endswith(")") else ".".join(name.split(".")[-2:])
    shown = html.escape(text[: int((width - 4) / _LETTER)]) if width > 4 * _LETTER else ""
    y = -_ROW * (len(stack) + 0.2)
    colour = _COLOURS[sum(map(ord, name)) % len(_COLOURS)]
    return (
        f'<g><title>{html.escape(name)}: {share:.1%}</title><rect x="{x:.1f}" y="{y:.1f}" width="{width:.1f}" '
        f'height="{_ROW - 1:g}" fill="{colour}"/><text x="{x + 2:.1f}" y="{y + 12:.1f}">{shown}</text></g>'
    )


if __name__ == "__main__":
    sys.exit(main())
