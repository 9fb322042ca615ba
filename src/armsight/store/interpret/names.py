"""What a column's name says: whose pose or which joint, coordinate, unit; and what each kind of table of ours holds."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

from armsight.columns import POSITION, QUATERNION, STEREO_PIXELS
from armsight.store.covariances import CAMERA_COVARIANCE, POSE_COLUMNS, POSE_EXTRAS, POSITION_COVARIANCE
from armsight.store.interpret.table_format import UNITS, TableFormat

# frames of a pair: (whose pose, whether the name says it the other way round)
_LONG = ("flange", "gripper", "hand", "tool", "tool0", "ee", "tcp", "effector", "endeffector", "end_effector")
_HANDS = (*_LONG, "g", "h")
_TARGETS = ("target", "board", "marker", "object", "tag", "pattern", "checkerboard", "tracking", "optical", "t")
FRAMES: Mapping[str, tuple[str, bool]] = {
    **dict.fromkeys((*_LONG, "robot", "effector_wrt_world"), ("base_flange", False)),
    **{f"{base}_{hand}": ("base_flange", False) for base in ("base", "b", "world") for hand in _HANDS},
    **{f"{hand}_{base}": ("base_flange", True) for base in ("base", "b") for hand in _HANDS},
    **{f"{hand}2base": ("base_flange", False) for hand in _LONG},
    **{f"base2{hand}": ("base_flange", True) for hand in _LONG},
    "btg": ("base_flange", False),
    "bth": ("base_flange", False),
    **dict.fromkeys((*_TARGETS[:-1], "object_wrt_sensor"), ("camera_target", False)),
    **{f"{camera}_{target}": ("camera_target", False) for camera in ("camera", "cam", "c") for target in _TARGETS},
    **{f"{target}_{camera}": ("camera_target", True) for camera in ("camera", "cam", "c") for target in _TARGETS},
    **{f"{target}2{camera}": ("camera_target", False) for camera in ("camera", "cam") for target in _TARGETS[:-1]},
    **{f"{camera}2{target}": ("camera_target", True) for camera in ("camera", "cam") for target in _TARGETS[:-1]},
    "ctt": ("camera_target", False),
}

_X = "([xyz])"
_PATTERNS = tuple(
    (re.compile(pattern), kind)
    for pattern, kind in (
        (r"%?time|t|stamp|time_?stamp|secs?|header_stamp", "t"),
        (rf"{_X}|[pt]_?{_X}|(?:pos|position|translation|trans|xyz)_?{_X}|p_[a-z]+_[a-z]+_{_X}|{_X}_pos", "position"),
        (r"(?:q_?|quat_?|quaternion_?|orientation_?|rotation_?|q_[a-z]+_)([xyzw])", "quaternion"),
        (rf"(?:rotvec|rvec|rot_?vec|axis_?angle|rv)_?{_X}", "rotvec"),
        (rf"r{_X}|rot_?{_X}|euler_?{_X}|(roll|pitch|yaw)", "euler"),
        (r"euler_([123])", "sequence"),
        (r"(?:actual_|target_)?tcp_pose_([0-5])", "tcp"),
        (r"(?:m|r|t|h|rot|mat|matrix|o_t_ee)_?(\d_?\d|\d)", "cell"),
        (
            r"(?:q|j|jt|joint|axis|theta|th|a|(?:actual|target)_q|position|joint_?(?:position|angle)s?)_?(\d{1,2})",
            "joint",
        ),
    )
)
_BEFORE = (
    "actual arm base board camera command commanded current data desired ee effector end field flange "
    "gripper hand header joint joints laser marker measured message msg object orientation point pose "
    "poses position qtm robot rotation sample state states target tcp tool tool0 tracker transform "
    "translation world"
)
PREFIXES = frozenset(_BEFORE.split())
"""Words that may stand before a coordinate and do not change what it is: 'pose_position_x' is one, 'velocity_x' not."""
ROLL_PITCH_YAW: Mapping[str, str] = {"roll": "x", "pitch": "y", "yaw": "z"}
COMMANDED = frozenset(("command", "commanded", "desired"))
"""Words before what was asked for, not what was there; `target_` is that before joints and a controller's pose, and may
be a body's name elsewhere."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Meaning:
    """What one column is.

    name: as the file has it. frame: '' or a name of a pair's pose; inverse: the file holds that pose's inverse.
    kind: t, position, quaternion, rotvec, euler (by axis), sequence (by place in the order), tcp, cell (of a matrix) or
    joint. key: the coordinate within the kind; of joints the number as the file has it, or '=' and the place in
    TableFormat.joints. scale: to SI, None where no unit is stated. commanded: the name says it was asked for.
    """

    name: str
    kind: str
    key: str
    frame: str = ""
    inverse: bool = False
    scale: float | None = None
    commanded: bool = False


_BRACKET = re.compile(r"\s*[\[(]\s*(?P<unit>[^\])]*?)\s*[\])]\s*$")
_INDEX = re.compile(r"[\[(](\d+)[\])]")
_SEPARATORS = re.compile(r"[\s./:\-]+")


def split_unit(name: str) -> tuple[str, str]:
    """Return a column's name in lower case with '_' between its parts, and its unit, '' where none is stated.

    Both are empty where a unit is stated that is of no coordinate, such as m/s.
    """
    text = _INDEX.sub(r"_\1", name.strip().strip("\"'").lstrip("#%").strip())
    bracket, unit = _BRACKET.search(text), ""
    if bracket is not None:
        text, unit = text[: bracket.start()], bracket["unit"].lower()
    text = _SEPARATORS.sub("_", text).strip("_").lower()
    stem, _, tail = text.rpartition("_")
    if bracket is None and stem and tail in UNITS:
        return stem, tail
    return ("", "") if unit and unit not in UNITS else (text, unit)


def meaning(name: str, format_: TableFormat, *, frames: bool = False, joints: bool = True) -> Meaning | None:
    """Return what a column's name says, or None; frames: the table has two poses. joints: it has joint values."""
    named = _joint_by_name(name, format_.joints) if joints else None
    if named is not None:
        return named
    text, unit = split_unit(name)
    frame, inverse = "", False
    if frames:
        frame, inverse, text = _frame(text)
        format_ = format_.of_camera if frame == "camera_target" else format_
    scale = UNITS[unit][1] if unit else None
    parts = text.split("_")
    for k in range(len(parts)):
        before = parts[:k]
        if not PREFIXES.issuperset(before):
            break
        found = _kind("_".join(parts[k:]), format_, joints)
        if found is not None and (not unit or UNITS[unit][0] in QUANTITIES[found[0]]):
            asked = not COMMANDED.isdisjoint(before) or (found[0] in ("tcp", "joint") and parts[k] == "target")
            return Meaning(
                name=name, kind=found[0], key=found[1], frame=frame, inverse=inverse, scale=scale, commanded=asked
            )
    return None


QUANTITIES: Mapping[str, tuple[str, ...]] = {
    "t": ("time",),
    "position": ("length",),
    "quaternion": (),
    "rotvec": ("angle",),
    "euler": ("angle",),
    "sequence": ("angle",),
    "tcp": ("length", "angle"),
    "cell": ("length",),
    "joint": ("angle", "length"),
}
"""What the unit of each kind of column may measure."""


def _frame(text: str) -> tuple[str, bool, str]:
    """Return the frame that a name begins with, whether it is said the other way round, and the rest."""
    lead = text[2:] if text[:2] in ("t_", "r_") and len(text) > 2 else text
    for name in sorted(FRAMES, key=len, reverse=True):
        for start in (text, lead):
            if start.startswith(f"{name}_") and len(start) > len(name) + 1:
                return *FRAMES[name], start[len(name) + 1 :]
    return "", False, text


def _kind(text: str, format_: TableFormat, joints: bool) -> tuple[str, str] | None:
    """Return kind and key of a name without its frame and unit."""
    maker = format_.maker
    if maker is not None and text in maker.angles:
        if len(maker.angles) == 4:
            return _matched(text, joints) if joints else ("quaternion", "wxyz"[maker.angles.index(text)])
        number = str(maker.angles.index(text) + 1)
        return ("sequence", number) if maker.euler is not None else ("rotvec", "xyz"[int(number) - 1])
    return _matched(text, joints)


def _matched(text: str, joints: bool) -> tuple[str, str] | None:
    for pattern, kind in _PATTERNS:
        match = pattern.fullmatch(text)
        if match is None or (kind == "joint" and not joints):
            continue
        key = "".join(value for value in match.groups() if value is not None)
        return kind, ROLL_PITCH_YAW.get(key, key)
    return None


def _joint_by_name(name: str, joints: tuple[str, ...]) -> Meaning | None:
    text = name.strip().strip("\"'").lstrip("#%").strip()
    bracket, unit = _BRACKET.search(text), ""
    if bracket is not None:
        text, unit = text[: bracket.start()], bracket["unit"].lower()
    parts = re.split(r"[/.\s]+", text)
    for k, joint in enumerate(joints):
        for part in parts:
            if part == joint or (part.startswith(f"{joint}_") and part[len(joint) + 1 :] in UNITS):
                unit = unit or part[len(joint) + 1 :]
                if any(word in parts for word in ("velocity", "effort")):
                    return None
                return Meaning(name=name, kind="joint", key=f"={k}", scale=UNITS[unit][1] if unit in UNITS else None)
    return None


POSE = (*POSITION, *QUATERNION)
POSE_FURTHER = (*POSE_COLUMNS[8:], *POSE_EXTRAS)
PAIR_FRAMES = ("base_flange", "camera_target")


@dataclass(frozen=True, slots=True, kw_only=True)
class Role:
    """A kind of table: its frames ('' where the table has one pose without a name, () where it has none), whether a
    position, a rotation, joints and a time are wanted, can be there ('maybe') or not; words: columns of text by the
    names that people give them; extras: further columns of ours that are kept as they are."""

    name: str
    frames: tuple[str, ...] = ("",)
    position: str = "wanted"
    rotation: str = "wanted"
    joints: str = "no"
    time: str = "no"
    words: Mapping[str, Collection[str]] = field(default_factory=dict)
    extras: tuple[str, ...] = ()
    keeps_unknown: bool = False

    @property
    def counts_rows(self) -> bool:
        """Whether rows without a time are counted."""
        return self.name.startswith("untimed")

    @property
    def known(self) -> set[str]:
        """The columns of ours that the table may have, joints aside."""
        poses = {f"{frame}_{cell}" if frame else cell for frame in self.frames for cell in POSE}
        return poses | set(self.words) | set(self.extras) | ({"t_s"} if self.time != "no" else set())

    @property
    def required(self) -> set[str]:
        """The columns of ours that it must have to be one of ours, joints aside."""
        cells = POSE if self.rotation == "wanted" else POSITION if self.position == "wanted" else ()
        poses = {f"{frame}_{cell}" if frame else cell for frame in self.frames for cell in cells}
        time = {"t_s"} if self.time == "wanted" else set()
        return poses | time | ({"q1"} if self.joints == "wanted" else set())


IMAGES = ("image", "img", "filename", "file_name", "image_file", "frame_name")

ROLES: Mapping[str, Role] = {
    role.name: role
    for role in (
        Role(name="joints", frames=(), joints="wanted", time="wanted"),
        Role(name="untimed-joints", frames=(), joints="wanted", time="maybe"),
        Role(name="poses", time="wanted", extras=POSE_FURTHER),
        Role(name="untimed-poses", time="maybe", extras=POSE_FURTHER),
        Role(name="robot_poses", words={"file": IMAGES}),
        Role(name="pairs", frames=PAIR_FRAMES, extras=CAMERA_COVARIANCE),
        Role(
            name="points",
            rotation="maybe",
            joints="wanted",
            time="maybe",
            words={"point": ("reflector", "smr", "prism")},
            extras=tuple(dict.fromkeys((*POSE_FURTHER, *POSITION_COVARIANCE))),
        ),
        Role(name="measured", rotation="maybe", joints="maybe", time="maybe", keeps_unknown=True),
        Role(name="reported", frames=(), joints="wanted", time="maybe", keeps_unknown=True),
        Role(
            name="sweep",
            position="maybe",
            rotation="maybe",
            joints="wanted",
            extras=("joint", *STEREO_PIXELS, "std_px"),
        ),
        Role(name="sweep_joints", frames=(), joints="wanted", extras=("frame", "joint")),
    )
}
"""By name; 'untimed-' where time plays no part and rows are counted where no time is there."""
