"""Pictures of what the algorithms are made of: models, resampling, scan matching."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
from drives import drive, mapped
from numpy.typing import NDArray
from panels import GAP, ORANGE, SIDE, VIOLET, Chart, Panel, row_of, save
from PIL import ImageDraw

from gridslam import GridFastSlam, run
from gridslam.geometry.se2 import between
from gridslam.matching.gauss_newton import GaussNewton
from gridslam.matching.hill_climbing import HillClimbing
from gridslam.models import (
    BeamRangeFinder,
    CauchyEndPoint,
    DiffusionMotion,
    GMappingMotion,
    LikelihoodField,
    OdometryMotion,
)
from gridslam.particles import Multinomial, ResamplingWheel, Residual, Stratified, Systematic
from gridslam.types import StepReport
from gridslam.viz.canvas import CLOSURE, FAINT, FREE, OCCUPIED, RULE, TRUTH, font, time_colours

RESULTS = Path(__file__).resolve().parents[2] / "benchmarks" / "results"


def motion_models() -> None:
    """What four motion models make of one drive: samples after each of its increments, and the first-order ellipses."""
    drive_ = [np.array([1.0, 0.0, 0.0])] * 3 + [np.array([1.0, 0.18, 0.35])] * 4 + [np.array([1.0, 0.0, 0.0])] * 2
    models = [
        ("OdometryMotion()", OdometryMotion()),
        ("OdometryMotion(alpha1 = alpha2 = 0.002)", OdometryMotion(alpha1=0.002, alpha2=0.002)),
        ("GMappingMotion()", GMappingMotion()),
        ("DiffusionMotion(), after scan matching", DiffusionMotion()),
    ]
    panels = []
    for head, model in models:
        panel = Panel(head, [-1, -3.2, 9, 6.3])
        panel.page.paste(FREE, (0, 0, *panel.page.size))
        rng, poses, mean, P = np.random.default_rng(0), np.zeros((400, 3)), np.zeros(3), np.zeros((3, 3))
        path = [mean]
        for k, increment in enumerate(drive_):
            sampler = model(increment)
            poses = sampler(poses, rng)
            (moved,), (noise,) = sampler.moments(mean[None])
            G = np.eye(3)
            G[:2, 2] = mean[1] - moved[1], moved[0] - mean[0]
            mean, P = moved, G @ P @ G.T + noise
            path.append(mean)
            if k % 2 == 0:
                panel.dots(poses[:, :2], time_colours(np.full(len(poses), k / len(drive_))), 2.0)
                panel.ring(mean[:2], P[:2, :2], TRUTH)
        panel.line(np.array(path)[:, :2], OCCUPIED, 1.5)
        panels.append(panel)
    save("motion_models", panels, 2, [("mean", OCCUPIED), ("2 standard deviations to first order", TRUTH)])


def measurement_models() -> None:
    """Log likelihood of one scan over positions, heading as it was, by three models; and the beam model's density."""
    log = drive("rooms")
    maps = mapped(log, range(0, len(log), 2))
    at = 120
    truth, beams = between(log.truth.poses[0], log.truth.poses)[at], log.measurements[at].scan.beams(0.05, 30.0)
    half, cell = 1.0, 0.02
    steps = np.arange(-half, half, cell) + cell / 2
    x, y = np.meshgrid(steps, steps)
    poses = truth + np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], 1)
    panels = []
    box = [truth[0] - half, truth[1] - half, truth[0] + half, truth[1] + half]
    rows = np.zeros(len(poses), np.int32)
    for head, model in (
        ("BeamRangeFinder(tempering=0.03)", BeamRangeFinder(tempering=0.03)),
        ("LikelihoodField(tempering=0.03)", LikelihoodField(tempering=0.03)),
        ("CauchyEndPoint(), the default", CauchyEndPoint()),
    ):
        log_likelihood = model(beams)(maps, rows, poses).reshape(x.shape)
        share = np.clip(1 + (log_likelihood - log_likelihood.max()) / 5, 0, 1)[..., None]
        shades = (1 - share) * np.array(FREE) + share * np.array(VIOLET)
        panel = Panel(head, box, 330)
        panel.cells(shades.astype(np.uint8), (box[0], box[1]), cell)
        panel.robot(truth, ORANGE, 0.15)
        panels.append(panel)
    chart = Chart("p(z | 4 m to the wall), beam model, range to 8 m", [0, 0, 8, 1.4], 3 * 330 + 2 * GAP, 230)
    chart.values(range(1, 8), (0.5, 1.0), "measured range z, m", "1/m")
    z = np.linspace(0, 7.99, 1600)
    chart.curve(z, BeamRangeFinder(range_max_m=8.0, sigma_hit_m=0.25).likelihoods(z, np.full(len(z), 4.0)), VIOLET)
    save(
        "measurement_models",
        [*panels, chart],
        3,
        [("where the robot was", ORANGE), ("log likelihood, white from 5 nats below the greatest on", VIOLET)],
    )


def resampling() -> None:
    """How much the number of copies varies, by resampler; and who descends from whom in a run."""
    rng, size, draws = np.random.default_rng(0), 30, 4000
    weights = np.sort(rng.dirichlet(np.full(size, 0.7)))
    chart = Chart("standard deviation of a particle's copies", [0, 0, 2.6, 1.6], 430, 360)
    chart.values((0.5, 1, 1.5, 2), (0.5, 1), "copies expected", "")
    colours = {
        "Multinomial": CLOSURE,
        "ResamplingWheel": FAINT,
        "Residual": TRUTH,
        "Stratified": ORANGE,
        "Systematic": VIOLET,
    }
    for kind in (Multinomial, ResamplingWheel, Residual, Stratified, Systematic):
        counts = np.array([np.bincount(kind()(weights, size, rng), minlength=size) for _ in range(draws)])
        chart.dots(
            np.stack([size * weights, counts.std(0)], 1), colours[kind.__name__], 11.0 if kind is Multinomial else 6.0
        )
    parents: list[NDArray[np.int64] | None] = []

    def watch(report: StepReport, state: object, seconds: float) -> None:
        if report.skipped is None:
            parents.append(report.parents)

    log = drive("loop")
    run(log.measurements, GridFastSlam(particles_min=30), rng=np.random.default_rng(0), observers=[watch])
    tree = Chart(
        "who descends from whom, 30 particles of a drive twice around a block", [0, -1, len(parents) - 1, 30], 780, 360
    )
    tree.values((50, 100, 150, 200), (), "key scan", "")
    alive = np.ones(30, bool)
    for key in range(len(parents) - 1, 0, -1):
        came = parents[key - 1] if parents[key - 1] is not None else np.arange(30)
        for one in range(30):
            tree.line(
                np.array([[key - 1, came[one]], [key, one]], np.float64),
                VIOLET if alive[one] else RULE,
                1.5 if alive[one] else 1.0,
            )
        alive = np.isin(np.arange(30), came[alive])
    save("resampling", [chart, tree], 2, list(colours.items()))


def scan_matching() -> None:
    """A scan on the distance field before and after; and from which guesses three matchers find the pose."""
    log = drive("rooms")
    maps = mapped(log, range(0, len(log), 2))
    at = 121
    truth, beams = between(log.truth.poses[0], log.truth.poses)[at], log.measurements[at].scan.beams(0.05, 30.0)
    guess = truth + np.array([0.25, -0.2, 0.12])
    box = [truth[0] - 4, truth[1] - 3.2, truth[0] + 4.5, truth[1] + 4.5]
    field, corner = maps.field(0)
    near = field[..., None].astype(np.float64) / 255
    shades = (1 - near) * np.array(FREE) + near * np.array(OCCUPIED)
    prior = np.full((1, 3, 3), 1e-9) * np.eye(3)
    found = GaussNewton()(maps, np.zeros(1, np.int32), guess[None], prior, beams).poses[0]
    panels = []
    for head, pose in (("the scan at the guess, on the distance field", guess), ("after Gauss-Newton", found)):
        panel = Panel(head, box)
        panel.cells(shades.astype(np.uint8), (corner[1] * 0.05, corner[0] * 0.05), 0.05)
        c, s = math.cos(pose[2]), math.sin(pose[2])
        panel.dots(pose[:2] + beams.ends @ np.array([[c, s], [-s, c]]), ORANGE, 4.0)
        panel.robot(pose, VIOLET)
        panels.append(panel)
    rng = np.random.default_rng(0)
    for head, matcher, count in (
        ("Gauss-Newton", GaussNewton(), 1500),
        ("hill climbing", HillClimbing(), 1500),
    ):
        offsets = rng.uniform([-1.2, -1.2, -0.6], [1.2, 1.2, 0.6], (count, 3))
        matched = matcher(maps, np.zeros(count, np.int32), truth + offsets, np.tile(prior, (count, 1, 1)), beams).poses
        right = (np.hypot(*(matched - truth)[:, :2].T) < 0.05) & (np.abs(matched - truth)[:, 2] < 0.02)
        chart = Chart(f"{head}: {100 * right.mean():.0f} %", [0, 0, 1.7, 0.6], 2 * SIDE // 3 - 5, 230)
        chart.values((0.5, 1.0, 1.5), (0.2, 0.4), "m off", "rad off")
        colours = [TRUTH if one else ORANGE for one in right.tolist()]
        chart.dots(np.stack([np.hypot(*offsets[:, :2].T), np.abs(offsets[:, 2])], 1), colours, 3.0)
        panels.append(chart)
    save(
        "scan_matching",
        [row_of(panels[:2]), row_of(panels[2:])],
        1,
        [("guesses from which the pose is found", TRUTH), ("and from which it is not", ORANGE)],
    )


def error_budget() -> None:
    """Draw the errors of each stage, from the result of `benchmarks/error_budget.py`; bars are geometric means."""
    rows = json.loads((RESULTS / "error_budget.json").read_text())["rows"]
    stages = list(dict.fromkeys(row["stage"] for row in rows))
    charts = []
    for head, key, low, high, ticks in (
        ("over one metre, cm", "rpe_m", 0.2, 4.0, (0.25, 0.5, 1, 2)),
        ("over the whole way, cm", "ate_m", 0.1, 300.0, (0.2, 1, 5, 20, 100)),
    ):
        chart = Chart(head, [math.log10(low), -len(stages) - 0.4, math.log10(high), 0.3], SIDE + 60, 44 * len(stages))
        draw = ImageDraw.Draw(chart.page)
        for tick in ticks:
            x = math.log10(tick)
            chart.line(np.array([[x, chart.box[1]], [x, 0.3]]), RULE, 1.0)
            at = chart.pixels(np.array([[x, chart.box[1]]]))[0]
            draw.text((at[0] + 4, at[1] - 4), f"{tick:g}", fill=FAINT, font=font(15, 1.0), anchor="ls")
        for place, stage in enumerate(stages):
            y = -0.55 - place
            errors = np.log10([100 * row[key] for row in rows if row["stage"] == stage])
            colour = TRUTH if stage == "bound" else CLOSURE
            chart.line(np.array([[math.log10(low), y], [errors.mean(), y]]), colour, 9.0)
            chart.dots(np.column_stack([errors, np.full(len(errors), y)]), ORANGE, 6.0)
            corner = chart.pixels(np.array([[math.log10(low), y + 0.28]]))[0]
            draw.text((corner[0] + 6, corner[1]), stage, fill=OCCUPIED, font=font(15, 1.0), anchor="ls")
        charts.append(chart)
    key_of = [("mean of five worlds", CLOSURE), ("what the beams allow", TRUTH), ("a world", ORANGE)]
    save("error_budget", charts, 2, key_of)
