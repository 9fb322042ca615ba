"""A path taught by leading a target along it: before cameras that stand, before an arm that follows, or measured."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated, Any, Literal

from armsight.defaults import HAND_SPEED_M_S
from armsight.fields import Bounds, Doc, Flag
from armsight.file_names import TAUGHT
from armsight.ops.action import Input, action, action_of
from armsight.ops.flags import KNOWN_ARM
from armsight.ops.kinds import FRAMES, ROBOT_READERS, AnyRigLike, AsFile, CamerasLike, Confirm, TargetLike, WorldLike
from armsight.ops.motion import DISTANCE_M, MOVED_ARM, Folder, servo
from armsight.ops.requests.motion import (
    A_GAIN,
    A_LAG,
    ARM,
    LATENCY_S,
    LIVE_SRC,
    SIMULATED,
    Exposure,
    FollowedCell,
    HandSpeed,
    Latency,
    RsiConfig,
    Seconds,
    Speed,
)
from armsight.ops.requests.motion import RobotSettings as Settings

if TYPE_CHECKING:
    from armsight.control.status import RobotStatus
    from armsight.control.teach import PathRecorder
    from armsight.ops.teaching import TeachResult
    from armsight.records import Progress

__all__ = ["teach"]


@action(
    "teach",
    keeps=TAUGHT,
    working="teaching",
    examples=(
        "--robot sim:pachidis2005-circle --rig rig.yaml --target target.yaml --handeye handeye.yaml -o taught",
        "--left camera:0 --right camera:1 --rig rig.yaml --target target.yaml --world world.yaml --tip tip.yaml "
        "-o taught",
        "--from measured/poses.csv --tip tip.yaml -o taught",
    ),
)
def teach(
    rig: Annotated[AnyRigLike, Doc("rig.yaml of the cameras.")] = None,
    target: Annotated[TargetLike, Doc("target.yaml of the lights that are led along.")] = None,
    left: Annotated[Any, Doc("Left camera, or its file."), FRAMES, LIVE_SRC] = None,
    right: Annotated[Any, Doc("Right camera, or its file."), FRAMES, LIVE_SRC] = None,
    *,
    cameras: CamerasLike = None,
    image: Annotated[Any, Doc("The one camera of a mirror rig."), FRAMES, LIVE_SRC] = None,
    world: Annotated[WorldLike, Doc("world.yaml: where cameras that stand are; without --robot.")] = None,
    poses: Annotated[
        AsFile, Doc("Make the path of poses that were measured."), Flag("--from", metavar="poses.csv")
    ] = None,
    robot: Annotated[
        Any,
        Doc("Robot that follows the target meanwhile. [default: none]"),
        Input(f"{ROBOT_READERS}:robot", kind=str),
        Flag("--robot", metavar="DRIVER:DEVICE"),
    ] = None,
    robot_settings: Settings = None,
    rsi_config: RsiConfig = None,
    handeye: Annotated[AsFile, Doc("handeye.yaml; with --robot.")] = None,
    confirm: Confirm = False,
    out: Folder = None,
    tip: Annotated[
        Any,
        Doc("tip.yaml of the needle, in target axes. [default: the target's origin]"),
        Input(f"{ROBOT_READERS}:tip"),
    ] = None,
    every: Annotated[int, Doc("Frames per pose of the path."), Bounds(least=1)] = 1,
    mean: Annotated[bool, Doc("A pose is the mean of its frames, not the last one.")] = False,
    path_speed_m_s: Annotated[
        float | None, Doc("Speed to be run at, written into the path. [default: left open]"), Flag(quantity="m/s")
    ] = None,
    wait: Annotated[bool, Doc("Record nothing until the space key.")] = False,
    seconds_s: Seconds = None,
    distance_m: Annotated[
        float, Doc("How far along that axis the target is kept."), Bounds(least=0.0), Flag(quantity="m", panel=ARM)
    ] = DISTANCE_M,
    at: Annotated[Literal["camera", "tool"], Doc("Whose axis: camera or tool."), Flag(read=str, panel=ARM)] = "camera",
    gain: Annotated[float | None, Doc("Gain in 1/s. [default: as servo]"), A_GAIN, Flag(panel=ARM)] = None,
    rotation: Annotated[
        Literal["align", "keep", "hold"],
        Doc("How the arm turns after the target: align, keep or hold."),
        Flag(read=str, panel=ARM),
    ] = "align",
    latency_s: Latency = LATENCY_S,
    exposure_s: Exposure = None,
    arm: Annotated[Any, Doc(f"{KNOWN_ARM}."), *MOVED_ARM] = None,
    limits: Annotated[AsFile, Doc("limits.yaml: what the guard keeps."), Flag(panel=ARM)] = None,
    speed: Speed = 1.0,
    arm_lag_s: Annotated[float | None, Doc("From a command to the arm's motion, s."), A_LAG, Flag(panel=ARM)] = None,
    hand: Annotated[
        Literal["still", "circle", "trapezium", "random"] | None,
        Doc("How the target is led: still, circle, trapezium, random."),
        Flag(read=str, panel=SIMULATED),
    ] = None,
    hand_speed_m_s: HandSpeed = HAND_SPEED_M_S,
    follow: FollowedCell = None,
    show: Callable[[RobotStatus, float | None], object] = lambda *_: None,
    begun: Callable[[PathRecorder], object] = lambda _: None,
    progress: Progress | None = None,
) -> TeachResult:
    """Teach a path by leading the target along it: the path of the tip at each exposure goes into OUT/path.csv.

    With --robot the arm follows meanwhile; without one the cameras stand (--world), or --from takes poses.csv.

    Parameters
    ----------
    rig, target, left, right, cameras, image
        As `measure` takes them; with robot as `servo` does.
    world
        T_base_rig of cameras that stand.
    poses
        Instead of frames: poses that were measured, as `measure` returns them.
    robot, handeye, confirm, robot_settings, rsi_config, follow, show
        The arm that follows, as `servo` takes them.
    tip
        The result of calibrate_tool_tip, or tip.yaml; else the target's origin.
    every, mean
        Frames per row of the path, and whether a row is their mean.
    path_speed_m_s
        Written into the path.
    wait
        Record nothing until `start()` of what begun is given.
    begun
        Is given the recorder before the first frame that counts: `start()`, `pause()`, `undo()`, `tag(...)` steer it.
    out
        A folder for path.csv and teach.json.

    Raises
    ------
    NotEnoughData
        Less than two poses.
    UsageError, DataRefused, DeviceFailed
        As measure and servo; what was taught until then is in the files.

    Examples
    --------
    >>> cell = armsight.simulate("hand-cell", frames=4)
    >>> seen = armsight.measure(cell.rig, cell.target, [f.left for f in cell], [f.right for f in cell])
    >>> len(armsight.teach(poses=seen.poses).taught)
    4
    """
    from armsight.measure.poses.pipeline import Setup
    from armsight.measure.settings import SpotSettings
    from armsight.ops import teaching as parts
    from armsight.ops.robot.robot_run import as_question
    from armsight.ops.servo.cameras import CameraNames
    from armsight.ops.sources.pace import pace_of
    from armsight.records import Silent
    from armsight.store import read_poses

    parts.require_speed(path_speed_m_s)
    if poses is not None:
        parts.refuse_beside("--from", {"robot": robot, "rig": rig, "left": left, "camera": cameras, "image": image})
        recorder = parts.standing_recorder(world, tip, every=every, mean=mean)
        recorder.start()
        for pose in read_poses(poses):
            recorder.observe(pose, pose.t_s)
        return parts.Lesson(recorder, out, path_speed_m_s).result("end")
    rig, target = parts.require_eyes(rig, target, robot, handeye)
    if robot is None:
        parts.refuse_beside(
            "no --robot", {"handeye": handeye, "arm": arm, "limits": limits, "hand": hand, "follow": follow}
        )
        parts.require_world(world)
        eyes = CameraNames.of(cameras, left, right, image, exposure_s)
        moments, overlaid = parts.require_moments(eyes.moments(rig, target))
        recorder = parts.standing_recorder(world, tip, every=every, mean=mean)
        setup = Setup(
            rig=rig,
            target=target,
            settings=SpotSettings(colour=target.colour),
            overlaid=overlaid,
            pace=pace_of(*eyes.named().values()),
        )
        if not wait:
            recorder.start()
        begun(recorder)
        lesson = parts.Lesson(recorder, out, path_speed_m_s)
        return parts.teach_standing(lesson, setup, moments, seconds_s, progress or Silent())
    parts.refuse_beside("--robot", {"world": world})
    beside, asked = parts.TaughtBeside(tip, every=every, mean=mean), as_question(confirm)
    lesson = parts.Lesson(beside.recorder, out, path_speed_m_s)

    def agreed(question: str) -> bool:
        may = asked(question)
        if may:
            begun(beside.recorder)
        return may

    if not wait:
        beside.recorder.start()
    with lesson.kept():
        done: Any = action_of(servo).run(
            {
                "robot": robot,
                "rig": rig,
                "target": target,
                "handeye": handeye,
                "confirm": agreed,
                "out": out,
                "distance_m": distance_m,
                "at": at,
                "gain": gain,
                "rotation": rotation,
                "seconds_s": seconds_s,
                "left": left,
                "right": right,
                "cameras": cameras,
                "image": image,
                "latency_s": latency_s,
                "exposure_s": exposure_s,
                "arm": arm,
                "limits": limits,
                "speed": speed,
                "arm_lag_s": arm_lag_s,
                "hand": hand,
                "hand_speed_m_s": hand_speed_m_s,
                "show": show,
                "beside": beside,
                "progress": progress,
            }
        )
    return lesson.result(done.stopped_by, done)
