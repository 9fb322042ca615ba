"""A whole cell calibrated from one recording of its moving arm."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

from armsight.defaults import ANGLE_RAD, CELL_LENGTH_M
from armsight.errors import UsageError
from armsight.fields import Bounds, Doc, Flag
from armsight.file_names import CELL, CELL_CALIBRATED
from armsight.ops.action import Input, action
from armsight.ops.flags import KNOWN_ARM, SRC, Fps, Inverted, Limit, Table, Threshold, size_of
from armsight.ops.kinds import FRAMES, READERS, CamerasLike
from armsight.units import DEG, MM

if TYPE_CHECKING:
    from armsight.calibrate.cell import CellResult
    from armsight.records import Progress

__all__ = ["calibrate_cell"]

SPOTS = "table t_s,u_px,v_px[,su_px,sv_px]"
COMPLIANCE = {"auto": None, "on": True, "off": False}
HERE = "armsight.ops.calibration.cell"

TableFile: TypeAlias = Annotated[Any, Input(f"{READERS}:table", hashed=True)]
"""Columns by name, (t_s, q), or the path of a table."""
BuiltTarget: TypeAlias = Annotated[Any, Input(f"{READERS}:target", hashed=True)]
NominalArm: TypeAlias = Annotated[Any, Input(f"{HERE}:given_arm", kind=str)]
TipLike: TypeAlias = Annotated[Any, Input(f"{HERE}:given_tip", kind=str)]
Files: TypeAlias = Annotated[Any, Input(f"{HERE}:given_files", kind=list[Path], hashed=True)]
NamedTables: TypeAlias = Annotated[
    Any,
    Doc("The same of a camera by its name; repeated."),
    Input(f"{READERS}:named_spots", kind=list[str], hashed=True, files=f"{HERE}:named_tables"),
    Flag("--spots", metavar="NAME=CSV", repeated=True),
]
Size: TypeAlias = "tuple[int, int] | None"


def compliance_called(name: str) -> bool | None:
    """Return whether joints may give way, None where the recording shall show it. Raises UsageError."""
    if name not in COMPLIANCE:
        raise UsageError(f"--compliance {name!r} is none of {', '.join(COMPLIANCE)}")
    return COMPLIANCE[name]


@action(
    "calibrate cell",
    working="calibrating",
    keeps=CELL_CALIBRATED,
    examples=(
        "--robot-log joints.csv --left left.mp4 --right right.mp4 --target target.yaml --model ur10e --tip "
        "0,0,0.12 -o cell",
        "--robot-log joints.csv --left-spots left.csv --right-spots right.csv --size 1280x720 --target "
        "target.yaml --model arm.yaml -o cell",
        "--robot-log joints.csv --camera left=left.mp4 --camera right=right.mp4 --camera top=top.mp4 --target "
        "target.yaml --model arm.yaml -o cell",
    ),
    own=CELL,
    filed=True,
    judged=True,
    writes="write_cell",
    page="cell_report:cell_report",
)
def calibrate_cell(
    robot_log: Annotated[
        TableFile,
        Doc("joints.csv of the motion: t_s, q1, ... by the robot's clock; or the recording.mcap."),
        Flag(metavar="LOG"),
    ],
    target: Annotated[BuiltTarget, Doc("target.yaml of the lights on the flange, as built.")],
    model: Annotated[NominalArm, Doc(f"The nominal arm: {KNOWN_ARM}."), Flag(metavar="ARM")],
    left: Annotated[Any, Doc(f"Left frames, each with its camera's stamp: {SRC}."), FRAMES, Flag(metavar="SRC")] = None,
    right: Annotated[Any, Doc("Right frames, each with its camera's stamp."), FRAMES, Flag(metavar="SRC")] = None,
    *,
    cameras: CamerasLike = None,
    left_spots: Annotated[TableFile, Doc(f"Instead of frames: {SPOTS}; with --size."), Flag(metavar="CSV")] = None,
    right_spots: Annotated[TableFile, Doc("The same of the right camera."), Flag(metavar="CSV")] = None,
    spots: NamedTables = None,
    size: Annotated[
        Size, Doc("With tables of spots: size of the images, px."), Flag(metavar="WxH", read=size_of)
    ] = None,
    right_size: Annotated[
        Size, Doc("That of the right camera, where it is another."), Flag(metavar="WxH", read=size_of)
    ] = None,
    tip: Annotated[
        TipLike, Doc("The tool's tip in target axes, X,Y,Z in m or with units, or tip.yaml."), Flag(metavar="TIP")
    ] = None,
    tolerance_m: Annotated[
        float, Doc("Standard deviation of nominal lengths."), Bounds(least=1e-6 * MM), Flag(unit=MM)
    ] = CELL_LENGTH_M,
    tolerance_rad: Annotated[
        float, Doc("Standard deviation of nominal zeros and angles."), Bounds(least=1e-6 * DEG), Flag(unit=DEG)
    ] = ANGLE_RAD,
    prior: Annotated[
        Files,
        Doc("rig.yaml, world.yaml or handeye.yaml of earlier calibrations, to count with their covariance; repeated."),
        Flag(metavar="FILE"),
    ] = None,
    compliance: Annotated[
        bool | None,
        Doc(
            "Whether joints give way under the arm's weight: on fits how far, off says they do not, auto fits where "
            "the recording shows it and else counts in the deviations what they may."
        ),
        Flag(metavar="WHETHER", default="auto", read=compliance_called),
    ] = None,
    threshold: Threshold = None,
    inverted: Inverted = False,
    fps: Fps = None,
    frames: Limit = None,
    table: Table | None = None,
    out: Annotated[Path | None, Doc("Where the results go."), Flag("-o --out", metavar="FOLDER", needed=True)] = None,
    progress: Progress | None = None,
) -> CellResult:
    """Calibrate cameras, clocks, base, target and arm at once, from one recording of the moving arm.

    Parameters
    ----------
    robot_log
        (t_s, q) of the motion, or its file; also a recording that holds the robot's joints.
    target
        The lights on the flange, as built.
    model
        The arm as its data sheet says.
    left, right
        Frames of both cameras, each with its camera's stamps.
    cameras
        Instead: frames by the names of one to eight cameras, {'left': ..., 'top': ...}. They need not see the lights
        together, nor all the time; the first one's axes and stamps are the rig's.
    left_spots, right_spots, spots
        Instead of frames: columns t_s, u_px, v_px of each camera; spots: by the cameras' names. size, right_size: of
        their images (w, h) px.
    tip
        Of the tool in target axes: (x, y, z) m, or tip.yaml.
    tolerance_m, tolerance_rad
        Standard deviation of nominal lengths, and of nominal zeros and angles.
    prior
        Files of earlier calibrations.
    compliance
        Whether joints give way under the arm's weight; None: where the recording shows it, and else the
        deviations count what they may.
    frames
        Frames of each camera to read at most.
    out
        A folder to write rig.yaml, world.yaml, target.yaml, arm.yaml, cell.json and report.html into.

    Raises
    ------
    NotEnoughData, Degenerate
        Too little motion, or light.
    Inconsistent, Ambiguous, NotConverged
        Another arm, log or target; or something changed on the way, with what and when.

    Examples
    --------
    >>> made = armsight.write_simulation("cell", folder / "cell", frames=700)
    >>> found = armsight.calibrate_cell(
    ...     folder / "cell/joints.csv", folder / "cell/target.yaml", folder / "cell/arm.yaml",
    ...     left_spots=folder / "cell/left.csv", right_spots=folder / "cell/right.csv", size=(1280, 720))
    >>> found.tip.measured_m < 0.002
    True
    """
    from armsight.calibrate.cell import ArmTolerance, CellOptions, calibrate_cell
    from armsight.ops.calibration import cell as recorded
    from armsight.ops.calibration.spots_of_frames import SpotSearch
    from armsight.records import Silent
    from armsight.store.interpret import OURS

    for name, value in (("size", size), ("right_size", right_size)):
        recorded.require_size(name, value)
    given, listed = recorded.by_camera(left, right, cameras), recorded.by_camera(left_spots, right_spots, spots)
    recorded.require_sources(list(given.values()), list(listed.values()), size)
    sources, tables = ({name: one for name, one in each.items() if one is not None} for each in (given, listed))
    joints = recorded.joints_of(robot_log, model, table or OURS)
    if size is not None and tables:
        each = [right_size if name == "right" and right_size else size for name in tables]
        tracks, sizes = recorded.spots_of_tables(tables, each)
    else:
        first = next(iter(sources.values()))
        search = SpotSearch(threshold=threshold, inverted=inverted, fps=fps, limit=frames, origin_of=first)
        tracks, sizes = recorded.spots_and_sizes(search, sources, progress or Silent())
    recorded.require_own(tracks)
    names = tuple(tracks)
    options = CellOptions(
        tip_m=tip,
        tolerance=ArmTolerance(length_m=tolerance_m, zero_rad=tolerance_rad, angle_rad=tolerance_rad),
        compliance=compliance,
        priors=recorded.read_priors(prior or (), sizes, names),
    )
    every = list(tracks.values())
    done = calibrate_cell(model, joints, every, target, sizes=sizes, names=names, options=options, progress=progress)
    if size is not None:
        recorded.require_centred(done)
    return done
