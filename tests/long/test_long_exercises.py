"""The exercises: each solution passes, each notebook as given fails at its first check, and so do wrong solutions."""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import pytest

FOLDER = Path(__file__).parents[2] / "exercises"
GIVEN = sorted(path for path in FOLDER.glob("*.ipynb") if not path.stem.endswith("_solution"))
WRONG = json.loads((FOLDER / "wrong_solutions.json").read_text(encoding="utf-8"))
"""Wrong solutions: the exercise, a part of its solution, what stands there instead, and words of the feedback."""

pytestmark = pytest.mark.filterwarnings("ignore:FigureCanvasAgg is non-interactive")


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


@pytest.mark.parametrize("wrong", WRONG, ids=[f"{wrong['exercise']}-{k}" for k, wrong in enumerate(WRONG)])
def test_a_wrong_solution_fails_at_a_check_that_names_the_mistake(wrong, monkeypatch):
    (path,) = FOLDER.glob(f"{wrong['exercise']}_*_solution.ipynb")
    codes = list(cells(path))
    assert sum(code.count(wrong["right"]) for code in codes) == 1
    code, error = run([code.replace(wrong["right"], wrong["wrong"]) for code in codes], monkeypatch)
    assert isinstance(error, AssertionError)
    assert "checks." in code
    assert wrong["named"] in str(error)


def test_each_exercise_has_at_least_eight_wrong_solutions():
    counts = Counter(wrong["exercise"] for wrong in WRONG)
    assert counts.keys() == {path.name[:2] for path in GIVEN}
    assert min(counts.values()) >= 8
