"""Is the arm where it says it is: of files, before live cameras or a tracker; and the plan of a test."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias

from armsight.defaults import JOINT_STD, LATENCY_STD_S
from armsight.fields import Bounds, Doc, Flag, Flags
from armsight.file_names import ERRORS, PLAN, PLAN_SUMMARY, REPORT, VERIFY
from armsight.file_names import LIVE as RECORDING
from armsight.ops.action import action
from armsight.ops.flags import (
    AN_ARM,
    KNOWN_ARM,
    LIVE,
    Base,
    Cameras,
    JointStd,
    Latency,
    LatencyStd,
    Tip,
    Tracker,
    TrackerBody,
    TrackerStd,
    TrackerStdRad,
    TwoTables,
)
from armsight.ops.kinds import CHAIN, ArmLike, AsFile, CamerasLike, JointsFile, MeasuredFile, WorldFile
from armsight.ops.requests.motion import LATENCY_S, FollowedCell, RobotJob, RobotSettings
from armsight.ops.requests.plant import PlantFlags
from armsight.units import DEG, MM

if TYPE_CHECKING:
    from armsight.clock import Clock
    from armsight.ops.requests.plant import Publishing
    from armsight.ops.verification.supervising import Show, Supervised
    from armsight.records import Progress
    from armsight.verify.iso9283.plan import VerifyPlanOutput
    from armsight.verify.live import VerifyLiveOutput
    from armsight.verify.results import VerifyResult

__all__ = ["plan_verification", "supervise", "verify"]

Out: TypeAlias = Annotated[Path | None, Doc("Where the results go."), Flag("-o --out", metavar="FOLDER")]
AnArm: TypeAlias = Annotated[Any, Doc(f"{KNOWN_ARM}."), CHAIN, AN_ARM]
OneArm: TypeAlias = Annotated[ArmLike, Doc(f"{KNOWN_ARM}.")]
RigFile: TypeAlias = Annotated[AsFile, Doc("rig.yaml of the cameras."), Flag(panel=LIVE)]
TargetFile: TypeAlias = Annotated[AsFile, Doc("target.yaml of the lights on the tool."), Flag(panel=LIVE)]


@action(
    "verify",
    keeps=(VERIFY, ERRORS, REPORT),
    examples=(
        "--arm arm.yaml --measured poses.csv --joints joints.csv -o verified",
        "--live --robot rtde:192.168.1.10 --left camera:0 --right camera:1 --rig rig.yaml --target target.yaml "
        "--arm arm.yaml --world world.yaml -o live",
    ),
    filed=True,
    judged=True,
    writes="write_verified",
    page="verify_pages:verification",
)
def verify(
    measured: MeasuredFile,
    *,
    arm: AnArm | None = None,
    joints: JointsFile = None,
    commanded: Annotated[AsFile, Doc("Instead of an arm: the poses that were commanded."), Flag(metavar="FILE")] = None,
    world: WorldFile = None,
    align: Annotated[
        Literal["none", "base", "tool", "both"] | None,
        Doc("What is laid where it fits best. [default: both; none with --world]"),
        Flag(metavar="none|base|tool|both", read=str),
    ] = None,
    compare: Annotated[
        AsFile, Doc("An earlier run, to stand beside this one in the report."), Flag(metavar="FOLDER")
    ] = None,
    band_m: Annotated[
        float | None,
        Doc(
            "For rows with a column arrival: the limit band that the arm settles into. [default: the pose "
            "repeatability of the same pose]"
        ),
        Flag(quantity="m"),
    ] = None,
    tip: Tip = None,
    base: Base = None,
    table: TwoTables | None = None,
    out: Out = None,
) -> VerifyResult:
    """Return how measured poses differ from where the arm says it is, and what the difference comes from.

    Parameters
    ----------
    measured
        Poses or points: a file, a PoseTrack, columns by name, (t_s, T). With columns pose and visit, or run, also the
        figures of ISO 9283, in `iso9283`.
    arm, joints
        Where the arm says it is: an Arm, a preset's name or a file, and the controller's readings (t_s, q).
    commanded
        Instead of an arm: the poses that were commanded.
    world
        T_base_rig, where the measuring rig stands: nothing is then aligned.
    align
        What is laid where it fits best; else both, and none with world.
    compare
        The folder of an earlier run.
    band_m
        The limit band of arrivals at a pose.
    tip, base
        Of a URDF: the last link of the arm and its base link.
    table
        What is said of a foreign table: units, columns, the robot's maker.
    out
        A folder for verify.json, errors.csv and report.html; None writes nothing.

    Raises
    ------
    NotEnoughData, Inconsistent, Degenerate
        Rows that cannot carry the answer.
    UsageError
        Parameters that mean nothing together.

    Examples
    --------
    >>> arm = armsight.presets.ur10()
    >>> q = np.random.default_rng(1).uniform(-1.5, 1.5, (40, 6))
    >>> armsight.verify(arm.fk(q), arm=arm, joints=q, align="none").after.rms_m < 1e-9
    True
    """
    from armsight.ops.verification import run
    from armsight.store import read_world
    from armsight.store.interpret import OURS
    from armsight.store.verify_files import read_measured
    from armsight.verify import Align

    links, folders = (tip, base), (compare, out)
    run.check_usage(
        arm=arm, joints=joints, commanded=commanded, links=links, align=align, band_m=band_m, folders=folders
    )
    tables, expected = table or OURS, None
    earlier = None if compare is None else run.read_run(compare)
    file = read_measured(measured, tables.of_camera)
    how = None if align is None else Align(align)
    if world is not None:
        stand = read_world(world)
        file, how = run.file_in_world(file, stand), how or Align.NONE
        # measured in base, and so expected there
        arm = arm.based() if arm is not None and stand.parent == "base" else arm
    if commanded is not None:
        expected = run.commands_of(commanded, tables)
    elif arm is not None:
        expected = run.readings_of(arm, file, measured, joints, tables)
    done = run.verified(file, expected, how, band_m)
    return done if earlier is None else run.beside(done, compare, earlier)


@action("verify", keeps=(PLAN, PLAN_SUMMARY), writes="write_planned_test")
def plan_verification(
    arm: AnArm,
    out: Out = None,
    part: Annotated[
        str,
        Doc("With --plan: which part of the test. [default: cube, all]"),
        Flag(positional=True, metavar="[cube|poses|paths]", default=None),
    ] = "cube",
    *,
    side_m: Annotated[
        float | None, Doc("With --plan: the cube's side. [default: the largest that fits]"), Flag(quantity="m")
    ] = None,
    speed_m_s: Annotated[float | None, Doc("With --plan: the speed along the paths."), Flag(quantity="m/s")] = None,
    tip: Tip = None,
    base: Base = None,
    progress: Progress | None = None,
) -> VerifyPlanOutput:
    """Write plan.csv, the test of ISO 9283 for an arm, into a folder, and return what it holds.

    part: cube (all), poses, paths, or a motion's name. side_m: of the cube; else the largest that fits. speed_m_s:
    along the paths. tip, base: as `verify` takes them. Raises UsageError, DataRefused where no cube fits.

    Examples
    --------
    >>> armsight.plan_verification("irb120", folder / "plan", "poses", side_m=0.1).cube.side_m
    0.1
    """
    from armsight.verify.iso9283.plan import PlanOptions, chosen_motions, plan_test

    options = PlanOptions(side_m=side_m)
    if speed_m_s is not None:
        options = replace(options, speed_m_s=speed_m_s)
    return chosen_motions(plan_test(arm, options, progress), part)


@action(
    "verify",
    working="supervising",
    keeps=(VERIFY, ERRORS, REPORT, RECORDING),
    writes="write_verified",
    page="verify_pages:live_report",
)
def supervise(
    robot: Annotated[str, Doc("Whose joints are read."), Flag(metavar="DRIVER:DEVICE", panel=LIVE)],
    rig: RigFile,
    target: TargetFile,
    left: Annotated[str | None, Doc("The left camera: camera:NAME."), Flag(metavar="SRC", panel=LIVE)],
    right: Annotated[str | None, Doc("The right camera."), Flag(metavar="SRC", panel=LIVE)],
    arm: OneArm,
    world: WorldFile,
    *,
    cameras: CamerasLike = None,
    follow: FollowedCell = None,
    tracker: Tracker = None,
    body: TrackerBody = "",
    tracker_std_m: TrackerStd = None,
    tracker_std_rad: TrackerStdRad = None,
    warn_m: Annotated[float | None, Doc("Error of place that warns."), Flag(unit=MM, panel=LIVE)] = None,
    stop_m: Annotated[float | None, Doc("Error of place that stops the robot."), Flag(unit=MM, panel=LIVE)] = None,
    warn_rad: Annotated[float | None, Doc("Error of rotation that warns."), Flag(unit=DEG, panel=LIVE)] = None,
    stop_rad: Annotated[float | None, Doc("Error of rotation that stops it."), Flag(unit=DEG, panel=LIVE)] = None,
    blind_stop_s: Annotated[
        float | None, Doc("Stop where nothing is seen for so long."), Flag("--stop-blind", metavar="S", panel=LIVE)
    ] = None,
    joint_std: JointStd = JOINT_STD,
    latency_s: Latency = LATENCY_S,
    latency_std_s: LatencyStd = LATENCY_STD_S,
    seconds_s: Annotated[float | None, Doc("End after so long."), Bounds(above=0.0), Flag(panel=LIVE)] = None,
    frames: Annotated[int | None, Doc("End after so many pairs."), Bounds(least=1), Flag(panel=LIVE)] = None,
    keep_frames: Annotated[bool, Doc("Keep the images in the recording too."), Flag(panel=LIVE)] = False,
    play: Annotated[bool, Doc("A simulated robot goes its scenario's way by itself."), Flag(panel=LIVE)] = False,
    robot_settings: RobotSettings = None,
    rsi_config: Annotated[
        AsFile, Doc("Of rsi: the RSI Ethernet configuration, for its own tags."), Flag(metavar="FILE.xml")
    ] = None,
    plant: Annotated[Publishing | None, Flags(PlantFlags)] = None,
    camera_settings: Cameras | None = None,
    out: Out = None,
    progress: Progress | None = None,
    show: Show | None = None,
    tell: Callable[[str], None] | None = None,
    clock: Clock | None = None,
    devices: Supervised | None = None,
) -> VerifyLiveOutput:
    """Watch a running arm with cameras, stop it where it is not where it says, and return what was seen.

    Parameters
    ----------
    robot, left, right, cameras
        As identify_arm_live takes them, or cameras by the rig's names, and robot_settings, rsi_config and follow.
    rig, target
        Of the cameras; None with a tracker.
    tracker, body, tracker_std_m, tracker_std_rad
        Instead of cameras a tracker, which measures by itself, its body on the tool, and what its poses may be off.
    arm, world
        Where the arm should be: its geometry, and where the rig, or the tracker, stands (T_base_rig).
    warn_m, stop_m, warn_rad, stop_rad
        Errors that warn, and that stop the robot.
    blind_stop_s
        Stop where nothing was seen for so long.
    joint_std, latency_s, latency_std_s
        Of a reading (rad, m); from exposure to frame in memory, and how well that is known.
    seconds_s, frames
        When to end.
    keep_frames, out
        The images too; a folder for report and recording.
    play
        A simulated robot goes its scenario's way by itself.
    plant, tell
        What publishes it to a plant's systems, and what takes their notes.
    show
        Is told of every pair: pose, what was compared, level, and what was lost.
    clock, devices
        In place of the machine's and of those named.

    Raises
    ------
    UsageError, DataRefused, DeviceFailed
        Nothing could be compared, or a device failed; what was seen until then is written all the same.
    """
    from armsight.clock import SystemClock
    from armsight.drivers import AUTOMATIC, RobotTraits
    from armsight.ops.given import Given as Folder
    from armsight.ops.measurement.warm_up import prepare
    from armsight.ops.sources.cameras import named_cameras
    from armsight.ops.verification import eyes, live
    from armsight.ops.verification.supervising import Supervision
    from armsight.records import Silent
    from armsight.store import read_world
    from armsight.verify.live import live_output
    from armsight.verify.supervision import Limits, PredictedPose

    limits = Limits(warn_m=warn_m, stop_m=stop_m, warn_rad=warn_rad, stop_rad=stop_rad)
    clock, progress = clock or SystemClock(), progress or Silent()
    stand = read_world(world)
    live.check_times(latency_s, latency_std_s, blind_stop_s, joint_std)
    link = RobotJob(robot=robot, robot_settings=robot_settings, rsi_config=rsi_config, follow=follow)
    views = named_cameras(cameras or {}, left, right)
    live.check_eyes(
        tracker,
        {"--rig": rig, "--target": target, "cameras": views, "--keep-frames": keep_frames, "--play": play},
        {"--body": body, "--tracker-std": tracker_std_m, "--tracker-std-deg": tracker_std_rad},
    )
    if tracker is not None:
        watch: eyes.Eyes = eyes.TrackerEyes()
        devices = devices or live.open_tracked(link, tracker, body, (tracker_std_m, tracker_std_rad), clock, arm)
    else:
        setup = live.setup_of(rig, target)
        watch = eyes.CameraEyes(setup, (rig, target), frames=keep_frames)
        devices = devices or live.open_supervised(
            *(link, setup.rig, views, setup.target, clock, arm),
            play=play,
            camera_settings=camera_settings or AUTOMATIC,
        )
        prepare(progress, views=not setup.rig.is_pair)
    expectation = PredictedPose(
        arm=arm if stand.parent == "world" else arm.based(),
        T_parent_rig=stand.T_parent_rig,
        rig_covariance=None if stand.covariance is None else stand.covariance.matrix,
        joint_std=max(joint_std, RobotTraits.of(devices.robot).reading_std),
        time_std_s=0.0 if devices.origin_s is not None else latency_std_s,
        turns=watch.turns,
    )
    live.check_arm(arm, devices)
    live.check_stop(devices.robot, asked=stop_m is not None or stop_rad is not None or blind_stop_s is not None)
    run = Supervision(watch, expectation, devices, clock, limits, latency_s=latency_s, blind_stop_s=blind_stop_s)
    run.show, run.tell = show or run.show, tell or run.tell
    with Folder(out) as folder:
        recording = folder.out / RECORDING
        failure = live.supervise_until_ended(
            run,
            lambda stack: run.open(stack, recording),
            lambda: run.ended(seconds_s, frames),
            plant,
            progress,
        )
    latency = None if devices.origin_s is not None else (latency_s, latency_std_s)
    known = [
        *live.doubts(limits, arm, stand, latency, failure),
        *live.tracker_doubts(tracker, tracker_std_m is not None and tracker_std_rad is not None),
        *(one.contradiction for one in run.contradictions),
    ]
    done = live_output(run.judge.log, recording=str(recording), doubts=known, of_pair=watch.of_pair)
    if failure is not None:
        raise live.with_kept(failure, done, out)
    return done
