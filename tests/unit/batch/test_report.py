"""The page of a batch, as a file; tests/contracts/page opens it in a browser."""

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


def test_the_page_is_small_and_all_that_is_written(out):
    before = set(out.rglob("*"))
    page = write_report(out)
    assert set(out.rglob("*")) - before == {page}
    assert page.stat().st_size < 60_000
