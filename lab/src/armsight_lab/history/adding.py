"""Runs put into the history: those of commands as they end, and results of earlier ones."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

from sqlalchemy import Connection

from armsight.calibrate.cameras.pairing import baseline_std
from armsight.errors import ArmsightError, BadFile, UsageError
from armsight.fields import Doc
from armsight.optics import Rig
from armsight.records.output import Output, keys, output
from armsight.store.arm_file import ARM_YAML, arm_from_mapping
from armsight.store.rigs import RIG_YAML, read_rig
from armsight.store.yamls import read_yaml
from armsight_lab.history import queries
from armsight_lab.history.database import writing
from armsight_lab.history.entry import (
    FORMAT,
    Entry,
    InputFile,
    Quantity,
    cell_name,
    deviation,
    entry_of,
    moment,
    number,
    other_arm,
    read_json,
    utc,
    whole_moment,
)
from armsight_lab.history.figures import Parameters, of_arm, of_cameras, parameters_of, point_named, pose_named
from armsight_lab.history.filing import entry_of_result, hash_of
from armsight_lab.history.place import Place, place_of
from armsight_lab.history.request import AddJob

LEFT_OUT = ("format", "version", "created", "software", "inputs", "covariance")
"""Of a YAML file: what is no figure."""


@output
class AddedOutput(Output):
    """armsight history add."""

    run: Annotated[int, Doc("The run's number.")]
    new: Annotated[bool, Doc("False where the same run was there already.")]
    cell: Annotated[str, Doc("The cell.")]
    command: Annotated[str, Doc("The command that the result is of.")]
    created: Annotated[str, Doc("When the result was made, UTC.")]
    n_figures: Annotated[int, Doc("Numbers of the result that were filed.")]
    n_parameters: Annotated[int, Doc("Calibrated parameters among what was filed, a pose counts six.")]
    notes: Annotated[list[str], Doc("What to know.")]


@dataclass(frozen=True, slots=True, kw_only=True)
class Filed:
    """A run in the history: its number, whether it is new, and what to know."""

    run: int
    new: bool
    notes: list[str]


def added(place: Place, entry: Entry) -> list[str]:
    """File a run; return what to tell the person. Raises UsageError, BadFile, DeviceFailed."""
    done = file_entry(place, entry)
    return [f"Filed as run {done.run} of cell {entry.cell!r} in {place}", *done.notes]


def file_entry(place: Place, entry: Entry) -> Filed:
    """File a run. Raises UsageError, BadFile, DeviceFailed."""
    with writing(place) as connection:
        notes = _notes(connection, entry)
        run, new = queries.add(connection, entry, utc(datetime.now(UTC)))
    if not new:
        return Filed(run=run, new=False, notes=[f"It was filed before, as run {run}: nothing was added."])
    return Filed(run=run, new=True, notes=notes)


def _notes(connection: Connection, entry: Entry) -> list[str]:
    """Return what does not fit with the runs that the cell has."""
    notes = []
    now = utc(datetime.now(UTC))
    latest = next(iter(queries.newest(connection, queries.Filter(cell=entry.cell), 1)), None)
    if latest is not None and latest.created > now:
        notes.append(
            f"Run {latest.id} of this cell is dated {latest.created[:16]} UTC, later than now: the clock was set back "
            "since, or was wrong then. Runs are judged in the order of their dates: set the clock right."
        )
    for other in queries.kinds_of_joints(connection, entry.cell):
        if other_arm(other.joints, entry.joints):
            notes.append(
                f"This arm has {len(entry.joints)} joints ({entry.joints}), that of run {other.id} of the same cell "
                f"{len(other.joints)} ({other.joints}): two arms. Give each arm a cell of its own."
            )
            break
    return notes


def add(job: AddJob) -> AddedOutput:
    """File the result of an earlier run. Raises UsageError, BadFile, DeviceFailed."""
    place = place_of(job.history)
    notes: list[str] = []
    entry = _of_file(job, notes)
    done = file_entry(place, entry)
    if not entry.parameters and not entry.poses:
        notes.append("It holds no calibrated parameter, so it says nothing of a drift of one.")
    return AddedOutput(
        run=done.run,
        new=done.new,
        cell=entry.cell,
        command=entry.command,
        created=entry.created,
        n_figures=len(entry.figures),
        n_parameters=len(entry.parameters) + 6 * len(entry.poses),
        notes=[*notes, *done.notes],
    )


def _of_file(job: AddJob, notes: list[str]) -> Entry:
    if job.result.suffix.lower() in (".yaml", ".yml"):
        return _of_yaml(job, notes)
    content = read_json(job.result)
    if content.get("format") == FORMAT:
        entry = entry_of(content, str(job.result))
        return entry if job.cell is None else replace(entry, cell=_cell(job))
    if "error" in content:
        raise BadFile(f"{job.result}: a refusal, no result", consequence="It is not filed", cure="Give a result")
    command = _command_of(content, job.result)
    arm = None if job.arm_file is None else arm_from_mapping(read_yaml(job.arm_file), str(job.arm_file))
    if command == "calibrate arm" and arm is None:
        notes.append("Joint zeros are in arm.yaml, not in this JSON: give --arm-file arm.yaml, or file that file.")
    return entry_of_result(
        content,
        parameters_of(content, arm if command == "calibrate arm" else None),
        [InputFile(flag="result", path=str(job.result), sha256=hash_of(str(job.result)))],
        command=command,
        cell=_cell(job),
        created=_created(job, None, notes),
    )


def _cell(job: AddJob) -> str:
    if job.cell is None:
        raise UsageError("no cell is named", consequence="Nothing was filed", cure="Give --cell NAME")
    return cell_name(job.cell)


def _created(job: AddJob, held: str | None, notes: list[str]) -> str:
    """Return when a result was made: as the flag says, else as its file says, else when that was written."""
    if job.created is not None:
        return whole_moment(job.created)
    if held is not None:
        return utc(moment(held))
    notes.append("The file does not say when the result was made: it is dated when the file was written.")
    return utc(datetime.fromtimestamp(job.result.stat().st_mtime, UTC))


def _command_of(content: Mapping[str, Any], path: Path) -> str:
    """Return which command prints such an object: that with all its keys and no other. Raises BadFile."""
    for command, kind in _kinds():
        known = keys(kind)
        needed = {key.name for key in known if not key.optional}
        if needed <= set(content) <= {key.name for key in known}:
            return command
    raise BadFile(
        f"{path}: is of no command whose results are filed",
        consequence="It is not filed",
        cure=f"Give a result of {', '.join(sorted({command for command, _ in _kinds()}))}",
    )


def _kinds() -> list[tuple[str, type[Output]]]:
    from armsight.calibrate.arm import ArmResult, RobotWorldResult
    from armsight.calibrate.cameras import CameraCalibration, StereoCalibration
    from armsight.calibrate.cameras.many_result import CamerasCalibration
    from armsight.calibrate.handeye import HandEyeResult
    from armsight.calibrate.identify import Identification
    from armsight.calibrate.mirrors.result import MirrorsOutput
    from armsight.calibrate.tooltip_result import PivotCalibration, ToolTipResult
    from armsight.verify.live import VerifyLiveOutput
    from armsight.verify.results import MasteringOutput, VerifyResult

    return [
        ("calibrate arm", ArmResult),
        ("calibrate camera", CameraCalibration),
        ("calibrate cameras", CamerasCalibration),
        ("calibrate handeye", HandEyeResult),
        ("calibrate mirrors", MirrorsOutput),
        ("calibrate pivot", PivotCalibration),
        ("calibrate robot-world", RobotWorldResult),
        ("calibrate stereo", StereoCalibration),
        ("calibrate tooltip", ToolTipResult),
        ("identify", Identification),
        ("verify", MasteringOutput),
        ("verify", VerifyLiveOutput),
        ("verify", VerifyResult),
    ]


def _of_yaml(job: AddJob, notes: list[str]) -> Entry:
    content = read_yaml(job.result)
    command, found = _calibrated(content, job.result)
    figures = {key: value for key, value in content.items() if key not in LEFT_OUT}
    inputs = content.get("inputs")
    given = [one for one in inputs if isinstance(one, Mapping)] if isinstance(inputs, list) else []
    held = content.get("created")
    read = [
        InputFile(flag=f"input {i}", path=str(one.get("path"))[-1000:], sha256=str(one.get("sha256"))[:64])
        for i, one in enumerate(given, 1)
    ]
    created = _created(job, held if isinstance(held, str) else None, notes)
    entry = entry_of_result(figures, found, read, command=command, cell=_cell(job), created=created)
    return replace(entry, software=str(content.get("software") or "unknown")[:60])


def _calibrated(content: Mapping[str, Any], path: Path) -> tuple[str, Parameters]:
    """Return the command that writes such a file, and what was calibrated. Raises BadFile."""
    format_ = str(content.get("format"))
    stds = _stds(content)
    if format_ == ARM_YAML.format:
        arm = arm_from_mapping(content, str(path))
        return ("identify" if "identif" in arm.source else "calibrate arm"), of_arm(arm)
    if format_ == RIG_YAML.format:
        rig = read_rig(path, any_cameras=True)
        made = "calibrate stereo" if rig.is_pair else "calibrate cameras"
        return ("calibrate mirrors" if str(rig.kind) == "mirror" else made), _of_rig(rig)
    poses = [name for name in ("T_flange_camera", "T_base_camera") if name in content]
    if format_ == "armsight/handeye" and poses:
        return "calibrate handeye", pose_named("handeye", content[poses[0]], stds, "camera.")
    if format_ == "armsight/tip" and "tip_m" in content:
        return "calibrate tooltip", point_named("tip", content["tip_m"], stds, "tip.")
    if format_ == "armsight/world" and "T_base_rig" in content:
        return "calibrate robot-world", pose_named("world", content["T_base_rig"], stds)
    raise BadFile(
        f"{path}: its format is {format_[:60]!r}, of which nothing is filed",
        consequence="It is not filed",
        cure="Give the arm.yaml, rig.yaml, handeye.yaml, tip.yaml or world.yaml of a calibration",
    )


def _stds(content: Mapping[str, Any]) -> dict[str, float]:
    """Return deviations by name of a covariance as files hold it; empty where there is none."""
    held = content.get("covariance")
    if not isinstance(held, Mapping):
        return {}
    variances = {name: number(row[i]) for i, (name, row) in enumerate(zip(held["names"], held["matrix"], strict=True))}
    return {name: float(value**0.5) for name, value in variances.items() if value is not None and value > 0.0}


def _of_rig(rig: Rig) -> Parameters:
    if not rig.is_pair:
        stds = {} if rig.covariance is None else {f"{name}_m": std for name, std in rig.covariance.std().items()}
        return of_cameras({one.name: one.T_rig_camera.translation.tolist() for one in rig.cameras}, stds)
    try:
        std = deviation(baseline_std(rig))
    except (ArmsightError, ValueError, KeyError):
        std = None
    return Parameters(quantities=(Quantity(name="baseline_m", value=rig.baseline_m, std=std, unit="m"),))
