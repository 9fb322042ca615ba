"""What actions take besides numbers and words: each an object, arrays, or a file's path, which is read for the action.

Type checkers see Any: in the action stands the object, at its caller whatever is read as one.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any, TypeAlias

from armsight.fields import Doc, Flag
from armsight.ops.action import Input
from armsight.ops.flags import BOARD, SRC, cameras_of

READERS = "armsight.ops.inputs"
ROBOT_READERS = "armsight.ops.robot_inputs"
FRAMES = Input(f"{READERS}:frames", kind=str)
CHAIN = Input(f"{READERS}:chain", kind=str)
"""An arm, with the links of its file that `tip` and `base` name."""
FILES = "armsight.ops.calibration.camera_noise:input_files"
IMAGES = Input(f"{READERS}:images", kind=str, hashed=True, files=FILES)
"""Images as the command line names them, or arrays and paths in order."""
NOISE = Input(f"{READERS}:noise", kind=str, hashed=True, files=FILES)
"""Still frames, the file that holds a camera's noise, or a NoiseModel."""
NAMED_IMAGES = Input(f"{READERS}:named_images", kind=list[str], hashed=True, files=f"{READERS}:named_files")
"""Images by the cameras' names, as NAME=SRC or a mapping."""
NAMED_LENSES = Input(f"{READERS}:named_lenses", kind=list[str], hashed=True, files=f"{READERS}:named_files")
"""camera.yaml files by the cameras' names, as NAME=FILE or a mapping; or Cameras and what calibrate_camera returns."""
CAMERA = Input(f"{READERS}:camera", hashed=True)
"""A Camera, or the path of a camera.yaml."""
LIGHTS = Input(f"{READERS}:target", hashed=True)
"""A Target, or the path of a target.yaml."""
ZOOM_LENS = Input(f"{READERS}:zoom_lens", hashed=True)
"""The path of a camera.yaml with a lens's settings, or the ZoomLens."""

RigLike: TypeAlias = Annotated[Any, Input(f"{READERS}:rig", hashed=True)]
"""A Rig, or the path of a rig.yaml."""
AnyRigLike: TypeAlias = Annotated[Any, Input(f"{READERS}:any_rig", hashed=True)]
"""A Rig of one to eight cameras, or the path of a rig.yaml."""
TargetLike: TypeAlias = Annotated[Any, Input(f"{READERS}:target")]
"""A Target, the path of a target.yaml, or a board's text."""
PointsLike: TypeAlias = Annotated[Any, Input(f"{ROBOT_READERS}:points", hashed=True)]
"""Joint readings (m, n) in rad and m, with positions beside them, or the path of a table of both."""
TouchesLike: TypeAlias = Annotated[Any, Input(f"{ROBOT_READERS}:touches", hashed=True)]
"""(q, feature[, kind[, tip]]), or the path of a table of touches."""
HeldPointsLike: TypeAlias = Annotated[Any, Input(f"{ROBOT_READERS}:held_points", hashed=True)]
"""(q, xyz_m), or the path of a table of points."""
WorldLike: TypeAlias = Annotated[Any, Input(f"{READERS}:world")]
"""A World, the path of a world.yaml, or the rig's pose (4, 4) in the base, m."""
PosesLike: TypeAlias = Annotated[Any, Input(f"{READERS}:poses", hashed=True)]
"""Poses (n, 4, 4) in m, a RigidTransform, or the path of a table of poses."""
BoardLike: TypeAlias = Annotated[Any, Doc(BOARD), Input(f"{READERS}:board", kind=str), Flag(metavar="BOARD")]
"""A printed board's text, a file that says it, or a Target."""
SpotsLike: TypeAlias = Annotated[Any, Input(f"{READERS}:spots")]
"""Columns t_s, u_px, v_px, or the path of a table of spots."""
ArmLike: TypeAlias = Annotated[Any, Input(f"{READERS}:arm", kind=str), Flag(metavar="ARM")]
"""An Arm, the path of an arm.yaml or URDF, or a known arm's name."""
TaughtLike: TypeAlias = Annotated[Any, Input(f"{ROBOT_READERS}:taught"), Flag(positional=True, metavar="PATH")]
"""A TaughtPath, or the path of a path.csv."""
ToolTip: TypeAlias = Annotated[
    Any, Doc("tip.yaml of the tool, in flange axes. [default: the arm's tool frame]"), Input(f"{ROBOT_READERS}:tip")
]
"""What calibrate_tool_tip returns, or the path of its file."""
LimitsLike: TypeAlias = Annotated[Any, Input(f"{ROBOT_READERS}:limits")]
"""Limits, or the path of a limits.yaml."""
Readings: TypeAlias = Annotated[Any, Input(f"{READERS}:readings", kind=str)]
"""Joint readings (n,), written as 0,-1.2,0.4, or the path of a joints.csv."""
AsFile: TypeAlias = Annotated[Any, Input(f"{READERS}:file")]
"""A file's path, or what becomes one: a table's columns, a pose."""
MeasuredFile: TypeAlias = Annotated[
    AsFile,
    Doc(
        "Measured poses or points: poses.csv, points.csv, a tracker's table (x_m,y_m,z_m), TUM. With columns "
        "pose and visit, or run, the figures of ISO 9283."
    ),
    Flag(metavar="FILE"),
]
"""A table's path, a PoseTrack, columns by name, or (t_s, T)."""
JointsFile: TypeAlias = Annotated[AsFile, Doc("joints.csv of the controller. [default: q1 .. qn of the measured file]")]
WorldFile: TypeAlias = Annotated[AsFile, Doc("world.yaml: where the measuring rig stands.")]
RobotLike: TypeAlias = Annotated[
    Any,
    Doc(
        "sim:SCENARIO, rsi:UDP_PORT, egm:UDP_PORT, rtde:HOST[:PORT], ws://HOST:PORT, or alter:, feetech: or "
        "dynamixel:/dev/PORT."
    ),
    Input(f"{ROBOT_READERS}:robot", kind=str),
    Flag("--robot", metavar="DRIVER:DEVICE"),
]
"""DRIVER:DEVICE, a driver of one's own that keeps drivers.Robot, or one of these with its clock."""
Confirm: TypeAlias = bool | Callable[[str], bool]
"""Whether the arm may move: True, or what is asked with the motion in words."""
GuardLimits: TypeAlias = Annotated[
    Any, Doc("limits.yaml: what the guard keeps. [default: its own]"), Input(f"{READERS}:file")
]
"""Limits, or the path of a limits.yaml, whose name errors tell."""
Left: TypeAlias = Annotated[Any, Doc(f"Left frames: {SRC}."), FRAMES, Flag(metavar="SRC")]
"""Frames as the command line names them, or images in order."""
Right: TypeAlias = Annotated[Any, Doc("Right frames, in step with the left ones."), FRAMES, Flag(metavar="SRC")]
CamerasLike: TypeAlias = Annotated[
    Any,
    Doc("Frames of a camera by its name in rig.yaml; repeated. --left SRC is short for left=SRC."),
    Input(f"{READERS}:cameras"),
    Flag("--camera", metavar="NAME=SRC", read=cameras_of, repeated=True),
]
"""Frames by camera: {"left": ..., "top": ...}, each as Left takes them."""
NamedSpotsLike: TypeAlias = Annotated[
    Any, Input(f"{READERS}:named_spots", kind=list[str]), Flag("--spots", metavar="NAME=CSV", repeated=True)
]
"""Spots by camera: {"left": ..., "top": ...}, each as SpotsLike."""
BothViews: TypeAlias = Annotated[Any, Doc("Frames with both views in one image."), FRAMES, Flag(metavar="SRC")]
