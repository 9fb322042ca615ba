"""A loop and a log that keep what they are told, and a certificate of this run by the system's openssl."""

from __future__ import annotations

import json
import subprocess
import threading
from types import SimpleNamespace

import numpy as np
import pytest

from armsight.control.guard import GuardState
from armsight.control.session.channels import LineChannels
from armsight.control.session.loop_host import LoopEvent
from armsight.control.session.service import Service
from armsight.control.setpoints import JointGoal
from armsight.control.status import RobotStatus
from armsight.drivers import RobotState
from armsight.drivers.remote import protocol as say
from armsight.errors import DeviceLost
from armsight.records import JointReading


@pytest.fixture(scope="session")
def certificate(tmp_path_factory):
    folder = tmp_path_factory.mktemp("certificate")
    cert, key = folder / "cert.pem", folder / "key.pem"
    subprocess.run(
        ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes",
         "-days", "2", "-keyout", key, "-out", cert, "-subj", "/CN=localhost",
         "-addext", "subjectAltName=DNS:localhost,IP:127.0.0.1"],
        check=True,
        capture_output=True,
    )  # fmt: skip
    return cert, key


class FakeHost:
    """A loop on a hand-moved clock that goes at once where it is told, and keeps what it was told."""

    def __init__(self, n: int = 2) -> None:
        joints = [say.JointDescription(name=f"j{i}", lower=-2.0, upper=2.0, max_speed=1.0) for i in range(1, n + 1)]
        self.description = say.RobotDescription(
            name="fake", driver="fake:0", n_joints=n, cycle_s=0.1, takes_poses=False, joints=joints
        )
        self.arm = None
        self.told: list[tuple] = []
        self.happened: list[LoopEvent] = []
        self.t_s, self.q, self.cycle = 100.0, np.zeros(n), 1
        self.guard, self.robot, self.dropped = "disabled", RobotState.READY, 0
        self.ended, self.lapsed = False, ""
        self.heard = threading.Event()
        self.line = LineChannels()

    def tick(self, cycles: int = 1) -> None:
        self.cycle += cycles
        self.t_s += cycles * 0.1

    def now_s(self) -> float:
        return self.t_s

    def status(self) -> RobotStatus:
        if self.ended:
            raise DeviceLost("the loop has ended")
        reading = JointReading(q=self.q, t_s=self.t_s - 0.01, sequence=self.cycle, source="fake")
        return RobotStatus(
            t_s=self.t_s, cycle=self.cycle, robot=self.robot, guard=GuardState(self.guard), reading=reading,
            q_sent=self.q, enabled=True, dropped=self.dropped, lapsed=self.lapsed,
        )  # fmt: skip

    enable_age_s = 0.25

    def grant(self, lease: int, key: str, person: str = "") -> None:
        self.line.grant.write(json.dumps([lease, key, person]).encode())

    def post(self, setpoint, *, age_s: float = 0.0) -> None:
        self._tell("post", setpoint)
        if isinstance(setpoint, JointGoal):
            self.q = setpoint.q

    def beat(self, *, enable: bool, age_s: float = 0.0, lease: int = 0, number: int | None = None) -> None:
        self._tell("beat", enable)

    def release(self, why: str, *, lease: int = 0) -> None:
        self._tell("release", why)
        self.heard.set()

    def stop(self, why: str) -> None:
        self._tell("stop", why)

    def reset(self) -> None:
        self._tell("reset")

    def lateness_p99_s(self) -> float:
        return 1e-5

    def records(self) -> list[LoopEvent]:
        events, self.happened = self.happened, []
        return events

    def _tell(self, *what) -> None:
        if self.ended and what[0] not in ("release", "stop"):
            raise DeviceLost("the loop has ended")
        self.told.append(what)


class KeptLog:
    """A log in memory."""

    def __init__(self) -> None:
        self.events: list[tuple[str, str]] = []
        self.commands: list[tuple[str, str, dict]] = []
        self.dropped, self.failed = 0, ""

    def event(self, t_s: float, level: str, message: str) -> None:
        self.events.append((level, message))

    def command(self, t_s: float, who: str, kind: str, values: dict) -> None:
        self.commands.append((who, kind, values))

    def joints(self, reading) -> None:
        pass


@pytest.fixture
def host():
    return FakeHost()


@pytest.fixture
def log():
    return KeptLog()


@pytest.fixture
def service(host, log):
    return Service(host, log)


@pytest.fixture(scope="session")
def fakes():
    """The loop and log in memory, for those who make a server of their own."""
    return SimpleNamespace(FakeHost=FakeHost, KeptLog=KeptLog)
