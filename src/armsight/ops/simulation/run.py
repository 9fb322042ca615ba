"""A simulated cell's frames and truth as files."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Protocol, cast

import numpy as np

from armsight.calibrate.handeye import Setup
from armsight.drivers import CELLS, SETS, known, load
from armsight.errors import Cancelled, UsageError
from armsight.fields import Doc
from armsight.ops.simulation.cells import SIDES, CellPairs, load_cell, room_choice, write_cell_files, write_png
from armsight.ops.simulation.scenarios import build_world, load_scenario, scenario_names, settled_text, with_arm
from armsight.records import Frame, Motion, Progress, Silent
from armsight.records.output import Output, output
from armsight.shown import Shown
from armsight.store import rig_from_mapping, target_from_mapping, write_rig, write_target, write_text
from armsight.store.arm_file import ARM_YAML, arm_from_mapping, write_arm
from armsight.store.covariances import POSE_COLUMNS
from armsight.store.handeye_file import write_handeye_poses
from armsight.store.rigs import CAMERA_YAML, RIG_YAML, World, write_world
from armsight.store.schema import write_document
from armsight.store.tables import cells, number
from armsight.store.targets import TARGET_YAML
from armsight.store.tracks import write_joints
from armsight.store.yamls import dump_yaml

CELL_FRAMES = 100
"""Frames of a built-in cell without a scenario file, where the caller does not say."""


@output
class SimulateOutput(Output):
    """armsight simulate."""

    scenario: Annotated[str, Doc("The scenario's or cell's name.")]
    seed: Annotated[int, Doc("The seed, which gives the same run again.")]
    n_frames: Annotated[int, Doc("Frames of each view written.")]
    n_dropped: Annotated[int | None, Doc("Frames left out by the scenario's faults.")] = None
    views: Annotated[list[str] | None, Doc("The views: the cameras' names, or image.")] = None
    out: Annotated[str, Doc("The folder.")]
    commands: Annotated[list[str] | None, Doc("What reads the set, run in its folder.")] = None

    def summary(self) -> Iterator[Shown]:
        """Yield what a terminal shows of it."""
        if self.commands is None:
            yield f"{self.n_frames} frames of each view and the truth are in {self.out}"
            return
        pictures = f"{self.n_frames} pictures, tables" if self.n_frames else "tables"
        yield f"{pictures} and the truth are in {self.out}; in that folder, try:"
        yield from (f"  {command}" for command in self.commands)


def simulate(
    scenario: str,
    out: Path,
    *,
    seed: int | None = None,
    frames: int | None = None,
    room: str | None = None,
    zoom: float | None = None,
    arm: str | None = None,
    home: str | None = None,
    progress: Progress | None = None,
) -> SimulateOutput:
    """Simulate a scenario, by name or file, a built-in cell, or a set for one calibration, into the folder out.

    Writes left/*.png and right/*.png (image/*.png for a mirror rig), rig.yaml, target.yaml, times.csv, truth.csv and
    scenario.yaml; of a scenario with a robot also arm.yaml (nominal, the target or rig as its tool), arm_true.yaml,
    joints.csv (encoders), truth_world.csv, handeye.yaml and world.yaml (of a fixed rig), true both, and
    sweep_joints.csv (of sweeps); of other cameras than left and right a folder each, and truth_lights.csv, which light
    each sees, or what hides it. seed, frames
    and room (a name, or a picture's path) default to the scenario's own. Raises DeviceNotFound for an unknown scenario,
    UsageError for an unknown room; zoom: of the zoom lenses of the scenario, or of those that a cell's cameras then
    get. arm, home: as with_arm takes them; UsageError for a cell or set. BadFile for what cannot be, DeviceFailed where
    the disk refuses, Cancelled.
    """
    progress = progress or Silent()
    require_arm(scenario, arm, home)
    if scenario in known(CELLS) and scenario not in scenario_names():
        return _simulate_cell(scenario, out, 1 if seed is None else seed, frames or CELL_FRAMES, room, zoom, progress)
    if scenario in known(SETS):
        require_own(scenario, room, zoom)
        return simulate_set(scenario, out, seed=1 if seed is None else seed, size=frames, progress=progress)
    model, text = load_scenario(scenario) if arm is None else with_arm(scenario, arm, home)
    chosen = None if room is None else room_choice(room)
    world = build_world(scenario, model, seed=seed, frames=frames, room=chosen, zoom=zoom)
    settled = settled_text(text, seed=world.seed, frames=world.n_frames, room=chosen, zoom=zoom)
    write_text(out / "scenario.yaml", settled)
    write_world_files(world, out)
    done = _write_frames(world, out, progress)
    return SimulateOutput(
        scenario=model.name,
        seed=world.seed,
        n_frames=done,
        n_dropped=world.n_frames - len(world.kept),
        views=list(world.views),
        out=str(out),
    )


def write_world_files(world: Any, out: Path, *, frames: int | None = None) -> None:
    """Write what is known of a world besides its frames; frames: of so many of them only, from the first."""
    truth, kept = world.truth[:frames], world.kept[:frames]
    write_set_up(world, out)
    _write_arm(world, world.true, out / "arm_true.yaml")
    _write_truth(out / "truth.csv", truth)
    _write_truth(out / "truth_world.csv", world.world_truth[:frames])
    write_text(out / "times.csv", "\n".join(["t_s", *(number(t_s) for t_s, _, _ in truth)]) + "\n")
    readings = [one for one in world.joints if frames is None or one[0] <= truth[-1][0] + 1e-9]
    if readings:
        motion = Motion(t_s=np.array([t_s for t_s, _ in readings]), q=np.array([q for _, q in readings]))
        write_joints(out / "joints.csv", motion)
    if world.T_base_rig is not None:
        T_world_rig = world.true.T_world_base * world.T_base_rig
        write_world(out / "world.yaml", World(parent="world", T_parent_rig=T_world_rig))
    if world.views != SIDES and "image" not in world.views:
        _write_sights(out / "truth_lights.csv", world, kept)
    if world.sweeps:
        n = world.nominal.n
        row_of = {index: row for row, index in enumerate(kept)}
        rows = [
            f"{row_of[frame]},{joint},{cells(world.servo.read(frame / world.fps)[0])}"
            for frame, joint in world.sweeps
            if frame in row_of
        ]
        header = ",".join(["frame", "joint", *(f"q{i + 1}" for i in range(n))])
        write_text(out / "sweep_joints.csv", "\n".join([header, *rows]) + "\n")


def _write_sights(path: Path, world: Any, kept: Sequence[int]) -> None:
    """Write where every light is before every camera, and what hides it; of a pair no such table is written."""
    rows = ["t_s,camera,light,u_px,v_px,hidden_by"]
    for index in kept:
        for one in world.sights(index):
            place = cells(one.uv_px) if np.isfinite(one.uv_px).all() else ","
            rows.append(f"{number(one.t_s)},{one.camera},{one.light},{place},{one.hidden_by}")
    write_text(path, "\n".join(rows) + "\n")


def write_set_up(world: Any, out: Path) -> None:
    """Write what a person who set the cell up would know: rig, target, arm and hand-eye."""
    write_rig(out / "rig.yaml", rig_from_mapping(world.rig, f"{world.name}'s rig"))
    write_target(out / "target.yaml", target_from_mapping(world.target, f"{world.name}'s target"))
    _write_arm(world, world.nominal, out / "arm.yaml")
    _write_handeye(world, out)


def _write_arm(world: Any, arm: Any, file: Path) -> None:
    content = {"format": "armsight/arm", "version": 1, **arm.mapping(world.T_flange_tool)}
    write_arm(file, arm_from_mapping(content, f"{world.name}'s arm"))


def _write_handeye(world: Any, out: Path) -> None:
    """Write where the rig truly is, on the flange or on the base, as a hand-eye calibration would tell it."""
    if world.T_flange_rig is not None:
        T_base_target = world.true.T_world_base.inv() * world.target_path(np.zeros(1))[0]
        write_handeye_poses(out / "handeye.yaml", Setup.EYE_IN_HAND, world.T_flange_rig, T_base_target)
    elif world.T_base_rig is not None:
        write_handeye_poses(out / "handeye.yaml", Setup.EYE_TO_HAND, world.T_base_rig, world.T_flange_tool)


def _write_truth(path: Path, truth: Any) -> None:
    rows = []
    for t_s, xyz_m, quat_xyzw in truth:
        rows.append(f"{number(t_s)},{cells(xyz_m)},{cells(quat_xyzw)},,,,,,,ok,")
    write_text(path, "\n".join([",".join(POSE_COLUMNS), *rows]) + "\n")


def _simulate_cell(
    name: str, out: Path, seed: int, frames: int, room: str | None, zoom: float | None, progress: Progress
) -> SimulateOutput:
    cell = load_cell(name, seed=seed, frames=frames, room=room, zoom=zoom)
    write_cell_files(cell, out, seed=seed, frames=frames)
    done = 0
    with CellPairs(cell, frames, folder=out) as pairs:
        for _ in pairs:
            done += 1
            progress.update(done, frames)
            if progress.cancelled():
                write_cell_files(cell, out, seed=seed, frames=frames, kept=done)
                raise Cancelled(f"stopped after {done} pairs", consequence=f"They and their tables are in {out}")
    return SimulateOutput(scenario=name, seed=seed, n_frames=done, out=str(out))


Documents = Mapping[str, Mapping[str, Any]]


class Dataset(Protocol):
    """What a simulated set offers (entry points armsight.sets: (seed, size) -> Dataset): contents by file name."""

    name: str
    commands: Sequence[str]
    assumptions: Sequence[str]
    rigs: Documents
    cameras: Documents
    targets: Documents
    arms: Documents
    truths: Documents
    tables: Mapping[str, tuple[Sequence[str], Sequence[Sequence[float | str]]]]
    n_images: int
    images: Callable[[], Iterator[tuple[str, Frame]]]


def simulate_set(name: str, out: Path, *, seed: int, size: int | None, progress: Progress) -> SimulateOutput:
    """Write a set's pictures, tables and truth into the folder out.

    size: how many pictures or rows, where not the set's own. Raises UsageError for too few, DeviceFailed where the disk
    refuses, Cancelled between two pictures, before any of the tables is there.
    """
    made = cast(Dataset, load(SETS, name)(seed, size))
    done, folders = 0, set()
    for done, (path, frame) in enumerate(made.images(), start=1):
        file = out / f"{path}.png"
        file.parent.mkdir(parents=True, exist_ok=True)
        folders.add(file.parent.name)
        write_png(file, frame)
        progress.update(done, made.n_images)
        if progress.cancelled():
            raise Cancelled(f"stopped after {done} pictures", consequence=f"They are in {out}, and no tables")
    _write_files(made, out, seed)
    return SimulateOutput(
        scenario=made.name,
        seed=seed,
        n_frames=done,
        views=sorted(folders) or None,
        out=str(out),
        commands=list(made.commands),
    )


def _write_frames(world: Any, out: Path, progress: Progress) -> int:
    """Write the frames of a world and return how many. Raises Cancelled, with the tables of those until then."""
    for view in world.views:
        (out / view).mkdir(parents=True, exist_ok=True)
    done, total = 0, len(world.kept)
    for done, seen in enumerate(world.frames(), start=1):
        for view, frame in zip(world.views, seen, strict=True):
            write_png(out / view / f"{frame.sequence:06d}.png", frame)
        progress.update(done, total)
        if progress.cancelled():
            write_world_files(world, out, frames=done)
            raise Cancelled(f"stopped after {done} frames", consequence=f"They and their tables are in {out}")
    return done


def require_arm(scenario: str, arm: str | None, home: str | None) -> None:
    """Raise UsageError for another arm in what has none, and for a home position without an arm."""
    alone = scenario not in scenario_names() and (scenario in known(CELLS) or scenario in known(SETS))
    if (home is not None and arm is None) or (alone and arm is not None):
        raise UsageError(
            f"{scenario} has no arm that could be another" if alone else "a home position is given, and no arm",
            consequence="Nothing is simulated",
            cure="Give --arm with a scenario whose cameras stand beside an arm, such as webcam-cell",
        )


def require_own(name: str, room: str | None, zoom: float | None) -> None:
    """Raise UsageError where a room or a zoom is asked for."""
    if room is not None or zoom is not None:
        raise UsageError(f"the set {name} has a room and lenses of its own", cure="Leave --room and --zoom away")


def _write_files(made: Dataset, out: Path, seed: int) -> None:
    kinds = (
        (RIG_YAML.format, made.rigs),
        (CAMERA_YAML.format, made.cameras),
        (TARGET_YAML.format, made.targets),
        (ARM_YAML.format, made.arms),
    )
    for format_, documents in kinds:
        for file, content in documents.items():
            write_document(out / file, format_, content, [])
    for file, content in made.truths.items():
        write_text(out / file, dump_yaml(dict(content)))
    for file, (columns, rows) in made.tables.items():
        lines = [",".join(cell if isinstance(cell, str) else number(cell) for cell in row) for row in rows]
        write_text(out / file, "\n".join([",".join(columns), *lines]) + "\n")
    scenario = {
        "format": "armsight/scenario",
        "version": 1,
        "name": made.name,
        "seed": seed,
        "assumptions": list(made.assumptions),
    }
    write_text(out / "scenario.yaml", dump_yaml(scenario))
