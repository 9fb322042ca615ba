"""A scenario file's structure, checked: what each key means and what it may be.

Lengths in m, angles in degrees, times in s. Reached by name through the entry points `armsight.scenarios`: the text is
read elsewhere, this takes the mapping. `sim.scenario_builder` makes the world.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from armsight_sim.lens import ZoomLens
from armsight_sim.scenario_keys import (
    EventKeys,
    Finite,
    Keys,
    NotNegative,
    PipelineChoice,
    PipelineKeys,
    PoseKeys,
    Positive,
    RoomChoice,
    RoomKeys,
    Vector2,
    Vector3,
)
from armsight_sim.scenario_motions import FollowedMotion, RobotMotion, joint_rows
from armsight_sim.scene import ALL_BEFORE_IT_DEG
from armsight_sim.sensor import Sensor

MOST_CAMERAS = 8
TAKEN = frozenset({"rig", "image", "complex", "all", "both", "left", "right"})
Share = Annotated[float, Field(ge=0.0, lt=1.0)]
Count = Annotated[int, Field(ge=1, le=100_000)]
Vector5 = Annotated[list[Finite], Field(min_length=5, max_length=5)]


class JointKeys(Keys):
    """One joint, standard Denavit-Hartenberg; lower, upper in degrees or m; max_speed in rad/s or m/s."""

    name: str
    type: Literal["revolute", "prismatic"] = "revolute"
    a_m: Finite = 0.0
    alpha_deg: Finite = 0.0
    d_m: Finite = 0.0
    theta_deg: Finite = 0.0
    lower: Finite | None = None
    upper: Finite | None = None
    max_speed: Positive
    radius_m: NotNegative = 0.0

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.lower is not None and self.upper is not None and not self.lower < self.upper:
            raise ValueError(f"lower {self.lower:g} is not below upper {self.upper:g}")
        return self


class ErrorKeys(Keys):
    """How far the true arm is from the nominal one: standard deviations, drawn from the seed."""

    length_m: NotNegative = 0.0
    angle_deg: NotNegative = 0.0


class VibrationKeys(Keys):
    """Vibration of the flange along each of its axes."""

    amplitude_m: NotNegative = 0.0
    hz: Positive = 10.0


class ArmKeys(Keys):
    """The robot. cycle_s, lag_s: of its controller and servos; steps: of an encoder per turn, or per m of a slide.

    T_base_frame0: where the first joint's row begins.
    """

    joints: Annotated[list[JointKeys], Field(min_length=1, max_length=12)]
    T_world_base: PoseKeys = PoseKeys()
    T_base_frame0: PoseKeys = PoseKeys()
    error: ErrorKeys = ErrorKeys()
    cycle_s: Annotated[float, Field(ge=0.0005, le=1.0)]
    lag_s: NotNegative = 0.0
    steps: Positive
    vibration: VibrationKeys = VibrationKeys()
    max_speed_m_s: Positive | None = None
    max_speed_deg_s: Positive | None = None


ZOOM, SENSOR = ZoomLens(width=1280, height=720), Sensor()
"""What a lens and a sensor are where a scenario says nothing else."""


class ZoomKeys(Keys):
    """A zoom lens of two thin groups (sim.lens): its setting, the ends of its range, lengths in mm; see there."""

    at: Finite = ZOOM.zoom[0]
    range: Annotated[list[Finite], Field(min_length=2, max_length=2)] = Field(default=list(ZOOM.zoom))
    wide_mm: Positive = ZOOM.wide_mm
    ratio: Annotated[float, Field(gt=1.0, le=30.0)] = ZOOM.ratio
    front_mm: Annotated[float, Field(lt=0.0)] = ZOOM.front_mm
    rear_mm: Positive = ZOOM.rear_mm
    cam: Literal["distance", "focal", "log_focal"] = "log_focal"
    bend: Vector2 = Field(default=list(ZOOM.bend))
    focus_mm: Positive = ZOOM.focus_mm
    barrel: Finite = ZOOM.barrel
    cushion: Finite = ZOOM.cushion


class LensKeys(Keys):
    """A lens: focal lengths and principal point in px, distortion k1, k2, p1, p2, k3, of a fisheye k1, k2, k3, k4, of
    a rational lens k1, k2, p1, p2, k3, k4, k5, k6.

    With zoom the focal length is that at the wide end, and the distortion is the zoom lens's own.
    """

    fx: Positive
    fy: Positive
    cx: Finite
    cy: Finite
    lens: Literal["pinhole", "fisheye", "rational"] = "pinhole"
    distortion: Annotated[list[Finite], Field(max_length=8)] = Field(default=[0.0, 0.0, 0.0, 0.0, 0.0])
    zoom: ZoomKeys | None = None

    @model_validator(mode="after")
    def _one_lens(self) -> Self:
        n = {"fisheye": 4, "rational": 8}.get(self.lens, 5)
        if len(self.distortion) != n and any(self.distortion):
            raise ValueError(f"distortion of a {self.lens} lens has {n} numbers, not {len(self.distortion)}")
        if self.lens != "pinhole" and self.zoom is not None:
            raise ValueError(f"zoom: a {self.lens} lens does not zoom here")
        if self.zoom is not None and any(self.distortion):
            raise ValueError("zoom brings its own distortion: leave distortion away, or give zoom.barrel and cushion")
        return self


class RightKeys(LensKeys):
    """The right camera or another, and where it stands in the axes of the left one, which are the rig's."""

    T_rig_camera: PoseKeys


class MirrorKeys(Keys):
    """The mirrors before the one lens of a mirror rig; tilts_rad of mirrors 1 to 4: about the vertical, and across."""

    baseline_m: Positive
    plate_m: NotNegative
    index: Annotated[float, Field(ge=1.0, le=4.0)]
    near_m: Positive
    gap_m: Positive
    tilts_rad: tuple[tuple[Finite, Finite], ...] = Field(default=((0.0, 0.0),) * 4, min_length=4, max_length=4)


class SensorKeys(Keys):
    """Noise: electrons per grey level, read noise in grey levels; ambient light and unevenness in grey levels."""

    electrons_per_level: Positive = SENSOR.electrons_per_level
    read_noise_level: NotNegative = SENSOR.read_noise_level
    ambient_level: NotNegative = 9.0
    hot_pixels: Annotated[int, Field(ge=0, le=10_000)] = 0


CameraName = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_-]{0,15}$")]


class CameraKeys(Keys):
    """The rig: two cameras (left, right), or left with others by name, right among them or not; or one behind mirrors.

    On the world's ground or the flange. `others: {}` and no right is the left camera alone.
    """

    width: Annotated[int, Field(ge=16, le=8192)]
    height: Annotated[int, Field(ge=16, le=8192)]
    colour: bool = False
    left: LensKeys
    right: RightKeys | None = None
    others: Annotated[dict[CameraName, RightKeys], Field(max_length=7)] | None = None
    mirrors: MirrorKeys | None = None
    mount: Literal["base", "flange"]
    T_mount_rig: PoseKeys
    exposure_s: NotNegative = 0.0
    readout_s: NotNegative = 0.0
    jitter_s: NotNegative = 0.0
    latency_s: NotNegative = 0.0
    drop: Share = 0.0
    sensor: SensorKeys = SensorKeys()
    pipeline: PipelineChoice = PipelineKeys()

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        if (self.right is None and self.others is None) == (self.mirrors is None):
            raise ValueError("give either right (two cameras) or mirrors (one camera)")
        taken = TAKEN & (self.others or {}).keys()
        if taken:
            raise ValueError(f"others: {', '.join(sorted(taken))} is no name of another camera")
        if len(self.lenses) > MOST_CAMERAS:
            raise ValueError(f"others: a rig has {MOST_CAMERAS} cameras at most, not {len(self.lenses)}")
        placed = {name: np.array(keys.T_rig_camera.xyz_m) for name, keys in self.placed.items()}
        if self.right is not None and not np.linalg.norm(placed["right"]) > 1e-6:
            raise ValueError("right.T_rig_camera.xyz_m puts both cameras in one place: there is no depth")
        for (one, at), (other, there) in combinations({"left": np.zeros(3), **placed}.items(), 2):
            if not np.linalg.norm(at - there) > 1e-6:
                raise ValueError(f"T_rig_camera.xyz_m puts the cameras {one} and {other} in one place")
        if self.mirrors is not None and self.left.zoom is not None:
            raise ValueError("left.zoom: a lens behind mirrors does not zoom here")
        if self.mirrors is not None and self.mirrors.gap_m <= 2.0 * self.mirrors.plate_m:
            raise ValueError("mirrors.gap_m leaves no room for the plate of mirrors.plate_m")
        return self

    @property
    def placed(self) -> dict[str, RightKeys]:
        """All cameras but the left one, by name, in the rig's order."""
        return ({} if self.right is None else {"right": self.right}) | (self.others or {})

    @property
    def lenses(self) -> dict[str, LensKeys]:
        """All cameras by name, in the rig's order."""
        return {"left": self.left, **self.placed}


class TargetKeys(Keys):
    """The lights; in target axes, z pointing away from the cameras. carried by the flange or not by the robot.

    facing: where each shines, in target axes, up to wide_deg from there; -z, and all before it, where not given.
    """

    spots_m: Annotated[dict[str, Vector3], Field(min_length=1, max_length=64)]
    level: Annotated[float, Field(gt=0.0, le=5000.0)]
    sigma_px: Annotated[float, Field(ge=0.3, le=50.0)]
    diameter_m: Positive | None = None
    colour: Literal["red", "green", "blue"] | None = None
    everywhere: bool = False
    facing: dict[str, Vector3] | None = None
    wide_deg: Annotated[float, Field(gt=0.0, le=ALL_BEFORE_IT_DEG)] = ALL_BEFORE_IT_DEG
    T_flange_target: PoseKeys | None = None

    @model_validator(mode="after")
    def _apart(self) -> Self:
        if self.facing is not None and (self.everywhere or self.facing.keys() != self.spots_m.keys()):
            raise ValueError("facing needs a direction of every light, and contradicts everywhere")
        if self.facing is not None and not all(any(way) for way in self.facing.values()):
            raise ValueError("facing: a direction of no length is none")
        places = np.array(list(self.spots_m.values()))
        gaps = np.linalg.norm(places[:, None] - places[None], axis=2) + np.eye(len(places))
        if gaps.min() < 1e-4:
            raise ValueError("two of spots_m are in one place")
        if self.everywhere and self.diameter_m is not None:
            raise ValueError("everywhere and diameter_m contradict each other: a flat disc shines one way")
        return self


class Scenario(Keys):
    """A scenario file; zoom: the setting of all zoom lenses, in place of their own `at`."""

    format: Literal["armsight/scenario"]
    version: Literal[1]
    name: Annotated[str, Field(min_length=1, max_length=100)]
    about: str = ""
    seed: Annotated[int, Field(ge=0)] = 1
    frames: Count
    fps: Annotated[float, Field(gt=0.0, le=1000.0)]
    arm: ArmKeys
    cameras: CameraKeys
    zoom: Finite | None = None
    target: TargetKeys
    room: RoomChoice = RoomKeys()
    motion: Annotated[RobotMotion | FollowedMotion, Field(discriminator="kind")]
    events: list[EventKeys] = Field(default=[])

    @model_validator(mode="after")
    def _fits(self) -> Self:
        self._check_who_moves()
        for key, values in joint_rows(self.motion):
            self._check_row(key, values)
        cameras = [*self.cameras.lenses, *(("right",) if self.cameras.mirrors else ()), "both", "all"]
        for event in self.events:
            if event.side not in cameras:
                raise ValueError(f"events: {event.side} is no camera; there are {', '.join(cameras)}")
            unknown = [name for name in event.lights if name not in self.target.spots_m]
            if unknown:
                raise ValueError(f"events: lights {', '.join(unknown)} are not among target.spots_m")
            if event.joint is not None and event.joint > len(self.arm.joints):
                raise ValueError(f"events: there is no joint {event.joint}, the arm has {len(self.arm.joints)}")
        return self

    def _check_who_moves(self) -> None:
        """Raise ValueError where target and rig are not held by what the motion says."""
        motion = self.motion
        if isinstance(motion, RobotMotion):
            if self.target.T_flange_target is None:
                raise ValueError(
                    f"target.T_flange_target is missing: with motion.kind {motion.kind} the arm carries it"
                )
            if self.cameras.mount == "flange":
                raise ValueError("cameras.mount is flange, but the arm carries the target: mount the rig on the base")
        else:
            if self.target.T_flange_target is not None:
                raise ValueError(f"target.T_flange_target is given, but motion.kind {motion.kind} carries the target")
            if self.cameras.mount == "base":
                raise ValueError(
                    f"cameras.mount is base, but with motion.kind {motion.kind} the arm follows with the rig"
                )
            if len(self.arm.joints) != 6:
                raise ValueError(f"motion.follow needs an arm of six joints, not {len(self.arm.joints)}")

    def _check_row(self, key: str, values: Sequence[float]) -> None:
        """Raise ValueError for joint values that the arm has not, or beyond the range of a joint."""
        if len(values) != len(self.arm.joints):
            raise ValueError(f"motion.{key} has {len(values)} values for {len(self.arm.joints)} joints")
        for joint, value in zip(self.arm.joints, values, strict=True):
            below = joint.lower is not None and value < joint.lower
            if below or (joint.upper is not None and value > joint.upper):
                raise ValueError(f"motion.{key} takes joint {joint.name} to {value:g}, beyond its range")
