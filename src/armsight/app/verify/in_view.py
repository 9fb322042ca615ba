"""Whether both cameras of a rig would see a whole target."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from armsight.optics import SIDES, Rig
from armsight.records import Target

BORDER = 0.03
"""Share of the image's width that lights keep from its border."""


def seen_whole(rig: Rig, target: Target, T_rig_target: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Tell for poses (m, 4, 4) whether all lights of the target fall into both images, whichever way they shine."""
    points = np.einsum("mij,pj->mpi", T_rig_target[:, :3, :3], target.xyz_m) + T_rig_target[:, None, :3, 3]
    seen = np.ones(len(T_rig_target), dtype=np.bool_)
    for side, uv in zip(SIDES, rig.project(points.reshape(-1, 3)), strict=True):
        camera = rig.camera(side)
        border = BORDER * camera.width
        limit = np.array([camera.width, camera.height]) - border
        seen &= ((uv > border) & (uv < limit)).all(axis=1).reshape(len(T_rig_target), -1).all(axis=1)
    return seen
