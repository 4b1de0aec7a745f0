"""Where the compiled kernels are missing or not wanted, the NumPy twins run everything; missing ones are said once."""

import os
import subprocess
import sys

CHOSEN = """
import warnings
warnings.simplefilter("error")
from gridslam.kernels import backend, compiled, reference
assert backend is reference and not compiled
"""

# None in sys.modules is how an import of a module that does not exist looks to its importer.
MISSING = """
import sys, warnings
sys.modules["gridslam.kernels._compiled"] = None
with warnings.catch_warnings(record=True) as said:
    warnings.simplefilter("always")
    import gridslam.kernels
    from gridslam.kernels import backend, compiled
    import gridslam.grid, gridslam.matching, gridslam.mapping
assert backend.__name__ == "gridslam.kernels.reference" and not compiled
assert [w.category for w in said] == [RuntimeWarning], [str(w.message) for w in said]
assert "compile" in str(said[0].message)
"""

SCANS = """
import numpy as np
from gridslam.grid import Evidence, TileMaps
from gridslam.matching import GaussNewton
from gridslam.types import LaserScan, ScanGeometry

rng = np.random.default_rng(7)
maps = TileMaps(2, resolution_m=0.05, reach_cells=10.5, evidence=Evidence(2.4, -0.4, -16, 32, 2.0))
geometry = ScanGeometry(np.linspace(-2, 2, 90))
rows, pose = np.arange(2, dtype=np.int32), np.zeros((2, 3))
for step in range(4):
    ranges = 4 / np.maximum(np.abs(np.cos(geometry.bearings)), 0.5) + rng.normal(0, 0.01, 90)
    beams = LaserScan.from_ranges(step, ranges, geometry).beams(0.05, 30.0)
    if step:
        guess = pose + rng.normal(0, 0.01, (2, 3))
        pose = GaussNewton()(maps, rows, guess, np.repeat(np.eye(3)[None], 2, axis=0), beams).poses
    maps.update(rows, np.round(pose, 3), beams)
    maps.select(np.array([step % 2, 1]))
# Poses agree to less than the rounding; the maps then agree in every bit.
print(np.round(pose, 3).tolist(), {name: int(a.astype(np.int64).sum()) for name, a in maps.to_arrays().items()})
"""


def run(code, **environment):
    done = subprocess.run(
        [sys.executable, "-c", code], env={**os.environ, **environment}, capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr
    return done


def test_the_environment_chooses_the_twins_without_a_word():
    assert run(CHOSEN, GRIDSLAM_KERNELS="reference").stderr == ""


def test_missing_kernels_warn_exactly_once():
    run(MISSING, GRIDSLAM_KERNELS="compiled")


def test_the_fallback_maps_and_matches_as_the_kernels_do():
    by_twins = run(SCANS, GRIDSLAM_KERNELS="reference").stdout
    assert by_twins == run(SCANS, GRIDSLAM_KERNELS="compiled").stdout
    assert "log_odds" in by_twins
