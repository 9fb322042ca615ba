"""One run of a robot: asked for, moved by a source of set points through the guard, recorded, shown, counted.

Playing, following, running a motion and jogging are each a source, a question and figures of their own.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Annotated, Any, Self

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.control.guard import GuardState
from armsight.control.loop import ControlLoop
from armsight.control.play import PathSource
from armsight.control.servo import ServoSource
from armsight.control.setpoints import CycleState, Hold, SetPoint, SetPointSource, ToolPose, ToolTwist
from armsight.control.status import QueueSink, RobotStatus, Timing
from armsight.drivers import Robot, RobotTraits
from armsight.errors import ArmsightError, Cancelled, DataRefused, Inconsistent, UsageError
from armsight.fields import Doc
from armsight.geometry import pose_difference, xyz_quat
from armsight.kinematics import Arm
from armsight.ops.requests.motion import RobotJob
from armsight.ops.robot.opening import (
    ClockedRobot,
    arm_of,
    beside_outside,
    clocked_robot,
    guard_for,
    noted,
    standing_outside,
)
from armsight.ops.robot.recorder import LoopRecorder, run_with_progress
from armsight.records import Progress, Silent, require_kind
from armsight.records.output import Output, output
from armsight.units import DEG, MM

Confirm = Callable[[str], bool]
"""Is asked whether the arm may move; the text says how."""


def as_question(confirm: bool | Confirm) -> Confirm:
    """Return what is asked before motion. Raises UsageError for what is neither truth nor function."""
    if callable(confirm):
        return confirm
    require_kind("confirm", confirm, bool, cure="Give True, or a function of the question")
    return lambda _: confirm


SHOWN_S = 0.2
"""Simulated time between two calls of show."""
STUCK_S = 5.0
"""A motion that the guard has held for so long, though the operator's enable was there, is given up."""
ARM_OFF_M, ARM_OFF_RAD = 0.02, 2.0 * DEG
"""A calibrated arm.yaml differs by millimetres from what the controller computes; beyond this it is another arm's."""


@output
class RunOutput(Output):
    """What the control loop of a run came to."""

    n_cycles: Annotated[int, Doc("Cycles of the control loop.")]
    late: Annotated[int, Doc("Cycles that began more than half a cycle too late.")]
    missed: Annotated[int, Doc("Cycles that never began.")]
    stopped_by: Annotated[str, Doc("Why it ended: end, time, operator, or in words what stopped it.")]
    holds: Annotated[list[str], Doc("Why the arm held, each reason once.")]
    recording: Annotated[str, Doc("The recording: set points, commands, readings, poses and events.")]

    def held(self) -> Iterator[str]:
        """Yield a line for each reason for which the arm held."""
        yield from (f"  it held: {why}" for why in self.holds)


@output
class ToolRunOutput(RunOutput):
    """What a run came to whose tool goes along a path or after a target."""

    state: Annotated[str, Doc("The guard's last state: running, holding, retreating, disabled or stopped.")]
    wrong_premise: Annotated[
        str | None,
        Doc("What the target's motion contradicts: hand-eye, rig, target, pictures or robot; null: nothing."),
    ]
    outside: Annotated[str, Doc("Which limits the arm stood outside of at the start, by how much; empty: none.")]

    @property
    def exit_code(self) -> int:
        """3 where the target's motion contradicts what was given."""
        return 0 if self.wrong_premise is None else DataRefused.exit_code


class CycleTally:
    """Counts cycles as the loop does them; given to it as what may end it."""

    def __init__(self, cancelled: Callable[[], bool], stuck_s: float = STUCK_S) -> None:
        self.cycles = 0
        self.holds: list[str] = []
        self.last: RobotStatus | None = None
        self.began_s: float | None = None
        self._cancelled, self._stuck_s = cancelled, stuck_s
        self._held_s: float | None = None

    def __call__(self, status: RobotStatus) -> bool:
        """Take a cycle; tell whether it was the last: at the end, let go of, stopped, or held for too long."""
        self.last = status
        self.cycles += 1
        self.began_s = status.t_s if self.began_s is None else self.began_s
        if status.why and status.reason not in self.holds:
            self.holds.append(status.reason)
        if status.guard is not GuardState.HOLDING:
            self._held_s = None
        elif self._held_s is None:
            self._held_s = status.t_s
        stuck = self._held_s is not None and status.t_s - self._held_s > self._stuck_s
        return status.finished or self._cancelled() or status.guard is GuardState.STOPPED or stuck

    @property
    def took_s(self) -> float:
        """Time since the first cycle."""
        return 0.0 if self.last is None or self.began_s is None else self.last.t_s - self.began_s

    @property
    def state(self) -> str:
        """The guard's state in the last cycle."""
        return "disabled" if self.last is None else self.last.guard.value

    def stopped_by(self, *, finished: bool = False) -> str:
        """Return why the loop ended."""
        if finished:
            return "end"
        if self._cancelled():
            return "operator"
        return "" if self.last is None else self.last.why or (self.holds[-1] if self.holds else "")


class RecordedSource:
    """A source whose set points go into the recording."""

    def __init__(self, source: PathSource | ServoSource, sink: QueueSink) -> None:
        self.name = source.name
        self._recorded, self._sink = source, sink

    def next(self, now: CycleState) -> SetPoint:
        """Return the set point, and queue it."""
        wanted = self._recorded.next(now)
        self._sink.command(now.t_s, "set_point", set_point_values(wanted))
        return wanted

    def warm_up(self) -> None:
        """Run once what a cycle runs."""
        self._recorded.warm_up()


def set_point_values(wanted: SetPoint) -> Mapping[str, Any]:
    """Return a set point of the tool as JSON knows it."""
    match wanted:
        case ToolTwist(velocity_m_s=v, angular_rad_s=w):
            return {"velocity_m_s": v.tolist(), "angular_rad_s": w.tolist()}
        case ToolPose(T_base_tool=T):
            xyz, quat = xyz_quat(T)
            return {"xyz_m": xyz.tolist(), "quat_xyzw": quat.tolist()}
        case _:
            return {"hold": wanted.why if isinstance(wanted, Hold) else ""}


class RobotRun:
    """A robot, its guard and its loop, from the question to the last cycle. `with run:` opens the robot.

    failed: tells what else ended the run, such as its cameras; outside: where the arm stood outside its limits when it
    was looked at; status: the last cycle, once the loop has ended.
    """

    def __init__(
        self,
        job: RobotJob,
        arm: Arm | None,
        progress: Progress | None,
        *,
        confirm: bool | Confirm,
        recording: Path | None,
        limits: Path | None,
        speed: float,
        device: ClockedRobot | None = None,
    ) -> None:
        """arm: as given. recording: an .mcap file, None: none is made. limits, speed: as guard_for takes them.

        device: the robot, where it is made already. Nothing is opened. Raises as clocked_robot and guard_for.
        """
        device = device or clocked_robot(job, arm)
        self.robot, self.clock, self.progress = device.robot, device.clock, progress or Silent()
        self.guard = guard_for(self.robot, arm, limits, share=speed)
        self.knows_lengths = arm_of(self.robot, arm) is not None
        self.failed: Callable[[], ArmsightError | None] = lambda: None
        self.outside = ""
        self.status: RobotStatus | None = None
        self.recording = None if recording is None else Path(recording)
        self._job, self._limits, self._confirm = job, limits, as_question(confirm)
        self._moves = False

    def __enter__(self) -> Self:
        self.robot.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.robot.__exit__(kind, error, trace)

    def require_lengths(self, consequence: str) -> None:
        """Raise UsageError where neither a file nor the robot tells the arm's lengths."""
        if not self.knows_lengths:
            raise UsageError(
                f"{self.robot.name} does not tell its arm's lengths",
                consequence=consequence,
                cure="Give the arm's file (--arm)",
            )

    @contextmanager
    def planning(self) -> Iterator[None]:
        """Look where the open robot stands; told with why a way from there is refused where that is outside."""
        self.outside = standing_outside(self.guard, self.robot)
        with beside_outside(self.outside):
            yield

    def ask(self, question: str, *, unasked: str = "unasked") -> None:
        """Ask whether the arm may move, with what is to be known of it besides. Raises Cancelled."""
        if not self._confirm(question + noted(self.outside, self.guard, self._job, self._limits, self.robot)):
            raise Cancelled("not confirmed", consequence="Nothing was moved", cure=f"Give --yes to move {unasked}")

    @contextmanager
    def recorded(self) -> Iterator[QueueSink]:
        """Record what the sink takes; raise at the end what the run failed of.

        Nothing is left of a run that ended before the arm might move, or the next one would be refused beside it.
        """
        path = self.recording
        if path is None:
            yield QueueSink(longest=0)
            return
        recorder = LoopRecorder(path, self.clock)
        try:
            with recorder:
                yield recorder.sink
        finally:
            if not self._moves:
                path.unlink(missing_ok=True)
        failed = self.failed() or recorder.failed
        if failed is not None:
            raise failed

    def follow(
        self,
        source: SetPointSource,
        sink: QueueSink,
        until: Callable[[RobotStatus], bool],
        show: Callable[[RobotStatus | None], None],
        *,
        enabled: Callable[[], bool] | None = None,
        for_s: float = math.inf,
        doubt: Callable[[], str] = lambda: "",
        stepped: bool = False,
    ) -> Timing:
        """Follow the source until that, a failure or the time ends it; return how punctual the loop was.

        enabled: the operator's enable; None: it lasts until progress is cancelled. doubt: asked each cycle for what the
        robot is to be stopped for, in words. show: told of the newest cycle now and then. stepped: time is simulated
        and passes as the loop waits for it: another thread would see it jump, and pictures come too late.
        """
        alive = enabled or (lambda: not self.progress.cancelled())
        loop = ControlLoop(self.robot, self.guard, source, self.clock, enabled=alive, sink=sink)
        every = max(1, round(SHOWN_S / self.guard.cycle_s))

        def over(status: RobotStatus) -> bool:
            if stepped and (status.cycle - 1) % every == 0:
                show(status)
            if why := doubt():
                loop.stop(why)
            return until(status) or self.failed() is not None

        self._moves = True
        if stepped:
            timing = loop.run(for_s=for_s, until=over)
        else:
            timing = run_with_progress(lambda: loop.run(for_s=for_s, until=over), lambda: show(loop.status))
        self.status = loop.status
        return timing

    def output(self, tally: CycleTally, timing: Timing, stopped_by: str) -> RunOutput:
        """Return what the loop came to."""
        return RunOutput(
            n_cycles=timing.n_cycles,
            late=timing.late,
            missed=timing.missed,
            stopped_by=stopped_by,
            holds=tally.holds,
            recording="" if self.recording is None else str(self.recording),
        )


def check_arm(robot: Robot, arm: Arm) -> None:
    """Raise Inconsistent where the controller computes another pose of the flange than the arm's file does."""
    if not RobotTraits.of(robot).takes_joints:
        return
    sent = robot.step_joints(np.zeros(arm.n))
    if sent.pose is None:
        return
    T_world_tool = RigidTransform.from_matrix(arm.fk(arm.values(sent.q)))
    off = pose_difference(arm.T_world_base.inv() * T_world_tool * arm.T_flange_tool.inv(), sent.pose)
    off_m, off_rad = float(np.linalg.norm(off[:3])), float(np.linalg.norm(off[3:]))
    if off_m > ARM_OFF_M or off_rad > ARM_OFF_RAD:
        raise Inconsistent(
            f"the controller of {robot.name} has its flange {off_m / MM:.0f} mm and {off_rad / DEG:.1f} deg from where "
            f"{arm.name} has it",
            consequence="The file is of another arm, and nothing is moved",
            cure="Give the file of this arm (--arm)",
        )
