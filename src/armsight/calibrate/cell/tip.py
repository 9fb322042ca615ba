"""How well the tip is known in the base frame over a work volume: as the cameras measure it, and as the arm says."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.calibrate.cell.model import CellModel
from armsight.geometry.poses import skew

FEWEST_SEEN = 3
"""Lights in both images by which a pose is measured."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TipSlopes:
    """How the tip moves in base axes with the cell's parameters: measured, commanded (k, 3, P); seen (k,).

    measured: as both cameras see the target, by its lights. commanded: as the joints say. noise (k, 3, 3): what the
    spots' noise of one pair of frames does to the measured tip, m^2.
    """

    measured: Array
    commanded: Array
    noise: Array
    seen: NDArray[np.bool_]

    def take(self, rows: NDArray[np.intp]) -> TipSlopes:
        """Return those of some positions."""
        return TipSlopes(
            measured=self.measured[rows], commanded=self.commanded[rows], noise=self.noise[rows], seen=self.seen[rows]
        )

    def spread_m(self, slopes: Array, covariance: Array) -> Array:
        """Return the covariance (k, 3, 3) of the tip by that (P, P) of the parameters."""
        return np.asarray(slopes @ covariance @ slopes.transpose(0, 2, 1))

    def strayed_m(self, columns: NDArray[np.intp], std: Array) -> Array:
        """Return the covariance (k, 3, 3) of the commanded tip where joints, columns (n,), stray by std (n,)."""
        return self.spread_m(self.commanded[:, :, columns], np.diag(std**2))


def tip_slopes(
    model: CellModel, x: Array, q: Array, T_flange_target: RigidTransform, tip_m: Array, sigma_px: tuple[float, float]
) -> TipSlopes:
    """Return how the tip at tip_m (3,) in target axes depends on the parameters, the arm standing at q (k, n)."""
    k, n, P = len(q), len(model.lights), len(x)
    uv, J = model.standing(x, q)
    T = model.flange(x, q)
    arm_at = np.array(T_flange_target.apply(tip_m))
    tip = T[:, :3, :3] @ arm_at  # (k, 3) from the flange
    lights = model.lights_m(x)
    inside = _inside(model, uv)
    weight = inside / np.square(np.asarray(sigma_px))[None, :, None]
    # by the target's own motion (dt, dw) about the tip: a light at T (light - tip) moves by dt + dw x that
    a = model.lights_at
    by_flange = np.stack(
        [J[:, :, i, :, a + 3 * i : a + 3 * i + 3] for i in range(n)], axis=2
    )  # by lights in flange axes
    by_base = by_flange @ T[:, None, None, :3, :3].transpose(0, 1, 2, 4, 3)
    lever = (T[:, :3, :3] @ (lights - arm_at).T).transpose(0, 2, 1)  # (k, n, 3)
    by_pose = np.concatenate([by_base, by_base @ -skew(lever)[:, None]], axis=-1)  # (k, 2, n, 2, 6)
    by_x = J.copy()
    by_x[..., model.arm_at : a] = 0.0  # where the arm stands is what is measured
    by_x[..., a:] = by_x[..., a:] @ _shape_only(lights, arm_at)
    A, B = by_pose.reshape(k, -1, 6), by_x.reshape(k, -1, P)
    w = np.repeat(weight.reshape(k, -1), 2, axis=1)[:, :, None]
    # the pose is where A' W (A dpose + B dx) = 0: what the parameters do to the pixels, the pose takes up
    H = A.transpose(0, 2, 1) @ (w * A)
    seen = (inside.all(axis=1).sum(axis=1) >= FEWEST_SEEN) & np.isfinite(uv).all(axis=(1, 2, 3))
    H[~seen] = np.eye(6)
    inverse = np.linalg.inv(H)
    measured = -(inverse @ (A.transpose(0, 2, 1) @ (w * B)))[:, :3]
    measured[~seen] = np.nan
    commanded = np.zeros((k, 3, P))
    links = model.flange_slopes(x, q)  # (k, 6, arm parameters)
    commanded[:, :, model.arm_at : a] = links[:, :3] + np.cross(
        links[:, 3:].transpose(0, 2, 1), tip[:, None, :]
    ).transpose(0, 2, 1)
    commanded[:, :, a:] = T[:, :3, :3] @ _carried(lights, arm_at)
    return TipSlopes(measured=measured, commanded=commanded, noise=inverse[:, :3, :3], seen=seen)


def _inside(model: CellModel, uv: Array) -> NDArray[np.bool_]:
    """Return which pixels (k, 2, n, 2) are in their camera's image."""
    largest = np.array(model.recording.sizes)[None, :, None] - 1.0
    with np.errstate(invalid="ignore"):
        return np.asarray(((uv >= 0.0) & (uv <= largest)).all(axis=-1))


def _moves(lights: Array, tip: Array) -> Array:
    """Return (3 n, 6): what a rigid motion of the target about the tip does to its lights, in flange axes."""
    return np.concatenate([np.tile(np.eye(3), (len(lights), 1)), -skew(lights - tip).reshape(-1, 3)], axis=1)


def _carried(lights: Array, tip: Array) -> Array:
    """Return (3, 3 n): how the tip moves on the flange with the lights that the target is laid onto."""
    return np.asarray(np.linalg.pinv(_moves(lights, tip))[:3])


def _shape_only(lights: Array, tip: Array) -> Array:
    """Return (3 n, 3 n): of a change of the lights that which is no rigid motion of the target."""
    moves = _moves(lights, tip)
    return np.asarray(np.eye(len(moves)) - moves @ np.linalg.pinv(moves))
