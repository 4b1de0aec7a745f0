#!/usr/bin/env bash
# Builds the kernels under AddressSanitizer and UBSan into a temporary folder and runs their tests on them.
#
#   tests/asan.sh [pytest arguments]
#
# PYTHON names the interpreter (python3 if not set); it needs this package's dependencies, pytest, hypothesis, nanobind
# and cmake. Nothing that is installed is changed.
set -euo pipefail

root=$(cd "$(dirname "$0")/.." && pwd)
python=$("${PYTHON:-python3}" -c 'import sys; print(sys.executable)')
PATH="$(dirname "$python"):$PATH"
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

cmake -S "$root" -B "$work/build" -DPython_EXECUTABLE="$python" -DGRIDSLAM_SANITIZE=ON > "$work/log" 2>&1 &&
  cmake --build "$work/build" --parallel 2 >> "$work/log" 2>&1 ||
  { cat "$work/log" >&2; exit 1; }
compiler=$(sed -n 's/^CMAKE_CXX_COMPILER:[A-Z]*=//p' "$work/build/CMakeCache.txt")

mkdir "$work/package"
cp -R "$root/src/gridslam" "$work/package/"
find "$work/package" -name '_compiled*' -delete
cp "$work"/build/_compiled*.so "$work/package/gridslam/kernels/"

cat > "$work/run.py" <<'PYTHON'
"""Run pytest on the package beside this file, even where an editable install would answer for it."""
import sys
from pathlib import Path

package = Path(__file__).parent / "package"
sys.meta_path[:] = [finder for finder in sys.meta_path if not type(finder).__name__.startswith("ScikitBuild")]
sys.path.insert(0, str(package))

import pytest  # noqa: E402

from gridslam.kernels import backend  # noqa: E402

assert Path(backend.__file__).is_relative_to(package), backend.__file__
loaded = Path("/proc/self/maps").read_text()
assert "libasan" in loaded and "libubsan" in loaded, "the sanitizers are not loaded"
sys.exit(pytest.main(sys.argv[1:]))
PYTHON

# The runtime must come before everything else, libstdc++ with it so that exceptions are caught; Python's own allocator
# would hide the ends of small arrays. Reports go to a file, since pytest swallows what is said before a crash.
preload="$("$compiler" -print-file-name=libasan.so) $("$compiler" -print-file-name=libstdc++.so.6)"
cd "$work"
env -u GRIDSLAM_KERNELS -u PYTHONPATH LD_PRELOAD="$preload" ASAN_OPTIONS="detect_leaks=0:log_path=$work/report" UBSAN_OPTIONS="print_stacktrace=1:log_path=$work/report" \
  PYTHONMALLOC=malloc PYTHONDONTWRITEBYTECODE=1 \
  "$python" run.py -p no:cacheprovider -c "$root/pyproject.toml" --rootdir "$root" \
  "$root/tests/laws/test_twins.py" "$root/tests/laws/test_tiles.py" "$root/tests/laws/test_branch_and_bound_laws.py" \
  "$root/tests/unit/kernels/test_threads.py" "$root/tests/unit/matching/test_branch_and_bound.py" \
  "$root/tests/unit/grid/test_far_maps.py" "$root/tests/fuzz/test_kernels.py" \
  "$@" ||
  { cat "$work"/report* >&2 2> /dev/null; exit 1; }
