"""Log diagnosis: content and faults; docs/doctor.md lists every finding."""

from gridslam.doctor.diagnose import (
    CheckedLog,
    Diagnosis,
    Doctor,
    EarlyCheck,
    diagnose,
)
from gridslam.doctor.finding import Finding, Severity
from gridslam.doctor.repair import Repair, RepairedLog

__all__ = [
    "CheckedLog",
    "Diagnosis",
    "Doctor",
    "EarlyCheck",
    "Finding",
    "Repair",
    "RepairedLog",
    "Severity",
    "diagnose",
]
