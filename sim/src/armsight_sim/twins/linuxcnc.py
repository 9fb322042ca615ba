"""The real LinuxCNC, without a screen, with an arm in Craig's convention: no emulation.

Its kinematics is genserkins, lengths are in mm. Its motors are where they are told to be. It runs as an ordinary user,
since it refuses root, in a folder of its own that goes away with it.
"""

from __future__ import annotations

import contextlib
import os
import pwd
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Mapping
from importlib.resources import files
from pathlib import Path
from signal import SIGKILL, SIGTERM
from types import TracebackType
from typing import Any, ClassVar, Self

from armsight.clock import Clock, SystemClock
from armsight.drivers.linuxcnc.__main__ import BRIDGE, HAL_FILE, set_up
from armsight.errors import DeviceFailed, DeviceNotFound, UsageError
from armsight_sim.twins.base import small_arm_mapping
from armsight_sim.twins.linuxcnc_files import Row, ini, machine_hal, rows_of, without_tcp

APT = "apt-get install --no-install-recommends linuxcnc-uspace"
LOCK = Path("/tmp/linuxcnc.lock")
NML = Path("/usr/share/linuxcnc/linuxcnc.nml")
PORT = 49160
SERVO_S = 0.001
SYSTEM_PATH = "/usr/bin:/bin:/usr/sbin:/sbin"
"""Debian's programs: LinuxCNC's are scripts for Debian's Python."""

ORDINARY, GROUP = "nobody", "nogroup"
"""As whom it runs where this program is root's."""

BRIDGE_FIRST = 20
"""Of SCHED_FIFO; the servo threads go before it."""

UP_S, END_S, POLL_S = 40.0, 15.0, 0.1
LOG_LINES = 6


def missing() -> str:
    """Return that LinuxCNC is not installed; empty where it is."""
    return "" if shutil.which("linuxcnc", path=SYSTEM_PATH) else "LinuxCNC is not installed"


class LinuxcncTwin:
    """A LinuxCNC of its own. port: UDP port of its link; arm: in Craig's convention; cycle_s: the servo period.

    Raises UsageError for an arm that genserkins cannot hold, DeviceNotFound where LinuxCNC is not installed.
    """

    convention: ClassVar[str] = "craig"
    """How the arm is to be given."""

    def __init__(
        self,
        *,
        port: str | None = None,
        connect: str | None = None,
        arm: Mapping[str, Any] | None = None,
        cycle_s: float | None = None,
        clock: Clock | None = None,
    ) -> None:
        if connect is not None:
            raise UsageError("LinuxCNC's link waits for the driver", cure="Give --port in place of --connect")
        if not (port or str(PORT)).isdecimal() or not 0 < int(port or PORT) < 65536:
            raise UsageError(
                f"{port!r} is no UDP port", consequence="There is no twin", cure=f"Give for instance {PORT}"
            )
        self._port = int(port or PORT)
        self._rows: tuple[Row, ...] = rows_of(arm or small_arm_mapping())
        self._servo_ns = round(1e9 * (cycle_s or SERVO_S))
        self._clock = clock or SystemClock()
        self._process: subprocess.Popen[bytes] | None = None
        self._folder: Path | None = None
        self.messages: list[str] = []
        if lacks := missing():
            raise DeviceNotFound(lacks, consequence="There is no twin", cure=f"Install it: {APT}")

    @property
    def address(self) -> str:
        """What opens the driver."""
        return f"linuxcnc:127.0.0.1:{self._port}"

    @property
    def folder(self) -> Path:
        """Where its INI, HAL and log files are. Raises DeviceFailed where it is not open."""
        if self._folder is None:
            raise DeviceFailed("the twin is not open", cure="Open it first")
        return self._folder

    def __enter__(self) -> Self:
        if LOCK.exists():  # without a screen LinuxCNC would end the other one unasked
            raise DeviceFailed(
                f"another LinuxCNC runs on this computer, or one ended without tidying up ({LOCK})",
                consequence="There is no twin: there is one LinuxCNC at a time",
                cure=f"End the other one; where none runs, delete {LOCK}",
            )
        self._folder = Path(tempfile.mkdtemp(prefix="armsight-linuxcnc-"))
        try:
            self._write(self._folder)
            self._begin()
            self._wait_up()
            self._go_first(self._folder)
        except BaseException:
            self.__exit__(None, None, None)
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        process, folder = self._process, self._folder
        self._process = self._folder = None
        if process is not None and folder is not None:
            (folder / "on").unlink(missing_ok=True)  # the holder then ends, and LinuxCNC with it
            for signal in (SIGTERM, SIGKILL):  # its script tidies up behind the first
                with contextlib.suppress(subprocess.TimeoutExpired):
                    process.wait(END_S)
                    break
                with contextlib.suppress(ProcessLookupError):
                    os.kill(process.pid, signal)
            process.wait()
        if folder is not None:
            shutil.rmtree(folder, ignore_errors=True)

    def run(self, on: Callable[[], bool]) -> None:
        """Let it run as long as on() holds. Raises DeviceFailed where it ends by itself."""
        while on():
            if self._process is None or self._process.poll() is not None:
                raise DeviceFailed(f"LinuxCNC ended by itself: {self._log()}", consequence="There is no twin any more")
            self._clock.sleep_until(self._clock.now_s() + POLL_S)

    def _write(self, folder: Path) -> None:
        """Write what it starts from, owned by whom it runs as."""
        holder = folder / "holder.py"
        holder.write_text((files("armsight_sim.twins") / "linuxcnc_holder.py").read_text())
        display = f"{folder}/display"
        (folder / "display").write_text(
            f"#!/bin/sh\nexec /usr/bin/python3 {holder} {folder}/on {folder}/up {os.getpid()}\n"
        )
        (folder / "on").touch()
        (folder / "display").chmod(0o755)
        (folder / "machine.hal").write_text(machine_hal(self._rows))
        names = ("machine.hal", HAL_FILE)
        twin_ini = folder / "twin.ini"
        twin_ini.write_text(ini(self._rows, servo_ns=self._servo_ns, display=display, hal_files=names))
        set_up(twin_ini, bind="127.0.0.1", port=self._port)
        (folder / "linuxcnc.nml").write_text(without_tcp(NML.read_text()))
        (folder / "linuxcnc.tbl").write_text("")
        if os.geteuid() == 0:
            owner = pwd.getpwnam(ORDINARY)
            for path in (folder, *folder.rglob("*")):
                os.chown(path, owner.pw_uid, owner.pw_gid)

    def begin(self, *words: str, **more: Any) -> subprocess.Popen[Any]:
        """Begin a program of LinuxCNC's as the user it runs as, in its folder and environment."""
        away = {"DISPLAY", "WAYLAND_DISPLAY", "PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV"}
        env = {key: value for key, value in os.environ.items() if key not in away}
        env |= {"HOME": f"{self.folder}", "RTAPI_FIFO_PATH": f"{self.folder}/rtapi_fifo", "PATH": SYSTEM_PATH}
        # Popen's own user= forks this process as a whole, which keeps its other threads waiting
        as_user = ["setpriv", "--reuid", ORDINARY, "--regid", GROUP, "--clear-groups"] if os.geteuid() == 0 else []
        return subprocess.Popen([*as_user, *words], cwd=self.folder, env=env, **more)

    def hal(self, *words: str) -> str:
        """Return what LinuxCNC's halcmd answers. Raises DeviceFailed where it refuses."""
        process = self.begin("halcmd", *words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        out, error = process.communicate()
        if process.returncode:
            raise DeviceFailed(f"halcmd {' '.join(words)}: {error.strip() or out.strip()}")
        return str(out)

    def joints_deg(self) -> list[float]:
        """Return where its joints are commanded to be, in degrees."""
        rows = (row.split() for row in self.hal("-s", "show", "pin", "joint.*.pos-cmd").splitlines())
        found = {row[4]: float(row[3]) for row in rows if len(row) > 4}
        return [found[f"joint.{j}.pos-cmd"] for j in range(len(self._rows))]

    def _begin(self) -> None:
        with (self.folder / "linuxcnc.log").open("wb") as log:
            self._process = self.begin(
                "linuxcnc",
                f"{self.folder}/twin.ini",
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,  # Ctrl-C is for this process, which ends the other
            )

    def _wait_up(self) -> None:
        """Wait until it is homed. Raises DeviceFailed, with the end of its log, where that does not come to be."""
        end_s = self._clock.now_s() + UP_S
        up = self.folder / "up"
        while not up.exists():
            if self._process is None or self._process.poll() is not None or self._clock.now_s() > end_s:
                raise DeviceFailed(f"LinuxCNC did not come up: {self._log()}", consequence="There is no twin")
            self._clock.sleep_until(self._clock.now_s() + POLL_S)
        if (why := up.read_text()) != "up":
            raise DeviceFailed(f"LinuxCNC is up, but {why}: {self._log()}", consequence="There is no twin")

    @staticmethod
    def _go_first(folder: Path) -> None:
        """Let servo threads and bridge go before other work of this computer, as a controller's do on its own."""
        for process in Path("/proc").glob("[0-9]*"):
            with contextlib.suppress(OSError):  # it has ended, or the system does not allow it
                command = (process / "cmdline").read_bytes()
                ours = f"{folder}/{BRIDGE.name}".encode() in command and b"python3" in command
                if not ours and b"rtapi_app" not in command:
                    continue
                for task in (process / "task").iterdir():
                    os.sched_setscheduler(int(task.name), os.SCHED_FIFO, os.sched_param(BRIDGE_FIRST + (not ours)))

    def _log(self) -> str:
        logs = [self.folder / "linuxcnc_print.txt", self.folder / "linuxcnc.log"]  # what refuses an INI is in the first
        text = "\n".join(log.read_text(errors="replace") for log in logs if log.exists())
        lines = [line.strip() for line in text.splitlines() if line.strip()]
        return "; ".join(lines[-LOG_LINES:]) or "it said nothing"
