"""Makes the pictures of the pages, each from a run of our own: ``python docs/pictures.py [NAME ...]``.

Worlds, noise and seeds are fixed, so that the same version draws the same pictures. All take a minute or two.
"""

from __future__ import annotations

import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from gridslam import GraphSlam, GridFastSlam, OccupancyGrid, PoseGraph, Trajectory, run
from gridslam.api import map_log
from gridslam.evaluation import relation_errors
from gridslam.geometry.se2 import between, compose
from gridslam.io.relations import read_relations
from gridslam.mapping import OccupancyGridMapping
from gridslam.matching.correlative import Correlative
from gridslam.matching.gauss_newton import GaussNewton
from gridslam.matching.hill_climbing import HillClimbing
from gridslam.models import BeamRangeFinder, CauchyAgreement, DiffusionMotion, GMappingMotion, LikelihoodField, OdometryMotion
from gridslam.particles import Multinomial, ResamplingWheel, Residual, Stratified, Systematic
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, SimulatedLog, make_world, simulate
from gridslam.types import FloatArray, StepReport
from gridslam.viz import draw_graph
from gridslam.viz.layout import font
from gridslam.viz.palette import CLOSURE, FAINT, FREE, OCCUPIED, RULE, TIME_ENDS, TRUTH, UNKNOWN, Colour, time_colours
from gridslam.viz.strokes import disc, stroke

IMAGES = Path(__file__).parent / "images"
ORANGE, VIOLET = TIME_ENDS[1], TIME_ENDS[0]
SIDE, HEAD, GAP = 420, 40, 14  # px of a panel, of the line above it, and between two


class Panel:
    """A part of the world, [x0, y0, x1, y1] in m, drawn with y up; SIDE px wide."""

    def __init__(self, head: str, box: Sequence[float], wide: int = SIDE, tall: int | None = None) -> None:
        self.head, self.box = head, box
        x0, y0, x1, y1 = box
        self.scale = wide / (x1 - x0), (tall or round(wide * (y1 - y0) / (x1 - x0))) / (y1 - y0)
        self.page = Image.new("RGB", (wide, round(self.scale[1] * (y1 - y0))), UNKNOWN)

    def pixels(self, points: FloatArray) -> FloatArray:
        """Page coordinates (N, 2) of points (N, 2)."""
        return np.stack([(points[:, 0] - self.box[0]) * self.scale[0], (self.box[3] - points[:, 1]) * self.scale[1]], 1)

    def cells(self, shades: NDArray[np.uint8], origin: tuple[float, float], cell: float) -> None:
        """Paint cells [row = y, column = x] of RGB."""
        height, width = shades.shape[:2]
        size = max(1, round(width * cell * self.scale[0])), max(1, round(height * cell * self.scale[1]))
        kept = Image.Resampling.BOX if size[0] < width else Image.Resampling.NEAREST
        corner = self.pixels(np.array([[origin[0], origin[1] + height * cell]]))[0].round().astype(int).tolist()
        self.page.paste(Image.fromarray(shades[::-1]).resize(size, kept), tuple(corner))

    def grid(self, grid: OccupancyGrid) -> None:
        """Paint a map: unknown, free, occupied."""
        share = np.where(grid.known, np.clip(grid.probability, 0, 1), 0.5)[..., None]
        shades = (1 - share) * np.array(FREE) + share * np.array(OCCUPIED)
        self.cells(np.where(grid.known[..., None], shades, UNKNOWN).astype(np.uint8), grid.origin, grid.resolution_m)

    def line(self, points: FloatArray, colour: Colour, width: float = 2.0) -> None:
        """Draw a path (N, 2)."""
        at = self.pixels(points)
        stroke(self.page, np.concatenate([at[:-1], at[1:]], axis=1), [colour] * (len(at) - 1), width)

    def timed(self, points: FloatArray, width: float = 2.0) -> None:
        """Draw a path (N, 2) in the colours of time."""
        at = self.pixels(points)
        colours = time_colours(np.linspace(0, 1, len(at) - 1))
        stroke(self.page, np.concatenate([at[:-1], at[1:]], axis=1), colours, width)

    def dots(self, points: FloatArray, colours: list[Colour] | Colour, width: float = 4.0) -> None:
        """Draw points (N, 2)."""
        at = self.pixels(points)
        stroke(self.page, np.tile(at, 2), colours if isinstance(colours, list) else [colours] * len(at), width)

    def ring(self, mean: FloatArray, covariance: FloatArray, colour: Colour, sigmas: float = 2.0) -> None:
        """Draw an ellipse about (2,) of a covariance (2, 2)."""
        angles = np.linspace(0, math.tau, 60)
        values, vectors = np.linalg.eigh(covariance)
        arms = vectors * np.sqrt(np.maximum(values, 0))
        self.line(mean + sigmas * np.stack([np.cos(angles), np.sin(angles)], 1) @ arms.T, colour)

    def robot(self, pose: FloatArray, colour: Colour = ORANGE, length: float = 0.6) -> None:
        """Mark a pose (3,) by a disc and its heading."""
        tip = pose[:2] + length * np.array([math.cos(pose[2]), math.sin(pose[2])])
        self.line(np.stack([pose[:2], tip]), colour, 3.0)
        (x, y), = self.pixels(pose[None, :2]).tolist()
        disc(self.page, (x, y), 6, FREE, colour)


def save(name: str, panels: Sequence[Panel], columns: int, key: Sequence[tuple[str, Colour]] = ()) -> None:
    """Lay panels side by side, their heads above and a key below, and write a small PNG."""
    rows = [panels[k : k + columns] for k in range(0, len(panels), columns)]
    width = max(sum(panel.page.width + GAP for panel in row) + GAP for row in rows)
    heads = [HEAD if any(panel.head for panel in row) else 0 for row in rows]
    height = sum(max(panel.page.height for panel in row) + GAP for row in rows) + sum(heads) + (34 if key else 0)
    page = Image.new("RGB", (width, height), UNKNOWN)
    draw, y = ImageDraw.Draw(page), 0
    for row, head in zip(rows, heads, strict=True):
        x = GAP
        for panel in row:
            draw.text((x, y + 27), panel.head, fill=OCCUPIED, font=font(19, 1.0), anchor="ls")
            page.paste(panel.page, (x, y + head))
            x += panel.page.width + GAP
        y += max(panel.page.height for panel in row) + head + GAP
    x = GAP
    for says, colour in key:
        draw.rectangle((x, y + 6, x + 26, y + 14), fill=colour)
        draw.text((x + 36, y + 16), says, fill=FAINT, font=font(17, 1.0), anchor="ls")
        x += 36 + round(font(17, 1.0).getlength(says)) + 36
    page.quantize(128, dither=Image.Dither.NONE).save(IMAGES / f"{name}.png", optimize=True)
    print(f"{name}.png: {(IMAGES / f'{name}.png').stat().st_size // 1000} kB")


def drive(world: str, seed: int = 1, noise: OdometryNoise | None = None, lidar: LidarConfig | None = None) -> SimulatedLog:
    """A simulated log; the frame of its map has the robot's first pose as origin."""
    rng = np.random.default_rng(seed)
    robot = RobotConfig(v_max_m_s=1.0)
    return simulate(make_world(world, rng), robot, noise or OdometryNoise(), lidar or LidarConfig(rate_hz=4.0), rng)


def extent(grid: OccupancyGrid, margin: float = 0.5) -> tuple[float, float, float, float]:
    """The box of what is known, m."""
    rows, columns = np.flatnonzero(grid.known.any(1)), np.flatnonzero(grid.known.any(0))
    (x, y), cell = grid.origin, grid.resolution_m
    return (
        x + columns[0] * cell - margin, y + rows[0] * cell - margin,
        x + columns[-1] * cell + margin, y + rows[-1] * cell + margin,
    )  # fmt: skip


def mapped(log: SimulatedLog, scans: Sequence[int], mapper: OccupancyGridMapping | None = None) -> tuple[OccupancyGridMapping, object]:
    """A map of some scans, drawn at their true poses seen from the first one."""
    mapper = mapper or OccupancyGridMapping()
    maps, poses = mapper.empty(1), between(log.truth.poses[0], log.truth.poses)
    for k in scans:
        mapper(maps, poses[k][None], log.measurements[k].scan.beams(0.05, 30.0))
    return mapper, maps


class Chart(Panel):
    """Values over an axis: a panel of the box's shape with round values written at its rim."""

    def __init__(self, head: str, box: Sequence[float], wide: int = SIDE, tall: int = SIDE) -> None:
        super().__init__(head, box, wide, tall)
        self.page.paste(FREE, (0, 0, *self.page.size))

    def values(self, xs: Sequence[float], ys: Sequence[float], x_name: str = "", y_name: str = "") -> None:
        """Rule the chart at values of both axes, and name these."""
        draw, small = ImageDraw.Draw(self.page), font(15, 1.0)
        x0, y0, x1, y1 = self.box
        for x in xs:
            self.line(np.array([[x, y0], [x, y1]]), RULE, 1.0)
            draw.text((self.pixels(np.array([[x, y0]]))[0, 0] + 4, self.page.height - 6), f"{x:g}", fill=FAINT, font=small, anchor="ls")  # fmt: skip
        for y in ys:
            self.line(np.array([[x0, y], [x1, y]]), RULE, 1.0)
            draw.text((6, self.pixels(np.array([[x0, y]]))[0, 1] - 4), f"{y:g}", fill=FAINT, font=small, anchor="ls")
        draw.text((self.page.width - 8, self.page.height - 26), x_name, fill=FAINT, font=small, anchor="rs")
        draw.text((8, 18), y_name, fill=FAINT, font=small, anchor="ls")

    def curve(self, x: FloatArray, y: FloatArray, colour: Colour, width: float = 2.0) -> None:
        """Draw y over x."""
        self.line(np.stack([x, y], 1), colour, width)


def grid_fastslam() -> None:
    """A loop before and after it closes: the particles' pasts, and how far they are apart."""
    log = drive("loop")
    told: list[tuple[float, float]] = []
    kept: dict[int, tuple[FloatArray, int, OccupancyGrid]] = {}
    before, after = 93, 101

    def watch(report: StepReport, state: object, seconds: float) -> None:
        if report.skipped is None:
            spread = state.poses[:, :2] - state.poses[:, :2].mean(0)
            told.append((report.n_eff, float(np.sqrt(np.square(spread).sum(1).mean()))))
            if len(told) - 1 in (before, after):
                kept[len(told) - 1] = state.ancestry.trajectories(), state.best, state.maps.occupancy(state.best)

    run(log.measurements, GridFastSlam(), particles=30, rng=np.random.default_rng(0), observers=[watch])
    paths, best, grid = kept[before]
    at = paths[best, -1, :2]
    near = [at[0] - 1.1, at[1] - 1.6, at[0] + 4.9, at[1] + 1.2]
    x0, y0, x1, y1 = extent(grid)
    whole = Panel("the best particle's map when it is back", (x0, y0, x1, y1), tall=round(SIDE * (y1 - y0) / (x1 - x0)))
    whole.grid(grid)
    whole.timed(paths[best, :, :2])
    corners = np.array([[near[0], near[1]], [near[2], near[1]], [near[2], near[3]], [near[0], near[3]], [near[0], near[1]]])  # fmt: skip
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
    save("grid_fastslam", [whole, chart, *zooms], 2, [("spread, m", ORANGE), ("N_eff / 100", TRUTH), ("pasts of the particles", CLOSURE)])  # fmt: skip


def mapping() -> None:
    """A map from known poses: one scan, twenty, all."""
    log = drive("rooms")
    mapper = OccupancyGridMapping()
    box, panels = None, []
    for count in (len(log), 24, 1):
        scans = range(count)
        _, maps = mapped(log, scans, mapper)
        grid = maps.occupancy(0)
        box = box or extent(grid)
        panel = Panel(f"{count} scan{'s' * (count > 1)}", box, 300)
        panel.grid(grid)
        poses = between(log.truth.poses[0], log.truth.poses)
        panel.line(poses[:count:4, :2] if count > 8 else np.repeat(poses[:1, :2], 2, 0), ORANGE, 1.5)
        panel.robot(poses[count - 1])
        panels.append(panel)
    save("mapping", panels[::-1], 3)


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
    mapper, maps = mapped(log, range(0, len(log), 2))
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
        ("CauchyAgreement(), the default", CauchyAgreement()),
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
    save("measurement_models", [*panels, chart], 3, [("where the robot was", ORANGE), ("log likelihood, white from 5 nats below the greatest on", VIOLET)])  # fmt: skip


def resampling() -> None:
    """How much the number of copies varies, by resampler; and who descends from whom in a run."""
    rng, size, draws = np.random.default_rng(0), 30, 4000
    weights = np.sort(rng.dirichlet(np.full(size, 0.7)))
    chart = Chart("standard deviation of a particle's copies", [0, 0, 2.6, 1.6], 430, 360)
    chart.values((0.5, 1, 1.5, 2), (0.5, 1), "copies expected", "")
    colours = {"Multinomial": CLOSURE, "ResamplingWheel": FAINT, "Residual": TRUTH, "Stratified": ORANGE, "Systematic": VIOLET}  # fmt: skip
    for kind in (Multinomial, ResamplingWheel, Residual, Stratified, Systematic):
        counts = np.array([np.bincount(kind()(weights, size, rng), minlength=size) for _ in range(draws)])
        chart.dots(np.stack([size * weights, counts.std(0)], 1), colours[kind.__name__], 11.0 if kind is Multinomial else 6.0)
    parents: list[NDArray[np.int64] | None] = []

    def watch(report: StepReport, state: object, seconds: float) -> None:
        if report.skipped is None:
            parents.append(report.parents)

    log = drive("loop")
    run(log.measurements, GridFastSlam(), particles=30, rng=np.random.default_rng(0), observers=[watch])
    tree = Chart("who descends from whom, 30 particles of a drive twice around a block", [0, -1, len(parents) - 1, 30], 780, 360)  # fmt: skip
    tree.values((50, 100, 150, 200), (), "key scan", "")
    alive = np.ones(30, bool)
    for key in range(len(parents) - 1, 0, -1):
        came = parents[key - 1] if parents[key - 1] is not None else np.arange(30)
        for one in range(30):
            tree.line(np.array([[key - 1, came[one]], [key, one]], np.float64), VIOLET if alive[one] else RULE, 1.5 if alive[one] else 1.0)  # fmt: skip
        alive = np.isin(np.arange(30), came[alive])
    save("resampling", [chart, tree], 2, list(colours.items()))


def scan_matching() -> None:
    """A scan on the distance field before and after; and from which guesses three matchers find the pose."""
    log = drive("rooms")
    mapper, maps = mapped(log, range(0, len(log), 2))
    at = 121
    truth, beams = between(log.truth.poses[0], log.truth.poses)[at], log.measurements[at].scan.beams(0.05, 30.0)
    guess = truth + [0.25, -0.2, 0.12]
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
        ("Gauss-Newton", GaussNewton(), 1500), ("hill climbing", HillClimbing(), 1500),
        ("correlative search", Correlative(), 250),
    ):  # fmt: skip
        offsets = rng.uniform([-1.2, -1.2, -0.6], [1.2, 1.2, 0.6], (count, 3))
        matched = matcher(maps, np.zeros(count, np.int32), truth + offsets, np.tile(prior, (count, 1, 1)), beams).poses
        right = (np.hypot(*(matched - truth)[:, :2].T) < 0.05) & (np.abs(matched - truth)[:, 2] < 0.02)
        chart = Chart(f"{head}: {100 * right.mean():.0f} %", [0, 0, 1.7, 0.6], 2 * SIDE // 3 - 5, 230)
        chart.values((0.5, 1.0, 1.5), (0.2, 0.4), "m off", "rad off")
        colours = [TRUTH if one else ORANGE for one in right.tolist()]
        chart.dots(np.stack([np.hypot(*offsets[:, :2].T), np.abs(offsets[:, 2])], 1), colours, 3.0)
        panels.append(chart)
    save("scan_matching", [_row(panels[:2]), _row(panels[2:])], 1, [("guesses from which the pose is found", TRUTH), ("and from which it is not", ORANGE)])  # fmt: skip


def _row(panels: Sequence[Panel]) -> Panel:
    """Several panels with their heads as a single one."""
    wide, tall = sum(panel.page.width + GAP for panel in panels) - GAP, max(panel.page.height for panel in panels)
    row = Panel("", [0, 0, 1, 1], wide, tall + HEAD)
    draw, x = ImageDraw.Draw(row.page), 0
    for panel in panels:
        draw.text((x, 27), panel.head, fill=OCCUPIED, font=font(19, 1.0), anchor="ls")
        row.page.paste(panel.page, (x, HEAD))
        x += panel.page.width + GAP
    return row


def loop_closure() -> None:
    """The ACES log with a single particle, without and with loop closure; needs the log and its relations."""
    data = Path(os.environ.get("GRIDSLAM_DATA", Path(__file__).parents[2] / "shared" / "data"))
    if not (data / "aces.clf.bz2").exists():
        print(f"loop_closure.png: left as it is, no aces.clf.bz2 in {data} (GRIDSLAM_DATA)")
        return
    panels, relations = [], read_relations(data / "aces.relations")
    for closes, head in ((False, "the filter alone"), (True, "with loop closure")):
        result = map_log(data / "aces.clf.bz2", 1, 0, loop_closure=closes)
        error = relation_errors(result.trajectory, relations)
        panel = Panel(f"{head}: {error.trans_mean_m:.3f} m", [-34, -58, 36, 12])
        panel.grid(result.map)
        panel.timed(result.trajectory.poses[:, :2], 2.0)
        if result.loops is not None:
            for one, other in [*result.loops.closures, *result.loops.revisits[::4]]:
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
    caption = [f"{len(poses)} poses, {len(edges) - len(chain)} loop closures", f"chi2 {solution.chi2_before:.4g} before, {solution.chi2_after:.4g} after {solution.iterations} linear systems"]  # fmt: skip
    picture = draw_graph(solution.graph, graph.poses, title="a simulated town", caption=caption)
    small = picture.resize((1100, round(1100 * picture.height / picture.width)), Image.Resampling.LANCZOS)
    small.quantize(96, dither=Image.Dither.NONE).save(IMAGES / "graph_slam.png", optimize=True)
    print(f"graph_slam.png: {(IMAGES / 'graph_slam.png').stat().st_size // 1000} kB")


def first_map() -> None:
    """What `gridslam demo` writes, smaller."""
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([sys.executable, "-m", "gridslam.cli.main", "demo", "-o", folder], check=True)
        picture = Image.open(Path(folder) / "map.png")
        small = picture.resize((760, round(760 * picture.height / picture.width)), Image.Resampling.LANCZOS)
    small.quantize(96, dither=Image.Dither.NONE).save(IMAGES / "first_map.png", optimize=True)


PICTURES = (
    first_map, grid_fastslam, mapping, motion_models, measurement_models, resampling, scan_matching, loop_closure, graph_slam,
)  # fmt: skip

if __name__ == "__main__":
    for make in PICTURES:
        if len(sys.argv) == 1 or make.__name__ in sys.argv[1:]:
            make()
