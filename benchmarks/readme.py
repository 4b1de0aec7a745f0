"""Write the README's figures and docs/scoreboard.md from the committed results: python benchmarks/readme.py.

The tables between `<!-- figures -->` and `<!-- end of figures -->` are made here, of `results/suite.json` (by
`scoreboard.py`) and `results/others.json`; the figures in the page's sentences stand in `results/quoted.json`, each
with the commit that it is of.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from measure import RESULTS
from report import table

README = Path(__file__).resolve().parents[1] / "README.md"
SCOREBOARD = README.parent / "docs" / "scoreboard.md"
BLOCK = re.compile(r"(?<=<!-- figures -->\n).*?(?=<!-- end of figures -->)", re.DOTALL)
_FIGURE = re.compile(r"[\d,.]*\d(?: to [\d.]*\d)? (?:m|km|deg|ms|s|MB|scans)\b")
_LOGS = {"intel": "Intel", "aces": "ACES"}
_OWN = ("default", "filter")


class _Row(NamedTuple):
    """A row of the table for each log: what it is of, its keys with us and with others, and its unit."""

    name: str
    key: str
    other: str
    unit: str
    scale: float = 1.0
    digits: int = 1


_ROWS = (
    _Row("translation", "error_m", "translation_m", "m", digits=4),
    _Row("rotation", "error_rad", "rotation_deg", "deg", 180.0 / math.pi, 3),
    _Row("worst single relation", "worst_m", "worst_relation_m", "m", digits=3),
    _Row("CPU time", "cpu_s", "cpu_s", "s"),
    _Row("peak memory", "peak_memory_bytes", "peak_mb", "MB", 1e-6, 0),
)


def block() -> str:
    """Return the generated part of the README: commit, machine, and the table."""
    suite, others = _read("suite.json"), _read("others.json")
    head = ["", "gridslam", "filter only", *(system["name"] for system in others["systems"].values())]
    rows = [_cells(log, row, suite["cells"][log], others) for log in _LOGS for row in _ROWS]
    return f"{_describe_machine(suite)}\n{_describe_ratio(suite)}\n\n{table(head, rows)}\n"


def scoreboard() -> str:
    """Return the generated part of docs/scoreboard.md: all logs and variants."""
    suite = _read("suite.json")
    head = ["log", "variant", "seeds", *(row.name for row in _ROWS)]
    rows: list[list[object]] = []
    for log, variants in suite["cells"].items():
        for variant, cell in variants.items():
            failed = f", {cell['failed']} failed" if cell["failed"] else ""
            figures = [_write(row, cell) for row in _ROWS]
            rows.append([log, variant, f"{cell['seeds']}{failed}", *figures])
    return f"{_describe_machine(suite)}\n\n{table(head, rows)}\n"


def _describe_machine(suite: Mapping[str, Any]) -> str:
    seeds = sorted({cell["seeds"] for variants in suite["cells"].values() for cell in variants.values()})
    machine = suite["machine"]
    load = next(value for name, value in machine.items() if name.startswith("load")).partition(",")[0]
    count = " to ".join(map(str, dict.fromkeys((seeds[0], seeds[-1]))))
    return f"Commit {suite['commit'][:7]}, {count} seeds; {machine['machine']}, at a load of {load}."


def _describe_ratio(suite: Mapping[str, Any]) -> str:
    ratio = suite["ratio"]
    changes = [
        f"{_LOGS[log]} {variants['default']['error_m']:.2f}" for log, variants in ratio["logs"].items() if log in _LOGS
    ]
    return f"Errors as ratios to those of commit {ratio['to'][:7]}: {', '.join(changes)}."


def quoted() -> list[str]:
    """Return the figures that sentences of docs/scoreboard.md quote."""
    return [text for figure in _read("quoted.json")["figures"] for text in figure["told"]]


def strangers(section: str) -> list[str]:
    """List figures with a unit in a section, outside its table, that are in no committed result."""
    others = _read("others.json")
    known = set(quoted())
    for published in others["published"]:
        known |= {f"{published[f'{log}_m']:{form}} m" for log in _LOGS for form in (".3f", ".4f")}
    sentences = " ".join(BLOCK.sub("", section).split())
    return [figure for figure in _FIGURE.findall(sentences) if figure not in known]


def main() -> None:
    """Write the blocks into the README and the page."""
    for path, text in ((README, block()), (SCOREBOARD, scoreboard())):
        page = path.read_text(encoding="utf-8")
        assert BLOCK.search(page), f"{path.name} has no <!-- figures --> ... <!-- end of figures -->"
        path.write_text(BLOCK.sub(lambda _, text=text: text, page), encoding="utf-8")


def _read(name: str) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((RESULTS / name).read_text(encoding="utf-8"))
    return found


def _cells(log: str, row: _Row, cells: Mapping[str, Any], others: Mapping[str, Any]) -> list[str]:
    own = [_write(row, cells[variant]) for variant in _OWN]
    return [
        f"{_LOGS[log]}, {row.name}",
        *own,
        *(_write_other(row, system[log]) for system in others["systems"].values()),
    ]


def _write(row: _Row, cell: Mapping[str, Any]) -> str:
    """The mean with its 95 % interval; of worst relations the worst of all seeds."""
    if row.key not in cell:
        return ""
    mean, low, high, worst = (row.scale * cell[row.key][name] for name in ("mean", "low", "high", "worst"))
    if row.key == "worst_m":
        return f"{worst:.{row.digits}f} {row.unit}"
    return f"{mean:.{row.digits}f} {row.unit} ({low:.{row.digits}f} to {high:.{row.digits}f})"


def _write_other(row: _Row, figures: Mapping[str, Any]) -> str:
    """As it was published: its digits are not ours."""
    return f"{figures[row.other]} {row.unit}" if row.other in figures else ""


if __name__ == "__main__":
    main()
