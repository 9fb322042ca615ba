"""Files of measurements and of the arm in; verify.json, errors.csv and report.html out."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from armsight._files import real_path
from armsight.app.arm_files import load_arm
from armsight.app.requests.verify import VerifyJob
from armsight.app.verify.iso import by_name, check_unit, command_of, iso_figures, named_paths, named_rows, uncommanded
from armsight.app.verify.output import errors_csv, repeats_csv, repeats_output, verify_output
from armsight.arrays import Array
from armsight.errors import BadFile, Inconsistent, UsageError
from armsight.file_names import ERRORS, REPORT, VERIFY
from armsight.kinematics import Arm
from armsight.report.verify_pages import repeats_report
from armsight.report.verify_report import OtherRun, verify_report
from armsight.store import read_table, read_world, write_text
from armsight.store.atomic import read_bytes, write_json
from armsight.store.codec import read_output
from armsight.store.rigs import World
from armsight.store.verify_files import CommandedFile, MeasuredFile, read_commanded, read_measured, read_reported_joints
from armsight.verify import Align, Measured, Repeats, Reported, verify
from armsight.verify.repeats import Command
from armsight.verify.results import ComparedRun, VerifyOutput

Other = VerifyOutput | None

MAX_SUMMARY_BYTES = 100_000_000


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Expected:
    """What a job's other files say: the arm, what the controller says, whether that has rotations, the commands."""

    arm: Arm | None
    reported: Reported
    turned: bool
    commanded: CommandedFile | None = None


def run_verify(job: VerifyJob) -> VerifyOutput:
    """Verify; write verify.json, errors.csv and report.html into the job's folder; return the figures.

    Without arm and command, where the file says which repeat each row is of, what the repeats alone tell. Raises
    UsageError, DataRefused.
    """
    _check_usage(job)
    other = None if job.compare is None else read_run(job.compare)
    file = read_measured(job.measured, job.table.of_camera)
    world = None if job.world is None else read_world(job.world)
    if world is not None:
        file = replace(file, measured=in_world(file.measured, world), repeats=shared_in_world(file.repeats, world))
    if job.arm is None and job.commanded is None:
        return _repeats_alone(job, file, None, other)
    expected = _expected(job, file)
    if world is not None and world.parent == "base" and expected.arm is not None:
        expected = replace(expected, arm=expected.arm.based())  # measured in base, and so expected there
    measured = file.measured if expected.turned else replace(file.measured, rotation=None)
    commands = expected.commanded
    if commands is not None and by_name(file, commands):
        expected = replace(expected, reported=named_rows(file, commands))
        file = replace(file, notes=(*file.notes, *uncommanded(file, commands)))
        named = _known(expected.reported, measured)
        if not len(named):
            return _repeats_alone(job, file, commands, other)
        measured = measured.take(named)
    how = _align(job, expected.turned)
    result = verify(expected.arm, expected.reported, measured, how, pose=_pose(file, measured))
    command = command_of(result, commands, file, expected.turned)
    iso, commanded = iso_figures(file, file.measured, command, job.band_m)
    done = _beside(job, verify_output(result, expected.arm, file, iso, commanded), other)
    page = verify_report(result, done, arm=expected.arm, inputs=_inputs(job), other=_other_run(job.compare, other))
    return _written(job, done, errors_csv(result), page)


def _known(reported: Reported, measured: Measured) -> NDArray[np.intp]:
    """Return the places of the measured rows whose command is known."""
    if reported.T is None:
        return np.empty(0, dtype=np.intp)
    return np.flatnonzero(np.isfinite(reported.T[measured.rows - 1, 0, 3]))


def _pose(file: MeasuredFile, measured: Measured) -> Array | None:
    return None if file.pose is None else file.pose[np.isin(file.measured.rows, measured.rows)]


def _repeats_alone(job: VerifyJob, file: MeasuredFile, commanded: CommandedFile | None, other: Other) -> VerifyOutput:
    """Return and write what repeats tell without a command for each row; told: the paths that were commanded."""
    if not file.repeats.any:
        raise UsageError(
            "what the measurements are to be compared with is missing",
            cure="Give --arm with --joints joints.csv, --commanded with the poses that were asked for, or a measured "
            "file with columns pose and visit, or run, for what repeats alone tell",
        )
    check_unit(file.measured)
    command = None
    if commanded is not None:
        command = Command(
            row=np.empty(0, dtype=np.intp),
            T=np.empty((0, 4, 4)),
            turned=commanded.turned,
            in_frame=_align(job, commanded.turned) is Align.NONE,
            paths=named_paths(commanded),
        )
    iso, notes = iso_figures(file, file.measured, command, job.band_m)
    done = _beside(job, repeats_output(file, iso, notes), other)
    beside = None if other is None else (str(job.compare), other)
    page = repeats_report(file.measured, file.repeats, done, other=beside)
    return _written(job, done, repeats_csv(file), page)


def _beside(job: VerifyJob, done: VerifyOutput, other: Other) -> VerifyOutput:
    if other is None:
        return done
    compared = ComparedRun(folder=str(job.compare), n=other.n, after=other.after, cause=other.cause)
    return replace(done, compared=compared)


def _written(job: VerifyJob, done: VerifyOutput, table: str, page: str) -> VerifyOutput:
    write_json(job.out / VERIFY, done.to_dict())
    write_text(job.out / ERRORS, table)
    write_text(job.out / REPORT, page)
    return done


def _check_usage(job: VerifyJob) -> None:
    """Raise UsageError where the job does not say what is expected."""
    if job.commanded is not None and (job.joints is not None or job.arm is not None):
        raise UsageError(
            "both a commanded path and an arm were given",
            cure="Give --arm with --joints, or --commanded, and verify twice for both",
        )
    if job.arm is None and job.joints is not None:
        raise UsageError("joint readings were given without an arm", cure="Give --arm with the arm they are of")
    if job.align is not None and job.align not in set(Align):
        raise UsageError(f"--align {job.align} is not known", cure=f"Use one of: {', '.join(Align)}")
    if job.band_m is not None and not (np.isfinite(job.band_m) and job.band_m > 0.0):
        raise UsageError(f"--band {job.band_m:g} is not a positive length", cure="Give the limit band in m: 0.0005")
    if job.compare is not None and real_path(job.compare) == real_path(job.out):
        raise UsageError("--compare names the folder that is written to", cure="Give the folder of an earlier run")


def _align(job: VerifyJob, turned: bool) -> Align:
    if job.align is not None:
        return Align(job.align)
    if job.world is not None:
        return Align.NONE
    return Align.BOTH if turned else Align.BASE


def _expected(job: VerifyJob, file: MeasuredFile) -> _Expected:
    """Return the arm and what the controller says, or what was commanded."""
    if job.commanded is not None:
        commanded = read_commanded(job.commanded, job.table)
        return _Expected(arm=None, reported=commanded.reported, turned=commanded.turned, commanded=commanded)
    arm = load_arm(job.arm or "")
    names = job.table.of_arm(arm)
    found = file.reported if job.joints is None else read_reported_joints(job.joints, names)
    if found is None or found.q is None:
        raise UsageError(
            f"{job.measured} has no columns q1 .. qn, and no --joints were given",
            cure="Give --joints joints.csv: t_s,q1,...,qn, or q1,...,qn row by row",
        )
    if found.q.shape[1] != arm.n:
        raise Inconsistent(
            f"{job.joints or job.measured} has {found.q.shape[1]} joints, {arm.name} has {arm.n}",
            consequence="Nothing is verified",
            cure="Give the file of this arm, with q1 .. qn in the order of its joints",
        )
    return _Expected(arm=arm, reported=found.values_of(arm), turned=True)


def in_world(measured: Measured, world: World) -> Measured:
    """Return measurements in a rig's axes in those of the rig's parent."""
    T = world.T_parent_rig
    R = T.rotation.as_matrix()
    turned = np.kron(np.eye(2), R)  # (6, 6)
    covariance = None if measured.covariance is None else turned @ measured.covariance @ turned.T
    rotation = None if measured.rotation is None else R @ measured.rotation
    return replace(measured, xyz_m=T.apply(measured.xyz_m), rotation=rotation, covariance=covariance)


def shared_in_world(repeats: Repeats, world: World) -> Repeats:
    """Return repeats with the shared part of the covariance in the axes of a rig's parent."""
    if repeats.systematic is None:
        return repeats
    turned = np.kron(np.eye(2), world.T_parent_rig.rotation.as_matrix())
    return replace(repeats, systematic=turned @ repeats.systematic @ turned.T)


def read_run(folder: Path) -> VerifyOutput:
    """Return what an earlier run found. Raises BadFile where the folder holds none."""
    path = folder / VERIFY
    held = read_bytes(path, limit=MAX_SUMMARY_BYTES)
    try:
        return read_output(VerifyOutput, json.loads(held), path.name)
    except (ValueError, BadFile) as error:
        first = str(error).splitlines()[0]
        raise BadFile(
            f"{path}: not the summary of a verification ({first})",
            consequence="The runs are not compared",
            cure="Give the folder that an earlier `armsight verify -o` wrote",
        ) from error


def _other_run(folder: Path | None, done: VerifyOutput | None) -> OtherRun | None:
    if folder is None or done is None or done.after is None:
        return None
    rows = read_table(
        folder / ERRORS, ("row", "error_m"), optional=_columns(folder / ERRORS), blank=_columns(folder / ERRORS)
    )
    return OtherRun(name=str(folder), summary=done, error_m=rows.numbers["error_m"])


def _columns(path: Path) -> tuple[str, ...]:
    first = read_bytes(path, limit=MAX_SUMMARY_BYTES).split(b"\n", 1)[0].decode("utf-8", errors="replace")
    return tuple(name.strip() for name in first.split(",") if name.strip() not in ("row", "error_m"))


def _inputs(job: VerifyJob) -> list[tuple[str, str]]:
    named = (
        ("measured", job.measured.name),
        ("arm", job.arm),
        ("joints", None if job.joints is None else job.joints.name),
        ("commanded", None if job.commanded is None else job.commanded.name),
        ("world", None if job.world is None else job.world.name),
    )
    return [(what, which) for what, which in named if which is not None]
