"""Pixel <-> ray: cameras, rigs, triangulation."""

from armsight.optics.camera import FISHEYE_INTRINSICS, INTRINSICS, SIDES, WIDEST_RAD, Camera, LensKind, Plate
from armsight.optics.mounted import MOST_CAMERAS, MountedCamera, MountedZoom, require_camera_name
from armsight.optics.paper_rigs import converged_rig, parallel_rig
from armsight.optics.parallelism import Parallelism, Resolution, mean_axes, parallelism, resolution
from armsight.optics.rig import (
    PLACE,
    RIG_PARAMETERS,
    RIGHT_POSE,
    PackedRig,
    Rig,
    RigKind,
    moved_rig,
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
from armsight.optics.zoom_rig import RigAtZoom, Zooms, at_zoom, with_zoom

__all__ = [
    "FISHEYE_INTRINSICS",
    "INTRINSICS",
    "MOST_CAMERAS",
    "PLACE",
    "RIGHT_POSE",
    "RIG_PARAMETERS",
    "SIDES",
    "WIDEST_RAD",
    "Camera",
    "LeftOut",
    "LensKind",
    "MountedCamera",
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
    "Zooms",
    "at_zoom",
    "converged_rig",
    "epipolar_chi2",
    "epipolar_distance",
    "mean_axes",
    "moved_rig",
    "parallel_rig",
    "parallelism",
    "require_camera_name",
    "resolution",
    "triangulate",
    "triangulate_closed",
    "with_zoom",
]
