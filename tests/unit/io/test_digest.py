"""A file is known by its bytes, a folder by its files and their names."""

import hashlib
import shutil
import subprocess

from gridslam.io.text import compute_digest


def test_a_file(tmp_path):
    path = tmp_path / "log"
    path.write_bytes(b"abc")
    assert compute_digest(path) == hashlib.sha256(b"abc").hexdigest()


def test_a_folder_is_what_sha256sum_says_of_its_files(tmp_path):
    folder = tmp_path / "bag"
    (folder / "below").mkdir(parents=True)
    for name in ("b.db3", "metadata.yaml", "below/a"):
        (folder / name).write_bytes(name.encode())
    said = subprocess.run(
        ["sha256sum", "b.db3", "below/a", "metadata.yaml"], cwd=folder, capture_output=True, check=True
    ).stdout
    assert compute_digest(folder) == hashlib.sha256(said).hexdigest()
    moved = shutil.copytree(folder, tmp_path / "elsewhere")
    assert compute_digest(moved) == compute_digest(folder)
    (moved / "b.db3").rename(moved / "c.db3")
    assert compute_digest(moved) != compute_digest(folder)
