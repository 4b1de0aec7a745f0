"""What landmarks, evaluate and simulate say of what they cannot use: by the option's own name, and nothing is lost."""

import pytest


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["lop"], "WORLD: expected one of demo, loop, rooms, hall, corridor, random"),
        (["loop", "--fov", "0"], "'--fov': 0.0 is not in the range 0<x<=360"),
        (["loop", "--fov", "400"], "'--fov': 400.0 is not in the range 0<x<=360"),
        (["loop", "--fov", "nan"], "'--fov': expected a finite number, got nan"),
        (["loop", "--range-max", "inf"], "'--range-max': expected a finite number, got inf"),
        (["loop", "--rate", "0"], "'--rate': 0.0 is not in the range 0<x<=1000"),
        (["loop", "--rate", "1e9"], "'--rate': 1000000000.0 is not in the range 0<x<=1000"),
        (["loop", "--beams", "1"], "'--beams': 1 is not in the range x>=2"),
        (["loop", "--duration", "-1"], "'--duration': -1.0 is not in the range"),
        (["loop", "--duration", "nan"], "'--duration': expected a finite number, got nan"),
    ],
)
def test_simulate_names_the_option(call, tmp_path, arguments, message):
    status, out, err = call("simulate", *arguments, "-o", tmp_path / "log.clf")
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert message in err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["log.bag", "log.csv", "log.mcap", "log.gz", "log"])
def test_simulate_writes_carmen_under_no_other_name(call, tmp_path, name):
    status, out, err = call("simulate", "rooms", "-o", tmp_path / name, "--duration", 1)
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert f"{name}: expected a name that ends in .clf, .log or .carmen" in err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("pose", ["1,2", "1,2,x", "1,2,inf", "1,2,3,4", ""])
def test_a_pose_is_three_numbers(call, tmp_path, pose):
    status, _, error = call("landmarks", tmp_path / "log.txt", "-o", tmp_path / "out", "--initial-pose", pose)
    assert status == 2
    assert f"--initial-pose': expected X,Y,THETA (m, rad), got {pose!r}" in error
