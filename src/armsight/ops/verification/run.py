"""Measurements held against an arm at its joints, or against commands; an earlier run beside them."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from armsight._files import real_path
from armsight.arrays import Array
from armsight.errors import BadFile, Inconsistent, UsageError
from armsight.file_names import ERRORS, VERIFY
from armsight.kinematics import Arm
from armsight.ops.verification.iso import (
    by_name,
    check_unit,
    command_of,
    iso_figures,
    named_paths,
    named_rows,
    uncommanded,
)
from armsight.ops.verification.output import repeats_output, verify_output
from armsight.store import read_table
from armsight.store.atomic import read_bytes
from armsight.store.codec import read_output
from armsight.store.interpret import TableFormat
from armsight.store.rigs import World
from armsight.store.verify_files import CommandedFile, MeasuredFile, read_commanded, read_reported_joints
from armsight.verify import Align, Measured, Repeats, Reported, verify
from armsight.verify.repeats import Command
from armsight.verify.results import ComparedRun, EarlierRun, VerifyResult

MAX_SUMMARY_BYTES = 100_000_000


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Expected:
    """What measurements are held against: the arm, what the controller says, whether that has rotations, the
    commands."""

    arm: Arm | None
    reported: Reported
    turned: bool
    commanded: CommandedFile | None = None


def verified(file: MeasuredFile, expected: Expected | None, how: Align | None, band_m: float | None) -> VerifyResult:
    """Return how measurements differ from what was expected; without that, and where no row has a command, what
    repeats alone tell.

    how: what is laid where it fits best; None: both, of positions the base. Raises UsageError, DataRefused.
    """
    if expected is None:
        return _repeats_alone(file, None, how, band_m)
    measured = file.measured if expected.turned else replace(file.measured, rotation=None)
    commands = expected.commanded
    if commands is not None and by_name(file, commands):
        expected = replace(expected, reported=named_rows(file, commands))
        file = replace(file, notes=(*file.notes, *uncommanded(file, commands)))
        named = _known(expected.reported, measured)
        if not len(named):
            return _repeats_alone(file, commands, how, band_m)
        measured = measured.take(named)
    laid = how or (Align.BOTH if expected.turned else Align.BASE)
    result = verify(expected.arm, expected.reported, measured, laid, pose=_pose(file, measured))
    command = command_of(result, commands, file, expected.turned)
    iso, notes = iso_figures(file, file.measured, command, band_m)
    return verify_output(result, expected.arm, file, iso, notes)


def _known(reported: Reported, measured: Measured) -> NDArray[np.intp]:
    """Return the places of the measured rows whose command is known."""
    if reported.T is None:
        return np.empty(0, dtype=np.intp)
    return np.flatnonzero(np.isfinite(reported.T[measured.rows - 1, 0, 3]))


def _pose(file: MeasuredFile, measured: Measured) -> Array | None:
    return None if file.pose is None else file.pose[np.isin(file.measured.rows, measured.rows)]


def _repeats_alone(
    file: MeasuredFile, commanded: CommandedFile | None, how: Align | None, band_m: float | None
) -> VerifyResult:
    """Return what repeats tell without a command for each row; commanded: the paths that were."""
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
            in_frame=how is Align.NONE,
            paths=named_paths(commanded),
        )
    iso, notes = iso_figures(file, file.measured, command, band_m)
    return repeats_output(file, iso, notes)


def check_usage(
    *,
    arm: object,
    joints: object,
    commanded: object,
    links: tuple[str | None, ...],
    align: str | None,
    band_m: float | None,
    folders: tuple[Path | None, Path | None],
) -> None:
    """Raise UsageError for what means nothing together. links: --tip, --base; folders: --compare, and the result's."""
    if arm is None and any(one is not None for one in links):
        raise UsageError("--tip and --base choose a chain of an arm, and none was given", cure="Give --arm FILE.urdf")
    if commanded is not None and (joints is not None or arm is not None):
        raise UsageError(
            "both a commanded path and an arm were given",
            cure="Give --arm with --joints, or --commanded, and verify twice for both",
        )
    if arm is None and joints is not None:
        raise UsageError("joint readings were given without an arm", cure="Give --arm with the arm they are of")
    if align is not None and align not in set(Align):
        raise UsageError(f"--align {align} is not known", cure=f"Use one of: {', '.join(Align)}")
    if band_m is not None and not (np.isfinite(band_m) and band_m > 0.0):
        raise UsageError(f"--band {band_m:g} is not a positive length", cure="Give the limit band in m: 0.0005")
    compare, out = folders
    if compare is not None and out is not None and real_path(compare) == real_path(out):
        raise UsageError("--compare names the folder that is written to", cure="Give the folder of an earlier run")


def readings_of(arm: Arm, file: MeasuredFile, measured: Path, joints: Path | None, table: TableFormat) -> Expected:
    """Return what the controller says: of its log, or of the measured file's own columns."""
    own = joints is None or Path(joints).absolute() == Path(measured).absolute()  # of one file rows belong together
    found = file.reported if own or joints is None else read_reported_joints(joints, table.of_arm(arm))
    if found is None or found.q is None:
        raise UsageError(
            f"{measured} has no columns q1 .. qn, and no --joints were given",
            cure="Give --joints joints.csv: t_s,q1,...,qn, or q1,...,qn row by row",
        )
    if found.q.shape[1] != arm.n:
        raise Inconsistent(
            f"{joints or measured} has {found.q.shape[1]} joints, {arm.name} has {arm.n}",
            consequence="Nothing is verified",
            cure="Give the file of this arm, with q1 .. qn in the order of its joints",
        )
    return Expected(arm=arm, reported=found.values_of(arm), turned=True)


def commands_of(commanded: Path, table: TableFormat) -> Expected:
    """Return what was commanded."""
    found = read_commanded(commanded, table)
    return Expected(arm=None, reported=found.reported, turned=found.turned, commanded=found)


def file_in_world(file: MeasuredFile, world: World) -> MeasuredFile:
    """Return measurements in a rig's axes, with what their rows share, in those of the rig's parent."""
    return replace(file, measured=in_world(file.measured, world), repeats=_shared_in_world(file.repeats, world))


def in_world(measured: Measured, world: World) -> Measured:
    """Return measurements in a rig's axes in those of the rig's parent."""
    T = world.T_parent_rig
    R = T.rotation.as_matrix()
    turned = np.kron(np.eye(2), R)  # (6, 6)
    covariance = None if measured.covariance is None else turned @ measured.covariance @ turned.T
    rotation = None if measured.rotation is None else R @ measured.rotation
    return replace(measured, xyz_m=T.apply(measured.xyz_m), rotation=rotation, covariance=covariance)


def _shared_in_world(repeats: Repeats, world: World) -> Repeats:
    """Return repeats with the shared part of the covariance in the axes of a rig's parent."""
    if repeats.systematic is None:
        return repeats
    turned = np.kron(np.eye(2), world.T_parent_rig.rotation.as_matrix())
    return replace(repeats, systematic=turned @ repeats.systematic @ turned.T)


def read_run(folder: Path) -> VerifyResult:
    """Return what an earlier run found. Raises BadFile where the folder holds none."""
    path = folder / VERIFY
    held = read_bytes(path, limit=MAX_SUMMARY_BYTES)
    try:
        return read_output(VerifyResult, json.loads(held), path.name)
    except (ValueError, BadFile) as error:
        first = str(error).splitlines()[0]
        raise BadFile(
            f"{path}: not the summary of a verification ({first})",
            consequence="The runs are not compared",
            cure="Give the folder that an earlier `armsight verify -o` wrote",
        ) from error


def beside(done: VerifyResult, folder: Path, other: VerifyResult) -> VerifyResult:
    """Return a result with the earlier run of a folder to stand beside it. Raises BadFile."""
    error_m = None
    if done.verification is not None and other.after is not None:
        columns = _columns(folder / ERRORS)
        rows = read_table(folder / ERRORS, ("row", "error_m"), optional=columns, blank=columns)
        error_m = rows.numbers["error_m"]
    compared = ComparedRun(folder=str(folder), n=other.n, after=other.after, cause=other.cause)
    return replace(done, compared=compared, earlier=EarlierRun(name=str(folder), result=other, error_m=error_m))


def _columns(path: Path) -> tuple[str, ...]:
    first = read_bytes(path, limit=MAX_SUMMARY_BYTES).split(b"\n", 1)[0].decode("utf-8", errors="replace")
    return tuple(name.strip() for name in first.split(",") if name.strip() not in ("row", "error_m"))
