"""A simulated robot behind the Protocol of real ones, on an injected clock."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Sequence
from enum import StrEnum
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.clock import Clock
from armsight.drivers import RobotState, Sent
from armsight.errors import DeviceFailed, DeviceLost, Inconsistent, StaleData, UsageError
from armsight.records import JointReading
from armsight_sim.arms import Drive, FlangeLimits, Servo, SimArm
from armsight_sim.motions import JointMotion, smooth_step

STALE_CYCLES = 3.5
"""A reading older than so many cycles is stale: two packets in a row may be late, a third is a fault."""

REST = 1e-6
"""Joints nearer to their command than this (rad or m) are at rest."""

RUN_UP_S = 2.0
"""Time in which a robot that stands at home takes up the motion of its own program."""

MEMORY = 15_000
"""Steps of the motion remembered: a minute, and 1 MB."""


class RobotFault(StrEnum):
    """What can be made to go wrong."""

    LINK_LOST = "link_lost"
    FROZEN = "frozen"
    LATE_CYCLE = "late_cycle"
    JUMP = "jump"


class SimRobot:
    """An arm with true and nominal geometry, encoders, lag, speed limits and a controller's cycle.

    nominal is what the controller computes poses with; true is where the flange really is. Every call first lets the
    motors move up to the clock's time; a command is taken at the next beginning of a cycle.
    """

    takes_poses: bool

    def __init__(
        self,
        name: str,
        *,
        true: SimArm,
        nominal: SimArm,
        drive: Drive,
        home: ArrayLike,
        clock: Clock,
        limits: FlangeLimits | None = None,
    ) -> None:
        self.name = name
        self.true = true
        self.nominal = nominal
        self.takes_poses = nominal.n == 6
        self._drive = drive
        self._clock = clock
        self._limits = limits or FlangeLimits()
        self._origin_s = clock.now_s()
        self._servo = Servo(drive, home, keep=MEMORY)
        self._open = False
        self._stopped = False
        self._faults: set[RobotFault] = set()
        self._frozen_at_s = 0.0
        self._jump: Array = np.zeros(nominal.n)
        self._sent = 0
        self._cycle = -1
        self._from: Array = self._servo.goal
        self._lock = threading.RLock()
        self._program: JointMotion | None = None
        self._start: Array = self._servo.goal
        self._begun_s = 0.0
        self._played = 0
        self._zero_jumps: tuple[tuple[float, float, Array], ...] = ()
        self._followed: Callable[[float], Array] | None = None

    def follow(self, joints: Callable[[float], Array]) -> None:
        """Stand, for cameras, where joints (t_s of the clock) says: the motors that move it run in another process."""
        self._followed = joints

    def play(self, motion: JointMotion) -> None:
        """Have the controller's own program go along a motion from opening on, until it is stopped.

        From home it takes the motion up within RUN_UP_S.
        """
        self._program = motion

    def jump_zeros(self, jumps: Sequence[tuple[float, float, Array]]) -> None:
        """Have encoders jump: from and to which time since opening in s, and by how much, (n,) in rad or m."""
        self._zero_jumps = tuple(jumps)

    @property
    def n_joints(self) -> int:
        """How many joints it has."""
        return self.nominal.n

    @property
    def cycle_s(self) -> float:
        """The controller's cycle in s."""
        return self._drive.cycle_s

    @property
    def state(self) -> RobotState:
        """What it can do just now."""
        if not self._open:
            return RobotState.CLOSED
        if RobotFault.LINK_LOST in self._faults:
            return RobotState.LOST
        if self._stopped:
            return RobotState.STOPPED
        rest = self._servo.goal - self._servo.at(self._now_s())[0]
        return RobotState.MOVING if float(np.abs(rest).max()) > REST else RobotState.READY

    def __enter__(self) -> Self:
        self._begun_s = self._now_s()
        self._open, self._stopped, self._played = True, False, 0
        self._from = self._start = self._servo.goal
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()
        self._open = False

    def arm_mapping(self) -> dict[str, object]:
        """Return the arm that its controller computes with, without a tool, as arm.yaml has it."""
        return {
            "format": "armsight/arm",
            "name": self.name,
            **self.nominal.mapping(RigidTransform.identity()),
        }

    def read(self) -> JointReading:
        """Return the reading of the newest cycle. Raises DeviceFailed where closed, DeviceLost, StaleData."""
        self._check_link("read")
        now_s = self._now_s()
        cycle = self._cycle_at(self._frozen_at_s if RobotFault.FROZEN in self._faults else now_s)
        t_s = cycle * self.cycle_s
        if now_s - t_s > STALE_CYCLES * self.cycle_s:
            raise StaleData(
                f"{self.name}: the newest reading is {now_s - t_s:.3f} s old",
                consequence="Where the arm is now is not known",
                cure="Stop the robot and look at its controller",
            )
        with self._lock:
            q = self._servo.read(t_s)[0] + self._jump
        for start_s, end_s, by in self._zero_jumps:
            q = q + by * float(start_s <= t_s - self._begun_s < end_s)
        return JointReading(q=q, t_s=self._origin_s + t_s, sequence=cycle, source=self.name)

    def step_joints(self, step: Array) -> Sent:
        """Move on by step (n,) in rad or m as far as range, speed and cycle allow; return what was sent."""
        self._check_motion()
        values = np.asarray(step, dtype=float)
        if values.shape != (self.n_joints,):
            raise UsageError(
                f"{self.name} has {self.n_joints} joints, but the step has shape {values.shape}",
                consequence="Nothing was sent",
                cure=f"Give {self.n_joints} values",
            )
        if not np.isfinite(values).all():
            raise Inconsistent(f"{self.name}: a step is not finite", consequence="Nothing was sent")
        return self._send(self._servo.goal + values, ())

    def move_pose(self, T_base_flange: RigidTransform) -> Sent:
        """Move the flange towards a pose by the controller's geometry, as far as one cycle allows."""
        self._check_motion()
        if not self.takes_poses:
            raise UsageError(
                f"{self.name} has {self.n_joints} joints and takes no poses",
                consequence="Nothing was sent",
                cure="Send joint steps",
            )
        if not np.isfinite(T_base_flange.as_matrix()).all():
            raise Inconsistent(f"{self.name}: a pose is not finite", consequence="Nothing was sent")
        self._begin_cycle()
        here = self.nominal.frames(self._from)[-1]
        goal, limited = self._limits.cut(here, T_base_flange.as_matrix(), self.cycle_s)
        return self._send(self.nominal.reach(goal, self._from), limited)

    def stop(self) -> None:
        """Come to rest where the joints are; legal always."""
        self._now_s()
        with self._lock:
            self._servo.halt()
            self._stopped, self._program = True, None

    def reset(self) -> None:
        """Take commands again from where it stands."""
        self._check_link("reset")
        self._from = self._servo.goal
        self._stopped = False

    def fault(self, fault: RobotFault | str, *, on: bool = True, by: ArrayLike = 0.0) -> None:
        """Make something go wrong, or right again: the link lost, readings frozen or jumping by `by`, cycles late.

        A robot whose link is lost comes to rest by itself.
        """
        kind = RobotFault(fault)
        now_s = self._now_s()
        if kind is RobotFault.JUMP:
            self._jump = np.broadcast_to(np.asarray(by, dtype=float), (self.n_joints,)) * float(on)
        if kind is RobotFault.FROZEN and kind not in self._faults:
            self._frozen_at_s = now_s
        if kind is RobotFault.LINK_LOST and on:
            self._servo.halt()
        (self._faults.add if on else self._faults.discard)(kind)

    def true_flange(self, t_s: float) -> RigidTransform:
        """Return where the flange really was at time t_s of the clock, T_base_flange; now at the latest."""
        return self.true.flange(self.true_joints(t_s))

    def true_joints(self, t_s: float) -> Array:
        """Return where the joints (n,) really were at time t_s of the clock; now at the latest."""
        if self._followed is not None:
            return self._followed(t_s)
        self._now_s()
        with self._lock:
            return np.asarray(self._servo.at(t_s - self._origin_s)[0])

    def _now_s(self) -> float:
        with self._lock:  # cameras and whoever reads the joints may be in two threads
            now_s = self._clock.now_s() - self._origin_s
            self._play_until(now_s)
            self._servo.advance(now_s)
            return now_s

    def _play_until(self, now_s: float) -> None:
        """Give the commands of the controller's own program up to now, one a cycle."""
        if self._program is None or not self._open or self._stopped or RobotFault.LINK_LOST in self._faults:
            return
        wanted = math.floor((now_s - self._begun_s) / self.cycle_s) + 1
        if wanted <= self._played:
            return
        t_s = self.cycle_s * np.arange(self._played, wanted, dtype=np.float64)
        share = np.asarray(smooth_step(t_s / RUN_UP_S))[:, None]
        for moment, q in zip(t_s, self._start + share * (self._program(t_s) - self._start), strict=True):
            self._servo.command(self._begun_s + moment, q)
        self._played = wanted

    def _cycle_at(self, t_s: float) -> int:
        return math.floor(t_s / self.cycle_s + 1e-9)

    def _check_link(self, what: str) -> None:
        if not self._open:
            raise DeviceFailed(f"{self.name} is not open", consequence=f"It cannot {what}", cure="Open it first")
        if RobotFault.LINK_LOST in self._faults:
            raise DeviceLost(
                f"the link to {self.name} is lost",
                consequence="The robot has stopped by itself, and where it is is not known",
                cure="Check the cable and the controller, and open it again",
            )

    def _check_motion(self) -> None:
        self._check_link("move")
        if self._program is not None:
            raise DeviceFailed(
                f"{self.name} goes by its own program", consequence="Nothing was sent", cure="Stop and reset it first"
            )
        if self._stopped:
            raise DeviceFailed(f"{self.name} is stopped", consequence="Nothing was sent", cure="Reset it first")

    def _begin_cycle(self) -> None:
        """Note where this cycle's commands begin: several within one cycle replace each other, they do not add up."""
        cycle = self._cycle_at(self._now_s())
        if cycle != self._cycle:
            self._cycle = cycle
            self._from = self._servo.goal

    def _send(self, goal: Array, limited: tuple[str, ...]) -> Sent:
        """Send joint values (n,), cut to what one cycle allows."""
        self._begin_cycle()
        joints = self.nominal.joints
        way = goal - self._from
        longest = self._drive.max_speed * self.cycle_s
        share = float(np.min(longest / np.maximum(np.abs(way), 1e-300), initial=1.0))
        slow = [f"speed of {j.name}" for j, w, m in zip(joints, way, longest, strict=True) if abs(w) > m * (1 + 1e-9)]
        asked = self._from + share * way  # all joints alike, so that the direction of the motion stays
        low = np.array([joint.lower for joint in joints])
        high = np.array([joint.upper for joint in joints])
        q = np.clip(asked, low, high)
        ends = [f"range of {j.name}" for j, a, b in zip(joints, asked, q, strict=True) if a != b]
        late = 2 if RobotFault.LATE_CYCLE in self._faults else 1
        self._servo.command((self._cycle + late) * self.cycle_s, q)
        self._sent += 1
        return Sent(
            q=q,
            t_s=self._origin_s + self._now_s(),
            sequence=self._sent - 1,
            pose=self.nominal.flange(q),
            limited=(*limited, *slow, *ends),
        )
