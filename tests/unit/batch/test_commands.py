"""What children of a batch are forked with."""

import json
import subprocess
import sys

from support.batch_jobs import map_job, write_logs

_RUN = """
import importlib, json, sys
from gridslam.batch.child import _PRELOADED
from gridslam.batch.commands import run_map
for name in _PRELOADED:
    importlib.import_module(name)
before = set(sys.modules)
run_map(json.loads(sys.argv[1]))
print(sorted(name for name in set(sys.modules) - before if not name.startswith("encodings.")))
"""


def test_a_job_that_maps_imports_nothing_as_the_server_has_imported_all(tmp_path):
    (log,) = write_logs(tmp_path / "logs", 1)
    arguments = {**map_job(log, "a").arguments, "out": str(tmp_path / "out"), "job": {}}
    done = subprocess.run(
        [sys.executable, "-c", _RUN, json.dumps(arguments)], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "[]"
