"""The pages under docs: they build without a warning, what they show runs, and what they name exists."""

from __future__ import annotations

import ast
import doctest
import re
import shlex
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import graphical_models
import pytest

from gridslam.cli.main import main
from gridslam.config import PARAMETERS, Configuration
from gridslam.config.tables import value_of
from gridslam.io.landmarks import LANDMARKS_HEADER

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = sorted(DOCS.glob("*.md"))
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


MADE: dict[str, Path] = {}
"""Commands that have run, and the folder `demo` beside which they did."""

RUN = [page for page in PAGES if any(examples(page))]


def run_console(shown: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Run lines that begin with $; what stands below them is their output, where ... is anything."""
    for part in re.split(r"^\$ ", shown, flags=re.MULTILINE)[1:]:
        command, _, expected = part.partition("\n")
        program, *arguments = shlex.split(command)
        capsys.readouterr()
        if command == "gridslam demo -o demo" and (earlier := MADE.get(command)):
            shutil.copytree(earlier, "demo")  # two pages map the same building
            continue
        status = main(arguments)
        MADE[command] = Path("demo").absolute()
        told, problem = capsys.readouterr()
        assert (program, status) == ("gridslam", 0), f"{command}\n{problem}"
        assert not expected.strip() or SAME.check_output(expected, told, doctest.ELLIPSIS), f"{command}\n{told}"


@pytest.mark.parametrize("page", RUN, ids=lambda page: page.name)
def test_examples_run(page, tmp_path, monkeypatch, capsys):
    """In a folder of its own, as in a terminal of no colour and one width."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "120")
    monkeypatch.setenv("NO_COLOR", "1")
    names: dict[str, object] = {"__name__": "__main__"}
    for example in examples(page):
        if example.language == "console":
            run_console(example.text, capsys)
        else:
            code = ast.increment_lineno(ast.parse(example.text), example.line)
            exec(compile(code, str(page), "exec"), names)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_block_that_makes_an_example_ready_runs(page):
    """What begins with <!-- setup ends with a line of its own, so that it is found."""
    text = page.read_text(encoding="utf-8")
    assert text.count("<!-- setup") == sum(found["setup"] is not None for found in BLOCK.finditer(text))


def test_the_pages_build_without_a_warning(site):
    assert site.errors == ""
    assert {page.stem for page in PAGES} <= {page.stem for page in site.html.glob("*.html")}
    api = (site.html / "api.html").read_text(encoding="utf-8")
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
