"""What a session in Python or a notebook shows of results: one line each, a picture of each map, and tables."""

from __future__ import annotations

import io
import re
import sys

import numpy as np
import pytest
from PIL import Image

import gridslam
from gridslam.types import Trajectory

LONGEST = 200


@pytest.fixture(scope="module")
def mapped(log):
    return gridslam.map_log(log, particles=2)


@pytest.fixture(scope="module")
def results(log, mapped, park, tmp_path_factory):
    folder = tmp_path_factory.mktemp("landmarks")
    landmarks = gridslam.map_landmarks(park[0], "ekf")
    landmarks.save(folder / "out")
    return {
        "MapResult": mapped,
        "LocalizationResult": gridslam.localize(log, mapped.map, pose=np.zeros(3)),
        "GridResult": gridslam.map_with_poses(log, mapped.trajectory),
        "LandmarkResult": landmarks,
        "LandmarkLocalizationResult": gridslam.localize_by_landmarks(park[0], folder / "out" / "landmarks.csv"),
    }


def one_line(thing):
    text = repr(thing)
    assert text == text.strip()
    assert "\n" not in text
    assert len(text) <= LONGEST, text
    assert text.startswith(f"{type(thing).__name__}(")
    return text


def test_results_are_one_line_with_their_main_figures(results):
    told = {name: one_line(result) for name, result in results.items()}
    assert re.search(r"rooms\.clf\.bz2: 120 scans, 24 s, \d+ m driven, .*2 particles, seed 0", told["MapResult"])
    assert re.search(r"rooms\.clf\.bz2: 120 scans, 24 s, .*lost at 0", told["LocalizationResult"])
    assert re.search(r"rooms\.clf\.bz2: 120 scans", told["GridResult"])
    assert "landmarks" in told["LandmarkResult"]
    assert "landmarks" in told["LandmarkLocalizationResult"]


def test_values_are_one_line(log, mapped):
    measurements = list(gridslam.open_log(log))
    (odometry, scan), slam = measurements[-1], gridslam.GridFastSlam()
    state, report = slam.init(odometry, scan, 2)
    known = gridslam.KnownMap(mapped.map)
    localizer = gridslam.MonteCarloLocalization(known)
    told = [
        one_line(thing)
        for thing in (
            odometry,
            scan,
            scan.geometry,
            scan.beams(0.1, 30.0),
            mapped.trajectory,
            mapped.map,
            mapped.graph,
            mapped.state,
            report,
            known,
            localizer.init(),
            gridslam.diagnose(log),
            mapped.loop_summary,
            localizer.step(localizer.init(), odometry, scan, np.random.default_rng(0))[1],
            mapped.log,
        )
    ]
    assert "180 beams" in told[1]
    assert "120 poses" in told[4]
    assert "cells of 0.05 m" in told[5]
    slam.step(state, odometry, scan, np.random.default_rng(0))
    assert "consumed" in one_line(state)
    assert "0 poses" in one_line(Trajectory(np.zeros(0, np.int64), np.zeros((0, 3))))
    assert "no cell known" in one_line(empty_grid())


def empty_grid(shape=(0, 0)):
    return gridslam.OccupancyGrid(np.zeros(shape, np.float32), np.zeros(shape, bool), 0.05, (0.0, 0.0))


def test_a_notebook_shows_the_map(results):
    for name, result in results.items():
        picture = Image.open(io.BytesIO(result._repr_png_()))
        assert max(picture.size) <= 1000, name
        assert np.ptp(np.asarray(picture.convert("L"))) > 100, name
        assert result.picture().size > picture.size, name


def test_a_grid_is_shown_as_map_files_have_it(mapped):
    grid = mapped.map
    pixels = np.asarray(Image.open(io.BytesIO(grid._repr_png_())))
    assert pixels.shape == grid.known.shape
    assert ((pixels == 205) == ~grid.known[::-1]).all()
    assert ((pixels < 100) <= (grid.log_odds > 0)[::-1]).all()
    assert (pixels[(grid.log_odds > 2)[::-1] & grid.known[::-1]] < 50).all()
    large = empty_grid((5, 3001))
    large.known[2, 1500] = True
    large.log_odds[2, 1500] = 5.0
    shrunk = np.asarray(Image.open(io.BytesIO(large._repr_png_())))
    assert max(shrunk.shape) <= 1000
    assert (shrunk < 50).any()  # a wall of one cell is still there
    assert empty_grid()._repr_png_() is None


@pytest.mark.dev
def test_a_result_becomes_a_table(results):
    import pandas

    for name, result in results.items():
        table, poses = result.to_dataframe(), result.trajectory
        assert table["stamp_ns"].dtype == np.int64
        assert np.array_equal(table["stamp_ns"], poses.stamps_ns), name
        assert np.array_equal(table[["x_m", "y_m", "theta_rad"]], poses.poses), name
    table = results["MapResult"].to_dataframe()
    assert np.array_equal(table["cov_xtheta_m_rad"], results["MapResult"].covariances[:, 0, 2])
    lost = results["LocalizationResult"].to_dataframe()["lost"]
    assert lost.dtype == bool
    assert isinstance(lost, pandas.Series)


def test_without_pandas_the_extra_is_named(mapped, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(gridslam.GridslamError, match=r"needs pandas.*pip install 'gridslam\[pandas\]'"):
        mapped.to_dataframe()


def test_a_session_a_trajectory_and_a_diagnosis_show_themselves(log):
    session = gridslam.Session(gridslam.Configuration(particles=2))
    assert session._repr_png_() is None
    session.add(log)
    assert Image.open(io.BytesIO(session._repr_png_())).format == "PNG"
    one_line(session)
    assert len(repr(session.pieces)) < LONGEST
    one_line(session.pieces[0].drives[0])
    trajectory = next(iter(session.trajectories.values()))
    assert re.fullmatch(r"<svg .*<polyline points=\"[\d., ]+\".*</svg>", trajectory._repr_svg_())
    assert "nan" not in Trajectory(np.zeros(0, np.int64), np.zeros((0, 3)))._repr_svg_()
    diagnosis = gridslam.diagnose(log)
    assert diagnosis._repr_html_().count("<li>") == len(diagnosis.findings)
