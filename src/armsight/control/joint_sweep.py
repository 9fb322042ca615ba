"""A robot led before two cameras: joint by joint while they watch its beacon, or from pose to pose, where it rests."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from armsight.arrays import Array
from armsight.calibrate.identify import Sweeps
from armsight.clock import Clock
from armsight.defaults import SWEEP_SPEED
from armsight.drivers import PROVING, Robot, RobotState, RobotTraits, Sent
from armsight.errors import Cancelled, DeviceFailed, DeviceLost, Inconsistent, NotEnoughData
from armsight.optics import SIDES
from armsight.records import JointReading, PoseStatus, Progress, TargetPose

LOOK_S = 0.2
"""Time between two looks at the beacon while a joint moves: at a tenth of its travel a second 2 % of it, blindly."""
REST_FRAMES = 3
"""Frames in a row in which joints and beacon keep still."""
REST_PX = 0.5
"""A beacon that moves less from frame to frame rests: three times a poor centre's noise."""
REST_STEP = 2e-4
"""Joint readings (rad, m) that change less rest: an encoder may flicker by a step."""
HELD_BACK_S = 0.2
"""By how much a frame may be older than its stamp: cameras' drivers stamp at arrival and buffer up to some frames."""
REST_TIMEOUT_S = 10.0
"""A joint told nothing new for so long that still moves is not under control."""
FOLLOW_SHARE = 0.02
"""Share of its travel by which a joint at rest may miss where it was sent: play and gravity, not a fault."""
STUCK = 20
"""Commands in a row that go nowhere."""
FIRST_LOOKS = 8
"""Pairs looked at before anything moves: old frames in the cameras' queues are gone then, and all code is compiled."""
SLACK = 1e-9
"""Joint values (rad, m) so far beyond a limit are at it: rounding."""
THERE = 1e-6
"""Joint readings (rad, m) so near to where the track has them are there."""
MOST_LOST = 30
"""Looks in a row at a stop without a whole pose that mean the target is not seen there."""
SWEPT = ("The robot was stopped", "The sweeps are not complete")
VISITED = ("The robot is held", "The run ends there")
"""What is told where a person ends the motion, and where the robot does."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Observation:
    """The beacon in a moment: uv_px (v, 2), NaN where a camera does not see it, std_px of each, xyz_m (3,), or why not;
    taken_s: the earliest, our clock."""

    taken_s: float
    uv_px: Array | None = None
    xyz_m: Array | None = None
    std_px: float | None = None
    why: str = ""


class BeaconObserver(Protocol):
    """Sees where the beacon is, now."""

    def observe(self, while_: str) -> Observation:
        """Return what is seen next; while_: what the robot does, for messages.

        Raises NotEnoughData where the beacon has been lost for several frames in a row, DeviceLost.
        """


@dataclass(frozen=True, slots=True, kw_only=True)
class Pace:
    """speed: share of a joint's travel a second. frames_per_reading: pairs averaged for a reading."""

    speed: float = SWEEP_SPEED
    frames_per_reading: int = 4


class Sweeper:
    """Moves an open robot one joint at a time within limits (n, 2), and reads joints and beacon where it rests.

    It never asks for a joint value outside the limits, and watches the beacon all the while. Nothing here stops the
    robot: whoever catches an error does.
    """

    def __init__(
        self,
        robot: Robot,
        observer: BeaconObserver,
        limits: Array,
        clock: Clock,
        progress: Progress,
        pace: Pace,
        cameras: Sequence[str] = SIDES,
    ) -> None:
        """cameras: the rig's, by which the observer gives pixels."""
        self._cameras = tuple(cameras)
        self._robot = robot
        self._observer = observer
        self.limits = limits
        self._clock = clock
        self._progress = progress
        self._pace = pace
        self._flicker = max(REST_STEP, 1.5 * RobotTraits.of(robot).reading_step)
        self._at: Array | None = None
        self._joint: list[int] = []
        self._rows: list[tuple[Array, Array, Array, float | None]] = []
        self._total = 0

    @property
    def travel(self) -> Array:
        """How far each joint may go (n,), rad or m."""
        return np.asarray(self.limits[:, 1] - self.limits[:, 0])

    @property
    def standing(self) -> Array:
        """Where the robot was last sent (n,)."""
        return self._sent()

    @property
    def sweeps(self) -> Sweeps | None:
        """What was read since the last clear; None where nothing was."""
        if not self._rows:
            return None
        *columns, std = zip(*self._rows, strict=True)
        q, uv, xyz = (np.array(values) for values in columns)
        std_px = None if None in std else np.array(std, dtype=np.float64)
        return Sweeps(
            joint=np.array(self._joint, dtype=np.intp), q=q, xyz_m=xyz, uv_px=uv, std_px=std_px, cameras=self._cameras
        )

    def begin(self) -> None:
        """See the beacon before anything moves. Raises NotEnoughData where it is not there, DeviceLost."""
        for _ in range(FIRST_LOOKS):
            self._observer.observe("before anything moved")

    def clear(self, expected: int) -> None:
        """Forget what was read; so many readings are to come."""
        self._joint, self._rows, self._total = [], [], expected

    def sweep(self, joint: int, q: Array) -> None:
        """Take a reading at every pose of q (m, n); they differ in one joint, as the robot's own from the first."""
        for pose in q:
            self.move(pose)
            self._rest(joint)
            self._read(joint)
            self._progress.update(len(self._rows), self._total, f"joint {joint + 1}")

    def move(self, goal: Array) -> None:
        """Move the one joint in which goal (n,) differs from where the robot was last sent.

        Raises Inconsistent for a goal beyond the limits or with two joints, DeviceFailed, NotEnoughData, Cancelled.
        """
        self._check_goal(goal)
        at = self._sent()
        joint = int(np.argmax(np.abs(goal - at)))
        longest = self._pace.speed * self.travel[joint] * self._robot.cycle_s
        stuck, looked_s = 0, self._clock.now_s()
        while abs(goal[joint] - at[joint]) > SLACK:
            _check_going(self._robot, self._progress, f"while joint {joint + 1} moved", *SWEPT)
            step = np.zeros(len(at))
            step[joint] = np.clip(goal[joint] - at[joint], -longest, longest)
            sent = self._robot.step_joints(step)
            stands = abs(sent.q[joint] - at[joint]) < 1e-3 * abs(step[joint]) and PROVING not in sent.limited
            stuck = stuck + 1 if stands else 0
            if stuck >= STUCK:
                raise DeviceFailed(
                    f"joint {joint + 1} does not go from {at[joint]:.4g} to {goal[joint]:.4g}{_limited_by(sent)}",
                    consequence="The robot was stopped",
                    cure="Give limits inside the robot's own",
                )
            at = self._at = sent.q
            self._clock.sleep_until(self._clock.now_s() + self._robot.cycle_s)
            if self._clock.now_s() - looked_s >= LOOK_S:
                looked_s = self._clock.now_s()
                while self._observer.observe(f"while joint {joint + 1} moved").uv_px is None:
                    continue  # told nothing, the robot waits where it is until the beacon is seen again, or lost

    def _sent(self) -> Array:
        if self._at is None:
            self._at = self._robot.step_joints(np.zeros(self._robot.n_joints)).q
        return self._at

    def _check_goal(self, goal: Array) -> None:
        at = self._sent()
        beyond = np.flatnonzero((goal < self.limits[:, 0] - SLACK) | (goal > self.limits[:, 1] + SLACK))
        if len(beyond):
            j = int(beyond[0])
            raise Inconsistent(
                f"joint {j + 1} would go to {goal[j]:.4g}, its limits are {self.limits[j, 0]:g} to "
                f"{self.limits[j, 1]:g}",
                consequence="It was not sent there",
                cure="Give other limits or another plan",
            )
        if (np.abs(goal - at) > SLACK).sum() > 1:
            raise Inconsistent("more than one joint would move at once", consequence="Nothing was sent")

    def _rest(self, joint: int) -> None:
        """Return when joints and beacon keep still. Raises DeviceFailed where they do not, or stand elsewhere."""
        arrived_s = self._clock.now_s()
        when = f"while joint {joint + 1} came to rest"
        still, before, seen = 0, self._robot.read(), self._observer.observe(when)
        while still < REST_FRAMES:
            _check_going(self._robot, self._progress, when, *SWEPT)
            if self._clock.now_s() - arrived_s > REST_TIMEOUT_S:
                raise DeviceFailed(
                    f"joint {joint + 1} did not come to rest in {REST_TIMEOUT_S:g} s",
                    consequence="It was stopped",
                    cure="Look for vibration, a slipping brake, or a camera that shakes",
                )
            look, reading = self._observer.observe(when), self._robot.read()
            fresh = look.taken_s >= arrived_s + HELD_BACK_S
            same = _same(before, reading, seen, look, self._flicker)
            still = still + 1 if fresh and same else 0
            before, seen = reading, look
        self._check_start(before.q)

    def _check_start(self, q: Array) -> None:
        off = np.abs(q - self._sent())
        j = int(np.argmax(off / self.travel))
        if off[j] > FOLLOW_SHARE * self.travel[j]:
            raise DeviceFailed(
                f"joint {j + 1} was sent to {self._sent()[j]:.4g} and stands at {q[j]:.4g}",
                consequence="The robot was stopped",
                cure="Look for an obstacle, a brake, or a broken encoder",
            )

    def _read(self, joint: int) -> None:
        looks: list[Observation] = []
        readings: list[Array] = []
        while len(looks) < self._pace.frames_per_reading:
            _check_going(self._robot, self._progress, f"while joint {joint + 1} was read", *SWEPT)
            look = self._observer.observe(f"while joint {joint + 1} was read")
            if look.uv_px is not None:
                looks.append(look)
                readings.append(self._robot.read().q)
        # a camera counts that showed the beacon in all looks
        uv = np.mean([look.uv_px for look in looks if look.uv_px is not None], axis=0)
        xyz = np.mean([look.xyz_m for look in looks if look.xyz_m is not None], axis=0)
        known = [look.std_px for look in looks if look.std_px is not None]
        self._joint.append(joint)
        # what is behind the beacon shifts it alike in all frames: a mean is known no better for it
        self._rows.append((np.mean(readings, axis=0), uv, xyz, float(np.median(known)) if known else None))


def _same(before: JointReading, now: JointReading, seen: Observation, look: Observation, flicker: float) -> bool:
    if seen.uv_px is None or look.uv_px is None:
        return False
    off = np.abs(look.uv_px - seen.uv_px)
    off = off[np.isfinite(off)]  # of the cameras that see it in both
    return bool(np.abs(now.q - before.q).max() <= flicker and len(off) and off.max() <= REST_PX)


class PoseObserver(Protocol):
    """Sees where the target is, now."""

    def observe(self, while_: str) -> tuple[float, TargetPose]:
        """Return when the newest frames were taken at the earliest, on our clock, and what they show.

        while_: what the robot does, for messages. Raises DeviceFailed where no frames come.
        """


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PathSegment:
    """The way to a pose: joint readings q (k, n) at times t_s (k,); it begins where the last one ended."""

    name: str
    q: Array
    t_s: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PoseVisit:
    """What was seen at one stop: the pose's name, the cycle from 1, frames with a whole pose, and the readings (n,)."""

    name: str
    cycle: int
    poses: tuple[TargetPose, ...]
    q: Array


class Visitor:
    """Leads an open robot along segments, and looks where it rests."""

    def __init__(self, robot: Robot, observer: PoseObserver, clock: Clock, progress: Progress, *, frames: int) -> None:
        """frames: with a whole pose that are wanted at a stop."""
        self._robot, self._observer = robot, observer
        self._clock, self._progress, self._frames = clock, progress, frames
        self._at: Array | None = None

    def visit(self, segment: PathSegment, cycle: int) -> PoseVisit:
        """Go along a segment, rest, and look. Raises DeviceFailed, DeviceLost, NotEnoughData, Cancelled."""
        self._go(segment)
        self._rest(segment)
        return self._look(segment, cycle)

    def _go(self, segment: PathSegment) -> None:
        at = self._robot.step_joints(np.zeros(segment.q.shape[1])).q if self._at is None else self._at
        gone_s, stuck = 0.0, 0
        while gone_s < segment.t_s[-1] or np.abs(segment.q[-1] - at).max() > THERE:
            _check_going(self._robot, self._progress, f"on the way to {segment.name}", *VISITED)
            gone_s = min(gone_s + self._robot.cycle_s, float(segment.t_s[-1])) if stuck == 0 else gone_s
            goal = np.array([np.interp(gone_s, segment.t_s, column) for column in segment.q.T])
            sent = self._robot.step_joints(goal - at)
            short = np.abs(goal - sent.q).max()
            stuck = stuck + 1 if short > THERE else 0  # the guard took a part of it: wait on the track
            proving = PROVING in sent.limited  # the link, which ends by itself, or stops the robot
            if stuck >= STUCK and not proving and np.abs(sent.q - at).max() < THERE:
                raise DeviceFailed(
                    f"the arm does not go on towards {segment.name}{_limited_by(sent)}",
                    consequence="The run ends there",
                    cure="Choose a smaller cube, or wider limits",
                )
            at = self._at = sent.q
            self._clock.sleep_until(self._clock.now_s() + self._robot.cycle_s)

    def _rest(self, segment: PathSegment) -> None:
        """Return when the joints keep still and frames come that were taken after."""
        arrived_s, still = self._clock.now_s(), 0
        before = self._robot.read()
        while still < REST_FRAMES:
            _check_going(self._robot, self._progress, f"coming to rest at {segment.name}", *VISITED)
            if self._clock.now_s() - arrived_s > REST_TIMEOUT_S:
                raise DeviceFailed(
                    f"the arm did not come to rest at {segment.name} in {REST_TIMEOUT_S:g} s",
                    consequence="The run ends there",
                    cure="Look for vibration or a slipping brake",
                )
            taken_s, _ = self._observer.observe(f"at {segment.name}")
            now = self._robot.read()
            same = np.abs(now.q - before.q).max() <= REST_STEP
            still = still + 1 if same and taken_s >= arrived_s + HELD_BACK_S else 0
            before = now

    def _look(self, segment: PathSegment, cycle: int) -> PoseVisit:
        poses: list[TargetPose] = []
        lost = 0
        while len(poses) < self._frames:
            _check_going(self._robot, self._progress, f"while {segment.name} was looked at", *VISITED)
            _, pose = self._observer.observe(f"at {segment.name}")
            if pose.status is PoseStatus.OK:
                poses.append(pose)
                lost = 0
                continue
            lost += 1
            if lost >= MOST_LOST:
                raise NotEnoughData(
                    f"the target is not seen whole at {segment.name}" + (f": {pose.why}" if pose.why else ""),
                    consequence="The run ends there",
                    cure="Free the view of it, or choose a smaller cube",
                )
        return PoseVisit(name=segment.name, cycle=cycle, poses=tuple(poses), q=self._robot.read().q)


def _limited_by(sent: Sent) -> str:
    return f": {', '.join(sent.limited)}" if sent.limited else ""


def _check_going(robot: Robot, progress: Progress, when: str, stopped: str, unfinished: str) -> None:
    """Raise Cancelled, with the consequence stopped, DeviceFailed and DeviceLost with the consequence unfinished."""
    if progress.cancelled():
        raise Cancelled(f"stopped {when}", consequence=stopped)
    state = robot.state
    if state not in (RobotState.READY, RobotState.MOVING):
        kind = DeviceLost if state is RobotState.LOST else DeviceFailed
        why = getattr(robot, "why", "")  # a driver says it, a simulated robot need not
        raise kind(
            f"{robot.name} is {state} {when}" + (f": {why}" if why else ""),
            consequence=unfinished,
            cure="Look at the robot and its controller, then begin anew",
        )
