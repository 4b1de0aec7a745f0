"""`view OUT` waits for no pipe that lies in OUT."""

import os
import shutil

import numpy as np
import pytest

from gridslam.api.mapping import map_log
from gridslam.config import override
from gridslam.errors import InputError
from gridslam.io.carmen.writer import write_carmen
from gridslam.live.history import History, Moment
from gridslam.live.history_file import write_history
from gridslam.live.replay import Replay
from support.loops import PROVOKED, loop_drive

READ = "run.json", "graph.g2o", "map.yaml", "map.pgm"
OPTIONAL = "history.npz", "truth.tum"


@pytest.fixture(scope="module")
def healthy(tmp_path_factory):
    folder = tmp_path_factory.mktemp("mapped")
    write_carmen(folder / "loop.clf", loop_drive().measurements[:40])
    map_log(folder / "loop.clf", configuration=override(PROVOKED, "particles=3"), repair="none").save(folder / "out")
    shutil.copy(folder / "out" / "trajectory.tum", folder / "out" / "truth.tum")
    history = History()
    nothing = np.zeros((0, 2))
    path, at, scan = (nothing.astype(kind) for kind in (np.float32, np.int32, np.int16))
    history.stamps_ns.append(1)
    history.scans.append(1)
    history.figures.extend([0.0] * 5)
    history.add(Moment(1, 1, np.zeros(3), 0, path, at, np.zeros(0, np.uint8), scan))
    write_history(folder / "out" / "history.npz", history)
    return folder / "out"


@pytest.fixture
def out(healthy, tmp_path):
    return shutil.copytree(healthy, tmp_path / "out")


@pytest.mark.parametrize("name", [*READ, *OPTIONAL])
def test_a_pipe_in_the_folder_does_not_block(out, name):
    (out / name).unlink(missing_ok=True)
    os.mkfifo(out / name)
    if name in READ:
        with pytest.raises(InputError, match=name):
            Replay(out)
    else:
        Replay(out)
