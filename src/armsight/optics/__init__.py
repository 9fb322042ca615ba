"""Pixel <-> ray: cameras, rigs, triangulation."""

from armsight.optics.camera import INTRINSICS, Camera
from armsight.optics.rig import SIDES, Rig, RigKind

__all__ = ["INTRINSICS", "SIDES", "Camera", "Rig", "RigKind"]
