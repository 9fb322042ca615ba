"""Files of one kind as those of another; recordings exported. Python's `convert` finds which of them is meant."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from os import fspath
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias, get_args

from armsight.errors import UsageError, not_one_of
from armsight.fields import Doc, Flag
from armsight.ops.action import Input, action
from armsight.ops.flags import AN_ARM, KNOWN_ARM, OUT, Base, Table, Tip, UnitLength, size_of
from armsight.ops.kinds import READERS, ArmLike, AsFile

if TYPE_CHECKING:
    from armsight.ops.arm_files import ConvertArmOutput
    from armsight.ops.conversion import ConvertOutput
    from armsight.ops.given import PathText
    from armsight.ops.recording.export import ExportOutput
    from armsight.ops.tables import ConvertTableOutput
    from armsight.records import Progress
    from armsight.records.output import Output
    from armsight.store.foreign import FrameNames
    from armsight.store.interpret import TableFormat

__all__ = ["convert", "export_recording"]

Kind = Literal["camera", "rig", "handeye", "arm", "poses", "table", "recording"]
ARGUMENT = Flag(positional=True)
To: TypeAlias = Annotated[str | None, Doc("A kind of convert --list that is written. [armsight]")]
Size: TypeAlias = Annotated[
    tuple[int, int] | None, Doc("WIDTHxHEIGHT, where the file says none or is of several sizes."), Flag(read=size_of)
]
Approximate: TypeAlias = Annotated[bool, Doc("Take the nearest lens, however far another model is from it.")]
Out: TypeAlias = Annotated[Path, Doc("File to write."), OUT]
Nominal: TypeAlias = Annotated[ArmLike, Doc("The arm as its maker draws it and its controller has it.")]

RIG_KEYS = {"cam1", "cameraMatrix2", "M2", "K2", "R", "T"}
"""Of these each says that a file of another program is of two cameras."""
OF_ENDING = {".mcap": "recording", ".urdf": "arm", ".tum": "poses", ".txt": "poses"}
"""What a file is by its name's ending."""


@action(
    "convert recording",
    working="exporting",
    writes=True,
    examples=("recording.mcap -o frames", "recording.mcap --to rosbag2 -o bag"),
)
def export_recording(
    path: Annotated[AsFile, Doc("A recording."), Flag(positional=True, metavar="FILE.mcap")],
    out: Annotated[Path, Doc("A folder, or a .csv or .tum for the poses."), OUT],
    *,
    to: Annotated[str, Doc("files, or rosbag2: a bag of ROS 2, in a new folder.")] = "files",
    progress: Progress | None = None,
) -> ExportOutput:
    """Write a recording's content as PNG folders and tables, its poses as CSV or TUM, or all as a bag of ROS 2.

    Parameters
    ----------
    out
        A folder, or a .csv or .tum.

    Raises
    ------
    BadFile, NotEnoughData, UsageError
        No recording, or nothing in it that is asked for.

    Examples
    --------
    >>> done = armsight.record(folder / "run.mcap", cell="hand-cell", frames=2)
    >>> armsight.export_recording(folder / "run.mcap", folder / "run").n["left"]
    2
    """
    from armsight.ops.recording.export import export

    return export(path, out, to=to, progress=progress)


@action(
    "convert camera", writes=True, examples=("camchain.yaml -o camera.yaml", "camera.yaml --to ros -o camera_info.yaml")
)
def camera(
    source: Annotated[AsFile, Doc("camera.yaml, or a file of a kind of convert --list."), ARGUMENT],
    out: Out,
    *,
    to: To = None,
    size: Size = None,
    name: Annotated[str | None, Doc("Which camera of a file that holds several.")] = None,
    approximate: Approximate = False,
    zoom: Annotated[float | None, Doc("Of a zoom lens's camera.yaml: the camera at this setting.")] = None,
) -> ConvertOutput:
    """Convert the calibration of one camera; or take one setting out of a zoom lens's."""
    from armsight.ops.calibration.zoom import fix_camera
    from armsight.ops.conversion import convert_camera
    from armsight.store.foreign import Asked

    if zoom is None:
        names = () if name is None else (name,)
        return convert_camera(source, out, to=to, asked=Asked(size=size, names=names, approximate=approximate))
    _require_ours(to, size)
    return fix_camera(source, out, zoom)


@action("convert rig", writes=True, examples=("stereo.yml -o rig.yaml", "rig.yaml --to opencv -o r.yml"))
def rig(
    source: Annotated[
        Any,
        Doc("rig.yaml, or a file of a kind of convert --list; two files of ROS or OpenCV."),
        Input(f"{READERS}:each_file", kind=list[Path]),
        ARGUMENT,
    ],
    out: Annotated[list[Path], Doc("File; for ROS left, right, maybe a launch file of TF."), OUT],
    *,
    to: To = None,
    size: Size = None,
    unit_m: UnitLength = None,
    names: Annotated[
        list[str] | None, Doc("A camera of a file that holds more, the first one first; once for each."), Flag("--name")
    ] = None,
    approximate: Approximate = False,
    zoom_left: Annotated[float | None, Doc("Of a rig with zoom lenses: at this setting.")] = None,
    zoom_right: Annotated[float | None, Doc("... of the right lens.")] = None,
) -> ConvertOutput:
    """Convert the calibration of a rig's cameras; or take one setting out of a rig with zoom lenses."""
    from armsight.ops.calibration.zoom import fix_rig
    from armsight.ops.conversion import convert_rig
    from armsight.store.foreign import Asked

    if zoom_left is None and zoom_right is None:
        asked = Asked(size=size, unit_m=unit_m, names=tuple(names or ()), approximate=approximate)
        return convert_rig(source, out, to=to, asked=asked)
    _require_ours(to, size)
    if len(source) != 1 or len(out) != 1:
        raise UsageError("one rig.yaml goes into one", cure="Give one file and one -o with --zoom-left")
    return fix_rig(source[0], out[0], (zoom_left, zoom_right))


@action("convert poses", writes=True, examples=("poses.csv -o poses.tum",))
def poses(
    source: Annotated[AsFile, Doc("poses.csv, or a TUM file (.tum, .txt)."), ARGUMENT],
    out: Annotated[Path, Doc("File to write: .csv, .tum or .txt."), OUT],
) -> ConvertOutput:
    """Convert poses between poses.csv and TUM, which evo reads."""
    from armsight.ops.conversion import convert_poses

    return convert_poses(source, out)


@action("convert table", examples=("log.txt --robot-format kuka --as robot_poses -o robot_poses.csv",))
def any_table(
    source: Annotated[AsFile, Doc("CSV, TXT, YAML, JSON, .mat, or a folder with one file per pose."), ARGUMENT],
    out: Annotated[Path | None, Doc("File to write. [default: only tell]"), OUT] = None,
    *,
    kind: Annotated[
        str | None, Doc("joints, poses, points, pairs, robot_poses or sweep. [default: tell]"), Flag("--as")
    ] = None,
    arm: Annotated[ArmLike, Doc("Where columns carry the names of an arm's joints."), AN_ARM] = None,
    table: Table | None = None,
) -> ConvertTableOutput:
    """Show what is understood of a table, and write it in armsight's columns and units."""
    from armsight.ops.file_kinds import pointed_elsewhere
    from armsight.ops.tables import convert_table

    with pointed_elsewhere(source, "convert table"):
        return convert_table(source, kind=kind, format_=table, arm=arm, out=out)


@action("convert handeye", writes=True, examples=("handeye.yaml --to easy_handeye -o handeye_easy.yaml",))
def handeye(
    source: Annotated[AsFile, Doc("handeye.yaml."), ARGUMENT],
    out: Out,
    to: Annotated[str, Doc("easy_handeye, easy_handeye2, or tf: a launch file of ROS 2.")],
    *,
    base: Annotated[str, Doc("The base's frame in TF.")] = "base_link",
    flange: Annotated[str, Doc("The flange's frame in TF.")] = "tool0",
    camera_frame: Annotated[str, Doc("The camera's optical frame in TF.")] = "camera_optical_frame",
    target: Annotated[str, Doc("The target's frame in TF.")] = "calibration_target",
) -> ConvertOutput:
    """Write a hand-eye calibration for ROS."""
    from armsight.ops.conversion import convert_handeye
    from armsight.store.foreign import FrameNames

    names = FrameNames(base=base, flange=flange, camera=camera_frame, target=target)
    return convert_handeye(source, out, to=to, names=names)


@action(
    "convert arm",
    writes=True,
    examples=(
        "robot.urdf --tip tool0 -o arm.yaml",
        "calibration.conf --nominal ur10e -o arm.yaml",
        "arm.yaml --to kuka --nominal kr6 -o krc.txt",
        "arm.yaml -o arm.mjcf",
    ),
)
def arm(
    source: Annotated[
        str,
        Doc(f"{KNOWN_ARM}, or the factory calibration of a Universal Robot, an xArm or a Techman."),
        Flag(positional=True, metavar="FILE"),
    ],
    out: Annotated[Path, Doc("File to write: .yaml, .urdf, or .mjcf for MuJoCo; .txt with --to."), OUT],
    *,
    convention: Annotated[str | None, Doc("standard or craig, for arm.yaml.")] = None,
    rigid: Annotated[
        bool, Doc("The nearest rigid arm, for programs that know no other; .urdf and .mjcf are so.")
    ] = False,
    tip: Tip = None,
    base: Base = None,
    nominal: Nominal = None,
    to: Annotated[str | None, Doc("What is typed into its controller: kuka, ur, fanuc, abb, staubli.")] = None,
) -> ConvertArmOutput:
    """Convert an arm: arm.yaml and URDF, to MJCF, conventions of Denavit and Hartenberg, for a controller.

    With --to the file says what a calibrated arm's zeros, base and tool become in its controller, and what is lost.
    """
    from armsight._files import arm_source
    from armsight.ops.arm_files import convert_arm
    from armsight.ops.file_kinds import pointed_elsewhere

    with pointed_elsewhere(Path(source), "convert arm"):
        chain = arm_source(source, tip=tip, base=base)
        return convert_arm(chain, out, convention=convention, only_rigid=rigid, nominal=nominal, to=to)


def convert(
    source: Any,
    out: PathText | list[PathText] | tuple[PathText, ...],
    *,
    to: str | None = None,
    kind: Kind | None = None,
    size: tuple[int, int] | None = None,
    unit_m: UnitLength = None,
    convention: Literal["standard", "craig"] | None = None,
    nominal: Nominal = None,
    names: FrameNames | None = None,
    table: TableFormat | None = None,
) -> Output:
    """Write a record or a file of one kind as a file of another program, or the other way round.

    Parameters
    ----------
    source
        A Camera, Rig, Arm, PoseTrack or hand-eye result; or a file, or the two files of ROS or OpenCV.
    out
        The file; for a rig of ROS left, right, and maybe a launch file of TF.
    to
        Cameras and rigs: a kind of `armsight convert --list`; hand-eye: easy_handeye, easy_handeye2, tf; recordings:
        files, rosbag2; arms: kuka, ur, fanuc, abb, staubli, what is typed into such a controller. Arms, poses and
        tables by the name's ending.
    kind
        What it is, where the file does not tell.
    size, unit_m
        Of an OpenCV file that leaves them open.
    convention
        Of an arm.yaml.
    nominal
        Of an arm: as its maker draws it and its controller has it. A Universal Robot's calibration.conf needs it too.
    names
        Of frames in TF.
    table
        What a foreign table leaves open.

    Raises
    ------
    BadFile, UsageError
        Not a file of this kind, or no such conversion.

    Examples
    --------
    >>> camera = armsight.Camera.pinhole(640, 480, 500.0, 500.0, 320.0, 240.0)
    >>> armsight.convert(camera, folder / "info.yaml", to="ros").target
    'ros'
    >>> armsight.read_camera(folder / "info.yaml").width
    640
    """
    from armsight.ops.arrays import as_path, as_size
    from armsight.ops.inputs import each_file
    from armsight.store.foreign import FrameNames

    if kind is not None and kind not in get_args(Kind):
        raise not_one_of("kind", kind, get_args(Kind))
    outs = [as_path(one, "out") for one in (out if isinstance(out, list | tuple) else [out])]
    with ExitStack() as undo:
        files = each_file("source", source, {}, undo)
        chosen = kind or ("arm" if nominal is not None else _kind(source, files))
        if chosen == "rig":
            return rig(files, outs, to=to, size=as_size(size), unit_m=unit_m)
        if chosen == "camera":
            return camera(files[0], outs[0], to=to, size=as_size(size))
        if chosen == "arm":
            return arm(fspath(files[0]), outs[0], convention=convention, nominal=nominal, to=to)
        if chosen == "handeye":
            names = names or FrameNames()
            frames = {"base": names.base, "flange": names.flange, "target": names.target}
            return handeye(files[0], outs[0], to or "", camera_frame=names.camera, **frames)
        if chosen == "recording":
            return export_recording(files[0], outs[0], to=to or "files")
        if chosen == "poses" and "poses" in (OF_ENDING.get(path.suffix.lower()) for path in (files[0], outs[0])):
            return poses(files[0], outs[0])
        return any_table(files[0], outs[0], kind=None if chosen == "table" else chosen, table=table)


def _kind(source: object, files: Sequence[Path]) -> str:
    """Return which kind of thing is converted, by its content."""
    from armsight.measure.track import PoseTrack
    from armsight.optics import Rig
    from armsight.store.factory_arms import is_factory_file
    from armsight.store.yamls import read_yaml

    if isinstance(source, Rig) or len(files) > 1:
        return "rig"
    suffix = files[0].suffix.lower()
    if suffix in OF_ENDING:
        return OF_ENDING[suffix]
    if is_factory_file(files[0]):
        return "arm"
    if suffix not in (".yaml", ".yml"):
        return "poses" if isinstance(source, PoseTrack) else "table"
    content = read_yaml(files[0])
    if not isinstance(content, Mapping):
        return "table"
    name = str(content.get("format", "")).removeprefix("armsight/")
    return name if name in ("camera", "rig", "handeye", "arm") else "rig" if RIG_KEYS & set(content) else "camera"


def _require_ours(to: str | None, size: tuple[int, int] | None) -> None:
    """Raise UsageError where a setting is to be taken and converted at once."""
    if to not in (None, "armsight") or size is not None:
        raise UsageError(
            "a setting is taken out of armsight's own file into another one",
            cure="Leave --to and --size away, and convert the file that is written",
        )
