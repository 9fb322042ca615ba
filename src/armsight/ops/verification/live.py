"""A running arm supervised: live poses beside where the arm says it is, alarms, a recording."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from typing import cast

import numpy as np

from armsight.clock import Clock
from armsight.control.loop import quiet_interpreter
from armsight.drivers import CameraSettings, Robot, RobotTraits, Views, moments_of
from armsight.drivers.trackers.source import TrackedBody, open_tracker
from armsight.errors import ArmsightError, DeviceFailed, Inconsistent, NotEnoughData, UsageError
from armsight.kinematics import Arm
from armsight.measure.poses.moments import require_rotation, require_views
from armsight.measure.poses.pipeline import Setup
from armsight.measure.settings import SpotSettings
from armsight.ops.measurement.run import target_of
from armsight.ops.requests.motion import RobotJob, refuse_cameras, require_named
from armsight.ops.requests.plant import Publishing
from armsight.ops.robot.opening import refuse_settings, robot_of
from armsight.ops.simulation.following import watching_cell
from armsight.ops.simulation.scenarios import live_cell
from armsight.ops.sources.cameras import cameras_of, open_cameras, require_watching, told_apart, told_later
from armsight.ops.sources.pace import live_pace
from armsight.ops.verification.supervising import Supervised, Supervision
from armsight.optics import Rig
from armsight.records import Progress, Target
from armsight.store import read_rig
from armsight.store.rigs import World
from armsight.units import DEG, MM
from armsight.verify.live import LiveLog, VerifyLiveOutput
from armsight.verify.supervision import Limits

YOUNG = 1
"""What was made since the last moments is looked through for garbage between two of them, in a tenth of a millisecond;
all that a process holds would take a tenth of a second, within one."""


def supervise_until_ended(
    run: Supervision,
    opened: Callable[[ExitStack], None],
    ended: Callable[[], bool],
    plant: Publishing | None,
    progress: Progress,
) -> ArmsightError | None:
    """Go through the pairs until the person stops or enough was seen; return why that ended early.

    The robot is told nothing but to stop: beyond a level, and where supervision itself fails and stops were asked for.
    Closing its link stops it too where the link commands it. opened: begins what goes on beside it. Raises
    ArmsightError where nothing was seen at all.
    """
    try:
        with ExitStack() as stack:
            robot = stack.enter_context(run.devices.robot)
            stack.enter_context(run.devices.pairs)
            opened(stack)
            if plant is not None:
                stack.enter_context(plant.supervised(run))
            try:
                _take_pairs(run, lambda: ended() or progress.cancelled())
            except BaseException:
                if run.stops:
                    robot.stop()  # nobody watches any more
                raise
    except ArmsightError as error:
        if not run.judge.log.rows:
            raise
        return error
    return _nothing_compared(run.judge.log)


def _take_pairs(run: Supervision, ended: Callable[[], bool]) -> None:
    moments = moments_of(cast("Iterable[Views | TrackedBody]", run.devices.pairs))
    with quiet_interpreter(), closing(moments):
        for moment in moments:
            run.take(moment)
            if ended():
                return
            gc.collect(YOUNG)
    raise DeviceFailed("the cameras ended", consequence="Nobody watches the arm any more", cure="Check them")


def _nothing_compared(log: LiveLog) -> NotEnoughData | None:
    """Return the error for a run in which not one pair could be compared."""
    if any(not row.lost for row in log.rows):
        return None
    return NotEnoughData(
        f"none of {len(log.rows)} pairs could be compared; the last: {log.rows[-1].lost}",
        consequence="Whether the arm is where it says it is, is not known",
        cure="See that both cameras see the whole target, and that the robot's link delivers joints",
    )


def tracker_doubts(tracker: str | None, said: bool) -> list[str]:
    """Return what to know of a tracker's poses. said: what they may be off was given."""
    if tracker is None or said:
        return []
    return [
        f"the tracker's poses are taken to be off by {TRACKER_STD[0] / MM:g} mm and {TRACKER_STD[1] / DEG:g} deg "
        "(standard deviations), which its stream does not say: --tracker-std, --tracker-std-deg"
    ]


TRACKER_STD = (0.3 * MM, 0.3 * DEG)
"""What a tracker's pose is taken to be off where that is not said: some tenths of a millimetre, and the rotation that
these give a body of 100 mm."""


def open_tracked(
    link: RobotJob, tracker: str, body: str, std: tuple[float | None, float | None], clock: Clock, arm: Arm | None
) -> Supervised:
    """Return the robot and a tracker's body, not yet open; std: of a pose in m and rad, None as it is taken to be.

    Raises UsageError, DeviceNotFound.
    """
    if link.follow is not None or link.robot.startswith(SIM):
        raise UsageError("a tracker sees no simulated robot", cure="Give cameras, or the robot itself with --robot")
    std_m, std_rad = (taken if one is None else one for one, taken in zip(std, TRACKER_STD, strict=True))
    stream = open_tracker(tracker, body=body, std_m=std_m, std_rad=std_rad)
    return Supervised(robot=robot_of(link, clock, arm), pairs=stream)


def check_eyes(tracker: str | None, of_cameras: Mapping[str, object], of_tracker: Mapping[str, object]) -> None:
    """Raise UsageError where both cameras and a tracker are given, or neither completely."""
    given = [flag for flag, value in of_cameras.items() if value]
    if tracker is not None and given:
        raise UsageError(
            f"{', '.join(given)} of cameras {'stands' if len(given) == 1 else 'stand'} beside --tracker",
            cure="Give cameras with rig and target, or a tracker",
        )
    if tracker is None and not (of_cameras["--rig"] and of_cameras["--target"]):
        raise UsageError("cameras need a rig and a target", cure="Give --rig and --target, or --tracker")
    unused = [flag for flag, value in of_tracker.items() if value]
    if tracker is None and unused:
        raise UsageError(
            f"{', '.join(unused)} goes with --tracker", cure="Leave it out, or give --tracker in place of the cameras"
        )


def with_kept(failure: ArmsightError, done: VerifyLiveOutput, out: Path | None) -> ArmsightError:
    """Return a failure with what was seen until then, which is written where there is a folder."""
    kept = "" if out is None else f"What was seen until then is in {out}"
    failure.consequence = ". ".join(part.rstrip(".") for part in (failure.consequence, kept) if part)
    failure.kept = done
    return failure


def check_times(latency_s: float, latency_std_s: float, blind_stop_s: float | None, joint_std: float) -> None:
    """Raise UsageError for times that cannot be."""
    for name, value in (("--latency", latency_s), ("--latency-std", latency_std_s)):
        if not (np.isfinite(value) and value >= 0.0):
            raise UsageError(f"{name} {value:g} is no time", cure="Give seconds, zero or more")
    if blind_stop_s is not None and not blind_stop_s > 0.0:
        raise UsageError(f"--stop-blind {blind_stop_s:g} is no time", cure="Give seconds, more than zero")
    if not (np.isfinite(joint_std) and joint_std >= 0.0):
        raise UsageError(f"--joint-std {joint_std / DEG:g} is no standard deviation", cure="Give degrees, zero or more")


def check_arm(arm: Arm, devices: Supervised) -> None:
    """Raise Inconsistent for the arm of another robot."""
    if devices.robot.n_joints != arm.n:
        raise Inconsistent(
            f"{devices.robot.name} has {devices.robot.n_joints} joints, {arm.name} has {arm.n}",
            consequence="Nothing is supervised",
            cure="Give the file of this arm (--arm)",
        )


def check_stop(robot: Robot, *, asked: bool) -> None:
    """Raise UsageError where a stop is asked of a robot whose link only reads."""
    if asked and RobotTraits.of(robot).reads_only:
        raise UsageError(
            f"{robot.name} is only read (reads_only), and cannot be stopped by it",
            consequence="Nothing is supervised",
            cure="Leave --stop-mm, --stop-deg and --stop-blind out; warnings stay",
        )


def doubts(
    limits: Limits, arm: Arm, world: World, latency_s: tuple[float, float] | None, failure: Exception | None
) -> Sequence[str]:
    """Return what to know of a supervision. latency_s: as it was taken, and its deviation; None where it was known."""
    notes = [f"supervision ended early: {failure}"] if failure is not None else []
    if not limits.all:
        notes.append("no level was set: nothing could raise an alarm")
    if world.covariance is None:
        notes.append("world.yaml says no uncertainty of the rig's place: none is counted")
    if arm.covariance is None:
        notes.append(
            "the arm's file says no uncertainty of its geometry: an error of the model looks like one of the arm"
        )
    if latency_s is not None:
        notes.append(
            f"the exposure's moment on the robot's clock is taken as {1e3 * latency_s[0]:.3g} +- "
            f"{1e3 * latency_s[1]:.2g} ms before a frame's arrival; verify finds it from poses and joints"
        )
    return notes


NOT_SUPERVISED = "Nothing is supervised: no picture could be held against the joints"


def setup_of(rig: Path, target: Path) -> Setup:
    """Return cameras and lights of files, as a live run measures them. Raises BadFile, and UsageError where they give
    no whole pose."""
    seen, lights = read_rig(rig, any_cameras=True), target_of(target)
    require_rotation(lights, NOT_SUPERVISED)
    setup = Setup(rig=seen, target=lights, settings=SpotSettings(colour=lights.colour), pace=live_pace())
    require_views(setup, len(seen.cameras))
    return setup


SIM = "sim:"


def open_supervised(
    link: RobotJob,
    rig: Rig,
    given: Mapping[str, str],
    target: Target,
    clock: Clock,
    arm: Arm | None,
    *,
    play: bool,
    camera_settings: CameraSettings,
    tell: Callable[[str], None] = told_later,
) -> Supervised:
    """Return the robot and the cameras given by a rig's names; nothing is opened yet. play: a simulated robot goes by
    itself. tell: takes what cameras have to tell.

    Raises UsageError, DeviceNotFound, BadFile.
    """
    if play and not link.robot.startswith(SIM):
        raise UsageError(f"--play is of simulated robots, and {link.robot} is none", cure="Leave --play away")
    if link.follow is not None:
        refuse_cameras(link.follow, **given)
        camera_settings.require_none(f"the simulated cell {link.follow}")
        robot = robot_of(link, clock, arm)
        cell = watching_cell(link.follow, robot, clock, cameras=rig.names)
        return Supervised(robot=robot, pairs=cell.pairs, origin_s=lambda: float(cell.origin_s))
    require_named(given)
    cameras = cameras_of(rig.names, given)
    if link.robot.startswith(SIM):
        refuse_settings(link)
        return _simulated(link.robot, cameras, clock, play, camera_settings)
    require_watching(cameras.values(), link.robot)
    robot = robot_of(link, clock, arm)
    pairs = open_cameras(cameras, colour=target.colour is not None, settings=camera_settings, tell=tell)
    return Supervised(robot=robot, pairs=told_apart(pairs, rig))


def _simulated(
    robot: str, cameras: Mapping[str, str], clock: Clock, play: bool, camera_settings: CameraSettings
) -> Supervised:
    name = robot.removeprefix(SIM)
    for side, text in cameras.items():
        if text != f"camera:sim:{name}:{side}":
            raise UsageError(f"{text} does not see the simulated robot {robot}", cure=f"Give camera:sim:{name}:{side}")
    camera_settings.require_none(f"the simulated robot {robot}")
    cell = live_cell(name, clock, play=play, cameras=tuple(cameras))
    return Supervised(robot=cell.robot, pairs=cell.pairs, origin_s=lambda: float(cell.origin_s))
