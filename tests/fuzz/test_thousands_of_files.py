"""Four thousand damaged and hostile files of every format, other ones than the quick tests see."""

from support.fuzz_files import families, run_cases, summarize


def test_four_thousand_files_are_read_or_refused(tmp_path, record_property):
    chosen = families(tmp_path / "healthy")
    rows = summarize(run_cases(chosen, 4000, 1, tmp_path), chosen)
    for row in rows:
        record_property(row["family"], f"{row['read']} read, {row['refused']} refused, {row['failures']} failures")
    assert not [example for row in rows for example in row["examples"]]
