"""Suites: the public one, files of one's own, and what is absent."""

from __future__ import annotations

from pathlib import Path

import pytest

from gridslam.batch.suite import PUBLIC_SUITE, load_suite
from gridslam.errors import InputError
from gridslam.io.datasets import DATASETS
from measure import RESULTS

SUITE = """
seeds = 2
[[logs]]
name = "one"
file = "one.clf"
reference = "one.relations"
[[logs]]
name = "two"
file = "two.clf"
[[variants]]
name = "default"
[[variants]]
name = "fast"
options = { preset = "fast" }
"""


@pytest.fixture
def suite(tmp_path):
    (tmp_path / "suite.toml").write_text(SUITE)
    return load_suite(str(tmp_path / "suite.toml"))


def test_the_public_suite_has_all_logs_that_can_be_downloaded_and_all_presets():
    suite = load_suite(PUBLIC_SUITE)
    assert {log.file for log in suite.logs} == {dataset.file for dataset in DATASETS}
    assert {log.name for log in suite.logs} == {dataset.name for dataset in DATASETS}
    assert {"default", "fast", "accurate", "gmapping"} <= {variant.name for variant in suite.variants}
    assert suite.seeds == 10
    assert load_suite(str(RESULTS.parent / "suite.toml")) == suite


def test_each_log_is_run_by_each_variant_and_seed(suite, tmp_path):
    for name in ("one.clf", "two.clf", "one.relations"):
        (tmp_path / name).write_text("")
    entries, absent = suite.find([Path("/no/such"), tmp_path])
    assert absent == []
    assert [entry.name for entry in entries[:4]] == [
        "one-default-seed0",
        "one-fast-seed0",
        "two-default-seed0",
        "two-fast-seed0",
    ]
    assert len({entry.name for entry in entries}) == len(entries) == 8
    assert entries[1].options == {"preset": "fast", "seed": "0"}
    assert (entries[0].reference, entries[2].reference) == (str(tmp_path / "one.relations"), None)


def test_what_is_absent_is_named_and_the_rest_is_run(suite, tmp_path):
    (tmp_path / "one.clf").write_text("")
    entries, absent = suite.find([tmp_path])
    assert len(entries) == 4
    assert [sentence.partition(":")[0] for sentence in absent] == ["one", "two"]
    assert "no one.relations" in absent[0]
    with pytest.raises(InputError, match=r"none of the suite's logs: one: no one\.clf in .*; two: no two\.clf in"):
        suite.find([tmp_path / "suite.toml"])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("seeds = ", r"expected TOML"),
        ("seeds = 3", r"logs: Field required"),
        (SUITE.replace("seeds = 2", "seeds = 0"), r"seeds: Input should be greater than or equal to 1"),
        (SUITE.replace('"two"', '"one"'), r"suite: the name 'one' is given twice"),
        (SUITE.replace('"two"', '"../two"'), r"logs\.1\.name: String should match pattern"),
        (SUITE + "colour = 3", r"variants\.1\.colour: Extra inputs are not permitted"),
    ],
)
def test_a_file_that_is_no_suite_is_named_with_its_key(tmp_path, text, message):
    path = tmp_path / "suite.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=rf"suite\.toml: {message}"):
        load_suite(str(path))
