"""From the adjustment's numbers to cameras and rigs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from armsight.calibrate.cameras.bundle_adjustment import Bundle
from armsight.calibrate.cameras.pairing import as_pose
from armsight.optics import Camera, LensKind, Rig, RigKind
from armsight.records import NamedCovariance

Array = NDArray[np.float64]


def camera_of(k: Array, size: tuple[int, int], lens: LensKind = LensKind.PINHOLE) -> Camera:
    """Return the camera of intrinsics k (10,) and image size (width, height)."""
    return Camera(width=size[0], height=size[1], intrinsics=k, lens=lens)


def rig_of(
    state: Bundle,
    sizes: tuple[tuple[int, int], ...],
    *,
    covariance: NamedCovariance | None = None,
    rms_px: float | None = None,
    lenses: tuple[LensKind, ...] = (LensKind.PINHOLE, LensKind.PINHOLE),
) -> Rig:
    """Return the rig, its reference the left camera."""
    return Rig(
        kind=RigKind.STEREO,
        left=camera_of(state.k[0], sizes[0], lenses[0]),
        right=camera_of(state.k[1], sizes[1], lenses[1]),
        T_rig_left=RigidTransform.identity(),
        T_rig_right=as_pose(state.side_pose),
        covariance=covariance,
        rms_px=rms_px,
    )


def baseline_std(rig: Rig) -> float:
    """Return the standard deviation of the baseline in m, from the covariance of T_rig_right; NaN without one."""
    if rig.covariance is None:
        return float("nan")
    t = np.asarray(rig.T_rig_right.translation)
    direction = t / np.linalg.norm(t)
    return float(np.sqrt(direction @ rig.covariance.block(("right.tx", "right.ty", "right.tz")) @ direction))


def of_one_lens(covariance: NamedCovariance) -> NamedCovariance:
    """Return the covariance of both views' intrinsics from that of the left one's, which are the right one's too."""
    shared = [i for i, name in enumerate(covariance.names) if name.startswith("left.")]
    rows = [*range(len(covariance.names)), *shared]
    names = (*covariance.names, *(covariance.names[i].replace("left.", "right.") for i in shared))
    return NamedCovariance(names=names, matrix=covariance.matrix[np.ix_(rows, rows)])


def in_frame(rig: Rig, T_new_rig: RigidTransform) -> Rig:
    """Return the rig with its axes moved: poses, and the covariance of T_rig_right."""
    covariance = rig.covariance
    if covariance is not None:
        turn = np.eye(len(covariance.names))
        R = T_new_rig.rotation.as_matrix()
        for block in (("tx", "ty", "tz"), ("rx", "ry", "rz")):
            at = [covariance.names.index(f"right.{name}") for name in block]
            turn[np.ix_(at, at)] = R
        covariance = NamedCovariance(names=covariance.names, matrix=turn @ covariance.matrix @ turn.T)
    return replace(
        rig,
        T_rig_left=T_new_rig * rig.T_rig_left,
        T_rig_right=T_new_rig * rig.T_rig_right,
        covariance=covariance,
    )
