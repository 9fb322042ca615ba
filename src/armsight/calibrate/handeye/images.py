"""Hand-eye calibration from the corners themselves: reprojection, with the robot's noise weighed against it.

Three things are unknown of every image: nothing more than the target's pose in the camera (6), which the corners
measure by reprojection, and the robot, with its own noise, through the hand-eye equation. Taking the robot as exact
and reprojecting through it would weigh its millimetres as pixels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.calibrate.cameras.bundle_adjustment import EMPTY, Bundle, problem_of
from armsight.calibrate.handeye.advice import advise
from armsight.calibrate.handeye.calibrate import HandEyeOptions, calibrate_eye_in_hand, calibrate_eye_to_hand
from armsight.calibrate.handeye.kernels import fit as kernels
from armsight.calibrate.handeye.kernels import noise as noise_kernels
from armsight.calibrate.handeye.noise import Noise, part
from armsight.calibrate.handeye.pairs import Array, Arrays, PosePairs, Setup, components, pose
from armsight.calibrate.handeye.result import NAMES, HandEye
from armsight.calibrate.handeye.solution import residuals
from armsight.calibrate.handeye.target_views import ViewPoses, cross, poses_of_views
from armsight.calibrate.handeye.variances import Restricted, restricted_variances
from armsight.errors import Inconsistent
from armsight.fitting import EvaluatedNormalEquations, Evaluation, Fit, Problem, Settings, solve
from armsight.optics import Camera
from armsight.records import BoardView, NamedCovariance, Target

FREE_INTRINSICS = frozenset({"fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"})
"""What is freed of the camera on request; skew and k3 stay."""


LEAST = np.array([1e-12, 1e-12, 0.0])
"""Beside the corners' noise at least a micrometre and a microradian are left to the robot: none is exact, and weights
without end would ruin the arithmetic."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ImageHandEye:
    """The result, and the camera: as given, or as fitted along with it."""

    result: HandEye
    camera: Camera


def calibrate_from_views(
    views: Sequence[BoardView],
    T_base_flange: Sequence[RigidTransform],
    camera: Camera,
    board: Target,
    setup: Setup,
    *,
    free_camera: bool = False,
) -> ImageHandEye:
    """Return the hand-eye calibration from board views and the robot's pose at each, same order.

    free_camera: fit the camera's intrinsics along. Raises as calibrate_eye_in_hand, and Inconsistent for images
    of another size than the camera's.
    """
    if len(views) != len(T_base_flange):
        raise Inconsistent(f"{len(views)} views and {len(T_base_flange)} robot poses do not pair up")
    seen = poses_of_views(views, camera, board)
    pairs = PosePairs.of(T_base_flange, [seen.T_camera_target[i] for i in range(len(views))], [v.source for v in views])
    calibrate = calibrate_eye_in_hand if setup is Setup.EYE_IN_HAND else calibrate_eye_to_hand
    result = calibrate(pairs, HandEyeOptions(target_pitch_m=board.pitch_m or None))
    model = _Model.of(result, seen)
    restricted = model.variances()
    fit = model.reproject(restricted.V[result.used], camera, free_camera)
    moved = camera
    if free_camera:
        moved = replace(camera, intrinsics=fit.shared[12:])
        seen = poses_of_views(views, moved, board)
        pairs = replace(pairs, T_camera_target=seen.T_camera_target)
        model = replace(model, arrays=pairs.arrays(setup), seen=seen)
        result = replace(result, pairs=pairs)
    refined = _refined(result, seen, model, restricted, fit)
    return ImageHandEye(result=advise(refined, board.pitch_m or None), camera=moved)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Model:
    """The used pairs and where the pose fit left the unknowns."""

    setup: Setup
    arrays: Arrays
    used: np.ndarray
    seen: ViewPoses
    start: tuple[Array, Array, Array, Array]

    @classmethod
    def of(cls, result: HandEye, seen: ViewPoses) -> _Model:
        RX, tX = components(result.T_parent_camera)
        RZ, tZ = components(result.T_parent_target)
        return cls(
            setup=result.setup,
            arrays=result.pairs.arrays(result.setup),
            used=result.used,
            seen=seen,
            start=(RX, tX, RZ, tZ),
        )

    def linearised(self, at: tuple[Array, Array, Array, Array]) -> tuple[Array, Array, Array]:
        """Return residuals e (n, 6), derivatives J (n, 6, 12) by X and Z, and lever shapes L (n, 6, 6)."""
        RX, tX, RZ, tZ = at
        RF, tF, RB, tB = self.arrays
        n = len(RF)
        e, J, L = np.empty((n, 6)), np.empty((n, 6, 13)), np.empty((n, 6, 6))
        P, t_hat, work, E = np.empty((3, 3)), np.empty(3), np.empty((2, 3, 3)), np.empty((3, 3))
        for i in range(n):
            kernels.residual(RX, tX, RZ, tZ, 1.0, RF[i], tF[i], RB[i], tB[i], e[i], P, t_hat, work)
            kernels.jacobian(RX, 1.0, e[i], P, t_hat, J[i])
            to_hand = self.setup is Setup.EYE_TO_HAND
            length = noise_kernels.lever_frame(RX, tX, 1.0, RF[i], tF[i], t_hat, to_hand, E)
            reach = np.concatenate(
                [-cross(length * E[2:])[0], np.eye(3)]
            )  # (6, 3): dw at the flange seen at the target
            L[i] = reach @ reach.T
        return e, J[:, :, :12], L

    def variances(self) -> Restricted:
        """Return the noises beside that of the corners, by restricted maximum likelihood."""
        e, J, L = self.linearised(self.start)
        n = len(e)
        Q = np.zeros((3, n, 6, 6))
        Q[0, :, :3, :3] = Q[1, :, 3:, 3:] = np.eye(3)
        Q[2] = L
        return restricted_variances(e, J, self.seen.covariance, Q, self.used, LEAST)

    def reproject(self, V: Array, camera: Camera, free_camera: bool) -> Fit:
        """Return the fit of X, Z, the camera and the target's pose in each used view to corners and robot."""
        used = np.flatnonzero(self.used)
        sightings = self.seen.sightings.take(used)
        F = self.arrays[0][used], self.arrays[1][used]
        whiten = np.linalg.inv(np.linalg.cholesky(V))  # (n, 6, 6)
        G = len(used)
        poses = self.seen.centred[used]
        boards = problem_of(
            sightings, Bundle(k=camera.intrinsics[None], side_pose=np.zeros(6), poses=poses), frozenset()
        )

        def evaluate(shared: Array, local: Array) -> Evaluation:
            corners = boards.evaluate(shared[12:], local)
            by_corners = corners.condensed
            if by_corners is None or not np.isfinite(corners.residuals).all():
                bad = np.full((G, corners.residuals.shape[1] + 6), np.nan)
                return Evaluation(residuals=bad, shared=EMPTY, local=EMPTY)
            e, J, by_pose = self._at(shared, local, F, sightings.middle)
            e = np.einsum("nij,nj->ni", whiten, e)
            J, by_pose = whiten @ J, whiten @ by_pose
            condensed = _with_robot(by_corners, e, J, by_pose)
            residuals = np.concatenate([corners.residuals, e], axis=1)
            return Evaluation(residuals=residuals, shared=EMPTY, local=EMPTY, condensed=condensed)

        def retract(shared: Array, local: Array, ds: Array, dl: Array) -> tuple[Array, Array]:
            return _stepped(shared, ds), boards.retract(shared[12:], local, ds[12:], dl)[1]

        RX, tX, RZ, tZ = self.start
        rotvecs = [Rotation.from_matrix(R).as_rotvec() for R in (RX, RZ)]
        problem = Problem(
            names=(*NAMES, *camera.names),
            guess=np.concatenate([tX, rotvecs[0], tZ, rotvecs[1], camera.intrinsics]),
            evaluate=evaluate,
            n_residuals=2 * sightings.n_points + 6 * G,
            local_names=("tx", "ty", "tz", "rx", "ry", "rz"),
            local_guess=poses,
            fixed=frozenset(camera.names) - (FREE_INTRINSICS if free_camera else frozenset()),
            retract=retract,
        )
        return solve(problem, Settings(cost_tolerance=1e-9))

    def _at(self, shared: Array, local: Array, F: tuple[Array, Array], middle: Array) -> tuple[Array, Array, Array]:
        """Return e (n, 6), its derivatives (n, 6, 12) by X and Z and (n, 6, 6) by the poses of the board's middle."""
        turned = Rotation.from_rotvec(np.array(local[:, 3:]))  # scipy takes no read-only array
        lever = turned.apply(middle)
        inner = replace(self, arrays=(*F, np.ascontiguousarray(turned.as_matrix()), local[:, :3] - lever))
        e, J, _ = inner.linearised((_rotation(shared[3:6]), shared[:3], _rotation(shared[9:12]), shared[6:9]))
        by_pose = np.tile(np.eye(6), (len(local), 1, 1))
        by_pose[:, :3, 3:] = cross(lever)
        by_pose[:, 3:, 3:] = _left_inverse(e[:, 3:])
        return e, J, by_pose


def _with_robot(corners: EvaluatedNormalEquations, e: Array, J: Array, by_pose: Array) -> EvaluatedNormalEquations:
    """Return the normal equations of X, Z, camera and poses: the corners' and the robot's whitened errors e (n, 6).

    J (n, 6, 12), by_pose (n, 6, 6): derivatives of e by X and Z and by the poses.
    """
    A, b, W = np.zeros((22, 22)), np.zeros(22), np.zeros((len(e), 22, 6))
    A[:12, :12], A[12:, 12:] = np.einsum("nia,nib->ab", J, J), corners.A
    b[:12], b[12:] = np.einsum("nia,ni->a", J, e), corners.b
    W[:, :12], W[:, 12:] = J.transpose(0, 2, 1) @ by_pose, corners.W
    return EvaluatedNormalEquations(
        A=A,
        b=b,
        C=corners.C + by_pose.transpose(0, 2, 1) @ by_pose,
        c=corners.c + np.einsum("nia,ni->na", by_pose, e),
        W=W,
    )


def _stepped(shared: Array, step: Array) -> Array:
    """Return X, Z and the camera after a step; the rotations of X and Z (rotvecs at 3 and 9) turn by theirs."""
    moved = shared + step
    for at in (3, 9):
        turn, before = Rotation.from_rotvec(step[at : at + 3]), Rotation.from_rotvec(np.array(shared[at : at + 3]))
        moved[at : at + 3] = (turn * before).as_rotvec()
    return moved


def _refined(result: HandEye, seen: ViewPoses, model: _Model, restricted: Restricted, fit: Fit) -> HandEye:
    """Return the result with the reprojection's answer in place of the pose fit's."""
    RX, RZ = (_rotation(fit.shared[at : at + 3]) for at in (3, 9))
    at = (RX, fit.shared[:3], RZ, fit.shared[6:9])
    covariance = result.covariance.matrix if fit.covariance is None else fit.covariance.block(NAMES)
    widen = result.coverage_factor**2
    return replace(
        result,
        T_parent_camera=pose(RX, fit.shared[:3]),
        T_parent_target=pose(RZ, fit.shared[6:9]),
        covariance=NamedCovariance(names=NAMES, matrix=covariance * widen),
        noise=_noise(result, seen, restricted),
        residuals=residuals(model.arrays, *at),
        left_out=_left_out(model, at, restricted.V + seen.covariance),
        reprojection_rms_px=seen.rms_px,
    )


def _left_out(model: _Model, at: tuple[Array, Array, Array, Array], S: Array) -> Array:
    """Return (n, 6): each pose against its prediction from the other used ones, S (n, 6, 6) the noise of each."""
    e, J, _ = model.linearised(at)
    whiten = np.linalg.inv(np.linalg.cholesky(S))
    e, J = np.einsum("nij,nj->ni", whiten, e), whiten @ J
    C = np.linalg.inv(np.einsum("nia,nib->ab", J[model.used], J[model.used]))
    M = J @ C @ J.transpose(0, 2, 1)
    out: Array = np.empty((len(e), 6))
    for i in range(len(e)):
        one = tuple(a[i : i + 1] for a in model.arrays)
        step = C @ J[i].T @ np.linalg.solve(np.eye(6) - M[i], e[i]) if model.used[i] else np.zeros(12)
        RX, tX, RZ, tZ = at
        moved = (
            _rotation(step[3:6]) @ RX,
            tX + step[:3],
            _rotation(step[9:]) @ RZ,
            tZ + step[6:9],
        )
        out[i] = residuals((one[0], one[1], one[2], one[3]), *moved)[0]
    return out


def _noise(result: HandEye, seen: ViewPoses, restricted: Restricted) -> Noise:
    """Return the noises with the corners' share known."""
    corners = np.einsum("nii->ni", seen.covariance[result.used]).mean(axis=0)
    uncertainty = restricted.covariance
    robot_m = part(restricted.variances[0], uncertainty[0, 0])
    corner_m = float(corners[:3].mean())
    camera_rad = part(restricted.variances[1] + corners[3:].mean(), uncertainty[1, 1])
    return Noise(
        translation_m=part(restricted.variances[0] + corner_m, uncertainty[0, 0]),
        robot_m=robot_m,
        camera_m=part(corner_m, 0.0),
        robot_rad=part(restricted.variances[2], uncertainty[2, 2]),
        camera_rad=camera_rad,
        lever_m=result.noise.lever_m,
    )


def _rotation(rotvec: Array) -> Array:
    """Return the matrix (3, 3) of a rotation vector (3,)."""
    return np.asarray(Rotation.from_rotvec(np.array(rotvec)).as_matrix())


def _left_inverse(w: Array) -> Array:
    """Return (n, 3, 3): d log(Exp(d) Exp(w)) / d d, to the third order in w (residuals are small)."""
    K = cross(w)
    return np.asarray(np.eye(3) - 0.5 * K + (K @ K) / 12.0)
