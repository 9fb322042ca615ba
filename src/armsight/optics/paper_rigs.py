"""The papers' rigs of two cameras by name: parallel and converged."""

from __future__ import annotations

from scipy.spatial.transform import RigidTransform

from armsight.errors import Inconsistent
from armsight.geometry import pose_from_rotvec
from armsight.optics.camera import Camera
from armsight.optics.rig import Rig, RigKind


def parallel_rig(camera: Camera, baseline_m: float, right: Camera | None = None) -> Rig:
    """Return a pair with parallel axes, the right camera baseline_m along the left one's x (Kapucu 2005).

    The rig's axes are the left camera's. Raises Inconsistent where the baseline is not positive.
    """
    if not baseline_m > 0.0:
        raise Inconsistent(
            f"a baseline of {baseline_m} m is not positive",
            consequence="Two views from one place tell no distance",
            cure="Give the distance between the cameras; the right one stands at +x of the left",
        )
    return Rig(
        kind=RigKind.STEREO,
        left=camera,
        right=right or camera,
        T_rig_left=RigidTransform.identity(),
        T_rig_right=RigidTransform.from_translation([baseline_m, 0.0, 0.0]),
    )


def converged_rig(
    left: Camera,
    right: Camera,
    baseline_m: float,
    beta1_rad: float,
    beta2_rad: float,
) -> Rig:
    """Return Korayem's rig: cameras at x = -B/2 and +B/2, optical axes (sin beta, 0, cos beta) in rig axes.

    Both angles count in the same sense, about the rig's y; cameras that look at one point in front have
    beta1 > 0 > beta2 (MATH A16). The focal lengths F1, F2 are those of the cameras. The rig's origin is midway
    between the centres of projection. Raises Inconsistent for a baseline that is not positive.
    """
    if not baseline_m > 0.0:
        raise Inconsistent(f"a baseline of {baseline_m} m is not positive", cure="Give the distance between the lenses")
    half = 0.5 * baseline_m
    return Rig(
        kind=RigKind.STEREO,
        left=left,
        right=right,
        T_rig_left=pose_from_rotvec([-half, 0.0, 0.0], [0.0, beta1_rad, 0.0]),
        T_rig_right=pose_from_rotvec([half, 0.0, 0.0], [0.0, beta2_rad, 0.0]),
    )
