"""A path.csv written as a controller's program, checked for its arm before."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from armsight.app.arm_files import load_arm
from armsight.app.kinematics import reading_values
from armsight.app.play.play_job import tipped
from armsight.app.requests.files import ExportJob
from armsight.control.guard import Limits
from armsight.control.paths import (
    PathCheck,
    Program,
    check_path,
    krl,
    program_moves,
    python_module,
    rapid,
    urscript,
    with_approach,
)
from armsight.control.paths.outliers import PathJump, path_jumps
from armsight.control.paths.program import weld_state
from armsight.errors import Inconsistent, UsageError
from armsight.fields import Doc
from armsight.kinematics import Arm, JointType
from armsight.records import TaughtPath
from armsight.records.output import Output, output
from armsight.store.atomic import write_text
from armsight.store.limits_file import read_limits
from armsight.store.path_file import read_path, write_path

PROGRAMS: Mapping[str, Callable[[Program], str]] = MappingProxyType({"urscript": urscript, "krl": krl, "rapid": rapid})
FORMATS = (*PROGRAMS, "csv", "python")
BY_SUFFIX = MappingProxyType({".script": "urscript", ".src": "krl", ".mod": "rapid", ".csv": "csv", ".py": "python"})
TOLD = 3
"""Issues of the check that a refusal tells."""


@output
class PathExportOutput(Output):
    """armsight path export."""

    file: Annotated[str, Doc("The file written.")]
    format: Annotated[str, Doc("urscript, krl, rapid, csv or python.")]
    n: Annotated[int, Doc("Rows written, those of the approach among them.")]
    length_m: Annotated[float, Doc("Length of the path with them, m.")]
    checked: Annotated[bool, Doc("Whether the path was checked for an arm; it is not without --arm.")]
    start_q: Annotated[
        list[float] | None,
        Doc("Readings to which the program goes first, rad; null where it goes there on a straight line."),
    ]


def export_path(job: ExportJob) -> PathExportOutput:
    """Write a path as a program, csv or Python module.

    A program's path is checked for the arm, with its approach, and not written where the arm cannot run it; without an
    arm it is not checked. Raises Inconsistent with what is wrong, UsageError, BadFile, NotEnoughData.
    """
    kind = _format(job)
    path = read_path(job.source, parent=job.parent)
    if kind not in PROGRAMS:
        return _as_it_is(job, path, kind)
    _require_tags(job, path)
    arm = _arm(job)
    jumps = path_jumps(path)
    path = with_approach(_in_base(path, arm), job.approach_m)
    stops = (1, len(path) - 2) if job.approach_m > 0.0 else ()  # a blend would cut the path's ends off
    moves = program_moves(path, speed_m_s=job.speed_m_s, blend_m=job.blend_m, stops=stops)
    found = None if arm is None else _checked(job, path, arm, jumps)
    start = None if arm is None or found is None else _start(arm, found)
    program = Program(
        name=job.out.stem if job.name is None else job.name,
        moves=moves,
        acceleration_m_s2=job.acceleration_m_s2,
        turn_rad_s=job.turn_rad_s,
        start=start,
        tool=job.tool,
        T_flange_tool=None if arm is None else arm.T_flange_tool,
        weld_output=job.weld_output,
    )
    write_text(job.out, PROGRAMS[kind](program))
    return PathExportOutput(
        file=str(job.out),
        format=kind,
        n=len(path),
        length_m=float(path.length_m[-1]),
        checked=found is not None,
        start_q=None if start is None else start.tolist(),
    )


def _format(job: ExportJob) -> str:
    kind = BY_SUFFIX.get(job.out.suffix.lower()) if job.to is None else job.to
    if kind not in FORMATS:
        raise UsageError(
            f"{job.out.name if job.to is None else job.to!r} is no kind of program that is known",
            consequence="Nothing is written",
            cure=f"Use --to {', '.join(FORMATS)}, or one of the endings {', '.join(BY_SUFFIX)}",
        )
    return kind


def _require_tags(job: ExportJob, path: TaughtPath) -> None:
    if job.weld_output is not None and all(weld_state(tag) is None for tag in path.tags):
        raise UsageError(
            f"a weld output is given, and no row of {job.source.name} is tagged weld_on or weld_off",
            consequence="No program is written: it would never weld",
            cure="Tag the rows where the seam begins and ends (column tag), or omit --weld-output",
        )


def _arm(job: ExportJob) -> Arm | None:
    if job.arm is not None:
        return tipped(load_arm(job.arm), job.tip)
    if job.tip is not None:
        raise UsageError(
            "a tip is given, and no arm that carries it",
            consequence="No program is written",
            cure="Give the arm too (--arm)",
        )
    return None


def _as_it_is(job: ExportJob, path: TaughtPath, kind: str) -> PathExportOutput:
    if kind == "csv":
        write_path(job.out, path)
    else:
        write_text(job.out, python_module(path))
    return PathExportOutput(
        file=str(job.out), format=kind, n=len(path), length_m=float(path.length_m[-1]), checked=False, start_q=None
    )


def _in_base(path: TaughtPath, arm: Arm | None) -> TaughtPath:
    if path.parent != "world":
        return path
    if arm is None:
        raise UsageError(
            "the path is in world, and nobody can tell where the robot's base is there",
            consequence="No program is written",
            cure="Give the arm (--arm), whose file says it, or --frame base where the path is in base",
        )
    T = arm.T_world_base.inv().as_matrix() @ path.T_world_tip
    return replace(path, T_world_tip=T, parent="base")


def _checked(job: ExportJob, path: TaughtPath, arm: Arm, jumps: tuple[PathJump, ...]) -> PathCheck:
    if jumps:
        raise Inconsistent(jumps[0].text, consequence="No program is written", cure=jumps[0].cure)
    limits = Limits() if job.limits is None else read_limits(job.limits)
    first = None if job.start is None else reading_values(arm, job.start)
    found = check_path(path, arm, limits, speed_m_s=job.speed_m_s, start=first, taught=False)
    if found.issues or not found.ok:  # another controller slows down in its own way, or not
        text = "; ".join(issue.text for issue in found.issues[:TOLD])
        more = f"; and {len(found.issues) - TOLD} more" if len(found.issues) > TOLD else ""
        raise Inconsistent(
            f"{arm.name} cannot run the program, whose row 0 is its approach: {text}{more}",
            consequence="No program is written",
            cure="Change the path, its speeds, the limits or the approach; `armsight path check` tells all",
        )
    return found


def _start(arm: Arm, found: PathCheck) -> NDArray[np.float64] | None:
    """Return the readings (6,) at the first row; None for arms that these controllers have no joint motion for."""
    six = arm.n == 6 and all(joint.type is JointType.REVOLUTE for joint in arm.joints)
    return np.asarray(found.q[0]) if six else None
