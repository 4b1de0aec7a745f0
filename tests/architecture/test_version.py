"""The version stands in the package; whoever else tells it tells the same."""

from __future__ import annotations

import re
from importlib.metadata import version

import gridslam
from support.house import ROOT


def test_the_installed_version_is_the_packages():
    assert version("gridslam") == gridslam.__version__


def test_the_newest_entry_of_the_changes_is_this_version():
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert re.search(r"^## \[([^\]]+)\]", changes, re.MULTILINE)[1] == gridslam.__version__


def test_the_package_of_ros1_has_this_version():
    manifest = (ROOT / "examples" / "ros1" / "gridslam_ros" / "package.xml").read_text(encoding="utf-8")
    assert re.search("<version>(.*)</version>", manifest)[1] == gridslam.__version__


def test_the_recipe_of_conda_has_this_version():
    recipe = (ROOT / "recipe" / "recipe.yaml").read_text(encoding="utf-8")
    assert re.search(r"^  version: ([\d.]+)$", recipe, re.MULTILINE)[1] == gridslam.__version__
