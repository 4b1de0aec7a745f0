"""docs/doctor.md tells of every finding there is, and of no other."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[3]


def test_every_code_has_its_section():
    sources = "\n".join(path.read_text(encoding="utf-8") for path in (ROOT / "src/gridslam/doctor").glob("*.py"))
    codes = set(re.findall(r'Finding\(\s*"(\w+)"', sources)) | {"late_transform", "missing_transform"}
    sections = re.findall(r"^### (\w+)$", (ROOT / "docs/doctor.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert len(codes) > 20
    assert sorted(sections) == sorted(codes)
