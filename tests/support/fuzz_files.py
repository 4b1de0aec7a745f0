"""Small healthy files of every format, damaged at random with stated seeds, and what readers make of them.

Each case is read in a process of its own. It passes where the file is read, or refused by an error that names it;
whatever else comes (another exception, a signal, more than 2 GB, no end) is a failure.
"""

from __future__ import annotations

import bz2
import gzip
import io
import json
import math
import os
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from PIL import Image

from gridslam.api.landmarks import map_landmarks
from gridslam.api.mapping import map_log
from gridslam.cli import map as _map_command  # noqa: F401 imported before processes are forked
from gridslam.cli.main import main
from gridslam.config import Configuration, load, override, preset
from gridslam.doctor import CheckedLog, diagnose
from gridslam.doctor.report import document
from gridslam.errors import ArgumentError, ConfigurationError, InputError
from gridslam.io.csv import write_csv_log
from gridslam.io.edited_maps import apply_edits, check_edits
from gridslam.io.edits import LAYERS, Edit, Edits, parse_edits, read_edits
from gridslam.io.g2o import read_g2o, write_g2o
from gridslam.io.landmark_logs import open_landmark_log
from gridslam.io.log import LogOptions, open_log
from gridslam.io.maps import read_map, write_map
from gridslam.io.ros_parameters import read_parameter_file
from gridslam.io.trajectories import read_relations, read_trajectory, read_trajectory_csv, read_tum
from gridslam.live.history_file import HISTORY_NAME
from gridslam.live.replay import Replay
from gridslam.localization import KnownMap
from gridslam.messages import Messages
from gridslam.plan.drawn_plans import read_drawn_plan
from gridslam.plan.masks import make_keepout_mask, make_speed_mask
from gridslam.slam.pose_graph.graph_slam import GraphSlam
from gridslam.slam.pose_graph.pose_graph import PoseGraph
from support import ros_bags
from support.broken_logs import OF_BYTES, OF_TEXT, damage, drive_about, whole_logs
from support.changes import FLOATS, change_array, change_json
from support.children import run_in_child
from support.fuzz_images import MAP_YAML, images
from support.fuzz_page import page_requests
from support.recorded import map_with_history


@dataclass(frozen=True)
class Family:
    """Cases of one kind of file.

    Attributes
    ----------
    name : str
        What is damaged.
    prepare : callable
        Writes a case's files to an empty folder; gets the folder and the random generator of the case.
    read : callable
        Reads them; gets the folder.
    weight : int
        Cases in relation to other families.
    """

    name: str
    prepare: Callable[[Path, np.random.Generator], None]
    read: Callable[[Path], object]
    weight: float = 1.0


def run_cases(chosen: Sequence[Family], cases: int, seed: int, folder: Path) -> dict[str, list[str]]:
    """Run `cases` cases, shared out by weight; the verdicts of each family: "read", "refused", or what failed.

    Case k of a family has the generator `numpy.random.default_rng([seed, crc32 of the family's name, k])`.
    """
    total = sum(family.weight for family in chosen)
    found: dict[str, list[str]] = {}
    for family in chosen:
        name = zlib.crc32(family.name.encode())
        count = max(1, round(cases * family.weight / total))
        rngs = (np.random.default_rng([seed, name, number]) for number in range(count))
        found[family.name] = [_run_case(family, rng, folder) for rng in rngs]
    return found


def failures(found: dict[str, list[str]]) -> list[str]:
    """Each case that failed, by its family and number."""
    return [
        f"{name}, case {number}: {verdict}"
        for name, verdicts in found.items()
        for number, verdict in enumerate(verdicts)
        if verdict not in ("read", "refused")
    ]


def _run_case(family: Family, rng: np.random.Generator, folder: Path) -> str:
    with TemporaryDirectory(dir=folder) as aside:
        family.prepare(Path(aside), rng)
        return run_in_child(lambda: _read(family, Path(aside)))


def _read(family: Family, folder: Path) -> str:
    """Read a case's files; the verdict."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    try:
        family.read(folder)
    except (InputError, ConfigurationError) as error:
        text = str(error)
        named = isinstance(error, ConfigurationError) or str(folder) in text
        return "refused" if named and "\n" not in text else f"unnamed: {text[:200]}"
    return "read"


def families(folder: Path) -> list[Family]:
    """All families; healthy files are made in `folder`."""
    folder.mkdir(exist_ok=True)
    makers = (
        _logs,
        _names,
        _tables,
        _graphs,
        _landmark_logs,
        _maps,
        _edits,
        _plans,
        _results,
    )
    of_files = [family for maker in makers for family in maker(folder)]
    others = (
        *images(folder),
        *page_requests(folder),
    )
    return [*of_files, *(Family(*family) for family in others)]


FEW = override(preset("default", 2), "loop_closure=false")


def _scan(path: Path, *, keep: bool = False) -> None:
    for odometry, scan in open_log(path, LogOptions(keep_truncated=keep)):
        assert len(scan.ranges) == len(scan.geometry.bearings)
        assert odometry is None or np.isfinite(odometry.pose).all()


def _logs(folder: Path) -> Iterator[Family]:
    """CARMEN, CSV and bags of all kinds, also compressed; what can be read is diagnosed and mapped."""
    (folder / "logs").mkdir(exist_ok=True)
    whole = whole_logs(folder / "logs")

    def prepare(to: Path, rng: np.random.Generator) -> None:
        log = whole[rng.integers(len(whole))]
        (to / log.name).write_bytes(log.damaged(rng)[0])

    def read(where: Path) -> None:
        (path,) = where.iterdir()
        _scan(path, keep=True)
        _scan(path)
        json.dumps(document(diagnose(open_log(path))), allow_nan=False)
        log = CheckedLog(open_log(path), lambda found: None)
        poses = map_log(log, configuration=FEW).trajectory.poses
        assert len(poses) == log.statistics.scan_count > 0
        assert np.isfinite(poses).all()

    yield Family("logs", prepare, read, 6)

    def run_commands(where: Path) -> None:
        (path,) = where.iterdir()
        converted, out = where / "converted.csv", where / "out"
        few = ("--particles", "2", "--no-loop-closure", "--no-history")
        statuses = [_run_command(path, "convert", path, converted), _run_command(path, "map", path, "-o", out, *few)]
        for status, written in zip(statuses, (converted, out / "run.json"), strict=True):
            assert written.exists() == (status == 0), f"{written.name} of a command that ended with {status}"
        if not statuses[0]:
            _scan(converted)
        if any(statuses):
            raise InputError(path, "refused")

    yield Family("commands", prepare, run_commands, 2)


def _run_command(log: Path, *words: object) -> int:
    """Run a command in this process: it succeeds, or ends with status 2 and a line that names the log."""
    told = io.StringIO()
    with redirect_stdout(io.StringIO()), redirect_stderr(told):
        status = main([str(word) for word in words])
    *_, last = ["", *told.getvalue().splitlines()]
    assert status == 0 or (status == 2 and str(log) in last), f"status {status}: {last}"
    return status


def _names(folder: Path) -> Iterator[Family]:
    """Bags by odd names, beside another bag that the name may be taken for."""
    (folder / "names").mkdir(exist_ok=True)
    bags = {}
    for kind in ("db3", "mcap", "ros1"):
        for seconds in (1.0, 2.0):
            written = ros_bags.write(folder / "names", kind, ros_bags.drive(seconds), name=f"{kind}{seconds:g}")
            file = written if written.is_file() else next(written.glob(f"*.{kind}"))
            bags[kind, seconds] = file.read_bytes()

    def prepare(to: Path, rng: np.random.Generator) -> None:
        kind = ("db3", "mcap", "ros1")[rng.integers(3)]
        pieces = ("%", "%41", "%2F", "%00", "%zz", "mode=rw", *"#?&= '\"ä~a;+")
        name = "".join(pieces[k] for k in rng.integers(len(pieces), size=rng.integers(1, 5)))
        for other in ("A", "a", name.split("?")[0].split("#")[0], name.replace("%41", "A")):
            with suppress(OSError, ValueError):
                (to / other).write_bytes(bags[kind, 1.0])
        (to / name).write_bytes(bags[kind, 2.0])
        (to / "name.txt").write_text(name)

    def read(where: Path) -> None:
        log = open_log(where / (where / "name.txt").read_text())
        count = sum(1 for _ in log)
        assert count == 20, f"another file was read: {count} scans"

    yield Family("names", prepare, read)


def _tables(folder: Path) -> Iterator[Family]:
    """Trajectories, relations, parameter files and configurations."""
    rng = np.random.default_rng(0)
    poses = np.cumsum(rng.normal(0, 0.1, (30, 3)), axis=0)
    rows = [f"{0.1 * k:.6f} {x:.6f} {y:.6f} 0 0 0 {math.sin(t / 2):.9f} {math.cos(t / 2):.9f}" for k, (x, y, t) in
            enumerate(poses.tolist())]  # fmt: skip
    covariances = ",1e-4,0,0,1e-4,0,1e-5"
    table = [f"{0.1 * k:.6f},{x:.6f},{y:.6f},{t:.6f}{covariances}" for k, (x, y, t) in enumerate(poses.tolist())]
    header = (
        "stamp_s,x_m,y_m,theta_rad,cov_xx_m2,cov_xy_m2,cov_xtheta_m_rad,cov_yy_m2,cov_ytheta_m_rad,cov_thetatheta_rad2"
    )
    euroc = ["#timestamp,p_x,p_y,p_z,q_w,q_x,q_y,q_z,v_x"] + [
        f"{1700000000000000000 + 10**8 * k},{x:.6f},{y:.6f},0,{math.cos(t / 2):.9f},0,0,{math.sin(t / 2):.9f},0.1"
        for k, (x, y, t) in enumerate(poses.tolist())
    ]
    relations = [f"{k}.5 {k + 1}.5 0.5 0.1 0 0 0 0.2" for k in range(20)]
    parameters = (
        "amcl:\n  ros__parameters:\n    max_particles: 2000\n    laser_model_type: likelihood_field\n"
        "    initial_pose: {x: 1.0, y: 2.0, yaw: 0.5}\n    set_initial_pose: true\n    scan_topic: [a, b]\n"
    )
    configuration = "particles = 10\n\n[motion]\nkind = 'DiffusionMotion'\n\n[tracker]\nmap_scans = 30\n"
    packed = [(gzip.compress, ".gz"), (bz2.compress, ".bz2")]
    beams = [(scan, angle, 1000 + 10 * angle) for scan in range(3) for angle in range(0, 360, 9)]
    named = [f"{'S ' * (not angle)} theta: {angle:.2f} Dist: {distance:08.2f} Q: 47" for _, angle, distance in beams]
    echoed = [f"{k},{k},laser,0,1.9,0.1,0,0.1,0.1,12,{','.join(['1.5'] * 20)}" for k in range(9)]
    numbered = ["scan_id,angle (°),dist_mm", *(f"{scan},{angle},{distance}" for scan, angle, distance in beams)]
    points = ["t; angle [deg]; dist [mm]", *(f"{scan},5; {angle}; {distance}" for scan, angle, distance in beams)]

    def read_scans(path: Path) -> None:
        for _ in open_log(path):
            pass

    for name, lines, read in (
        ("a.tum", rows, read_tum),
        ("a.euroc", euroc, read_trajectory),
        ("a.csv", [header, *table], read_trajectory_csv),
        ("a.relations", relations, read_relations),
        ("a.named", named, read_scans),
        ("a.points", points, read_scans),
        ("a.numbered", numbered, read_scans),
        ("a.echoed", echoed, read_scans),
        ("a.yaml", [parameters], read_parameter_file),
        ("a.toml", [configuration], load),
    ):
        content = ("\n".join(lines) + "\n").encode()

        def prepare(to: Path, rng: np.random.Generator, content: bytes = content, name: str = name) -> None:
            pack = rng.integers(6)
            if pack < 2 and name not in ("a.yaml", "a.toml"):
                (to / name).write_bytes(damage(packed[pack][0](content), OF_BYTES, rng)[0])
            else:
                (to / name).write_bytes(damage(content, OF_TEXT, rng)[0])

        def read_one(where: Path, name: str = name, read: Callable[[Path], object] = read) -> None:  # type: ignore[assignment]
            read(where / name)

        yield Family(f"table {name[2:]}", prepare, read_one)


def _graphs(folder: Path) -> Iterator[Family]:
    """Pose graphs with vertices, and of edges alone."""
    angles = np.arange(24) * 2 * np.pi / 12
    truth = np.stack([5 * np.cos(angles), 5 * np.sin(angles), angles], axis=1)
    pairs = np.array([(k, k + 1) for k in range(23)] + [(k, k + 12) for k in range(12)])
    from gridslam.geometry.se2 import between

    measured = between(truth[pairs[:, 0]], truth[pairs[:, 1]])
    write_g2o(folder / "whole.g2o", PoseGraph.of(truth, pairs, measured, [np.diag([100.0, 100.0, 400.0])] * len(pairs)))
    whole = (folder / "whole.g2o").read_bytes()
    edges = b"".join(line for line in whole.splitlines(keepends=True) if line.startswith(b"EDGE"))

    landmarks = b"VERTEX_XY 99 1 2\nEDGE_SE2_XY 0 99 1 2 100 0 100\nEDGE_SE2_XY 5 99 3 -2 100 10 100\n"
    toro = b"VERTEX2 98 1 2 0.5\nEDGE2 0 98 1 2 0.5 100 0 100 400 0 0\n"

    def prepare(to: Path, rng: np.random.Generator) -> None:
        content = whole + [b"", landmarks, toro, landmarks + toro][rng.integers(4)]
        (to / "a.g2o").write_bytes(damage(content, OF_TEXT, rng)[0])

    def prepare_edges(to: Path, rng: np.random.Generator) -> None:
        lines = edges.splitlines(keepends=True)
        content = b"".join(lines[k] for k in rng.permutation(len(lines)))
        healthy = rng.integers(3) == 0
        (to / "a.g2o").write_bytes(content if healthy else damage(content, OF_TEXT, rng)[0])
        (to / "healthy.txt").write_text(str(healthy))

    def read(where: Path) -> float:
        source = read_g2o(where / "a.g2o")
        try:
            return GraphSlam(max_iterations=30).solve(source.graph).chi2_after
        except ArgumentError as error:  # as the command does
            raise InputError(where / "a.g2o", str(error)) from None

    def read_edges(where: Path) -> None:
        if (where / "healthy.txt").read_text() == "False":
            read(where)
            return
        try:
            chi2 = read(where)
        except InputError as error:
            raise AssertionError(f"a graph of edges alone was refused: {error}") from None
        assert chi2 < 1e-6, f"chi2 {chi2}"

    yield Family("graphs", prepare, read, 2)
    yield Family("graphs of edges alone", prepare_edges, read_edges)


def _landmark_logs(folder: Path) -> Iterator[Family]:
    """MRCLAM and Victoria Park, mapped by EKF SLAM."""
    rng = np.random.default_rng(0)
    park = ["ODOMETRY 0 1 0.5 0 0.1 0.01 0 0 0.01 0 0.001"]
    for k in range(1, 12):
        park += [f"LANDMARK {k} {100 + j} {rng.normal(3, 0.1):.4f} {j - 1.0:.4f} 0.1 0 0.1" for j in range(3)]
        park += [f"ODOMETRY {k} {k + 1} 0.5 0 0.1 0.01 0 0 0.01 0 0.001"]
    park_text = ("\n".join(park) + "\n").encode()
    mrclam = {
        "Robot1_Odometry.dat": "".join(f"{0.1 * k:.3f} 0.2 0.05\n" for k in range(60)),
        "Robot1_Measurement.dat": "".join(f"{0.5 * k:.3f} {61 + k % 3} 2.0{k % 10} 0.1\n" for k in range(12)),
        "Robot1_Groundtruth.dat": "".join(f"{0.1 * k:.3f} {0.02 * k:.3f} 0 0\n" for k in range(60)),
        "Barcodes.dat": "".join(f"{6 + k} {61 + k}\n" for k in range(3)),
        "Landmark_Groundtruth.dat": "".join(f"{6 + k} {k} 2 0.01 0.01\n" for k in range(3)),
    }

    def covariances(content: bytes, rng: np.random.Generator) -> bytes:
        """Replace numbers of some lines by those that are numbers, but of no log."""
        lines = content.split(b"\n")
        for _ in range(rng.integers(1, 4)):
            row = int(rng.integers(len(lines) - 1))
            words = lines[row].split()
            words[rng.integers(3, len(words))] = f"{10.0 ** rng.integers(-300, 300):g}".encode()
            lines[row] = b" ".join(words)
        return b"\n".join(lines)

    def prepare_park(to: Path, rng: np.random.Generator) -> None:
        made = covariances(park_text, rng) if rng.integers(2) else damage(park_text, OF_TEXT, rng)[0]
        (to / "park.txt").write_bytes(made)

    def prepare_mrclam(to: Path, rng: np.random.Generator) -> None:
        chosen = sorted(mrclam)[rng.integers(len(mrclam))]
        for name, text in mrclam.items():
            content = damage(text.encode(), OF_TEXT, rng)[0] if name == chosen else text.encode()
            (to / name).write_bytes(content)

    def read(where: Path) -> None:
        path = where / "park.txt"
        method = "ekf" if path.exists() else "fastslam1"
        log = open_landmark_log(path if path.exists() else where / "Robot1_Odometry.dat")
        result = map_landmarks(log, method, particles=None if method == "ekf" else 5)
        assert np.isfinite(result.trajectory.poses).all()

    yield Family("Victoria Park", prepare_park, read, 2)
    yield Family("MRCLAM", prepare_mrclam, read, 2)


def _maps(folder: Path) -> Iterator[Family]:
    """map.yaml with PGM and PNG."""
    image = np.random.default_rng(0).choice([0, 205, 254], (40, 50)).astype(np.uint8)
    images: dict[str, bytes] = {}
    for name, made in (
        ("map.pgm", Image.fromarray(image)),
        ("map.png", Image.fromarray(image)),
        ("deep.png", Image.fromarray(image.astype(np.uint16) * 257)),
        ("clear.png", Image.fromarray(np.dstack([image, image, image, image]))),
        ("map.tif", Image.fromarray(image)),
        ("map.bmp", Image.fromarray(image)),
    ):
        made.save(folder / name)
        images[name] = (folder / name).read_bytes()

    def prepare(to: Path, rng: np.random.Generator) -> None:
        name = sorted(images)[rng.integers(len(images))]
        yaml = MAP_YAML.replace("map.pgm", name).encode()
        what = rng.integers(3)
        if what == 0:
            lines = yaml.split(b"\n")
            row = int(rng.integers(1, len(lines) - 1))
            number = f"{FLOATS[rng.integers(len(FLOATS))]}".encode()
            pose = [number if place == rng.integers(3) else b"0" for place in range(3)]
            lines[row] = lines[row].split(b":")[0] + b": " + (b"[" + b", ".join(pose) + b"]" if row == 2 else number)
            yaml = b"\n".join(lines)
        (to / "map.yaml").write_bytes(damage(yaml, OF_TEXT, rng)[0] if what == 1 else yaml)
        (to / name).write_bytes(damage(images[name], OF_BYTES, rng)[0] if what == 2 else images[name])

    def read(where: Path) -> None:
        grid = read_map(where / "map.yaml")
        with suppress(ArgumentError):  # a map without walls, which the command refuses by its file
            KnownMap(grid)

    yield Family("maps", prepare, read, 3)


def _edits(folder: Path) -> Iterator[Family]:
    """Edits of a map: their text is damaged, or a value in it is exchanged for another."""
    places = np.array([[0.2, -1.8], [1.2, -1.7], [1.1, -0.5], [0.1, -0.6]])
    points = {"Point": places[:1], "LineString": places[:2], "Polygon": places}
    drawn = tuple(
        Edit(layer, kind, points[kind], "room", 0.2, 20.0) for layer, kinds in LAYERS.items() for kind in kinds
    )
    text = Edits(drawn, "map.yaml", "").to_text()
    image = np.full((40, 50), 254, np.uint8)

    def prepare(to: Path, rng: np.random.Generator) -> None:
        Image.fromarray(image).save(to / "map.pgm")
        (to / "map.yaml").write_text(MAP_YAML)
        if rng.random() < 0.5:
            (to / "edits.geojson").write_bytes(damage(text.encode(), OF_TEXT, rng)[0])
        else:
            document = json.loads(text)
            (to / "edits.geojson").write_text(json.dumps(change_json(document, rng) if rng.integers(2) else document))

    def read(where: Path) -> None:
        edits = read_edits(where / "edits.geojson")
        assert parse_edits(json.loads(edits.to_text()), where).to_text() == edits.to_text()
        grid = read_map(where / "map.yaml")
        check_edits(edits, where / "edits.geojson", where / "map.yaml", grid, lambda remark: None)
        grid = apply_edits(grid, edits)
        make_keepout_mask(grid, edits)
        make_speed_mask(grid, edits)

    yield Family("edits", prepare, read, 2)


def _plans(folder: Path) -> Iterator[Family]:
    """Drawn plans."""
    Image.fromarray(np.random.default_rng(0).choice([0, 255], (40, 50)).astype(np.uint8)).save(folder / "drawn.png")
    whole = (folder / "drawn.png").read_bytes()

    def prepare(to: Path, rng: np.random.Generator) -> None:
        (to / "plan.png").write_bytes(damage(whole, OF_BYTES, rng)[0])

    def read(where: Path) -> None:
        read_drawn_plan(where / "plan.png", 0.02)

    yield Family("plans", prepare, read, 2)


def _results(folder: Path) -> Iterator[Family]:
    """Folders of results, as `gridslam view` reads them."""
    write_csv_log(folder / "drive.csv", drive_about(40))
    result = map_with_history(folder / "drive.csv", folder / "out", configuration=Configuration(particles=3))
    document = json.loads((folder / "out" / "run.json").read_text())
    messages = Messages(lambda level, text: None)
    messages("late scans", "by 2 s")
    document["messages"] = messages.to_list()
    (folder / "out" / "run.json").write_text(json.dumps(document))
    write_map(folder / "out" / "map.yaml", result.map)
    names = ("run.json", HISTORY_NAME, "graph.g2o", "trajectory.tum", "map.yaml", "map.pgm")
    whole = {name: (folder / "out" / name).read_bytes() for name in names}
    record = dict(np.load(folder / "out" / HISTORY_NAME).items())

    def prepare(to: Path, rng: np.random.Generator) -> None:
        chosen = names[rng.integers(len(names))]
        for name, content in whole.items():
            (to / name).write_bytes(content)
        if chosen.endswith(".json") and rng.integers(4):
            (to / chosen).write_text(json.dumps(change_json(json.loads(whole[chosen]), rng)))
        elif chosen == HISTORY_NAME and rng.integers(4):
            changed = dict(record)
            change_array(changed, rng)
            with open(to / chosen, "wb") as file:
                np.savez(file, **changed)
        elif chosen == "map.yaml" and rng.integers(2):
            corner = FLOATS[rng.integers(len(FLOATS))]
            (to / chosen).write_text(MAP_YAML.replace("-1.0", repr(corner)).replace("-2.0", "1e12"))
        else:
            kinds = OF_BYTES if chosen.endswith((".npz", ".pgm")) else OF_TEXT
            (to / chosen).write_bytes(damage(whole[chosen], kinds, rng)[0])

    def read(where: Path) -> None:
        replay = Replay(where)
        viewer = replay.add_viewer()
        for at in (10**6, 0, replay.last // 2):
            viewer.command({"do": "seek", "at": at})
            while viewer.next_message() is not None:
                pass

    yield Family("result folders", prepare, read, 3)
