"""Hand-eye, tool tip, and arms: identified, calibrated, or known by name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from armsight.api.arrays import Array, Poses, as_joint_numbers, as_path, as_poses, as_rotations
from armsight.api.results import Result, Row, pose_rows, with_std
from armsight.app.calibrate.arm import arm_output
from armsight.app.calibrate.handeye import handeye_output, tip_output
from armsight.app.identify.sweep_files import identify_output
from armsight.calibrate.arm import ArmCalibration, ArmPoints
from armsight.calibrate.arm import calibrate_arm as solve_arm
from armsight.calibrate.handeye import HandEye, PosePairs, Setup, calibrate_eye_in_hand, calibrate_eye_to_hand, verdict
from armsight.calibrate.identify import Identification, Sweeps, identify
from armsight.calibrate.tooltip import MeasuredPoint, TipCalibration, calibrate_tooltip
from armsight.errors import Inconsistent, UsageError
from armsight.geometry import euler_rad
from armsight.kinematics import Arm
from armsight.optics import Rig
from armsight.records import checked_array, require_kind, require_number, require_texts
from armsight.store.handeye_file import write_handeye, write_tip


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class HandEyeResult(Result):
    """Where the camera is on the arm (or beside it), and how far to believe it. detail: everything else."""

    detail: HandEye

    @property
    def T_flange_camera(self) -> Array:
        """Pose of the camera on the flange (4, 4). Raises Inconsistent for a camera that is not on the arm."""
        return self._pose(Setup.EYE_IN_HAND, "T_flange_camera")

    @property
    def T_base_target(self) -> Array:
        """Pose of the target in the base (4, 4). Raises Inconsistent for a target that is on the arm."""
        return self._pose(Setup.EYE_IN_HAND, "T_base_target")

    @property
    def T_base_camera(self) -> Array:
        """Pose of the camera in the base (4, 4). Raises Inconsistent for a camera that is on the arm."""
        return self._pose(Setup.EYE_TO_HAND, "T_base_camera")

    @property
    def T_flange_target(self) -> Array:
        """Pose of the target on the flange (4, 4). Raises Inconsistent for a target that is not on the arm."""
        return self._pose(Setup.EYE_TO_HAND, "T_flange_target")

    @property
    def std(self) -> dict[str, float]:
        """Standard deviations of the camera's pose: x_m, y_m, z_m, rx_rad, ry_rad, rz_rad."""
        return self.detail.std("camera")

    @property
    def rejected(self) -> tuple[tuple[str, str], ...]:
        """(row, why) of the pairs that were left out."""
        return self.detail.rejected

    @property
    def verdict(self) -> str:
        """Whether the result can be trusted."""
        return verdict(self.detail)

    @property
    def title(self) -> str:
        """What it is, in a few words."""
        where = "T_flange_camera" if self.detail.setup is Setup.EYE_IN_HAND else "T_base_camera"
        return f"Hand-eye ({self.detail.setup}): {where} from {self.detail.n_used} of {len(self.detail.pairs)} pairs"

    def rows(self) -> list[Row]:
        """Return the camera's pose with standard deviations, residuals and the verdict."""
        found = self.detail
        T = found.T_parent_camera
        values = [*np.asarray(T.translation).tolist(), *euler_rad(T.rotation).tolist()]
        return [
            *pose_rows(dict(zip(self.std, values, strict=True)), self.std),
            ("left-out error", f"{1e3 * found.loo_rms_m:.3g} mm, {np.rad2deg(found.loo_rms_rad):.3g} deg RMS"),
            *((f"rejected {name}", why) for name, why in self.rejected[:5]),
            ("verdict", self.verdict),
            *(("advice", text) for text in found.advice),
        ]

    def to_dict(self) -> dict[str, Any]:
        """Return the figures as `armsight calibrate handeye --json` gives them."""
        return handeye_output(self.detail).to_dict()

    def save(self, path: str | PathLike[str]) -> None:
        """Write handeye.yaml."""
        write_handeye(as_path(path), self.detail, self.verdict)

    def _pose(self, setup: Setup, name: str) -> Array:
        if self.detail.setup is not setup:
            raise Inconsistent(
                f"{name} belongs to {setup}, and this calibration is {self.detail.setup}",
                cure="Give setup='eye-to-hand' for a camera beside the arm, 'eye-in-hand' for one on it",
            )
        camera = name.endswith("camera")
        return np.asarray((self.detail.T_parent_camera if camera else self.detail.T_parent_target).as_matrix())


def calibrate_hand_eye(
    T_base_flange: Poses,
    T_camera_target: Poses,
    *,
    setup: Literal["eye-in-hand", "eye-to-hand"] = "eye-in-hand",
    names: Sequence[str] | None = None,
) -> HandEyeResult:
    """Return where the camera is, from poses of the robot and of the target at the same moments, row by row.

    Parameters
    ----------
    T_base_flange
        N poses (n, 4, 4) in m, or RigidTransform: the flange in the robot's base, as its controller says.
    T_camera_target
        N poses alike: the target in the camera's frame.
    setup
        The camera is on the arm ('eye-in-hand') or beside it ('eye-to-hand').
    names
        Of the rows, for messages.

    Raises
    ------
    NotEnoughData
        Fewer rows than the answer has directions.
    Degenerate
        Too little turning, or about one axis only.
    Inconsistent
        Wrong units, inverted poses, or rows that do not belong together.
    NotConverged
        The fit found no answer.
    """
    robot, camera = as_poses(T_base_flange, "T_base_flange"), as_poses(T_camera_target, "T_camera_target")
    rows = require_texts("names", names) if names is not None else tuple(f"row {i}" for i in range(len(robot)))
    pairs = PosePairs(T_base_flange=robot, T_camera_target=camera, names=rows)
    if setup not in tuple(Setup):
        raise UsageError(f"there is no setup {setup!r}", cure=f"Use one of: {', '.join(Setup)}")
    calibrate = calibrate_eye_in_hand if Setup(setup) is Setup.EYE_IN_HAND else calibrate_eye_to_hand
    return HandEyeResult(detail=calibrate(pairs))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class ToolTipResult(Result):
    """Where the tool's end is in the axes of the turned frame. detail: everything else."""

    detail: TipCalibration

    @property
    def tip_m(self) -> Array:
        """The tip (3,) in the turned frame's axes."""
        return self.detail.tip_m

    @property
    def point_m(self) -> Array:
        """The point (3,) on which it rested, in the poses' parent frame."""
        return self.detail.point_m

    @property
    def std(self) -> dict[str, float]:
        """Standard deviations of the tip: x_m, y_m, z_m."""
        return self.detail.std()

    @property
    def title(self) -> str:
        """What it is, in a few words."""
        return f"Tool tip from {self.detail.n_used} of {len(self.detail.used)} poses"

    def rows(self) -> list[Row]:
        """Return the tip's coordinates with standard deviations, and the residual."""
        named = zip(self.std.items(), self.tip_m.tolist(), strict=True)
        rows = [(name.removesuffix("_m"), with_std(value, std, "mm", scale=1e3)) for (name, std), value in named]
        return [*rows, ("residual", f"{1e3 * self.detail.residual_rms_m:.3g} mm RMS")]

    def to_dict(self) -> dict[str, Any]:
        """Return the figures as `armsight calibrate tooltip --json` gives them."""
        return tip_output(self.detail).to_dict()

    def save(self, path: str | PathLike[str]) -> None:
        """Write tip.yaml."""
        write_tip(as_path(path), self.detail)


def calibrate_tool_tip(
    T_world_target: Poses,
    covariances: ArrayLike | None = None,
    *,
    point_m: ArrayLike | None = None,
    point_std_m: float = 0.0,
    t_s: ArrayLike | None = None,
) -> ToolTipResult:
    """Return the tool's tip from poses of a frame that was turned about it while it rested on one point.

    Parameters
    ----------
    T_world_target
        N poses (n, 4, 4) in m, or RigidTransform.
    covariances
        (n, 6, 6) in m and rad, where known.
    point_m
        (3,) in m, where the tip rests in the world, if that was measured.
    point_std_m
        Standard deviation in m of one coordinate of point_m.
    t_s
        (n,) in s, where the poses are of one recording: how long their errors are alike is estimated, and they are
        weighed and believed by it.

    Raises
    ------
    NotEnoughData
        Too few poses.
    Degenerate
        Too little turning.
    Inconsistent
        The poses have no common point.
    """
    poses = as_poses(T_world_target, "T_world_target")
    n = len(poses)
    given = None if covariances is None else checked_array("covariances", covariances, (n, 6, 6))
    times = None if t_s is None else checked_array("t_s", t_s, (n,))
    require_number("point_std_m", point_std_m)
    point = None
    if point_m is not None:
        point = MeasuredPoint(xyz_m=checked_array("point_m", point_m, (3,)), sigma_m=point_std_m)
    return ToolTipResult(detail=calibrate_tooltip(poses, given, point, times))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class ArmIdentification(Result):
    """An unknown arm's geometry. arm: what was found, for kinematics and files. detail: everything else."""

    detail: Identification

    @property
    def arm(self) -> Arm:
        """The arm."""
        return self.detail.arm

    @property
    def notes(self) -> tuple[str, ...]:
        """What to know about the result."""
        return self.detail.notes

    @property
    def title(self) -> str:
        """What it is, in a few words."""
        return f"Arm of {self.arm.n} joints, identified"

    def rows(self) -> list[Row]:
        """Return each joint's type and table, with standard deviations where they mean something."""
        rows = []
        for number, (joint, found) in enumerate(zip(self.arm.joints, self.detail.joints, strict=True), 1):
            std = found.std
            parts = [
                f"a {with_std(joint.a_m, std.get('a_m'), 'mm', scale=1e3)}",
                f"alpha {with_std(joint.alpha_rad, std.get('alpha_rad'), 'deg', scale=180.0 / np.pi)}",
                f"d {with_std(joint.d_m, std.get('d_m'), 'mm', scale=1e3)}",
                f"theta {with_std(joint.theta_rad, std.get('theta_rad'), 'deg', scale=180.0 / np.pi)}",
            ]
            rows.append((f"joint {number}", f"{joint.type}{'' if found.decided else '?'}: {', '.join(parts)}"))
        return rows + [("note", note) for note in self.notes]

    def to_dict(self) -> dict[str, Any]:
        """Return the figures as `armsight identify --json` gives them."""
        return identify_output(self.detail).to_dict()

    def save(self, path: str | PathLike[str]) -> None:
        """Write arm.yaml."""
        self.arm.save(path)


def identify_arm(
    joint: ArrayLike,
    q: ArrayLike,
    xyz_m: ArrayLike,
    *,
    rig: Rig | None = None,
    uv_px: ArrayLike | None = None,
    name: str = "identified",
) -> ArmIdentification:
    """Return the arm whose beacon was seen while one joint after the other moved (Kapucu and Baysec 2005).

    Parameters
    ----------
    joint
        (m,) which joint moves in each row, counted from 1.
    q
        (m, n) joint values in rad and m.
    xyz_m
        (m, 3) where the beacon was, in m, in any fixed frame.
    rig
        The cameras; with uv_px the fit is of pixels.
    uv_px
        (m, 2, 2) the beacon's positions in both images, [row, side].
    name
        Of the arm.

    Raises
    ------
    NotEnoughData
        Too few readings of a joint, or too short a sweep.
    Inconsistent
        Rows that do not belong together.
    """
    require_kind("name", name, str)
    positions, readings = checked_array("xyz_m", xyz_m, (None, 3)), checked_array("q", q, (None, None))
    moving = as_joint_numbers(joint, len(positions))
    pixels = None if uv_px is None else checked_array("uv_px", uv_px, (len(positions), 2, 2))
    if rig is not None:
        require_kind("rig", rig, Rig)
    if (rig is None) != (pixels is None):
        raise UsageError(
            "of rig and uv_px only one is given",
            consequence="Pixels say nothing without their cameras",
            cure="Give both, or neither",
        )
    sweeps = Sweeps(joint=moving - 1, q=readings, xyz_m=positions, uv_px=pixels)
    return ArmIdentification(detail=identify(sweeps, rig=rig, name=name))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class ArmResult(Result):
    """A known arm's calibration. arm: corrected where a gain is proved, else nominal. detail: everything else."""

    detail: ArmCalibration

    @property
    def arm(self) -> Arm:
        """The arm."""
        return self.detail.arm

    @property
    def gain(self) -> bool:
        """Whether the correction lowers the error on measurements left out, beyond its own uncertainty."""
        return self.detail.gain

    @property
    def title(self) -> str:
        """What it is, in a few words."""
        return f"Arm {self.arm.name} calibrated from {len(self.detail.error_m)} measurements"

    def rows(self) -> list[Row]:
        """Return the errors before and after, and the verdict."""
        found = self.detail
        pairs = (("fitted rows", found.before, found.after), ("left-out rows", found.cross_before, found.cross_after))
        rows = [(name, f"{1e3 * a.rms_m:.3g} mm RMS before, {1e3 * b.rms_m:.3g} mm after") for name, a, b in pairs]
        return [*rows, ("freed", ", ".join(found.free) or "nothing"), ("verdict", found.verdict)]

    def to_dict(self) -> dict[str, Any]:
        """Return the figures as `armsight calibrate arm --json` gives them."""
        return arm_output(self.detail).to_dict()

    def save(self, path: str | PathLike[str]) -> None:
        """Write arm.yaml."""
        self.arm.save(path)


def calibrate_arm(
    nominal: Arm,
    q: ArrayLike,
    xyz_m: ArrayLike,
    *,
    rotation: ArrayLike | None = None,
    point: Sequence[str] = (),
) -> ArmResult:
    """Return the arm corrected from the tool's measured positions at the controller's readings.

    Parameters
    ----------
    nominal
        The arm as its data sheet says.
    q
        (m, n) joint readings in rad and m.
    xyz_m
        (m, 3) where the tool's point was, in m, in any fixed frame.
    rotation
        (m, 3, 3) of the tool in that frame, where measured.
    point
        (m,) names which of the tool's points a row is of.

    Raises
    ------
    NotEnoughData
        Too few measurements for anything to be freed.
    Inconsistent
        The measurements are not of this arm.
    """
    require_kind("nominal", nominal, Arm, cure="Give an Arm: read_arm(path), or presets.ur10()")
    positions, readings = checked_array("xyz_m", xyz_m, (None, 3)), checked_array("q", q, (None, nominal.n))
    point = require_texts("point", point)
    turned = None if rotation is None else as_rotations(rotation, "rotation", len(positions))
    points = ArmPoints(q=readings @ nominal.gearing.T, xyz_m=positions, rotation=turned, point=tuple(point))
    return ArmResult(detail=solve_arm(nominal, points))
