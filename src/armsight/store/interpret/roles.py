"""What each kind of table of ours holds."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

from armsight.columns import POSITION, QUATERNION, STEREO_PIXELS
from armsight.store.covariances import CAMERA_COVARIANCE, POSE_COLUMNS, POSE_EXTRAS, POSITION_COVARIANCE

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
