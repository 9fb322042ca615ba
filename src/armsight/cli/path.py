"""armsight path."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

import typer

from armsight.cli.command_ui import CommandUI
from armsight.cli.kinematics import ArmFile
from armsight.cli.options import KNOWN_ARM, AsJson, quantity
from armsight.units import DEG, MM

if TYPE_CHECKING:
    from armsight.app.path.tools import PathChangeOutput

path = typer.Typer(name="path", help="Change, check and export the path of a tool's tip.", no_args_is_help=True)

NOT_OK = 3
Source: TypeAlias = Annotated[Path, typer.Argument(metavar="PATH", help="path.csv.")]
Out: TypeAlias = Annotated[Path, typer.Option("-o", "--out", metavar="FILE", help="path.csv to write.")]


def _say(face: CommandUI, done: PathChangeOutput) -> None:
    face.say(f"{done.n} rows (of {done.n_before}), {done.length_m:.4f} m: {done.file}")
    face.result(done)


@path.command("smooth")
def smooth(
    source: Source,
    out: Out,
    bound: Annotated[float, typer.Option("--bound-m", help="No row moves further, m.")] = 5e-4,
    bound_deg: Annotated[float, typer.Option("--bound-deg", help="No row turns further, degrees.")] = 1.0,
    on_outliers: Annotated[
        str, typer.Option("--outliers", help="Rows off the path: refuse, drop, or keep (smooth over them).")
    ] = "refuse",
    json: AsJson = False,
) -> None:
    """Take the noise out, within a bound. Corners stay; outliers are named."""
    with CommandUI(as_json=json) as face:
        from armsight.app.path.tools import smooth as run

        done = run(source, out, bound_m=bound, bound_rad=bound_deg * DEG, on_outliers=on_outliers)
        for outlier in done.outliers:
            face.say(f"  {outlier.text}{'; left out' if done.dropped else ''}")
        face.say(f"moved by {done.moved_rms_m / MM:.3g} mm RMS, {done.moved_max_m / MM:.3g} mm at most")
        _say(face, done)


@path.command("resample")
def resample(
    source: Source,
    out: Out,
    step: Annotated[float, typer.Option("--step-m", help="Rows are at most so far apart, m.")],
    spline: Annotated[bool, typer.Option("--spline", help="On splines between corners, not on lines.")] = False,
    json: AsJson = False,
) -> None:
    """Spread rows evenly by length. Ends, corners and tagged rows stay."""
    with CommandUI(as_json=json) as face:
        from armsight.app.path.tools import resample as run

        _say(face, run(source, out, step_m=step, spline=spline))


@path.command("fillet")
def fillet(
    source: Source,
    out: Out,
    radius: Annotated[float, typer.Option("--radius-m", help="Of the arcs, m.")],
    json: AsJson = False,
) -> None:
    """Round the corners to arcs."""
    with CommandUI(as_json=json) as face:
        from armsight.app.path.tools import fillet as run

        _say(face, run(source, out, radius_m=radius))


@path.command("offset")
def offset(
    source: Source,
    out: Out,
    by: Annotated[float, typer.Option("--by-m", help="Along the tool's z axis, m; negative: back from the work.")],
    json: AsJson = False,
) -> None:
    """Move the path along the tool's own axis."""
    with CommandUI(as_json=json) as face:
        from armsight.app.path.tools import offset as run

        _say(face, run(source, out, by_m=by))


@path.command("angle")
def angle(
    source: Source,
    out: Out,
    travel: Annotated[
        float, typer.Option("--travel-deg", help="Toward the direction of travel, degrees; negative drags.")
    ] = 0.0,
    work: Annotated[float, typer.Option("--work-deg", help="About the direction of travel, degrees.")] = 0.0,
    json: AsJson = False,
) -> None:
    """Tilt the tool about its tip, as a torch is held."""
    with CommandUI(as_json=json) as face:
        from armsight.app.path.tools import angle as run

        _say(face, run(source, out, travel_rad=travel * DEG, work_rad=work * DEG))


@path.command("reverse")
def reverse(source: Source, out: Out, json: AsJson = False) -> None:
    """Turn the path round; the same stretches are welded."""
    with CommandUI(as_json=json) as face:
        from armsight.app.path.tools import reverse as run

        _say(face, run(source, out))


@path.command("join")
def join(
    sources: Annotated[list[Path], typer.Argument(metavar="PATH...", help="Two path.csv or more, in their order.")],
    out: Out,
    gap: Annotated[float, typer.Option("--gap-m", min=0.0, help="Widest gap between two ends, m.")] = 1e-3,
    gap_deg: Annotated[
        float, typer.Option("--gap-deg", min=0.0, max=180.0, help="Largest turn between them, degrees.")
    ] = 5.0,
    json: AsJson = False,
) -> None:
    """Put paths one after the other."""
    with CommandUI(as_json=json) as face:
        from armsight.app.path.tools import join as run

        _say(face, run(sources, out, gap_m=gap, gap_rad=gap_deg * DEG))


@path.command("check")
def check(
    source: Source,
    arm: ArmFile,
    out: Annotated[Path | None, typer.Option("-o", "--out", help="A page with the picture of it, .html.")] = None,
    tip: Annotated[
        Path | None, typer.Option(help="tip.yaml of the tool, in flange axes. [default: the arm's tool frame]")
    ] = None,
    limits: Annotated[Path | None, typer.Option(help="limits.yaml of the guard. [default: its own]")] = None,
    frame: Annotated[str, typer.Option(help="Frame of the path: world or base.")] = "world",
    speed: Annotated[
        float | None, typer.Option("--speed-m-s", help="Where the path leaves it open, m/s. [default: the limits']")
    ] = None,
    start: Annotated[
        str | None, typer.Option(help="Where the arm stands: readings as 0,-1.2,0.4, or a joints.csv.")
    ] = None,
    json: AsJson = False,
) -> None:
    """Tell before any motion whether an arm can run the whole path. Exit code 3 where it cannot."""
    with CommandUI(as_json=json) as face:
        from armsight.app.path.check import check as run

        done = run(source, arm, tip=tip, limits=limits, parent=frame, speed_m_s=speed, start=start, out=out)
        for issue in done.issues[:20]:
            face.say(f"  {issue.text}")
        if len(done.issues) > 20:
            face.say(f"  ... and {len(done.issues) - 20} more")
        verdict = "can run the path" if done.ok else "cannot run the path as it is"
        face.say(f"{done.arm} {verdict}: {done.n_reached} of {done.n} rows reached, {done.duration_s:.2f} s")
        face.result(done)
        if not done.ok:
            raise typer.Exit(NOT_OK)


@path.command("export")
def export(
    source: Source,
    out: Annotated[
        Path, typer.Option("-o", "--out", metavar="FILE", help="program.script, .src, .mod, path.csv or .py.")
    ],
    to: Annotated[
        str | None, typer.Option(help="urscript, krl, rapid, csv or python. [default: by the file's ending]")
    ] = None,
    arm: Annotated[
        str | None, typer.Option(metavar="ARM", help=f"{KNOWN_ARM}: the path is checked for it, or refused.")
    ] = None,
    tip: Annotated[
        Path | None, typer.Option(help="tip.yaml of the tool, in flange axes. [default: the arm's tool frame]")
    ] = None,
    limits: Annotated[Path | None, typer.Option(help="limits.yaml for the check. [default: the guard's own]")] = None,
    frame: Annotated[str, typer.Option(help="Frame of the path: world (needs --arm) or base.")] = "world",
    start: Annotated[
        str | None, typer.Option(help="Readings near which the arm begins, as 0,-1.2,0.4, or a joints.csv.")
    ] = None,
    name: Annotated[str | None, typer.Option(help="Name of the program. [default: the file's]")] = None,
    speed: Annotated[float | None, typer.Option("--speed-m-s", help="Where the path leaves it open, m/s.")] = None,
    blend: Annotated[float, typer.Option("--blend-m", help="Radius of blends or zones, m; 0 stops at rows.")] = 0.0,
    acceleration: Annotated[float, typer.Option("--acceleration-m-s2", help="Of the tool, m/s^2.")] = 0.5,
    approach: Annotated[
        float, typer.Option("--approach-m", help="How far back along the tool it begins and ends, m.")
    ] = 0.05,
    tool: Annotated[str | None, typer.Option(help="KRL: number of TOOL_DATA; RAPID: name of the tooldata.")] = None,
    weld_output: Annotated[
        str | None, typer.Option(help="Digital output of weld_on and weld_off. [default: comments alone]")
    ] = None,
    json: AsJson = False,
) -> None:
    """Write the path as a controller's program (Universal Robots, KUKA, ABB), as CSV, or as a Python module."""
    with CommandUI(as_json=json) as face:
        from armsight.app.path.export import ExportJob, export_path

        job = ExportJob(
            source=source,
            out=out,
            to=to,
            arm=arm,
            tip=tip,
            limits=limits,
            parent=frame,
            start=start,
            name=name,
            speed_m_s=speed,
            blend_m=blend,
            acceleration_m_s2=acceleration,
            approach_m=approach,
            tool=tool,
            weld_output=weld_output,
        )
        done = export_path(job)
        checked = "checked for the arm" if done.checked else "not checked for any arm"
        face.say(f"{done.n} rows, {done.length_m:.4f} m, {checked}: {done.file}")
        face.result(done)


@path.command("from-picks")
def from_picks(
    left: Annotated[Path, typer.Option(help="Picture of the left camera.")],
    right: Annotated[Path, typer.Option(help="Picture of the right camera, of the same scene at rest.")],
    rig: Annotated[Path, typer.Option(help="rig.yaml of the two cameras.")],
    picks: Annotated[Path, typer.Option(help="picks.csv: u_px,v_px[,edge] of one view.")],
    out: Out,
    view: Annotated[str, typer.Option(help="The view that the picks are of: left or right.")] = "left",
    world: Annotated[Path | None, typer.Option(help="world.yaml. [default: the path is in the rig's axes]")] = None,
    near: Annotated[float | None, typer.Option(help="Nearest depth. [default: 3 baselines]", **quantity("m"))] = None,
    far: Annotated[float | None, typer.Option(help="Furthest depth. [default: 300 baselines]", **quantity("m"))] = None,
    step: Annotated[float, typer.Option("--step-px", help="Between points on an edge, px.")] = 10.0,
    patch: Annotated[int, typer.Option("--patch-px", help="Side of a patch, px.")] = 15,
    pick_std: Annotated[float, typer.Option("--pick-std-px", help="Standard deviation of a pick, px.")] = 0.5,
    tool_axis: Annotated[
        str | None, typer.Option(metavar="X,Y,Z", help="The tool's z. [default: the view's optical axis]")
    ] = None,
    skip: Annotated[bool, typer.Option("--skip", help="Leave out what is not found, instead of refusing all.")] = False,
    json: AsJson = False,
) -> None:
    """Make a path of points and edges picked in one picture, found in the other one, and triangulated."""
    with CommandUI(as_json=json) as face:
        from armsight.app.path.picks import PicksJob, path_from_picks
        from armsight.measure.correspondence import PatchSettings

        job = PicksJob(
            left=left,
            right=right,
            rig=rig,
            picks=picks,
            out=out,
            side=view,
            world=world,
            step_px=step,
            tool_axis=tool_axis,
            skip=skip,
            settings=PatchSettings(half_px=patch // 2, near_m=near, far_m=far, pick_std_px=pick_std),
        )
        done = path_from_picks(job, face.progress("searching"))
        for refused in done.refused:
            face.say(f"  pick {refused.pick} left out: {refused.why}")
        if done.frame == "rig":
            face.say("The path is in the rig's own axes: no arm can take it so. Give --world for one in world or base.")
        face.say(f"{done.n} points, {done.length_m:.4f} m, in {done.frame} axes: {done.file}")
        face.result(done)
