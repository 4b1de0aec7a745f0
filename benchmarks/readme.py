"""Write the README's figures from the committed results: python benchmarks/readme.py.

The table between `<!-- figures -->` and `<!-- end of figures -->` is made here; the figures in the sentences below it
stand in `results/quoted.json`, each with the commit that it is of.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any, NamedTuple

from record import RESULTS
from report import table

__all__ = ["block", "main", "quoted", "strangers"]

README = Path(__file__).resolve().parents[1] / "README.md"
BLOCK = re.compile(r"(?<=<!-- figures -->\n).*?(?=<!-- end of figures -->)", re.DOTALL)
_FIGURE = re.compile(r"[\d,.]*\d(?: to [\d.]*\d)? (?:m|km|deg|ms|s|MB|scans)\b")
_LOGS = {"intel": "Intel", "aces": "ACES"}


class _Row(NamedTuple):
    """A row of the table for each log: what it is of, and how a figure is told."""

    name: str
    key: str
    form: str
    tells_worst: bool = False


_ROWS = (
    _Row("translation", "translation_m", "{:.4f} m", tells_worst=True),
    _Row("rotation", "rotation_deg", "{:.3f} deg"),
    _Row("worst single relation", "worst_relation_m", "{:.3f} m"),
    _Row("CPU time", "cpu_s", "{:.1f} s"),
    _Row("peak memory", "peak_mb", "{:.0f} MB"),
)


def block() -> str:
    """The generated part of the README: what was measured on what, and the table."""
    present, others = _read("present.json"), _read("others.json")
    seeds = {variant["seeds"] for variants in present["logs"].values() for variant in variants.values()}
    assert len(seeds) == 1, f"logs were measured with different numbers of seeds: {seeds}"
    ratio = present["ratio"]
    changes = [
        f"{_LOGS[log]} {variants['gridslam']['translation_m']:.2f} times the error and "
        f"{variants['gridslam']['cpu_s']:.2f} times the CPU time"
        for log, variants in ratio["logs"].items()
    ]
    head = ["", "gridslam", "filter only", *(system["name"] for system in others["systems"].values())]
    rows = [_cells(log, row, present, others) for log in _LOGS for row in _ROWS]
    machine = present["machine"]
    load = machine["load, yardstick"].partition(",")[0]
    return (
        f"Commit {present['commit'][:7]}, {seeds.pop()} seeds; {machine['machine']}, at a load of {load}.\n"
        f"Beside commit {ratio['to']}: {'; '.join(changes)}.\n\n{table(head, rows)}\n"
    )


def quoted() -> list[str]:
    """Figures that sentences of the README tell."""
    return [text for figure in _read("quoted.json")["figures"] for text in figure["told"]]


def strangers(section: str) -> list[str]:
    """Figures with a unit in a section of the README, outside its table, that no committed result has."""
    others = _read("others.json")
    known = set(quoted())
    for published in others["published"]:
        known |= {f"{published[f'{log}_m']:{form}} m" for log in _LOGS for form in (".3f", ".4f")}
    sentences = " ".join(BLOCK.sub("", section).split())
    return [figure for figure in _FIGURE.findall(sentences) if figure not in known]


def main() -> None:
    """Write the block into the README."""
    text = README.read_text(encoding="utf-8")
    assert BLOCK.search(text), "the README has no <!-- figures --> ... <!-- end of figures -->"
    README.write_text(BLOCK.sub(lambda _: block(), text), encoding="utf-8")


def _read(name: str) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((RESULTS / name).read_text(encoding="utf-8"))
    return found


def _cells(log: str, row: _Row, present: dict[str, Any], others: dict[str, Any]) -> list[str]:
    own = [present["logs"][log][variant] for variant in ("gridslam", "filter")]
    systems = [system[log] for system in others["systems"].values()]
    return [
        f"{_LOGS[log]}, {row.name}",
        *(_make_writable(row, figures) for figures in own),
        *(_other(row, s) for s in systems),
    ]


def _make_writable(row: _Row, figures: dict[str, Any]) -> str:
    figure = figures[row.key]
    if not isinstance(figure, dict):
        return row.form.format(figure)
    if row.tells_worst:
        return f"{row.form.format(figure['mean'])} ({row.form.format(figure['worst']).split()[0]})"
    return row.form.format(figure["worst" if row.key == "worst_relation_m" else "mean"])


def _other(row: _Row, figures: dict[str, Any]) -> str:
    """As it was told: its digits are not ours."""
    return f"{figures[row.key]} {row.form.rpartition(' ')[2]}" if row.key in figures else ""


if __name__ == "__main__":
    main()
