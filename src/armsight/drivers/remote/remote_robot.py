"""A robot behind a robot server, as the Robot that every other driver is."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.clock import Clock, SystemClock
from armsight.defaults import STALE_CYCLES
from armsight.drivers.protocols import RobotState, Sent
from armsight.drivers.remote import protocol as say
from armsight.drivers.remote.link import Heart, Link
from armsight.drivers.remote.wire import ServerAddress
from armsight.errors import ArmsightError, DeviceFailed, DeviceLost, Inconsistent, StaleData, UsageError
from armsight.geometry import pose_from_quat, xyz_quat
from armsight.records import JointReading

STALE_S = 0.1
"""A reading older than either is stale, its way through the network included: the larger counts."""

OFFSETS = 64
"""Answers from which the offset between the clocks is taken: that of the quickest, which says it best."""


class RemoteRobot:
    """The robot of an `armsight serve`: device is ws://HOST:PORT or wss://HOST:PORT.

    Settings: token (else the environment variable ARMSIGHT_TOKEN), ca_file. Opening it makes this program the driver;
    closing it, or falling silent for a second, holds the robot. A stop of somebody else stays until reset() is called.
    Times of readings are on clock: the server's, moved by the offset that the quickest answer shows; half that answer's
    time is how wrong they may be.
    """

    def __init__(self, device: str, *, settings: Mapping[str, Any] | None = None, clock: Clock | None = None) -> None:
        given = dict(settings or {})
        token, ca_file = given.pop("token", None), given.pop("ca_file", None)
        if given:
            raise UsageError(
                f"{device} takes no setting {', '.join(map(str, given))}", cure="It takes token and ca_file"
            )
        self._address = ServerAddress(url=device, token=token, ca_file=None if ca_file is None else Path(ca_file))
        self._clock = clock or SystemClock()
        self._link: Link | None = None
        self._heart: Heart | None = None
        self._known: say.RobotDescription | None = None
        self._instance = ""
        self._offsets: deque[tuple[float, float]] = deque(maxlen=OFFSETS)

    @property
    def name(self) -> str:
        """The robot's name, at its server's address."""
        return self._address.url

    @property
    def n_joints(self) -> int:
        """How many joints it has; asks the server where that is not known yet."""
        return self._description().n_joints

    @property
    def cycle_s(self) -> float:
        """The controller's cycle in s; asks the server where that is not known yet."""
        return self._description().cycle_s

    @property
    def takes_poses(self) -> bool:
        """Whether move_pose is possible; asks the server where that is not known yet."""
        return self._description().takes_poses

    @property
    def state(self) -> RobotState:
        """What it can do just now."""
        if self._link is None:
            return RobotState.CLOSED
        try:
            return RobotState(self._ask_state().robot)
        except ArmsightError:
            return RobotState.LOST

    def __enter__(self) -> Self:
        link = Link(self._address, say.DRIVE_PATH)
        welcome = link.open()
        if welcome.instance != self._instance:
            self._offsets.clear()  # a server started anew may have a clock started anew
        self._known, self._instance, self._link = welcome.robot, welcome.instance, link
        self._heart = Heart(link, time_s=self._clock.now_s)
        try:
            self._heart.beat(enable=True)
        except ArmsightError:
            self._close()
            raise
        self._heart.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._close()

    def heartbeat(self) -> None:
        """Tell the server now that this program lives, besides what its thread tells. Raises DeviceLost."""
        self._alive("be enabled")[1].beat()

    def read(self) -> JointReading:
        """Return the newest reading, on this program's clock. Raises DeviceFailed, DeviceLost, StaleData."""
        self._alive("be read")
        asked_s = self._clock.now_s()
        state = self._ask_state()
        passed_s = self._clock.now_s() - asked_s
        if RobotState(state.robot) is RobotState.LOST:
            raise DeviceLost(
                f"the server lost the link to {self.name}", consequence="Where the arm is is not known", cure=state.why
            )
        reading, limit_s = state.reading, max(STALE_S, STALE_CYCLES * self.cycle_s)
        age_s = np.inf if reading is None else reading.age_s + passed_s
        if reading is None or age_s > limit_s:
            raise StaleData(
                f"{self.name}: the newest reading is {age_s:.3f} s old",
                consequence="Where the arm is now is not known",
                cure="Look at the server and the network",
            )
        self._offsets.append((passed_s, asked_s + 0.5 * passed_s - state.t_s))
        return JointReading(
            q=np.array(reading.q),
            t_s=reading.t_s + min(self._offsets)[1],
            sequence=reading.sequence,
            source=self.name,
        )

    def step_joints(self, step: Array) -> Sent:
        """Move on by step (n,) in rad or m as far as the server's limits allow; return where that leads."""
        self._alive("move")
        values = np.asarray(step, dtype=float)
        if values.shape != (self.n_joints,):
            raise UsageError(
                f"{self.name} has {self.n_joints} joints, but the step has shape {values.shape}",
                cure=f"Give {self.n_joints} values",
            )
        if not np.isfinite(values).all():
            raise Inconsistent(f"{self.name}: a step is not finite", consequence="Nothing was sent")
        return self._command(say.JointStepMessage, step=values.tolist())

    def move_pose(self, T_base_flange: RigidTransform) -> Sent:
        """Move the flange towards a pose by the server's model of the arm; return where that leads."""
        self._alive("move")
        if not self.takes_poses:
            raise UsageError(f"{self.name} takes no poses", cure="Send joint steps")
        if not np.isfinite(T_base_flange.as_matrix()).all():
            raise Inconsistent(f"{self.name}: a pose is not finite", consequence="Nothing was sent")
        xyz, quat = xyz_quat(T_base_flange)
        pose = say.PoseMessage(xyz_m=xyz.tolist(), quat_xyzw=quat.tolist())
        return self._command(say.FlangePoseMessage, T_base_flange=pose)

    def stop(self) -> None:
        """Come to rest and take no commands until reset; legal always. Without a connection the server holds it."""
        link = self._link
        if link is not None:
            try:
                link.stop()
            except ArmsightError:
                link.cut()  # the server holds a robot whose driver is gone

    def reset(self) -> None:
        """Take commands again from where it stands."""
        link, heart = self._alive("be reset")
        link.ask(say.ResetMessage)
        heart.beat(enable=False)  # after a reset the server wants the enable anew
        heart.beat(enable=True)

    def cut(self) -> None:
        """Cut the connection as a pulled cable does, for tests of what happens then."""
        if self._link is not None:
            self._link.cut()

    def _command(self, make: Any, **fields: Any) -> Sent:
        link, heart = self._alive("move")
        heart.check()
        answer = link.ask(make, **fields)
        if not isinstance(answer, say.Accepted) or answer.q is None:
            raise DeviceFailed(f"{self.name} did not say where it goes", consequence="It is not known what it was sent")
        pose = answer.T_base_flange
        return Sent(
            q=np.array(answer.q),
            t_s=self._clock.now_s(),
            sequence=answer.reply_to,
            pose=None if pose is None else pose_from_quat(pose.xyz_m, pose.quat_xyzw),
            limited=tuple(answer.limited),
        )

    def _ask_state(self) -> say.StateMessage:
        link, heart = self._alive("be read")
        heart.touch()
        answer = link.ask(say.ReadMessage)
        if not isinstance(answer, say.StateMessage):
            raise DeviceFailed(f"{self.name} did not tell its state", consequence="Where the arm is is not known")
        return answer

    def _alive(self, what: str) -> tuple[Link, Heart]:
        if self._link is None or self._heart is None:
            raise DeviceFailed(f"{self.name} is not open", consequence=f"It cannot {what}", cure="Open it first")
        return self._link, self._heart

    def _description(self) -> say.RobotDescription:
        if self._known is None:
            link = Link(self._address, say.STREAM_PATH)
            try:
                self._known = link.open().robot
            finally:
                link.close()
        return self._known

    def _close(self) -> None:
        link, heart, self._link, self._heart = self._link, self._heart, None, None
        if heart is not None:
            heart.end()
        if link is not None:
            link.close()
