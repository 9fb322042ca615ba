"""Python that starts in a hundredth of a second: a process that has imported and loaded all of armsight forks for it.

`commands()` is a folder with `python` and `armsight`, which take the words of the real ones (`-W`, `-m`, `-c`, a
script). Both hand their words, folder, environment and streams to the server, pass signals on, and end as the fork
does; where they are killed, so is the fork. How a process starts (locales, streams that are closed) they do not show.
"""

import atexit
import contextlib
import fcntl
import gc
import os
import runpy
import select
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

import lit_rooms

FOLDER = "ARMSIGHT_WARM_FOLDER"
TESTS = "ARMSIGHT_TESTS_PID"
SOCKET, STARTED, WORDS = "socket", "started", 1 << 20
CLIENT = """\
#!{python} -ISE
import os, signal, socket, sys
line = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
line.connect({address!r})
words = [{first}*sys.argv[1:]]
told = repr((words, os.getcwd(), dict(os.environ), os.nice(0))).encode("utf-8", "surrogateescape")
socket.send_fds(line, [len(told).to_bytes(4, "big")], [0, 1, 2])
line.sendall(told)
fork = int.from_bytes(line.recv(4), "big")
for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
    signal.signal(number, lambda number, _: os.kill(fork, number))
ended = line.recv(4)
os._exit(int.from_bytes(ended, "big") if ended else 70)
"""


def begin() -> None:
    """Choose the server's folder for this run of tests, before workers begin: they inherit it."""
    if FOLDER not in os.environ:
        os.environ[TESTS], os.environ[FOLDER] = str(os.getpid()), tempfile.mkdtemp(prefix="warm")
        atexit.register(shutil.rmtree, os.environ[FOLDER], ignore_errors=True)


def rooms() -> Path:
    """Return the folder of the rooms that all processes of this run of tests share."""
    return Path(os.environ[FOLDER]) / "rooms"


def once(name: str, fill: Callable[[Path], object]) -> Path:
    """Return a folder that is filled once for all processes of this run of tests: nobody writes into it later."""
    folder = Path(os.environ[FOLDER]) / name
    with folder.with_name(f"{name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not folder.exists():
            part = folder.with_name(f"{name}.part")
            shutil.rmtree(part, ignore_errors=True)
            fill(part)
            part.rename(folder)
    return folder


def commands() -> Path:
    """Return the folder of `python` and `armsight`; the first caller of all workers begins their server."""
    folder = Path(os.environ[FOLDER])
    with contextlib.suppress(FileExistsError):
        (folder / STARTED).touch(exist_ok=False)
        with (folder / "log").open("wb") as log:
            command = ["sh", "-c", '"$@" &', "sh", sys.executable, "-W", "error", __file__, str(folder)]
            subprocess.run(command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, check=True)
    until_s = time.monotonic() + 500.0  # a minute of computing, beside all else that runs
    while not (folder / SOCKET).exists():
        assert time.monotonic() < until_s, (folder / "log").read_text()
        time.sleep(0.02)
    return folder / "bin"


def write_commands(folder: Path) -> None:
    """Write the two clients."""
    (folder / "bin").mkdir()
    for name, first in (("python", ""), ("armsight", "'-m', 'armsight', ")):
        file = folder / "bin" / name
        file.write_text(CLIENT.format(python=sys.executable, address=str(folder / SOCKET), first=first))
        file.chmod(0o755)


def load_all() -> None:
    """Import all that commands import, load the kernels from their cache, and bare the rooms of cells."""
    import importlib
    import pkgutil
    import warnings

    import cv2

    cv2.setNumThreads(1)  # threads do not survive a fork
    import armsight
    import armsight_lab
    import armsight_plant
    import armsight_sim
    from armsight.kinematics import warm_up
    from armsight.ops.compilation import GROUPS

    for package in (armsight, armsight_sim, armsight_plant, armsight_lab):
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            if not module.name.endswith("__main__"):
                with contextlib.suppress(ImportError), warnings.catch_warnings():  # of what is not installed
                    warnings.simplefilter("ignore")
                    importlib.import_module(module.name)
    for name, run in GROUPS.items():
        if name not in ("kinematics", "room", "simulator", "measure"):  # the first begins threads, others take long
            run()
    warm_up()
    lit_rooms.bare()


def serve(folder: Path) -> None:
    """Fork for every client until the tests have ended."""
    load_all()
    gc.freeze()  # or the forks' collections would touch, and so copy, every page
    write_commands(folder)
    tests = int(os.environ[TESTS])
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as door:
        door.bind(str(folder / f"{SOCKET}-new"))
        door.listen(64)
        door.settimeout(1.0)
        (folder / f"{SOCKET}-new").rename(folder / SOCKET)
        signal.signal(signal.SIGCHLD, signal.SIG_IGN)
        while alive(tests):
            with contextlib.suppress(TimeoutError):
                line = door.accept()[0]
                if os.fork() == 0:
                    door.close()
                    watch(line)
                line.close()


def alive(process: int) -> bool:
    """Whether a process is there."""
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True


def watch(line: socket.socket) -> None:
    """Fork what a client asks for, and tell how it ended; kill it where the client is gone."""
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    line.settimeout(None)
    head, streams, *_ = socket.recv_fds(line, 4, 3)
    told = b""
    while len(told) < int.from_bytes(head, "big"):
        told += line.recv(WORDS)
    fork = os.fork()
    if fork == 0:
        line.close()
        run(streams, *eval(told.decode("utf-8", "surrogateescape")))  # what CLIENT wrote
    for stream in streams:
        os.close(stream)
    line.sendall(fork.to_bytes(4, "big"))
    ended = os.pidfd_open(fork)
    ready, _, _ = select.select([ended, line], [], [])
    if ended not in ready:
        os.kill(fork, signal.SIGKILL)
    code = os.waitstatus_to_exitcode(os.waitpid(fork, 0)[1])
    with contextlib.suppress(OSError):
        line.sendall((code if code >= 0 else 128 - code).to_bytes(4, "big"))
    os._exit(0)


def run(streams: list[int], words: list[str], folder: str, environment: dict[str, str], niceness: int) -> NoReturn:
    """Do in this fork what Python would with these words, and end."""
    os.nice(niceness - os.nice(0))
    for number, stream in enumerate(streams):
        os.dup2(stream, number)
        os.close(stream)
    sys.stdin = open(0, encoding="utf-8", closefd=False)  # noqa: SIM115  # as long as the process
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    while words[0] == "-W":
        words = words[2:]
    code = 0
    try:
        execute(words, folder)
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else int(end.code is not None)
        if isinstance(end.code, str):
            sys.stderr.write(f"{end.code}\n")
    except BaseException:  # as Python ends
        traceback.print_exc()
        code = 1
    threading._shutdown()  # type: ignore[attr-defined]
    atexit._run_exitfuncs()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)  # what Python would tear down is shared with the server, and would be copied for it


def execute(words: list[str], folder: str) -> None:
    """Run a module, a text or a file as the main program."""
    kind, rest = (words[0], words[1:]) if words[0] in ("-m", "-c") else ("", words)
    sys.argv = ["-c", *rest[1:]] if kind == "-c" else rest
    sys.path[0] = folder if kind else str(Path(rest[0]).resolve().parent)
    if kind == "-m":
        runpy.run_module(rest[0], run_name="__main__", alter_sys=True)
    elif kind == "-c":
        exec(compile(rest[0], "<string>", "exec"), {"__name__": "__main__"})
    else:
        runpy.run_path(rest[0], run_name="__main__")


if __name__ == "__main__":
    serve(Path(sys.argv[1]))
