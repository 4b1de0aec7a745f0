"""What `gridslam doctor` prints, writes and returns."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from gridslam import __version__
from gridslam.api.diagnosis import check_log
from gridslam.cli.output import warn
from gridslam.io.carmen.writer import write_carmen
from gridslam.io.csv import write_csv_log
from gridslam.io.log import LogOptions, open_log
from gridslam.io.measurement import Measurement
from gridslam.io.trajectories import write_tum
from support.faults import with_fault

LASER_KEYS = {
    "scans",
    "rate_hz",
    "beams",
    "field_of_view_rad",
    "direction",
    "range_min_m",
    "range_max_m",
    "invalid_share",
    "no_return_share",
    "mounting",
}
FINDING_KEYS = {"code", "severity", "size", "unit", "message", "remedy", "sensor"}


@pytest.fixture(scope="module")
def reflected(simulated, tmp_path_factory) -> Path:
    """A log that would spoil the map: its beams come the wrong way round."""
    path = tmp_path_factory.mktemp("reflected") / "reflected.clf.gz"
    write_carmen(path, with_fault(simulated.measurements[:400], "reflected_laser", np.random.default_rng(0)))
    return path


def test_a_healthy_log_is_said_to_be_healthy(call, log):
    status, out, err = call("doctor", log)
    assert status == 0
    assert out.startswith(f"{log.name}: 120 scans in 24 s, ")
    assert "This log is healthy" in out.splitlines()[-1]
    assert "-> " not in out
    assert err == ""


def test_one_json_object_tells_all(call, log):
    status, out, err = call("doctor", log, "--json")
    told = json.loads(out)
    assert (status, err) == (0, "")
    assert set(told) == {"schema", "version", "log", "worst", "counts", "findings"}
    assert (told["schema"], told["version"], told["worst"]) == ("gridslam.doctor/3", __version__, "info")
    assert told["log"]["path"] == str(log)
    assert told["log"]["scans"] == 120
    assert told["log"]["duration_s"] == pytest.approx(119 / 5)
    assert 5 < told["log"]["odometry_length_m"] < 20
    (laser,) = told["log"]["lasers"].values()
    assert set(laser) == LASER_KEYS
    assert (laser["scans"], laser["beams"], laser["direction"]) == (120, 180, "counter-clockwise")
    assert laser["rate_hz"] == pytest.approx(5.0)
    assert laser["field_of_view_rad"] == pytest.approx(np.pi)
    assert laser["mounting"]["x_m"] == pytest.approx(0.1)
    assert all(set(finding) == FINDING_KEYS for finding in told["findings"])
    assert told["counts"] == {"info": len(told["findings"]), "warning": 0, "error": 0}
    assert {"topics"} <= {finding["code"] for finding in told["findings"]}


def test_what_spoils_the_map_ends_with_status_3(call, reflected, tmp_path):
    out = tmp_path / "new" / "out"
    status, printed, _ = call("doctor", reflected, "-o", out)
    assert status == 3
    report = json.loads((out / "report.json").read_text())
    spoiling = [finding for finding in report["findings"] if finding["severity"] == "error"]
    assert [finding["code"] for finding in spoiling] == ["reflected_laser"]
    assert report["worst"] == "error"
    assert spoiling[0] == report["findings"][0], "the worst come first"
    assert spoiling[0]["message"] in printed
    assert f"-> {spoiling[0]['remedy']}" in printed
    assert f"report: {out / 'report.txt'}" in printed


def test_a_trajectory_is_scored_by_the_scans_as_they_are_mapped(call, simulated, tmp_path):
    """Drawn as the log declares the beams, the true trajectory of a reflected laser would look wrong: 2.9 times."""
    write_tum(tmp_path / "truth.tum", simulated.truth)
    rng = np.random.default_rng(0)
    scores = []
    for name, fault in (("healthy", None), ("reflected", "reflected_laser")):
        log = tmp_path / f"{name}.csv"
        measurements = simulated.measurements[:400]
        write_csv_log(log, with_fault(measurements, fault, rng) if fault else measurements)
        status, printed, _ = call("evaluate", tmp_path / "truth.tum", log, "--json")
        assert status == 0
        scores.append(json.loads(printed)["self_consistency"]["nats_per_beam"])
    assert scores[1] < 1.5 * scores[0], "the beams of a reversed scan are one step, 1 degree, off"


def test_the_report_is_what_is_printed(call, reflected, tmp_path):
    _, printed, _ = call("doctor", reflected, "-o", tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"report.json", "report.txt"}
    assert printed.startswith((tmp_path / "report.txt").read_text())


def test_a_checked_log_tells_on_stderr_what_is_wrong_at_its_begin(simulated, tmp_path, capsys):
    path = tmp_path / "a.clf"
    write_carmen(path, (Measurement(None, scan) for _, scan in simulated.measurements[:60]))
    assert len(list(check_log(open_log(path), LogOptions(), warn))) == 60
    out, err = capsys.readouterr()
    assert out == ""
    (line,) = err.splitlines()
    assert line.startswith(f"gridslam: {path}: no_odometry: There is no odometry")
    assert "--no-odometry" in line
