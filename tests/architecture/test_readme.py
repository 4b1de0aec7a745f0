"""What the README shows is what there is."""

from __future__ import annotations

import inspect
import re
import textwrap

import numpy as np

import gridslam
from gridslam.io.carmen.writer import write_carmen
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, make_world, simulate
from readme import BLOCK, SCOREBOARD, block, quoted, scoreboard, strangers
from support.house import ROOT

README = (ROOT / "README.md").read_text(encoding="utf-8")


def shown(name: str) -> str:
    """The block of code below the comment <!-- name -->."""
    return re.search(rf"^<!-- {name} -->\n```\w*\n(.*?)\n```$", README, re.DOTALL | re.MULTILINE)[1]


def test_the_trunk_is_the_code():
    code = textwrap.dedent(inspect.getsource(gridslam.GridFastSlam.step)).rstrip()
    assert shown("trunk") == code, "copy GridFastSlam.step into README.md"


def test_the_figures_are_those_of_the_committed_results():
    page = SCOREBOARD.read_text(encoding="utf-8")
    for text, made in ((README, block()), (page, scoreboard())):
        assert BLOCK.search(text)[0] == made, "python benchmarks/readme.py writes them"


def test_sentences_state_no_figure_that_is_not_among_the_committed_results():
    section = re.search(r"^## Figures\n(.*?)^## ", README, re.DOTALL | re.MULTILINE)[1]
    assert strangers(section) == []
    page = re.search(r"^## Further figures\n(.*?)^## Run", SCOREBOARD.read_text("utf-8"), re.DOTALL | re.MULTILINE)[1]
    assert strangers(page) == []
    words = " ".join(page.split())
    assert [text for text in quoted() if text not in words] == []


def test_the_readme_is_short_and_shows_a_growing_map_at_the_top():
    assert len(README.splitlines()) <= 150
    animation = re.search(r"!\[.{20,}\]\((docs/animations/\w+\.webp)\)", "\n".join(README.splitlines()[:10]))[1]
    assert (ROOT / animation).stat().st_size < 1_000_000


def test_a_figure_without_a_result_is_seen():
    assert strangers("It takes 2.5 to 3.5 ms and 738 MB, not 17 ms.") == ["17 ms"]


def test_the_five_lines_run(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(1)
    log = simulate(make_world("rooms", rng), RobotConfig(), OdometryNoise(), LidarConfig(beams=60), rng)
    write_carmen("intel.clf.bz2", log.measurements[:20])
    exec(shown("python"), {})
    assert (tmp_path / "out" / "map.png").is_file()
    assert re.fullmatch(r"\[ *\S+ +\S+ +\S+\]\n", capsys.readouterr().out)


def test_links_lead_somewhere():
    pages = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").glob("*.md")]
    for page in pages:
        for link in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", page.read_text(encoding="utf-8")):
            assert (page.parent / link).exists(), f"{page.name}: {link}"
