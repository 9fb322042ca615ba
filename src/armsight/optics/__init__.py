"""Pixel <-> ray: cameras, rigs, triangulation."""

from armsight.optics.camera import FISHEYE_INTRINSICS, INTRINSICS, SIDES, WIDEST_RAD, Camera, LensKind, Plate
from armsight.optics.parallelism import Parallelism, Resolution, mean_axes, moved_rig, parallelism, resolution
from armsight.optics.rig import (
    RIG_PARAMETERS,
    RIGHT_POSE,
    MountedZoom,
    PackedRig,
    Rig,
    RigAtZoom,
    RigKind,
    at_zoom,
    converged_rig,
    parallel_rig,
    with_zoom,
)
from armsight.optics.triangulate import (
    Triangulation,
    Verdict,
    epipolar_chi2,
    epipolar_distance,
    triangulate,
    triangulate_closed,
)
from armsight.optics.zoom import LeftOut, ZoomLens, ZoomSetting, ZoomState

__all__ = [
    "FISHEYE_INTRINSICS",
    "INTRINSICS",
    "RIGHT_POSE",
    "RIG_PARAMETERS",
    "SIDES",
    "WIDEST_RAD",
    "Camera",
    "LeftOut",
    "LensKind",
    "MountedZoom",
    "PackedRig",
    "Parallelism",
    "Plate",
    "Resolution",
    "Rig",
    "RigAtZoom",
    "RigKind",
    "Triangulation",
    "Verdict",
    "ZoomLens",
    "ZoomSetting",
    "ZoomState",
    "at_zoom",
    "converged_rig",
    "epipolar_chi2",
    "epipolar_distance",
    "mean_axes",
    "moved_rig",
    "parallel_rig",
    "parallelism",
    "resolution",
    "triangulate",
    "triangulate_closed",
    "with_zoom",
]
