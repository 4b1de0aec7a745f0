"""Findings from reading a log: topics, missing transforms, a truncated file."""

from __future__ import annotations

from collections.abc import Iterator

from gridslam.doctor.finding import Finding, Severity, percent
from gridslam.io.log_statistics import LogStatistics

_LATE = "no reading"  # a link that has readings, but none at the scan's time
_FEW = 0.02  # share of the scans, as at the begin and the end of a recording: their neighbours show the same walls
_SHOWN = 40


def reader_findings(statistics: LogStatistics) -> Iterator[Finding]:
    """Yield the findings from the statistics of a log that was read to its end."""
    if statistics.missing_files:
        yield _missing_files(statistics.missing_files)
    if statistics.clock_offset_s:
        yield _two_clocks(statistics.clock_offset_s)
    for reason, scans in statistics.missing_transforms.most_common():
        if statistics.clock_offset_s and reason.startswith("odometry"):
            continue  # which is what two clocks come to
        chain = f" ({statistics.odometry_source})" if reason.startswith("odometry") else ""
        yield _missing(reason + chain, scans, statistics.scan_count)
    if statistics.truncated:
        yield Finding(
            "unreadable",
            Severity.WARNING,
            f"The log is truncated after {statistics.scan_count} scans.",
            statistics.scan_count,
            "scans",
            "Record it again, if the end matters.",
        )
    for remark, count in statistics.remarks.items():
        times = f" ({count} times)" if count > 1 else ""
        yield Finding("remark", Severity.INFO, f"{remark[:1].upper()}{remark[1:]}{times}.", count, "times")
    yield _topics(statistics)


def _missing_files(names: tuple[str, ...]) -> Finding:
    shown = ", ".join(names[:_SHOWN]) + (f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else "")
    absent = "is not there: what was recorded in it" if len(names) == 1 else "are not there: what was recorded in them"
    of_bag = "of the bag, by its metadata.yaml or by the numbers of its files,"
    return Finding(
        "missing_files",
        Severity.WARNING,
        f"{shown} {of_bag} {absent} is not read.",
        len(names),
        "files",
        "Copy the whole folder of the bag; ros2 bag reindex writes the metadata of what is left.",
    )


def _two_clocks(offset_s: float) -> Finding:
    side = "ahead of" if offset_s > 0 else "behind"
    return Finding(
        "clock_skew",
        Severity.WARNING,
        f"The stamps of the odometry are {abs(offset_s):.1f} s {side} those of the scans recorded at the same time: "
        "they come from two clocks, and odometry cannot be assigned to the scans.",
        -offset_s,
        "s",
        "Synchronize the clocks of the computers (NTP, chrony), or stamp both by one; --no-odometry until then.",
    )


def _missing(reason: str, scans: int, of: int) -> Finding:
    """Return a transform that came late for some scans, or never came."""
    late = _LATE in reason
    share = min(scans / max(of, 1), 1.0)
    few = late and share <= _FEW
    remedy = (
        "Record transforms and odometry from before the first scan until after the last, by the scans' clock."
        if late
        else "Publish the missing transform (static_transform_publisher) and record /tf and /tf_static, or name the "
        "robot's frames with --base-frame and --odom-frame."
    )
    return Finding(
        "late_transform" if late else "missing_transform",
        Severity.INFO if few else Severity.WARNING,
        f"{scans} of {of} scans ({percent(share)}) lack a transform; {reason}.",
        scans,
        "scans",
        "" if few else remedy,
    )


def _topics(statistics: LogStatistics) -> Finding:
    """Return all that the log holds; of a bag its topics with their types."""
    if statistics.topics:
        counted = [(name, topic.type, topic.messages) for name, topic in sorted(statistics.topics.items())]
    else:
        counted = [(tag, "laser scans", count) for tag, count in statistics.scans.items()]
        counted += [("ODOM", "odometry", statistics.odometry_lines)] if statistics.odometry_lines else []
        counted += [(tag, "not used", count) for tag, count in statistics.unused_tags.most_common()]
    reported = ", ".join(f"{name} ({kind}): {count}" for name, kind, count in counted[:_SHOWN])
    more = f" and {len(counted) - _SHOWN} more" if len(counted) > _SHOWN else ""
    return Finding("topics", Severity.INFO, f"The log holds {reported}{more}.", len(counted), "topics")
