"""The files of a measurement, written row by row, and the figures that sum it up."""

from __future__ import annotations

import hashlib
import math
from array import array
from collections import Counter
from collections.abc import Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.columns import POSE6
from armsight.errors import Unseen
from armsight.file_names import POINTS, POSES, SPOTS, TUM
from armsight.geometry import moved_parent_covariance, quat_of_matrix
from armsight.measure.consistency.check import advice, finalise, sentence
from armsight.measure.consistency.findings import Consistency, Finding
from armsight.measure.poses.pipeline import Measured, Setup
from armsight.measure.results import (
    Candidates,
    ConsistencyOutput,
    Estimated,
    FrameTime,
    Grounds,
    MadeWith,
    MeasureResult,
    OtherCause,
    PoseDeviations,
)
from armsight.measure.track import PackedPoses, PoseTrack
from armsight.optics import SIDES, Rig
from armsight.records import Points, PoseStatus, Spots, Target, TargetPose
from armsight.records.result_parts import PoseStd
from armsight.store import (
    MovingPosesWriter,
    PointsWriter,
    PosesWriter,
    SpotsWriter,
    World,
    restate_points,
    write_poses,
    write_tum,
)
from armsight.store.atomic import RowFile

Velocity = tuple[Array | None, Array | None]
REASONS_KEPT = 20
"""Different reasons for lost frames that are counted apart; the rest is summed."""


class Outputs:
    """poses.csv, points.csv, spots.csv and poses.tum in a folder, whole rows at any moment, and the figures of them.

    A context manager. folder: None writes nothing. world: the frame the poses are given in; points stay in rig axes. It
    is exact here: its own uncertainty is common to all poses and not part of theirs. moving: poses have velocities.
    """

    def __init__(
        self, folder: Path | None, *, world: World | None = None, moving: bool = False, names: Sequence[str] = SIDES
    ) -> None:
        self._folder, self._world, self._moving, self._names = folder, world, moving, tuple(names)
        self._stack = ExitStack()
        self._ms = array("d")
        self._candidates: Counter[str] = Counter()
        self._clear()

    def _clear(self) -> None:
        self._counts: Counter[PoseStatus] = Counter()
        self._reasons: Counter[str] = Counter()  # sentences, for people
        self._kinds: Counter[Unseen] = Counter()
        self._squares_px2 = 0.0
        self._residuals = 0
        self._aside = 0
        self._std = array("d")  # per full pose: six totals, six of what repeats

    def again(self) -> Self:
        """Begin anew, files and figures, for the same frames solved in another way; their times and spots stay."""
        self._clear()
        self._candidates.clear()
        return self

    @property
    def units(self) -> str:
        """What the frames of one moment are called."""
        return "pairs" if self._names == SIDES else "moments"

    def __enter__(self) -> Self:
        if self._folder is None:
            return self
        with ExitStack() as stack:
            self._poses: MovingPosesWriter | PosesWriter
            if self._moving:
                self._poses = stack.enter_context(MovingPosesWriter(self._folder / POSES))
            else:
                self._poses = stack.enter_context(PosesWriter(self._folder / POSES))
            self._points = stack.enter_context(PointsWriter(self._folder / POINTS))
            self._spots = stack.enter_context(SpotsWriter(self._folder / SPOTS))
            self._tum = stack.enter_context(RowFile(self._folder / TUM, "# t_s x_m y_m z_m qx qy qz qw"))
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()

    @property
    def n_frames(self) -> int:
        """Frames added so far."""
        return self._counts.total()

    @property
    def n_seen(self) -> int:
        """Frames in which at least a position was found."""
        return self.n_frames - self._counts[PoseStatus.LOST]

    @property
    def commonest(self) -> str:
        """What took a pose away most often, in words; empty where nothing did."""
        return next((why for why, _ in self._reasons.most_common(1)), "")

    def took(self, ms: float) -> None:
        """Note how many milliseconds a frame has taken in all: searched, checked, written and kept for the report."""
        self._ms.append(ms)

    def add(self, measured: Measured) -> TargetPose:
        """Take one frame's result; return its pose in the parent frame."""
        pose = moved_to(measured.pose, self._world)
        self.row(pose, measured.points, measured.cause)
        for s, (name, spots) in enumerate(zip(self._names, measured.spots, strict=True)):
            self.spots(pose.t_s, name, measured.names_in(s), spots)
        if pose.status.size == 6 and pose.covariance is not None:
            repeats = np.zeros((6, 6)) if pose.systematic_covariance is None else pose.systematic_covariance
            variances = np.concatenate([np.diag(pose.covariance), np.diag(repeats).clip(min=0.0)])
            self._std.extend(np.sqrt(variances).tolist())
        self._candidates.update(candidates_of(measured))
        judged = [measured.judged_px(s) for s in range(len(measured.spots))]
        count = sum(part.size for part in judged)
        left_over = pose.residual_px if count == len(pose.residual_px) else np.concatenate(judged).ravel()
        self._squares_px2 += float(left_over @ left_over)
        self._residuals += count
        self._aside += (len(pose.residual_px) - count) // 2
        return pose

    def row(self, pose: TargetPose, points: Points | None, cause: Unseen, velocity: Velocity = (None, None)) -> None:
        """Take a pose in the parent frame, the points in rig axes, and the kind of what took it away, if anything did.

        velocity: (6,) and its standard deviations, of a moving target.
        """
        self._counts[pose.status] += 1
        if pose.why:
            known = pose.why in self._reasons or len(self._reasons) < REASONS_KEPT
            self._reasons[pose.why if known else "other reasons"] += 1
            self._kinds[cause] += 1
        if self._folder is None:
            return
        if isinstance(self._poses, MovingPosesWriter):
            self._poses.write(pose, *velocity)
        else:
            self._poses.write(pose)
        if points is not None:
            self._points.write(pose.t_s, points, status=_status_of_points(pose))
        T = pose.T_parent_target
        if pose.status is PoseStatus.OK and T is not None:
            self._tum.add(" ".join(repr(value) for value in (pose.t_s, *T[:3, 3].tolist(), *quat_of_matrix(T))))

    def spots(self, t_s: float, side: str, names: Sequence[str], spots: Spots) -> None:
        """Take the spots of one view, by the names of their lights."""
        if self._folder is not None:
            self._spots.write(t_s, side, names, spots)

    def settle(self, poses: PackedPoses, *, inconsistent: bool) -> None:
        """Give all rows, in place too, the status of the verdict on their run; to be called once, when it has ended.

        While it goes a row only knows what was known by then.
        """
        other = PoseStatus.OK if inconsistent else PoseStatus.DOUBTFUL
        changed = poses.restate(other, partial(finalise, inconsistent=inconsistent))
        if not changed:
            return
        if self._folder is not None:
            write_poses(self._folder / POSES, poses)
            write_tum(self._folder / TUM, poses)
            restate_points(self._folder / POINTS, {pose.t_s: _status_of_points(pose) for pose in poses})
        self._counts = Counter(pose.status for pose in poses)
        self._kinds[Unseen.INCONSISTENT] += changed if inconsistent else -changed

    def summary(
        self,
        setup: Setup,
        poses: Sequence[TargetPose],
        consistency: Consistency,
        grounds: Grounds,
        views: tuple[float | None, FrameTime, int] | None = None,
        **more: Any,
    ) -> MeasureResult:
        """Return the figures of all poses; more: of the result.

        views: reprojection RMS (px), time and n_aside of views that are no frames of pairs; else it is of the 2-D
        residual per point, pooled over all frames.
        """
        rms_px, took, n_aside = views or self._of_pairs()
        return MeasureResult(
            reprojection_rms_px=rms_px,
            ms_per_frame=took,
            n_frames=self.n_frames,
            n_ok=self._counts[PoseStatus.OK],
            n_doubtful=self._counts[PoseStatus.DOUBTFUL],
            n_position_only=self._counts[PoseStatus.POSITION_ONLY],
            n_lost=self._counts[PoseStatus.LOST],
            reasons={kind.value: n for kind, n in self._kinds.most_common() if n},
            candidates=Candidates(**self._candidates) if self._candidates else None,
            std=_medians(np.array(self._std).reshape(-1, 2, 6)),
            consistency=consistency_output(consistency),
            made_with=made_with(setup.rig, setup.target),
            grounds=grounds,
            poses=PoseTrack(poses=poses),
            n_aside=n_aside or None,
            **more,
        )

    def _of_pairs(self) -> tuple[float | None, FrameTime, int]:
        ms, n = np.array(self._ms), self._residuals
        median, p99 = (float(np.median(ms)), float(np.percentile(ms, 99))) if len(ms) else (None, None)
        rms_px = float(np.sqrt(2.0 * self._squares_px2 / n)) if n else None
        return rms_px, FrameTime(median=median, p99=p99), self._aside


def _status_of_points(pose: TargetPose) -> PoseStatus:
    """Return the status of the points of a moment: they are whole even where the pose is not."""
    return PoseStatus.DOUBTFUL if pose.status is PoseStatus.DOUBTFUL else PoseStatus.OK


def _medians(std: Array) -> PoseDeviations | None:
    """Return the median standard deviations of poses (n, [total, systematic], 6) by part and coordinate; None for
    none."""
    if not len(std):
        return None
    random = np.sqrt(np.maximum(std[:, 0] ** 2 - std[:, 1] ** 2, 0.0))

    def median(values: Array) -> PoseStd:
        return PoseStd(**dict(zip(POSE6, np.median(values, axis=0).tolist(), strict=True)))

    return PoseDeviations(total=median(std[:, 0]), random=median(random), systematic=median(std[:, 1]))


def candidates_of(measured: Measured) -> dict[str, int]:
    """Return how many bright things were seen in all images, how many were fitted, and how many are the target's."""
    views = (
        measured.seen[:1]
        if len(measured.seen) == len(SIDES) and measured.seen[0] is measured.seen[-1]
        else measured.seen
    )
    fitted = sum(len(spots) for spots in views)
    return {
        "n_seen": fitted + sum(len(spots.rejected) for spots in views),
        "n_fitted": fitted,
        "n_matched": sum(len(spots) for spots in measured.spots),
    }


def moved_to(pose: TargetPose, world: World | None) -> TargetPose:
    """Return a pose given in rig axes in the world's; unchanged where there is none. See moved_pose."""
    return pose if world is None else moved_pose(pose, world.T_parent_rig, world.parent)


def moved_pose(pose: TargetPose, T_parent_rig: RigidTransform | None, parent: str) -> TargetPose:
    """Return a pose given in rig axes in the parent's; unchanged where T_parent_rig is None or it is lost."""
    if T_parent_rig is None:
        return pose
    T = None
    if pose.T_parent_target is not None:
        T = T_parent_rig.as_matrix() @ pose.T_parent_target
        if pose.status.size < 6:
            T[:3, :3] = np.eye(3)  # the rotation means nothing
    return TargetPose(
        t_s=pose.t_s,
        status=pose.status,
        parent=parent,
        spots=pose.spots,
        T_parent_target=T,
        covariance=_moved(T_parent_rig, pose.covariance),
        residual_px=pose.residual_px,
        why=pose.why,
        systematic_covariance=_moved(T_parent_rig, pose.systematic_covariance),
        origin_known=pose.origin_known,
    )


def _moved(T_parent_rig: RigidTransform, covariance: Array | None) -> Array | None:
    """Return the covariance (6, 6) of a pose, or (3, 3) of a position, in the parent's axes."""
    if covariance is None or len(covariance) == 6:
        return None if covariance is None else moved_parent_covariance(T_parent_rig, covariance)
    R = T_parent_rig.rotation.as_matrix()
    return np.asarray(R @ covariance @ R.T)


DECIMALS = 9
"""m and px are compared to so many places: what a file's text or a quaternion's rounding changes is far below."""


def made_with(rig: Rig, target: Target) -> MadeWith:
    """Return the fingerprints of a rig's cameras and of a target's points: of what is measured with, not of files.

    A comment, a covariance or another name of the file changes nothing; a camera calibrated anew does.
    """
    cameras: list[ArrayLike] = []
    for side in rig.names:
        camera = rig.camera(side)
        plate = [] if camera.plate is None else [camera.plate.thickness_m, camera.plate.index]
        cameras += [[camera.width, camera.height, *plate], camera.intrinsics, rig.T_rig_camera(side).as_matrix()]
    names = [] if rig.is_pair else rig.names
    lenses = [str(one.camera.lens) for one in rig.cameras]
    return MadeWith(
        rig=_fingerprint([str(rig.kind), *names, *lenses], cameras),
        target=_fingerprint([str(target.kind), str(target.model_known), *target.names], [target.xyz_m]),
    )


def _fingerprint(words: Sequence[str], numbers: Sequence[ArrayLike]) -> str:
    """Return the SHA-256, as 64 hexadecimal digits, of words and of numbers rounded to DECIMALS."""
    digest = hashlib.sha256("\n".join([*words, ""]).encode())
    for one in numbers:
        digest.update((np.round(np.asarray(one, dtype="<f8"), DECIMALS) + 0.0).tobytes())  # + 0.0: no -0.0
    return digest.hexdigest()


LISTED = 4
"""Causes that are told in all."""


def consistency_output(found: Consistency) -> ConsistencyOutput:
    """Return the check as measure.json holds it; figures that there is no data for are None."""
    first = found.findings[0] if found.findings else None
    return ConsistencyOutput(
        verdict=found.verdict,
        cause=first.cause.key if first else None,
        estimate=first.size if first and first.cause.unit else None,
        std=first.std if first and first.cause.unit else None,
        unit=first.unit if first else None,
        effect_m=first.effect_m if first else None,
        effect_rad=first.effect_rad if first else None,
        since_s=first.since_s if first else None,
        equally_likely=[f.cause.key for f in found.findings[1 : found.equal]],
        others=[_other(f, found.findings[0]) for f in found.findings[1:LISTED]],
        components=_components(first) if first else {},
        chi2_per_dof=_number(found.chi2_per_dof),
        noise_scale=found.noise_scale,
        refused=found.refused,
        claimed_m=_number(found.claimed_m),
        n_frames=found.frames,
        undetected_m=dict(found.undetected),
        sentence=sentence(found),
        advice=advice(found),
    )


def _other(f: Finding, best: Finding) -> OtherCause:
    return OtherCause(
        cause=f.cause.key,
        estimate=f.size if f.cause.unit else None,
        std=f.std if f.cause.unit else None,
        unit=f.unit,
        effect_m=f.effect_m,
        log_odds=f.evidence - best.evidence,
    )


def _components(f: Finding) -> dict[str, Estimated]:
    deviations = f.covariance.diagonal().clip(min=0.0) ** 0.5
    rows = zip(f.cause.labels, f.estimate.tolist(), deviations.tolist(), strict=True)
    return {label: Estimated(estimate=value, std=std) for label, value, std in rows}


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None
