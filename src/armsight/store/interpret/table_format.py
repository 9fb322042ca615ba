"""What a person says about a table beside its header: flags that every command which reads tables takes."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from armsight.columns import QUATERNION
from armsight.errors import UsageError
from armsight.kinematics import Arm
from armsight.store.interpret.rotations import EulerOrder, RobotFormat, euler_order, robot_format
from armsight.units import DEG, MM


def _silent(text: str) -> None:
    """Tell nobody."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TableFormat:
    """What is said about a table: all empty for one of ours.

    euler: an order such as 'xyz-fixed'. columns: names for a table without a header, see column_names. robot: a name of
    ROBOT_FORMATS. units: such as 'mm,deg', of what the header leaves open. joints: the arm's joints by name, where an
    arm is known; following: the places of those that have no drive, which need no column; coupled: of those that the
    arm's file couples to others. pulses: per degree, of each axis. as_stated: units and orders are taken as stated
    though the numbers look otherwise. on_hand: whether the camera is on the hand, where it is known. body: which of a
    tracker's bodies, or which markers, see trackers. measured: euler, columns and units of what was measured, where
    they are others than the robot's. notify: called with what was understood, in words.
    """

    euler: str = ""
    columns: str = ""
    robot: str = ""
    units: str = ""
    joints: tuple[str, ...] = ()
    following: tuple[int, ...] = ()
    coupled: tuple[int, ...] = ()
    pulses: tuple[float, ...] = ()
    as_stated: bool = False
    on_hand: bool | None = None
    body: str = ""
    measured: tuple[str, str, str] | None = None
    notify: Callable[[str], None] = _silent

    @property
    def order(self) -> EulerOrder | None:
        """The order of Euler angles: that stated, else the robot's. Raises UsageError."""
        if self.euler:
            return euler_order(self.euler)
        return self.maker.euler if self.maker else None

    @property
    def maker(self) -> RobotFormat | None:
        """The robot maker's way. Raises UsageError."""
        return robot_format(self.robot) if self.robot else None

    def of_arm(self, arm: Arm) -> TableFormat:
        """Return it with the names of an arm's joints."""
        names = tuple(joint.name for joint in arm.joints)
        coupled = tuple(names.index(one.joint) for one in arm.couplings)
        return replace(self, joints=names, following=arm.undriven, coupled=coupled)

    @property
    def of_camera(self) -> TableFormat:
        """What is said, without what is said of the robot's own poses: for what a camera or a tracker measured."""
        if self.measured is None:
            return replace(self, robot="") if self.robot else self
        euler, columns, units = self.measured
        return replace(self, robot="", measured=None, euler=euler, columns=columns, units=units)

    @property
    def stated(self) -> bool:
        """Whether anything is said of what the columns are."""
        return bool(self.euler or self.columns or self.robot or self.units)

    def check(self) -> None:
        """Raise UsageError where anything stated is not known."""
        _ = self.order, self.names, self.length_m, self.angle_rad

    def unit(self, quantity: str, of_maker: float | None) -> float:
        """Return the SI value of the unit of columns that state none: of 'length', 'angle' or 'time'; else the maker's,
        or 1.

        Raises UsageError for units that are not known.
        """
        for name in filter(None, (part.strip().lower() for part in self.units.split(","))):
            if name not in UNITS:
                raise UsageError(f"--units {self.units!r}: {name!r} is no unit", cure="Write for instance mm,deg")
            if UNITS[name][0] == quantity:
                return UNITS[name][1]
        return 1.0 if of_maker is None else of_maker

    @property
    def length_m(self) -> float:
        """The unit of lengths that state none, in m. Raises UsageError."""
        return self.unit("length", self.maker.length_m if self.maker else None)

    @property
    def angle_rad(self) -> float:
        """The unit of a pose's angles that state none, in rad. Raises UsageError."""
        return self.unit("angle", self.maker.angle_rad if self.maker else None)

    @property
    def joint_rad(self) -> float:
        """The unit of joint values that state none, in rad. Raises UsageError."""
        return self.unit("angle", self.maker.joint_rad if self.maker else None)

    @property
    def time_s(self) -> float | None:
        """The unit of times that state none, in s; None where nothing is said. Raises UsageError."""
        return self.unit("time", 0.0) or None

    @property
    def names(self) -> tuple[str, ...]:
        """The columns' names that are stated, one per column. Raises UsageError."""
        return column_names(self.columns, self.maker) if self.columns else ()


OURS = TableFormat()
"""Nothing is said."""

TABLES = ("measured", "robot")
"""The two tables that some commands read."""
EXAMPLES = {
    "--units": "'measured:mm;robot:deg'",
    "--columns": "'measured:xyz_mm;robot:q1..q6_deg'",
    "--euler": "'measured:zyx;robot:xyz'",
}


def by_table(flag: str, text: str) -> tuple[str, str]:
    """Return what a flag says of what was measured, and of what the robot says: 'measured:mm;robot:deg', or both alike.

    Raises UsageError for a table of another name, and for one named twice.
    """
    if ":" not in text:
        return text, text
    said = dict.fromkeys(TABLES, "")
    parts = [part.partition(":") for part in text.split(";")]
    names = [name.strip() for name, _, _ in parts]
    if len(set(names)) < len(names) or not set(names) <= set(TABLES):
        raise UsageError(
            f"{flag} {text!r} is not of the tables measured and robot, each once",
            cure=f"Write for instance, in quotes, {flag} {EXAMPLES[flag]}; or one text for both",
        )
    said |= {name: word.strip() for name, (_, _, word) in zip(names, parts, strict=True)}
    return said["measured"], said["robot"]


_RANGE = re.compile(r"(?P<stem>.*?)(?P<first>\d+)\.\.(?P=stem)?(?P<last>\d+)(?P<unit>_[a-z]+)?")
_GROUP = re.compile(
    r"(?P<frame>(?:\w+_)??)(?P<what>xyz|quat_xyzw|quat_wxyz|rotvec|euler|T12|T|pose)(?P<unit>_(?:mm|cm|m|deg|rad))?"
)
SKIPPED = "-"
MOST_COLUMNS = 1000


def column_names(text: str, maker: RobotFormat | None = None) -> tuple[str, ...]:
    """Return the names of '--columns', groups written out.

    Names are separated by commas; '-' is a column that is not used. q1..q6_deg counts; xyz_mm, quat_xyzw, quat_wxyz,
    rotvec, euler_deg (in the stated order), T (4 x 4 row by row), T12 (3 x 4) and pose (as the robot format has it)
    stand for their columns, after a frame's name and '_' where there are two. Raises UsageError.
    """
    names: list[str] = []
    for token in (part.strip() for part in text.split(",")):
        if not token:
            raise UsageError(f"--columns {text!r} has an empty name", cure="Write - for a column that is not used")
        names += _written_out(token, maker)
        if len(names) > MOST_COLUMNS:
            raise UsageError(f"--columns names more than {MOST_COLUMNS} columns")
    twice = sorted({name for name in names if name != SKIPPED and names.count(name) > 1})
    if twice:
        raise UsageError(f"--columns names {twice[0]!r} twice", cure="Write - for a column that is not used")
    return tuple(names)


def _written_out(token: str, maker: RobotFormat | None) -> list[str]:
    counted = _RANGE.fullmatch(token)
    if counted is not None:
        first, last = int(counted["first"]), int(counted["last"])
        if not 0 <= last - first < MOST_COLUMNS:
            raise UsageError(f"{token!r} does not count up")
        return [f"{counted['stem']}{k}{counted['unit'] or ''}" for k in range(first, last + 1)]
    group = _GROUP.fullmatch(token)
    if group is None:
        return [token]
    frame, what, unit = group["frame"], group["what"], group["unit"] or ""
    if what in ("T", "T12"):
        rows = range(4 if what == "T" else 3)
        return [f"{frame}m{r}{c}{unit if c == 3 and r < 3 else ''}" for r in rows for c in range(4)]
    if what == "pose":
        if maker is None:
            raise UsageError("pose in --columns stands for a robot's own columns", cure="Give --robot-format too")
        return [frame + name for name in maker.columns]
    parts = {
        "xyz": ("x", "y", "z"),
        "quat_xyzw": QUATERNION,
        "quat_wxyz": ("qw", "qx", "qy", "qz"),
        "rotvec": ("rotvec_x", "rotvec_y", "rotvec_z"),
        "euler": ("euler_1", "euler_2", "euler_3"),
    }[what]
    return [frame + part + unit for part in parts]


UNITS: Mapping[str, tuple[str, float]] = {
    **dict.fromkeys(("meter", "meters", "metre", "metres"), ("length", 1.0)),
    **dict.fromkeys(("millimeter", "millimeters", "millimetre", "millimetres"), ("length", MM)),
    **dict.fromkeys(("centimeter", "centimeters", "centimetre", "centimetres"), ("length", 1e-2)),
    **dict.fromkeys(("radian", "radians"), ("angle", 1.0)),
    **dict.fromkeys(("second", "seconds", "secs"), ("time", 1.0)),
    **dict.fromkeys(("millisecond", "milliseconds", "msec"), ("time", 1e-3)),
    **dict.fromkeys(("microsecond", "microseconds", "usec"), ("time", 1e-6)),
    **dict.fromkeys(("nanosecond", "nanoseconds", "nsec"), ("time", 1e-9)),
    "inches": ("length", 0.0254),
    "m": ("length", 1.0),
    "mm": ("length", MM),
    "cm": ("length", 1e-2),
    "um": ("length", 1e-6),
    "in": ("length", 0.0254),
    "inch": ("length", 0.0254),
    "rad": ("angle", 1.0),
    "mrad": ("angle", 1e-3),
    "deg": ("angle", DEG),
    "degree": ("angle", DEG),
    "degrees": ("angle", DEG),
    "°": ("angle", DEG),
    "s": ("time", 1.0),
    "sec": ("time", 1.0),
    "ms": ("time", 1e-3),
    "us": ("time", 1e-6),
    "ns": ("time", 1e-9),
}
"""Kind of quantity, and the SI unit's part."""
