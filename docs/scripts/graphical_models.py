"""Draws the graphical models of the pages.

``python docs/scripts/graphical_models.py`` writes an SVG for each into docs/figures.

An arrow leads from what causes to what is caused. A node's fill says what is known of it: given, sought by sampling,
sought in closed form, or integrated out.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from graphical_model import INK, RADIUS, Picture

FIGURES = Path(__file__).parents[1] / "figures"

TIMES = ("t-2", "t-1", "t")
COLUMNS = (170.0, 320.0, 470.0)
ROW_U, ROW_X, ROW_Z, ROW_M = 90.0, 175.0, 260.0, 350.0


def chain(
    formula: str,
    note: str,
    *,
    past: str,
    now: str,
    landmarks: Iterable[tuple[str, float, str, Sequence[int]]],
    controls: bool = True,
) -> Picture:
    """A robot's way through time: controls above poses, measurements below, and what these show at the bottom.

    Each of `landmarks` is a name, its place across, its kind, and at which of the three times it is seen.
    """
    up = 0 if controls else ROW_X - ROW_U
    picture = Picture(formula, note, (600, ROW_M + RADIUS + 22 - up))
    for k, (time, x) in enumerate(zip(TIMES, COLUMNS, strict=True)):
        if controls:
            picture.add(f"u_{{{time}}}", x, ROW_U, "given")
            picture.arrows.append((f"u_{{{time}}}", f"x_{{{time}}}"))
        picture.add(f"x_{{{time}}}", x, ROW_X - up, now if k == 2 else past)
        picture.add(f"z_{{{time}}}", x, ROW_Z - up, "given")
        picture.arrows.append((f"x_{{{time}}}", f"z_{{{time}}}"))
        if k and controls:
            picture.arrows.append((f"x_{{{TIMES[k - 1]}}}", f"x_{{{time}}}"))
    for name, x, kind, seen in landmarks:
        picture.add(name, x, ROW_M - up, kind)
        picture.arrows += [(name, f"z_{{{TIMES[k]}}}") for k in seen]
    picture.dots += [(80, ROW_X - up), (80, ROW_Z - up)]
    return picture


def one_map(kind: str) -> list[tuple[str, float, str, Sequence[int]]]:
    """A map that every measurement shows."""
    return [("m", COLUMNS[1], kind, (0, 1, 2))]


def two_landmarks(kind: str) -> list[tuple[str, float, str, Sequence[int]]]:
    """Two landmarks, one of them seen twice."""
    return [("m_1", 245.0, kind, (0, 1)), ("m_2", 435.0, kind, (2,))]


def pose_graph() -> Picture:
    """Poses around a block, joined by increments and one closure."""
    picture = Picture(
        "x_{1:t}  =  argmin  Σ e′ Ω e", "squares are measurements: increments, and a loop closure in blue", (600, 330)
    )
    places = [(130, 260), (130, 160), (215, 90), (330, 90), (430, 125), (455, 225), (350, 275), (240, 275)]
    for k, (x, y) in enumerate(places):
        picture.add(f"x_{k}", x, y, "sought" if k else "given")
    picture.factors += [((f"x_{k}", f"x_{k + 1}"), INK) for k in range(len(places) - 1)]
    picture.factors.append((("x_0", "x_7"), "#1e88d2"))
    return picture


def landmark_graph() -> Picture:
    """Poses in a row, and landmarks that several of them see."""
    picture = Picture(
        "x_{1:t}, m  =  argmin  Σ e′ Ω e", "squares are measurements: increments, and sightings in blue", (600, 300)
    )
    for k in range(4):
        picture.add(f"x_{k}", 110 + 127 * k, 115, "sought" if k else "given")
    for k, x in enumerate((175, 300, 425), 1):
        picture.add(f"m_{k}", x, 240, "sought")
    picture.factors += [((f"x_{k}", f"x_{k + 1}"), INK) for k in range(3)]
    for pose, landmark in ((0, 1), (1, 1), (1, 2), (2, 2), (2, 3), (3, 3)):
        picture.factors.append(((f"x_{pose}", f"m_{landmark}"), "#1e88d2"))
    return picture


def matching() -> Picture:
    """One step of a scan matcher."""
    picture = Picture(
        "x_t*  =  argmax  p(z_t | x_t, m) p(x_t | u_t, x_{t-1})",
        "the map is that of the scans before; one pose is sought",
        (600, 372),
    )
    picture.add("u_t", 400, 90, "given")
    picture.add("x_{t-1}", 200, 175, "given")
    picture.add("x_t", 400, 175, "sought")
    picture.add("z_t", 400, 260, "given")
    picture.add("m", 200, 330, "given")
    picture.arrows += [("u_t", "x_t"), ("x_{t-1}", "x_t"), ("x_t", "z_t"), ("m", "z_t")]
    return picture


def closing() -> Picture:
    """A drive that comes back, and the measurement that says so."""
    picture = Picture(
        "p(x_{1:t} | z_{1:t}, u_{1:t}, z_{ij})",
        "the closure is one more measurement: the new place seen from the old one",
        (600, 312),
    )
    places = {
        "x_1": (120, 95),
        "x_i": (260, 95),
        "x_{i+1}": (400, 95),
        "x_{j-1}": (400, 265),
        "x_j": (260, 265),
        "x_t": (120, 265),
    }
    for name, (x, y) in places.items():
        picture.add(name, x, y, "sought")
    picture.add("z_{ij}", 260, 180, "given")
    picture.dots += [(190, 95), (480, 180), (190, 265)]
    picture.arrows += [("x_i", "x_{i+1}"), ("x_{j-1}", "x_j"), ("x_i", "z_{ij}"), ("x_j", "z_{ij}")]
    return picture


def cells() -> Picture:
    """Mapping with known poses, cell by cell."""
    seen = [
        ("m_1", 170.0, "closed", (0,)),
        ("m_2", 270.0, "closed", (0, 1)),
        ("m_3", 370.0, "closed", (1, 2)),
        ("m_4", 470.0, "closed", (2,)),
    ]
    return chain(
        "p(m | x_{1:t}, z_{1:t})  ≈  Π_i p(m_i | x_{1:t}, z_{1:t})",
        "the poses are known; each cell is a binary Bayes filter of its own",
        past="given",
        now="given",
        landmarks=seen,
        controls=False,
    )


PICTURES = {
    "online_slam": chain(
        "p(x_t, m | z_{1:t}, u_{1:t})",
        "earlier poses are integrated out: what they knew stays in the belief",
        past="out",
        now="sought",
        landmarks=one_map("sought"),
    ),
    "full_slam": chain(
        "p(x_{1:t}, m | z_{1:t}, u_{1:t})",
        "every pose is sought, and may still change when a loop closes",
        past="sought",
        now="sought",
        landmarks=one_map("sought"),
    ),
    "localization": chain(
        "p(x_t | z_{1:t}, u_{1:t}, m)",
        "the map is given; earlier poses are integrated out",
        past="out",
        now="sought",
        landmarks=one_map("given"),
    ),
    "ekf_localization": chain(
        "p(x_t | z_{1:t}, u_{1:t}, m)",
        "the landmarks are given; one Gaussian of three numbers is carried on",
        past="out",
        now="sought",
        landmarks=two_landmarks("given"),
    ),
    "mapping": cells(),
    "grid_fastslam": chain(
        "p(x_{1:t} | z_{1:t}, u_{1:t}) · p(m | x_{1:t}, z_{1:t})",
        "a particle is a whole trajectory, and its map follows from it",
        past="sampled",
        now="sampled",
        landmarks=one_map("closed"),
    ),
    "ekf_slam": chain(
        "p(x_t, m_{1:n} | z_{1:t}, u_{1:t})",
        "one Gaussian over all; earlier poses leave correlations behind",
        past="out",
        now="sought",
        landmarks=two_landmarks("sought"),
    ),
    "fastslam": chain(
        "p(x_{1:t} | z_{1:t}, u_{1:t}) · Π_j p(m_j | x_{1:t}, z_{1:t})",
        "given the trajectory nothing joins the landmarks any more",
        past="sampled",
        now="sampled",
        landmarks=two_landmarks("closed"),
    ),
    "pose_graph": pose_graph(),
    "landmark_graph": landmark_graph(),
    "scan_matching": matching(),
    "loop_closure": closing(),
}

if __name__ == "__main__":
    for name, picture in PICTURES.items():
        (FIGURES / f"{name}.svg").write_text(picture.svg(), encoding="utf-8")
