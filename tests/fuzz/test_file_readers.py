"""A damaged or hostile file of any format is read or refused by name, in bounded time and memory: a sample.

Thousands of cases are in the long tier (`test_thousands_of_files.py`).
"""

from __future__ import annotations

import os

import pytest

from support.fuzz_files import Family, failures, families, run_cases

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="cases are read in processes that are forked")

PAGE = ("page: sockets",)  # it waits for answers


@pytest.fixture(scope="module")
def chosen(tmp_path_factory) -> list[Family]:
    return families(tmp_path_factory.mktemp("fuzz") / "healthy")


def test_a_sample_of_what_visitors_send_is_answered(chosen, tmp_path):
    assert not failures(run_cases([family for family in chosen if family.name in PAGE], 2, 0, tmp_path))


def test_a_sample_of_damaged_files_is_read_or_refused(chosen, tmp_path):
    found = run_cases([family for family in chosen if family.name not in PAGE], 60, 0, tmp_path)
    assert not failures(found)
    verdicts = [verdict for of_family in found.values() for verdict in of_family]
    assert min(verdicts.count("read"), verdicts.count("refused")) > 12  # damage is neither always fatal nor never


@pytest.mark.parametrize(
    ("fault", "kind"),
    [
        ("raise KeyError('field')", "KeyError"),
        ("os.kill(os.getpid(), 11)", "SIGSEGV"),
        ("bytearray(8 << 30)", "memory"),
        ("b'a' * (700 << 20)", "memory"),
        ("raise InputError('elsewhere', 'no file')", "unnamed"),
    ],
)
def test_a_reader_that_fails_is_seen(tmp_path, monkeypatch, fault, kind):
    monkeypatch.setattr("support.children.MEMORY_LIMIT_BYTES", 600 << 20)

    def read(where):
        exec(f"import os\nfrom gridslam.errors import InputError\n{fault}")

    family = Family("faulty", lambda to, rng: None, read)
    ((verdict,),) = run_cases([family], 1, 0, tmp_path).values()
    assert verdict.partition(":")[0] == kind


def test_a_reader_that_never_ends_is_seen(tmp_path, monkeypatch):
    monkeypatch.setattr("support.children.CPU_LIMIT_S", 1)

    def read(where):
        while True:
            pass

    family = Family("endless", lambda to, rng: None, read)
    ((verdict,),) = run_cases([family], 1, 0, tmp_path).values()
    assert verdict.startswith("hang")
