"""What is in a log and what is wrong with it, in plain words; docs/doctor.md tells every finding."""

from gridslam.doctor.diagnose import Doctor, diagnose, quick_check
from gridslam.doctor.diagnosis import Diagnosis, LaserFacts
from gridslam.doctor.finding import Figure, Finding, Mark, Series, Severity

__all__ = [
    "Diagnosis", "Doctor", "Figure", "Finding", "LaserFacts", "Mark", "Series", "Severity", "diagnose", "quick_check",
]  # fmt: skip
