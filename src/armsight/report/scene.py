"""The scene of a measurement in space: cameras, the target's lights at one moment, and the rays that found them."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.optics import SIDES, Camera, Rig
from armsight.report.figures import GREEN, GREY, INK, ORANGE, Figure, Plot, axis, layout
from armsight.report.run import MeasureRun
from armsight.units import MM

NAMED = 12
"""Lights up to which each gets its name and its rays; a board has too many."""


def line(xyz: Array, name: str, style: Plot, **more: Any) -> Plot:
    """Return a line in space through points (n, 3) in mm."""
    coordinates = {"x": xyz[:, 0], "y": xyz[:, 1], "z": xyz[:, 2]}
    return {"type": "scatter3d", **coordinates, "name": name, "mode": "lines", "line": style, **more}


def camera_line(rig: Rig, side: str, T_parent_rig: RigidTransform | None, *, depth_m: float) -> Plot:
    """Return a camera as a pyramid whose base is its image, depth_m away."""
    T = rig.T_rig_camera(side)
    T = T if T_parent_rig is None else T_parent_rig * T
    return line(pyramid(rig.camera(side), T, depth_m), f"{side} camera", {"color": INK, "width": 2})


def pyramid(camera: Camera, T_parent_camera: RigidTransform, depth_m: float) -> Array:
    """Return the edges (n, 3) in mm of a camera's pyramid in one stroke."""
    fx, fy, cx, cy = camera.intrinsics[:4]
    u, v = np.array([0.0, camera.width, camera.width, 0.0]), np.array([0.0, 0.0, camera.height, camera.height])
    base = np.stack([(u - cx) / fx * depth_m, (v - cy) / fy * depth_m, np.full(4, depth_m)], axis=1)  # (4, 3)
    order = np.array([(0.0, 0.0, 0.0), *base[[0, 1]], (0, 0, 0), *base[[1, 2]], (0, 0, 0), *base[[2, 3]], (0, 0, 0)])
    closed = np.vstack([order, base[[3, 0]], base[3], np.zeros(3)])
    return np.asarray(T_parent_camera.apply(closed)) / MM


def scene_axes(parent: str) -> Plot:
    """Return axes in mm fitted to the data: seen from behind the cameras in rig axes, else with z up."""
    scene: Plot = {f"{name}axis": axis(f"{name}, mm", ticks="") for name in "xyz"}
    scene["aspectmode"] = "data"
    behind = {"up": {"x": 0, "y": -1, "z": 0}, "eye": {"x": -0.85, "y": -0.7, "z": -1.45}}
    above = {"up": {"x": 0, "y": 0, "z": 1}, "eye": {"x": 1.1, "y": -1.3, "z": 0.75}}
    return {**scene, "camera": behind if parent == "rig" else above}


def scene_figure(run: MeasureRun) -> Figure | None:
    """Return the scene at the best-known full pose; None where there is none."""
    best = _best(run)
    if best is None or (run.parent != "rig" and run.T_parent_rig is None):
        return None
    T = np.asarray(run.poses[best].T_parent_target)
    xyz = run.target.xyz_m @ T[:3, :3].T + T[:3, 3]
    eyes = [_eye(run, side) for side in SIDES]
    away = float(np.mean([np.linalg.norm(xyz.mean(axis=0) - eye) for eye in eyes]))
    data = [camera_line(run.rig, side, run.T_parent_rig, depth_m=0.1 * away) for side in SIDES]
    if len(xyz) <= NAMED:
        for side, eye in zip(SIDES, eyes, strict=True):
            rays = np.concatenate([np.stack([eye, point, eye]) for point in xyz]) / MM
            data.append(line(rays, f"rays, {side}", {"color": GREY, "width": 1}))
    names = list(run.target.names) if len(xyz) <= NAMED else None
    marks = {"mode": "markers+text" if names else "markers", "marker": {"size": 5, "color": ORANGE}, "text": names}
    data.append(line(xyz / MM, f"target in frame {best}", {}, **marks))
    size = 0.08 * away
    axes = np.concatenate([np.stack([T[:3, 3], T[:3, 3] + size * T[:3, k], T[:3, 3]]) for k in range(3)])
    tips = T[:3, 3] + size * T[:3, :3].T
    data.append(line(axes / MM, "its axes", {"color": GREEN, "width": 4}))
    ends = {"mode": "text", "text": ["x", "y", "z"], "showlegend": False}
    data.append(line(tips / MM, "axes' names", {}, **ends))
    shape = layout(scene=scene_axes(run.parent), uirevision=1)
    return Figure(data=data, layout=shape, height_px=460)


def _best(run: MeasureRun) -> int | None:
    """Return the frame whose full pose is known best."""
    known = [
        (float(np.trace(pose.covariance[:3, :3])), i)
        for i, pose in enumerate(run.poses)
        if pose.status.size == 6 and pose.covariance is not None
    ]
    return min(known)[1] if known else None


def _eye(run: MeasureRun, side: str) -> Array:
    """Return where a camera is in the parent frame (3,)."""
    T = run.rig.T_rig_camera(side)
    return np.asarray((T if run.T_parent_rig is None else run.T_parent_rig * T).translation)
