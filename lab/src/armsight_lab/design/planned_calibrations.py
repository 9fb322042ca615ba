"""How sure a calibration from boards will be before it is done: the Fisher information of views that are planned."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation
from scipy.special import chdtri

from armsight.arrays import Array
from armsight.calibrate.cameras.bundle_adjustment import BY_CHANCE, Bundle, problem_of, side_by_side
from armsight.calibrate.cameras.observations import BoardOptions, Observations
from armsight.calibrate.cameras.outlier_rejection import LAST_TERMS, fixed_names
from armsight.calibrate.cameras.pairing import in_frame, of_one_lens, rig_of
from armsight.calibrate.cameras.preconditions import LEAST_VIEWS
from armsight.calibrate.handeye.known_noise import CONDITION, linearise
from armsight.calibrate.handeye.pairs import components
from armsight.errors import Degenerate, NotEnoughData
from armsight.fitting import Problem, inverse_information
from armsight.fitting.groups import whitener
from armsight.geometry.poses import skew
from armsight.optics import SIDES, Rig, RigKind, mean_axes
from armsight.records import NamedCovariance, Target
from armsight.units import DEG

CANDIDATES, ROUNDS = 4000, 8
"""Poses of the board that are drawn at a time, and how often before it is said not to fit into both views."""
SPAN = (0.25, 0.75)
"""Share of the left image's width that the board's longer side takes: as people hold it."""
MOST_TILT_RAD = 40.0 * DEG
MOST_ROLL_RAD = 20.0 * DEG
MARGIN_PX = 12.0
"""How far inside both images the board ends."""
DRAWN = 1
"""Seed: the same rig and board are planned with the same views."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlannedViews:
    """Where a board is held for a calibration: T_rig_board of each view; sigma_px: of one coordinate of one point."""

    board: Target
    T_rig_board: RigidTransform
    sigma_px: float

    def __len__(self) -> int:
        return len(self.T_rig_board)


def planned_views(rig: Rig, board: Target, n: int, sigma_px: float) -> PlannedViews:
    """Return n poses of a board all over the common view, tilted up to 40 degrees, whole in both images.

    Raises NotEnoughData for fewer views than a calibration takes, and where no pose is whole in both.
    """
    if n < LEAST_VIEWS:
        raise NotEnoughData(
            f"{n} views of the board are planned, {LEAST_VIEWS} are the fewest that calibrate a rig",
            consequence="Nothing can be said of a rig that is not calibrated",
            cure="Plan 15 to 30 views",
        )
    rng = np.random.default_rng(DRAWN)
    found: list[RigidTransform] = []
    for round_ in range(ROUNDS):
        # wide rigs see little of what is near: their boards are held where they span less
        drawn = _drawn(rig, board, rng, SPAN if round_ == 0 or found else (0.4 * SPAN[0], SPAN[1]))
        whole = np.flatnonzero(_whole(rig, board, drawn))
        found += [drawn[int(i)] for i in whole[: n - len(found)]]
        if len(found) == n:
            break
    if len(found) < n:
        size = 1e3 * np.ptp(board.xyz_m, axis=0)
        raise NotEnoughData(
            f"no {n} places were found at which both cameras see all of a board of {size[0]:.0f} x {size[1]:.0f} mm",
            consequence="The rig cannot be calibrated with it, so nothing can be said of what it measures",
            cure="Plan a smaller board, or turn the cameras so that their views overlap more",
        )
    return PlannedViews(board=board, T_rig_board=RigidTransform.concatenate(found), sigma_px=sigma_px)


def _drawn(rig: Rig, board: Target, rng: np.random.Generator, span: tuple[float, float]) -> RigidTransform:
    """Return CANDIDATES poses T_rig_board, the board's middle on rays of the left image."""
    camera, T = rig.left, rig.T_rig_left
    length = float(np.ptp(board.xyz_m, axis=0).max())
    uv = rng.uniform(0.1, 0.9, (CANDIDATES, 2)) * [camera.width - 1.0, camera.height - 1.0]
    rays = np.column_stack([camera.rays(uv), np.ones(CANDIDATES)])
    share = np.exp(rng.uniform(np.log(span[0]), np.log(span[1]), CANDIDATES))
    depth = camera.intrinsics[0] * length / (share * camera.width)
    at = np.asarray(T.translation) + T.rotation.apply(np.nan_to_num(rays) * depth[:, None])
    way, lean = rng.uniform(0.0, 2.0 * np.pi, CANDIDATES), rng.uniform(0.0, MOST_TILT_RAD, CANDIDATES)
    tilt = Rotation.from_rotvec(np.column_stack([lean * np.cos(way), lean * np.sin(way), 0.0 * lean]))
    roll = Rotation.from_rotvec(np.outer(rng.uniform(-MOST_ROLL_RAD, MOST_ROLL_RAD, CANDIDATES), [0.0, 0.0, 1.0]))
    turn = Rotation.from_matrix(mean_axes(rig)) * tilt * roll
    return RigidTransform.from_components(at - turn.apply(board.xyz_m.mean(axis=0)), turn)


def _whole(rig: Rig, board: Target, poses: RigidTransform) -> NDArray[np.bool_]:
    """Tell which poses of a board lie whole in both images, its outer border of one pitch too."""
    low, high = board.xyz_m.min(axis=0) - board.pitch_m, board.xyz_m.max(axis=0) + board.pitch_m
    edge = np.array([(x, y, 0.0) for x in (low[0], high[0]) for y in (low[1], high[1])])
    points = (poses.rotation.as_matrix() @ edge.T).transpose(0, 2, 1) + poses.translation[:, None]  # (m, 4, 3)
    fine = np.ones(len(points), bool)
    for side, uv in zip(SIDES, rig.project(points.reshape(-1, 3)), strict=True):
        camera = rig.camera(side)
        inside = (uv >= MARGIN_PX) & (uv <= np.array([camera.width, camera.height]) - 1.0 - MARGIN_PX)
        fine &= inside.all(axis=1).reshape(-1, 4).all(axis=1)
    return fine


def planned_rig(rig: Rig, views: PlannedViews, options: BoardOptions | None = None) -> Rig:
    """Return the rig with the covariance that its calibration from the views will have, by the Cramer-Rao bound.

    It is that of the bundle adjustment's normal equations at the true values; a plate's thickness is taken as known.
    The last distortion terms are free where a lens has them so large that the data would ask for them. Raises
    Degenerate where the views leave something open.
    """
    options = options or BoardOptions(lens=rig.left.lens, right_lens=rig.right.lens)
    observations, start = _expected(rig, views)
    fixed = fixed_names(options, observations)
    held = fixed_names(replace(options, automatic_k3=False), observations)
    if options.automatic_k3 and fixed != held:
        wider = _covariance(problem_of(observations, start, held))
        last = tuple(f"{side}.{name}" for side in SIDES for name in LAST_TERMS[rig.camera(side).lens])
        asked = [name for name in last if name in wider.names]
        k = np.array([_intrinsic(rig, name) for name in asked])
        if k @ np.linalg.solve(wider.block(tuple(asked)), k) + len(k) > chdtri(len(k), BY_CHANCE):
            fixed = held
    covariance = _covariance(problem_of(observations, start, fixed))
    covariance = of_one_lens(covariance) if observations.one_lens else covariance
    alone = rig_of(start, observations.sizes, covariance=covariance, lenses=observations.lenses)
    return replace(rig, covariance=in_frame(alone, rig.T_rig_left).covariance)


def _intrinsic(rig: Rig, name: str) -> float:
    side, plain = name.split(".")
    camera = rig.camera(side)
    return float(camera.intrinsics[camera.names.index(plain)])


def _expected(rig: Rig, views: PlannedViews) -> tuple[Observations, Bundle]:
    """Return what the cameras will see of the board, without noise, and the truth as the adjustment's state."""
    board, poses, n = views.board, views.T_rig_board, len(views)
    middle = board.xyz_m.mean(axis=0)
    points = (poses.rotation.as_matrix() @ board.xyz_m.T).transpose(0, 2, 1) + poses.translation[:, None]
    bare = rig.with_each(camera=[replace(one.camera, plate=None) for one in rig.cameras])
    uv = np.stack([seen.reshape(n, -1, 2) for seen in bare.project(points.reshape(-1, 3))], axis=1)  # (G, 2, n, 2)
    size = np.array([[rig.camera(side).width, rig.camera(side).height] for side in SIDES])[None, :, None]
    seen = np.asarray(np.isfinite(uv).all(axis=3) & (uv >= 0.0).all(axis=3) & (uv <= size - 1.0).all(axis=3))
    observations = Observations(
        X=board.xyz_m - middle,
        middle=middle,
        uv=np.where(seen[..., None], uv, 0.0),
        weight=np.where(seen, 1.0 / views.sigma_px, 0.0),
        sizes=((rig.left.width, rig.left.height), (rig.right.width, rig.right.height)),
        sources=tuple((f"view {g + 1}", f"view {g + 1}") for g in range(n)),
        radius_m=0.5 * board.diameter_m if board.diameter_m else 0.0,
        one_lens=rig.kind is RigKind.MIRROR,
        lenses=(rig.left.lens, rig.right.lens),
    )
    T_left_middle = rig.T_rig_left.inv() * poses * RigidTransform.from_translation(middle)
    T_left_right = rig.T_rig_left.inv() * rig.T_rig_right
    return observations, Bundle(
        k=side_by_side([rig.left.intrinsics, rig.right.intrinsics]),
        sides=np.concatenate([T_left_right.translation, T_left_right.rotation.as_rotvec()])[None],
        poses=np.column_stack([T_left_middle.translation, T_left_middle.rotation.as_rotvec()]),
    )


def _covariance(problem: Problem) -> NamedCovariance:
    """Return the inverse of the information on the free shared parameters, the boards' poses eliminated."""
    free = np.array([i for i, name in enumerate(problem.names) if name not in problem.fixed], dtype=np.intp)
    evaluation = problem.evaluate(problem.guess, problem.local_guess)
    normal = problem.normal_equations(evaluation, problem.guess, free)
    matrix, open_ = inverse_information(normal.reduced_system(), np.diag(normal.A), problem.free)
    if open_:
        raise Degenerate(
            "the planned views leave some of the rig's parameters open",
            consequence="Such a calibration would be refused",
            cure="Plan more views, or a larger board",
        )
    return NamedCovariance(names=problem.free, matrix=0.5 * (matrix + matrix.T))


UNKNOWN = tuple(
    f"{pose}.{part}" for pose in ("T_base_rig", "T_flange_target") for part in ("x", "y", "z", "rx", "ry", "rz")
)
"""The unknowns of planned_handeye, in their order."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RobotNoise:
    """Standard deviations of one component of where the flange truly is: position, and orientation."""

    position_m: float
    orientation_rad: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlannedHandEye:
    """T_base_rig and T_flange_target with what a calibration will leave open of them.

    covariance (12, 12): dt, dw of T_base_rig, then of T_flange_target, from the noise of cameras and robot.
    slopes (12, p): how both follow the p parameters that all camera poses hang on.
    """

    T_base_rig: RigidTransform
    T_flange_target: RigidTransform
    covariance: Array
    slopes: Array


def planned_handeye(
    T_base_rig: RigidTransform,
    T_flange_target: RigidTransform,
    T_base_flange: RigidTransform,
    camera: tuple[Array, Array],
    robot: RobotNoise,
) -> PlannedHandEye:
    """Return what a calibration of a rig beside the arm from n poses T_base_flange will give.

    camera: of the rig's poses of the target, their covariances (n, 6, 6), and how they follow p common parameters
    (n, 6, p). Raises Degenerate where the poses leave something open.
    """
    random, common = camera
    X, Z = components(T_base_rig), components(T_flange_target)
    T_rig_target = T_base_rig.inv() * T_base_flange * T_flange_target
    arrays = (*components(T_base_flange.inv()), *components(T_rig_target))
    at = linearise(arrays, X, Z, 1.0, to_hand=True)
    unit = np.zeros((6, 6))
    unit[:3, :3] = np.eye(3)
    V = random + robot.position_m**2 * unit + robot.orientation_rad**2 * at.L  # (n, 6, 6)
    W = whitener(V, CONDITION)
    J = W @ at.J[:, :, :12]
    information = np.einsum("nia,nib->ab", J, J)
    C, open_ = inverse_information(information, np.diag(information), UNKNOWN)
    if open_:
        raise Degenerate(
            "the planned poses of the arm leave the rig's place open",
            consequence="Nothing can be said of the tool in the arm's base",
            cure="Plan more poses, or a volume in which the target can be turned about two axes",
        )
    # least squares: d unknowns = -C J' W d camera pose
    slopes = -C @ np.einsum("nia,nij,njp->ap", J, W, common)
    return PlannedHandEye(T_base_rig=T_base_rig, T_flange_target=T_flange_target, covariance=C, slopes=slopes)


def tool_slopes(
    known: PlannedHandEye, T_rig_target: RigidTransform, T_flange_tool: RigidTransform
) -> tuple[Array, Array]:
    """Return how T_base_tool = X B Z^-1 T_flange_tool follows the rig's poses B (m, 6, 6), and X and Z (m, 6, 12).

    Each moves as t + dt, Exp(dw) R in its parent's axes.
    """
    RX, _ = components(known.T_base_rig)
    RZ, tZ = components(known.T_flange_target)
    RB, _ = components(T_rig_target)
    m = len(RB)
    tip = np.asarray(T_flange_tool.translation) - tZ  # (3,) from the target, in flange axes
    seen = RB @ (RZ.T @ tip)  # (m, 3): from the target, in rig axes
    place = T_rig_target.translation + seen
    of_camera, of_known = np.zeros((m, 6, 6)), np.zeros((m, 6, 12))
    of_camera[:, :3, :3] = of_camera[:, 3:, 3:] = RX
    of_camera[:, :3, 3:] = RX @ -skew(seen)
    turn = RX @ RB @ RZ.T  # (m, 3, 3): T_base_flange's
    of_known[:, :3, :3] = np.eye(3)
    of_known[:, :3, 3:6] = -skew(place @ RX.T)
    of_known[:, :3, 6:9] = -turn
    of_known[:, :3, 9:] = turn @ skew(tip)
    of_known[:, 3:, 3:6] = np.eye(3)
    of_known[:, 3:, 9:] = -turn
    return of_camera, of_known
