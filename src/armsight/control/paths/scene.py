"""A path through points of a scene: picks on edges filled up, the tool held one way."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.control.paths.along import positive
from armsight.errors import UsageError
from armsight.records import TaughtPath

Array = NDArray[np.float64]


def along_edges(uv_px: Array, edges: Sequence[str], step_px: float) -> tuple[Array, NDArray[np.intp]]:
    """Return pixels (m, 2) with more of them between neighbours of one edge, and of which pick (m,) each is.

    Neighbours are at most step_px apart then; a pixel between two picks is of the one before it. Raises UsageError for
    a step that is none.
    """
    positive("step_px", step_px)
    out, rows = [], []
    for i, here in enumerate(uv_px):
        out.append(here[None])
        rows.append(i)
        if i + 1 < len(uv_px) and edges[i] and edges[i] == edges[i + 1]:
            count = math.ceil(float(np.linalg.norm(uv_px[i + 1] - here)) / step_px - 1e-9)
            share = np.arange(1, count)[:, None] / max(count, 1)
            out.append(here + share * (uv_px[i + 1] - here))
            rows += [i] * len(share)
    return np.concatenate(out), np.array(rows, dtype=np.intp)


def path_through_points(xyz_m: Array, tool_axis: Array, *, parent: str) -> TaughtPath:
    """Return the path through points (n, 3) with the tool's z along tool_axis (3,), all in the frame parent.

    The tool's x is the frame's x, or its y where that lies along the tool, made square to z. Raises UsageError for an
    axis without a direction.
    """
    length = float(np.linalg.norm(tool_axis))
    if not (math.isfinite(length) and length > 1e-9):
        raise UsageError("the tool's axis has no direction", cure="Give three numbers, for instance 0,0,-1")
    z = tool_axis / length
    nearest = np.array([1.0, 0.0, 0.0]) if abs(z[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    x = nearest - (nearest @ z) * z
    x = x / np.linalg.norm(x)
    R = np.stack([x, np.cross(z, x), z], axis=1)
    turns = Rotation.from_matrix(np.repeat(R[None], len(xyz_m), axis=0))
    return TaughtPath.of_poses(RigidTransform.from_components(xyz_m, turns), parent=parent)
