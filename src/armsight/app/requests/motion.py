"""What the commands are told that move a robot, or lead a target: servo, teach, play and robot jog."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

from armsight.defaults import APPROACH_SPEED_M_S, BLEND_M, PATH_SPEED_M_S, RETRACT_M
from armsight.errors import BadFile, UsageError
from armsight.fields import Bounds, Doc, Flag
from armsight.ops.flags import AN_ARM, KNOWN_ARM, OutFolder
from armsight.units import DEG, MM

if TYPE_CHECKING:
    from scipy.spatial.transform import RigidTransform

    from armsight.control.play import PlaySettings

CAMERAS, ARM, SIMULATED, WAY = "Cameras", "Arm and guard", "Simulated cell", "Way"
LATENCY_S = 0.03
"""From the middle of an exposure to the frame in memory, of cameras nobody has measured: two frames at 60 a second."""
STOP_M = 0.01
"""A tip that the cameras see further from where it was told to be has hit something, or is another one."""

RobotName: TypeAlias = Annotated[
    str,
    Doc("sim:SCENARIO, alter:/dev/PORT, rsi:UDP_PORT, egm:UDP_PORT, rtde:HOST[:PORT] or ws://HOST:PORT."),
    Flag("--robot", metavar="DRIVER:DEVICE"),
]
RsiConfig: TypeAlias = Annotated[
    Path | None, Doc("Of rsi: the RSI Ethernet configuration, for its own tags."), Flag(metavar="FILE.xml")
]


def settings_of(texts: list[str]) -> dict[str, Any]:
    """Return the settings of 'KEY=VALUE' texts; what is written with commas is several values. Raises UsageError."""
    made: dict[str, Any] = {}
    for text in texts:
        key, equals, value = text.partition("=")
        if not (key and equals and value) or key in made:
            raise UsageError(
                f"--robot-set {text!r} is {'given a second time' if key in made else 'not KEY=VALUE'}",
                consequence="The robot is not opened",
                cure="Write for instance --robot-set controller=192.168.0.10, each key once",
            )
        made[key] = value.split(",") if "," in value else value
    return made


RobotSettings: TypeAlias = Annotated[
    Mapping[str, Any] | None,
    Doc("A setting of the robot's driver, such as controller=192.168.0.10 or cycle_s=0.012; repeated."),
    Flag("--robot-set", metavar="KEY=VALUE", read=settings_of, repeated=True),
]
GuardLimits: TypeAlias = Annotated[Path | None, Doc("limits.yaml: what the guard keeps. [default: its own]")]
StandingWorld: TypeAlias = Annotated[Path | None, Doc("world.yaml: where cameras that stand are; without --robot.")]
JOINT, HOW_FAR, A_WAY = Doc("Which joint, from 1."), Doc("How far."), Flag(quantity="rad or m")
LIVE_SRC = Flag(metavar="SRC", panel=CAMERAS)
SHARE, UP_TO_1 = Doc("Share of the limits' speeds, up to 1."), Bounds(above=0.0, most=1.0)
Latency: TypeAlias = Annotated[
    float,
    Doc("From exposure to the frame in memory, s."),
    Bounds(least=0.0, most=10.0),
    Flag("--latency", panel=CAMERAS),
]
Exposure: TypeAlias = Annotated[float | None, Doc("Exposure, s."), Bounds(above=0.0), Flag("--exposure", panel=CAMERAS)]
LiveLeft: TypeAlias = Annotated[str | None, Doc("Left camera, camera:NAME."), LIVE_SRC]
LiveRight: TypeAlias = Annotated[str | None, Doc("Right camera, camera:NAME."), LIVE_SRC]
LiveImage: TypeAlias = Annotated[str | None, Doc("The one camera of a mirror rig, camera:NAME."), LIVE_SRC]
MirrorImage: TypeAlias = Annotated[str | None, Doc("The one camera of a mirror rig."), LIVE_SRC]
AnyLeft: TypeAlias = Annotated[str | None, Doc("Left camera, or its file."), LIVE_SRC]
AnyRight: TypeAlias = Annotated[str | None, Doc("Right camera, or its file."), LIVE_SRC]
ABOVE_0 = Bounds(above=0.0)
A_GAIN, A_LAG = Bounds(above=0.0, most=1000.0), Bounds(least=0.0, most=10.0)
Seconds: TypeAlias = Annotated[
    float | None, Doc("End after so long. [default: Ctrl-C]"), Bounds(above=0.0), Flag("--seconds")
]
Speed: TypeAlias = Annotated[float, SHARE, UP_TO_1, Flag(metavar="SHARE", panel=ARM)]
Override: TypeAlias = Annotated[
    float, Doc("Share of the planned speed, 0.01 to 1."), Bounds(least=0.01, most=1.0), Flag(metavar="SHARE")
]


def _not(given: bool) -> bool:
    return not given


def require_handeye(file: Path) -> None:
    """Raise BadFile where there is no hand-eye calibration."""
    if not file.exists():
        raise BadFile(
            f"the hand-eye calibration {file} is missing",
            consequence="Where the cameras are on the robot is not known, and nothing is moved",
            cure="Make it with: armsight calibrate handeye",
        )


@dataclass(frozen=True, kw_only=True)
class RobotJob:
    """The robot of a job, and what its driver is told; see drivers.link_settings.LinkSettings."""

    robot: RobotName
    robot_settings: RobotSettings = None
    rsi_config: RsiConfig = None


@dataclass(frozen=True, kw_only=True)
class ServoJob(RobotJob):
    """A robot that follows a target; left and right, or image: live cameras, of a simulated robot none.

    gain: of translation and rotation. rotation: see control.servo.Turning. predict: go for where the target will be.
    """

    rig: Annotated[Path, Doc("rig.yaml of the cameras.")]
    target: Annotated[Path, Doc("target.yaml of the lights that are followed.")]
    handeye: Annotated[Path, Doc("handeye.yaml: where the cameras are, on the flange or on the base.")]
    out: OutFolder
    distance_m: Annotated[
        float, Doc("How far along that axis the target is wanted."), Bounds(least=0.0), Flag(quantity="m")
    ] = 0.6
    at: Annotated[str, Doc("Whose axis the target is wanted on: camera or tool.")] = "camera"
    gain: Annotated[
        float | None, Doc("Gain in 1/s. [default: the largest without overshoot at the measured delay]"), A_GAIN
    ] = None
    rotation: Annotated[
        str,
        Doc(
            "align: turn until the target's axes are those of --at. keep: as the target first stood to it. "
            "hold: do not turn."
        ),
        Flag(metavar="align|keep|hold"),
    ] = "align"
    predict: Annotated[
        bool,
        Doc("The law alone, which lags behind by speed over gain."),
        Flag("--no-prediction", default=False, read=_not),
    ] = True
    seconds_s: Seconds = None
    left: LiveLeft = None
    right: LiveRight = None
    image: LiveImage = None
    latency_s: Latency = LATENCY_S
    exposure_s: Exposure = None
    arm: Annotated[
        Path | None, Doc(f"{KNOWN_ARM}; needed unless the robot tells it."), Flag(metavar="ARM", panel=ARM)
    ] = None
    limits: Annotated[Path | None, Doc("limits.yaml: what the guard keeps. [default: its own]"), Flag(panel=ARM)] = None
    speed: Speed = 1.0
    arm_lag_s: Annotated[
        float | None, Doc("From a command to the arm's motion, s. [default: two cycles]"), A_LAG, Flag(panel=ARM)
    ] = None
    resume_m: Annotated[
        float,
        Doc("A target that jumped is followed again by itself so near to where it would be."),
        Bounds(least=0.0, most=0.5),
        Flag(unit=MM),
    ] = 20.0 * MM
    resume_rad: Annotated[
        float, Doc("The same for its rotation."), Bounds(least=0.0, most=30.0 * DEG), Flag(unit=DEG)
    ] = 3.0 * DEG
    hand: Annotated[
        str | None,
        Doc("How the target is led: still, circle, trapezium or random. [default: as the scenario has it]"),
        Flag(panel=SIMULATED),
    ] = None
    hand_speed_m_s: Annotated[float, Doc("How fast."), Flag(quantity="m/s", panel=SIMULATED)] = 0.05


@dataclass(frozen=True, kw_only=True)
class FollowJob(ServoJob):
    """A servo while its target is led along a path: the same, told in the words of `armsight teach`."""

    robot: Annotated[
        str, Doc("Robot that follows the target meanwhile. [default: none]"), Flag(metavar="DRIVER:DEVICE")
    ]
    rig: Annotated[Path, Doc("rig.yaml of the cameras.")]
    target: Annotated[Path, Doc("target.yaml of the lights that are led along.")]
    handeye: Annotated[Path, Doc("handeye.yaml; with --robot.")]
    distance_m: Annotated[
        float, Doc("How far along that axis the target is kept."), Bounds(least=0.0), Flag(quantity="m", panel=ARM)
    ] = ServoJob.distance_m
    at: Annotated[str, Doc("Whose axis: camera or tool."), Flag(panel=ARM)] = ServoJob.at
    gain: Annotated[float | None, Doc("Gain in 1/s. [default: as servo]"), A_GAIN, Flag(panel=ARM)] = None
    rotation: Annotated[str, Doc("How the arm turns after the target: align, keep or hold."), Flag(panel=ARM)] = (
        ServoJob.rotation
    )
    predict: bool = ServoJob.predict
    seconds_s: float | None = None
    left: AnyLeft = None
    right: AnyRight = None
    image: MirrorImage = None
    arm: Annotated[Path | None, Doc(f"{KNOWN_ARM}."), Flag(metavar="ARM", panel=ARM)] = None
    limits: Annotated[Path | None, Doc("limits.yaml: what the guard keeps."), Flag(panel=ARM)] = None
    arm_lag_s: Annotated[float | None, Doc("From a command to the arm's motion, s."), A_LAG, Flag(panel=ARM)] = None
    resume_m: float = ServoJob.resume_m
    resume_rad: float = ServoJob.resume_rad
    hand: Annotated[
        str | None, Doc("How the target is led: still, circle, trapezium, random."), Flag(panel=SIMULATED)
    ] = None


@dataclass(frozen=True, kw_only=True)
class TeachJob:
    """A path that is led along, and how it is made of frames; without wait it begins with the first one."""

    out: OutFolder
    tip: Annotated[Path | None, Doc("tip.yaml of the needle, in target axes. [default: the target's origin]")] = None
    every: Annotated[int, Doc("Frames per pose of the path."), Bounds(least=1)] = 1
    mean: Annotated[bool, Doc("A pose is the mean of its frames, not the last one.")] = False
    path_speed_m_s: Annotated[
        float | None, Doc("Speed to be run at, written into the path. [default: left open]"), Flag(quantity="m/s")
    ] = None
    wait: Annotated[bool, Doc("Record nothing until the space key.")] = False

    def __post_init__(self) -> None:
        if self.path_speed_m_s is not None and not (math.isfinite(self.path_speed_m_s) and self.path_speed_m_s > 0.0):
            raise UsageError(
                f"--path-speed {self.path_speed_m_s:g} is no speed",
                consequence="Nothing is taught",
                cure="Give m/s, more than zero",
            )

    def T_target_tip(self) -> RigidTransform:
        """Return the tip in target axes. Raises BadFile."""
        from scipy.spatial.transform import RigidTransform

        from armsight.store.handeye_file import read_tip

        if self.tip is None:
            return RigidTransform.identity()
        return RigidTransform.from_translation(read_tip(self.tip).tip_m)


@dataclass(frozen=True, kw_only=True)
class StandingJob:
    """Cameras that stand, or files of them; without a world nothing is taught. seconds_s: of the frames' own time."""

    rig: Annotated[Path, Doc("rig.yaml of the cameras.")]
    target: Annotated[Path, Doc("target.yaml of the lights that are led along.")]
    world: StandingWorld = None
    left: AnyLeft = None
    right: AnyRight = None
    image: MirrorImage = None
    exposure_s: Exposure = None
    seconds_s: Seconds = None


@dataclass(frozen=True, kw_only=True)
class PlayJob(RobotJob):
    """A path, and the robot that runs it; cameras that watch, where any are given.

    path_speed_m_s, blend_m, approach_speed_m_s, retract_m, keep_rotation: see control.play.PlaySettings. stop_m: None:
    the arm stops nowhere for what is seen.
    """

    path: Annotated[Path, Doc("path.csv of the tip.")]
    out: OutFolder
    arm: Annotated[Path | None, Doc(f"{KNOWN_ARM}, calibrated; needed unless the robot tells it."), AN_ARM] = None
    tip: Annotated[Path | None, Doc("tip.yaml of the tool, in flange axes. [default: the arm's tool frame]")] = None
    limits: GuardLimits = None
    override: Override = 1.0
    weave: Annotated[
        str, Doc("none, sine:AMPLITUDE:WAVELENGTH or zigzag:AMPLITUDE:WAVELENGTH, m."), Flag(panel=WAY)
    ] = "none"
    path_speed_m_s: Annotated[
        float, Doc("Speed along the path where it says none."), ABOVE_0, Flag(quantity="m/s", panel=WAY)
    ] = PATH_SPEED_M_S
    blend_m: Annotated[float, Doc("Length over which corners are rounded."), ABOVE_0, Flag(quantity="m", panel=WAY)] = (
        BLEND_M
    )
    approach_speed_m_s: Annotated[
        float, Doc("Speed of the way to the path's start."), ABOVE_0, Flag(quantity="m/s", panel=WAY)
    ] = APPROACH_SPEED_M_S
    retract_m: Annotated[
        float,
        Doc("The start is neared from so far before it along the tool's axis."),
        Bounds(least=0.0),
        Flag(quantity="m", panel=WAY),
    ] = RETRACT_M
    keep_rotation: Annotated[bool, Doc("The tool keeps the rotation it has."), Flag(panel=WAY)] = False
    frame: Annotated[str, Doc("Frame of the path: world or base."), Flag(panel=WAY)] = "world"
    speed: Speed = 1.0
    rig: Annotated[Path | None, Doc("rig.yaml of cameras that watch."), Flag(panel=CAMERAS)] = None
    target: Annotated[Path | None, Doc("target.yaml they see."), Flag(panel=CAMERAS)] = None
    handeye: Annotated[Path | None, Doc("handeye.yaml of them."), Flag(panel=CAMERAS)] = None
    left: LiveLeft = None
    right: LiveRight = None
    image: MirrorImage = None
    latency_s: Latency = LATENCY_S
    exposure_s: Exposure = None
    stop_m: Annotated[
        float | None,
        Doc("Stop where the tip is seen so far from where it was told."),
        Flag("--stop-at", quantity="m", panel=CAMERAS),
    ] = STOP_M

    @property
    def watched(self) -> bool:
        """Whether cameras are to watch."""
        given = (self.rig, self.target, self.handeye, self.left, self.right, self.image)
        return any(value is not None for value in given)

    @property
    def settings(self) -> PlaySettings:
        """How the path is run. Raises UsageError."""
        from armsight.control.play import PlaySettings, Weave

        return PlaySettings(
            speed_m_s=self.path_speed_m_s,
            blend_m=self.blend_m,
            weave=Weave.parse(self.weave),
            approach_speed_m_s=self.approach_speed_m_s,
            retract_m=self.retract_m,
            keep_rotation=self.keep_rotation,
        )

    def cameras(self) -> ServoJob:
        """Return the cameras with their files. Raises UsageError where one is missing, BadFile for the hand-eye."""
        if self.rig is None or self.target is None or self.handeye is None:
            names = (("--rig", self.rig), ("--target", self.target), ("--handeye", self.handeye))
            missing = ", ".join(name for name, value in names if value is None)
            raise UsageError(
                f"cameras are to watch, and {missing} is missing",
                consequence="Where they see the tip cannot be told, and nothing is moved",
                cure="Give rig, target and hand-eye calibration, or none of them and no camera",
            )
        require_handeye(self.handeye)
        return ServoJob(
            robot=self.robot,
            robot_settings=self.robot_settings,
            rsi_config=self.rsi_config,
            rig=self.rig,
            target=self.target,
            handeye=self.handeye,
            out=self.out,
            left=self.left,
            right=self.right,
            image=self.image,
            latency_s=self.latency_s,
            exposure_s=self.exposure_s,
        )


@dataclass(frozen=True, kw_only=True)
class RobotTestJob(RobotJob):
    """A robot that is read for a time; nothing moves."""

    for_s: Annotated[
        float, Doc("How many seconds to read it."), Bounds(above=0.0, most=1e5), Flag("--for", metavar="S")
    ] = 5.0


@dataclass(frozen=True, kw_only=True)
class TwinJob:
    """An emulated controller."""

    name: Annotated[str, Doc("alter, rsi, egm or rtde."), Flag(positional=True, metavar="DRIVER")]
    port: Annotated[
        str | None, Doc("Where it listens; for alter a name for its serial line."), Flag(metavar="PORT")
    ] = None
    connect: Annotated[str | None, Doc("Where the driver listens, for rsi and egm."), Flag(metavar="HOST:PORT")] = None
    arm: Annotated[str | None, Doc(f"{KNOWN_ARM}."), AN_ARM] = None
    cycle_s: Annotated[float | None, Doc("The controller's cycle in s."), Bounds(least=1e-4, most=1.0)] = None


@dataclass(frozen=True, kw_only=True)
class JogJob(RobotJob):
    """One joint (from 1) and its way in rad or m."""

    joint: Annotated[int, JOINT]
    by: Annotated[float, HOW_FAR, A_WAY]
    speed: Annotated[float, SHARE, UP_TO_1, Flag(metavar="SHARE")] = 0.5
    arm: Annotated[Path | None, Doc(f"{KNOWN_ARM}; without it only joints are limited, and slow."), AN_ARM] = None
    limits: GuardLimits = None
    record: Annotated[Path | None, Doc("An .mcap file for commands, readings and events.")] = None


@dataclass(frozen=True, kw_only=True)
class HandJogJob(RobotJob):
    """An arm that is moved by hand; by: keyboard or gamepad[:DEVICE]."""

    hand: Annotated[
        str, Doc("Move by hand, while a key or the enable is held."), Flag("--with", metavar="keyboard|gamepad")
    ]
    frame: Annotated[str, Doc("Of --with: what moves, and along which axes."), Flag(metavar="joints|base|tool")] = (
        "joints"
    )
    speed: Annotated[float, SHARE, UP_TO_1, Flag(metavar="SHARE")] = 0.5
    arm: Annotated[Path | None, Doc(f"{KNOWN_ARM}; without it only joints are limited, and slow."), AN_ARM] = None
    limits: GuardLimits = None
    record: Annotated[Path | None, Doc("An .mcap file for commands, readings and events.")] = None
