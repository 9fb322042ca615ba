"""A robot behind `armsight serve`: watch it, stop it, drive it; and emulated controllers to try things on."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from types import NoneType, TracebackType
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike

from armsight.api.results import Result, Row
from armsight.arrays import Array
from armsight.drivers.remote import Heart, Link, ServerAddress
from armsight.drivers.remote import protocol as say
from armsight.errors import ArmsightError, DeviceFailed
from armsight.ops.checks import speaks_python
from armsight.ops.commands import in_python
from armsight.ops.given import ArmLike, Given
from armsight.ops.requests.motion import TwinJob
from armsight.ops.robot.twin import twin_beside
from armsight.records import real_array, require_kind
from armsight.units import MS

POLL_S = 0.02
"""How often a motion that is waited for is looked at."""

ARRIVED = 1e-6
"""A robot told to stand this near (rad or m) to its goal has been told to stand there."""

HELD_S = 1.0
"""A guard that holds for so long has more than a late cycle as its reason; after that one it goes on by itself."""

BEGUN_CYCLES = 3
"""Cycles after which a guard that does not run says that it will not."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class RemoteState(Result):
    """A served robot at one moment. q, q_sent (n,): its newest reading and where it was told to go, in rad or m.

    age_s: how old the reading is; inf without one, and q is then empty. robot, guard: their states; why: of the guard.
    driver: who drives, empty where nobody does. late, missed: cycles of the server's loop.
    """

    q: Array
    age_s: float
    q_sent: Array
    robot: str
    guard: str
    why: str
    enabled: bool
    driver: str
    cycle: int
    late: int
    missed: int
    lateness_p99_s: float

    @property
    def title(self) -> str:
        """What it is."""
        return f"robot {self.robot}, guard {self.guard}"

    def rows(self) -> Sequence[Row]:
        """Return what it says, as people read it."""
        return [
            ("joints", f"{np.round(self.q, 4).tolist()}, {self.age_s / MS:.1f} ms old"),
            ("told to go to", f"{np.round(self.q_sent, 4).tolist()}"),
            ("why", self.why),
            ("enabled", "yes" if self.enabled else "no"),
            ("driver", self.driver or "nobody"),
            ("cycles", f"{self.cycle}, late {self.late}, missed {self.missed}"),
        ]

    def to_dict(self) -> dict[str, Any]:
        """Return plain numbers, lists and texts in SI units."""
        values = {name: getattr(self, name) for name in self.__dataclass_fields__}
        return {key: value.tolist() if isinstance(value, np.ndarray) else value for key, value in values.items()}


class RobotConnection:
    """A connection to a robot server that watches. Use it as a context manager."""

    def __init__(self, address: ServerAddress) -> None:
        self._address = address
        self._link = Link(address, say.STREAM_PATH)
        self._link.open()

    @property
    def robot(self) -> say.RobotDescription:
        """What robot it is: name, joints with their ranges and speeds, cycle_s."""
        return self._link.welcome.robot

    @property
    def instance(self) -> str:
        """Of this run of the server: another one means that it was started anew."""
        return self._link.welcome.instance

    def state(self) -> RemoteState:
        """Return the state now. Raises DeviceLost without a connection."""
        return _state(self._link)

    def events(self) -> list[str]:
        """Return what happened since this was last asked, in words."""
        return [f"{event.level}: {event.message}" for event in self._link.take_events()]

    def stop(self) -> None:
        """Bring the robot to rest until a driver resets it. Raises DeviceLost without a connection."""
        self._link.stop()

    def drive(self) -> RobotDriver:
        """Return the right to drive, to be used as a context manager. Raises DeviceFailed where another one has it."""
        return RobotDriver(self._address)

    def close(self) -> None:
        """End the connection."""
        self._link.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class RobotDriver:
    """The right to drive a served robot while the block runs; leaving it holds the robot.

    Motion needs enable(), and a program that lives: where it calls nothing for a second, or is gone, the server holds
    the robot; where it stood still, the enable is over and has to be given anew by enable(). Every command raises
    DeviceFailed where the robot is stopped, not enabled or lost, Inconsistent or UsageError for what it cannot do, and
    DeviceLost without a connection.
    """

    def __init__(self, address: ServerAddress) -> None:
        self._link = Link(address, say.DRIVE_PATH)
        self._heart = Heart(self._link)

    def __enter__(self) -> Self:
        self._link.open()
        self._heart.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._heart.end()
        self._link.close()

    def enable(self) -> None:
        """Allow motion, as the operator's deadman's switch does; also anew, where the enable ended by itself."""
        if not self.state().enabled:
            self._heart.beat(enable=False)
        self._heart.beat(enable=True)

    def disable(self) -> None:
        """Allow no motion: the robot comes to rest."""
        self._heart.beat(enable=False)

    def move_joints(self, q: ArrayLike, *, wait: bool = True, timeout_s: float = 60.0) -> None:
        """Go to joint values q (n,) in rad or m as fast as the limits allow; wait until it is there.

        Raises DeviceFailed where the guard does not go there, with its reason, and after timeout_s.
        """
        goal = real_array("q", q)
        begun = self._move(say.JointGoalMessage, q=goal.tolist())
        ran_s = time.monotonic()
        until_s = ran_s + timeout_s
        while wait:
            state = self.state()
            if state.guard == "running":
                ran_s = time.monotonic()
            held = state.guard == "holding" and time.monotonic() - ran_s < HELD_S
            if state.guard != "running" and not held and state.cycle > begun.cycle + BEGUN_CYCLES:
                raise DeviceFailed(
                    f"the robot does not go there: {state.guard}" + (f", {state.why}" if state.why else ""),
                    consequence="It rests on the way",
                )
            if state.robot == "ready" and np.abs(state.q_sent - goal).max() <= ARRIVED:
                return
            if time.monotonic() > until_s:
                self.hold()
                raise DeviceFailed(f"the robot was not there within {timeout_s:g} s", consequence="It is held")
            time.sleep(POLL_S)

    def jog(self, qd: ArrayLike) -> None:
        """Move with joint velocities qd (n,) in rad/s or m/s; to be called again within the server's setpoint_s."""
        self._move(say.JointVelocityMessage, qd=real_array("qd", qd).tolist())

    def twist(self, velocity_m_s: ArrayLike, angular_rad_s: ArrayLike = (0.0, 0.0, 0.0)) -> None:
        """Move the tool with a velocity (3,) and an angular velocity (3,) in base axes; to be called again as jog."""
        v = real_array("velocity_m_s", velocity_m_s)
        w = real_array("angular_rad_s", angular_rad_s)
        self._move(say.ToolTwistMessage, velocity_m_s=v.tolist(), angular_rad_s=w.tolist())

    def hold(self) -> None:
        """Come to rest; commands are taken again at once."""
        self._do(say.HoldMessage)

    def stop(self) -> None:
        """Come to rest until reset."""
        self._link.stop()

    def reset(self) -> None:
        """Take commands again after a stop; enable() must be called again before motion."""
        self._do(say.ResetMessage)
        self.disable()

    def state(self) -> RemoteState:
        """Return the state now."""
        self._heart.touch()
        return _state(self._link)

    def _move(self, make: Any, **fields: Any) -> say.Accepted:
        self._heart.check()
        return _taken(self._link, make, **fields)

    def _do(self, make: Any, **fields: Any) -> say.Accepted:
        self._heart.touch()
        return _taken(self._link, make, **fields)


def connect(url: str, *, token: str | None = None, ca_file: str | PathLike[str] | None = None) -> RobotConnection:
    """Connect to a robot server and return the connection.

    url: ws://HOST:PORT, or wss://HOST:PORT with TLS. token: of the server's token file; else the environment variable
    ARMSIGHT_TOKEN. ca_file: a PEM file with the server's certificate where no authority known to the system signed it.
    Raises UsageError for another url, DeviceNotFound where no server answers, DeviceFailed where it refuses.
    """
    require_kind("url", url, str, cure="Give ws://HOST:PORT")
    require_kind("token", token, str, NoneType)
    return RobotConnection(ServerAddress(url=url, token=token, ca_file=None if ca_file is None else _pem(ca_file)))


def _pem(ca_file: str | PathLike[str]) -> Path:
    require_kind("ca_file", ca_file, str, PathLike, cure="Give a PEM file's path")
    return Path(ca_file)


def _taken(link: Link, make: Any, **fields: Any) -> say.Accepted:
    """Send a command and return the server's word that it was taken."""
    answer = link.ask(make, **fields)
    if not isinstance(answer, say.Accepted):
        raise DeviceFailed("the server did not say that it took the command", consequence="What it did is not known")
    return answer


def _state(link: Link) -> RemoteState:
    now = link.ask(say.ReadMessage)
    if not isinstance(now, say.StateMessage):
        raise DeviceFailed("the server did not tell its state", consequence="Where the arm is is not known")
    reading = now.reading
    return RemoteState(
        q=np.array([] if reading is None else reading.q, dtype=float),
        age_s=np.inf if reading is None else reading.age_s,
        q_sent=np.array(now.q_sent),
        robot=now.robot,
        guard=now.guard,
        why=now.why,
        enabled=now.enabled,
        driver="" if now.driver is None else now.driver.who,
        cycle=now.cycle,
        late=now.late,
        missed=now.missed,
        lateness_p99_s=now.lateness_p99_s,
    )


@speaks_python(TwinJob)
@contextmanager
def twin(
    name: Literal["alter", "rsi", "egm", "rtde"],
    *,
    port: str | None = None,
    connect: str | None = None,
    arm: ArmLike | None = None,
    cycle_s: float | None = None,
) -> Iterator[str]:
    """Run an emulated controller in a process of its own while the block runs; gives what opens it, DRIVER:DEVICE.

    port: where it listens. connect: HOST:PORT where the driver listens, for rsi and egm. arm: which it has. cycle_s: of
    the controller. Raises UsageError, DeviceNotFound with the twins there are, DeviceFailed.

    Examples
    --------
    >>> with armsight.twin("alter") as robot:
    ...     robot.partition(":")[0]
    'alter'
    """
    for text, value in (("name", name), ("port", port or ""), ("connect", connect or "")):
        require_kind(text, value, str)
    with Given() as given:
        model = None if arm is None else given.arm("arm", arm)
        try:
            with twin_beside(name, port=port, connect=connect, arm=model, cycle_s=cycle_s) as address:
                yield address
        except ArmsightError as error:
            in_python(error)
            raise
