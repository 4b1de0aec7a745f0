"""The commands doctor, convert and dataset."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import asdict
from pathlib import Path

from gridslam.api.conversion import convert_log
from gridslam.api.diagnosis import write_diagnosis
from gridslam.cli.options import name_option
from gridslam.cli.output import open_output, open_progress, print_result, warn
from gridslam.doctor import Severity, diagnose
from gridslam.doctor.report import document, text
from gridslam.io.datasets import DATASETS, fetch_dataset, find_dataset
from gridslam.io.log import LogOptions, open_log

CONVERSION_SCHEMA = "gridslam.conversion/2"
DATASETS_SCHEMA = "gridslam.datasets/1"

EXIT_FOUND_ERRORS = 3
"""Exit status if a fault makes the map unusable."""


def doctor_log(log: Path, out: Path | None, options: LogOptions, as_json: bool) -> int:
    """Diagnose a log, print the findings, and write the report if a folder is given."""
    source = open_log(log, options)
    with (
        nullcontext() if out is None else open_output(out) as folder,
        open_progress(source, shown=not as_json) as on_progress,
    ):
        diagnosis = diagnose(source, on_progress=on_progress)
        if folder is not None:
            write_diagnosis(diagnosis, folder)
    report = [] if out is None else [f"report: {out / 'report.txt'}"]
    print_result(document(diagnosis), [*text(diagnosis), *report], as_json)
    return EXIT_FOUND_ERRORS if diagnosis.worst is Severity.ERROR else 0


def convert(log: Path, out: Path, options: LogOptions, as_json: bool) -> None:
    """Convert a log."""
    source = open_log(log, options)
    with name_option(out=str(out)), open_progress(source, shown=not as_json) as on_progress:
        conversion = convert_log(source, out, on_progress=on_progress)
    read = conversion.log
    warn(*(f"{log}: {remark}" for remark in read.remarks))
    if read.truncated:
        warn(f"{log}: the log is truncated after {read.scan_count} scans")
    content = {
        "schema": CONVERSION_SCHEMA,
        "log": str(log),
        "out": str(out),
        "format": conversion.format,
        "scans": read.scan_count,
        "written": conversion.scans,
        "duration_s": read.duration_s,
        "truncated": read.truncated,
    }
    summary = [
        f"{log}: {read.scan_count} scans, {read.duration_s:.0f} s",
        f"{out}: {conversion.scans} scans in the format {conversion.format}",
    ]
    print_result(content, summary, as_json)


def list_datasets(as_json: bool) -> None:
    """List the available datasets."""
    lines = (
        f"{dataset.name:10} {dataset.size / 1e6:.1f} MB  {dataset.about}\n"
        f"{'':10} {dataset.credit}\n{'':10} {dataset.licence}"
        for dataset in DATASETS
    )
    print_result({"schema": DATASETS_SCHEMA, "datasets": [asdict(dataset) for dataset in DATASETS]}, lines, as_json)


def get_dataset(name: str, out: Path, url: str | None, as_json: bool) -> None:
    """Download a dataset, and print its credit."""
    with name_option(name="NAME"):
        dataset = find_dataset(name)
    file = fetch_dataset(name, out, url=url)
    summary = [f"{file}: {dataset.about}", f"credit: {dataset.credit}", f"licence: {dataset.licence}"]
    print_result({"schema": DATASETS_SCHEMA, "datasets": [asdict(dataset)], "path": str(file)}, summary, as_json)
