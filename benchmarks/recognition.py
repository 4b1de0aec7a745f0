"""Recall and precision of loop closure, on drives where old places have to be recognized.

Other benchmarks of closures have odometry so good that nothing needs to be recognized, and there none that is false
proves nothing. How many revisits there are, and which, is decided by the truth alone (see `recognition_drives`).
"""

from __future__ import annotations

import argparse
import hashlib
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np

from gridslam.config import Configuration, override
from gridslam.errors import ConfigurationError
from gridslam.types import FloatArray
from measure import provenance
from recognition_drives import HONEST, KINDS, LARGE, Drive, certain_revisits, driven_m, revisited_way, simulated
from recognition_scores import Score, judge, mapped, off_m, rmse
from report import Report, table

_ROOT = Path(__file__).resolve().parent.parent
LOOSE = tuple(
    f"loop_closure.{it}"
    for it in ("places.inlier_ratio=0.4", "recognition.min_matches=1", "recognition.runner_up_ratio=100")
)
"""A gate that lets through what it should not."""

_RULES = "1"
"""Change it with what makes a revisit certain: cached ones are not believed then."""
_OFF_M = 1.0
_Result = TypeVar("_Result")


def revisits(drive: Drive, folder: Path | None) -> FloatArray:
    """Certain revisits of a drive, kept in a folder: they depend on nothing that a mapper does.

    Where the laser was never blind they are all of the way that was driven before, in pieces of 10 m.
    """
    if not len(drive.dark):
        return revisited_way(drive)
    if folder is None:
        return certain_revisits(drive)
    digest = hashlib.sha256(_RULES.encode() + drive.truth.tobytes() + drive.dark.tobytes()).hexdigest()[:16]
    path = folder / f"revisits-{drive.name.replace(' ', '-')}-{digest}.npy"
    return _cached(path, lambda: certain_revisits(drive))


def _cached(path: Path, make: Callable[[], FloatArray]) -> FloatArray:
    if path.is_file():
        return np.asarray(np.load(path))
    found = make()
    path.parent.mkdir(parents=True, exist_ok=True)
    beside = path.with_suffix(f".{os.getpid()}.npy")
    np.save(beside, found)
    beside.replace(path)  # other workers see all of it or nothing
    return found


class _Task(NamedTuple):
    """A simulated drive that a worker maps, with changes of parameters, and the folder of what is kept."""

    kind: str
    seed: int
    changes: tuple[str, ...]
    cache: Path | None

    @property
    def name(self) -> str:
        """Name of the drive."""
        return f"{self.kind} {self.seed}"


def _scored(task: _Task) -> Score:
    config = override(Configuration(), "particles=10", *task.changes)
    alone = override(config, "loop_closure=false")
    drive = simulated(task.kind, task.seed)
    log = [drive.everything[k] for k in drive.lit.tolist()]
    arcs = revisits(drive, task.cache)
    truth, driven = drive.truth[drive.lit], driven_m(drive.truth)[drive.lit]
    said, filtered = mapped(log, config), mapped(log, alone)
    off, off_alone = off_m(truth, said.full), off_m(truth, filtered.full)
    return Score(
        len(arcs),
        *judge(truth, driven, said, arcs, by_way=not len(drive.dark)),
        rmse(off),
        rmse(off_m(truth, said.online)),
        rmse(off_alone),
        float(off_alone.max()),
        float(off.max()),
        said.cpu_s,
    )


_HEAD = [
    "drives",
    "number",
    "certain revisits",
    "recognized",
    "recall",
    "right constraints",
    "false constraints",
    "false by search",
    "drives with false",
    "drives with right",
    "filter off > 1 m",
    "full m",
    "online m",
    "filter m",
    "worst full m",
    "CPU s",
]


def _row(name: str, scores: Sequence[Score]) -> list[Any]:
    """Sums over drives; of errors the median, as one lost drive would be all that a mean tells."""
    certain, recognized = sum(s.certain for s in scores), sum(s.recognized for s in scores)
    recall = f"{recognized / certain:.3f}" if certain else "-"
    off = float(np.mean([s.filter_off_m > _OFF_M for s in scores]))
    errors = [float(np.median([getattr(s, f"{it}_m") for s in scores])) for it in ("full", "online", "filter")]
    return [
        name,
        len(scores),
        certain,
        recognized,
        recall,
        sum(s.right for s in scores),
        sum(s.false for s in scores),
        sum(s.false_searched for s in scores),
        sum(s.false > 0 for s in scores),
        sum(s.right > 0 for s in scores),
        f"{off:.0%}",
        *errors,
        max(s.full_off_m for s in scores),
        float(np.mean([s.cpu_s for s in scores])),
    ]


def _each(
    pool: ProcessPoolExecutor | None, work: Callable[[Any], _Result], tasks: Sequence[_Task]
) -> Iterator[_Result]:
    return map(work, tasks) if pool is None else pool.map(work, tasks)


def _printed(row: Sequence[object]) -> None:
    print("  ".join(f"{cell:.3g}" if isinstance(cell, float) else str(cell) for cell in row), flush=True)


def _simulated_section(
    report: Report, title: str, kinds: Sequence[str], tasks: Sequence[_Task], scores: Iterator[Score]
) -> list[list[Any]]:
    """Rows of one setting, each drive printed as it comes; returns those of honest and of deceptive drives."""
    by_kind: dict[str, list[Score]] = {kind: [] for kind in kinds}
    for task, score in zip(tasks, scores, strict=True):
        by_kind[task.kind].append(score)
        _printed([task.name, *score])
    rows = [_row(kind, found) for kind, found in by_kind.items()]
    honest = [score for kind in kinds if _honest(kind) for score in by_kind[kind]]
    deceptive = [score for kind in kinds if not _honest(kind) for score in by_kind[kind]]
    totals = [_row(name, found) for name, found in (("honest", honest), ("deceptive", deceptive)) if found]
    report.add(title, table(_HEAD, rows + totals))
    return totals


def _honest(kind: str) -> bool:
    return kind in (*HONEST, *LARGE)


def _settings(given: argparse.Namespace) -> list[tuple[str, tuple[str, ...]]]:
    """Titles and changes of parameters; checked here, before hours of work."""
    common = tuple(given.set)
    found = [("as it is" if not common else ", ".join(common), common)]
    for sweep in given.sweep:
        name, _, values = sweep.partition("=")
        found += [(f"{name}={value}", (*common, f"{name}={value}")) for value in values.split(",")]
    if given.loose:
        found.append(("loose", (*common, *LOOSE)))
    try:
        for _, changes in found:
            override(Configuration(), *changes)
    except ConfigurationError as error:
        sys.exit(f"recognition: {error}")
    return found


def main(arguments: Sequence[str] | None = None) -> Report:
    """Run what is asked for, and write the report where it is asked for."""
    given = _parser().parse_args(arguments)
    settings, report, curve = _settings(given), Report(), []
    machine = "\n".join(f"- {name}: {value}" for name, value in provenance().items())
    print(machine)
    pool = ProcessPoolExecutor(given.workers) if given.workers > 1 else None
    for setting, changes in settings:
        tasks = [_Task(kind, seed, changes, given.cache) for kind in given.kinds for seed in range(given.drives)]
        totals = _simulated_section(
            report, f"Simulated drives: {setting}", given.kinds, tasks, _each(pool, _scored, tasks)
        )
        curve += [[setting, *row] for row in totals]
    if len(settings) > 1 and curve:
        report.add("Curve", table(["setting", *_HEAD], curve))
    if pool is not None:
        pool.shutdown()
    if given.out is not None:
        given.out.parent.mkdir(parents=True, exist_ok=True)
        given.out.write_text("\n\n".join(["# Recognition", machine, *report.sections]) + "\n", encoding="utf-8")
    return report


def _parser() -> argparse.ArgumentParser:
    def kinds(text: str) -> list[str]:
        return _named(text, [*KINDS, *LARGE])

    parser = argparse.ArgumentParser(description="Recall and precision of loop closure where it is needed.")
    parser.add_argument("--kinds", type=kinds, default=list(KINDS), help="worlds [all but campus and grounds]")
    parser.add_argument("--drives", type=int, default=50, help="drives of each kind [50]")
    parser.add_argument("--cache", type=Path, help="keeps certain revisits from one run to the next")
    parser.add_argument("--workers", type=int, default=1, help="processes [1]")
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help="a parameter of all runs")
    parser.add_argument("--sweep", action="append", default=[], metavar="NAME=V1,V2", help="again with each value")
    parser.add_argument("--loose", action="store_true", help="again with a gate that lets through what it should not")
    parser.add_argument("-o", "--out", type=Path, help="Markdown file")
    return parser


def _named(text: str, known: Sequence[str]) -> list[str]:
    """Names in a list with commas; argparse tells what is wrong with others."""
    names = text.split(",")
    if wrong := [name for name in names if name not in known]:
        raise argparse.ArgumentTypeError(f"expected some of {', '.join(known)}, got {', '.join(wrong)}")
    return names


if __name__ == "__main__":
    main()
