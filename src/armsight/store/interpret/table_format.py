"""What a person says about a table beside its header: flags that every command which reads tables takes."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass

from armsight.errors import UsageError
from armsight.store.interpret.rotations import EulerOrder, RobotFormat, euler_order, robot_format


def _silent(text: str) -> None:
    """Tell nobody."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TableFormat:
    """What is said about a table: all empty for one of ours.

    euler: an order such as 'xyz-fixed'; columns: names for a table without a header, see column_names; robot: a name
    of ROBOT_FORMATS; joints: the arm's joints by name, where one is known; as_stated: units and orders are taken as
    stated though the numbers look otherwise. tell: called with what was understood, in words.
    """

    euler: str = ""
    columns: str = ""
    robot: str = ""
    joints: tuple[str, ...] = ()
    as_stated: bool = False
    tell: Callable[[str], None] = _silent

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

    @property
    def names(self) -> tuple[str, ...]:
        """The columns' names that are stated, one per column. Raises UsageError."""
        return column_names(self.columns, self.maker) if self.columns else ()


OURS = TableFormat()
"""Nothing is said."""

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
        return [f"{frame}m{row}{column}" for row in range(4 if what == "T" else 3) for column in range(4)]
    if what == "pose":
        if maker is None:
            raise UsageError("pose in --columns stands for a robot's own columns", cure="Give --robot-format too")
        return [frame + name for name in maker.columns]
    parts = {
        "xyz": ("x", "y", "z"),
        "quat_xyzw": ("qx", "qy", "qz", "qw"),
        "quat_wxyz": ("qw", "qx", "qy", "qz"),
        "rotvec": ("rotvec_x", "rotvec_y", "rotvec_z"),
        "euler": ("euler_1", "euler_2", "euler_3"),
    }[what]
    return [frame + part + unit for part in parts]
