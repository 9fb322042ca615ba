"""A cell whose robot a page moves: its loop in a process, its log, its session, and a simulated cell's cameras."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from armsight.app.live.followed import FollowedCell
from armsight.app.operator.job_runner import JobRunner
from armsight.app.requests.motion import RobotJob
from armsight.app.robot.guarding import arm_model, left_open
from armsight.app.robot.hosting import ProcessHost, spec_of
from armsight.app.robot.opening import SIM, open_to_all
from armsight.app.robot.recorder import RecordingLog, default_log, require_recorded
from armsight.app.simulate.run import write_set_up
from armsight.app.simulate.scenarios import build_world, load_scenario
from armsight.arrays import Array
from armsight.control.guard import Limits
from armsight.control.session.channels import JointTrack
from armsight.control.session.operator_session import OperatorSession
from armsight.control.session.service import Service
from armsight.drivers.lock import DeviceLock
from armsight.errors import NotEnoughData
from armsight.records import JointReading
from armsight.store.atomic import disk_errors
from armsight.store.cell_file import CellFile, cell_path, read_cell, write_cell
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
    scenario = scenario_of(robot)
    track = None if scenario is None else JointTrack(model.n)
    spec = spec_of(job, model, kept)
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


def scenario_of(robot: str) -> str | None:
    """Return the scenario of a robot sim:SCENARIO; None for others."""
    driver, _, device = robot.partition(":")
    return device if driver == SIM else None


def cameras_of(scenario: str) -> tuple[str, str]:
    """Return the left and right camera of a simulated cell, as sources; of a mirror rig its one camera, and none.

    Raises DeviceNotFound, BadFile for the scenario.
    """
    if load_scenario(scenario)[0].cameras.mirrors is not None:
        return f"camera:sim:{scenario}:image", ""
    return f"camera:sim:{scenario}:left", f"camera:sim:{scenario}:right"


def prepare_simulated(robot: str, folder: Path) -> CellFile | None:
    """Write rig, target, arm and hand-eye of sim:SCENARIO into a folder that holds no cell; return the cell.

    A folder with a cell, and a robot that is not simulated, are left as they are: None. Raises BadFile,
    DeviceNotFound for the scenario.
    """
    scenario = scenario_of(robot)
    if scenario is None or read_cell(folder) != CellFile():
        return None
    model, _ = load_scenario(scenario)
    folder.mkdir(parents=True, exist_ok=True)
    world = build_world(scenario, model, seed=None, frames=1, room="dark")  # of which nothing is written
    write_set_up(world, folder)
    left, right = cameras_of(scenario)
    cell = CellFile(
        left=left,
        right=right,
        robot=robot,
        rig="rig.yaml",
        target="target.yaml",
        arm="arm.yaml",
        handeye="handeye.yaml",
        cameras="standing" if world.T_flange_rig is None else "carried",
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
