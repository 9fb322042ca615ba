"""A target's poses over many pairs, as a table."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.columns import POSE6
from armsight.geometry import euler_rad
from armsight.records import PoseStatus, TargetPose
from armsight.records.by_value import ByValue
from armsight.records.output import Row, TitledOutput, output

NONE = np.empty(0)
LAST_ROW = (0.0, 0.0, 0.0, 1.0)
UPPER = {n: np.triu_indices(n) for n in (3, 6)}


class PackedPoses(ByValue, Sequence[TargetPose]):
    """Poses in the order of time, kept as their numbers: a third of what the records take. Each is made where asked."""

    def __init__(self, poses: Iterable[TargetPose] = ()) -> None:
        self._numbers, self._ends = array("d"), array("q", (0,))
        self._words: list[tuple[Any, ...]] = []
        for pose in poses:
            self.append(pose)

    def append(self, pose: TargetPose) -> None:
        """Keep one more."""
        T = pose.T_parent_target
        blocks = (NONE if T is None else T[:3].ravel(), _half(pose.covariance), _half(pose.systematic_covariance))
        self._numbers.append(pose.t_s)
        for block in (*blocks, pose.residual_px):
            self._numbers.extend(block)
        self._ends.append(len(self._numbers))
        words = (pose.status, pose.why, pose.parent, pose.spots, pose.origin_known, *map(len, blocks))
        self._words.append(self._words[-1] if self._words[-1:] == [words] else words)

    def restate(self, status: PoseStatus, stated: Callable[[TargetPose], TargetPose]) -> int:
        """Give each of a status that of what a function makes of it, and the reason; return how many it made anew."""
        changed = 0
        for k, words in enumerate(self._words):
            if words[0] is not status:
                continue
            before = self[k]
            after = stated(before)
            if after is not before:
                self._words[k] = (after.status, after.why, *words[2:])
                changed += 1
        return changed

    def __len__(self) -> int:
        return len(self._words)

    @overload
    def __getitem__(self, at: int) -> TargetPose: ...
    @overload
    def __getitem__(self, at: slice) -> tuple[TargetPose, ...]: ...
    def __getitem__(self, at: int | slice) -> TargetPose | tuple[TargetPose, ...]:
        if isinstance(at, slice):
            return tuple(self[k] for k in range(*at.indices(len(self))))
        at = range(len(self))[at]
        numbers = np.frombuffer(self._numbers[self._ends[at] : self._ends[at + 1]])
        status, why, parent, spots, origin_known, n_pose, n_covariance, n_systematic = self._words[at]
        after_pose = 1 + n_pose
        after_covariance = after_pose + n_covariance
        after_systematic = after_covariance + n_systematic
        return TargetPose(
            t_s=float(numbers[0]),
            status=status,
            parent=parent,
            spots=spots,
            T_parent_target=np.append(numbers[1:after_pose], LAST_ROW).reshape(4, 4) if n_pose else None,
            covariance=_square(numbers[after_pose:after_covariance]),
            residual_px=numbers[after_systematic:],
            why=why,
            systematic_covariance=_square(numbers[after_covariance:after_systematic]),
            origin_known=origin_known,
        )


def _half(C: Array | None) -> Array:
    """Return the upper half of a matrix (n, n) by rows, or all of one that rounding has left unlike its transpose."""
    if C is None:
        return NONE
    return C[UPPER[len(C)]] if (C == C.T).all() else C.ravel()


def _square(half: Array) -> Array | None:
    n = {0: 0, 6: 3, 9: 3, 21: 6, 36: 6}[len(half)]
    if len(half) == n * n:
        return half.reshape(n, n) if n else None
    C = np.empty((n, n))
    C[UPPER[n]] = C.T[UPPER[n]] = half
    return C


@output
class PoseTrack(TitledOutput):
    """Poses of the target in the order of time; its file is poses.csv, or TUM with the complete ones (.tum, .txt)."""

    poses: Sequence[TargetPose] = ()

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
