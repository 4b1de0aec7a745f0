"""How the package is shipped: workflows only call scripts, and recipes ask for what the package asks for."""

import os
import re
import shutil
import subprocess
import sys

import pytest
from ruamel.yaml import YAML

from support.house import ROOT

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
RECIPE = ROOT / "recipe" / "recipe.yaml"
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
CONDA_NAMES = {"qdldl": "qdldl-python"}
"""Names on conda-forge that are not PyPI's."""


def load(file):
    return YAML(typ="safe").load(file.read_text(encoding="utf-8"))


def commands(workflow):
    """The lines of shell of a workflow's steps."""
    steps = [step for job in load(workflow)["jobs"].values() for step in job.get("steps", ())]
    return [line for step in steps for line in step.get("run", "").splitlines()]


@pytest.mark.parametrize("workflow", WORKFLOWS, ids=lambda file: file.name)
def test_a_workflow_calls_scripts_that_exist(workflow):
    names = {name for line in commands(workflow) for name in re.findall(r"(?<!\S)\.ci/\w+", line)}
    matrices = (job.get("strategy", {}).get("matrix", {}) for job in load(workflow)["jobs"].values())
    names |= {f".ci/{script.split()[0]}" for matrix in matrices for script in matrix.get("script", ())}
    assert names or load(workflow)["jobs"]
    for name in names:
        assert os.access(ROOT / name, os.X_OK), f"{workflow.name} calls {name}"
    for line in commands(workflow):  # what is more than a call cannot be tried elsewhere
        assert ".ci/" in line or line.startswith(("apt-get", "gh release")), line


@pytest.mark.skipif(os.name == "nt", reason="a script of bash")
@pytest.mark.parametrize(
    ("tag", "day", "found"),
    [("v1.2.3", "2027-01-31", ""), ("v1.2.4", "2027-01-31", "the version 1.2.3"), ("v1.2.3", "unreleased", "no day")],
)
def test_only_a_finished_version_is_published(tag, day, found, tmp_path):
    script = tmp_path / ".ci" / "release"
    script.parent.mkdir()
    shutil.copy(ROOT / ".ci" / "release", script)
    (tmp_path / "src" / "gridslam").mkdir(parents=True)
    (tmp_path / "src" / "gridslam" / "__init__.py").write_text('__version__ = "1.2.3"\n', encoding="utf-8")
    (tmp_path / "CHANGELOG.md").write_text(f"## [1.2.3] - {day}\n", encoding="utf-8")
    done = subprocess.run(["bash", script, tag], capture_output=True, text=True, timeout=30)
    assert (done.returncode != 0) == bool(found)
    assert found in done.stderr


def conda_requirements():
    """The requirement of each package of the recipe, as PyPI writes it."""
    found = {}
    for entry in load(RECIPE)["requirements"]["run"]:
        text, python = (entry["then"], entry["if"]) if isinstance(entry, dict) else (entry, "")
        name, _, versions = text.partition(" ")
        found[name] = versions, "".join(re.findall(r"<[\d.]+", python))
    return found


def test_conda_asks_for_what_pypi_asks_for():
    wanted = {"python": (PYPROJECT["project"]["requires-python"], "")}
    for requirement in PYPROJECT["project"]["dependencies"]:
        text, _, marker = requirement.partition(";")
        name = re.match(r"[\w.-]+", text)[0]
        python = re.search(r"python_version < '([\d.]+)'", marker)
        wanted[CONDA_NAMES.get(name, name)] = text[len(name) :].strip(), f"<{python[1]}" if python else ""
    assert conda_requirements() == wanted


def test_no_page_installs_from_pypi_what_is_not_there():
    """An extra by name is right: pip finds the gridslam that is installed."""
    for page in (*(ROOT / "docs").glob("*.md"), *ROOT.glob("*.md"), *(ROOT / "exercises").glob("*.md")):
        text = page.read_text(encoding="utf-8")
        assert re.findall(r"pip install\s+(?:-\S+\s+)*'?gridslam(?![\w-]|\[)[^`\n]*", text) == [], page.name


def test_the_recipe_builds_with_what_pypi_builds_with():
    host = load(RECIPE)["requirements"]["host"]
    assert set(PYPROJECT["build-system"]["requires"]) <= {entry.replace(" ", "") for entry in host}


def test_the_image_is_no_administrators():
    """Each stage that is run ends as a user without rights, and takes nothing of the tree but what is built."""
    stages = re.split(r"^FROM ", (ROOT / "Dockerfile").read_text(encoding="utf-8"), flags=re.MULTILINE)[1:]
    run = [stage for stage in stages if "ENTRYPOINT" in stage]
    assert len(run) == 2
    for stage in run:
        assert re.findall(r"^USER (\w+)$", stage, re.MULTILINE) == ["gridslam"]
    copied = {name for stage in stages for name in re.findall(r"^COPY (?!--from)(.*) \S+$", stage, re.MULTILINE)}
    for name in " ".join(copied).split():
        assert (ROOT / name).exists()
        assert f"!{name}\n" in (ROOT / ".dockerignore").read_text(encoding="utf-8")
