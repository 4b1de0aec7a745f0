"""Four thousand damaged and hostile files of every format, other ones than the quick tests see."""

from support.fuzz_files import failures, families, run_cases


def test_four_thousand_files_are_read_or_refused(tmp_path):
    assert not failures(run_cases(families(tmp_path / "healthy"), 4000, 1, tmp_path))
