"""A target's poses over many pairs, as a table."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.columns import POSE6
from armsight.geometry import euler_rad
from armsight.records import PoseStatus, TargetPose
from armsight.records.output import Row, TitledOutput, output


@output
class PoseTrack(TitledOutput):
    """Poses of the target in the order of time; its file is poses.csv, or TUM with the complete ones (.tum, .txt)."""

    poses: tuple[TargetPose, ...] = ()

    def __len__(self) -> int:
        return len(self.poses)

    def __iter__(self) -> Iterator[TargetPose]:
        return iter(self.poses)

    @property
    def t_s(self) -> Array:
        """Times (n,) in s."""
        return np.array([pose.t_s for pose in self.poses])

    @property
    def ok(self) -> NDArray[np.bool_]:
        """Which poses are complete, position and orientation (n,)."""
        return np.array([pose.status is PoseStatus.OK for pose in self.poses], dtype=bool)

    @property
    def T_parent_target(self) -> Array:
        """Poses (n, 4, 4) in the rig's frame (or the file's); NaN where lost."""
        none = np.full((4, 4), np.nan)
        found = [none if pose.T_parent_target is None else pose.T_parent_target for pose in self.poses]
        return np.array(found).reshape(-1, 4, 4)

    @property
    def title(self) -> str:
        """What it is, in a few words."""
        return f"{len(self)} poses of the target, {int(self.ok.sum())} of them complete"

    def rows(self) -> list[Row]:
        """Return the figures of the track."""
        if not len(self):
            return []
        counts = [(str(status), str(sum(pose.status is status for pose in self.poses))) for status in PoseStatus]
        xyz = self.T_parent_target[:, :3, 3]
        seen = xyz[np.isfinite(xyz).all(axis=1)]
        spans = np.ptp(seen, axis=0) if len(seen) else np.zeros(3)
        times = [("time", f"{self.t_s[0]:.3f} to {self.t_s[-1]:.3f} s")]
        return (
            times + counts + [(f"moved in {axis}", f"{1e3 * d:.3f} mm") for axis, d in zip("xyz", spans, strict=True)]
        )

    def table(self) -> dict[str, Any]:
        """Return columns (n,): t_s, status, x_m ... rz_rad (R = Rz Ry Rx), sx_m ... srz_rad; NaN where not known."""
        values = np.full((len(self), 12), np.nan)
        for row, pose in zip(values, self.poses, strict=True):
            if pose.T_parent_target is not None and pose.covariance is not None:
                n = len(pose.covariance)
                row[:3] = pose.T_parent_target[:3, 3]
                if n == len(POSE6):
                    row[3:6] = euler_rad(RigidTransform.from_matrix(pose.T_parent_target).rotation)
                row[6 : 6 + n] = np.sqrt(np.diag(pose.covariance))
        names = (*POSE6, *(f"s{name}" for name in POSE6))
        columns = dict(zip(names, values.T, strict=True))
        return {"t_s": self.t_s, "status": [str(pose.status) for pose in self.poses], **columns}

    def to_dict(self) -> dict[str, Any]:
        """Return the table with lists; None where a number is not known."""
        content = {}
        for name, column in self.table().items():
            values = column if isinstance(column, list) else column.tolist()
            content[name] = [None if value != value else value for value in values]
        return content
