"""The page of a batch, as a file; tests/contracts/page opens it in a browser."""

from __future__ import annotations

import json
import re

import pytest

from gridslam.batch.report import write_report
from support.journals import make_rows, write_journal, write_results


def data(page):
    """The rows that a page holds, as a browser reads them."""
    (text,) = re.findall(
        r'<script type="application/json" id="data">(.*?)</script>', page.read_text("utf-8"), re.DOTALL
    )
    return json.loads(text)


@pytest.fixture
def out(tmp_path):
    rows = make_rows(20, failed=4)
    write_journal(tmp_path, rows)
    write_results(tmp_path, rows)
    return tmp_path


def test_every_run_is_on_the_page_and_failures_have_their_message(out):
    found = data(write_report(out))["runs"]
    assert len(found) == 20
    failed = [run for run in found if run["failed"]]
    assert [run["error"] for run in failed] == ["InputError", "timeout", "out of memory", "SIGSEGV"]
    assert failed[0]["message"].startswith("log.clf, line 12")
    assert "</script>" in failed[0]["tail"]  # as text: it does not end the element
    assert all(run["picture"] == "map.png" for run in found if not run["failed"])


def test_the_page_asks_nothing_of_a_network(out):
    page = write_report(out).read_text(encoding="utf-8").partition('id="data">')[0]
    assert "default-src 'none'" in page
    assert not re.findall(r"""(?:src|href)=["'](?!data:)""", page)


def test_thumbnails_lie_beside_the_maps_and_are_made_once(out):
    write_report(out)
    thumbnails = sorted(out.glob("*/thumbnail.jpg"))
    assert len(thumbnails) == 16
    made = [path.stat().st_mtime_ns for path in thumbnails]
    size = write_report(out).stat().st_size
    assert [path.stat().st_mtime_ns for path in thumbnails] == made
    assert size < 60_000


def test_a_damaged_picture_hides_no_run(out):
    folders = sorted(path.parent for path in out.glob("*/map.png"))
    (folders[0] / "map.pgm").write_bytes(b"P5 9 9 255\n1")
    found = {run["folder"]: run for run in data(write_report(out))["runs"]}
    assert len(found) == 20
    assert found[folders[0].name]["picture"] is None
