"""What commands write: checked before the work begins, and where one of it fails in the end the others are written."""

import errno
import re
from pathlib import Path

import click
import pytest

from gridslam.api.session import Session
from gridslam.cli.commands import gridslam
from gridslam.cli.option_types import OUT, OUTPUT_FILE, OUTPUT_FOLDER

FEW = "--particles", "2", "--duration", "4"
FOLDERS = OUT, OUTPUT_FOLDER
TARGETS = *FOLDERS, OUTPUT_FILE


def commands(group=gridslam, names=()):
    context = click.Context(group)
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        if isinstance(command, click.Group):
            yield from commands(command, (*names, name))
        else:
            yield (*names, name), command


WRITTEN = [
    pytest.param(names, parameter, id=" ".join([*names, parameter.name]))
    for names, command in commands()
    for parameter in command.params
    if parameter.type in TARGETS
]


def given(parameter, value):
    return [value] if isinstance(parameter, click.Argument) else [parameter.opts[0], value]


@pytest.mark.parametrize(("names", "parameter"), WRITTEN)
@pytest.mark.parametrize(
    ("target", "problem"),
    [
        ("file/below", "expected a folder to write to, but .*file is a file"),
        ("link/below", "is a link to nothing"),
        ("x" * 300, "expected a path, got one that no file can have: File name too long"),
        ("new/" + "x" * 300 + "/below", "File name too long"),
        ("/proc/nowhere/below", "/proc/nowhere/below: cannot be written: "),
        ("other", "other is a file|got an existing folder"),
    ],
)
def test_what_cannot_be_written_is_one_line_before_anything_else(
    call, tmp_path, monkeypatch, names, parameter, target, problem
):
    monkeypatch.chdir(tmp_path)
    Path("file").write_text("")
    Path("link").symlink_to("nowhere")
    if parameter.type in FOLDERS:
        Path("other").write_text("")
    else:
        Path("other").mkdir()
    before = sorted(tmp_path.rglob("*"))
    first = ["log.clf"] if names == ("convert",) else []
    status, out, err = call(*names, *first, *given(parameter, target))
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert re.search(problem, err), err
    assert sorted(tmp_path.rglob("*")) == before


def test_every_option_that_is_written_is_checked():
    for names, command in commands():
        for parameter in command.params:
            said = getattr(parameter, "help", None) or ""
            if isinstance(parameter.type, click.Path) and re.match(r"(Output|Write|Save|Record|Folder for)\b", said):
                assert parameter.type in TARGETS, (names, parameter.name)


def full_disk(*_, **__):
    raise OSError(errno.ENOSPC, "No space left on device")


@pytest.mark.parametrize("command", ["map", "merge"])
def test_where_a_session_cannot_be_saved_the_results_are_written(call, log, tmp_path, monkeypatch, command):
    out = tmp_path / "out"
    saved = tmp_path / "s.gridslam"
    arguments = ["map", log, *FEW]
    if command == "merge":
        sessions = tmp_path / "a.gridslam", tmp_path / "b.gridslam"
        for start_s, session in enumerate(sessions):
            assert call("map", log, "-o", out, "--save", session, *FEW, "--start", start_s)[0] == 0
        arguments = ["merge", *sessions]
    monkeypatch.setattr(Session, "save", full_disk)
    status, said, err = call(*arguments, "-o", out, "--save", saved)
    assert status == 1
    assert "gridslam: [Errno 28] No space left on device\n" in err
    assert "Traceback" not in err
    assert said == ""
    assert (out / "map.yaml").exists()
    assert not saved.exists()


@pytest.mark.parametrize(
    ("option", "value"), [("--duration", "inf"), ("--start", "1e300"), ("--max-gap", "inf"), ("--max-gap", "-1e300")]
)
def test_times_are_such_as_there_can_be(call, log, tmp_path, option, value):
    truth = log.with_name("truth.tum")
    status, out, err = call("grid", log, "--trajectory", truth, "-o", tmp_path / "out", option, value)
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert option in err
    assert not list(tmp_path.iterdir())
