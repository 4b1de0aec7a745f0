"""TUM and relations files."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gridslam.errors import InputError
from gridslam.io.tables import format_stamp_ns
from gridslam.io.trajectories import read_relations, read_trajectory, read_tum, write_tum
from gridslam.types import Trajectory

stamps = st.integers(-(10**18), 4 * 10**18)
metres = st.floats(-1e4, 1e4)
angles = st.floats(-np.pi, np.pi, exclude_max=True)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=50)
@given(st.lists(st.tuples(stamps, metres, metres, angles), min_size=1, max_size=20))
def test_tum_round_trip(tmp_path, rows):
    poses = np.array([row[1:] for row in rows])
    write_tum(tmp_path / "t.tum", Trajectory(np.array([row[0] for row in rows]), poses))
    back = read_tum(tmp_path / "t.tum")
    assert back.stamps_ns.tolist() == [row[0] for row in rows]
    # Nine decimals: half of 1e-9 in place; twice that in the half angle's sine or cosine, where the other is flat.
    np.testing.assert_allclose(back.poses[:, :2], poses[:, :2], rtol=0, atol=0.6e-9)
    assert np.abs(np.angle(np.exp(1j * (back.poses[:, 2] - poses[:, 2])))).max() < 4e-9
    assert ((back.poses[:, 2] >= -np.pi) & (back.poses[:, 2] < np.pi)).all()


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("1 2 3\n", 1),
        ("1 0 0 0 0 0 0 1\nx 0 0 0 0 0 0 1\n", 2),
        ("1 0 0 0 0 0 0 1\n2 0 y 0 0 0 0 1\n", 2),
        ("1 nan 0 0 0 0 0 1\n", 1),
        ("\n1 0 0 0 0 0 0 2\n", 2),
        ("# only a comment\n", None),
        ("", None),
    ],
)
def test_bad_tum(tmp_path, text, line):
    (tmp_path / "t.tum").write_text(text)
    with pytest.raises(InputError) as caught:
        read_tum(tmp_path / "t.tum")
    assert caught.value.line == line


STAMPS = np.array([1_700_000_000_000_000_000, 1_700_000_000_200_000_001])
POSES = np.array([[1.0, -2.5, 0.3], [1.2, -2.4, 3.1]])
QUATERNIONS = [(np.sin(t / 2), np.cos(t / 2)) for t in POSES[:, 2].tolist()]


def in_form(form):
    """The same two poses in a form of text."""
    lines = {
        "tum": [
            f"{format_stamp_ns(s)} {x} {y} 0 0 0 {z} {w}"
            for s, (x, y, _), (z, w) in zip(STAMPS.tolist(), POSES.tolist(), QUATERNIONS, strict=True)
        ],
        "tum_commas": [
            f"{format_stamp_ns(s)},{x}, {y},0,0,0,{z},{w}"
            for s, (x, y, _), (z, w) in zip(STAMPS.tolist(), POSES.tolist(), QUATERNIONS, strict=True)
        ],
        "tum_ns": [
            f"{s} {x} {y} 0 0 0 {z} {w}" for s, (x, y, _), (z, w) in zip(STAMPS, POSES, QUATERNIONS, strict=True)
        ],
        "tum_names": ["\xef\xbb\xbftimestamp x y z qx qy qz qw"]
        + [
            f"{format_stamp_ns(s)} {x} {y} 0 0 0 {z} {w}"
            for s, (x, y, _), (z, w) in zip(STAMPS.tolist(), POSES.tolist(), QUATERNIONS, strict=True)
        ],
        "euroc": ["#timestamp,p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z []"]
        + [f"{s},{x},{y},0,{w},0,0,{z}" for s, (x, y, _), (z, w) in zip(STAMPS, POSES, QUATERNIONS, strict=True)],
        "euroc_17": [
            f"{s},{x},{y},0,{w},0,0,{z}" + ",0" * 9
            for s, (x, y, _), (z, w) in zip(STAMPS, POSES, QUATERNIONS, strict=True)
        ],
    }[form]
    return "\n".join(lines) + "\n"


FORMS = ["tum", "tum_commas", "tum_ns", "tum_names", "euroc", "euroc_17"]


@pytest.mark.parametrize("form", FORMS)
def test_the_same_trajectory_in_every_form(tmp_path, form):
    (tmp_path / "t.txt").write_bytes(in_form(form).encode("latin-1"))
    back = read_trajectory(tmp_path / "t.txt")
    assert back.stamps_ns.tolist() == STAMPS.tolist()
    np.testing.assert_allclose(back.poses, POSES, atol=1e-9)


def test_a_line_of_commas_alone_is_refused_by_its_number(tmp_path):
    (tmp_path / "t.csv").write_text("1,0,0,0,0,0,0,1\n,,,,,,,\n")
    with pytest.raises(InputError, match=r"t\.csv, line 2: expected 8 numbers"):
        read_trajectory(tmp_path / "t.csv")


@pytest.mark.parametrize(("per_s", "digits"), [(10**3, 13), (10**6, 16)])
def test_whole_stamps_since_1970_are_in_the_unit_that_their_digits_have(tmp_path, per_s, digits):
    stamps = [STAMPS[0] // (10**9 // per_s), STAMPS[0] // (10**9 // per_s) + 1]
    assert len(str(stamps[0])) == digits
    (tmp_path / "t.txt").write_text("".join(f"{stamp} 0 0 0 0 0 0 1\n" for stamp in stamps))
    assert (read_trajectory(tmp_path / "t.txt").stamps_ns - STAMPS[0]).tolist() == [0, 10**9 // per_s]


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("1700000000000000000,0,0,0,1,0,0,0\n1.5,0,0,0,1,0,0,0\n", 2),
        ("1700000000000000000,0,0,0,2,0,0,0\n", 1),
        ("1700000000000000000,0,0,0,1,0,0,x\n", 1),
        ("1700000000000000000 0 0 0 0 0 0 1\n9999999999999999999 0 0 0 0 0 0 1\n", 2),
        ("1 0 0 0 0 1 0 0 0 0 1 0\n", 1),
    ],
)
def test_bad_rows_of_other_forms(tmp_path, text, line):
    (tmp_path / "t.txt").write_text(text)
    with pytest.raises(InputError) as caught:
        read_trajectory(tmp_path / "t.txt")
    assert caught.value.line == line


@pytest.mark.parametrize(
    ("text", "line"), [("1 2 3\n", 1), ("1 2 0 0 0 0 0 0\n1 2 0 0 0 0.5 0 0\n", 2), ("1 2 0 0 0 0 0 inf\n", 1)]
)
def test_bad_relations(tmp_path, text, line):
    (tmp_path / "r.relations").write_text(text)
    with pytest.raises(InputError) as caught:
        read_relations(tmp_path / "r.relations")
    assert caught.value.line == line
