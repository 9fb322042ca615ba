"""Fields that several requests have, and groups of flags that make one object together."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

from armsight.errors import UsageError
from armsight.fields import Bounds, Doc, Flag, Flags, loaded
from armsight.units import DEG, MM, read_quantity

if TYPE_CHECKING:
    from armsight.calibrate.handeye import Setup
    from armsight.drivers import CameraSettings
    from armsight.store.interpret import TableFormat

SRC = (
    "a folder of images, a quoted 'pattern*.png', a video, a recording.mcap, bag:FILE:/topic, or camera:0, "
    "camera:aravis:NAME"
)
BOARD = (
    "checkerboard:9x6:0.025 (inner corners, square in m), circles:, acircles:, "
    "charuco:8x5:0.04:0.03:DICT_4X4_50, aprilgrid:6x6:0.088:0.3 or a file: target.yaml, Kalibr's aprilgrid.yaml"
)
KNOWN_ARM = "arm.yaml, .urdf or a known arm's name such as ur5e"
HISTORY_PLACE = (
    "File (SQLite) or postgresql:// URL of the history. [default: $ARMSIGHT_HISTORY, or in the user's data folder]"
)
OUT = Flag("-o --out")
A_SRC = Flag(metavar="SRC")
AN_ARM = Flag(metavar="ARM")

OutFolder: TypeAlias = Annotated[Path, Doc("Where the results go."), Flag("-o --out", metavar="FOLDER")]
Left: TypeAlias = Annotated[str | None, Doc(f"Left frames: {SRC}."), A_SRC]
Right: TypeAlias = Annotated[str | None, Doc("Right frames, in step with the left ones."), A_SRC]
Every: TypeAlias = Annotated[int, Doc("Use every n-th frame, for videos."), Bounds(least=1)]
Limit: TypeAlias = Annotated[int | None, Doc("Stop after so many."), Bounds(least=1), Flag("--frames")]
Fps: TypeAlias = Annotated[
    float | None, Doc("Frames a second, where none brings its time. [default: 30]"), Bounds(least=1e-6)
]
Threshold: TypeAlias = Annotated[
    float | None, Doc("Grey level that counts as light. [default: automatic]"), Bounds(least=0.0, most=255.0)
]
Inverted: TypeAlias = Annotated[bool, Doc("Look for dark spots on a bright ground.")]
Workers: TypeAlias = Annotated[
    int | None, Doc("Threads that read and search images. [default: all cores]"), Bounds(least=1)
]
Bits: TypeAlias = Annotated[
    int | None, Doc("Bits that carry the light in 16-bit image files, such as 12."), Flag(metavar="N")
]
Strict: TypeAlias = Annotated[bool, Doc("Stop at an image file that cannot be read, in place of going on without it.")]
Tip: TypeAlias = Annotated[str | None, Doc("Of a URDF that branches: the last link of the arm."), Flag(metavar="LINK")]
Base: TypeAlias = Annotated[
    str | None, Doc("Of a URDF: the arm's base link. [default: the root]"), Flag(metavar="LINK")
]
UnitLength: TypeAlias = Annotated[
    float | None,
    Doc("Length of the unit of another program's file in m. [default: 1, asked for beyond 1 m]"),
    Bounds(least=1e-9),
    Flag("--unit"),
]
MaxSkew: TypeAlias = Annotated[
    float | None,
    Doc("Largest time in s between live frames of a pair. [default: 1/60]"),
    Bounds(least=0.0),
    Flag("--max-skew"),
]


CAMERAS = "Live cameras (all the same)"
LIVE, MASTERING = "With --live", "With --mastering"
TABLES = "Tables that are not armsight's own (see the guide: tables)"


Tracker: TypeAlias = Annotated[
    str | None,
    Doc("Instead of cameras: qtm:HOST[:PORT] or natnet:HOST[:PORT][:unicast]."),
    Flag(metavar="DRIVER:HOST", panel=LIVE),
]
TrackerBody: TypeAlias = Annotated[
    str, Doc("Of a tracker: the body on the tool. [default: the only one]"), Flag(metavar="NAME", panel=LIVE)
]
TrackerStd: TypeAlias = Annotated[
    float | None,
    Doc("How far a tracker's position may be off (standard deviation), mm. [default: 0.3]"),
    Flag("--tracker-std", unit=MM, panel=LIVE),
]
TrackerStdRad: TypeAlias = Annotated[
    float | None, Doc("... and its rotation, deg. [default: 0.3]"), Flag("--tracker-std-deg", unit=DEG, panel=LIVE)
]
JointStd: TypeAlias = Annotated[
    float,
    Doc("Of a joint reading, deg (a slide: m x 57). [default: 0.001; of coarse encoders more]"),
    Flag("--joint-std", unit=DEG, default=None, panel=LIVE),
]
Latency: TypeAlias = Annotated[
    float, Doc("From exposure to frame in memory, s. [default: 0.03]"), Flag(default=None, panel=LIVE)
]
LatencyStd: TypeAlias = Annotated[
    float, Doc("How well that is known, s. [default: 0.01]"), Flag(default=None, panel=LIVE)
]


@dataclass(frozen=True, kw_only=True)
class CameraFlags:
    """The settings of live cameras."""

    exposure_s: Annotated[float | None, Doc("Lock the exposure, in s."), Flag(metavar="S", panel=CAMERAS)] = None
    gain: Annotated[
        float | None,
        Doc("Lock the gain: in dB with GenICam, else in the driver's unit."),
        Flag(metavar="GAIN", panel=CAMERAS),
    ] = None
    focus: Annotated[
        float | None, Doc("Lock the focus, in the driver's unit."), Flag(metavar="VALUE", panel=CAMERAS)
    ] = None
    white_balance_k: Annotated[
        float | None, Doc("Lock the white balance, in kelvin."), Flag(metavar="K", panel=CAMERAS)
    ] = None
    trigger: Annotated[
        str | None,
        Doc("GenICam: expose at the edges of this input, such as Line1."),
        Flag(metavar="LINE", panel=CAMERAS),
    ] = None
    pixel_format: Annotated[
        str | None, Doc("GenICam: such as Mono8 or BayerRG8; 8 bits."), Flag(metavar="NAME", panel=CAMERAS)
    ] = None

    def made(self, notify: Callable[[str], None]) -> CameraSettings:
        """Return the settings. Raises UsageError for a value that no camera can have."""
        from armsight.drivers import CameraSettings

        return CameraSettings(**asdict(self))


@dataclass(frozen=True, kw_only=True)
class TableFlags:
    """What is said about tables that are not ours."""

    euler: Annotated[
        str, Doc("Order of Euler angles: xyz-fixed, zyx, zyz ..."), Flag(metavar="ORDER", panel=TABLES)
    ] = ""
    columns: Annotated[
        str, Doc("Names where no header is: q1..q6_deg,xyz_mm,quat_wxyz,-"), Flag(metavar="NAMES", panel=TABLES)
    ] = ""
    robot_format: Annotated[
        str,
        Doc("The robot's poses and joints are written as by abb, fanuc, kuka, staubli, ur, yaskawa ..."),
        Flag(metavar="MAKER", panel=TABLES),
    ] = ""
    units: Annotated[
        str,
        Doc("Where the header states none: mm,deg. Where two tables are read, of each: 'measured:mm;robot:deg'"),
        Flag(metavar="UNITS", panel=TABLES),
    ] = ""
    body: Annotated[
        str,
        Doc("Of a tracker's file: the body, the group of markers, or markers as A,B,C."),
        Flag(metavar="NAME", panel=TABLES),
    ] = ""
    as_stated: Annotated[
        bool, Doc("Take units and orders as stated though the numbers look otherwise."), Flag(panel=TABLES)
    ] = False
    pulses_per_degree: Annotated[
        str, Doc("Of joint values in pulses: one number for each axis."), Flag(metavar="S,L,U,...", panel=TABLES)
    ] = ""

    def made(self, notify: Callable[[str], None]) -> TableFormat:
        """Return them as the readers take them; what was understood is told."""
        from armsight.store.interpret import TableFormat

        given = asdict(self)
        pulses = pulses_of(given.pop("pulses_per_degree"))
        return TableFormat(robot=given.pop("robot_format"), pulses=pulses, notify=notify, **given)


@dataclass(frozen=True, kw_only=True)
class TwoTableFlags(TableFlags):
    """The same where a command reads what was measured and what the robot says: each may have its own."""

    def made(self, notify: Callable[[str], None]) -> TableFormat:
        """Return them as the readers take them. Raises UsageError for a table that the command has not."""
        from armsight.store.interpret.table_format import by_table

        euler, columns, units = (
            by_table(flag, text)
            for flag, text in (("--euler", self.euler), ("--columns", self.columns), ("--units", self.units))
        )
        robots = replace(self, euler=euler[1], columns=columns[1], units=units[1])
        return replace(TableFlags.made(robots, notify), measured=(euler[0], columns[0], units[0]))


Cameras: TypeAlias = Annotated["CameraSettings", Flags(CameraFlags)]
Table: TypeAlias = Annotated["TableFormat", Flags(TableFlags)]
TwoTables: TypeAlias = Annotated["TableFormat", Flags(TwoTableFlags)]


automatic = loaded("armsight.drivers:AUTOMATIC")
"""What is asked of cameras where nobody says: nothing."""
ours = loaded("armsight.store.interpret:OURS")
"""What is said of tables: that they are our own."""
on_hand = loaded("armsight.calibrate.handeye:Setup.EYE_IN_HAND")
"""Where the camera is: on the hand."""


def setup_called(name: str) -> Setup:
    """Return where the camera is, by its name. Raises UsageError."""
    from armsight.calibrate.handeye import Setup

    if name not in tuple(Setup):
        raise UsageError(f"no setup is called {name!r}; there are {', '.join(Setup)}")
    return Setup(name)


def point_of(text: str) -> tuple[float, float, float]:
    """Return the point of 'X,Y,Z', m or with units. Raises UsageError."""
    try:
        x, y, z = (read_quantity(cell, "m") for cell in text.split(","))
    except ValueError:
        raise UsageError(f"the point {text!r} is not X,Y,Z", cure="Write for instance 0.2,1.25,0.08, in m") from None
    return x, y, z


def pulses_of(text: str) -> tuple[float, ...]:
    """Return the numbers of 'S,L,U,R,B,T', none for ''. Raises UsageError."""
    try:
        ratios = tuple(float(cell) for cell in text.split(",")) if text else ()
    except ValueError:
        ratios = (0.0,)
    if not all(math.isfinite(ratio) and ratio != 0.0 for ratio in ratios):
        raise UsageError(
            f"--pulses-per-degree {text!r} is no list of numbers other than 0",
            cure="Write one for each axis: 1435.1,1140.6,-957.2,682.7,682.7,455.1",
        )
    return ratios


def lengths_of(texts: list[str] | tuple[str, ...]) -> list[tuple[str, str, float, float | None]]:
    """Return (a, b, m, standard deviation or None) of each 'A,B,270mm[,0.02mm]'; of a radius 'A,30mm' b is ''.

    Raises UsageError.
    """
    found = []
    for text in texts:
        cells = [cell.strip() for cell in text.split(",")]
        numbers: list[float] = []
        while len(cells) > 1 and len(numbers) < 2 and (value := _length(cells[-1])) is not None:
            numbers.insert(0, value)
            cells.pop()
        if not numbers or not 1 <= len(cells) <= 2 or not all(cells) or min(numbers) <= 0.0:
            raise UsageError(
                f"the length {text!r} is not A,B,LENGTH or A,RADIUS",
                cure="Write for instance --length left,right,270mm or --length ball,19mm,0.01mm: names of the table, "
                "the length, and its standard deviation",
            )
        found.append((cells[0], cells[1] if len(cells) > 1 else "", numbers[0], numbers[1] if numbers[1:] else None))
    return found


def cameras_of(texts: list[str] | tuple[str, ...]) -> dict[str, str]:
    """Return source by camera of each 'NAME=SRC'. Raises UsageError, also for a name that is there twice."""
    found: dict[str, str] = {}
    for text in texts:
        name, equals, source = text.partition("=")
        if not (name and equals and source):
            raise UsageError(
                f"--camera {text!r} is not NAME=SRC",
                consequence="It is open which camera is meant",
                cure="Write for instance --camera top=camera:2, the name as in rig.yaml",
            )
        if name in found:
            raise UsageError(
                f"two sources are given of the camera {name}: {found[name]} and {source}",
                consequence="It is open which are its frames",
                cure="Give each camera once, by its own name",
            )
        found[name] = source
    return found


def _length(text: str) -> float | None:
    try:
        return read_quantity(text, "m")
    except ValueError:
        return None


def size_of(text: str) -> tuple[int, int]:
    """Return (width, height) of '640x480'. Raises UsageError."""
    match = re.fullmatch(r"([1-9][0-9]{0,5})[xX]([1-9][0-9]{0,5})", text)
    if match is None:
        raise UsageError(f"the size {text!r} is not WIDTHxHEIGHT", cure="Write for instance 640x480")
    return int(match[1]), int(match[2])
