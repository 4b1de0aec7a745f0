"""The version stands in the package; whoever else tells it tells the same."""

import re
from importlib.metadata import version

import gridslam
from support.house import ROOT


def test_the_installed_version_is_the_packages():
    assert version("gridslam") == gridslam.__version__


def test_the_newest_entry_of_the_changes_is_this_version():
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert re.search(r"^## \[([^\]]+)\]", changes, re.MULTILINE)[1] == gridslam.__version__


def test_the_packages_of_ros_have_this_version():
    for name in ("gmapping", "gridslam_ros"):
        manifest = (ROOT / "ros" / name / "package.xml").read_text(encoding="utf-8")
        assert re.search("<version>(.*)</version>", manifest)[1] == gridslam.__version__
    setup = (ROOT / "ros" / "gridslam_ros" / "setup.py").read_text(encoding="utf-8")
    assert f'version="{gridslam.__version__}"' in setup


def test_the_recipe_of_conda_has_this_version():
    recipe = (ROOT / "recipe" / "recipe.yaml").read_text(encoding="utf-8")
    assert re.search(r"^  version: ([\d.]+)$", recipe, re.MULTILINE)[1] == gridslam.__version__
