"""What actions take besides numbers and words: each an object, arrays, or a file's path, which is read for the action.

Type checkers see Any: in the action stands the object, at its caller whatever is read as one.
"""

from __future__ import annotations

from typing import Annotated, Any, TypeAlias

from armsight.app.requests.shared import BOARD, SRC
from armsight.fields import Doc, Flag
from armsight.ops.action import Input

READERS = "armsight.ops.inputs"
FRAMES = Input(f"{READERS}:frames", kind=str)
IMAGES = Input(f"{READERS}:images", kind=str, hashed=True)
"""Images as the command line names them, or arrays and paths in order."""
NOISE = Input(f"{READERS}:noise", kind=str, hashed=True)
"""Still frames, the file that holds a camera's noise, or a NoiseModel."""
CAMERA = Input(f"{READERS}:camera", hashed=True)
"""A Camera, or the path of a camera.yaml."""
LIGHTS = Input(f"{READERS}:target", hashed=True)
"""A Target, or the path of a target.yaml."""
ZOOM_LENS = Input(f"{READERS}:zoom_lens", hashed=True)
"""The path of a camera.yaml with a lens's settings, or the ZoomLens."""

RigLike: TypeAlias = Annotated[Any, Input(f"{READERS}:rig", hashed=True)]
"""A Rig, or the path of a rig.yaml."""
TargetLike: TypeAlias = Annotated[Any, Input(f"{READERS}:target")]
"""A Target, the path of a target.yaml, or a board's text."""
PosesLike: TypeAlias = Annotated[Any, Input(f"{READERS}:poses", hashed=True)]
"""Poses (n, 4, 4) in m, a RigidTransform, or the path of a table of poses."""
BoardLike: TypeAlias = Annotated[Any, Doc(BOARD), Input(f"{READERS}:board", kind=str), Flag(metavar="BOARD")]
"""A printed board's text, a file that says it, or a Target."""
SpotsLike: TypeAlias = Annotated[Any, Input(f"{READERS}:spots")]
"""Columns t_s, u_px, v_px, or the path of a table of spots."""
Left: TypeAlias = Annotated[Any, Doc(f"Left frames: {SRC}."), FRAMES, Flag(metavar="SRC")]
"""Frames as the command line names them, or images in order."""
Right: TypeAlias = Annotated[Any, Doc("Right frames, in step with the left ones."), FRAMES, Flag(metavar="SRC")]
BothViews: TypeAlias = Annotated[Any, Doc("Frames with both views in one image."), FRAMES, Flag(metavar="SRC")]
