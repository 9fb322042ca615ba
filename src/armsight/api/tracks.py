"""A target's poses over many pairs: a table, a file, a plot."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from armsight.api.results import Result, Row
from armsight.arrays import Array
from armsight.columns import POSE6
from armsight.geometry import euler_rad
from armsight.records import PoseStatus, TargetPose
from armsight.store import write_poses, write_tum
from armsight.store.saving import file_to_write
from armsight.units import displayed_name

if TYPE_CHECKING:
    import plotly.graph_objects as go

TUM_SUFFIXES = (".tum", ".txt")

BAND: dict[str, Any] = {
    "mode": "lines",
    "line": {"width": 0},
    "fillcolor": "rgba(31,119,180,0.25)",
    "hoverinfo": "skip",
    "showlegend": False,
}
"""How the edges of a plot's band of standard deviations look."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class PoseTrack(Result):
    """Poses of the target in the order of time."""

    poses: tuple[TargetPose, ...] = field(default_factory=tuple)

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

    def save(self, path: str | PathLike[str]) -> Path:
        """Write poses.csv, or complete poses as TUM where the name ends in .tum or .txt, and return its path."""
        file = file_to_write(path, ".csv", *TUM_SUFFIXES)
        write = write_tum if file.suffix.lower() in TUM_SUFFIXES else write_poses
        write(file, self.poses)
        return file

    def plot(self) -> go.Figure:
        """Return a plotly figure: position (mm) and orientation (deg) over time with their 95 % bands."""
        import plotly.graph_objects as go
        from plotly.subplots import make_subplots

        table = self.table()
        figure = make_subplots(rows=6, cols=1, shared_xaxes=True, vertical_spacing=0.02)
        for i, name in enumerate(POSE6, 1):
            label, unit, size = displayed_name(name)
            band = 1.96 / size * table[f"s{name}"]
            value = table[name] / size
            for sign, fill in ((-1.0, None), (1.0, "tonexty")):
                edge = go.Scatter(x=table["t_s"], y=value + sign * band, fill=fill, **BAND)
                figure.add_trace(edge, row=i, col=1)
            figure.add_trace(go.Scatter(x=table["t_s"], y=value, name=label, mode="lines+markers"), row=i, col=1)
            figure.update_yaxes(title_text=f"{label}, {unit}", row=i, col=1)
        figure.update_xaxes(title_text="t, s", row=6, col=1)
        figure.update_layout(title=self.title, height=900, showlegend=False)
        return figure
