"""Tools for taught paths, as `armsight path` has them: `armsight.paths.smooth(path)` and so on, paths in, paths out."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import reduce
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, ParamSpec, TypeAlias, TypeVar

from armsight.defaults import (
    EXPORT_ACCELERATION_M_S2,
    PATCH_PX,
    PATH_GAP_M,
    PATH_GAP_RAD,
    PICK_STD_PX,
    SMOOTHING_M,
    SMOOTHING_RAD,
)
from armsight.errors import UsageError
from armsight.fields import Bounds, Doc, Flag
from armsight.ops.action import Input, action
from armsight.ops.flags import KNOWN_ARM
from armsight.ops.kinds import (
    READERS,
    ROBOT_READERS,
    AnyRigLike,
    ArmLike,
    AsFile,
    LimitsLike,
    Readings,
    TaughtLike,
    ToolTip,
)
from armsight.units import DEG

if TYPE_CHECKING:
    from armsight.ops.path.check import PathCheckOutput
    from armsight.ops.path.export import PathExportOutput
    from armsight.ops.path.picks import PathPicksOutput
    from armsight.ops.path.tools import PathChangeOutput, PathSmoothOutput
    from armsight.records import Progress, TaughtPath

__all__ = ["angle", "check", "export", "fillet", "from_picks", "join", "offset", "resample", "reverse", "smooth"]

P = ParamSpec("P")
Change = TypeVar("Change", bound="PathChangeOutput")

APath: TypeAlias = Annotated[TaughtLike, Doc("path.csv.")]
PathOut: TypeAlias = Annotated[Path | None, Doc("path.csv to write."), Flag("-o --out", metavar="FILE", needed=True)]
Speed: TypeAlias = Annotated[float | None, Doc("Where the path leaves it open, m/s.")]
Picture: TypeAlias = Annotated[Any, Input(f"{READERS}:picture")]


def _tool(command: str, **more: Any) -> Callable[[Callable[P, Change]], Callable[P, TaughtPath]]:
    """Make a function an action of which Python gets the path that it makes."""
    return action(command, gives="taught", **more)  # type: ignore[return-value]  # which is a part of the result


@_tool("path smooth", examples=("path.csv --bound-m 0.0005 -o smooth.csv",))
def smooth(
    path: APath,
    *,
    bound_m: Annotated[float, Doc("No row moves further, m."), Bounds(above=0.0)] = SMOOTHING_M,
    bound_rad: Annotated[
        float, Doc("No row turns further, degrees."), Bounds(above=0.0, most=180.0 * DEG), Flag(unit=DEG)
    ] = SMOOTHING_RAD,
    outliers: Annotated[
        Literal["refuse", "drop", "keep"],
        Doc("Rows off the path: refuse, drop, or keep (smooth over them)."),
        Flag(read=str),
    ] = "refuse",
    out: PathOut = None,
) -> PathSmoothOutput:
    """Take the noise out, within a bound. Corners stay; outliers are named.

    Raises
    ------
    Inconsistent
        Rows that do not belong to the path, where they are refused.

    Examples
    --------
    >>> T = np.tile(np.eye(4), (9, 1, 1))
    >>> T[:, 0, 3] = np.linspace(0.0, 0.1, 9)
    >>> len(armsight.paths.smooth(armsight.TaughtPath.of_poses(T)))
    9
    """
    from armsight.ops.path.tools import smooth_path

    return smooth_path(path.taught, bound_m, bound_rad, outliers, where=path.where, out=out)


@_tool("path resample", examples=("path.csv --step-m 0.001 -o even.csv",))
def resample(
    path: APath,
    step_m: Annotated[float, Doc("Rows are at most so far apart, m.")],
    *,
    spline: Annotated[bool, Doc("On splines between corners, not on lines.")] = False,
    out: PathOut = None,
) -> PathChangeOutput:
    """Spread rows evenly by length. Ends, corners and tagged rows stay."""
    from armsight.control.paths import resampled
    from armsight.ops.path.tools import changed

    return changed([path.taught], resampled(path.taught, step_m, spline=spline), out)


@_tool("path fillet", examples=("path.csv --radius-m 0.005 -o rounded.csv",))
def fillet(path: APath, radius_m: Annotated[float, Doc("Of the arcs, m.")], *, out: PathOut = None) -> PathChangeOutput:
    """Round the corners to arcs."""
    from armsight.control.paths import filleted
    from armsight.ops.path.tools import changed

    return changed([path.taught], filleted(path.taught, radius_m), out)


@_tool("path offset", examples=("path.csv --by-m -0.01 -o above.csv",))
def offset(
    path: APath,
    by_m: Annotated[float, Doc("Along the tool's z axis, m; negative: back from the work.")],
    *,
    out: PathOut = None,
) -> PathChangeOutput:
    """Move the path along the tool's own axis."""
    from armsight.control.paths import offset_along_tool
    from armsight.ops.path.tools import changed

    return changed([path.taught], offset_along_tool(path.taught, by_m), out)


@_tool("path angle", examples=("path.csv --travel-deg 15 -o tilted.csv",))
def angle(
    path: APath,
    *,
    travel_rad: Annotated[float, Doc("Toward the direction of travel, degrees; negative drags."), Flag(unit=DEG)] = 0.0,
    work_rad: Annotated[float, Doc("About the direction of travel, degrees."), Flag(unit=DEG)] = 0.0,
    out: PathOut = None,
) -> PathChangeOutput:
    """Tilt the tool about its tip, as a torch is held."""
    from armsight.control.paths import tilted
    from armsight.ops.path.tools import changed

    return changed([path.taught], tilted(path.taught, travel_rad=travel_rad, work_rad=work_rad), out)


@_tool("path reverse", examples=("path.csv -o back.csv",))
def reverse(path: APath, *, out: PathOut = None) -> PathChangeOutput:
    """Turn the path round; the same stretches are welded."""
    from armsight.control.paths import reversed_path
    from armsight.ops.path.tools import changed

    return changed([path.taught], reversed_path(path.taught), out)


@_tool("path join", examples=("first.csv second.csv -o both.csv",))
def join(
    first: Annotated[
        Any,
        Doc("Two path.csv or more, in their order."),
        Input(f"{ROBOT_READERS}:taught_paths", kind=list[Path]),
        Flag(positional=True, metavar="PATH..."),
    ],
    second: Annotated[Any, Input(f"{ROBOT_READERS}:taught_paths")] = (),
    *,
    gap_m: Annotated[float, Doc("Widest gap between two ends, m."), Bounds(least=0.0)] = PATH_GAP_M,
    gap_rad: Annotated[
        float, Doc("Largest turn between them, degrees."), Bounds(least=0.0, most=180.0 * DEG), Flag(unit=DEG)
    ] = PATH_GAP_RAD,
    out: PathOut = None,
) -> PathChangeOutput:
    """Put paths one after the other.

    Parameters
    ----------
    first, second
        A path, or several in their order.

    Raises
    ------
    Inconsistent
        Their ends are further apart than the gap.
    """
    from armsight.control.paths import joined
    from armsight.ops.path.tools import changed

    paths = [one.taught for one in (*first, *second)]
    if len(paths) < 2:
        raise UsageError("one path alone is not joined", cure="Give two paths or more, in their order")
    return changed(paths, reduce(lambda a, b: joined(a, b, gap_m=gap_m, gap_rad=gap_rad), paths), out)


@action("path check", examples=("path.csv --arm arm.yaml --limits limits.yaml -o check.html",))
def check(
    path: APath,
    arm: Annotated[ArmLike, Doc(f"{KNOWN_ARM}.")],
    *,
    out: Annotated[Path | None, Doc("A page with the picture of it, .html."), Flag("-o --out")] = None,
    tip: ToolTip = None,
    limits: Annotated[LimitsLike, Doc("limits.yaml of the guard. [default: its own]")] = None,
    frame: Annotated[Literal["world", "base"], Doc("Frame of the path: world or base."), Flag(read=str)] = "world",
    speed_m_s: Annotated[float | None, Doc("Where the path leaves it open, m/s. [default: the limits']")] = None,
    start: Annotated[Readings, Doc("Where the arm stands: readings as 0,-1.2,0.4, or a joints.csv.")] = None,
) -> PathCheckOutput:
    """Tell before any motion whether an arm can run the whole path. Exit code 3 where it cannot.

    Parameters
    ----------
    path, frame
        A TaughtPath, which says its frame, or a file in a frame.
    start
        Readings (n,).
    """
    from armsight.control.guard import Limits
    from armsight.ops.kinematics_results import reading_values
    from armsight.ops.path.check import checked, with_tip

    carrier = arm if tip is None else with_tip(arm, tip)
    stand = None if start is None else reading_values(carrier, start)
    return checked(
        path.taught,
        carrier,
        limits or Limits(),
        speed_m_s=speed_m_s,
        start=stand,
        page_of=None if out is None else Path(path.where).name,
    )


@action(
    "path export",
    examples=(
        "path.csv --to urscript --arm arm.yaml -o seam.script",
        "path.csv --to krl --arm arm.yaml --tool 1 -o seam.src",
    ),
)
def export(
    path: APath,
    out: Annotated[Path, Doc("program.script, .src, .mod, .ngc, path.csv or .py."), Flag("-o --out", metavar="FILE")],
    *,
    to: Annotated[
        str | None, Doc("urscript, krl, rapid, linuxcnc, csv or python. [default: by the file's ending]")
    ] = None,
    arm: Annotated[ArmLike, Doc(f"{KNOWN_ARM}: the path is checked for it, or refused.")] = None,
    tip: ToolTip = None,
    limits: Annotated[LimitsLike, Doc("limits.yaml for the check. [default: the guard's own]")] = None,
    frame: Annotated[
        Literal["world", "base"], Doc("Frame of the path: world (needs --arm) or base."), Flag(read=str)
    ] = "world",
    start: Annotated[Readings, Doc("Readings near which the arm begins, as 0,-1.2,0.4, or a joints.csv.")] = None,
    name: Annotated[str | None, Doc("Name of the program. [default: the file's]")] = None,
    speed_m_s: Speed = None,
    blend_m: Annotated[float, Doc("Radius of blends or zones, m; 0 stops at rows.")] = 0.0,
    acceleration_m_s2: Annotated[float, Doc("Of the tool, m/s^2.")] = EXPORT_ACCELERATION_M_S2,
    approach_m: Annotated[float, Doc("How far back along the tool it begins and ends, m.")] = 0.05,
    turn_acceleration_rad_s2: Annotated[
        float, Doc("LinuxCNC: of the axes A B C, deg/s^2."), Bounds(above=0.0), Flag("--turn-acceleration", unit=DEG)
    ] = math.pi,
    controller: Annotated[
        ArmLike, Doc("LinuxCNC: the arm that its genserkins is set to, where --arm is calibrated. [default: --arm]")
    ] = None,
    tool: Annotated[str | None, Doc("KRL: number of TOOL_DATA; RAPID: name of the tooldata.")] = None,
    weld_output: Annotated[str | None, Doc("Digital output of weld_on and weld_off. [default: comments alone]")] = None,
) -> PathExportOutput:
    """Write the path as a controller's program (Universal Robots, KUKA, ABB, LinuxCNC), as CSV, or as a Python module.

    Parameters
    ----------
    arm, tip, limits, frame, start
        As `check` takes them.
    name, speed_m_s, blend_m, acceleration_m_s2, approach_m, tool, weld_output
        They are written into the program.
    turn_acceleration_rad_s2, controller
        Of LinuxCNC, whose joints are worked out by the axes' accelerations: what A B C have, and another geometry.

    Raises
    ------
    Inconsistent
        The arm cannot run it.
    """
    from armsight.control.paths.linuxcnc import Axes
    from armsight.control.paths.program import Program, program_moves
    from armsight.ops.kinematics_results import reading_values
    from armsight.ops.path import export as parts

    file, kind, taught = Path(out), parts.format_of(Path(out), to), path.taught
    if kind in parts.AS_IT_IS:
        return parts.exported(file, kind, taught, parts.AS_IT_IS[kind](taught))
    parts.require_tags(path.where, taught, weld_output)
    carrier = parts.carrier_of(arm, tip)
    run = parts.with_ends(taught, carrier, approach_m)
    stops = (1, len(run) - 2) if approach_m > 0.0 else ()  # a blend would cut the path's ends off
    moves = program_moves(run, speed_m_s=speed_m_s, blend_m=blend_m, stops=stops)
    found = None
    if carrier is not None:
        first = None if start is None else reading_values(carrier, start)
        parts.refuse_jumps(taught)
        found = parts.checked_run(run, carrier, limits, speed_m_s=speed_m_s, start=first)
    if kind == parts.LINUXCNC:
        axes = Axes(acceleration_m_s2=acceleration_m_s2, acceleration_rad_s2=turn_acceleration_rad_s2)
        called = file.stem if name is None else name
        return parts.for_linuxcnc(file, called, run, moves, found, carrier, controller, limits, axes, weld_output)
    program = Program(
        name=file.stem if name is None else name,
        moves=moves,
        acceleration_m_s2=acceleration_m_s2,
        turn_rad_s=parts.TURN_RAD_S,
        start=None if carrier is None or found is None else parts.start_of(carrier, found),
        tool=tool,
        T_flange_tool=None if carrier is None else carrier.T_flange_tool,
        weld_output=weld_output,
    )
    return parts.exported(file, kind, run, parts.PROGRAMS[kind](program), found=found, start=program.start)


@action(
    "path from-picks",
    working="searching",
    examples=("--left left.png --right right.png --rig rig.yaml --picks picks.csv --world world.yaml -o path.csv",),
)
def from_picks(
    left: Annotated[Picture, Doc("Picture of the left camera.")],
    right: Annotated[Picture, Doc("Picture of the right camera, of the same scene at rest.")],
    rig: Annotated[AnyRigLike, Doc("rig.yaml that has the cameras left and right.")],
    picks: Annotated[AsFile, Doc("picks.csv: u_px,v_px[,edge] of one view.")],
    *,
    out: PathOut = None,
    view: Annotated[
        Literal["left", "right"], Doc("The view that the picks are of: left or right."), Flag(read=str)
    ] = "left",
    world: Annotated[AsFile, Doc("world.yaml. [default: the path is in the rig's axes]")] = None,
    near_m: Annotated[float | None, Doc("Nearest depth. [default: 3 baselines]"), Flag(quantity="m")] = None,
    far_m: Annotated[float | None, Doc("Furthest depth. [default: 300 baselines]"), Flag(quantity="m")] = None,
    step_px: Annotated[float, Doc("Between points on an edge, px.")] = 10.0,
    patch_px: Annotated[int, Doc("Side of a patch, px.")] = PATCH_PX,
    pick_std_px: Annotated[float, Doc("Standard deviation of a pick, px.")] = PICK_STD_PX,
    tool_axis: Annotated[
        str | None, Doc("The tool's z. [default: the view's optical axis]"), Flag(metavar="X,Y,Z")
    ] = None,
    skip: Annotated[bool, Doc("Leave out what is not found, instead of refusing all.")] = False,
    progress: Progress | None = None,
) -> PathPicksOutput:
    """Make a path of points and edges picked in one picture, found in the other one, and triangulated.

    Parameters
    ----------
    left, right
        Images or files.
    picks
        Columns u_px, v_px of the places, or a file.
    world
        T_base_rig.

    Returns
    -------
    PathPicksOutput
        `taught`, the path, and how its points were found.
    """
    from scipy.spatial.transform import RigidTransform

    from armsight.control.paths.along import along_edges
    from armsight.measure.correspondence import PatchSettings, StereoViews
    from armsight.ops.path.picks import axis_of, find_places, path_of_places
    from armsight.records import Silent
    from armsight.store.rigs import World, read_world
    from armsight.store.spots_csv import read_picks

    settings = PatchSettings(half_px=patch_px // 2, near_m=near_m, far_m=far_m, pick_std_px=pick_std_px)
    views = StereoViews(rig=rig.pair(), left=left, right=right)
    picked = read_picks(picks)
    stand = World(parent="rig", T_parent_rig=RigidTransform.identity()) if world is None else read_world(world)
    axis = axis_of(tool_axis, views, view, stand.T_parent_rig)
    uv, rows = along_edges(picked.uv_px, picked.edges, step_px)
    places = [(int(row), px) for row, px in zip(rows, uv, strict=True)]
    found, refused = find_places(places, views, view, settings, skip, progress or Silent())
    return path_of_places(found, refused, len(picked.uv_px), stand, axis, out)
