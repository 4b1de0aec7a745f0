"""What only a process of its own shows: start, signals, pipes."""

import os
import signal
import subprocess
import sys
import time

import pytest

GRIDSLAM = sys.executable, "-m", "gridslam"


def start(*arguments, **options):
    command = [*GRIDSLAM, *map(str, arguments)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **options)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_interrupted_run_leaves_everything_as_it_was(log, tmp_path, number):
    out = tmp_path / "out"
    out.mkdir()
    (out / "map.png").write_text("of an earlier run")
    run = start("map", log, "-o", out, "--particles", "500")
    while not list(out.glob(".*.partial")):  # the folder aside is made when the run begins
        assert run.poll() is None, run.communicate()
        time.sleep(0.01)
    time.sleep(0.3)
    run.send_signal(number)
    printed, problem = run.communicate(timeout=60)
    assert (run.returncode, printed) == (130, "")
    assert problem.splitlines()[-1] == "gridslam: interrupted"
    assert "Traceback" not in problem
    assert [path.name for path in out.iterdir()] == ["map.png"]
    assert (out / "map.png").read_text() == "of an earlier run"


@pytest.mark.skipif(not hasattr(os, "openpty"), reason="needs a pseudo terminal")
def test_progress_is_a_bar_on_a_terminal(log, tmp_path):
    leader, follower = os.openpty()
    command = [*GRIDSLAM, "map", str(log), "-o", str(tmp_path / "out"), "--particles", "3", "--duration", "4"]
    run = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=follower, env=os.environ | {"TERM": "xterm"})
    os.close(follower)
    told = b""
    while True:
        try:
            block = os.read(leader, 4096)
        except OSError:  # the other side is closed
            break
        if not block:
            break
        told += block
    os.close(leader)
    assert run.wait() == 0
    assert "━".encode() in told


def test_a_reader_that_goes_away_is_no_traceback(log, tmp_path):
    run = start("map", log, "-o", tmp_path / "out", "--particles", "2", "--duration", "4")
    run.stdout.close()
    problem = run.stderr.read()
    assert run.wait() == 1
    assert "Traceback" not in problem
    assert "Exception ignored" not in problem
    run.stderr.close()


@pytest.mark.parametrize("pause_s", [0.0, 0.2])
def test_further_interrupts_print_no_traceback(log, tmp_path, pause_s):
    out = tmp_path / "out"
    out.mkdir()
    run = start("map", log, "-o", out, "--particles", "500")
    while not list(out.glob(".*.partial")):
        assert run.poll() is None, run.communicate()
        time.sleep(0.01)
    for _ in range(200):
        if run.poll() is not None:
            break
        run.send_signal(signal.SIGINT)
        time.sleep(pause_s)
    printed, problem = run.communicate(timeout=60)
    assert (run.returncode, printed) == (130, "")
    assert "Traceback" not in problem
    assert "Exception ignored" not in problem
    assert problem.splitlines()[-1] == "gridslam: interrupted"
    assert not list(out.iterdir())


SWALLOWED = """
import os, signal
from gridslam.cli.output import handle_signals, stop_if_interrupted
class Dying:
    def __del__(self):
        os.kill(os.getpid(), {number})
        print("never printed")
with handle_signals(until_exit=True):
    dying = Dying()
    del dying
    try:
        stop_if_interrupted()
    except KeyboardInterrupt:
        print("stopped")
"""


def test_an_interrupt_that_python_swallows_is_repeated_and_not_reported():
    """One that comes in a destructor, or in a callback of an import."""
    program = SWALLOWED.format(number=int(signal.SIGINT))
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60)
    assert (run.returncode, run.stdout, run.stderr) == (0, "stopped\n", "")


@pytest.mark.parametrize(
    ("command", "closed"),
    [("map", (0, 1, 2)), ("--version", (1,)), ("missing", (2,)), ("batch", (0, 1, 2))],
)
def test_closed_streams_change_nothing(log, tmp_path, command, closed):
    out = tmp_path / "out"
    few = ["--particles", "2", "--duration", "2"]
    arguments = {"map": ["map", log, "-o", out, *few], "batch": ["batch", log, "-o", out, "--", *few]}
    run = start(*arguments.get(command, [command]), preexec_fn=lambda: [os.close(stream) for stream in closed])
    printed, problem = run.communicate(timeout=60)
    assert run.returncode == (2 if command == "missing" else 0)
    assert "Traceback" not in problem
    assert (printed == "") == (1 in closed or command == "missing")
    found = {"map": out / "map.yaml", "batch": out / "rooms" / "map.yaml"}
    assert command not in found or found[command].exists()


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs a device that is full")
def test_a_full_device_is_one_line(log, tmp_path):
    for arguments in (["--version"], ["map", log, "-o", tmp_path / "out", "--particles", "2", "--duration", "2"]):
        with open("/dev/full", "w") as full:
            command = [*GRIDSLAM, *map(str, arguments)]
            done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True)
            assert done.returncode == 1
            assert done.stderr == "gridslam: [Errno 28] No space left on device\n"


ASCII = {"PYTHONUTF8": "0", "LC_ALL": "C"}


def test_logs_of_any_name_in_any_locale(log, tmp_path):
    name = "\udcff\n.clf.bz2"
    os.link(log, tmp_path / name)
    few = ["--duration", "2"]
    mapped = ["map", name, "-o", "ä", "--save", "ü.gridslam", "--particles", "2", *few]
    batch = ["batch", name, "-o", "ö", "--", "--particles", "2", *few]
    for arguments, environment in ((mapped, {}), (batch, ASCII)):
        command = [*GRIDSLAM, *map(os.fsencode, arguments)]
        done = subprocess.run(command, capture_output=True, cwd=tmp_path, env={**os.environ, **environment})
        assert (done.returncode, b"Traceback" in done.stderr) == (0, False), (arguments, done.stderr)


@pytest.mark.skipif(not os.path.isdir("/proc/self/task"), reason="the system does not list threads")
def test_the_command_starts_no_threads_of_linear_algebra():
    names = "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"
    plain = {name: value for name, value in os.environ.items() if name not in names}
    code = "import os, gridslam.cli.main, numpy; print(len(os.listdir('/proc/self/task')))"
    done = subprocess.run([sys.executable, "-c", code], env=plain, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "1"
