"""The frame that three lights span: Pachidis et al. 2005, eqs. (7) and (8)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armsight.errors import Degenerate

Array = NDArray[np.float64]


def frame_of_three(abc_m: ArrayLike) -> Array:
    """Return the pose (4, 4) of the frame of the lights A, B, C, rows of (3, 3) in m.

    Origin G is their mean, u = -GA, w = GB x GA, v = w x u. Raises Degenerate for lights on one line.
    """
    points = np.asarray(abc_m, float)
    G = points.mean(axis=0)
    a, b = points[0] - G, points[1] - G
    w = np.cross(b, a)
    size = float(np.linalg.norm(w))
    if size <= 1e-9 * float(np.linalg.norm(a) * np.linalg.norm(b)):
        raise Degenerate("the three lights lie on one line", consequence="They span no frame")
    u, w = -a / np.linalg.norm(a), w / size
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = np.stack([u, np.cross(w, u), w], axis=1), G
    return T


def pose_of_three(seen_m: ArrayLike, model_m: ArrayLike) -> Array:
    """Return the pose (4, 4) of a target whose lights (3, 3) are model_m in its own axes, seen at seen_m."""
    return np.asarray(frame_of_three(seen_m) @ np.linalg.inv(frame_of_three(model_m)))
