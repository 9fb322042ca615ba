"""A cell whose robot a page moves: its loop in a process, its log, its session; and where the things of a cell are."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight._files import DeviceLock
from armsight.app.live.measurement import FollowedCell
from armsight.app.operator.job_runner import JobRunner
from armsight.arrays import Array
from armsight.calibrate.handeye import Setup
from armsight.control.guard import Limits
from armsight.control.session.channels import JointTrack
from armsight.control.session.operator_session import OperatorSession
from armsight.control.session.service import Service
from armsight.errors import NotEnoughData, UsageError
from armsight.kinematics import Arm, link_frames
from armsight.ops.requests.motion import RobotJob
from armsight.ops.robot.hosting import ProcessHost, spec_of
from armsight.ops.robot.opening import SIM, arm_model, left_open, open_to_all
from armsight.ops.robot.recorder import RecordingLog, default_log, require_recorded
from armsight.ops.simulation.following import require_joints
from armsight.ops.simulation.run import write_set_up
from armsight.ops.simulation.scenarios import build_world, load_scenario
from armsight.optics import SIDES
from armsight.records import JointReading
from armsight.store import World, read_world
from armsight.store.atomic import disk_errors
from armsight.store.cell_file import COMPLEX, CellFile, cell_path, read_cell, write_cell
from armsight.store.handeye_file import HandEyeFile, read_handeye
from armsight.store.limits_file import read_limits


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotCell:
    """A robot under way. followed: its cameras where it is simulated, else None. notes: on limits and link."""

    robot: str
    service: Service
    session: OperatorSession
    limits: Limits
    followed: FollowedCell | None = None
    notes: tuple[str, ...] = ()
    jobs: JobRunner = field(default_factory=JobRunner)

    def joints(self) -> Array:
        """Return the newest values (n,) in rad or m. Raises as reading."""
        return self.reading().q

    def reading(self) -> JointReading:
        """Return the newest reading, with its time on the machine's clock. Raises DeviceLost, NotEnoughData before the
        first."""
        reading = self.service.host.status().reading
        if reading is None:
            raise NotEnoughData("the robot told no joints yet", consequence="No pose was taken", cure="Try again")
        return reading


@contextmanager
def open_robot_cell(job: RobotJob, folder: Path) -> Iterator[RobotCell]:
    """Run the loop of a robot with arm and limits of the folder's cell, until the block ends.

    Raises what arm_model, the driver, the files and the disk refuse.
    """
    cell = read_cell(folder)
    arm, limits = (cell_path(folder, getattr(cell, name), name) for name in ("arm", "limits"))
    robot = job.robot
    model = arm_model(robot, None if arm is None else str(arm))
    kept = Limits() if limits is None else read_limits(limits)
    scenario = scenario_of(job)
    track = None if scenario is None else JointTrack(model.n)
    spec = spec_of(job, model, kept)
    if scenario is not None:
        require_joints(len(load_scenario(scenario)[0].arm.joints), robot, model.n)
    folder.mkdir(parents=True, exist_ok=True)
    with RecordingLog(folder / default_log()) as log, ProcessHost(spec, track) as host:
        service = Service(host, log)
        service.authority.note("info", f"{robot} is at the operator's desk")
        made = RobotCell(
            robot=robot,
            service=service,
            session=OperatorSession(service),
            limits=kept,
            notes=("" if limits is None else left_open(kept, limits.name), open_to_all(job)),
            followed=None if scenario is None or track is None else FollowedCell(scenario, track),
        )
        try:
            yield made
        finally:
            made.jobs.close()
            service.authority.note("info", "the console ends")
            service.pump()
    require_recorded(log.failed)


def scenario_of(job: RobotJob) -> str | None:
    """Return the scenario whose cameras watch a robot, its own one of sim:SCENARIO; None for others.

    Raises UsageError for another one's before a simulated robot.
    """
    driver, _, device = job.robot.partition(":")
    if driver == SIM and job.follow is not None:
        raise UsageError(
            f"{job.robot} brings its own cameras, and --follow {job.follow} is given",
            consequence="Nothing is opened",
            cure="Leave --follow out, or name a real controller",
        )
    return device if driver == SIM else job.follow


def simulated_cameras(scenario: str) -> dict[str, str]:
    """Return the cameras of a simulated cell as sources by name; of a mirror rig its one picture.

    Raises DeviceNotFound, BadFile for the scenario.
    """
    cameras = load_scenario(scenario)[0].cameras
    if cameras.mirrors is not None:
        return {COMPLEX: f"camera:sim:{scenario}:image"}
    return {name: f"camera:sim:{scenario}:{name}" for name in cameras.lenses}


def prepare_simulated(job: RobotJob, folder: Path) -> CellFile | None:
    """Write rig, target, arm and hand-eye of a robot's scenario into a folder that holds no cell; return the cell.

    A folder with a cell, and a robot before real cameras, are left as they are: None. Raises BadFile,
    DeviceNotFound for the scenario.
    """
    scenario = scenario_of(job)
    if scenario is None or read_cell(folder) != CellFile():
        return None
    model, _ = load_scenario(scenario)
    folder.mkdir(parents=True, exist_ok=True)
    world = build_world(scenario, model, seed=None, frames=1, room="dark")  # of which nothing is written
    write_set_up(world, folder)
    named = simulated_cameras(scenario)
    left, right = named.pop(COMPLEX, None) or named.pop(SIDES[0]), named.pop(SIDES[1], "")
    carried = world.T_flange_rig is not None
    cell = CellFile(
        left=left,
        right=right,
        robot=job.robot,
        rig="rig.yaml",
        target="target.yaml",
        arm="arm.yaml",
        handeye="handeye.yaml",
        cameras=named or ("carried" if carried else "standing"),
        carried=carried and bool(named),
    )
    write_cell(folder, cell)
    return read_cell(folder)


def one_console(folder: Path) -> DeviceLock:
    """Return what a console holds while it serves a cell's folder, which is made where it is missing.

    Raises DeviceFailed where it cannot be made, and on entering where another console serves it.
    """
    with disk_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    return DeviceLock(
        "the console of this folder",
        folder=folder,
        consequence="Two consoles would write over each other's files; nothing is served",
        cure=f"Open the page of the other one, stop it, or choose another folder than {folder}",
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Placement:
    """What a cell's files tell of where its cameras and its target are; None of what they do not."""

    world: World | None
    handeye: HandEyeFile | None

    def rig_pose(self, arm: Arm | None, q: Array | None) -> RigidTransform | None:
        """Return T_world_rig by world.yaml, or by hand-eye, arm and joints q (n,); None where it is not known.

        A carried rig is where the arm is now; without an arm, or its joints, its position is not known.
        """
        if self.world is not None:
            return self.world_parent(arm) * self.world.T_parent_rig
        if self.handeye is None or arm is None:
            return None
        if self.handeye.setup is Setup.EYE_TO_HAND:
            return arm.T_world_base * self.handeye.T_parent_camera
        return None if q is None else flange_pose(arm, q) * self.handeye.T_parent_camera

    def world_parent(self, arm: Arm | None) -> RigidTransform:
        """Return T_world_parent of the frame that world.yaml gives the rig in, and the station its poses."""
        in_base = self.world is not None and self.world.parent == "base" and arm is not None
        return arm.T_world_base if in_base and arm is not None else RigidTransform.identity()

    def on_robot(self, arm: Arm | None, consequence: str) -> tuple[Arm, RigidTransform]:
        """Return the arm with the target as its tool, and T_world_rig of standing cameras. Raises NotEnoughData."""
        T_world_rig = self.rig_pose(arm, None)
        if arm is None or self.handeye is None or T_world_rig is None:
            raise NotEnoughData(
                "where the cameras and the target are on the robot is not known",
                consequence=consequence,
                cure="Calibrate hand-eye first, on the page Calibrate",
            )
        return replace(arm, T_flange_tool=self.handeye.T_parent_target), T_world_rig


def read_placement(folder: Path, cell: CellFile, *, target: bool = True) -> Placement:
    """Return what the cell's files tell; without target no more than the cameras' position takes. Raises BadFile."""
    files = {name: cell_path(folder, getattr(cell, name), name) for name in ("world", "handeye")}
    world = None if files["world"] is None else read_world(files["world"])
    needed = files["handeye"] if target or world is None else None
    return Placement(world=world, handeye=None if needed is None else read_handeye(needed))


def flange_pose(arm: Arm, q: Array) -> RigidTransform:
    """Return T_world_flange at a controller's readings q (n,)."""
    return RigidTransform.from_matrix(arm.fk(arm.values(q))) * arm.T_flange_tool.inv()


def arm_points(arm: Arm, q: Array) -> Array:
    """Return (2 n + 2, 3): the corners of the line that an arm is drawn as in world, from its base to its tool.

    Each link goes along its joint's axis first, then across it, as Denavit and Hartenberg's lengths do.
    """
    frames = link_frames(arm, arm.values(q))
    points = [frames[0, :3, 3]]
    for before, after in pairwise(frames[:-1]):
        z, way = before[:3, 2], after[:3, 3] - before[:3, 3]
        points += [before[:3, 3] + (z @ way) * z, after[:3, 3]]
    return np.array([*points, frames[-1, :3, 3]])
