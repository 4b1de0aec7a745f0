"""Run the logs there are and simulated ones; print accuracy and cost, and write a dated report.

python benchmarks/run.py [--quick] [--data ../shared/data] [--seeds 10] [--only SECTION ...] [-o reports]
"""

from __future__ import annotations

import argparse
import datetime
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import logs
from accuracy import accuracy, starts
from graphs import graphs
from gridslam import preset
from gridslam.config import dumps
from landmarks import landmarks
from measure import provenance
from report import Report

_SECTIONS = (
    "accuracy",
    "start",
    "graphs",
    "landmarks",
)
_WORLDS = ("demo", "rooms", "loop", "hall")
_ROOT = Path(__file__).resolve().parent.parent


def main(arguments: Sequence[str] | None = None) -> Path:
    """Run what is asked for; returns the report's path."""
    given = _parser().parse_args(arguments)
    given.seeds = given.seeds or (1 if given.quick else 10)
    sections = given.only or _SECTIONS
    today = datetime.date.today().isoformat()
    path: Path = given.out / f"benchmark-{today}{'-quick' if given.quick else ''}.md"
    report = Report()
    machine = "\n".join(f"- {name}: {value}" for name, value in provenance().items())
    print(machine)
    with tempfile.TemporaryDirectory() as folder:
        _run(sections, given, Path(folder), report, path.with_suffix(""))
    how = f"{'quick, ' if given.quick else ''}{given.seeds} seeds, sections: {', '.join(sections)}"
    configuration = f"```toml\n{dumps(preset('default'))}```"
    text = [f"# Benchmark of {today}", f"{machine}\n- run: {how}", "## Targets", report.summary(), *report.sections]
    given.out.mkdir(parents=True, exist_ok=True)
    path.write_text("\n\n".join([*text, "## Configuration", configuration]) + "\n", encoding="utf-8")
    print(f"\n## Targets\n\n{report.summary()}\n\n{path}")
    return path


def _run(sections: Sequence[str], given: argparse.Namespace, folder: Path, report: Report, pictures: Path) -> None:
    quick = given.quick
    found = logs.find(given.data)
    if not found:
        report.add("No real logs", f"There is none in {given.data}: only simulated ones were run.")
    main_log = found[0] if found else logs.simulated("demo", folder)
    seeds = range(given.seeds)

    def accuracy_section() -> None:
        worlds = [logs.simulated(world, folder) for world in (_WORLDS[:1] if quick else _WORLDS)]
        accuracy([*found, *worlds], seeds, report, pictures)

    runs: dict[str, Callable[[], object]] = {
        "accuracy": accuracy_section,
        "start": lambda: starts(main_log, report, 3 if quick else 9),
        "graphs": lambda: graphs(given.data, report, 3 if quick else 7),
        "landmarks": lambda: landmarks(report, given.data, seeds, 10 if quick else 100),
    }
    for name in _SECTIONS:
        if name in sections:
            runs[name]()


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description="Accuracy and cost of gridslam, with a dated report.")
    parser.add_argument("--quick", action="store_true", help="one seed, small sizes: two minutes")
    parser.add_argument("--data", type=Path, default=_ROOT.parent / "shared" / "data", help="folder of real logs")
    parser.add_argument("--seeds", type=int, help="seeds 0, 1, ... of each log [10; 1 with --quick]")
    parser.add_argument("--only", choices=_SECTIONS, action="append", help="a section; may be given several times")
    parser.add_argument("-o", "--out", type=Path, default=_ROOT / "reports", help="folder of the report")
    return parser


if __name__ == "__main__":
    main()
