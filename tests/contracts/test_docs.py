"""The pages under docs: they build without a warning, what they show runs, and what they name exists."""

from __future__ import annotations

import ast
import doctest
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import animations
import graphical_models
import pytest
from PIL import Image

from gridslam.config import PARAMETERS, Configuration
from gridslam.config.tables import value_of
from gridslam.io.landmarks import LANDMARKS_HEADER

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = sorted(DOCS.glob("*.md"))
CSS = DOCS / "_static" / "gridslam.css"
ALGORITHMS = (
    "grid_fastslam",
    "loop_closure",
    "graph_slam",
    "mapping",
    "localization",
    "ekf_localization",
    "ekf_slam",
    "fastslam",
    "landmark_graph",
    "models",
    "resampling",
    "scan_matching",
)

BLOCK = re.compile(
    r"^<!-- setup\n(?P<setup>.*?)^-->$"  # Python that makes what the examples below it need, not shown
    r"|^(?:<!-- (?P<mark>[^\n]*) -->\n)?```(?P<language>python|console)\n(?P<shown>.*?)^```$",
    re.DOTALL | re.MULTILINE,
)
SAME = doctest.OutputChecker()


@dataclass(frozen=True)
class Example:
    """A block of code: its language, its text, and the line of the page where it begins."""

    language: str
    text: str
    line: int


def examples(page: Path) -> Iterator[Example]:
    """All that runs on a page; what does not says why: <!-- not run: reason -->."""
    text = page.read_text(encoding="utf-8")
    for found in BLOCK.finditer(text):
        line = text.count("\n", 0, found.start("setup" if found["setup"] else "shown"))
        if found["setup"] is not None:
            yield Example("python", found["setup"], line)
        elif not (found["mark"] or "").startswith("not run: "):
            yield Example(found["language"], found["shown"], line)


RUN = [page for page in PAGES if any(examples(page))]


def run_console(shown: str, folder: Path) -> None:
    """Run lines that begin with $; what stands below them is their output, where ... is anything."""
    for part in re.split(r"^\$ ", shown, flags=re.MULTILINE)[1:]:
        command, _, expected = part.partition("\n")
        done = subprocess.run(
            ["bash", "-c", command], cwd=folder, capture_output=True, text=True, timeout=120, env=environment(folder)
        )
        assert done.returncode == 0, f"{command}\n{done.stderr}"
        told = done.stdout
        assert not expected.strip() or SAME.check_output(expected, told, doctest.ELLIPSIS), f"{command}\n{told}"


def environment(folder: Path) -> dict[str, str]:
    """The command line of the package that is under test, on the path, in a terminal of no colour and one width."""
    program = folder / ".bin" / "gridslam"
    if not program.exists():
        program.parent.mkdir()
        program.write_text(f"#!{sys.executable}\nfrom gridslam.cli.main import main\nmain()\n")
        program.chmod(0o755)
    here = {"PATH": f"{program.parent}:{os.environ['PATH']}", "COLUMNS": "120", "NO_COLOR": "1"}
    paths = [str(ROOT / "src")] if "PYTHONPATH" in os.environ else []
    return os.environ | here | ({"PYTHONPATH": os.pathsep.join(paths)} if paths else {})


@pytest.mark.parametrize("page", RUN, ids=lambda page: page.name)
def test_examples_run(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {"__name__": "__main__"}
    for example in examples(page):
        if example.language == "console":
            run_console(example.text, tmp_path)
        else:
            code = ast.increment_lineno(ast.parse(example.text), example.line)
            exec(compile(code, str(page), "exec"), names)


def test_a_wrong_example_is_seen(tmp_path):
    with pytest.raises(AssertionError):
        run_console("$ echo one\ntwo\n", tmp_path)
    with pytest.raises(AssertionError):
        run_console("$ false\n", tmp_path)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_block_that_makes_an_example_ready_runs(page):
    """What begins with <!-- setup ends with a line of its own, so that it is found."""
    text = page.read_text(encoding="utf-8")
    assert text.count("<!-- setup") == sum(found["setup"] is not None for found in BLOCK.finditer(text))


def test_the_pages_build_without_a_warning(tmp_path):
    for needed in ("sphinx", "furo", "myst_parser", "numpydoc"):
        pytest.importorskip(needed, reason="the extra docs is not installed")
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-n", "-E", "-q", "-d", tmp_path / "trees"]
    done = subprocess.run([*command, DOCS, tmp_path / "html"], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    pages = [page.relative_to(tmp_path / "html").with_suffix("").name for page in (tmp_path / "html").glob("*.html")]
    assert {page.stem for page in PAGES} <= set(pages)
    api = (tmp_path / "html" / "api.html").read_text(encoding="utf-8")
    assert len(re.findall("<p>Source: |References</p>", api)) > 20
    assert "<strong>Source</strong>" not in api  # as if it were a parameter


def test_files_and_tests_that_are_named_exist():
    """Of the pages and of the README."""
    texts = [page.read_text("utf-8") for page in (*PAGES, ROOT / "README.md")]
    files = {found for text in texts for found in re.findall(r"\b((?:tests|benchmarks|examples)/[\w/.]*\w)", text)}
    assert [name for name in files if not (ROOT / name).exists()] == []
    named = [found for text in texts for found in re.findall(r"(tests/[\w/]+\.py)::(\w+)", text)]
    assert named
    missing = [f"{path}::{name}" for path, name in named if f"def {name}(" not in (ROOT / path).read_text("utf-8")]
    assert missing == []


@pytest.mark.parametrize("name", ALGORITHMS)
def test_a_page_of_an_algorithm_has_all_that_it_promises(name):
    """The model, the equations, the trunk, a picture, when to use it and when not, what the tests prove, the source."""
    needed = (
        r"^## The problem$",
        r"figures/\w+\.svg",
        r"^\$\$",
        r"^```\{literalinclude\} \.\./src/",
        r"images/\w+\.png",
        r"^## When to use it$",
        r"\bWhen not\b",
        r"^## What the tests prove$",
        r"`tests/[\w/]+\.py::\w+`",
        r"^Source: ",
    )
    text = (DOCS / f"{name}.md").read_text(encoding="utf-8")
    assert [what for what in needed if not re.search(what, text, re.MULTILINE)] == []


def test_every_schema_is_told():
    """Of what is written or printed: by its name and number, and the columns of landmarks.csv."""
    sources = [path.read_text(encoding="utf-8") for path in (ROOT / "src").rglob("*.py")]
    schemas = {found for text in sources for found in re.findall(r'"(gridslam\.\w+/\d+)"', text)}
    pages = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    assert [schema for schema in sorted(schemas) if schema not in pages] == []
    assert len(schemas) > 8
    assert f"    {LANDMARKS_HEADER}\n" in pages


def test_tuning_names_every_parameter_with_its_default():
    text = (DOCS / "tuning.md").read_text(encoding="utf-8")
    rows = dict(re.findall(r"^\| `(\w+)` \| (\S+) \|", text, re.MULTILINE))
    defaults = {name: value_of(Configuration(), known.path) for name, known in PARAMETERS.items()}
    assert {name: str(value).lower() for name, value in defaults.items()} == rows


def test_graphical_models_are_those_that_the_script_draws():
    files = {path.stem: path.read_text(encoding="utf-8") for path in (DOCS / "figures").glob("*.svg")}
    assert files == {name: picture.svg() for name, picture in graphical_models.PICTURES.items()}


def test_pictures_are_small():
    assert [path.name for path in (DOCS / "images").iterdir() if path.stat().st_size > 150_000] == []


ANIMATIONS = [make.__name__ for make in animations.ANIMATIONS]


@pytest.mark.parametrize("name", ANIMATIONS)
def test_animations_are_short_and_small_and_have_a_still(name):
    """They repeat, and stand still for readers who ask for reduced motion."""
    path = DOCS / "animations" / f"{name}.webp"
    assert path.stat().st_size < 1_500_000
    with Image.open(path) as film:
        durations = []
        for k in range(film.n_frames):
            film.seek(k)
            film.load()
            durations.append(film.info["duration"])
        assert film.info["loop"] == 0
        with Image.open(DOCS / "_static" / "stills" / f"{name}.png") as still:
            assert still.size == film.size
    assert len(durations) > 40
    assert 5_000 < sum(durations) < 20_000
    assert f'img[src$="{name}.webp"] {{ content: url("stills/{name}.png"); }}' in CSS.read_text(encoding="utf-8")
    shown = [
        found
        for page in PAGES
        for found in re.findall(rf"!\[(.*)\]\(animations/{name}\.webp\)\n\n\*", page.read_text())
    ]
    assert len(shown) == 1
    assert len(shown[0]) > 40  # the text for those who do not see it


def test_each_animation_has_its_maker():
    assert sorted(path.stem for path in (DOCS / "animations").iterdir()) == sorted(ANIMATIONS)
    assert sorted(path.stem for path in (DOCS / "_static" / "stills").iterdir()) == sorted(ANIMATIONS)
