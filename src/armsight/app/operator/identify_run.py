"""An arm identified from the page: one light of the target is the beacon, the station sees it, the operator enables."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.app.live.station import MeasurementProcess
from armsight.app.operator.job_runner import BackgroundJob, SessionRobot
from armsight.app.operator.robot_cell import RobotCell, read_placement
from armsight.app.operator.station_observer import StationObserver
from armsight.arrays import Array
from armsight.calibrate.identify import Identification
from armsight.calibrate.identify.result import PlanOutput, ProposedPlanOutput
from armsight.clock import Clock, SystemClock
from armsight.columns import DH_ROW
from armsight.control.joint_sweep import Pace
from armsight.errors import NotEnoughData, UsageError
from armsight.kinematics import Arm, link_frames
from armsight.ops.identification.beacon_observer import reach_m
from armsight.ops.identification.left_out import consequence, in_radians
from armsight.ops.identification.live import Known, LiveSweeps, OperatorCallbacks, identify_observed
from armsight.ops.measurement.run import target_of
from armsight.ops.saving import write_with_page
from armsight.records import Progress, Silent
from armsight.store import World, read_rig, read_world, write_world
from armsight.store.arm_file import read_arm, write_arm
from armsight.store.arm_points import read_sweeps
from armsight.store.cell_file import CellFile, cell_path
from armsight.units import DEG, MM, displayed_name

JOB_NAME = "identify"
FOLDER = "identify"
STEPS = 24
"""Points of a fit that is drawn."""
AXIS_M = 0.15
"""Half the length in which a joint's axis is drawn."""
ENTRIES = tuple((name, *displayed_name(name)[1:]) for name in DH_ROW[:4])
FASTEST_DEG_S, FASTEST_MM_S = 10.0, 20.0
"""Of a joint on its sweep at full override: the light goes through the pictures slowly enough to be followed."""
AROUND_DEG, AROUND_M = 10.0, 0.05
"""Half a range that is proposed about where a joint stands."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Range:
    """How far a joint may go: lower and upper in deg or mm, as people type it; slides: mm. swept: else it is held."""

    joint: int
    name: str
    lower: float
    upper: float
    slides: bool = False
    swept: bool = True

    def limits(self) -> tuple[float, float]:
        """Return both in rad or m."""
        unit = MM if self.slides else DEG
        return self.lower * unit, self.upper * unit


@dataclass(frozen=True, kw_only=True)
class IdentifyRequest:
    """What a page asks: the cell, the ranges of all joints, readings of a sweep, frames of a reading."""

    folder: Path
    cell: CellFile
    ranges: tuple[Range, ...]
    readings: int = LiveSweeps.readings
    frames: int = Pace().frames_per_reading

    @property
    def left_out(self) -> tuple[int, ...]:
        """The joints that are not swept, from 1."""
        return tuple(one.joint for one in self.ranges if not one.swept)

    def consequence(self) -> str:
        """Return in words what leaving joints out means, empty where none is. Raises UsageError where it cannot be."""
        return consequence(len(self.ranges), self.left_out)


def proposed_ranges(robot: RobotCell) -> tuple[Range, ...]:
    """Return a range about where each joint stands, within what the joint can. Raises DeviceLost, NotEnoughData."""
    arm, q = robot.session.arm, robot.joints()
    if arm is None:
        raise NotEnoughData("the arm's joints are not known", consequence="No range is proposed")
    made = []
    for j, (joint, slides) in enumerate(zip(arm.joints, ~arm.revolute, strict=True)):
        unit, around = (MM, AROUND_M) if slides else (DEG, AROUND_DEG * DEG)
        low, high = max(q[j] - around, arm.lower[j]), min(q[j] + around, arm.upper[j])
        made.append(
            Range(
                joint=j + 1,
                name=joint.name,
                lower=round(float(low / unit), 1),
                upper=round(float(high / unit), 1),
                slides=bool(slides),
            )
        )
    return tuple(made)


def light_of(folder: Path, cell: CellFile) -> str:
    """Return the name of the target's light that is followed, empty without a target. Raises BadFile."""
    file = cell_path(folder, cell.target, "target")
    return "" if file is None else target_of(file).names[0]


def expected(asked: IdentifyRequest, robot: RobotCell, station: MeasurementProcess) -> PlanOutput:
    """Return the sweeps that would be made, and the accuracy to expect; nothing moves.

    Raises UsageError, Inconsistent, Degenerate, NotEnoughData where the arm's position before the cameras is not known.
    """
    clock = SystemClock()
    still = SessionRobot(robot.session, lambda: "", clock, waits=False, cancelled=lambda: True)
    done = _identify(asked, robot, station, still, OperatorCallbacks(), Silent(), clock, propose=True)
    return cast(ProposedPlanOutput, done).plan


def run(
    asked: IdentifyRequest, robot: RobotCell, station: MeasurementProcess, background: BackgroundJob
) -> Identification:
    """Make the sweeps while the operator holds the enable; write FOLDER/arm.yaml and its report.

    Raises as identify_live.
    """
    clock = SystemClock()
    moved = background.robot(robot.session, clock, waits=True)
    person = OperatorCallbacks(confirm=background.ask)
    done = _identify(asked, robot, station, moved, person, background, clock, propose=False)
    if not isinstance(done, Identification):
        raise NotEnoughData("only a plan was made", consequence="No arm was identified")
    out = asked.folder / FOLDER
    read = [_needed(asked, "rig"), _needed(asked, "target"), *([out / "world.yaml"] if done.nominal else [])]
    write_with_page(out / "arm.yaml", done, read, {"out": out / "arm.yaml"})
    return done


def _identify(
    asked: IdentifyRequest,
    robot: RobotCell,
    station: MeasurementProcess,
    moved: SessionRobot,
    person: OperatorCallbacks,
    progress: Progress,
    clock: Clock,
    *,
    propose: bool,
) -> Identification | ProposedPlanOutput:
    sweeps, known, light = prepared(asked, robot, propose=propose)
    pace = Pace(speed=_pace(asked, robot.session.override), frames_per_reading=asked.frames)
    sweeps = replace(sweeps, pace=pace)
    observer = StationObserver(station, known.rig, light, clock)
    with moved:
        return identify_observed(sweeps, known, person, moved, observer, clock, progress)


def _pace(asked: IdentifyRequest, override: float) -> float:
    """Return the share of its travel that each joint goes in a second: none is faster than FASTEST, 1 at most."""
    spans = [
        abs(one.upper - one.lower) / (FASTEST_MM_S if one.slides else FASTEST_DEG_S)
        for one in asked.ranges
        if one.swept
    ]
    return override / max([*spans, 1.0])


def prepared(asked: IdentifyRequest, robot: RobotCell, *, propose: bool) -> tuple[LiveSweeps, Known, str]:
    """Return the sweeps, what they start from, and the light's name; model and place are kept beside the result.

    Raises UsageError, BadFile, NotEnoughData.
    """
    rig_file, target_file = (_needed(asked, name) for name in ("rig", "target"))
    rig, target, arm = read_rig(rig_file, any_cameras=True), target_of(target_file), robot.session.arm
    if arm is None or len(asked.ranges) != arm.n:
        raise UsageError("a range is needed for every joint", consequence="Nothing is moved")
    if target.is_board:
        raise UsageError("the target is a board", consequence="It has no light to follow", cure="Choose a lit target")
    out = asked.folder / FOLDER
    out.mkdir(parents=True, exist_ok=True)
    light = target.names[0]
    sweeps = LiveSweeps(
        limits=in_radians(np.array([one.limits() for one in asked.ranges])),
        out=out / "arm.yaml",
        readings=asked.readings,
        propose=propose,
        left_out=asked.left_out,
        around_m=reach_m(target),
    )
    placed = _placed(asked, arm, robot.joints())
    if placed is None and propose:
        raise NotEnoughData(
            "where the arm stands before the cameras is not known",
            consequence="No accuracy can be foretold",
            cure="Calibrate hand-eye first, or run: the arm is then probed by small motions before",
        )
    if placed is None:
        return sweeps, Known(rig=rig), light
    T_world_rig, T_flange_light = placed[0], placed[1] * RigidTransform.from_translation(target.xyz_m[0])
    world, model = World(parent="world", T_parent_rig=T_world_rig), replace(arm, T_flange_tool=T_flange_light)
    write_world(out / "world.yaml", world)
    write_arm(out / "model.yaml", model)
    return sweeps, Known(rig=rig, world=world, model=model, nominal=model), light


def _placed(asked: IdentifyRequest, arm: Arm, q: Array) -> tuple[RigidTransform, RigidTransform] | None:
    """Return T_world_rig and T_flange_target by the hand-eye calibration of standing cameras; None without one."""
    placement = read_placement(asked.folder, asked.cell)
    T_world_rig = placement.rig_pose(arm, q)
    if placement.handeye is None or T_world_rig is None or asked.cell.on_robot:
        return None
    return T_world_rig, placement.handeye.T_parent_target


def _needed(asked: IdentifyRequest, name: str) -> Path:
    path = cell_path(asked.folder, getattr(asked.cell, name), name)
    if path is None:
        raise NotEnoughData(f"the cell has no {name} yet", consequence="Nothing is moved", cure="See the page Settings")
    return path


@dataclass(frozen=True, slots=True, kw_only=True)
class Entry:
    """An entry of an identified joint as a page shows it: value, standard deviation, and by how much it deviates from
    the model, in mm or deg; NaN where there is none, both of an entry that is chosen and not measured."""

    joint: int
    name: str
    unit: str
    value: float
    std: float
    deviation: float


def entries(done: Identification, model: Arm | None) -> tuple[Entry, ...]:
    """Return the table of an identified arm; model: what it is held against."""
    made = []
    for joint in done.joints:
        nominal = None if model is None else model.joints[joint.index - 1]
        for name, unit, scale in ENTRIES:
            value, std = getattr(joint, name), joint.std[name]
            chosen = not np.isfinite(std)  # not measured: that it is not the model's says nothing
            off = np.nan if nominal is None or chosen else value - getattr(nominal, name)
            off = float(np.angle(np.exp(1j * off))) if unit == "deg" and np.isfinite(off) else float(off)
            made.append(
                Entry(
                    joint=joint.index,
                    name=name.split("_")[0],
                    unit=unit,
                    value=value / scale,
                    std=std / scale,
                    deviation=off / scale,
                )
            )
    return tuple(made)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SweepFit:
    """What a scene shows of a joint's sweep, in world, or in rig axes where the rig's position was not known; in m.

    path (m, 3): where the identified arm has the light along it, an arc or a line. seen (n, 3): where it was seen. axis
    (2, 3): both ends of a piece of the joint's axis; of a slide along the path. centre (3,): the foot of the path's
    begin on the axis, None of a slide. off_m: RMS distance of what was seen from where the arm has it.
    """

    joint: int
    path: Array
    seen: Array
    axis: Array
    centre: Array | None
    off_m: float


def fits(folder: Path) -> tuple[SweepFit, ...]:
    """Return the fits of the sweeps kept in a folder, a joint each. Raises BadFile."""
    out = folder / FOLDER
    arm, sweeps = read_arm(out / "arm.yaml"), read_sweeps(out / "arm.sweep.csv")
    world = out / "world.yaml"
    T = read_world(world).T_parent_rig if world.exists() else RigidTransform.identity()
    seen = np.asarray(T.apply(sweeps.xyz_m))
    return tuple(
        _fit(arm, j, sweeps.q[sweeps.joint == j], seen[sweeps.joint == j])
        for j in range(arm.n)
        if (sweeps.joint == j).any()
    )


def _fit(arm: Arm, j: int, q: Array, seen: Array) -> SweepFit:
    begin, end = q[np.argmin(q[:, j])], q[np.argmax(q[:, j])]
    way = begin + np.linspace(0.0, 1.0, STEPS)[:, None] * (end - begin)
    path = np.asarray(arm.fk(arm.values(way))[:, :3, 3])
    off = np.asarray(arm.fk(arm.values(q))[:, :3, 3]) - seen
    frame = link_frames(arm, arm.values(begin))[j]
    direction = frame[:3, 2]
    foot = frame[:3, 3] + ((path[0] - frame[:3, 3]) @ direction) * direction
    turns = bool(arm.revolute[j])
    middle = foot if turns else path.mean(axis=0)
    return SweepFit(
        joint=j + 1,
        path=path,
        seen=seen,
        axis=middle + AXIS_M * np.array([[-1.0], [1.0]]) * direction,
        centre=foot if turns else None,
        off_m=float(np.sqrt((off**2).sum(axis=1).mean())),
    )
