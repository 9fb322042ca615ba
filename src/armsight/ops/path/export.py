"""A taught path as a controller's program, checked for its arm before."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Annotated

import numpy as np

from armsight.arrays import Array
from armsight.control.guard import Limits
from armsight.control.guard.limits import joint_bounds
from armsight.control.paths import PathCheck, Program, check_path, krl, python_module, rapid, urscript, with_approach
from armsight.control.paths.exports import gcode
from armsight.control.paths.linuxcnc import Axes, plan_lines, require_genserkins, require_kept
from armsight.control.paths.outliers import path_jumps
from armsight.control.paths.program import ProgramMove, weld_state
from armsight.errors import Inconsistent, UsageError
from armsight.fields import Doc
from armsight.kinematics import Arm, JointType
from armsight.ops.path.check import with_tip
from armsight.records import TaughtPath
from armsight.records.output import Output, output
from armsight.shown import Shown, Table
from armsight.store.atomic import TextOutput
from armsight.store.path_file import path_text
from armsight.units import DEG, MM

PROGRAMS: Mapping[str, Callable[[Program], str]] = MappingProxyType({"urscript": urscript, "krl": krl, "rapid": rapid})
AS_IT_IS: Mapping[str, Callable[[TaughtPath], str]] = MappingProxyType({"csv": path_text, "python": python_module})
LINUXCNC = "linuxcnc"
FORMATS = (*PROGRAMS, LINUXCNC, *AS_IT_IS)
BY_SUFFIX = MappingProxyType(
    {".script": "urscript", ".src": "krl", ".mod": "rapid", ".ngc": LINUXCNC, ".csv": "csv", ".py": "python"}
)
TURN_RAD_S = math.pi / 3.0
"""Of a program's motions in which the tool turns about its tip."""
TOLD = 3
"""Issues of the check that a refusal tells."""


@output
class JointPlanned(Output):
    """What a joint will do where a controller keeps only the limits of its axes."""

    name: Annotated[str, Doc("The joint.")]
    speed: Annotated[float, Doc("Its largest speed.", unit="rad/s")]
    speed_limit: Annotated[float, Doc("What is allowed.", unit="rad/s")]
    acceleration: Annotated[float, Doc("Its largest acceleration.", unit="rad/s^2")]
    acceleration_limit: Annotated[float, Doc("What is allowed.", unit="rad/s^2")]


@output
class PathExportOutput(TextOutput):
    """armsight path export."""

    file: Annotated[str, Doc("The file written.")]
    format: Annotated[str, Doc("urscript, krl, rapid, linuxcnc, csv or python.")]
    n: Annotated[int, Doc("Rows written, those of the approach among them.")]
    length_m: Annotated[float, Doc("Length of the path with them, m.")]
    checked: Annotated[bool, Doc("Whether the path was checked for an arm; it is not without --arm.")]
    start_q: Annotated[
        list[float] | None,
        Doc(
            "Readings to which the program goes first, rad; null where it goes there on a straight line. Of LinuxCNC: "
            "at which the arm has to stand."
        ),
    ]
    duration_s: Annotated[float | None, Doc("How long LinuxCNC will take, s; null for others.")] = None
    off_m: Annotated[float | None, Doc("How far its tip will be from the path at most, m.")] = None
    joints: Annotated[
        list[JointPlanned] | None, Doc("What its joints will do, whose limits LinuxCNC does not keep.")
    ] = None

    def summary(self) -> Iterator[Shown]:
        """Yield what a terminal shows of it."""
        checked = "checked for the arm" if self.checked else "not checked for any arm"
        yield f"{self.n} rows, {self.length_m:.4f} m, {checked}: {self.file}"
        if self.joints is None or self.duration_s is None or self.off_m is None or self.start_q is None:
            return
        yield (
            f"LinuxCNC will take {self.duration_s:.2f} s, the tip at most {self.off_m / MM:.3f} mm from the path; it "
            f"begins where the joints stand at {', '.join(f'{q / DEG:.2f}' for q in self.start_q)} deg alone"
        )
        columns = ["joint", "deg/s", "allowed", "deg/s^2", "allowed"]
        rows = [
            [
                joint.name,
                *(f"{value / DEG:.1f}" for value in (joint.speed, joint.speed_limit)),
                *(f"{value / DEG:.0f}" for value in (joint.acceleration, joint.acceleration_limit)),
            ]
            for joint in self.joints
        ]
        yield Table("What the joints will do, whose limits LinuxCNC does not keep", columns, rows)


def exported(
    file: Path, kind: str, path: TaughtPath, content: str, *, found: PathCheck | None = None, start: Array | None = None
) -> PathExportOutput:
    """Return what is told of a file of this content, made of a path; found: its check for an arm, start: readings."""
    return PathExportOutput(
        file=str(file),
        format=kind,
        n=len(path),
        length_m=float(path.length_m[-1]),
        checked=found is not None,
        start_q=None if start is None else start.tolist(),
        content=content,
    )


def format_of(out: Path, to: str | None) -> str:
    """Return which kind of program a file is to be, by its ending where `to` says none. Raises UsageError."""
    kind = BY_SUFFIX.get(out.suffix.lower()) if to is None else to
    if kind not in FORMATS:
        raise UsageError(
            f"{out.name if to is None else to!r} is no kind of program that is known",
            consequence="Nothing is written",
            cure=f"Use --to {', '.join(FORMATS)}, or one of the endings {', '.join(BY_SUFFIX)}",
        )
    return kind


def require_tags(where: str, path: TaughtPath, weld_output: str | None) -> None:
    """Raise UsageError for an output that no row would switch."""
    if weld_output is not None and all(weld_state(tag) is None for tag in path.tags):
        raise UsageError(
            f"a weld output is given, and no row of {Path(where).name} is tagged weld_on or weld_off",
            consequence="No program is written: it would never weld",
            cure="Tag the rows where the seam begins and ends (column tag), or omit --weld-output",
        )


def carrier_of(arm: Arm | None, tip_m: Array | None) -> Arm | None:
    """Return the arm with its tool's tip. Raises UsageError for a tip without an arm."""
    if arm is None and tip_m is not None:
        raise UsageError(
            "a tip is given, and no arm that carries it",
            consequence="No program is written",
            cure="Give the arm too (--arm)",
        )
    return arm if arm is None or tip_m is None else with_tip(arm, tip_m)


def with_ends(path: TaughtPath, arm: Arm | None, approach_m: float) -> TaughtPath:
    """Return the path in base, with its approach and retreat. Raises UsageError where the base is not known."""
    if path.parent == "world":
        if arm is None:
            raise UsageError(
                "the path is in world, and nobody can tell where the robot's base is there",
                consequence="No program is written",
                cure="Give the arm (--arm), whose file says it, or --frame base where the path is in base",
            )
        T = arm.T_world_base.inv().as_matrix() @ path.T_world_tip
        path = replace(path, T_world_tip=T, parent="base")
    return with_approach(path, approach_m)


def refuse_jumps(path: TaughtPath) -> None:
    """Raise Inconsistent for a path with a jump."""
    for jump in path_jumps(path):
        raise Inconsistent(jump.text, consequence="No program is written", cure=jump.cure)


def checked_run(
    path: TaughtPath, arm: Arm, limits: Limits | None, *, speed_m_s: float | None, start: Array | None
) -> PathCheck:
    """Return the check of a path with its approach. Raises Inconsistent where the arm cannot run it."""
    found = check_path(path, arm, limits or Limits(), speed_m_s=speed_m_s, start=start, taught=False)
    if found.issues or not found.ok:  # another controller slows down in its own way, or not
        text = "; ".join(issue.text for issue in found.issues[:TOLD])
        more = f"; and {len(found.issues) - TOLD} more" if len(found.issues) > TOLD else ""
        raise Inconsistent(
            f"{arm.name} cannot run the program, whose row 0 is its approach: {text}{more}",
            consequence="No program is written",
            cure="Change the path, its speeds, the limits or the approach; `armsight path check` tells all",
        )
    return found


def start_of(arm: Arm, found: PathCheck) -> Array | None:
    """Return the readings (6,) at the first row; None for arms that these controllers have no joint motion for."""
    six = arm.n == 6 and all(joint.type is JointType.REVOLUTE for joint in arm.joints)
    return np.asarray(found.q[0]) if six else None


def for_linuxcnc(
    file: Path,
    name: str,
    run: TaughtPath,
    moves: Sequence[ProgramMove],
    found: PathCheck | None,
    arm: Arm | None,
    controller: Arm | None,
    limits: Limits | None,
    axes: Axes,
    weld_output: str | None,
) -> PathExportOutput:
    """Return a path as G-code that LinuxCNC runs within the joints' limits, which it does not keep itself.

    controller: the arm that its genserkins is set to, where it is not the (calibrated) one that the path is planned
    for. Raises UsageError without an arm or for one that genserkins is none of, Inconsistent where a joint's limit
    would be passed, or the way led over another branch.
    """
    if arm is None or found is None:
        raise UsageError(
            "LinuxCNC takes poses of the flange in the first frame of the arm's table, and no arm is given",
            consequence="Where its joints would go is not known, and no program is written",
            cure="Give the arm (--arm), and what its joints may (--limits)",
        )
    kept, model = limits or Limits(), require_genserkins(controller or arm)
    bounds = joint_bounds(arm, kept)
    plan = plan_lines(moves, arm, model, axes, found.q[0], TURN_RAD_S)
    require_kept(plan, arm, bounds, kept.singularity)
    content = gcode(name, plan, model, axes, bounds, weld_output)
    joints = [
        JointPlanned(
            name=joint.name,
            speed=float(plan.speed[j]),
            speed_limit=float(bounds.speed[j]),
            acceleration=float(plan.acceleration[j]),
            acceleration_limit=float(bounds.acceleration[j]),
        )
        for j, joint in enumerate(arm.joints)
    ]
    done = exported(file, LINUXCNC, run, content, found=found, start=plan.q[0])
    return replace(done, duration_s=float(plan.t_s[-1]), off_m=plan.off_m, joints=joints)
