"""Pixel <-> ray: cameras, rigs, triangulation."""

from armsight.optics.camera import FISHEYE_INTRINSICS, INTRINSICS, SIDES, WIDEST_RAD, Camera, LensKind, Plate
from armsight.optics.mounted import MOST_CAMERAS, MountedCamera, MountedZoom, require_camera_name
from armsight.optics.parallelism import Parallelism, Resolution, mean_axes, parallelism, resolution, shared_point
from armsight.optics.rig import (
    PLACE,
    RIG_PARAMETERS,
    RIGHT_POSE,
    PackedRig,
    Rig,
    RigKind,
    as_pair,
    converged_rig,
    moved_rig,
    parallel_rig,
)
from armsight.optics.triangulate import (
    Triangulation,
    Verdict,
    epipolar_chi2,
    epipolar_distance,
    triangulate,
    triangulate_closed,
    triangulate_views,
)
from armsight.optics.zoom import LeftOut, ZoomLens, ZoomSetting, ZoomState
from armsight.optics.zoom_rig import RigAtZoom, Zooms, at_zoom, with_zoom
