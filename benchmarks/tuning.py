"""What `gridslam tune` finds: from a spoiled configuration, and from the default on other lasers.

A tuned configuration is compared with the default on logs that it was not searched on, with paired seeds.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from gridslam.cli.main import main as gridslam
from gridslam.config import Configuration, override
from gridslam.config.tables import to_table
from gridslam.io.carmen.writer import write_carmen
from gridslam.io.trajectories import write_tum
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, make_world, simulate
from gridslam.tuning.comparison import Pair, compare
from gridslam.tuning.trial import run_trial
from gridslam.types import Trajectory
from measure import write_document

__all__ = ["LIDARS", "main", "simulate_logs"]

LIDARS = {
    "180 degrees": LidarConfig(),
    "60 degrees": LidarConfig(beams=60, field_of_view_rad=math.radians(60)),
    "3 cm noise": LidarConfig(sigma_range_m=0.03),
}
_SCANS = 600
_SEARCHED = range(1, 5)  # seeds of worlds
_HELD_OUT = range(11, 17)
_UNSEEN = range(101, 111)
_SPOILED = (
    "range_max_m=5",
    "resolution_m=0.15",
    "beam_sigma_m=0.02",
    "insert_m=1",
    "noise_rad=0.05",
    "key_scan_m=1.5",
    "key_scan_rad=0.8",
    "loop_closure=false",
)
_KEPT = "start", "verdict", "recommended", "prefers_default", "comparison", "best", "importance"
_THINNED = {"every": 2, "duration_s": 900.0}


def simulate_logs(lidar: LidarConfig, seeds: Sequence[int], folder: Path) -> list[Path]:
    """Write logs of random worlds with their truth beside them."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for seed in seeds:
        rng = np.random.default_rng(seed)
        run = simulate(make_world("random", rng), RobotConfig(), OdometryNoise(), lidar, rng)
        path = folder / f"world{seed}.clf"
        write_carmen(path, run.measurements[:_SCANS])
        truth = Trajectory(run.truth.stamps_ns[:_SCANS], run.truth.poses[:_SCANS])
        write_tum(path.with_name(f"world{seed}.truth.tum"), truth)
        paths.append(path)
    return paths


def _tune(arguments: Sequence[str | Path], out: Path) -> dict[str, Any]:
    """What tune.json has of a search; of its trials only the stage, the part of the logs and the ratio."""
    assert gridslam(["tune", *map(str, arguments), "-o", str(out)]) == 0
    document = json.loads((out.with_suffix(".tune") / "tune.json").read_text(encoding="utf-8"))
    kept = {name: document[name] for name in _KEPT}
    trials = [[trial["stage"], round(trial["part"], 4), trial["ratio"]] for trial in document["trials"]]
    return {**kept, "trials": trials}


def _against_default(tuned: Configuration, log: Path, seeds: Sequence[int], options: dict[str, Any]) -> list[Pair]:
    """Pairs of the default and a configuration."""

    def loss(configuration: Configuration, seed: int) -> float:
        reference = log.with_name(f"{log.name.partition('.')[0]}.relations")
        return float(
            run_trial(
                {
                    "log": str(log),
                    "digest": "",
                    "configuration": to_table(configuration),
                    "seed": seed,
                    "repair": "needed",
                    "options": {"scan_topics": [], **options},
                    "reference": str(reference if reference.is_file() else log.with_name(f"{log.stem}.truth.tum")),
                    "max_memory_bytes": 1 << 32,
                    "threads": 1,
                }
            )["loss"]
        )

    return [Pair(log.name, seed, math.log(loss(Configuration(), seed)), math.log(loss(tuned, seed))) for seed in seeds]


def _from_spoiled(data: Path, folder: Path) -> dict[str, Any]:
    """Search on Intel from a spoiled configuration; judge by ACES and by worlds, against the default."""
    out = folder / "spoiled.toml"
    words = [data / "intel.clf.bz2", "--held-out", data / "aces.clf.bz2", "--trials", "60"]
    words += ["--every", str(_THINNED["every"]), "--duration", str(_THINNED["duration_s"])]
    found = _tune([*words, *(word for one in _SPOILED for word in ("--set", one))], out)
    tuned = override(Configuration(), *_SPOILED, *(f"{name}={str(v).lower()}" for name, v in found["best"].items()))
    aces = _against_default(tuned, data / "aces.clf.bz2", range(1, 6), _THINNED)
    worlds = simulate_logs(LIDARS["180 degrees"], _UNSEEN, folder / "unseen")
    pairs = [pair for log in worlds for pair in _against_default(tuned, log, [1], {})]
    return {
        **found,
        "best_against_default_on_aces": _describe(aces),
        "best_against_default_on_ten_worlds": _describe(pairs),
    }


def _describe(pairs: Sequence[Pair]) -> dict[str, Any]:
    return {name: None if value != value else value for name, value in asdict(compare(pairs)).items()}


def _from_default(name: str, folder: Path) -> dict[str, Any]:
    """Search for a laser from the default, on simulated worlds."""
    place = folder / name.replace(" ", "-")
    searched = simulate_logs(LIDARS[name], _SEARCHED, place)
    held_out = simulate_logs(LIDARS[name], _HELD_OUT, place)
    words = [*searched, *(word for log in held_out for word in ("--held-out", log))]
    return _tune([*words, "--trials", "40", "--judging-seeds", "3"], place / "best.toml")


def main(arguments: Sequence[str] | None = None) -> None:
    """Search and compare; the folder keeps the journals, so that an interrupted benchmark goes on."""
    parser = argparse.ArgumentParser(description="What gridslam tune finds.")
    parser.add_argument("data", type=Path, help="folder of the public logs")
    parser.add_argument("--folder", type=Path, required=True, help="for logs and results")
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/tuning.json"))
    given = parser.parse_args(arguments)
    lasers = {name: _from_default(name, given.folder) for name in ("60 degrees", "3 cm noise")}
    spoiled = _from_spoiled(given.data, given.folder)
    write_document(
        given.out,
        "python benchmarks/tuning.py DATA --folder FOLDER; seed 0, one worker",
        from_default=lasers,
        from_spoiled=spoiled,
    )


if __name__ == "__main__":
    main()
