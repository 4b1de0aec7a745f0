"""g2o files: what is read, what is written, and what is said of bad ones."""

import gzip

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gridslam.errors import InputError
from gridslam.io.g2o import read_g2o, write_g2o
from gridslam.slam.pose_graph.graph_slam import GraphSlam
from gridslam.slam.pose_graph.pose_graph import PoseGraph

FAR = "2 0 0 3 0 4"  # the end of an information matrix's row of six
SMALL = """# three vertices
EDGE_SE2 7 9 1 0 0.5 2 0.5 0.25 3 0.125 4

VERTEX_SE2 5 0 0 0
VERTEX_SE2 7 1 2 3
VERTEX_SE2 8 -1.5 2e-3 6.5
EDGE_SE2 8 7 0.5 0 -4 1 0 0 1 0 1
FIX 7
VERTEX_SE2 9 3 3 0
EDGE_SE2 5 9 1 1 1 1 0 0 1 0 1
"""


@pytest.fixture
def file(tmp_path):
    def write(text):
        path = tmp_path / "a.g2o"
        path.write_text(text)
        return path

    return write


def test_vertices_edges_and_the_fixed_one(file):
    read = read_g2o(file(SMALL))
    assert read.ids.tolist() == [7, 5, 8, 9]  # the fixed one is pose 0, the others stand as in the file
    assert read.ids[read.order].tolist() == [5, 7, 8, 9]
    np.testing.assert_array_equal(read.graph.poses[:, :2], [[1, 2], [0, 0], [-1.5, 2e-3], [3, 3]])
    np.testing.assert_allclose(read.graph.poses[:, 2], [3, 0, 6.5 - 2 * np.pi, 0])
    assert read.edge_ids.tolist() == [[7, 9], [8, 7], [5, 9]]
    np.testing.assert_allclose(read.graph.measurements, [[1, 0, 0.5], [0.5, 0, 2 * np.pi - 4], [1, 1, 1]])
    np.testing.assert_array_equal(read.graph.information[0], [[2, 0.5, 0.25], [0.5, 3, 0.125], [0.25, 0.125, 4]])
    assert read.graph.trusted.tolist() == [False, True, False]
    assert read.skipped == {}


def test_of_edges_alone_the_vertices_are_what_they_name_and_lie_where_they_agree(file):
    """A square of 2 m sides, walked through once, and a way across it: consistent, so that the guess is exact."""
    sides = [f"EDGE_SE2 {a} {b} 2 0 {np.pi / 2!r} 2 0 0 3 0 4\n" for a, b in ((30, 10), (10, 20), (20, 40), (40, 30))]
    read = read_g2o(file("".join([*sides, f"EDGE_SE2 20 30 2 2 {np.pi!r} {FAR}\n"])))
    assert read.ids.tolist() == [30, 10, 20, 40]
    corners = [[0, 0, 0], [2, 0, np.pi / 2], [2, 2, -np.pi], [0, 2, -np.pi / 2]]
    off = read.graph.poses - corners
    off[:, 2] = np.angle(np.exp(1j * off[:, 2]))
    np.testing.assert_allclose(off, 0, atol=1e-9)
    fixed = read_g2o(file("".join([*sides, "FIX 40\n"])))
    assert fixed.ids.tolist() == [40, 30, 10, 20]
    assert fixed.graph.poses[0].tolist() == [0, 0, 0]
    assert fixed.graph.chi2() < 1e-12


def test_information_that_cannot_be_added_up_is_refused(file):
    edges = [(0, 1, 1e-8), (1, 2, 1e11), (2, 3, 1e6), (0, 3, 1e-17)]
    text = "".join(f"EDGE_SE2 {a} {b} 10 3 2 {i:g} 0 0 {i:g} 0 {i:g}\n" for a, b, i in edges)
    with pytest.raises(InputError, match="information matrices that 64-bit numbers can add up"):
        read_g2o(file(text))


TWO = "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\n"


@pytest.mark.parametrize(
    ("text", "line", "said"),
    [
        (f"{TWO}EDGE_SE2 0 1 1 0 0 2 0 0 3 0\n", 3, "expected 'EDGE_SE2 from to"),
        (f"{TWO}EDGE_SE2 0 1 1 0 0 2 0 0 3 0 4 5\n", 3, "expected 'EDGE_SE2 from to"),
        ("VERTEX_SE2 0 0 0\n", 1, "expected 'VERTEX_SE2 id x y theta', got 'VERTEX_SE2 0 0 0'"),
        ("VERTEX_SE2 0 0 0 zero\n", 1, "zero"),
        ("VERTEX_SE2 0.0 0 0 0\n", 1, "0.0"),
        ("VERTEX_SE2 0 0 1_0 0\n", 1, "1_0"),
        (f"VERTEX_SE2 {2**63} 0 0 0\n", 1, str(2**63)),
        ("VERTEX_SE2 -1 0 0 0\n", 1, "-1"),
        (f"{TWO}FIX\n", 3, "expected 'FIX id'"),
        ("VERTEX_SE2 0 0 nan 0\n", 1, "numbers up to"),
        ("VERTEX_SE2 0 1e10 0 0\n", 1, "numbers up to 1e+09 m and rad for VERTEX_SE2"),
        (f"{TWO}EDGE_SE2 0 1 1 0 0 {FAR.replace('3', '1e999')}\n", 3, "information up to 1e+18"),
        (f"{TWO}VERTEX_SE3 2 0 0 0\n", 3, "--skip-unknown"),
        (f"{TWO}EDGE_SE2 0 1 1 0 0 {FAR}\nEDGE_SE2 1 2 1 0 0 {FAR}\n", 4, "vertex 2, which is not there"),
        (f"{TWO}VERTEX_SE2 0 0 0 0\n", 3, "got 0 again, which line 1 has"),
        (f"{TWO}EDGE_SE2 1 1 1 0 0 {FAR}\n", 3, "from 1 to itself"),
        (f"{TWO}EDGE_SE2 0 1 1 0 0 1 0 0 1 0 0\n", 3, "positive definite"),
        (f"{TWO}EDGE_SE2 0 1 1 0 0 1 2 0 1 0 1\n", 3, "eigenvalue -1"),
        (f"{TWO}EDGE_SE2 0 1 1 0 0 {FAR}\nFIX 2\n", 4, "vertex to fix, got 2"),
        (f"{TWO}EDGE_SE2 0 1 1 0 0 {FAR}\nFIX 1\nFIX 1\nFIX 0\n", 6, "one fixed vertex, got 0 after 1"),
        (f"{TWO}VERTEX_SE2 2 0 0 0\nEDGE_SE2 1 2 1 0 0 {FAR}\n", 2, "2 cannot be reached: 1 2"),
        (f"{TWO}VERTEX_SE2 2 0 0 0\nEDGE_SE2 1 2 1 0 0 {FAR}\nFIX 2", 1, "2 to all others, 1 cannot be reached: 0"),
        ("# nothing\n", None, "expected vertices (VERTEX_SE2) or edges"),
        (f"{TWO}EDGE_SE2 0 1 1 0 0 1e-40 0 0 1e-40 0 1e-40\n", 3, "positive definite"),
        (f"EDGE_SE2 0 1 1 0 0 {FAR}\nEDGE_SE2 2 3 1 0 0 {FAR}\n", 2, "0 to all others, 2 cannot be reached: 2 3"),
        (f"EDGE_SE2 0 1 1 0 0 {FAR}\nFIX 5\n", 2, "vertex to fix, got 5"),
        ("", None, "empty"),
        ("VERTEX_SE2 0 \x00\n", None, "binary"),
    ],
)
def test_bad_files(file, text, line, said):
    path = file(text)
    with pytest.raises(InputError) as caught:
        read_g2o(path)
    assert caught.value.line == line
    assert said in str(caught.value)
    assert str(caught.value).startswith(f"{path}, line {line}: " if line else f"{path}: ")
    assert "\n" not in str(caught.value)


def test_many_lonely_vertices_are_not_all_named(file):
    with pytest.raises(InputError, match=r"99 cannot be reached: 1 2 3 4 5 6 7 8 9 10 \.\.\.$"):
        read_g2o(file("".join(f"VERTEX_SE2 {k} 0 0 0\n" for k in range(100))))


def test_no_file_and_a_cut_off_one(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        read_g2o(tmp_path / "no.g2o")
    lines = "".join(f"VERTEX_SE2 {k} {k * 0.37} 0 0\n" for k in range(500))
    (tmp_path / "cut.g2o").write_bytes(gzip.compress(lines.encode())[:-100])
    with pytest.raises(InputError, match="the compressed file ends in the middle"):
        read_g2o(tmp_path / "cut.g2o")


numbers = st.floats(-1e9, 1e9)
headings = st.floats(-np.pi, np.pi, exclude_max=True)


@st.composite
def graphs(draw):
    """Chains with some closures: any numbers that are read, informations positive definite as written."""
    count = draw(st.integers(1, 5))
    chain = [(k, k + 1) for k in range(count - 1)]
    more = draw(st.lists(st.sampled_from(chain), max_size=3)) if chain else []
    edges = chain + [(b, a) for a, b in more]
    pose = st.tuples(numbers, numbers, headings)
    poses = draw(st.lists(pose, min_size=count, max_size=count))
    measured = draw(st.lists(pose, min_size=len(edges), max_size=len(edges)))
    scales = np.array(draw(st.lists(st.floats(1e-6, 1e6), min_size=len(edges), max_size=len(edges))))
    information = np.array([[2, 0.1, -1], [0.1, 3, 1 / 3], [-1, 1 / 3, 4]]) * scales.reshape(-1, 1, 1)
    ids = draw(st.lists(st.integers(0, 2**63 - 1), min_size=count, max_size=count, unique=True))
    return PoseGraph.of(poses, edges, measured, information), ids, draw(st.permutations(range(count)))


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=60)
@given(graphs())
def test_what_is_written_is_read_back_exactly_and_written_to_the_same_bytes(tmp_path, given_graph):
    graph, ids, order = given_graph
    first, second = tmp_path / "1.g2o", tmp_path / "2.g2o"
    write_g2o(first, graph, ids, order)
    back = read_g2o(first)
    write_g2o(second, back.graph, back.ids, back.order)
    assert second.read_bytes() == first.read_bytes()
    place = [ids.index(name) for name in back.ids.tolist()]
    assert place[0] == 0
    np.testing.assert_array_equal(back.graph.poses, graph.poses[place])
    np.testing.assert_array_equal(back.edge_ids, np.array(ids)[graph.edges])
    np.testing.assert_array_equal(back.graph.measurements, graph.measurements)
    np.testing.assert_array_equal(back.graph.information, graph.information)


@pytest.mark.parametrize(
    ("name", "vertices", "edges", "closures"),
    [("intel", 1728, 2512, 785), ("intel_1228", 1228, 1483, 256), ("m3500", 3500, 5453, 1954), ("ring", 434, 459, 26)],
)
def test_real_graphs(data_dir, name, vertices, edges, closures):
    graph = read_g2o(data_dir / "graphs" / f"{name}.g2o.gz").graph
    assert (len(graph.poses), len(graph.edges), (~graph.trusted).sum()) == (vertices, edges, closures)
    assert np.isfinite(graph.chi2())


def test_landmarks_are_where_their_measurements_put_them(file, tmp_path):
    """Two measurements of one place, each as certain: their mean. The poses stay as if there were no landmark."""
    poses = "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\nEDGE_SE2 0 1 1 0 0 1e6 0 0 1e6 0 1e6\n"
    seen = "EDGE_SE2_XY 0 7 2 2.2 1 0 1\nEDGE_SE2_XY 1 7 1 2 1 0 1\n"
    source = read_g2o(file(f"{poses}VERTEX_XY 7 5 5\n{seen}"))
    assert source.is_landmark.tolist() == [False, False, True]
    assert source.graph.trusted.tolist() == [True, False, False]
    solution = GraphSlam().solve(source.graph)
    np.testing.assert_allclose(solution.graph.poses[2, :2], [2.0, 2.1], atol=1e-5)
    np.testing.assert_allclose(solution.graph.poses[:2], [[0, 0, 0], [1, 0, 0]], atol=1e-5)
    write_g2o(tmp_path / "b.g2o", solution.graph, source.ids, source.order, source.is_landmark)
    text = (tmp_path / "b.g2o").read_text()
    assert text.count("VERTEX_XY 7 ") == 1
    assert "EDGE_SE2_XY 0 7 2.0 2.2 1.0 0.0 1.0\n" in text
    again = read_g2o(tmp_path / "b.g2o")
    np.testing.assert_array_equal(again.is_landmark, source.is_landmark)
    np.testing.assert_array_equal(again.graph.information, source.graph.information)
