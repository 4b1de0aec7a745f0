"""What Rerun reads back of a recording is what the run was. Needs the extra `rerun`; skipped without."""

from __future__ import annotations

import math
import sys

import numpy as np
import pytest

from gridslam.cli.main import main
from gridslam.config import build
from gridslam.errors import ConfigurationError, OutputError
from gridslam.pipeline import run
from gridslam.viz.rerun_recording import RerunRecording
from support.loops import PROVOKED, loop_drive


@pytest.fixture
def rerun():
    return pytest.importorskip("rerun", reason="Rerun (the extra rerun) is not installed")


@pytest.fixture
def read(rerun):
    """Rows of a recording by entity: a dict of lists for each."""
    chunk = pytest.importorskip("rerun.chunk", reason="this Rerun cannot read recordings")

    def rows(path):
        found: dict[str, dict[str, list]] = {}
        for part in chunk.RrdReader(str(path)).stream().to_chunks():
            columns = found.setdefault(part.entity_path.lstrip("/"), {})
            batch = part.to_record_batch()
            for name, values in zip(batch.schema.names, batch.columns, strict=True):
                stamps = str(values.type).startswith("timestamp")
                columns.setdefault(name, []).extend((values.cast("int64") if stamps else values).to_pylist())
        return found

    return rows


def column(rows, ending):
    (found,) = (values for name, values in rows.items() if name.endswith(ending))
    return found


def test_a_run_is_read_back(read, tmp_path):
    drive = loop_drive().measurements[:120]
    reports = []
    with RerunRecording(str(tmp_path / "run.rrd"), "loop", range_max_m=30.0) as recording:
        observers = [recording, lambda report, state, seconds: reports.append(report)]
        source = recording.followed(drive)
        state = run(source, build(PROVOKED), particles=5, rng=np.random.default_rng(1), observers=observers)
        grid, past = state.maps.occupancy(state.best), state.ancestry.trajectory(state.best)
        recording.finish(grid, past, np.array([[0.0, 1.0, 2.0, 3.0]]))
    rows = read(tmp_path / "run.rrd")
    keys = [report for report in reports if report.skipped is None]
    assert [value for (value,) in column(rows["filter/effective_particles"], "Scalars:scalars")] == pytest.approx(
        [report.n_eff for report in keys]
    )
    assert rows["filter/effective_particles"]["stamp"] == [report.stamp_ns for report in keys]
    assert len(column(rows["map/particles"], "Points3D:positions")[-1]) == 5
    pictures, forms = column(rows["map/grid"], "GridMap:data"), column(rows["map/grid"], "GridMap:format")
    assert len(pictures) == math.ceil(len(keys) / 10) + 1
    height, width = grid.known.shape
    assert (forms[-1][0]["width"], forms[-1][0]["height"]) == (width, height)
    cells = np.flipud(np.array(pictures[-1][0], np.uint8).reshape(height, width))
    np.testing.assert_array_equal(cells == 255, ~grid.known)
    np.testing.assert_array_equal(cells[grid.known] > 50, grid.log_odds[grid.known] > math.log(0.505 / 0.495))
    (corner,) = column(rows["map/grid"], "GridMap:translation")[-1]
    assert corner[:2] == pytest.approx(grid.origin)
    (path,) = column(rows["map/path"], "LineStrips3D:strips")[-1]
    np.testing.assert_allclose(np.array(path)[:, :2], past[:, :2], atol=1e-5)
    assert column(rows["map/closures"], "LineStrips3D:strips")[-1][0][1][:2] == [2.0, 3.0]


def test_a_localization_is_read_back(read, tmp_path):
    from gridslam.localization import KnownMap, MonteCarloLocalization
    from support.localization_world import drive, flat_map

    grid, reports = flat_map(), []
    mcl, rng = MonteCarloLocalization(KnownMap(grid)), np.random.default_rng(1)
    state = mcl.init()
    with RerunRecording(str(tmp_path / "run.rrd"), "flat", range_max_m=30.0, known=grid) as recording:
        for odometry, scan in recording.followed(drive(1).measurements):
            state, report = mcl.step(state, odometry, scan, rng)
            recording(report, state, 0.001)
            reports.append(report)
    rows = read(tmp_path / "run.rrd")
    updates = [report for report in reports if report.skipped is None]
    (form,) = column(rows["map/grid"], "GridMap:format")
    assert (form[0]["height"], form[0]["width"]) == grid.known.shape
    for name, told in (("doubt", "lost_probability"), ("particles", "particles"), ("effective_particles", "n_eff")):
        values = [value for (value,) in column(rows[f"filter/{name}"], "Scalars:scalars")]
        assert values == pytest.approx([getattr(report, told) for report in updates])
    clouds = column(rows["map/particles"], "Points3D:positions")
    assert len(clouds) == len(updates)
    assert 100 < max(map(len, clouds)) <= 1000
    strips = column(rows["map/path"], "LineStrips3D:strips")[-1]
    found = [report.pose[:2] for report in updates if not report.lost]
    assert 0 < len(found) < len(updates)
    places = np.concatenate([np.array(strip)[:, :2] for strip in strips])
    assert len(found) - 5 < len(places) <= len(found)  # single places among lost ones make no line
    np.testing.assert_allclose(places[-50:], found[-50:], atol=1e-5)
    assert rows["map/scan"]


@pytest.mark.parametrize(
    ("target", "address"),
    [
        ("127.0.0.1:9876", "rerun+http://127.0.0.1:9876/proxy"),
        ("[::1]:9876", "rerun+http://[::1]:9876/proxy"),
        ("rerun+http://robot:1234/proxy", "rerun+http://robot:1234/proxy"),
    ],
)
def test_an_address_is_streamed_to(rerun, monkeypatch, target, address):
    called = []
    monkeypatch.setattr(
        rerun.RecordingStream, "connect_grpc", lambda self, url, *, default_blueprint: called.append(url)
    )
    with RerunRecording(target, "loop"):
        pass
    assert called == [address]


def test_a_file_that_cannot_be_written_is_named(rerun, tmp_path):
    with pytest.raises(OutputError, match=r"none/run\.rrd: cannot be recorded to"):
        RerunRecording(str(tmp_path / "none" / "run.rrd"), "loop").__enter__()


def test_without_rerun_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(ConfigurationError, match=r"pip install 'gridslam\[rerun\]'"):
        RerunRecording("run.rrd", "loop")


def test_the_command_records_and_its_results_stay_the_same(rerun, read, tmp_path, capsys):
    from gridslam.io.carmen.writer import write_carmen

    write_carmen(tmp_path / "loop.clf", loop_drive().measurements[:60])
    for name, options in (("without", []), ("with", ["--rerun", str(tmp_path / "run.rrd")])):
        assert main(["map", str(tmp_path / "loop.clf"), "-o", str(tmp_path / name), "--particles", "3", *options]) == 0
    for name in ("map.pgm", "trajectory.tum", "trajectory_online.tum", "graph.g2o"):
        assert (tmp_path / "with" / name).read_bytes() == (tmp_path / "without" / name).read_bytes(), name
    rows = read(tmp_path / "run.rrd")
    assert {"map/grid", "map/path", "map/scan", "map/robot", "filter/latency_ms"} <= rows.keys()
