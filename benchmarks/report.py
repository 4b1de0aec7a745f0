"""Tables in Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Sequence


def table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Markdown table; numbers are shown with four significant digits."""
    lines = [head, ["---"] * len(head), *([_text(cell) for cell in row] for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _text(cell: object) -> str:
    if not isinstance(cell, float):
        return str(cell)
    return f"{cell:.0f}" if abs(cell) >= 1000 else f"{cell:.4g}"


def show(title: str, head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Print a section with a table, and return it."""
    section = f"## {title}\n\n{table(head, rows)}"
    print(f"\n{section}", flush=True)
    return section
