"""The diagnosis of a log as files, and the check of its first minute while another command reads it."""

from __future__ import annotations

from collections.abc import Callable

from gridslam.doctor import CheckedLog, Diagnosis, Finding
from gridslam.doctor.report import document, text
from gridslam.io.log import Log, LogOptions
from gridslam.io.output import OutputFolder


def check_log(log: Log, options: LogOptions, warn: Callable[[str], None]) -> CheckedLog:
    """Wrap a log so that faults at its beginning are reported while it is read, one line each.

    That there is no odometry is no news to who asked for it.
    """

    def report(found: tuple[Finding, ...]) -> None:
        for finding in found:
            if finding.code != "no_odometry" or not options.no_odometry:
                warn(describe_finding(log, finding))

    return CheckedLog(log, report)


def describe_finding(log: Log, finding: Finding) -> str:
    """Describe the findings of a log in one line."""
    return f"{log.path}: {finding.code}: {finding.message} {finding.remedy}".rstrip()


def write_diagnosis(diagnosis: Diagnosis, folder: OutputFolder) -> None:
    """Write report.json and report.txt."""
    folder.write_json("report.json", document(diagnosis))
    lines = "\n".join(text(diagnosis)) + "\n"  # with the name of the log, which may hold bytes that are no text
    folder.file("report.txt").write_text(lines, encoding="utf-8", errors="backslashreplace")
