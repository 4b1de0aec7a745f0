"""Animations of building blocks: the resampling wheel, and the Bayes filter of one cell."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
from film import Film
from panels import ORANGE, VIOLET, Chart, Panel
from PIL import Image, ImageDraw

from gridslam.models import InverseSensorModel
from gridslam.types import FloatArray
from gridslam.viz.canvas import CLOSURE, FREE, OCCUPIED, RULE, TRUTH, Colour

_FINE = 3  # times finer than the page, against jagged edges
_WEIGHTS = np.array([0.05, 0.28, 0.03, 0.12, 0.07, 0.25, 0.08, 0.12])


def _shade(k: int) -> Colour:
    """Colour of a particle, from violet to orange."""
    share = k / (len(_WEIGHTS) - 1)
    red, green, blue = (round((1 - share) * a + share * b) for a, b in zip(VIOLET, ORANGE, strict=True))
    return red, green, blue


def _wheel(head: str, points: FloatArray) -> Panel:
    """Draw the weights around a circle, and the points (K,) in [0, 1) at which particles are drawn, the last marked."""
    panel = Panel(head, [-1.3, -1.3, 1.3, 1.3], 400)
    side = panel.page.width * _FINE
    page = Image.new("RGB", (side, side), FREE)
    draw, centre, scale = ImageDraw.Draw(page), side / 2, side / 2.6
    box = [centre - scale, centre - scale, centre + scale, centre + scale]
    ends = np.concatenate([[0.0], np.cumsum(_WEIGHTS)])
    for k, (begin, end) in enumerate(pairwise(ends.tolist())):
        draw.pieslice(box, 360 * begin - 90, 360 * end - 90, fill=_shade(k), outline=FREE, width=3 * _FINE)
    draw.ellipse(
        [centre - 0.45 * scale, centre - 0.45 * scale, centre + 0.45 * scale, centre + 0.45 * scale], fill=FREE
    )
    for k, point in enumerate(points.tolist()):
        newest = k == len(points) - 1
        x, y = math.sin(math.tau * point), -math.cos(math.tau * point)
        near, far = (0.45, 1.24) if newest else (0.9, 1.15)
        line = [
            centre + near * scale * x,
            centre + near * scale * y,
            centre + far * scale * x,
            centre + far * scale * y,
        ]
        draw.line(line, fill=OCCUPIED, width=(5 if newest else 3) * _FINE)
    panel.page.paste(page.resize(panel.page.size, Image.Resampling.LANCZOS), (0, 0))
    return panel


def _counts(points: FloatArray) -> Panel:
    """Draw how often each particle was drawn, and how often is expected."""
    size = len(_WEIGHTS)
    chart = Chart("drawn, and expected (line)", [-0.6, 0.0, size - 0.4, 4.2], 300, 400)
    chart.values((), (1, 2, 3, 4))
    drawn = np.bincount(np.searchsorted(np.cumsum(_WEIGHTS), points % 1.0, side="right") % size, minlength=size)
    for k, count in enumerate(drawn.tolist()):
        if count:
            chart.line(np.array([[k, 0.0], [k, float(count)]]), _shade(k), 18.0)
        mean = size * _WEIGHTS[k]
        chart.line(np.array([[k - 0.42, mean], [k + 0.42, mean]]), OCCUPIED, 2.0)
    return chart


def resampling_wheel() -> None:
    """Draw eight particles by equal steps (low variance resampling), then by random steps, three times each."""
    rng, size = np.random.default_rng(3), len(_WEIGHTS)
    film = Film("resampling_wheel", [("particles, as wide as their weights", VIOLET), ("drawn", OCCUPIED)])
    for name in ("low variance: equal steps", "a wheel: random steps"):
        for _ in range(3):
            if name.startswith("low"):
                points = (rng.random() + np.arange(size)) / size
            else:
                points = (rng.random() + np.cumsum(rng.uniform(0, 2 * _WEIGHTS.max(), size))) % 1.0
            for k in range(1, size + 1):
                film.add([_wheel(name, points[:k]), _counts(points[:k])], hold=k == size)
                if k < size:
                    film.durations[-1] = 180
                else:
                    film.durations[-1] = 1200
    film.still = size - 1
    film.save()


def bayes_filter() -> None:
    """Measure one occupied and one free cell again and again: each hit and each miss adds its evidence."""
    sensor, rng = InverseSensorModel(), np.random.default_rng(6)
    film = Film(
        "bayes_filter", [("log-odds", VIOLET), ("probability of occupied", ORANGE), ("hit", TRUTH), ("miss", CLOSURE)]
    )
    for is_occupied in (True, False):
        log_odds = [0.0]
        for _ in range(28):
            hit = bool(rng.random() < (sensor.true_occupied if is_occupied else sensor.false_occupied))
            log_odds.append(log_odds[-1] + (sensor.log_odds_hit if hit else sensor.log_odds_miss))
            film.add([_beam(is_occupied, hit, log_odds[-1]), _evidence(log_odds)], hold=len(log_odds) == 29)
            if len(log_odds) < 29:
                film.durations[-1] = 200
        if is_occupied:
            film.still = len(film.frames) - 1
    film.save()


def _beam(is_occupied: bool, hit: bool, log_odds: float) -> Panel:
    """Draw a laser, a beam that ends in a cell or passes it, and the cell as dark as it is believed to be occupied."""
    panel = Panel(f"the cell is {'occupied' if is_occupied else 'free'}: {'hit' if hit else 'miss'}", [0, 0, 6, 6], 300)
    panel.page.paste(FREE, (0, 0, *panel.page.size))
    p = 1 / (1 + math.exp(-log_odds))
    shades = np.full((1, 1, 3), 1 - p)[..., :] * np.array(FREE) + p * np.array(OCCUPIED)
    panel.cells(shades.astype(np.uint8), (3.6, 2.6), 0.8)
    corners = np.array([[3.6, 2.6], [4.4, 2.6], [4.4, 3.4], [3.6, 3.4], [3.6, 2.6]])
    panel.line(corners, RULE, 2.0)
    end = 4.0 if hit else 5.8
    panel.line(np.array([[0.8, 3.0], [end, 3.0]]), TRUTH if hit else CLOSURE, 3.0)
    if hit:
        panel.dots(np.array([[4.0, 3.0]]), TRUTH, 10.0)
    panel.robot(np.array([0.8, 3.0, 0.0]), OCCUPIED, 0.5)
    return panel


def _evidence(log_odds: list[float]) -> Chart:
    """Draw log-odds, in nats, and the probability over the measurements."""
    chart = Chart(f"after {len(log_odds) - 1} measurements", [0.0, -12.0, 28.0, 25.0], 420, 300)
    chart.values((10, 20), (-10, 0, 10, 20), "measurements", "nats")
    x, y = np.arange(len(log_odds), dtype=np.float64), np.array(log_odds)
    if len(y) > 1:
        chart.curve(x, 10 / (1 + np.exp(-y)), ORANGE, 2.0)  # 0 to 1, drawn from 0 to 10
        chart.curve(x, y, VIOLET, 2.5)
    return chart
