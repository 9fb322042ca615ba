"""The corners of every image and the robot's poses, each with its noise, in one least-squares fit: a bundle adjustment.

Of every image the target's pose in the camera is unknown, which the corners measure by reprojection, and the robot,
with a noise of its own, through the hand-eye equation. Taking the robot as exact and reprojecting through it would
weigh its millimetres as pixels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array
from armsight.calibrate.cameras.bundle_adjustment import EMPTY, Bundle, adjust, problem_of
from armsight.calibrate.cameras.initial_guess import poses_by_rays
from armsight.calibrate.cameras.observations import Observations, pack
from armsight.calibrate.handeye.known_noise import CONDITION, Restricted, left_out, linearise, restricted_variances
from armsight.calibrate.handeye.pairs import Arrays, Poses, Setup, components
from armsight.calibrate.handeye.result import NAMES, HandEyeResult
from armsight.errors import Inconsistent, NotEnoughData
from armsight.fitting import Evaluation, Fit, NormalEquations, Problem, Settings, solve
from armsight.fitting.groups import whitener
from armsight.geometry.poses import skew, stepped
from armsight.optics import Camera
from armsight.records import BoardView, Target

FREE_INTRINSICS = frozenset({"fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"})
"""What is freed of the camera on request; skew and k3 stay."""

LEAST = np.array([1e-12, 1e-12, 0.0])
"""Beside the corners' noise at least a micrometre and a microradian are left to the robot: none is exact, and weights
without end would ruin the arithmetic."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ImageModel:
    """The used pairs (n,) and where the pose fit left the unknowns."""

    setup: Setup
    arrays: Arrays
    used: np.ndarray
    seen: ViewPoses
    start: Poses

    @classmethod
    def of(cls, result: HandEyeResult, seen: ViewPoses) -> ImageModel:
        """Return the model of a result from the poses seen."""
        RX, tX = components(result.T_parent_camera)
        RZ, tZ = components(result.T_parent_target)
        return cls(
            setup=result.setup,
            arrays=result.pairs.arrays(result.setup),
            used=result.used,
            seen=seen,
            start=(RX, tX, RZ, tZ),
        )

    def linearised(self, at: Poses) -> tuple[Array, Array, Array]:
        """Return residuals e (n, 6), derivatives J (n, 6, 12) by X and Z, and lever shapes L (n, 6, 6)."""
        RX, tX, RZ, tZ = at
        found = linearise(self.arrays, (RX, tX), (RZ, tZ), 1.0, to_hand=self.setup is Setup.EYE_TO_HAND)
        return found.e, found.J[:, :, :12], found.L

    def left_out(self, at: Poses, V: Array) -> Array:
        """Return (n, 6): each pose against its prediction from the other used ones, V (n, 6, 6) the noise of each."""
        X, Z, to_hand = (at[0], at[1]), (at[2], at[3]), self.setup is Setup.EYE_TO_HAND
        _, J, _ = self.linearised(at)
        J = (whitener(V, CONDITION) @ J)[self.used]
        C = np.linalg.inv(np.einsum("nia,nib->ab", J, J))
        return left_out(self.arrays, X, Z, 1.0, V, self.used, C, to_hand=to_hand)[0]

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
        whiten = whitener(V)  # (n, 6, 6)
        G = len(used)
        poses = self.seen.centred[used]
        boards = problem_of(sightings, Bundle(k=camera.intrinsics[None], poses=poses), frozenset())

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
            return stepped(shared, ds, (3, 9)), boards.retract(shared[12:], local, ds[12:], dl)[1]

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
        e, J, _ = inner.linearised((rotation_of(shared[3:6]), shared[:3], rotation_of(shared[9:12]), shared[6:9]))
        by_pose = np.tile(np.eye(6), (len(local), 1, 1))
        by_pose[:, :3, 3:] = skew(lever)
        by_pose[:, 3:, 3:] = _left_inverse(e[:, 3:])
        return e, J, by_pose


def poses_of(fit: Fit) -> Poses:
    """Return X and Z of a fit of ImageModel.reproject."""
    return rotation_of(fit.shared[3:6]), fit.shared[:3], rotation_of(fit.shared[9:12]), fit.shared[6:9]


def camera_of(fit: Fit, camera: Camera) -> Camera:
    """Return the camera with the intrinsics of a fit of ImageModel.reproject."""
    return replace(camera, intrinsics=fit.shared[12:])


def _with_robot(corners: NormalEquations, e: Array, J: Array, by_pose: Array) -> NormalEquations:
    """Return the normal equations of X, Z, camera and poses: the corners' and the robot's whitened errors e (n, 6).

    J (n, 6, 12), by_pose (n, 6, 6): derivatives of e by X and Z and by the poses.
    """
    A, b, W = np.zeros((22, 22)), np.zeros(22), np.zeros((len(e), 22, 6))
    A[:12, :12], A[12:, 12:] = np.einsum("nia,nib->ab", J, J), corners.A
    b[:12], b[12:] = np.einsum("nia,ni->a", J, e), corners.b
    W[:, :12], W[:, 12:] = J.transpose(0, 2, 1) @ by_pose, corners.W
    return NormalEquations(
        A=A,
        b=b,
        C=corners.C + by_pose.transpose(0, 2, 1) @ by_pose,
        c=corners.c + np.einsum("nia,ni->na", by_pose, e),
        W=W,
    )


def rotation_of(rotvec: Array) -> Array:
    """Return the matrix (3, 3) of a rotation vector (3,)."""
    return np.asarray(Rotation.from_rotvec(np.array(rotvec)).as_matrix())


def _left_inverse(w: Array) -> Array:
    """Return (n, 3, 3): d log(Exp(d) Exp(w)) / d d, to the third order in w (residuals are small)."""
    K = skew(w)
    return np.asarray(np.eye(3) - 0.5 * K + (K @ K) / 12.0)


# The target's pose in every image, with the covariance that its corners give.

ITERATIONS = 50


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ViewPoses:
    """Where every view shows the target, as pairs and as the bundle adjustment takes it.

    T_camera_target: a stack of n, with covariance (n, 6, 6) in camera axes and rms_px over all corners. sightings: the
    views with weights scaled to the noise that the corners show. centred (n, 6): poses of the board's middle as (t,
    rotation vector).
    """

    T_camera_target: RigidTransform
    covariance: Array
    rms_px: float
    sightings: Observations
    centred: Array


def poses_of_views(views: Sequence[BoardView], camera: Camera, board: Target) -> ViewPoses:
    """Return the target's pose in each view by least squares of the reprojection, camera fixed.

    Raises NotEnoughData without views, Inconsistent where the images are not of the camera's size.
    """
    if not views:
        raise NotEnoughData(
            "no view of the target", consequence="No pose can be given", cure="Check the board and the images"
        )
    for view in views:
        if (view.width, view.height) != (camera.width, camera.height):
            raise Inconsistent(
                f"{view.source} is {view.width}x{view.height} px, the camera file says {camera.width}x{camera.height}",
                consequence="Pixels and rays do not belong together",
                cure="Give the calibration of this camera at this resolution",
            )
    sightings = pack([views], board, (camera.lens,))
    found = poses_by_rays(sightings, camera)
    start = Bundle(k=camera.intrinsics[None], poses=np.full((len(views), 6), np.nan) if found is None else found)
    fit = adjust(sightings, start, frozenset(camera.names), max_iterations=ITERATIONS)
    R = Rotation.from_rotvec(fit.local[:, 3:])
    lever = R.apply(sightings.middle)  # (n, 3), from the board's origin to its middle
    J = np.tile(np.eye(6), (len(views), 1, 1))
    J[:, :3, 3:] = skew(lever)  # d t_origin = dt - dw x lever
    weight = sightings.weight
    squares = (fit.residuals.reshape(len(views), -1, 2) ** 2).sum(axis=2)  # (n, points) in units of 1 / weight
    sigma = np.divide(1.0, weight[:, 0], out=np.zeros_like(weight[:, 0]), where=weight[:, 0] > 0.0)
    return ViewPoses(
        T_camera_target=RigidTransform.from_components(fit.local[:, :3] - lever, R),
        covariance=J @ fit.local_covariance @ J.transpose(0, 2, 1),
        rms_px=float(np.sqrt((squares * sigma**2).sum() / np.count_nonzero(weight))),
        sightings=replace(sightings, weight=weight / fit.scale),
        centred=np.asarray(fit.local),
    )
