"""The report: tables in Markdown, and the figures that have a target."""

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
@dataclass(frozen=True)
class Target:
    """A figure beside the greatest value it may have and what others reach."""

    name: str
    value: float
    limit: float
    peer: str = ""
    gmapping: str = ""
    unit: str = ""

    @property
    def met(self) -> bool:
        return self.value <= self.limit

    def row(self) -> list[str]:
        value, limit = (f"{_text(number)} {self.unit}".strip() for number in (self.value, self.limit))
        return [self.name, value, f"<= {limit}", "yes" if self.met else "**NO**", self.peer, self.gmapping]


@final
@dataclass
class Report:
    """Collects sections, printed as they come, and targets."""

    sections: list[str] = field(default_factory=list)
    targets: list[Target] = field(default_factory=list)

    def add(self, title: str, *paragraphs: str) -> None:
        self.sections.append("\n\n".join([f"## {title}", *paragraphs]))
        print(f"\n{self.sections[-1]}", flush=True)

    def summary(self) -> str:
        """What the targets say, all in one table."""
        if not self.targets:
            return "No figure with a target was measured."
        head = ["figure", "measured", "target", "met", "best peer", "GMapping"]
        return table(head, [target.row() for target in self.targets])
