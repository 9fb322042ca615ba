"""The robot and the cameras of a supervision, by what the person calls them."""

from __future__ import annotations

from armsight.app.requests.verify import LiveVerifyJob
from armsight.app.robot.opening import open_robot
from armsight.app.simulate.scenarios import live_cell
from armsight.app.sources.frames import open_pairs
from armsight.app.verify.supervising import Supervised
from armsight.clock import Clock
from armsight.drivers import is_live
from armsight.errors import UsageError
from armsight.records import Target

SIM = "sim:"


def open_supervised(job: LiveVerifyJob, target: Target, clock: Clock) -> Supervised:
    """Return what the job names; nothing is opened yet. Raises UsageError, DeviceNotFound, BadFile."""
    if job.robot.startswith(SIM):
        return _simulated(job, clock)
    if job.play:
        raise UsageError(f"--play is of simulated robots, and {job.robot} is none", cure="Leave --play away")
    for text in (job.left, job.right):
        if not is_live(text) or text.startswith("camera:sim:"):
            raise UsageError(f"{text} does not see {job.robot} now", cure="Give camera:NAME for --left and --right")
    robot = open_robot(job.robot, clock)
    pairs = open_pairs(job.left, job.right, colour=target.colour is not None, settings=job.camera_settings)
    return Supervised(robot=robot, pairs=pairs)


def _simulated(job: LiveVerifyJob, clock: Clock) -> Supervised:
    name = job.robot.removeprefix(SIM)
    for view, text in (("left", job.left), ("right", job.right)):
        if text != f"camera:sim:{name}:{view}":
            raise UsageError(
                f"{text} does not see the simulated robot {job.robot}", cure=f"Give camera:sim:{name}:{view}"
            )
    job.camera_settings.require_none(f"the simulated robot {job.robot}")
    cell = live_cell(name, clock, play=job.play)
    return Supervised(robot=cell.robot, pairs=cell.pairs, origin_s=lambda: float(cell.origin_s))
