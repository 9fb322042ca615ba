"""The tool tip, from poses or from frames while it rests on a point."""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from armsight.api.arrays import Array, Poses, as_poses
from armsight.api.checks import speaks_python
from armsight.api.given import Given, RigLike, Source, TargetLike
from armsight.api.results import Result, Row, error_figure, with_std
from armsight.app.calibrate.pivot import find_tip
from armsight.app.requests.calibrate_robot import PivotJob
from armsight.calibrate.tooltip import MeasuredPoint, calibrate_tooltip
from armsight.calibrate.tooltip_result import TipCalibration
from armsight.drivers import CameraSettings
from armsight.records import Progress, checked_array
from armsight.store.handeye_file import write_tip
from armsight.store.saving import YAML, file_to_write

if TYPE_CHECKING:
    import plotly.graph_objects as go


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
        return self.detail.to_dict()

    def save(self, path: str | PathLike[str]) -> Path:
        """Write tip.yaml and return its path."""
        file = file_to_write(path, *YAML)
        write_tip(file, self.detail)
        return file

    def plot(self) -> go.Figure:
        """Return a plotly figure of each pose's residual, mm."""
        return error_figure(self.title, np.linalg.norm(self.detail.residuals_m, axis=1))


@speaks_python(PivotJob)
def calibrate_tool_tip(
    T_world_target: Poses,
    covariances: ArrayLike | None = None,
    *,
    point_m: ArrayLike | None = None,
    point_std_m: float = PivotJob.sigma_m,
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

    Examples
    --------
    >>> turn = Rotation.from_rotvec(np.random.default_rng(1).normal(0.0, 0.4, (20, 3)))
    >>> poses = RigidTransform.from_components(-turn.apply([0.0, 0.0, 0.2]), turn)
    >>> armsight.calibrate_tool_tip(poses).tip_m.round(6) + 0.0
    array([0. , 0. , 0.2])
    """
    poses = as_poses(T_world_target, "T_world_target")
    n = len(poses)
    given = None if covariances is None else checked_array("covariances", covariances, (n, 6, 6))
    times = None if t_s is None else checked_array("t_s", t_s, (n,))
    point = None
    if point_m is not None:
        point = MeasuredPoint(xyz_m=checked_array("point_m", point_m, (3,)), sigma_m=point_std_m)
    return ToolTipResult(detail=calibrate_tooltip(poses, given, point, times))


@speaks_python(PivotJob)
def calibrate_pivot(
    rig: RigLike,
    target: TargetLike,
    left: Source,
    right: Source | None = None,
    *,
    goal_m: float = PivotJob.goal_m,
    point_m: ArrayLike | None = None,
    point_std_m: float = PivotJob.sigma_m,
    camera_settings: CameraSettings | None = None,
    progress: Progress | None = None,
) -> ToolTipResult:
    """Return the tip of a tool from frames while it pivots on a point, as soon as it is known well enough.

    Parameters
    ----------
    rig, target
        Records or files; the target is on the tool.
    left, right
        Frames, as `measure` takes them.
    goal_m
        Standard deviation of the tip's place at which to stop.
    point_m, point_std_m
        Where it rests in rig axes, if measured, and how well.

    Raises
    ------
    NotEnoughData
        The poses do not tell the tip.
    """
    with Given(name="tip.yaml") as given:
        point = None if point_m is None else tuple(checked_array("point_m", point_m, (3,)).tolist())
        return ToolTipResult(
            detail=find_tip(given.job(PivotJob, locals(), point=point, sigma_m=point_std_m), progress)[1]
        )
