"""An arm as far as it is known before its sweeps are planned, and where two cameras surely see its beacon."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armsight.arrays import Array
from armsight.calibrate.identify.chain import Axis, ChainModel
from armsight.calibrate.identify.kernels import see_many
from armsight.calibrate.identify.result import Identification
from armsight.kinematics import Arm, JointType, link_frames
from armsight.optics import PackedRig, Rig

PRIOR_RAD, PRIOR_M = 1.0, 3.0
"""Standard deviations before any reading: an axis may point anywhere, within metres. Keeps every information
invertible."""
SURE = 3.0
"""Standard deviations by which the beacon must be inside two cameras' images for a pose to count as seen."""
MARGIN_PX = 10.0
"""A spot nearer to the border may be cut off."""
FEWEST_VIEWS = 2
"""Cameras that must see a light to place it."""
WAY = 9
"""Poses looked at on each way."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RoughArm:
    """An arm as far as it is known: axes and beacon in rig axes, all joints at zero; noise of a reading in px.

    covariance (P, P): of ChainModel's parameters, None where the arm is taken as known.
    """

    axes: tuple[Axis, ...]
    beacon_m: Array
    sigma_px: float
    covariance: Array | None = None

    @property
    def model(self) -> ChainModel:
        """The arm as a model about itself."""
        return ChainModel(axes=self.axes, beacon_m=self.beacon_m)


def rough_arm(found: Identification, q: Array, rig: Rig) -> RoughArm:
    """Return the arm that readings at q (m, n) identified, with the covariance that they leave."""
    axes = tuple(joint.axis for joint in found.joints)
    arm = RoughArm(axes=axes, beacon_m=found.beacon_m, sigma_px=found.sigma)
    G = View.of(arm, rig).slopes(q) / found.sigma
    G = G[np.isfinite(G).all(axis=(1, 2))]
    information = np.einsum("mia,mib->ab", G, G) + prior_information(arm.model)
    return RoughArm(axes=axes, beacon_m=found.beacon_m, sigma_px=found.sigma, covariance=np.linalg.inv(information))


def known_arm(arm: Arm, T_rig_world: Array, sigma_px: float) -> RoughArm:
    """Return a modelled arm, its tool's origin the beacon, as a rig at T_rig_world (4, 4) sees it."""
    frames = T_rig_world @ link_frames(arm, np.zeros(arm.n))
    axes = tuple(
        Axis(point_m=T[:3, 3].copy(), direction=joint.sign * T[:3, 2], revolute=joint.type is JointType.REVOLUTE)
        for joint, T in zip(arm.joints, frames, strict=False)
    )
    return RoughArm(axes=axes, beacon_m=frames[-1, :3, 3].copy(), sigma_px=sigma_px)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class View:
    """Where two cameras see a roughly known arm's beacon, and all within around_m of it; sizes (v, 2) px."""

    arm: RoughArm
    rig: PackedRig
    sizes: Array
    around_m: float = 0.0

    @classmethod
    def of(cls, arm: RoughArm, rig: Rig, around_m: float = 0.0) -> View:
        """Return the view of a rig's cameras."""
        sizes = np.array([[one.camera.width, one.camera.height] for one in rig.cameras], dtype=float)
        return cls(arm=arm, rig=PackedRig.of(rig), sizes=sizes, around_m=around_m)

    def seen(self, q: Array) -> NDArray[np.bool_]:
        """Return for poses (m, n) whether the beacon is surely in two cameras' images, by SURE standard deviations of
        what is known."""
        uv, G, D = pixel_slopes(self.arm.model, self.rig, q)
        spread = np.zeros(uv.shape)
        if self.arm.covariance is not None:
            C = self.arm.covariance
            # cov(uv) = G C G', of each coordinate by itself
            spread = np.sqrt(np.maximum(np.einsum("mia,ab,mib->mi", G, C, G, optimize=True), 0.0)).reshape(uv.shape)
        edge = SURE * spread + (MARGIN_PX + self.around_m * np.linalg.norm(D, axis=3))
        with np.errstate(invalid="ignore"):
            inside = (uv > edge) & (uv < self.sizes - 1.0 - edge)
        return np.asarray(inside.all(axis=2).sum(axis=1) >= FEWEST_VIEWS)

    def slopes(self, q: Array) -> Array:
        """Return the derivatives (m, 2 v, P) of the pixels that cameras show at q (m, n), 0 of what none shows."""
        uv, G, _ = pixel_slopes(self.arm.model, self.rig, q)
        if len(self.sizes) > FEWEST_VIEWS:  # of two cameras both see what is planned
            with np.errstate(invalid="ignore"):
                out = ~((uv > 0.0) & (uv < self.sizes - 1.0)).all(axis=2)
            G.reshape(*uv.shape, -1)[out] = 0.0
        return G

    def way(self, a: Array, b: Array) -> Array | None:
        """Return poses (k, n) from a to b, each a move of one joint, all in view; None where none of two orders is."""
        moved = np.flatnonzero(a != b)
        if not len(moved):
            return np.empty((0, len(a)))
        for order in (moved, moved[::-1]):
            poses, at = [], a.copy()
            for j in order:
                at = at.copy()
                at[j] = b[j]
                poses.append(at)
            corners = np.array([a, *poses])
            between = np.linspace(0.0, 1.0, WAY)[1:, None, None]
            if self.seen((corners[:-1] + between * np.diff(corners, axis=0)).reshape(-1, len(a))).all():
                return np.array(poses)
        return None


def pixel_slopes(model: ChainModel, rig: PackedRig, q: Array) -> tuple[Array, Array, Array]:
    """Return pixels (m, v, 2) of the beacon at q (m, n), their derivatives by the parameters (m, 2 v, P) and by its
    place (m, v, 2, 3); NaN behind a camera."""
    X, J = model.predict(np.zeros(len(model.names)), q)
    # d uv / d p = d uv / d X  d X / d p
    v = len(rig.k)
    uv, D = np.empty((len(q), v, 2)), np.empty((len(q), v, 2, 3))
    see_many(rig.k, rig.R, rig.t, X, uv, D)
    return uv, D.reshape(len(q), 2 * v, 3) @ J, D


def prior_information(model: ChainModel) -> Array:
    """Return the information (P, P) there is before any reading."""
    return np.diag([(PRIOR_RAD if "tilt" in name else PRIOR_M) ** -2.0 for name in model.names])
