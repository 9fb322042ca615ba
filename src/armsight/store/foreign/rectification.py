"""The matrices of a rectified pair, as OpenCV's stereoRectify gives them."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from armsight.arrays import Array
from armsight.errors import Inconsistent
from armsight.geometry.poses import skew
from armsight.optics import LensKind, Rig
from armsight.store.foreign.numbers import relative


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rectification:
    """R1, R2 (3, 3): into the rectified cameras' axes; P1, P2 (3, 4): their projections; Q (4, 4): pixels and disparity
    to points in the left rectified camera's axes, m; E, F (3, 3): essential and fundamental matrix, of points without
    distortion: x_right^T F x_left = 0."""

    R1: Array
    R2: Array
    P1: Array
    P2: Array
    Q: Array
    E: Array
    F: Array


def rectification(rig: Rig) -> Rectification:
    """Return a rig's rectification, with zero disparity at infinity and no pixel of nothing (alpha 0).

    Raises Inconsistent where the two images differ in size: one P serves both.
    """
    if (rig.left.width, rig.left.height) != (rig.right.width, rig.right.height):
        raise Inconsistent("the cameras' images differ in size", consequence="One rectified pair cannot say this")
    R, t = relative(rig.T_rig_left, rig.T_rig_right)
    lenses = {rig.left.lens, rig.right.lens}
    if len(lenses) > 1:
        raise Inconsistent("one camera is a pinhole and one a fisheye", consequence="OpenCV cannot rectify the pair")
    size = (rig.left.width, rig.left.height)
    cameras = (rig.left.matrix, rig.left.distortion, rig.right.matrix, rig.right.distortion)
    if lenses == {LensKind.FISHEYE}:
        R1, R2, P1, P2, Q = cv2.fisheye.stereoRectify(*cameras, size, R, t, flags=cv2.CALIB_ZERO_DISPARITY)
    else:
        R1, R2, P1, P2, Q, *_ = cv2.stereoRectify(*cameras, size, R, t, flags=cv2.CALIB_ZERO_DISPARITY, alpha=0.0)
    E = skew(t) @ R
    F = np.linalg.inv(rig.right.matrix).T @ E @ np.linalg.inv(rig.left.matrix)
    scale = F[2, 2] if abs(F[2, 2]) > np.finfo(float).eps * np.abs(F).max() else np.linalg.norm(F)
    parts = {"R1": R1, "R2": R2, "P1": P1, "P2": P2, "Q": Q, "E": E, "F": F / scale}
    return Rectification(**{name: np.asarray(part, np.float64) for name, part in parts.items()})
