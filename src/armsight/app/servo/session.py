"""One run of the servo: opened, delay measured, asked, followed, told."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import ExitStack

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.app.requests.motion import ServoJob
from armsight.app.robot.guarding import noted, standing_outside
from armsight.app.robot.recorder import LoopRecorder
from armsight.app.robot.with_progress import run_with_progress
from armsight.app.schemas.servo import ServoOutput
from armsight.app.servo.job import ServoDevices
from armsight.app.servo.outcome import RecordedSource, Show, Tally, servo_output
from armsight.app.servo.vision import Beside, Vision, VisionThread, probe
from armsight.control.guard import Guard
from armsight.control.jitter import Timing
from armsight.control.loop import ControlLoop, LoopStatus
from armsight.control.servo import Gain, ServoSettings, ServoSource, chosen_gain
from armsight.drivers import Robot
from armsight.errors import ArmsightError, Cancelled, Inconsistent
from armsight.geometry import pose_difference
from armsight.kinematics import Arm
from armsight.measure.poses.pipeline import Setup
from armsight.records import Progress
from armsight.units import DEG, MM, MS

RECORDING = "servo.mcap"
ARM_OFF_M, ARM_OFF_RAD = 0.02, 2.0 * DEG
"""A calibrated arm.yaml differs by millimetres from what the controller computes; beyond this it is another arm's."""
TOLD_S = 0.2
"""Simulated time between two tellings."""

Confirm = Callable[[str], bool]
"""Is asked whether the arm may move; the text says how."""


class ServoSession:
    """Robot, cameras, guard and how the target is followed, of one run."""

    def __init__(
        self,
        job: ServoJob,
        devices: ServoDevices,
        guard: Guard,
        settings: ServoSettings,
        setup: Setup,
        beside: Beside | None = None,
    ) -> None:
        self._job, self._devices, self._guard, self._settings, self._setup = job, devices, guard, settings, setup
        self._thread: VisionThread | None = None
        self._beside = beside

    def run(self, confirm: Confirm, show: Show, progress: Progress) -> ServoOutput:
        """Follow the target and return what it came to. Raises as run_servo."""
        devices, clock = self._devices, self._devices.clock
        with ExitStack() as stack:
            robot = stack.enter_context(devices.robot)
            check_arm(robot, self._guard.arm)
            recorder = stack.enter_context(LoopRecorder(self._job.out / RECORDING, clock))
            vision = Vision(self._setup, devices, self._job.latency_s, recorder.sink)
            self._watch(stack, vision)
            probe(vision, clock, self._failed)
            gain, source = self._source(vision)
            if self._beside is not None:
                self._beside.begin(source, self._guard.arm, clock, recorder.sink)
                vision.beside = self._beside.observe
            outside = standing_outside(self._guard, robot)
            if not confirm(question(robot, self._guard, gain, source) + noted(outside)):
                raise Cancelled("not confirmed", consequence="Nothing was moved", cure="Give --yes to move unasked")
            tally = Tally(source, progress.cancelled)
            loop = ControlLoop(
                robot,
                self._guard,
                RecordedSource(source, recorder.sink),
                clock,
                enabled=lambda: not progress.cancelled(),
                sink=recorder.sink,
            )
            timing = self._follow(loop, tally, show, progress)
        failed = self._failed() or recorder.failed
        if failed is not None:
            raise failed
        return servo_output(tally, timing, vision, source, gain, str(self._job.out / RECORDING), outside)

    def _watch(self, stack: ExitStack, vision: Vision) -> None:
        """Open the cameras and take their pairs: as the simulated clock moves, or in a thread."""
        pairs = stack.enter_context(self._devices.pairs)
        if self._devices.stepped is not None:
            self._devices.stepped.watch(pairs, vision.take)  # type: ignore[arg-type]  # of a live cell, by number too
            return
        self._thread = stack.enter_context(VisionThread(vision, self._devices))

    def _source(self, vision: Vision) -> tuple[Gain, ServoSource]:
        """Return the gain that the measured delay allows, and the source, which sees from now on."""
        cycle_s, delay = self._guard.cycle_s, vision.delay
        delay_s = delay.delay_s + self._settings.arm_lag_s
        gain = chosen_gain(self._job.gain, max(cycle_s, delay.period_s), delay_s)
        setup, settings = self._setup, self._settings.with_gain(gain.used)
        source = ServoSource(self._guard.arm, setup.rig, setup.target, settings, cycle_s)
        source.warm_up()
        vision.source = source
        return gain, source

    def _failed(self) -> ArmsightError | None:
        return None if self._thread is None else self._thread.failed

    def _follow(self, loop: ControlLoop, tally: Tally, show: Show, progress: Progress) -> Timing:
        """Run the loop: in this thread where time is simulated, beside the telling where it is real."""
        clock = self._devices.clock
        for_s = math.inf if self._job.seconds_s is None else self._job.seconds_s
        started_s = clock.now_s()

        def tell() -> None:
            progress.update(clock.now_s() - started_s, 0.0 if math.isinf(for_s) else for_s)
            if loop.status is not None:
                show(loop.status, tally.error_m)

        def until(status: LoopStatus) -> bool:
            ended = tally(status)
            return ended or self._failed() is not None

        if self._devices.stepped is None:
            return run_with_progress(lambda: loop.run(for_s=for_s, until=until), tell)
        every = max(1, round(TOLD_S / self._guard.cycle_s))

        def telling(status: LoopStatus) -> bool:
            if tally.cycles % every == 0:
                tell()
            return until(status)

        return loop.run(for_s=for_s, until=telling)


def check_arm(robot: Robot, arm: Arm) -> None:
    """Raise Inconsistent where the controller computes another pose of the flange than the arm's file does."""
    if not getattr(robot, "takes_joints", True):
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


def question(robot: Robot, guard: Guard, gain: Gain, source: ServoSource) -> str:
    """Return what is asked before the arm follows."""
    limits, mount = guard.limits, source.settings.mount
    noted = f" Note: {gain.note}." if gain.note else ""
    return (
        f"{robot.name} follows the target with gain {gain.used:.3g} 1/s ({mount}, delay "
        f"{(gain.n * gain.cycle_s) / MS:.0f} ms, arm's lag taken as {source.arm_lag_s / MS:.0f} ms), at up to "
        f"{limits.speed_m_s / MM:.0f} mm/s and {limits.turn_rad_s / DEG:.0f} deg/s.{noted} It may start at once. Move?"
    )
