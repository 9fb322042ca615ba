"""The robot and the cameras of a servo, by what the person calls them."""

from __future__ import annotations

from functools import partial

from armsight.app.requests.motion import ServoJob
from armsight.app.robot.opening import open_robot
from armsight.app.servo.job import ServoDevices
from armsight.app.servo.stepped import SteppedClock
from armsight.app.simulate.scenarios import live_cell
from armsight.app.sources.complex_images import complex_pairs
from armsight.app.sources.frames import open_pairs, open_source
from armsight.clock import Clock, SystemClock
from armsight.drivers import CameraSettings, is_live
from armsight.errors import UsageError
from armsight.optics import Rig
from armsight.records import Target

SIM = "sim:"


def open_servo(job: ServoJob, rig: Rig, target: Target, clock: Clock | None = None) -> ServoDevices:
    """Return what the job names; nothing is opened yet. Raises UsageError, DeviceNotFound, BadFile."""
    if job.robot.startswith(SIM):
        return _simulated(job)
    if job.hand is not None:
        raise UsageError(f"--hand leads a simulated target, and {job.robot} is no simulated robot", cure="Leave it out")
    clock = clock or SystemClock()
    settings, colour = CameraSettings(exposure_s=job.exposure_s), target.colour is not None
    if job.image is not None and job.left is job.right is None:
        _check_live(job.image)
        source = partial(open_source, job.image, colour=colour, settings=settings, clock=clock)
        pairs, overlaid = complex_pairs(source, rig)
        return ServoDevices(robot=open_robot(job.robot, clock), pairs=pairs, clock=clock, overlaid=overlaid)
    if job.image is not None or job.left is None or job.right is None:
        raise UsageError(
            "which cameras see the target is not said", cure="Give --left and --right, or --image for a mirror rig"
        )
    _check_live(job.left)
    _check_live(job.right)
    both = open_pairs(job.left, job.right, colour=colour, settings=settings)
    return ServoDevices(robot=open_robot(job.robot, clock), pairs=both, clock=clock)


def _check_live(text: str) -> None:
    if not is_live(text) or text.startswith("camera:sim:"):
        raise UsageError(f"{text} does not see the target now", cure="Give camera:NAME")


def _simulated(job: ServoJob) -> ServoDevices:
    """Return a simulated cell, whose time moves with the loop."""
    given = [name for name in ("left", "right", "image", "exposure_s") if getattr(job, name) is not None]
    if given:
        raise UsageError(
            f"the simulated cell {job.robot} has its own cameras, and {', '.join(given)} is given", cure="Leave it out"
        )
    clock = SteppedClock()
    cell = live_cell(job.robot.removeprefix(SIM), clock, hand=job.hand, speed_m_s=job.hand_speed_m_s)
    return ServoDevices(
        robot=cell.robot,
        pairs=cell.pairs,
        clock=clock,
        overlaid=cell.one_image,
        origin_s=lambda: float(cell.origin_s),
        stepped=clock,
    )
