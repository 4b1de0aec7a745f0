"""Log diagnosis: content and faults; docs/doctor.md lists every finding."""

from gridslam.doctor.diagnose import Doctor, diagnose
from gridslam.doctor.diagnosis import Diagnosis, LaserFacts
from gridslam.doctor.finding import Figure, Finding, Mark, Series, Severity
from gridslam.doctor.quick import CheckedLog, quick_check
from gridslam.doctor.repair import Repair
from gridslam.doctor.repaired_log import RepairedLog

__all__ = [
    "CheckedLog", "Diagnosis", "Doctor", "Figure", "Finding", "LaserFacts", "Mark", "Repair", "RepairedLog", "Series",
    "Severity", "diagnose", "quick_check",
]  # fmt: skip
