"""Rows of a batch: what is read of a journal, and written as a table."""

import json
import math
import sqlite3

import numpy as np
import pytest

from gridslam.batch.journal import COLUMNS, JOURNAL, Journal
from gridslam.batch.runs import read_runs
from gridslam.errors import InputError
from support.journals import make_document, make_rows, write_journal


def test_figures_of_a_run_are_those_of_its_document(tmp_path):
    document = make_document(np.random.default_rng(0), seed=3, error_m=0.02)
    document["input"]["faults"] = {"mirrored": "The laser is mirrored."}
    write_journal(tmp_path, [make_rows(1)[0] | {"document": json.dumps(document)}])
    (run,) = read_runs(tmp_path)
    assert run.is_done
    assert (run.figures["seed"], run.figures["error_m"], run.figures["worst_m"]) == (3, 0.02, 0.16)
    assert run.figures["error_rad"] == pytest.approx(math.radians(0.2))
    assert run.figures["scans"] == document["scans"]["read"]
    assert run.findings == (("warning", "mirrored", "The laser is mirrored."),)


def test_a_folder_without_a_journal_and_a_damaged_one_are_named(tmp_path):
    with pytest.raises(InputError, match=r"runs\.sqlite: no such file"):
        list(read_runs(tmp_path))
    (tmp_path / JOURNAL).write_bytes(b"no database at all, however long it may be" * 100)
    with pytest.raises(InputError, match="expected a journal of gridslam batch, got: file is not a database"):
        list(read_runs(tmp_path))
    (tmp_path / JOURNAL).unlink()
    with sqlite3.connect(tmp_path / JOURNAL) as journal:
        journal.execute("CREATE TABLE runs (key TEXT)")
    with pytest.raises(InputError, match="no such column: log"):
        list(read_runs(tmp_path))


def test_rows_of_a_transaction_are_written_together_or_not_at_all(tmp_path):
    rows = [dict.fromkeys(COLUMNS) | row | {"document": None} for row in make_rows(4)]
    with Journal(tmp_path) as journal:
        with journal.transaction():
            journal.write(rows[0])
            journal.write(rows[1])
        with pytest.raises(InputError):
            write_and_fail(journal, rows[2])
        journal.write(rows[3])
    assert [run.row["folder"] for run in read_runs(tmp_path)] == ["run-00000", "run-00001", "run-00003"]


def write_and_fail(journal, row):
    with journal.transaction():
        journal.write(row)
        raise InputError("a.clf", "what comes between")
