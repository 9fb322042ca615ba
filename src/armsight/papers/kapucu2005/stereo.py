"""Places from two parallel cameras in the paper's camera frame (section 2.2).

Origin at the right camera's centre of projection, X to the right, Y up, Z outward: a left-handed triple, although
the paper calls it right-handed (MATH C8).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armsight.errors import Degenerate
from armsight.optics import Rig

Array = NDArray[np.float64]

TO_CAMERA = np.diag([1.0, -1.0, 1.0])
"""From x right, y down, z forward to the paper's axes, and back."""


def camera_places(rig: Rig, left_px: ArrayLike, right_px: ArrayLike) -> Array:
    """Return places (n, 3) in m in the paper's camera frame from pixels (n, 2) of identical parallel cameras.

    The heights that the two images give are averaged. Raises Degenerate where a disparity is not positive.
    """
    left, right = np.atleast_2d(left_px).astype(float), np.atleast_2d(right_px).astype(float)
    fu, fv, ru, rv = rig.right.intrinsics[:4]
    lu, lv = rig.left.intrinsics[2:4]
    baseline_m = float(np.linalg.norm(rig.T_rig_right.translation - rig.T_rig_left.translation))
    x_left, x_right = left[:, 0] - lu, right[:, 0] - ru
    disparity = x_left - x_right
    if (disparity <= 0.0).any():
        raise Degenerate("the disparity of a pair is not positive", consequence="Its rays do not meet before the rig")
    Z = fu * baseline_m / disparity
    Y = -0.5 * ((left[:, 1] - lv) + (right[:, 1] - rv)) * Z / fv
    return np.stack([x_right * Z / fu, Y, Z], axis=1)


def to_world(rig: Rig, T_world_rig: Array, places_m: Array) -> Array:
    """Return places (n, 3) of the paper's camera frame in world; T_world_rig: (4, 4)."""
    in_rig = places_m @ TO_CAMERA + rig.T_rig_right.translation
    return np.asarray(in_rig @ T_world_rig[:3, :3].T + T_world_rig[:3, 3])


def from_world(rig: Rig, T_world_rig: Array, world_m: Array) -> Array:
    """Return places (n, 3) of the world in the paper's camera frame; T_world_rig: (4, 4)."""
    in_rig = (world_m - T_world_rig[:3, 3]) @ T_world_rig[:3, :3]
    return np.asarray((in_rig - rig.T_rig_right.translation) @ TO_CAMERA)
