"""armsight path."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

import typer

from armsight.app import requests
from armsight.cli.command import command, path
from armsight.cli.command_ui import CommandUI
from armsight.cli.kinematics import ArmFile
from armsight.fields import Doc, Flag
from armsight.units import DEG, MM

if TYPE_CHECKING:
    from armsight.app.path.tools import PathChangeOutput

NOT_OK = 3
Source: TypeAlias = "requests.files.PathFile"
Out: TypeAlias = "requests.files.PathOut"


def _say(face: CommandUI, done: PathChangeOutput) -> None:
    face.say(f"{done.n} rows (of {done.n_before}), {done.length_m:.4f} m: {done.file}")
    face.result(done)


@command(path)
def smooth(face: CommandUI, job: requests.files.SmoothJob) -> None:
    """Take the noise out, within a bound. Corners stay; outliers are named."""
    from armsight.app.path.tools import smooth as run

    done = run(job.source, job.out, bound_m=job.bound_m, bound_rad=job.bound_rad, on_outliers=job.on_outliers)
    for outlier in done.outliers:
        face.say(f"  {outlier.text}{'; left out' if done.dropped else ''}")
    face.say(f"moved by {done.moved_rms_m / MM:.3g} mm RMS, {done.moved_max_m / MM:.3g} mm at most")
    _say(face, done)


@command(path)
def resample(
    face: CommandUI,
    source: Source,
    out: Out,
    step_m: Annotated[float, Doc("Rows are at most so far apart, m.")],
    spline: Annotated[bool, Doc("On splines between corners, not on lines.")] = False,
) -> None:
    """Spread rows evenly by length. Ends, corners and tagged rows stay."""
    from armsight.app.path.tools import resample as run

    _say(face, run(source, out, step_m=step_m, spline=spline))


@command(path)
def fillet(face: CommandUI, source: Source, out: Out, radius_m: Annotated[float, Doc("Of the arcs, m.")]) -> None:
    """Round the corners to arcs."""
    from armsight.app.path.tools import fillet as run

    _say(face, run(source, out, radius_m=radius_m))


@command(path)
def offset(
    face: CommandUI,
    source: Source,
    out: Out,
    by_m: Annotated[float, Doc("Along the tool's z axis, m; negative: back from the work.")],
) -> None:
    """Move the path along the tool's own axis."""
    from armsight.app.path.tools import offset as run

    _say(face, run(source, out, by_m=by_m))


@command(path)
def angle(
    face: CommandUI,
    source: Source,
    out: Out,
    travel_rad: Annotated[float, Doc("Toward the direction of travel, degrees; negative drags."), Flag(unit=DEG)] = 0.0,
    work_rad: Annotated[float, Doc("About the direction of travel, degrees."), Flag(unit=DEG)] = 0.0,
) -> None:
    """Tilt the tool about its tip, as a torch is held."""
    from armsight.app.path.tools import angle as run

    _say(face, run(source, out, travel_rad=travel_rad, work_rad=work_rad))


@command(path)
def reverse(face: CommandUI, source: Source, out: Out) -> None:
    """Turn the path round; the same stretches are welded."""
    from armsight.app.path.tools import reverse as run

    _say(face, run(source, out))


@command(path)
def join(face: CommandUI, job: requests.files.JoinPathsJob) -> None:
    """Put paths one after the other."""
    from armsight.app.path.tools import join as run

    _say(face, run(job.sources, job.out, gap_m=job.gap_m, gap_rad=job.gap_rad))


@command(path)
def check(
    face: CommandUI,
    *,
    source: Source,
    arm: ArmFile,
    out: Annotated[Path | None, Doc("A page with the picture of it, .html."), Flag("-o --out")] = None,
    tip: requests.files.ToolTip = None,
    limits: Annotated[Path | None, Doc("limits.yaml of the guard. [default: its own]")] = None,
    parent: Annotated[str, Doc("Frame of the path: world or base."), Flag("--frame")] = "world",
    speed_m_s: Annotated[float | None, Doc("Where the path leaves it open, m/s. [default: the limits']")] = None,
    start: Annotated[str | None, Doc("Where the arm stands: readings as 0,-1.2,0.4, or a joints.csv.")] = None,
) -> None:
    """Tell before any motion whether an arm can run the whole path. Exit code 3 where it cannot."""
    from armsight.app.path.check import check as run

    done = run(source, arm, tip=tip, limits=limits, parent=parent, speed_m_s=speed_m_s, start=start, out=out)
    for issue in done.issues[:20]:
        face.say(f"  {issue.text}")
    if len(done.issues) > 20:
        face.say(f"  ... and {len(done.issues) - 20} more")
    verdict = "can run the path" if done.ok else f"cannot run the path as it is ({done.refused})"
    if done.ok and done.issues:
        verdict += ", slower than asked where that is told"
    face.say(f"{done.arm} {verdict}: {done.n_reached} of {done.n} rows reached, {done.duration_s:.2f} s")
    face.result(done)
    if not done.ok:
        raise typer.Exit(NOT_OK)


@command(path)
def export(face: CommandUI, job: requests.files.ExportJob) -> None:
    """Write the path as a controller's program (Universal Robots, KUKA, ABB), as CSV, or as a Python module."""
    from armsight.app.path.export import export_path

    done = export_path(job)
    checked = "checked for the arm" if done.checked else "not checked for any arm"
    face.say(f"{done.n} rows, {done.length_m:.4f} m, {checked}: {done.file}")
    face.result(done)


@command(path)
def from_picks(face: CommandUI, job: requests.files.PicksJob) -> None:
    """Make a path of points and edges picked in one picture, found in the other one, and triangulated."""
    from armsight.app.path.picks import path_from_picks

    done = path_from_picks(job, face.progress("searching"))
    for refused in done.refused:
        face.say(f"  pick {refused.pick} left out: {refused.why}")
    if done.frame == "rig":
        face.say("The path is in the rig's own axes: no arm can take it so. Give --world for one in world or base.")
    face.say(f"{done.n} points, {done.length_m:.4f} m, in {done.frame} axes: {done.file}")
    face.result(done)
