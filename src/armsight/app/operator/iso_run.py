"""An ISO 9283 run from the page: a cube's five poses about where the target is, visited again and again, and judged."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Annotated

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.app.live.station import MeasurementProcess
from armsight.app.operator.job_runner import BackgroundJob
from armsight.app.operator.robot_cell import RobotCell, read_placement
from armsight.app.operator.station_observer import StationPoses
from armsight.arrays import Array
from armsight.clock import Clock, SystemClock
from armsight.control.joint_sweep import PathSegment, PoseObserver, PoseVisit, Visitor
from armsight.defaults import TOOL_SPEED_M_S
from armsight.drivers import Robot
from armsight.errors import ArmsightError, DataRefused, NotEnoughData, UsageError
from armsight.fields import Bounds
from armsight.kinematics import Arm, singularity_distance, track_path
from armsight.ops.measurement.run import target_of
from armsight.ops.verification.mastering import seen_whole
from armsight.ops.verify import verify
from armsight.records import Progress
from armsight.store import World, read_rig, write_text, write_world
from armsight.store.cell_file import CellFile, cell_path
from armsight.store.covariances import COVARIANCE, above_diagonal
from armsight.store.path_file import write_test_plan
from armsight.store.tables import cells
from armsight.units import MM
from armsight.verify.iso9283 import PlannedMotion, TestPlan
from armsight.verify.iso9283.motions import PLANES, POSE_ORDER, SIDES_M, TestCube
from armsight.verify.results import VerifyResult

JOB_NAME = "iso"
SMALL_SIDES_M = (0.16, 0.1, 0.063)
"""Cubes below the standard's smallest, for cameras that see no more."""
STEP_M = 0.005
"""Between the points at which a way is checked."""
JOINT_SPEED = 0.5
"""Fastest joint on the way (rad or m a second), at full override."""
FEWEST_VISITS = 3
"""Of each pose, before anything is judged."""
FIGURES = ("AP_m", "RP_m", "AD_m", "RD_m")
"""What a page shows, each with its poses."""


@dataclass(frozen=True, kw_only=True)
class IsoRequest:
    """What a page asks. side_m: of the cube, None for the largest that fits; cycles: visits of each pose.

    frames_per_visit: poses that are seen at each.
    """

    folder: Path
    cell: CellFile
    side_m: Annotated[float | None, Bounds(least=0.01, most=1.0)] = None
    cycles: Annotated[int, Bounds(least=FEWEST_VISITS, most=100)] = 10
    speed_m_s: Annotated[float, Bounds(least=0.001, most=1.0)] = TOOL_SPEED_M_S
    frames_per_visit: int = 5


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class IsoPlan:
    """The cube that fits, the ways between its poses, and what to know of it. begin: the way there from now on."""

    test: TestPlan
    begin: PathSegment
    legs: tuple[PathSegment, ...]
    T_world_rig: RigidTransform
    notes: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class IsoDone:
    """What came of a run. ended: why it ended before the last cycle, empty where it did not."""

    output: VerifyResult
    folder: Path
    cycles: int
    wanted: int
    ended: str


def plan(asked: IsoRequest, robot: RobotCell) -> IsoPlan:
    """Return the largest cube about where the target is now that the arm can serve and the cameras see.

    The target keeps its attitude. Raises UsageError, BadFile, NotEnoughData for what the cell lacks, DataRefused with
    the reason for every size.
    """
    if asked.cell.on_robot:
        raise UsageError("the cameras ride on the arm", cure="Put them beside it: they have to see where the arm goes")
    if not (asked.cycles >= FEWEST_VISITS and asked.speed_m_s > 0.0 and (asked.side_m is None or asked.side_m > 0.0)):
        raise UsageError(f"at least {FEWEST_VISITS} cycles, and a speed and a side above 0, are needed")
    arm, T_world_rig = read_placement(asked.folder, asked.cell).on_robot(robot.session.arm, "Nothing is planned")
    files = [cell_path(asked.folder, getattr(asked.cell, name), name) for name in ("rig", "target")]
    if files[0] is None or files[1] is None:
        raise NotEnoughData("the cell has no rig or no target", consequence="Nothing is planned", cure="See Settings")
    q = robot.joints()
    why: list[str] = []
    rig, target = read_rig(files[0], any_cameras=True), target_of(files[1])
    for side_m in (asked.side_m,) if asked.side_m else (*SIDES_M, *SMALL_SIDES_M):
        for plane in PLANES:
            cube = TestCube(centre_m=_here(arm, q).translation, side_m=side_m, plane=plane)
            poses = _poses(arm, q, cube)
            if not seen_whole(rig, target, (T_world_rig.inv() * poses).as_matrix()).all():
                why.append(f"{side_m / MM:.0f} mm: the cameras would not see the target at every pose")
                continue
            made = _planned(asked, arm, q, cube, T_world_rig)
            if isinstance(made, IsoPlan):
                return made
            why.append(f"{side_m / MM:.0f} mm: {made}")
    raise DataRefused(
        f"no cube about where the target is now fits ({'; '.join(dict.fromkeys(why))})",
        consequence="Nothing is planned",
        cure="Jog the target to the middle of both pictures, away from the arm's limits, or give a smaller side",
    )


def _here(arm: Arm, q: Array) -> RigidTransform:
    """Return T_base_target at the controller's readings q (n,)."""
    return arm.T_world_base.inv() * RigidTransform.from_matrix(arm.fk(arm.values(q)))


def _poses(arm: Arm, q: Array, cube: TestCube) -> RigidTransform:
    """Return T_world_target of P1 to P5, with the attitude that the target has now."""
    R = _here(arm, q).rotation
    return arm.T_world_base * RigidTransform.concatenate(
        [RigidTransform.from_components(position, R) for position in cube.points_m.values()]
    )


def _planned(asked: IsoRequest, arm: Arm, q: Array, cube: TestCube, T_world_rig: RigidTransform) -> IsoPlan | str:
    corners = dict(zip(cube.points_m, _poses(arm, q, cube), strict=True))
    at, tracks = arm.values(q), []
    for start, end in pairwise(("P1", *POSE_ORDER)):
        line = _straight(corners[start], corners[end])
        track = track_path(arm, line, start=at)
        if track.issues:
            return track.issues[0].text
        at = track.q[-1]
        tracks.append(arm.readings(track.q))
    legs = [
        _leg(name, readings, asked, float(np.linalg.norm(corners[start].translation - corners[name].translation)))
        for readings, (start, name) in zip(tracks, pairwise(("P1", *POSE_ORDER)), strict=True)
    ]
    small = cube.side_m < min(SIDES_M)
    notes = [f"a cube of {cube.side_m / MM:.0f} mm is below the standard's smallest of 250 mm"] if small else []
    notes.append("AP holds the error of the hand-eye calibration, which the same arm made")
    q_poses = np.array([leg.q[-1] for leg in legs])
    poses = PlannedMotion(
        test="poses",
        figures=("AP", "RP"),
        names=POSE_ORDER,
        repeats=asked.cycles,
        xyz_m=np.array([corners[name].translation for name in POSE_ORDER]),
        q=q_poses,
    )
    test = TestPlan(
        arm=arm.name,
        cube=cube,
        quat_xyzw=np.asarray(corners["P1"].rotation.as_quat(canonical=True)),
        motions=(poses,),
        speed_m_s=asked.speed_m_s,
        branch=(),
        singularity_distance=float(singularity_distance(arm, arm.values(q_poses)).min()),
        limit_margin=float(np.minimum(arm.values(q_poses) - arm.lower, arm.upper - arm.values(q_poses)).min()),
    )
    return IsoPlan(test=test, begin=legs[0], legs=tuple(legs[1:]), T_world_rig=T_world_rig, notes=tuple(notes))


def _straight(a: RigidTransform, b: RigidTransform) -> RigidTransform:
    """Return poses (k,) along the line from one to another that has the same attitude."""
    start, end = np.asarray(a.translation), np.asarray(b.translation)
    k = max(int(np.ceil(np.linalg.norm(end - start) / STEP_M)), 1) + 1
    return RigidTransform.concatenate(
        [RigidTransform.from_components(start + s * (end - start), a.rotation) for s in np.linspace(0.0, 1.0, k)]
    )


def _leg(name: str, readings: Array, asked: IsoRequest, length_m: float) -> PathSegment:
    """Return a way with its times: at the speed asked for, slower where a joint would be too fast."""
    if len(readings) < 2:
        return PathSegment(name=name, q=readings, t_s=np.zeros(1))
    steps = len(readings) - 1
    each = np.maximum(length_m / steps / (asked.speed_m_s), np.abs(np.diff(readings, axis=0)).max(axis=1) / JOINT_SPEED)
    return PathSegment(name=name, q=readings, t_s=np.concatenate([[0.0], np.cumsum(each)]))


def run(asked: IsoRequest, robot: RobotCell, station: MeasurementProcess, background: BackgroundJob) -> IsoDone:
    """Visit the poses while the operator holds the enable, and judge what was seen.

    What was measured before an early end is kept and judged. Raises as plan; NotEnoughData where no pose was visited
    often enough.
    """
    made = plan(asked, robot)
    side_mm = made.test.cube.side_m / MM
    if not background.ask(
        f"The arm visits five poses in a cube of {side_mm:.0f} mm, {asked.cycles} times. Is the way free?"
    ):
        raise NotEnoughData("it was not begun", consequence="Nothing was moved")
    clock = SystemClock()
    out = asked.folder / time.strftime("iso-%Y%m%d-%H%M%S")
    with background.robot(robot.session, clock, waits=True) as moved:
        override = max(robot.session.override, 0.01)
        visits, ended = visited(slower(made, override), asked, moved, StationPoses(station, clock), clock, background)
    return judged(made, asked, visits, ended, out)


def slower(made: IsoPlan, override: float) -> IsoPlan:
    """Return the plan with all ways at a share of their speed."""

    def leg(one: PathSegment) -> PathSegment:
        return replace(one, t_s=one.t_s / override)

    return replace(made, begin=leg(made.begin), legs=tuple(leg(one) for one in made.legs))


def visited(
    made: IsoPlan, asked: IsoRequest, robot: Robot, observer: PoseObserver, clock: Clock, progress: Progress
) -> tuple[list[PoseVisit], str]:
    """Return the visits that were made, and why they ended before the last cycle; the robot is held then."""
    visitor = Visitor(robot, observer, clock, progress, frames=asked.frames_per_visit)
    visits: list[PoseVisit] = []
    total = asked.cycles * len(made.legs)
    try:
        visitor.visit(made.begin, 0)  # P1, which every cycle ends with
        for cycle in range(1, asked.cycles + 1):
            for leg in made.legs:
                visits.append(visitor.visit(leg, cycle))
                progress.update(len(visits), total, f"cycle {cycle}, {leg.name}")
    except ArmsightError as error:
        robot.stop()
        return visits, str(error)
    return visits, ""


def judged(made: IsoPlan, asked: IsoRequest, visits: list[PoseVisit], ended: str, out: Path) -> IsoDone:
    """Write visits.csv, plan.csv, world.yaml and what `verify` writes; return the figures.

    Raises NotEnoughData where no pose was visited often enough, with why it ended.
    """
    if not visits:
        raise NotEnoughData(ended or "no pose was visited", consequence="Nothing was measured")
    write_text(out / "visits.csv", visits_csv(visits))
    write_test_plan(out / "plan.csv", made.test)
    complete = len(visits) // len(made.legs)
    if complete < FEWEST_VISITS:
        raise NotEnoughData(
            f"{complete} of {asked.cycles} cycles were made, {FEWEST_VISITS} are needed: {ended}",
            consequence=f"Nothing is judged; what was seen is in {out.name}/visits.csv",
        )
    world = None
    if visits[0].poses[0].parent == "rig":
        world = out / "world.yaml"
        write_world(world, World(parent="world", T_parent_rig=made.T_world_rig))
    output = verify(
        out / "visits.csv",
        commanded=out / "plan.csv",
        world=world,
        align=None if world is not None else "none",
        out=out,
    )
    return IsoDone(output=output, folder=out, cycles=complete, wanted=asked.cycles, ended=ended)


def visits_csv(visits: list[PoseVisit]) -> str:
    """Return visits.csv: a row for every frame, with the pose it is a visit of, and the cycle."""
    n = len(visits[0].q)
    header = "pose,visit,x_m,y_m,z_m,qx,qy,qz,qw,sx_m,sy_m,sz_m,srx_rad,sry_rad,srz_rad,t_s"
    lines = [",".join([header, *(f"q{i + 1}" for i in range(n)), *COVARIANCE])]
    for visit in visits:
        for pose in visit.poses:
            T = pose.pose
            if T is None or pose.covariance is None:
                continue
            quat = T.rotation.as_quat(canonical=True)
            std = np.sqrt(np.diag(pose.covariance))
            related = above_diagonal(pose.covariance)
            values = cells(np.concatenate([T.translation, quat, std, [pose.t_s], visit.q, related]))
            lines.append(f"{visit.name},{visit.cycle},{values}")
    return "\n".join(lines) + "\n"


def figures(done: IsoDone) -> tuple[tuple[str, str, str, str], ...]:
    """Return rows for a page: figure and pose, value in mm, its standard deviation, visits or why it is withheld."""
    rows = []
    for key, figure in done.output.iso9283.items():
        if key.split(" ")[0] not in FIGURES:
            continue
        if figure.value is None:
            rows.append((key.replace("_m", ""), "", "", figure.withheld or ""))
            continue
        std = "" if figure.std is None else f"{figure.std / MM:.3f}"
        rows.append((key.replace("_m", ""), f"{figure.value / MM:.3f}", std, f"{figure.n} of {figure.wanted} visits"))
    return tuple(rows)
