"""Makes the pictures of the pages, each from a run of our own: ``python docs/scripts/pictures.py [NAME ...]``.

Worlds, noise and seeds are fixed, so that the same version draws the same pictures. All take a minute or two.
"""

from __future__ import annotations

import io
import json
import math
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from drives import drive, extent, mapped, pasts
from matplotlib.figure import Figure
from panels import IMAGES, ORANGE, SIDE, Chart, Panel, keep, save
from pictures_of_parts import RESULTS, error_budget, measurement_models, motion_models, resampling, scan_matching
from PIL import Image

from gridslam import GraphSlam, GridFastSlam, GridFastSlamState, OccupancyGrid, PoseGraph, run
from gridslam.api.mapping import map_log
from gridslam.api.session import Session
from gridslam.config import Configuration
from gridslam.evaluation import relation_errors
from gridslam.geometry.se2 import between, compose
from gridslam.io.carmen.writer import write_carmen
from gridslam.io.log import open_log
from gridslam.io.measurement import Measurement
from gridslam.io.trajectories import read_relations
from gridslam.localization import KnownMap, MonteCarloLocalization
from gridslam.mapping import OccupancyGridMapping
from gridslam.plan.changes import write_changes_png
from gridslam.sim import LidarConfig
from gridslam.types import FloatArray, StepReport
from gridslam.viz import draw_graph
from gridslam.viz.canvas import CLOSURE, TRUTH

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))
from map_changes import compare, make_days

DATA = Path(os.environ.get("GRIDSLAM_DATA", Path(__file__).resolve().parents[3] / "shared" / "data"))
LOGS_DRAWN = {
    "simulated": [f"world{seed}" for seed in range(1, 7)],
    "Intel": ["intel"],
    "ACES": ["aces"],
    "Freiburg 101": ["freiburg"],
}


def grid_fastslam() -> None:
    """A loop before and after it closes: the particles' pasts, and how far they are apart."""
    log, told = drive("loop"), []
    kept: dict[int, tuple[FloatArray, int, OccupancyGrid]] = {}
    wanted: tuple[int, ...] = ()

    def watch(report: StepReport, state: GridFastSlamState, seconds: float) -> None:
        if report.skipped is None:
            away = state.poses[:, :2] - state.poses[:, :2].mean(0)
            told.append((report.n_eff, float(np.sqrt(np.square(away).sum(1).mean()))))
            if len(told) - 1 in wanted:
                kept[len(told) - 1] = pasts(state), state.best, state.maps.occupancy(state.best)

    for _ in range(2):  # the first time to find out when the particles are farthest apart
        told.clear()
        run(log.measurements, GridFastSlam(particles_min=30), rng=np.random.default_rng(0), observers=[watch])
        before = int(np.argmax([spread for _, spread in told]))
        after = before + 8
        wanted = before, after
    paths, best, grid = kept[before]
    at = paths[best, -1, :2]
    near = [at[0] - 1.1, at[1] - 1.6, at[0] + 4.9, at[1] + 1.2]
    x0, y0, x1, y1 = extent(grid)
    whole = Panel("the best particle's map when it is back", (x0, y0, x1, y1), tall=round(SIDE * (y1 - y0) / (x1 - x0)))
    whole.grid(grid)
    whole.timed(paths[best, :, :2])
    corners = np.array(
        [[near[0], near[1]], [near[2], near[1]], [near[2], near[3]], [near[0], near[3]], [near[0], near[1]]]
    )
    whole.line(corners, CLOSURE)
    zooms = []
    for key, head in ((before, "30 particles before the loop closes"), (after, f"{after - before} key scans later")):
        paths, best, grid = kept[key]
        panel = Panel(head, near)
        panel.grid(grid)
        for path in paths:
            panel.line(path[max(0, before - 14) :, :2], CLOSURE, 1.0)
        panel.dots(paths[:, -1, :2], ORANGE, 6.0)
        zooms.append(panel)
    neff, spread = np.array(told).T
    keys = np.arange(len(told), dtype=np.float64)
    chart = Chart("how far apart they are, and how many count", (0, 0, len(told), 0.32), tall=whole.page.height)
    chart.values((50, 100, 150, 200), (0.1, 0.2, 0.3), "key scan", "m")
    chart.curve(keys, neff / 100, TRUTH)
    chart.curve(keys, spread, ORANGE)
    save(
        "grid_fastslam",
        [whole, chart, *zooms],
        2,
        [("spread, m", ORANGE), ("N_eff / 100", TRUTH), ("pasts of the particles", CLOSURE)],
    )


def mapping() -> None:
    """A map from known poses: one scan, twenty, all."""
    log = drive("rooms")
    mapper = OccupancyGridMapping()
    box, panels = None, []
    for count in (len(log), 24, 1):
        scans = range(count)
        maps = mapped(log, scans, mapper)
        grid = maps.occupancy(0)
        box = box or extent(grid)
        panel = Panel(f"{count} scan{'s' * (count > 1)}", box, 300)
        panel.grid(grid)
        poses = between(log.truth.poses[0], log.truth.poses)
        panel.line(poses[:count:4, :2] if count > 8 else np.repeat(poses[:1, :2], 2, 0), ORANGE, 1.5)
        panel.robot(poses[count - 1])
        panels.append(panel)
    save("mapping", panels[::-1], 3)


def loop_closure() -> None:
    """The ACES log with a single particle, without and with loop closure; needs the log and its relations."""
    if not (DATA / "aces.clf.bz2").exists():
        print(f"loop_closure.png: left as it is, no aces.clf.bz2 in {DATA} (GRIDSLAM_DATA)")
        return
    panels, relations = [], read_relations(DATA / "aces.relations")
    for closes, head in ((False, "without loop closure"), (True, "with loop closure")):
        result = map_log(DATA / "aces.clf.bz2", configuration=Configuration(particles=1, loop_closure=closes), seed=1)
        error = relation_errors(result.trajectory, relations)
        panel = Panel(f"{head}: {error.trans_mean_m:.3f} m", [-34, -58, 36, 12])
        panel.grid(result.map)
        panel.timed(result.trajectory.poses[:, :2], 2.0)
        if result.loop_summary is not None:
            for one, other in [*result.loop_summary.closures, *result.loop_summary.tracked_revisits[::4]]:
                panel.line(result.graph.poses[[one, other], :2], CLOSURE, 1.5)
        panels.append(panel)
    save("loop_closure", panels, 2, [("places that are one", CLOSURE)])


def graph_slam() -> None:
    """A robot that walks the streets of a town, before and after its graph is solved."""
    rng, cell = np.random.default_rng(9), 1.0
    truth, turns = [np.zeros(3)], np.array([0, 0, 0, 0, 1, -1]) * math.pi / 2
    while len(truth) < 1500:
        step = np.array([cell, 0.0, 0.0 if len(truth) % 4 else rng.choice(turns)])
        ahead = compose(truth[-1], step)
        truth.append(ahead if np.abs(ahead[:2]).max() < 18 else compose(truth[-1], np.array([0.0, 0.0, math.pi / 2])))
    poses, spread = np.array(truth), np.array([0.05, 0.05, 0.02])
    chain = np.stack([np.arange(len(poses) - 1), np.arange(1, len(poses))], 1)
    away = np.hypot(*(poses[:, None, :2] - poses[None, :, :2]).T)
    one, other = np.nonzero(np.triu(away < 0.5, 30))
    chosen = rng.permutation(len(one))[:400]
    edges = np.concatenate([chain, np.stack([one[chosen], other[chosen]], 1)])
    exact = between(poses[edges[:, 0]], poses[edges[:, 1]])
    measured = compose(exact, rng.normal(size=exact.shape) * spread)
    guess = [poses[0]]
    for step in measured[: len(chain)]:
        guess.append(compose(guess[-1], step))
    information = np.tile(np.diag(spread**-2), (len(edges), 1, 1))
    graph = PoseGraph.of(np.array(guess), edges, measured, information, np.arange(len(edges)) < len(chain))
    solution = GraphSlam().solve(graph)
    caption = [
        f"{len(poses)} poses, {len(edges) - len(chain)} loop closures",
        f"chi2 {solution.chi2_before:.4g} before, {solution.chi2_after:.4g} after {solution.iterations} linear systems",
    ]
    before = draw_graph(graph, title="a simulated town, before", caption=caption[:1])
    after = draw_graph(solution.graph, title="after", caption=caption[1:])
    both = before.resize((after.width, round(before.height * after.width / before.width)))
    picture = Image.new("RGB", (2 * after.width, max(both.height, after.height)), "white")
    picture.paste(both, (0, 0))
    picture.paste(after, (after.width, 0))
    keep("graph_slam", picture, 1100)


def first_map() -> None:
    """What `gridslam demo` draws."""
    small_copy("first_map", "map.png", "demo")


def localization() -> None:
    """A robot that is found from nothing: the particles after some updates, in a map of the same building."""
    grid = mapped(drive("demo", 1), range(0, 700, 2)).occupancy(0)
    log = drive("demo", 2, lidar=LidarConfig(rate_hz=4.0, beams=90, range_max_m=3.0))
    slam, rng, state = MonteCarloLocalization(KnownMap(grid)), np.random.default_rng(1), None
    true, start, panels, updates = between(drive("demo", 1).truth.poses[0], log.truth.poses), 200, [], 0
    for k in range(start, len(log)):
        state, report = slam.step(state or slam.init(), *log.measurements[k], rng)
        updates += report.skipped is None
        if report.skipped is None and updates in (1, 5, 15, 40):
            off = np.hypot(*(report.pose - true[k])[:2])
            panel = Panel(f"update {updates}: {report.particles} particles, {off:.2f} m off", extent(grid))
            panel.grid(grid)
            panel.dots(report.poses[:4000, :2], CLOSURE, 3.0)
            panel.robot(true[k], TRUTH, 1.2)
            panel.robot(report.pose, ORANGE, 1.2)
            panels.append(panel)
    save("localization", panels, 2, [("particles", CLOSURE), ("truth", TRUTH), ("reported", ORANGE)])


def landmarks() -> None:
    """What `gridslam landmarks` draws of MRCLAM and of Victoria Park; needs these logs."""
    mrclam = DATA / "landmarks" / "mrclam6_Robot1_Odometry.dat.gz"
    if not mrclam.exists():
        print(f"pictures of landmarks: left as they are, no logs in {DATA} (GRIDSLAM_DATA)")
        return
    small_copy("ekf_slam", "landmarks.png", "landmarks", str(mrclam), "--method", "ekf")
    small_copy("ekf_localization", "landmarks.png", "landmarks", str(mrclam), "--method", "ekf-localization")
    small_copy("fastslam", "landmarks.png", "landmarks", str(mrclam), "--method", "fastslam2")
    park = str(mrclam.with_name("victoria_park.txt.gz"))
    small_copy("landmark_graph", "landmarks.png", "landmarks", park, "--method", "graph")


def small_copy(name: str, drawn: str, *command: str) -> None:
    """Run a command of gridslam, and keep the picture that it draws, smaller."""
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([sys.executable, "-m", "gridslam", *command, "-o", folder], check=True)
        keep(name, Image.open(Path(folder) / drawn), 760)


def tuning() -> None:
    """Self-consistency against true errors, and the course of a search: both from the benchmarks' results."""
    logs = json.loads((RESULTS / "self_consistency.json").read_text())["logs"]
    series = []
    for name, names in LOGS_DRAWN.items():
        ratios = [
            (one["relations_m"] / logs[log]["errors"][0]["relations_m"], score / logs[log]["scores"][0])
            for log in names
            for one, score in zip(logs[log]["errors"], logs[log]["scores"], strict=True)
        ]
        series.append((name, *np.log10(np.array(ratios)).T))
    labels = "log10 of the error as a ratio to the default's", "log10 of the score as a ratio to the default's"
    keep("self_consistency", scatter("30 configurations on each log", labels, series), 760)
    trials = json.loads((RESULTS / "tuning.json").read_text())["from_spoiled"]["trials"]
    ratios = whole_log_ratios(trials)
    labels = "trial on whole logs", "error as a ratio to that of the start"
    drawn = [("of the search", range(1, len(ratios) + 1), ratios)]
    keep("tuning_convergence", scatter("Trials", labels, drawn, span=(0.0, 1.1)), 760)


def whole_log_ratios(trials: Sequence[Any]) -> list[float]:
    """Ratios of the trials on whole logs: objects as in tune.json, or lists of stage, part of the log and ratio."""
    ratios = [
        one["ratio"] if isinstance(one, dict) else one[2] for one in trials if isinstance(one, dict) or one[1] == 1
    ]
    return [math.inf if ratio is None else ratio for ratio in ratios]


def scatter(
    title: str, labels: tuple[str, str], series: Sequence[Any], span: tuple[float, float] | None = None
) -> Image.Image:
    """Draw points, each series a name, abscissae and ordinates; those outside `span` are left out."""
    figure = Figure(figsize=(14, 8), layout="constrained")
    axes = figure.subplots()
    for name, x, y in series:
        axes.scatter(x, y, label=name)
    axes.set(title=title, xlabel=labels[0], ylabel=labels[1], ylim=span)
    axes.legend()
    file = io.BytesIO()
    figure.savefig(file)
    return Image.open(file)


def sessions() -> None:
    """Two halves of the Intel log as two days, the second one with an origin of its own."""
    log = DATA / "intel.clf.bz2"
    measurements = list(open_log(log))
    half = len(measurements) // 2
    with tempfile.TemporaryDirectory() as folder:
        first, second = (Path(folder) / f"{name}.clf" for name in ("first", "second"))
        begin = measurements[half].odometry
        assert begin is not None
        moved = [
            Measurement(replace(o, pose=compose(np.array([10.0, 0.0, 2.0]), between(begin.pose, o.pose))), scan)
            for o, scan in measurements[half:]
            if o is not None
        ]
        write_carmen(first, measurements[:half])
        write_carmen(second, moved)
        session = Session()
        session.add(first)
        keep("sessions", session.add(second).picture(), 1000)


def floor_plans() -> None:
    """The plan of the demo's office; of the Intel log, if it is there; and what moved between two days."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        gridslam("demo", out / "demo")
        gridslam("plan", out / "demo", out / "plan")
        shutil.copy(out / "plan" / "plan.svg", IMAGES / "floor_plan.svg")
        if (DATA / "intel.clf.bz2").exists():
            gridslam("map", DATA / "intel.clf.bz2", out / "intel")
            gridslam("plan", out / "intel", out / "plan")
            shutil.copy(out / "plan" / "plan.svg", IMAGES / "floor_plan_intel.svg")
        days, _ = make_days(2)
        changes = compare(days)
        write_changes_png(out / "changes.png", changes)
        keep("map_changes", Image.open(out / "changes.png"), 760)


def gridslam(command: str, *arguments: str | Path) -> None:
    """Run a command whose output folder is the last argument that is no option."""
    given = [str(argument) for argument in arguments]
    options = [word for word in given if word.startswith("--")]
    *inputs, out = [word for word in given if not word.startswith("--")]
    subprocess.run([sys.executable, "-m", "gridslam", command, *inputs, "-o", out, *options], check=True)


PICTURES = (
    sessions,
    floor_plans,
    tuning,
    first_map,
    grid_fastslam,
    mapping,
    motion_models,
    measurement_models,
    resampling,
    scan_matching,
    error_budget,
    loop_closure,
    graph_slam,
    localization,
    landmarks,
)

if __name__ == "__main__":
    for make in PICTURES:
        if len(sys.argv) == 1 or make.__name__ in sys.argv[1:]:
            make()
