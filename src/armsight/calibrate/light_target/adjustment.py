"""All frames at once: one shape of the target, one pose per frame, least reprojection error in both views."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from armsight.arrays import Array
from armsight.calibrate.light_target.frames import Layout
from armsight.fitting import Evaluation, Fit, Problem, solve
from armsight.fitting.groups import whitener, without
from armsight.geometry.poses import skew
from armsight.optics import RIG_PARAMETERS, PackedRig, Rig, moved_rig
from armsight.optics.kernels.light_image import see_both

POSE = ("tx_m", "ty_m", "tz_m", "rx_rad", "ry_rad", "rz_rad")

HOLD = 1.0
"""Information per rad^2 that holds the turn about a line of lights, of which nothing is known; pixels say 1e6."""

SMALL = 1e-2
"""Step, in standard deviations of the calibration, of the differences that tell how the answer follows the rig."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LightObservations:
    """Named spots of the frames: uv_px (g, n, 2, 2) [frame, light, side, axis], cov_px2 (g, n, 2, 2, 2)."""

    uv_px: Array
    cov_px2: Array

    def take(self, keep: NDArray[np.bool_]) -> LightObservations:
        """Return the frames of the mask."""
        return LightObservations(uv_px=self.uv_px[keep], cov_px2=self.cov_px2[keep])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LightBundle:
    """The fit. values (k,): of the layout. poses (g, 6): t, rotation vector. residual_px (g, n, 2, 2) predicted minus
    seen; left_out_px: the same with the shape of the other frames. frame_chi2 (g,). covariance (k, k): from the spots'
    standard deviations alone; rig_share (k, k): of the rig's calibration.
    """

    values: Array
    poses: Array
    residual_px: Array
    left_out_px: Array
    frame_chi2: Array
    covariance: Array
    rig_share: Array
    dof: int

    @property
    def scale2(self) -> float:
        """Chi-square by degree of freedom."""
        return float(self.frame_chi2.sum()) / max(self.dof, 1)


def fit_bundle(
    rig: Rig, layout: Layout, sightings: LightObservations, values: Array, R: Array, t: Array
) -> LightBundle:
    """Return the bundle from a guess: values (k,) of the layout, R (g, 3, 3), t (g, 3) of the frames."""
    packed = PackedRig.of(rig)
    whiten = whitener(sightings.cov_px2)  # (g, n, 2, 2, 2)
    g, n = sightings.uv_px.shape[:2]

    def evaluate(shared: Array, local: Array) -> Evaluation:
        return _evaluate(packed, layout, sightings, whiten, shared, local)

    fit = solve(
        Problem(
            names=layout.names,
            guess=values,
            evaluate=evaluate,
            n_residuals=4 * n * g + (g if layout.on_line else 0),
            local_names=POSE,
            local_guess=np.concatenate([t, Rotation.from_matrix(R).as_rotvec()], axis=1),
            retract=_retract,
        )
    )
    return _judge(rig, layout, sightings, fit, evaluate(fit.shared, fit.local), whiten)


def _evaluate(
    packed: PackedRig, layout: Layout, sightings: LightObservations, whiten: Array, shared: Array, local: Array
) -> Evaluation:
    g, n = sightings.uv_px.shape[:2]
    turned, uv, J = _project(packed, layout, shared, local)
    WJ = whiten @ J  # (g, n, 2, 2, 3)
    residuals = (whiten @ (uv - sightings.uv_px)[..., None]).reshape(g, -1)
    # p = R X + t moves by dt + dw x (R X): as J by dt, as -J [R X]x by dw
    own = np.concatenate([WJ, -WJ @ skew(turned)[:, :, None]], axis=-1).reshape(g, 4 * n, 6)
    R = _rotations(local)
    shape = (WJ @ R[:, None, None] @ layout.basis.reshape(1, n, 1, 3, -1)).reshape(g, 4 * n, -1)
    if layout.on_line:  # a row without residual that holds the turn about the line
        held = np.sqrt(HOLD) * np.concatenate([np.zeros((g, 3)), R[:, :, 0]], axis=1)
        residuals = np.concatenate([residuals, np.zeros((g, 1))], axis=1)
        own = np.concatenate([own, held[:, None]], axis=1)
        shape = np.concatenate([shape, np.zeros((g, 1, shape.shape[2]))], axis=1)
    return Evaluation(residuals=residuals, shared=shape, local=own)


def _judge(
    rig: Rig, layout: Layout, sightings: LightObservations, fit: Fit, at: Evaluation, whiten: Array
) -> LightBundle:
    """Return the bundle with its uncertainty, the rig's share and the left-out residuals."""
    g, n = sightings.uv_px.shape[:2]
    Js, Jl, r = at.shared, at.local, at.residuals
    # residuals and shape as they are once each frame's pose has followed
    free = np.eye(r.shape[1]) - Jl @ np.linalg.solve(Jl.transpose(0, 2, 1) @ Jl, Jl.transpose(0, 2, 1))
    Js, e = free @ Js, (free @ r[:, :, None])[:, :, 0]
    S = Js.transpose(0, 2, 1) @ Js  # (g, k, k)
    information = S.sum(axis=0)
    covariance = np.linalg.inv(information)
    step = np.zeros((g, len(information)))
    if g > 1:
        step = without(information, S, (Js.transpose(0, 2, 1) @ e[:, :, None])[:, :, 0])
    # the pose of a frame follows the shape that the others give: e and Js are by what is left of both
    left_out = (e + (Js @ step[:, :, None])[:, :, 0])[:, : 4 * n].reshape(g, n, 2, 2)
    share = np.zeros_like(covariance)
    if rig.covariance is not None:
        D = _by_rig(rig, layout, fit, whiten)
        if layout.on_line:
            D = np.concatenate([D, np.zeros((g, 1, D.shape[2]))], axis=1)
        # where the minimum goes when the rig changes: dx = -(J'J)^-1 J' dr, with each frame's pose following
        A = -covariance @ np.einsum("gmk,gmp->kp", Js, D)
        share = A @ PackedRig.of(rig).covariance @ A.T
    colour = np.linalg.inv(whiten)
    return LightBundle(
        values=fit.shared,
        poses=fit.local,
        residual_px=(colour @ r[:, : 4 * n].reshape(g, n, 2, 2)[..., None])[..., 0],
        left_out_px=(colour @ left_out[..., None])[..., 0],
        frame_chi2=(r**2).sum(axis=1),
        covariance=covariance,
        rig_share=share,
        dof=4 * n * g - (5 if layout.on_line else 6) * g - len(layout.names),
    )


def _by_rig(rig: Rig, layout: Layout, fit: Fit, whiten: Array) -> Array:
    """Return (g, 4 n, 26): whitened residuals by the rig's parameters, by central differences."""
    sigma = np.sqrt(np.diag(PackedRig.of(rig).covariance))
    g, n = whiten.shape[:2]
    D = np.zeros((g, 4 * n, len(RIG_PARAMETERS)))
    for p in np.flatnonzero(sigma > 0.0):
        step = np.zeros(len(RIG_PARAMETERS))
        step[p] = max(SMALL * sigma[p], 1e-9)
        plus, minus = (
            _project(PackedRig.of(moved_rig(rig, s * step)), layout, fit.shared, fit.local)[1] for s in (1.0, -1.0)
        )
        D[:, :, p] = (whiten @ ((plus - minus) / (2.0 * step[p]))[..., None])[..., 0].reshape(g, -1)
    return D


def _project(packed: PackedRig, layout: Layout, values: Array, poses: Array) -> tuple[Array, Array, Array]:
    """Return R X (g, n, 3), pixels (g, n, 2, 2) and their derivatives (g, n, 2, 2, 3) by the position in rig axes."""
    X = layout.spots(values)
    g, n = len(poses), len(X)
    turned = np.einsum("gij,nj->gni", _rotations(poses), X)
    positions = np.ascontiguousarray(turned + poses[:, None, :3]).reshape(-1, 3)
    uv, J = np.empty((g * n, 2, 2)), np.empty((g * n, 2, 2, 3))
    see_both(packed.k, packed.R, packed.t, positions, uv, J)
    return turned, uv.reshape(g, n, 2, 2), J.reshape(g, n, 2, 2, 3)


def _rotations(poses: Array) -> Array:
    return np.asarray(Rotation.from_rotvec(np.array(poses[:, 3:])).as_matrix())


def _retract(shared: Array, local: Array, step_shared: Array, step_local: Array) -> tuple[Array, Array]:
    turned = Rotation.from_rotvec(step_local[:, 3:]) * Rotation.from_rotvec(np.array(local[:, 3:]))
    return shared + step_shared, np.concatenate([local[:, :3] + step_local[:, :3], turned.as_rotvec()], axis=1)
