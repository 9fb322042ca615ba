"""A running arm supervised: live poses beside where the arm says it is, alarms, a recording, a report."""

from __future__ import annotations

from collections.abc import Callable, Generator
from contextlib import ExitStack, closing

import numpy as np

from armsight.app.arm_files import load_arm
from armsight.app.live.pace import live_pace
from armsight.app.measure.run import target_of
from armsight.app.measure.warm_up import prepare
from armsight.app.requests.verify import LiveVerifyJob
from armsight.app.robot.opening import refuse_settings, robot_of
from armsight.app.simulate.scenarios import live_cell
from armsight.app.sources.frames import open_pairs
from armsight.app.verify.live_output import LiveLog, live_output
from armsight.app.verify.supervising import Show, Supervised, Supervision
from armsight.clock import Clock, SystemClock
from armsight.drivers import is_live
from armsight.errors import ArmsightError, DeviceFailed, Inconsistent, NotEnoughData, UsageError
from armsight.file_names import ERRORS, LIVE, REPORT, VERIFY
from armsight.kinematics import Arm
from armsight.measure.poses.pipeline import Setup
from armsight.measure.settings import SpotSettings
from armsight.records import Frame, Progress, Silent, Target
from armsight.report.verify_pages import live_report
from armsight.store import read_rig, read_world, write_text
from armsight.store.atomic import write_json
from armsight.store.rigs import World
from armsight.units import DEG
from armsight.verify.results import VerifyLiveOutput
from armsight.verify.supervision import PredictedPose


def run_verify_live(
    job: LiveVerifyJob,
    show: Show = lambda *_: None,
    progress: Progress | None = None,
    *,
    tell: Callable[[str], None] = lambda _: None,
    clock: Clock | None = None,
    devices: Supervised | None = None,
) -> VerifyLiveOutput:
    """Supervise until the person stops, the limit is reached or a stop was raised; write the files of job.out.

    The robot is told nothing but to stop. Closing its link stops it too where the link commands it. tell: takes what a
    person should hear of the plant's systems. clock, devices: in place of the machine's and of those named. Raises
    UsageError, DataRefused, DeviceFailed; what was seen until a failure is in the files.
    """
    clock, progress = clock or SystemClock(), progress or Silent()
    rig, target, arm, world = read_rig(job.rig), target_of(job.target), load_arm(job.arm), read_world(job.world)
    _check(job)
    devices = devices or open_supervised(job, target, clock, arm)
    expectation = PredictedPose(
        arm=arm if world.parent == "world" else arm.based(),
        T_parent_rig=world.T_parent_rig,
        rig_covariance=None if world.covariance is None else world.covariance.matrix,
        joint_std=job.joint_std,
        time_std_s=0.0 if devices.origin_s is not None else job.latency_std_s,
    )
    _check_arm(arm, devices)
    setup = Setup(rig=rig, target=target, settings=SpotSettings(colour=target.colour), pace=live_pace())
    prepare(progress)
    log, failure = LiveLog(limits=job.limits), None
    try:
        _supervise(Supervision(job, setup, expectation, devices, clock, log, show, tell), progress)
    except ArmsightError as error:
        failure = error
    if failure is not None and not log.rows:
        raise failure
    failure = failure or _nothing_compared(log)
    done = live_output(log, recording=str(job.out / LIVE), doubts=_doubts(job, arm, world, devices, failure))
    write_json(job.out / VERIFY, done.to_dict())
    write_text(job.out / ERRORS, log.csv())
    write_text(job.out / REPORT, live_report(log.series(), done, inputs=_inputs(job)))
    if failure is not None:
        kept = f"What was seen until then is in {job.out}"
        failure.consequence = ". ".join(part.rstrip(".") for part in (failure.consequence, kept) if part)
        raise failure
    return done


def _supervise(run: Supervision, progress: Progress) -> None:
    """Go through the pairs; the robot is stopped where supervision itself fails and stops were asked for."""
    with ExitStack() as stack:
        robot = stack.enter_context(run.devices.robot)
        stack.enter_context(run.devices.pairs)
        run.open(stack)
        if run.job.plant is not None:
            stack.enter_context(run.job.plant.supervised(run))
        try:
            with closing(_generator(run)) as pairs:
                for pair in pairs:
                    run.take(pair)
                    if run.ended() or progress.cancelled():
                        return
            raise DeviceFailed("the cameras ended", consequence="Nobody watches the arm any more", cure="Check them")
        except BaseException:
            if run.job.limits.stops or run.job.blind_stop_s is not None:
                robot.stop()  # nobody watches any more
            raise


def _generator(run: Supervision) -> Generator[tuple[Frame, Frame], None, None]:
    yield from run.devices.pairs


def _nothing_compared(log: LiveLog) -> NotEnoughData | None:
    """Return the error for a run in which not one pair could be compared."""
    if any(not row.lost for row in log.rows):
        return None
    return NotEnoughData(
        f"none of {len(log.rows)} pairs could be compared; the last: {log.rows[-1].lost}",
        consequence="Whether the arm is where it says it is, is not known",
        cure="See that both cameras see the whole target, and that the robot's link delivers joints",
    )


def _check(job: LiveVerifyJob) -> None:
    """Raise UsageError for times that cannot be."""
    for name, value in (("--latency", job.latency_s), ("--latency-std", job.latency_std_s)):
        if not (np.isfinite(value) and value >= 0.0):
            raise UsageError(f"{name} {value:g} is no time", cure="Give seconds, zero or more")
    if job.blind_stop_s is not None and not job.blind_stop_s > 0.0:
        raise UsageError(f"--stop-blind {job.blind_stop_s:g} is no time", cure="Give seconds, more than zero")
    if not (np.isfinite(job.joint_std) and job.joint_std >= 0.0):
        raise UsageError(
            f"--joint-std {job.joint_std / DEG:g} is no standard deviation", cure="Give degrees, zero or more"
        )


def _check_arm(arm: Arm, devices: Supervised) -> None:
    if devices.robot.n_joints != arm.n:
        raise Inconsistent(
            f"{devices.robot.name} has {devices.robot.n_joints} joints, {arm.name} has {arm.n}",
            consequence="Nothing is supervised",
            cure="Give the file of this arm (--arm)",
        )


def _doubts(job: LiveVerifyJob, arm: Arm, world: World, devices: Supervised, failure: Exception | None) -> list[str]:
    notes = [f"supervision ended early: {failure}"] if failure is not None else []
    if not job.limits.all:
        notes.append("no level was set: nothing could raise an alarm")
    if world.covariance is None:
        notes.append("world.yaml says no uncertainty of the rig's place: none is counted")
    if arm.covariance is None:
        notes.append(
            "the arm's file says no uncertainty of its geometry: an error of the model looks like one of the arm"
        )
    if devices.origin_s is None:
        notes.append(
            f"the exposure's moment on the robot's clock is taken as {1e3 * job.latency_s:.3g} +- "
            f"{1e3 * job.latency_std_s:.2g} ms before a frame's arrival; verify finds it from poses and joints"
        )
    return notes


def _inputs(job: LiveVerifyJob) -> list[tuple[str, str]]:
    named = (("robot", job.robot), ("left", job.left), ("right", job.right), ("arm", job.arm))
    files = (("rig", job.rig), ("target", job.target), ("world", job.world))
    return [*named, *((what, path.name) for what, path in files)]


SIM = "sim:"


def open_supervised(job: LiveVerifyJob, target: Target, clock: Clock, arm: Arm) -> Supervised:
    """Return what the job names; nothing is opened yet. Raises UsageError, DeviceNotFound, BadFile."""
    if job.robot.startswith(SIM):
        refuse_settings(job)
        return _simulated(job, clock)
    if job.play:
        raise UsageError(f"--play is of simulated robots, and {job.robot} is none", cure="Leave --play away")
    for text in (job.left, job.right):
        if not is_live(text) or text.startswith("camera:sim:"):
            raise UsageError(f"{text} does not see {job.robot} now", cure="Give camera:NAME for --left and --right")
    robot = robot_of(job, clock, arm)
    pairs = open_pairs(job.left, job.right, colour=target.colour is not None, settings=job.camera_settings)
    return Supervised(robot=robot, pairs=pairs)


def _simulated(job: LiveVerifyJob, clock: Clock) -> Supervised:
    name = job.robot.removeprefix(SIM)
    for view, text in (("left", job.left), ("right", job.right)):
        if text != f"camera:sim:{name}:{view}":
            raise UsageError(
                f"{text} does not see the simulated robot {job.robot}", cure=f"Give camera:sim:{name}:{view}"
            )
    job.camera_settings.require_none(f"the simulated robot {job.robot}")
    cell = live_cell(name, clock, play=job.play)
    return Supervised(robot=cell.robot, pairs=cell.pairs, origin_s=lambda: float(cell.origin_s))
