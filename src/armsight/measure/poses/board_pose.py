"""A printed board in both views -> its pose: the points come with names, nothing has to be matched."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from armsight.arrays import Array, Index
from armsight.errors import BadImage, Inconsistent, Unseen
from armsight.measure.boards import find_board, find_two_boards
from armsight.measure.poses.outcome import Measured, lost_moment
from armsight.measure.poses.pose import NamedSpots, solve_pose
from armsight.measure.poses.setup import Setup
from armsight.records import BoardView, Frame, NotSeen, PoseStatus, Spots, TargetKind

LEAST_POINTS = 4
"""Points of a board seen by both cameras below which its pose is not asked for."""

OUTLIER_CHI2 = 50.0
"""Chi-square of one point (4 coordinates, slack included) beyond which it is a wrong corner: chance 4e-10."""

MAX_DROPPED = 0.2
"""Share of the points that may be wrong corners before the board is not believed."""


def measure_board_pair(setup: Setup, left: Frame, right: Frame, t_s: float) -> Measured:
    """Return the pose of a board seen by both cameras; LOST, with the detector's reason, where one does not see it.

    A live picture is searched the quick way alone, which looks at a picture without a board for a tenth of the time.
    Raises Inconsistent where the board lies behind the cameras, but before them with left and right exchanged.
    """
    frames, detector = (left, right), "quick" if setup.pace.live else "auto"

    def view(side: int) -> BoardView:
        return find_board(frames[side].image, setup.target, source=frames[side].source, detector=detector)

    try:
        if setup.overlaid:
            return pose_of_views(setup, *find_two_boards(left.image, setup.target, source=left.source), t_s)
        views = setup.pace.both(view)
    except BadImage as error:
        return _lost(t_s, str(error), Unseen.NO_BOARD if error.unseen is Unseen.OTHER else error.unseen)
    return pose_of_views(setup, views[0], views[1], t_s)


def pose_of_views(setup: Setup, left: BoardView, right: BoardView, t_s: float) -> Measured:
    """Return the pose of a board from its points found in both views; see measure_board_pair."""
    index, at_left, at_right = np.intersect1d(left.index, right.index, assume_unique=True, return_indices=True)
    if len(index) < LEAST_POINTS:
        why = f"{len(index)} points of the board are seen by both cameras, {LEAST_POINTS} are needed"
        return _lost(t_s, why, Unseen.IN_PART)
    uv = np.ascontiguousarray(np.stack([left.uv_px[at_left], right.uv_px[at_right]], axis=1))  # (n, 2, 2)
    variance = np.array([left.sigma_px, right.sigma_px]) ** 2
    cov = np.tile(variance[:, None, None] * np.eye(2), (len(index), 1, 1, 1))  # (n, 2, 2, 2)
    measured = _fit(setup, t_s, index, uv, cov)
    if measured.pose.status is not PoseStatus.OK:
        exchanged = _fit(setup, t_s, index, np.ascontiguousarray(uv[:, ::-1]), np.ascontiguousarray(cov[:, ::-1]))
        if exchanged.pose.status is PoseStatus.OK:
            raise swapped()
    return replace(measured, seen=(_all(left), _all(right)))


def _fit(setup: Setup, t_s: float, index: Index, uv: Array, cov: Array) -> Measured:
    """Return the pose of the points `index` of the board, wrong corners left out, or LOST where too many are."""
    kept = np.arange(len(index))
    dropped: list[str] = []
    while True:
        names = tuple(setup.target.names[i] for i in index[kept])
        solved = solve_pose(
            setup.packed,
            t_s,
            NamedSpots(
                names,
                np.ascontiguousarray(setup.target.xyz_m[index[kept]]),
                uv[kept],
                cov[kept],
                printed_radius(setup, len(kept), 2),
                setup.model.normal,
            ),
            limit=np.inf,  # judged point by point
            slack_px=setup.slack_px,
        )
        worst = _worst(solved.pose.residual_px, cov[kept], setup.slack_px)
        if worst is None or len(dropped) >= MAX_DROPPED * len(index) or len(kept) <= LEAST_POINTS:
            break
        dropped.append(names[worst])
        kept = np.delete(kept, worst)
    if worst is not None:
        why = f"more than {len(dropped)} points of the board are off: a wrong board or a bad calibration"
        return _lost(t_s, why, Unseen.MISFIT)
    if solved.pose.status is PoseStatus.LOST:
        return _lost(t_s, solved.pose.why, solved.cause)
    return Measured(
        pose=solved.pose,
        points=solved.points,
        spots=(_spots(uv[kept, 0], cov[kept, 0]), _spots(uv[kept, 1], cov[kept, 1])),
        names=names,
        seen=(Spots.none(),) * 2,
        notes=tuple(f"{name} left out: it does not fit the others" for name in dropped),
        cause=solved.cause,
    )


def _worst(residual_px: Array, cov: Array, slack_px: float) -> int | None:
    """Return the point whose residuals are beyond chance, the worst one; None where there is none."""
    variance = cov[..., 0, 0] + slack_px**2  # (n, 2); a board's points are as certain in u as in v
    chi2 = (residual_px.reshape(-1, 2, 2) ** 2 / variance[: residual_px.size // 4, :, None]).sum(axis=(1, 2))
    return int(np.argmax(chi2)) if len(chi2) and chi2.max() > OUTLIER_CHI2 else None


def printed_radius(setup: Setup, n: int, v: int) -> Array:
    """Return (n, v) radii: those of printed circles of known size, else 0."""
    circles = setup.target.kind in (TargetKind.CIRCLES, TargetKind.ACIRCLES)
    return np.full((n, v), setup.model.radius_m if circles else 0.0)


def swapped() -> Inconsistent:
    """Return the error that says that left and right are exchanged."""
    return Inconsistent(
        "left and right are swapped: the target is found, or fits, only with the two images exchanged",
        consequence="Nothing is measured: the depths would be turned round",
        cure="Exchange the two sources, or calibrate the rig with the cameras as they are now",
    )


def _all(view: BoardView) -> Spots:
    return _spots(view.uv_px, np.tile(view.sigma_px**2 * np.eye(2), (len(view), 1, 1)))


def _spots(uv: Array, cov: Array) -> Spots:
    n = len(uv)
    return Spots(uv_px=uv, covariance_px2=cov, peak=np.zeros(n), size_px=np.zeros(n), model=("corner",) * n)


def _lost(t_s: float, why: str, cause: Unseen) -> Measured:
    return lost_moment(t_s, (Spots.none(),) * 2, NotSeen(why, cause))
