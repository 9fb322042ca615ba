"""Known arms, calibrated; and where a rig stands to one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from armsight.api.results import Result, Row, pose_rows
from armsight.app.calibrate.arm import in_view, world_of
from armsight.app.requests.calibrate_robot import ArmJob
from armsight.arrays import Array
from armsight.calibrate.arm import (
    ArmCalibration,
    ArmPoints,
    Tolerance,
    WorldCalibration,
    calibrate_world,
    propose,
)
from armsight.calibrate.arm import calibrate_arm as solve_arm
from armsight.errors import UsageError
from armsight.geometry import euler_rad
from armsight.kinematics import Arm
from armsight.ops.arrays import Poses, as_poses, as_rotations
from armsight.ops.checks import speaks_python
from armsight.ops.given import ArmLike, as_arm
from armsight.optics import Rig
from armsight.records import checked_array, require_count, require_kind, require_texts
from armsight.report.plots import error_figure
from armsight.store import World, write_world
from armsight.store.saving import YAML, file_to_write

if TYPE_CHECKING:
    import plotly.graph_objects as go


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class ArmResult(Result):
    """A known arm's calibration. arm: corrected where a gain is proved, else nominal. detail: everything else.

    points: what it was calibrated from.
    """

    detail: ArmCalibration
    points: ArmPoints

    @property
    def arm(self) -> Arm:
        """The arm."""
        return self.detail.arm

    @property
    def gain(self) -> bool:
        """Whether the correction lowers the error on measurements left out, beyond its own uncertainty."""
        return self.detail.gain

    def propose(self, n: int, *, rig: Rig | None = None, T_base_rig: Poses | None = None) -> Array:
        """Return joint readings (n, joints) to measure at next, those that tell most first.

        rig, T_base_rig: only what both cameras of a rig that stands there see. Raises NotEnoughData where nothing is
        seen.
        """
        require_count("n", n, least=1)
        if (rig is None) != (T_base_rig is None):
            raise UsageError("of rig and T_base_rig only one is given", cure="Give both, or neither")
        seen = None
        if rig is not None and T_base_rig is not None:
            require_kind("rig", rig, Rig)
            seen = in_view(rig, World(parent="base", T_parent_rig=as_poses(T_base_rig, "T_base_rig")[0]))
        found = propose(self.detail.model, self.detail.fitted, self.points, n, visible=seen)
        return self.detail.nominal.readings(found.q)

    def plot(self) -> go.Figure:
        """Return a plotly figure of each row's error after calibration, mm."""
        return error_figure(self.title, self.detail.error_m)

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
        return self.detail.to_dict()

    def save(self, path: str | PathLike[str]) -> Path:
        """Write arm.yaml, or a URDF where the name ends in .urdf, and return its path."""
        return self.arm.save(path)


@speaks_python(ArmJob)
def calibrate_arm(
    nominal: ArmLike,
    q: ArrayLike,
    xyz_m: ArrayLike,
    *,
    rotation: ArrayLike | None = None,
    point: Sequence[str] = (),
    holdout: tuple[ArrayLike, ArrayLike] | None = None,
    scale: bool = True,
    tolerance_m: float = ArmJob.tolerance_m,
    tolerance_rad: float = ArmJob.tolerance_rad,
) -> ArmResult:
    """Return the arm corrected from the tool's measured positions at the controller's readings.

    Parameters
    ----------
    nominal
        The arm as its data sheet says: an Arm, its file, or a known arm's name.
    q
        (m, n) joint readings in rad and m.
    xyz_m
        (m, 3) where the tool's point was, in m, in any fixed frame.
    rotation
        (m, 3, 3) of the tool in that frame, where measured.
    point
        (m,) names which of the tool's points a row is of.
    holdout
        (q, xyz_m) of further rows, only for judging.
    scale
        Whether joint scales are tried too.
    tolerance_m, tolerance_rad
        Standard deviation of nominal lengths and angles.

    Raises
    ------
    NotEnoughData
        Too few measurements for anything to be freed.
    Inconsistent
        The measurements are not of this arm.

    Examples
    --------
    >>> arm = armsight.presets.ur10()
    >>> q = np.random.default_rng(2).uniform(-1.5, 1.5, (30, 6))
    >>> noise = np.random.default_rng(3).normal(0.0, 1e-4, (30, 3))
    >>> armsight.calibrate_arm(arm, q, arm.fk(q)[:, :3, 3] + noise).gain
    False
    """
    model = as_arm("nominal", nominal)
    points = _points(model, q, xyz_m, rotation, point)
    held = None
    if holdout is not None:
        require_kind("holdout", holdout, tuple, cure="Give (q, xyz_m)")
        if len(holdout) != 2:
            raise UsageError(f"holdout has {len(holdout)} entries", cure="Give (q, xyz_m)")
        held = _points(model, *holdout)
    tolerance = Tolerance(length_m=tolerance_m, angle_rad=tolerance_rad)
    done = solve_arm(model, points, holdout=held, tolerance=tolerance, scale=scale)
    return ArmResult(detail=done, points=points)


def _points(
    arm: Arm, q: ArrayLike, xyz_m: ArrayLike, rotation: ArrayLike | None = None, point: Sequence[str] = ()
) -> ArmPoints:
    positions, readings = checked_array("xyz_m", xyz_m, (None, 3)), checked_array("q", q, (None, arm.n))
    point = require_texts("point", point)
    turned = None if rotation is None else as_rotations(rotation, "rotation", len(positions))
    return ArmPoints(q=readings @ arm.gearing.T, xyz_m=positions, rotation=turned, point=tuple(point))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class RobotWorldResult(Result):
    """Where a rig stands to the arm's base. detail: residuals, covariance and what was left out."""

    detail: WorldCalibration

    @property
    def T_base_rig(self) -> Array:
        """Pose of the rig in the base (4, 4)."""
        return np.asarray(self.detail.T_base_rig.as_matrix())

    @property
    def std(self) -> dict[str, float]:
        """Standard deviations: x_m, y_m, z_m, rx_rad, ry_rad, rz_rad."""
        return self.detail.covariance.std()

    @property
    def title(self) -> str:
        """What it is, in a few words."""
        return f"T_base_rig from {world_of(self.detail).n_used} points"

    def rows(self) -> list[Row]:
        """Return the pose with standard deviations, and the residual."""
        T = self.detail.T_base_rig
        values = [*np.asarray(T.translation).tolist(), *euler_rad(T.rotation).tolist()]
        rows = pose_rows(dict(zip(self.std, values, strict=True)), self.std)
        return [*rows, ("residual", f"{1e3 * self.detail.residual_rms_m:.3g} mm RMS")]

    def to_dict(self) -> dict[str, Any]:
        """Return the figures as `armsight calibrate robot-world --json` gives them."""
        return self.detail.to_dict()

    def save(self, path: str | PathLike[str]) -> Path:
        """Write world.yaml and return its path."""
        file = file_to_write(path, *YAML)
        write_world(file, world_of(self.detail))
        return file

    def plot(self) -> go.Figure:
        """Return a plotly figure of each point's residual, mm."""
        return error_figure(self.title, np.abs(self.detail.residual_m))


@speaks_python()
def calibrate_robot_world(
    arm: ArmLike, q: ArrayLike, xyz_m: ArrayLike, *, point: Sequence[str] = ()
) -> RobotWorldResult:
    """Return where a rig stands to the arm's base, from points on the tool that it observed.

    Parameters
    ----------
    arm
        As calibrate_arm takes it; its tool is the beacon.
    q
        (m, n) joint readings in rad and m.
    xyz_m
        (m, 3) where the beacon was in rig axes, in m.
    point
        (m,) names which of the arm's tool points a row is of.

    Raises
    ------
    NotEnoughData, Inconsistent, Ambiguous, Degenerate
        The points do not tell the place.

    Examples
    --------
    >>> arm = armsight.presets.ur10()
    >>> q = np.random.default_rng(2).uniform(-1.5, 1.5, (20, 6))
    >>> seen = arm.fk(q)[:, :3, 3] - [0.0, 0.0, 1.0]
    >>> armsight.calibrate_robot_world("ur10", q, seen).T_base_rig[:3, 3].round(6).tolist()
    [0.0, 0.0, 1.0]
    """
    model = as_arm("arm", arm)
    return RobotWorldResult(detail=calibrate_world(model, _points(model, q, xyz_m, None, point)))
