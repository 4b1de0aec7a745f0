"""gridslam doctor."""

from __future__ import annotations

from pathlib import Path

import click

from gridslam.cli.interrupt import stop_if_interrupted
from gridslam.cli.output import open_output, print_json
from gridslam.cli.progress import reading_progress
from gridslam.doctor import CheckedLog, Diagnosis, Finding, Severity, diagnose
from gridslam.doctor.report import document, markdown, picture_name, text
from gridslam.io.log import Log, LogOptions, open_log
from gridslam.io.output import OutputFolder

__all__ = ["EXIT_FOUND_ERRORS", "check_log", "doctor_log"]

EXIT_FOUND_ERRORS = 3
"""Exit status if a fault makes the map unusable."""


def doctor_log(log: Path, out: Path | None, options: LogOptions, as_json: bool) -> int:
    """Diagnose a log, print the findings, and write the report and its figures if a folder is given."""
    source = open_log(log, options)
    if out is None:
        diagnosis = _diagnose_with_progress(source, not as_json)
    else:
        with open_output(out) as folder:
            diagnosis = _diagnose_with_progress(source, not as_json)
            _write(diagnosis, folder)
    if as_json:
        print_json(document(diagnosis))
    else:
        click.echo("\n".join([*text(diagnosis), *([f"report: {out / 'report.md'}"] if out else [])]))
    return EXIT_FOUND_ERRORS if diagnosis.worst is Severity.ERROR else 0


def check_log(log: Log, options: LogOptions) -> CheckedLog:
    """Wrap a log so that faults in its first minute are reported on stderr, one line each, while it is read.

    That there is no odometry is no news to who asked for it.
    """
    reported = {"no_odometry"} if options.no_odometry else set()

    def print_findings(found: tuple[Finding, ...]) -> None:
        for finding in found:
            if finding.code not in reported:
                reported.add(finding.code)  # the log may be read twice
                click.echo(
                    f"gridslam: {log.path}: {finding.code}: {finding.message} {finding.remedy}".rstrip(), err=True
                )

    return CheckedLog(log, print_findings)


def _diagnose_with_progress(source: Log, shown: bool) -> Diagnosis:
    """Diagnose while progress is shown."""
    with reading_progress(lambda: source.statistics, shown=shown) as show:

        def on_progress() -> None:
            stop_if_interrupted()
            show()

        return diagnose(source, on_progress=on_progress)


def _write(diagnosis: Diagnosis, folder: OutputFolder) -> None:
    from gridslam.viz.chart import draw_chart

    folder.write_json("report.json", document(diagnosis))
    folder.file("report.md").write_text("\n".join(markdown(diagnosis)) + "\n", encoding="utf-8")
    for number, finding in enumerate(diagnosis.findings, 1):
        name = picture_name(number, finding)
        if name is not None and finding.figure is not None:
            lines = [finding.message, *([finding.remedy] if finding.remedy else [])]
            draw_chart(finding.figure, caption=lines).save(folder.file(name), optimize=True)
