"""Recall and precision of loop closure, on drives where old places have to be recognized.

Other benchmarks of closures have odometry so good that nothing needs to be recognized, and there none that is false
proves nothing. How many revisits there are, and which, is decided by the truth alone (see `recognition_drives`).
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from closure_worlds import LARGE
from gridslam.config import Configuration, override
from measure import provenance
from recognition_drives import HONEST, KINDS, certain_revisits, driven_m, revisited_way, simulated
from recognition_scores import Score, judge, mapped, off_m, rmse
from report import Report, table

LOOSE = tuple(
    f"loop_closure.{it}"
    for it in ("places.inlier_ratio=0.4", "recognition.min_matches=1", "recognition.runner_up_ratio=100")
)
"""A gate that lets through what it should not."""


class _Task(NamedTuple):
    """A simulated drive that a worker maps, with changes of parameters."""

    kind: str
    seed: int
    changes: Sequence[str]


def _scored(task: _Task) -> Score:
    config = override(Configuration(), "particles=10", *task.changes)
    alone = override(config, "loop_closure=false")
    drive = simulated(task.kind, task.seed)
    log = [drive.everything[k] for k in drive.lit.tolist()]
    arcs = certain_revisits(drive) if len(drive.dark) else revisited_way(drive)
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


def _row(name: str, scores: Sequence[Score]) -> dict[str, Any]:
    """Sums over drives, by column; of errors the median, as one lost drive would be all that a mean tells."""
    certain, recognized = sum(s.certain for s in scores), sum(s.recognized for s in scores)
    return {
        "drives": name,
        "number": len(scores),
        "certain revisits": certain,
        "recognized": recognized,
        "recall": f"{recognized / certain:.3f}" if certain else "-",
        "right constraints": sum(s.right for s in scores),
        "false constraints": sum(s.false for s in scores),
        "false by search": sum(s.false_searched for s in scores),
        "drives with false": sum(s.false > 0 for s in scores),
        "drives with right": sum(s.right > 0 for s in scores),
        "filter off > 1 m": f"{np.mean([s.filter_off_m > 1.0 for s in scores]):.0%}",
        **{f"{it} m": float(np.median([getattr(s, f"{it}_m") for s in scores])) for it in ("full", "online", "filter")},
        "worst full m": max(s.full_off_m for s in scores),
        "CPU s": float(np.mean([s.cpu_s for s in scores])),
    }


def _simulated_section(report: Report, title: str, tasks: Sequence[_Task], scores: Iterable[Score]) -> None:
    """Add the rows of one setting, each drive printed as it comes, and those of honest and of deceptive drives."""
    by_kind: dict[str, list[Score]] = {task.kind: [] for task in tasks}
    for task, score in zip(tasks, scores, strict=True):
        by_kind[task.kind].append(score)
        print(task.kind, task.seed, *(f"{cell:.3g}" for cell in score), sep="  ", flush=True)
    totals: dict[str, list[Score]] = {"honest": [], "deceptive": []}
    for kind, found in by_kind.items():
        totals["honest" if kind in (*HONEST, *LARGE) else "deceptive"] += found
    rows = [_row(name, found) for name, found in (by_kind | totals).items() if found]
    report.add(title, table(list(rows[0]), [list(row.values()) for row in rows]))


def main(arguments: Sequence[str] | None = None) -> Report:
    """Run what is asked for, and write the report where it is asked for."""
    parser = argparse.ArgumentParser(description="Recall and precision of loop closure where it is needed.")
    parser.add_argument("--kinds", nargs="+", choices=[*KINDS, *LARGE], default=KINDS, help="[all but campus, grounds]")
    parser.add_argument("--drives", type=int, default=50, help="drives of each kind [50]")
    parser.add_argument("--workers", type=int, default=1, help="processes [1]")
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help="a parameter of all runs")
    parser.add_argument("--loose", action="store_true", help="again with a gate that lets through what it should not")
    parser.add_argument("-o", "--out", type=Path, help="Markdown file")
    given, report = parser.parse_args(arguments), Report()
    settings = {", ".join(given.set) or "as it is": given.set} | (
        {"loose": [*given.set, *LOOSE]} if given.loose else {}
    )
    for changes in settings.values():
        override(Configuration(), *changes)  # wrong ones end it here, before hours of work
    machine = "\n".join(f"- {name}: {value}" for name, value in provenance().items())
    print(machine)
    with ProcessPoolExecutor(given.workers) as pool:
        for title, changes in settings.items():
            tasks = [_Task(kind, seed, changes) for kind in given.kinds for seed in range(given.drives)]
            _simulated_section(report, f"Simulated drives: {title}", tasks, pool.map(_scored, tasks))
    if given.out is not None:
        given.out.write_text("\n\n".join(["# Recognition", machine, *report.sections]) + "\n", encoding="utf-8")
    return report


if __name__ == "__main__":
    main()
