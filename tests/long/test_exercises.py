"""The exercises: each solution passes, each notebook as given fails at its first check, and so do wrong solutions."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import pytest

FOLDER = Path(__file__).parents[2] / "exercises"
GIVEN = sorted(path for path in FOLDER.glob("*.ipynb") if not path.stem.endswith("_solution"))
pytestmark = pytest.mark.filterwarnings("ignore:FigureCanvasAgg is non-interactive")

WRONG = (
    ("01", "sigma1 = math.sqrt(a1 * rot1**2 + a2 * trans**2)", "sigma1 = a1 * rot1**2 + a2 * trans**2"),
    ("01", "a3 * trans**2 + a4 * (rot1**2 + rot2**2)", "a3 * trans**2"),
    ("01", "s * np.cos(poses[:, 2] + r1)", "s * np.cos(poses[:, 2])"),
    ("02", "/ (sigma * seen)", "/ sigma"),
    ("02", "model.z_max + model.z_hit * norm.cdf((expected - model.range_max_m) / sigma) / seen", "model.z_max"),
    ("02", "-0.5 * np.square(distances / model.sigma_hit_m)", "-np.square(distances / model.sigma_hit_m)"),
    ("03", "2 * k * difference + steps", "2 * k * difference"),
    ("03", "k = np.arange(steps)", "k = np.arange(steps + 1)"),
    ("03", "np.log(sensor.false_free / sensor.true_free)", "np.log((1 - sensor.true_free) / sensor.true_free)"),
    ("04", "[[1, 0, -s * dx - c * dy], [0, 1, c * dx - s * dy]", "[[1, 0, -s * dx + c * dy], [0, 1, c * dx + s * dy]"),
    ("04", "V @ noise @ V.T", "noise"),
    ("04", "innovation[1] = math.remainder(innovation[1], math.tau)", "pass"),
    ("05", "(rng.random() + np.arange(size))", "np.sort(rng.random(size) * size)"),
    ("05", "return moved[low_variance_resampling(weights, len(moved), rng)]", "return moved"),
    ("05", "log_likelihood(moved)", "log_likelihood(poses)[::-1]"),
    ("06", "w = 1 / (1 + np.square(d / 0.1))", "w = np.ones_like(d)"),
    ("06", "for _ in range(20)", "for _ in range(1)"),
    ("07", "F[:2, 2] = -s * dx - c * dy, c * dx - s * dy", "pass"),
    ("07", "across = A @ P[:3]", "across = 0 * A @ P[:3]"),
    ("07", "inverse @ Q @ inverse.T", "Q"),
    ("08", "H_m @ covariances @ H_m.swapaxes(1, 2) + Q\n    K = cov", "Q + 0 * covariances\n    K = cov"),
    (
        "08",
        "return moved, (np.eye(3) - K @ H_x) @ spreads, log_density(residual, L)",
        "return moved, spreads, log_density(residual, L)",
    ),
    ("08", "(np.eye(3) - K @ H_x) @ spreads, log_density(residual, L)", "(np.eye(3) - K @ H_x) @ spreads, 0.0"),
    ("09", "A[:2, 2] = turn @ [dy, -dx]", "pass"),
    ("09", "angle = x_i[2] + z[2]", "angle = x_i[2]"),
    ("09", "b += J.T @ omega @ e", "b += J.T @ e"),
    (
        "10",
        "np.exp(log_weights - log_weights.max())\n    return weights.sum() ** 2",
        "np.exp(log_weights)\n    return 1",
    ),
    ("10", "poses = MATCHER(maps, rows, poses, np.zeros((count, 3, 3)), beams).poses", "pass"),
    ("10", "poses = poses[parents]", "pass"),
)
"""Exercise, a part of its solution, and what a student may write instead."""


def cells(path: Path) -> Iterator[str]:
    for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
        if cell["cell_type"] == "code":
            yield "".join(cell["source"])


def run(codes: list[str], monkeypatch) -> tuple[str, BaseException | None]:
    """Run cells from the first one on: the last cell that ran, and what it raised."""
    mpl.use("Agg")
    monkeypatch.chdir(FOLDER)
    names: dict[str, object] = {"__name__": "__main__"}
    try:
        for code in codes:
            exec(compile(code, os.fspath(FOLDER), "exec"), names)
    except Exception as error:  # whatever a student's code raises
        return code, error
    finally:
        plt.close("all")
    return code, None


def solution(path: Path) -> Path:
    return path.with_name(f"{path.stem}_solution.ipynb")


@pytest.mark.parametrize("path", GIVEN, ids=lambda path: path.stem)
def test_a_solution_runs_to_its_end_and_passes(path, monkeypatch, capsys):
    _, error = run(list(cells(solution(path))), monkeypatch)
    assert error is None
    passed = sum("checks." in code and 'print("passed")' in code for code in cells(path))
    assert capsys.readouterr().out.count("passed") == passed > 0


@pytest.mark.parametrize("path", GIVEN, ids=lambda path: path.stem)
def test_an_exercise_as_given_fails_at_its_first_check(path, monkeypatch, capsys):
    code, error = run(list(cells(path)), monkeypatch)
    assert isinstance(error, NotImplementedError)
    assert "checks." in code
    assert "passed" not in capsys.readouterr().out


@pytest.mark.parametrize(("number", "right", "wrong"), WRONG, ids=[f"{n}-{k}" for k, (n, _, _) in enumerate(WRONG)])
def test_a_wrong_solution_fails_at_a_check(number, right, wrong, monkeypatch):
    (path,) = FOLDER.glob(f"{number}_*_solution.ipynb")
    codes = list(cells(path))
    assert sum(code.count(right) for code in codes) == 1
    code, error = run([code.replace(right, wrong) for code in codes], monkeypatch)
    assert isinstance(error, AssertionError)
    assert "checks." in code


def test_each_exercise_has_a_wrong_solution():
    assert {number for number, _, _ in WRONG} == {path.name[:2] for path in GIVEN}
