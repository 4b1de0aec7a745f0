"""What the commands write, print and return."""

import errno
import json
import os
import re
import signal

import numpy as np
import pytest
from PIL import Image

from gridslam import __version__
from gridslam.cli import map as map_module
from gridslam.cli import output as output_module
from gridslam.cli import simulate as simulate_module
from gridslam.cli.main import main
from gridslam.config import dumps
from gridslam.geometry.se2 import between
from gridslam.io.carmen.reader import CarmenLog
from gridslam.io.g2o import read_g2o
from gridslam.io.maps import read_map
from gridslam.io.text import compute_digest
from gridslam.io.trajectories import read_trajectory_csv, read_tum, write_tum
from gridslam.live.history_file import read_history
from gridslam.sim import make_world
from gridslam.types import Trajectory
from support.loops import PROVOKED
from support.refusals import refused

FILES = {
    "map.yaml",
    "map.pgm",
    "map.png",
    "trajectory.tum",
    "trajectory.csv",
    "trajectory_online.tum",
    "graph.g2o",
    "history.npz",
    "run.json",
}
FEW = "--particles", "3"
LINE_EVERY_S = output_module._LINE_EVERY_S  # which the fixture `call` makes infinite


@pytest.fixture(scope="module")
def mapped(log, tmp_path_factory):
    out = tmp_path_factory.mktemp("mapped") / "new" / "out"
    assert main(["map", str(log), "-o", str(out), "--seed", "5", "--particles", "4", "--no-loop-closure"]) == 0
    return out


def test_map_writes_what_the_contract_lists_and_nothing_else(mapped, log):
    assert {path.name for path in mapped.iterdir()} == FILES
    assert [path.name for path in mapped.parent.iterdir()] == ["out"]
    assert read_map(mapped / "map.yaml").known.any()
    with Image.open(mapped / "map.png") as picture:
        assert min(picture.size) > 500


def test_run_json_tells_all_of_the_run(mapped, log):
    run = json.loads((mapped / "run.json").read_text())
    assert run["schema"] == "gridslam.run/3"
    assert (run["version"], run["seed"], run["threads"]) == (__version__, 5, 1)
    assert run["kernels"] in ("compiled", "reference")
    assert run["input"]["sha256"] == compute_digest(log)
    assert run["input"]["path"] == str(log)
    scans = run["scans"]
    assert scans["read"] == 120
    assert scans["used"] + sum(scans["skipped"].values()) == 120
    assert scans["used"] == len(read_history(mapped / "history.npz").stamps_ns)
    assert run["filter"]["particles"] == run["configuration"]["particles"] == 4
    stages = run["time"]["stages"]
    assert {"read", "track", "step", "write", "draw"} <= set(stages)
    for which in ("wall_s", "cpu_s"):
        assert run["time"][which] == pytest.approx(sum(stage[which] for stage in stages.values()))
    for which in ("key_scans", "all_scans"):
        latency = run["latency"][which]
        assert 0 < latency["median_s"] <= latency["p99_s"] <= latency["max_s"]
    assert run["peak_memory_bytes"] > 20e6


def test_the_configuration_of_a_run_can_be_given_back(mapped, log, tmp_path, call):
    import tomli_w

    run = json.loads((mapped / "run.json").read_text())
    file = tmp_path / "effective.toml"
    file.write_text(tomli_w.dumps(run["configuration"]))
    status, _, _ = call("map", log, "-o", tmp_path / "out", "--seed", 5, "--preset", "gmapping", "--config", file)
    assert status == 0
    for name in ("trajectory.tum", "map.pgm"):
        assert (tmp_path / "out" / name).read_bytes() == (mapped / name).read_bytes()


@pytest.fixture(scope="module")
def closed(loop_log, tmp_path_factory):
    """The folder of a run with closures and a correction."""
    folder = tmp_path_factory.mktemp("closed")
    file = folder / "closing.toml"
    file.write_text(dumps(PROVOKED))
    assert main(["map", str(loop_log), "-o", str(folder / "out"), "--config", str(file)]) == 0
    return folder / "out"


def test_trajectory_csv_has_a_covariance_for_every_pose(closed, mapped):
    for folder in (closed, mapped):
        trajectory, covariances = read_trajectory_csv(folder / "trajectory.csv")
        other = read_tum(folder / "trajectory.tum")
        assert trajectory.stamps_ns.tolist() == other.stamps_ns.tolist()
        assert np.abs(between(trajectory.poses, other.poses)).max() < 1e-8
        assert (np.linalg.eigvalsh(covariances) > -1e-9).all()
        assert covariances[-1].trace() > 0


def test_graph_holds_the_key_scans_and_what_was_measured_between_them(closed, mapped, call, tmp_path):
    """Without loop closure it solves to itself; else the surfaces have had their say in the poses, too."""
    for folder, ties in ((closed, True), (mapped, False)):
        run = json.loads((folder / "run.json").read_text())
        graph = read_g2o(folder / "graph.g2o").graph
        assert len(graph.poses) == run["scans"]["used"]
        assert (len(graph.edges) > len(graph.poses)) == ties
        status, out, _ = call("graph", folder / "graph.g2o", "-o", tmp_path / "graph", "--json")
        assert status == 0
        solved = json.loads(out)
        assert solved["chi2_after"] <= solved["chi2_before"] * (1 + 1e-9) + 1e-9
        if not ties:
            assert solved["chi2_after"] == pytest.approx(solved["chi2_before"], rel=1e-3, abs=1e-9)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_interrupt_during_final_refinement_leaves_nothing(call, log, tmp_path, monkeypatch, number):
    def interrupt(*_, **__):
        os.kill(os.getpid(), number)

    monkeypatch.setattr("gridslam.api.mapping.full_slam", interrupt)
    status, out, err = call("map", log, "-o", tmp_path / "out", *FEW)
    assert (status, out, err.strip()) == (130, "", "gridslam: interrupted")
    assert not list(tmp_path.iterdir())


def test_progress_of_what_takes_unknown_time_has_no_percentage(monkeypatch, capsys):
    monkeypatch.setattr(output_module, "_LINE_EVERY_S", 0.0)
    monkeypatch.setattr(output_module, "_interrupted", False)  # tests before may have left it
    with output_module.open_progress() as on_progress:
        on_progress()
    assert capsys.readouterr().err == "1 step\n"


def test_progress_is_a_plain_line_now_and_then_and_none_with_json(log, tmp_path, call, monkeypatch):
    monkeypatch.setattr(output_module, "_LINE_EVERY_S", 0.0)
    _, _, err = call("map", log, "-o", tmp_path / "out", *FEW)
    lines = err.splitlines()
    assert len(lines) >= 120  # one for each scan, and those of the final refinement
    assert all(re.fullmatch(r" *\d+%  \d+ steps?", line) for line in lines)
    status, out, err = call("map", log, "-o", tmp_path / "out", *FEW, "--json")
    assert (status, err) == (0, "")
    assert json.loads(out) == json.loads((tmp_path / "out" / "run.json").read_text()), "one object, and all there is"


def test_options_go_preset_then_file_then_set(log, tmp_path, call):
    file = tmp_path / "my.toml"
    file.write_text("particles = 7\n[when_to_update]\ntranslation_m = 0.5\nrotation_rad = 0.4\n")
    options = "--preset", "gmapping", "--config", file, "--set", "key_scan_m=0.3", "--set", "motion.srr=0.2"
    status, out, _ = call("map", log, "-o", tmp_path / "out", *options, *FEW, "--json")
    assert status == 0
    configuration = json.loads(out)["configuration"]
    assert (configuration["particles"], configuration["range_max_m"], configuration["motion"]["srr"]) == (3, 80.0, 0.2)
    assert configuration["when_to_update"] == {"translation_m": 0.3, "rotation_rad": 0.4}


def test_map_replaces_an_earlier_result_and_leaves_other_files(log, tmp_path, call):
    (tmp_path / "map.png").write_text("old")
    (tmp_path / "notes.txt").write_text("mine")
    status, out, err = call("map", log, "-o", tmp_path, *FEW)
    assert (status, err) == (0, "")
    assert "0 loop closures (0 recognized, 0 tracked), 0 online corrections" in out
    assert out.startswith("rooms.clf.bz2: 120 scans, 24 s, ")
    assert str(tmp_path / "map.png") in out
    assert {path.name for path in tmp_path.iterdir()} == FILES | {"notes.txt"}
    assert (tmp_path / "map.png").read_bytes()[:4] == b"\x89PNG"


GOOD = "FLASER 3 1.0 2.0 1.5 0 0 0 0 0 0 {0}.0 host {0}.0\n"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "no such file"),
        (b"", "the file is empty"),
        ((GOOD.format(1) + "FLASER 3 1.0 2.0\n" + GOOD.format(3)).encode(), "bad.clf, line 2: "),
    ],
)
def test_bad_log_is_named_with_what_is_wrong(call, tmp_path, content, message):
    path = tmp_path / "bad.clf"
    if content is not None:
        path.write_bytes(content)
    err = refused(call, tmp_path, "map", path, "-o", tmp_path / "out")
    assert str(path) in err
    assert message in err


def test_cut_off_log_is_refused_or_mapped_on_request(call, tmp_path, simulated):
    from gridslam.io.carmen.writer import write_carmen

    path = tmp_path / "cut.clf.gz"
    write_carmen(path, simulated.measurements[:120])
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    err = refused(call, tmp_path, "map", path, "-o", tmp_path / "out", *FEW)
    assert "cut off" in err
    assert "scans were read before" in err
    status, out, err = call("map", path, "-o", tmp_path / "out", *FEW, "--keep-truncated", "--json")
    assert status == 0
    run = json.loads(out)
    assert run["input"]["truncated"]
    assert 20 < run["scans"]["read"] < 120
    assert len(read_tum(tmp_path / "out" / "trajectory.tum")) == run["scans"]["read"]
    assert err == f"gridslam: {path}: the log is truncated after {run['scans']['read']} scans\n"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--preset", "gmaping"], "preset: expected default, gmapping, got 'gmaping'; did you mean"),
        (["--set", "insrt_m=1"], "insrt_m: no such parameter; did you mean insert_m"),
        (["--set", "insert_m=-1"], "tracker.insert_m: expected a number greater than or equal to 0.000001, got -1"),
        (["--set", "insert_m"], "expected name=value, got 'insert_m'"),
        (["--particles", "0"], "particles: expected a number greater than or equal to 1, got 0"),
        (["--particles", "many"], "'--particles': 'many' is not a valid integer"),
        (["--threads", "0"], "'--threads': 0 is not in the range"),
        (["--seed", "-1"], "'--seed': -1 is not in the range"),
        (["--config", "none.toml"], "none.toml: cannot be read: No such file or directory"),
        (["--sed", "1"], "No such option"),
    ],
)
def test_bad_option_is_told_before_anything_is_done(call, log, tmp_path, options, message):
    assert message in refused(call, tmp_path, "map", log, "-o", tmp_path / "out", *options)


@pytest.mark.parametrize(
    "arguments", [[], ["map"], ["mapp"], ["map", "a.clf"], ["evaluate", "a.tum"], ["--sed"], ["dataset"]]
)
def test_bad_usage_is_one_line_that_says_where_to_read_on(call, tmp_path, arguments):
    command = "gridslam" if arguments[:1] in ([], ["mapp"], ["--sed"]) else f"gridslam {arguments[0]}"
    problem = refused(call, tmp_path, *arguments)
    assert problem.endswith(f" (see {command} --help)\n")
    assert "Usage:" not in problem


@pytest.mark.skipif(os.geteuid() == 0, reason="the superuser may write everywhere")
def test_folder_without_permission(call, log, tmp_path):
    (tmp_path / "closed").mkdir(mode=0o500)
    err = refused(call, tmp_path, "map", log, "-o", tmp_path / "closed" / "out")
    assert "cannot be written: Permission denied" in err


def test_a_run_that_fails_leaves_nothing_and_returns_1(call, log, tmp_path, monkeypatch):
    def full_disk(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("gridslam.api.result.write_tum", full_disk)
    err = refused(call, tmp_path, "map", log, "-o", tmp_path / "out", *FEW, status=1)
    assert "No space left on device" in err


def test_a_bug_is_a_traceback_and_a_line_that_asks_to_report_it(call, log, tmp_path, monkeypatch):
    def bug(*_, **__):
        raise ZeroDivisionError("a is\nno number")

    monkeypatch.setattr(map_module, "map_log", bug)
    status, out, err = call("map", log, "-o", tmp_path / "out")
    assert (status, out) == (70, "")
    assert "in map_with_progress" in err
    assert "ZeroDivisionError: a is" in err
    assert err.splitlines()[-1] == (
        f"gridslam: this is a bug of gridslam {__version__}, please report it with the lines above"
    )
    assert not list(tmp_path.iterdir())


def test_evaluate_against_a_trajectory(call, log, tmp_path):
    truth = read_tum(log.with_name("truth.tum"))
    moved = Trajectory(truth.stamps_ns, truth.poses + np.array([3.0, -2.0, 0.0]))
    write_tum(tmp_path / "moved.tum", moved)
    status, out, err = call("evaluate", tmp_path / "moved.tum", log.with_name("truth.tum"), "--json")
    assert (status, err) == (0, "")
    scores = json.loads(out)
    assert scores["schema"] == "gridslam.evaluation/1"
    assert scores["ate"]["n"] == len(truth)
    assert scores["ate"]["trans_max_m"] < 1e-6  # aligned
    assert scores["rpe"]["trans_max_m"] < 1e-6
    assert scores["rpe"]["distance_m"] == 1.0
    status, out, _ = call("evaluate", tmp_path / "moved.tum", log.with_name("truth.tum"), "--distance", 2)
    assert status == 0
    assert "ATE: 0.0000 m" in out
    assert "(over 2 m)" in out


def test_evaluate_against_relations(call, tmp_path):
    stamps = np.array([1_000_000_000, 2_000_000_000])
    write_tum(tmp_path / "t.tum", Trajectory(stamps, np.array([[0.0, 0.0, 0.0], [1.25, 0.0, 0.0]])))
    (tmp_path / "t.relations").write_text("1.0 2.0 1.0 0.0 0 0 0 0.0\n")
    status, out, _ = call("evaluate", tmp_path / "t.tum", tmp_path / "t.relations", "--json")
    assert status == 0
    relations = json.loads(out)["relations"]
    assert (relations["n"], relations["exact"]) == (1, 1.0)
    assert relations["trans_mean_m"] == pytest.approx(0.25)
    assert "relations: 0.2500 +- 0.0000 m" in call("evaluate", tmp_path / "t.tum", tmp_path / "t.relations")[1]


def test_evaluate_against_the_log_itself(call, log, tmp_path):
    truth = read_tum(log.with_name("truth.tum"))
    noise = np.random.default_rng(0).normal(0, 0.03, truth.poses.shape)
    write_tum(tmp_path / "noisy.tum", Trajectory(truth.stamps_ns, truth.poses + noise))
    scores = []
    for trajectory in (log.with_name("truth.tum"), tmp_path / "noisy.tum"):
        status, out, err = call("evaluate", trajectory, log, "--json")
        assert (status, err) == (0, "")
        document = json.loads(out)
        assert set(document) == {"schema", "trajectory", "reference", "self_consistency"}
        assert set(document["self_consistency"]) == {"scans", "beams", "nats_per_beam", "sharpness_m"}
        scores.append(document["self_consistency"]["nats_per_beam"])
    assert scores[0] < scores[1]
    assert "nats a beam" in call("evaluate", tmp_path / "noisy.tum", log)[1]


def test_simulate_writes_a_log_and_the_truth_beside_it(call, tmp_path):
    path = tmp_path / "new" / "loop.clf.gz"
    options = "--duration", 10, "--beams", 91, "--people", 1, "--seed", 3
    status, out, err = call("simulate", "loop", "-o", path, *options, "--json")
    assert (status, err) == (0, "")
    told = json.loads(out)
    assert told["schema"] == "gridslam.simulation/1"
    assert {file.name for file in path.parent.iterdir()} == {"loop.clf.gz", "loop.truth.tum"}
    scans = [scan for _, scan in CarmenLog(path)]
    assert told["scans"] == len(scans) == 51
    assert {len(scan) for scan in scans} == {91}
    assert read_tum(path.with_name("loop.truth.tum")).stamps_ns.tolist() == [scan.stamp_ns for scan in scans]
    again = tmp_path / "again.clf.gz"
    assert call("simulate", "loop", "-o", again, *options)[0] == 0
    assert again.read_bytes() == path.read_bytes()


def test_demo_maps_a_simulated_building_and_tells_its_errors(call, tmp_path, monkeypatch):
    """In a smaller building; the first page runs it in the office."""
    monkeypatch.setattr(simulate_module, "make_world", lambda name, rng: make_world("rooms", rng))
    status, out, err = call("demo", "-o", tmp_path / "demo", "--json")
    assert (status, err) == (0, "")
    told = json.loads(out)
    assert told["schema"] == "gridslam.demo/1"
    assert {path.name for path in (tmp_path / "demo").iterdir()} == FILES | {"demo.clf.gz", "truth.tum"}
    assert told["run"]["input"]["path"] == str(tmp_path / "demo" / "demo.clf.gz")
    assert told["run"]["input"]["sha256"] == compute_digest(tmp_path / "demo" / "demo.clf.gz")
    assert told["errors"]["ate"]["trans_rmse_m"] < 0.1 < told["odometry_errors"]["ate"]["trans_rmse_m"]


@pytest.mark.parametrize("asked", [["--particles", "8"], ["--map", "map.yaml"]])
def test_a_node_gets_the_options_that_were_given_and_no_others(monkeypatch, asked):
    """Else what a parameter file says, of `floor` for one, is overridden, and a node that localizes is warned of it."""
    given = {}
    run = "gridslam.ros.ros2.rclpy_transport.run_rclpy"
    monkeypatch.setattr(run, lambda arguments, options: given.update(options.given))
    assert main(["ros2", *asked]) == 0
    assert given in ({"particles": 8}, {"map_file": "map.yaml"})
