"""Places in the file system that others prepared: links, devices, pipes, and what a crash or a lock leaves there."""

from __future__ import annotations

import os
import stat
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.main import get_command

from armsight._files import DeviceLock
from armsight.app.operator.robot_cell import one_console
from armsight.cli import command_ui
from armsight.cli.command_ui import CommandUI
from armsight.cli.commands import app as commands
from armsight.clock import ManualClock
from armsight.drivers import list_images, read_image
from armsight.drivers.remote import ServerAddress
from armsight.drivers.rsi import read_tags
from armsight.errors import BadFile, DataRefused, DeviceFailed, UsageError
from armsight.store import atomic, read_rig, write_text
from armsight.store.atomic import sha256
from armsight.store.interpret.read import interpret
from armsight.store.recording.mcapfile import McapFile
from armsight.store.recording.reader import Recording
from armsight.store.recording.repair import repair
from armsight.store.tokens import add_token, read_tokens
from armsight.store.urdf import read_urdf
from refusals import refuses

READERS: dict[str, Callable[[Path], Any]] = {
    "rig": read_rig,
    "urdf": read_urdf,
    "tokens": read_tokens,
    "rsi": read_tags,
    "image": read_image,
    "recording": Recording,
    "repair": lambda path: repair(path, path.parent / "repaired.mcap"),
    "hash": sha256,
    "table": lambda path: interpret(path, "joints"),
}


def places(folder: Path) -> Iterator[tuple[str, Path]]:
    """Yield places that are no files; the tests end, and early, only where nobody begins to read them."""
    os.mkfifo(folder / "pipe")
    yield "pipe", folder / "pipe"
    (folder / "link-to-pipe.png").symlink_to(folder / "pipe")
    yield "link to a pipe", folder / "link-to-pipe.png"
    for device in ("/dev/zero", "/dev/full", "/dev/urandom"):
        (folder / f"{Path(device).name}.yaml").symlink_to(device)
        yield device, folder / f"{Path(device).name}.yaml"
    (folder / "loop").symlink_to(folder / "loop")
    yield "a link to itself", folder / "loop"
    yield "nothing", folder / "none"


@pytest.mark.timeout(20)
@pytest.mark.parametrize("name", READERS)
def test_what_is_no_file_is_refused_at_once(name: str, tmp_path: Path) -> None:
    for what, path in places(tmp_path):
        with pytest.raises(DataRefused) as caught:
            READERS[name](path)
        assert caught.value.cause, what


@pytest.mark.timeout(20)
def test_a_pipe_among_images_does_not_hold_up_the_others(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "a.png")
    (path,) = list_images(str(tmp_path))
    with refuses(BadFile, "not a file"):
        read_image(path)


def test_a_file_behind_a_link_is_read(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"x")
    (tmp_path / "b").symlink_to(tmp_path / "a")
    assert atomic.read_bytes(tmp_path / "b", limit=5) == b"x"


def test_a_link_as_output_stays_and_its_file_is_replaced(tmp_path: Path) -> None:
    goal, link = tmp_path / "deep" / "goal.yaml", tmp_path / "link.yaml"
    goal.parent.mkdir()
    goal.write_text("old")
    link.symlink_to(goal)
    write_text(link, "new")
    assert link.is_symlink() and goal.read_text() == "new" and [p.name for p in goal.parent.iterdir()] == ["goal.yaml"]


def test_dev_null_as_output_is_not_replaced(tmp_path: Path) -> None:
    before = Path("/dev/null").stat()
    for path in (Path("/dev/null"), tmp_path / "null"):
        if not path.exists():
            path.symlink_to("/dev/null")
        write_text(path, "gone")
    now = Path("/dev/null").stat()
    assert stat.S_ISCHR(now.st_mode) and now.st_ino == before.st_ino
    assert not list(Path("/dev").glob(".null.*.part"))


@pytest.mark.timeout(20)
def test_a_recording_is_not_written_to_a_device_nor_deletes_it(tmp_path: Path) -> None:
    (tmp_path / "empty.mcap").write_bytes(b"\x89MCAP0\r\n")
    for path in (Path("/dev/null"), tmp_path):
        with refuses(UsageError, "already"):
            McapFile(path, overwrite=True, clock=ManualClock())
        with refuses(UsageError, "already"):
            repair(tmp_path / "empty.mcap", path, overwrite=True)
    assert Path("/dev/null").exists()


@pytest.mark.timeout(20)
def test_a_pipe_that_nobody_reads_is_told_and_one_that_is_read_is_written(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with refuses(DeviceFailed, "written"):
        write_text(pipe, "text")
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    try:
        write_text(pipe, "text")
        assert os.read(reader, 10) == b"text"
    finally:
        os.close(reader)
    assert stat.S_ISFIFO(pipe.stat().st_mode)


def test_standard_output_by_its_name_is_written_to() -> None:
    code = "from armsight.store import write_text; from pathlib import Path; write_text(Path('/dev/stdout'), 'told')"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "told"
    assert Path("/dev/stdout").is_symlink()


def test_a_disk_that_is_full_is_told(tmp_path: Path) -> None:
    (tmp_path / "full").symlink_to("/dev/full")
    with refuses(DeviceFailed, "No space"):
        write_text(tmp_path / "full", "text")


def test_the_file_of_a_lock_is_no_link(tmp_path: Path) -> None:
    precious = tmp_path / "precious"
    precious.write_text("kept")
    (tmp_path / "armsight-camera-0.lock").symlink_to(precious)
    with DeviceLock("camera:0", folder=tmp_path):
        pass
    assert precious.read_text() == "kept"
    cell = tmp_path / "cell"
    cell.mkdir()
    for name in ("armsight-the-console-of-this-folder.lock",):
        (cell / name).symlink_to(precious)
    with one_console(cell):
        pass
    assert precious.read_text() == "kept"


def crashed(monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
    """Let a command meet something unforeseen; what is said is kept in a file of the folder."""
    monkeypatch.setattr(command_ui, "log_path", lambda: folder / "armsight.log")
    token = "a-local-that-nobody-should-read"  # noqa: F841 - looked for in the log below
    with pytest.raises(typer.Exit), CommandUI(as_json=False):
        raise RuntimeError("unforeseen")


def test_the_log_of_a_crash_is_for_its_owner_and_holds_no_values(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("ARMSIGHT_TOKEN", "token-of-the-environment")
    crashed(monkeypatch, tmp_path)
    log = tmp_path / "armsight.log"
    assert stat.S_IMODE(log.stat().st_mode) == 0o600 and "unforeseen" in log.read_text()
    assert not any(word in log.read_text() for word in ("nobody-should-read'", "token-of-the-environment"))


@pytest.mark.parametrize("there", ["link", "file"])
def test_the_log_of_a_crash_writes_over_nothing(there: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    precious, log = tmp_path / "precious", tmp_path / "armsight.log"
    precious.write_text("kept")
    log.symlink_to(precious) if there == "link" else log.write_text("kept")
    crashed(monkeypatch, tmp_path)
    assert precious.read_text() == "kept" and log.read_text() == "kept"


def test_a_temporary_file_is_for_its_owner_until_it_is_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    modes = []
    sync = os.fsync

    def synced(handle: int) -> None:
        modes.append(stat.S_IMODE(os.fstat(handle).st_mode))
        sync(handle)

    monkeypatch.setattr(os, "fsync", synced)
    write_text(tmp_path / "x.yaml", "x")
    assert modes[0] == 0o600


@pytest.mark.parametrize("mode", [0o602, 0o620, 0o666, 0o777])
def test_tokens_that_others_may_change_are_not_used(mode: int, tmp_path: Path) -> None:
    path = tmp_path / "tokens.yaml"
    token = add_token(path, "ann", "drive")
    assert stat.S_IMODE(path.stat().st_mode) == 0o600 and token not in path.read_text()
    path.chmod(mode)
    with refuses(BadFile, "owner"):
        read_tokens(path)


def test_no_command_takes_a_token_where_ps_shows_it() -> None:
    left, found = [get_command(commands)], []
    while left:
        command = left.pop()
        left += getattr(command, "commands", {}).values()
        found += [
            (command.name, one.name)
            for one in command.params
            if any(word in str(one.name) for word in ("token", "password", "secret"))
        ]
    assert {name for _, name in found} <= {"tokens", "add_token", "mqtt_password_file"}, (
        "names of files, and a name with a role"
    )


def test_an_address_holds_no_secret() -> None:
    with pytest.raises(UsageError) as caught:
        ServerAddress(url="wss://ann:secret@robot.example:8765")
    assert "secret" not in str(caught.value)


@pytest.mark.parametrize("url", ["ws://192.0.2.1:8765", "ws://localhost.evil.example:1", "ws://127.0.0.1.evil:1"])
def test_a_token_does_not_leave_this_machine_in_plain_text(url: str) -> None:
    with refuses(UsageError, "plain text") as caught:
        ServerAddress(url=url, token="a-token")
    assert "a-token" not in str(caught.value)
