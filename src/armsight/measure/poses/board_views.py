"""A printed board before any number of cameras -> its pose: one likelihood over every corner that each camera shows.

Two cameras have their own way, `board_pose`, by which both must see a corner.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from armsight.arrays import Array, Index, Mask
from armsight.errors import BadImage, Unseen
from armsight.measure.boards import find_board
from armsight.measure.poses.board_pose import LEAST_POINTS, MAX_DROPPED, printed_radius
from armsight.measure.poses.kernels import one_view as kernels
from armsight.measure.poses.outcome import Measured, lost_moment
from armsight.measure.poses.pose import NamedSpots, PoseSolution, solve_pose
from armsight.measure.poses.setup import Setup
from armsight.optics.kernels.camera import project_many
from armsight.records import Frame, NotSeen, PoseStatus, Spots
from armsight.records.checks import for_kernels
from armsight.records.views import symmetries

OUTLIER_CHI2 = 43.3
"""Chi-square of one sight (2 coordinates, slack included) beyond which it is a wrong corner: chance 4e-10."""
AS_WRONG = 0.25
"""Share of the worst sight's chi-square from which others are left out with it: one wrong corner bends its neighbours'
residuals by less, and a camera that has moved has many that are alike."""


def measure_board_views(setup: Setup, t_s: float, frames: Sequence[Frame | None]) -> Measured:
    """Return the pose of a board from one frame of each camera, None where it has none; LOST where none sees it.

    A live picture is searched the quick way alone, as board_pose does.
    """
    detector = "quick" if setup.pace.live else "auto"

    def look(s: int) -> Spots | NotSeen | None:
        frame = frames[s]
        if frame is None:
            return None
        try:
            view = find_board(frame.image, setup.target, source=frame.source, detector=detector)
        except BadImage as error:
            return NotSeen(str(error), Unseen.NO_BOARD if error.unseen is Unseen.OTHER else error.unseen)
        n = len(view)
        return Spots(
            uv_px=view.uv_px,
            covariance_px2=np.tile(view.sigma_px**2 * np.eye(2), (n, 1, 1)),
            peak=np.zeros(n),
            size_px=np.zeros(n),
            model=("corner",) * n,
            point=view.index,
        )

    found = setup.pace.each(look, len(frames))
    seen = tuple(one if isinstance(one, Spots) else Spots.none() for one in found)
    missed = [one for one in found if isinstance(one, NotSeen)]
    if not any(map(len, seen)) and missed:
        return lost_moment(t_s, seen, NotSeen(f"no camera sees the board; {missed[0].why}", missed[0].cause))
    return pose_of_corners(setup, t_s, seen)


def pose_of_corners(setup: Setup, t_s: float, seen: Sequence[Spots], *, judged: bool = True) -> Measured:
    """Return the pose of a board by its points as each view shows them, `point` says which.

    Wrong corners are left out, or the pose is LOST where these are many; not where it is not judged.
    """
    seen = tuple(seen)
    if max(map(len, seen)) < LEAST_POINTS:
        n = max(map(len, seen))
        why = f"a camera sees {n} points of the board at most, {LEAST_POINTS} are needed"
        return lost_moment(t_s, seen, NotSeen(why, Unseen.IN_PART))
    T, seen = _same_numbers(setup, seen)
    index = np.unique(np.concatenate([one.point for one in seen if one.point is not None]))
    uv, cov = np.full((len(index), len(seen), 2), np.nan), np.full((len(index), len(seen), 2, 2), np.inf)
    for s, spots in enumerate(seen):
        if spots.point is not None:
            at = np.searchsorted(index, spots.point)
            uv[at, s], cov[at, s] = spots.uv_px, spots.covariance_px2
    start = _best_start(setup, index, uv, cov, T)
    if start is None:
        return lost_moment(t_s, seen, NotSeen("the views of the board give no common pose", Unseen.MISFIT))
    return _fit(setup, t_s, seen, (index, uv, cov), start, judged=judged)


def _same_numbers(setup: Setup, seen: tuple[Spots, ...]) -> tuple[list[Array], tuple[Spots, ...]]:
    """Return T_rig_board (4, 4) by each view of enough points, and all views numbered as the first of them.

    A print that looks the same when turned is counted by each view as it stands in its picture.
    """
    X, poses, out = setup.target.xyz_m, list[Array](), list(seen)
    turns = symmetries(setup.target)
    for s, spots in enumerate(seen):
        if spots.point is None or len(spots) < LEAST_POINTS:
            continue
        if poses and len(turns) > 1:
            expected = np.empty((len(X), 2))
            project_many(*setup.packed.camera(s), for_kernels(X @ poses[0][:3, :3].T + poses[0][:3, 3]), expected)
            numbers = [turn[spots.point] for turn in turns]
            far = [np.linalg.norm(expected[one] - spots.uv_px, axis=1).sum() for one in numbers]
            taken = {name: getattr(spots, name) for name in Spots.__slots__}
            out[s] = Spots(**(taken | {"point": numbers[int(np.argmin(np.nan_to_num(far, nan=np.inf)))]}))
        own = _by_one_view(setup, s, out[s])
        if own is not None:
            poses.append(own)
    return poses, tuple(out)


def _by_one_view(setup: Setup, s: int, spots: Spots) -> Array | None:
    """Return T_rig_board (4, 4) by one view's points on their plane; None where their rays are not known."""
    one = setup.rig.cameras[s]
    rays = one.camera.rays(spots.uv_px)
    if not np.isfinite(rays).all():
        return None
    X = np.ascontiguousarray(setup.target.xyz_m[spots.point])
    T = np.eye(4)
    try:
        found, turn, place = cv2.solvePnP(X, rays[:, None], np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
    except cv2.error:  # points on one line
        return None
    T[:3, :3], T[:3, 3] = cv2.Rodrigues(turn)[0], place[:, 0]
    return np.asarray(one.T_rig_camera.as_matrix() @ T) if found and np.isfinite(T).all() else None


def _best_start(setup: Setup, index: Index, uv: Array, cov: Array, starts: Sequence[Array]) -> Array | None:
    """Return the pose (4, 4) of least chi-square of all sights near those by one view each, and their mirror images."""
    h, best, chi2_of_best = uv.shape[1] + 1, None, np.inf
    lights = for_kernels(setup.target.xyz_m[index]), printed_radius(setup, *uv.shape[:2]), setup.model.normal
    for start in starts:
        T, C, scores = np.empty((h, 4, 4)), np.empty((h, 6, 6)), np.empty((h, 3))
        start.setflags(write=False)  # as UNKNOWN: one compilation serves both
        kernels.tilts(setup.packed.arrays, lights, (uv, cov), setup.slack_px**2, start, T, C, scores)
        chi2 = scores[:, 0]
        i = int(np.argmin(chi2))
        if chi2[i] < chi2_of_best:
            best, chi2_of_best = T[i].copy(), float(chi2[i])
    return best


def _fit(
    setup: Setup,
    t_s: float,
    seen: tuple[Spots, ...],
    sights: tuple[Index, Array, Array],
    start: Array,
    *,
    judged: bool,
) -> Measured:
    """Return the pose of all sights near a start, wrong ones left out; see pose_of_corners."""
    index, uv, cov = sights
    start.setflags(write=False)
    total, dropped = int(np.isfinite(uv[..., 0]).sum()), list[str]()
    while True:
        shown = np.isfinite(uv[..., 0])
        kept = np.flatnonzero(shown.any(axis=1))
        solved = _solved(setup, t_s, index[kept], uv[kept], cov[kept], start)
        wrong = _wrong(setup, solved, shown[kept], cov[kept]) if judged else []
        if not wrong:
            break
        if len(dropped) + len(wrong) > MAX_DROPPED * total or shown.sum() - len(wrong) < LEAST_POINTS:
            why = f"{len(dropped) + len(wrong)} sights of the board's points are off: a wrong board or calibration"
            return lost_moment(t_s, seen, NotSeen(why, Unseen.MISFIT))
        for i, s in wrong:
            dropped.append(f"{setup.target.names[index[kept[i]]]} of {setup.rig.names[s]}")
            uv[kept[i], s], cov[kept[i], s] = np.nan, np.inf
    if solved.pose.status is PoseStatus.LOST:
        return lost_moment(t_s, seen, solved.missed)
    return Measured(
        pose=solved.pose,
        points=solved.points,
        spots=tuple(_taken(one, index[shown[:, s]]) for s, one in enumerate(seen)),
        names=tuple(setup.target.names[i] for i in index[kept].tolist()),
        seen=seen,
        sights=shown[kept],
        notes=tuple(f"{name} left out: it does not fit the others" for name in dropped),
        cause=solved.cause,
    )


def _solved(setup: Setup, t_s: float, index: Index, uv: Array, cov: Array, start: Array) -> PoseSolution:
    names = tuple(setup.target.names[i] for i in index.tolist())
    X = np.ascontiguousarray(setup.target.xyz_m[index])
    spots = NamedSpots(names, X, uv, cov, printed_radius(setup, *uv.shape[:2]), setup.model.normal)
    return solve_pose(setup.packed, t_s, spots, limit=np.inf, slack_px=setup.slack_px, start=start)


def _wrong(setup: Setup, solved: PoseSolution, shown: Mask, cov: Array) -> list[tuple[int, int]]:
    """Return the sights (light, view) whose residuals are beyond chance: the worst one and those hardly better."""
    if solved.pose.residual_px.size != 2 * shown.sum():
        return []  # nothing was solved
    chi2 = np.zeros(shown.shape)
    variance = cov[..., 0, 0] + setup.slack_px**2  # a board's points are as certain in u as in v
    chi2[shown] = (solved.pose.residual_px.reshape(-1, 2) ** 2).sum(axis=1) / variance[shown]
    return [(int(i), int(s)) for i, s in np.argwhere(chi2 > max(OUTLIER_CHI2, AS_WRONG * chi2.max()))]


def _taken(spots: Spots, points: Index) -> Spots:
    """Return the spots of these points, in their order."""
    if spots.point is None:
        return spots
    order = np.argsort(spots.point)
    return spots.take(order[np.searchsorted(spots.point[order], points)])
