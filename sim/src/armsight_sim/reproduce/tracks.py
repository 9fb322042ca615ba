"""Poses over time by both methods, their errors as rows, and curves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.columns import POSE6
from armsight.errors import NotEnoughData
from armsight.geometry import pose_difference
from armsight.records import PoseStatus
from armsight.store import read_poses
from armsight.store.tables import read_table
from armsight.store.tracks import SPOT_COLUMNS
from armsight_sim.reproduce.page import ComparedRow, Curve, Panel

SHOWN = ("x", "y", "z", "rx", "ry", "rz")
LEAST_SEEN = 0.9
"""Share of the frames that both methods must have a pose of, or their tables would be of the easy frames."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PoseTracks:
    """The same frames by both methods: poses (n, 4, 4) in world, and the true ones; t_s (n,); frame (n,) from 0."""

    frame: NDArray[np.intp]
    t_s: Array
    method: Array
    ours: Array
    true: Array

    def errors(self, poses: Array) -> Array:
        """Return poses minus true ones (n, 6): m, then rotation vectors in rad in the world's axes."""
        return pose_differences(poses, self.true)


def pose_differences(poses: Array, references: Array) -> Array:
    """Return the differences (n, 6) of poses (n, 4, 4) from others: m, then rotation vectors in rad."""
    pairs = zip(poses, references, strict=True)
    return np.array([pose_difference(RigidTransform.from_matrix(a), RigidTransform.from_matrix(b)) for a, b in pairs])


def measured_poses(path: Path) -> dict[int, Array]:
    """Return the full poses (4, 4) of a poses.csv by their row from 0."""
    return {
        i: pose.T_parent_target
        for i, pose in enumerate(read_poses(path, parent="world", measured=False))
        if pose.status is PoseStatus.OK and pose.T_parent_target is not None
    }


def spots_by_frame(path: Path, times_s: Array) -> dict[tuple[int, str], dict[str, Array]]:
    """Return the pixels (2,) of named spots in a spots.csv by frame (nearest of times_s) and camera."""
    table = read_table(path, SPOT_COLUMNS, text=("spot", "camera"), need_rows=False)
    uv, t_s = table.stacked(("u_px", "v_px")), table.numbers["t_s"]
    out: dict[tuple[int, str], dict[str, Array]] = {}
    for row, (camera, spot) in enumerate(zip(table.text["camera"], table.text["spot"], strict=True)):
        frame = int(np.abs(times_s - t_s[row]).argmin())
        out.setdefault((frame, camera), {})[spot] = uv[row]
    return out


def joined(times_s: Array, method: Mapping[int, Array], ours: Mapping[int, Array], true: Array) -> PoseTracks:
    """Return the frames that both methods have a pose of. Raises NotEnoughData where these are few."""
    frame = np.array(sorted(set(method) & set(ours)), dtype=np.intp)
    if len(frame) < LEAST_SEEN * len(times_s):
        raise NotEnoughData(
            f"of {len(times_s)} frames the paper's method has {len(method)} poses, armsight {len(ours)}",
            consequence="Their errors would be compared over the easy frames only",
            cure="Take another seed",
        )
    return PoseTracks(
        frame=frame,
        t_s=times_s[frame],
        method=np.array([method[i] for i in frame]),
        ours=np.array([ours[i] for i in frame]),
        true=true[frame],
    )


def statistic_rows(
    method: Array, ours: Array, statistics: Sequence[str], *, names: Sequence[str] = POSE6
) -> tuple[ComparedRow, ...]:
    """Return rows of statistics (rms, max) of errors (n, k) by both methods, without printed figures."""
    take = {
        "rms": lambda e: float(np.sqrt(np.mean(e**2))),
        "max": lambda e: float(np.abs(e).max()),
    }
    rows = []
    for kind in statistics:
        for k, name in enumerate(names):
            stem, _, unit = name.rpartition("_")
            rows.append(
                ComparedRow(
                    name=f"{stem}_{kind}_{unit}",
                    label=f"{stem}, {kind}",
                    unit=unit,
                    paper=None,
                    paper_method=take[kind](method[:, k]),
                    armsight=take[kind](ours[:, k]),
                    truth=0.0,
                    credible=False,
                )
            )
    return tuple(rows)


def time_panel(title: str, t_s: Array, values: Sequence[Array], names: Sequence[str], x_title: str = "t, s") -> Panel:
    """Return a panel of three columns (n,) over time: reference, the paper's method, armsight."""
    styles = (("truth", "lines"), ("method", "markers"), ("ours", "markers"))
    curves = tuple(
        Curve(name=name, x=t_s, y=column, who=who, mode=mode)
        for name, column, (who, mode) in zip(names, values, styles, strict=True)
    )
    return Panel(x_title=x_title, y_title=title, curves=curves)
