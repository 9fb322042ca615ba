"""What commands are told of a robot: its link, what its guard keeps, and the live cameras beside it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

from armsight.errors import UsageError
from armsight.fields import Bounds, Doc, Flag
from armsight.ops.flags import AN_ARM, KNOWN_ARM

if TYPE_CHECKING:
    from armsight.ops.robot.opening import ClockedRobot

CAMERAS, ARM, SIMULATED, WAY = "Cameras", "Arm and guard", "Simulated cell", "Way"
LATENCY_S = 0.03
"""From the middle of an exposure to the frame in memory, of cameras nobody has measured: two frames at 60 a second."""
STOP_M = 0.01
"""A tip that the cameras see further from where it was told to be has hit something, or is another one."""

RobotName: TypeAlias = Annotated[
    str,
    Doc(
        "sim:SCENARIO, rsi:UDP_PORT, egm:UDP_PORT, rtde:HOST[:PORT], ws://HOST:PORT, or alter:, feetech: or "
        "dynamixel:/dev/PORT."
    ),
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
ABOVE_0 = Bounds(above=0.0)
A_GAIN, A_LAG = Bounds(above=0.0, most=1000.0), Bounds(least=0.0, most=10.0)
Seconds: TypeAlias = Annotated[
    float | None, Doc("End after so long. [default: Ctrl-C]"), Bounds(above=0.0), Flag("--seconds")
]
Speed: TypeAlias = Annotated[float, SHARE, UP_TO_1, Flag(metavar="SHARE", panel=ARM)]
Override: TypeAlias = Annotated[
    float, Doc("Share of the planned speed, 0.01 to 1."), Bounds(least=0.01, most=1.0), Flag(metavar="SHARE")
]


HandSpeed: TypeAlias = Annotated[float, Doc("How fast."), Bounds(least=0.0), Flag(quantity="m/s", panel=SIMULATED)]


def negated(given: bool) -> bool:
    """Return the value of what a flag such as --no-prediction switches off."""
    return not given


FollowedCell: TypeAlias = Annotated[
    str | None,
    Doc("Simulated cameras of this scenario, in place of named ones, watch the joints that the robot tells."),
    Flag("--follow", metavar="SCENARIO", panel=SIMULATED),
]


def refuse_cameras(follow: str, **given: object) -> None:
    """Raise UsageError for cameras that are named beside a scenario, which has its own."""
    named = ", ".join(f"--{name}" for name, value in given.items() if value is not None)
    if named:
        raise UsageError(
            f"{named} is given beside --follow {follow}, which has its own cameras",
            consequence="Nothing is opened",
            cure="Leave it out, or --follow",
        )


def require_named(cameras: Mapping[str, str]) -> None:
    """Raise UsageError where no camera is named."""
    if not cameras:
        raise UsageError(
            "which cameras see the robot is not said",
            consequence="Nothing is opened",
            cure="Give --left and --right, --camera NAME=SRC for each of another rig, or --follow SCENARIO for "
            "simulated ones",
        )


@dataclass(frozen=True, kw_only=True)
class RobotJob:
    """A robot by what people call it, and what its driver is told; see drivers.link_settings.LinkSettings.

    device: the robot itself and its clock; None: the one that is named. follow: a scenario whose cameras watch it.
    """

    robot: RobotName
    robot_settings: RobotSettings = None
    rsi_config: RsiConfig = None
    device: ClockedRobot | None = None
    follow: str | None = None


@dataclass(frozen=True, kw_only=True)
class TwinJob:
    """An emulated controller."""

    name: Annotated[
        str,
        Doc("alter, rsi, egm, rtde, feetech, dynamixel, or linuxcnc (the real one)."),
        Flag(positional=True, metavar="DRIVER"),
    ]
    port: Annotated[
        str | None, Doc("Where it listens; for alter a name for its serial line."), Flag(metavar="PORT")
    ] = None
    connect: Annotated[str | None, Doc("Where the driver listens, for rsi and egm."), Flag(metavar="HOST:PORT")] = None
    arm: Annotated[str | None, Doc(f"{KNOWN_ARM}."), AN_ARM] = None
    cycle_s: Annotated[float | None, Doc("The controller's cycle in s."), Bounds(least=1e-4, most=1.0)] = None
