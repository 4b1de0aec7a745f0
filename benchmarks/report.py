"""The report: tables in Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import final


def table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Markdown table; numbers are shown with four significant digits."""
    lines = [head, ["---"] * len(head), *([_text(cell) for cell in row] for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _text(cell: object) -> str:
    if not isinstance(cell, float):
        return str(cell)
    return f"{cell:.0f}" if abs(cell) >= 1000 else f"{cell:.4g}"


@final
@dataclass
class Report:
    """Collects sections, printed as they come."""

    sections: list[str] = field(default_factory=list)

    def add(self, title: str, *paragraphs: str) -> None:
        self.sections.append("\n\n".join([f"## {title}", *paragraphs]))
        print(f"\n{self.sections[-1]}", flush=True)
