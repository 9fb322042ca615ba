"""Pairs of simulated cameras, in the axes of the left one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.geometry import xyz_quat
from armsight.sim.lens import Lens

SIDES = ("left", "right")

Pair = dict[str, tuple[Lens, RigidTransform]]
"""Lens and T_world_camera of 'left' and 'right'."""


def converging_webcams(width: int, height: int) -> Pair:
    """Return two webcams of 68 degrees width 120 mm apart that toe in by 5 degrees, as two real ones would differ.

    The focal length follows the width; every number is chosen. The lenses' centres lie off the image's, the right
    camera is a little higher, further back and rolled, and the distortion is that of plastic webcam lenses.
    """
    scale = width / 1280.0
    left = Lens(
        width=width,
        height=height,
        focal_px=(948.0 * scale, 949.5 * scale),
        centre_px=(0.5 * (width - 1) + 6.3 * scale, 0.5 * (height - 1) - 4.1 * scale),
        distortion=(0.090, -0.180, 0.0008, -0.0005, 0.050),
    )
    right = Lens(
        width=width,
        height=height,
        focal_px=(953.5 * scale, 952.0 * scale),
        centre_px=(0.5 * (width - 1) - 3.8 * scale, 0.5 * (height - 1) + 5.6 * scale),
        distortion=(0.084, -0.171, -0.0006, 0.0007, 0.042),
    )
    toe_in = Rotation.from_rotvec([0.004, -np.deg2rad(5.0), 0.006])
    return {
        "left": (left, RigidTransform.identity()),
        "right": (right, RigidTransform.from_components([0.120, 0.0015, -0.002], toe_in)),
    }


def parallel_pair(width: int, height: int, *, focal_px: float, baseline_m: float) -> Pair:
    """Return two equal pinholes without distortion, baseline_m apart along x, looking the same way."""
    lens = Lens(
        width=width,
        height=height,
        focal_px=(focal_px, focal_px),
        centre_px=(0.5 * (width - 1), 0.5 * (height - 1)),
    )
    return {
        "left": (lens, RigidTransform.identity()),
        "right": (lens, RigidTransform.from_translation([baseline_m, 0.0, 0.0])),
    }


def rig_mapping(pair: Mapping[str, tuple[Lens, RigidTransform]]) -> dict[str, Any]:
    """Return the pair as rig.yaml has it under kind and cameras."""
    cameras = {}
    for side, (lens, T_world_camera) in pair.items():
        xyz, quat = xyz_quat(T_world_camera)
        cameras[side] = lens.mapping() | {"T_rig_camera": {"xyz_m": xyz.tolist(), "quat_xyzw": quat.tolist()}}
    return {"kind": "stereo", "cameras": cameras}
