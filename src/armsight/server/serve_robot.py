"""A robot served from beginning to end: its loop's process, its log, the web server."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from armsight.app.robot.guarding import arm_model
from armsight.app.robot.hosting import ProcessHost, RobotSpec
from armsight.app.robot.opening import driver_settings
from armsight.app.robot.recorder import RecordingLog
from armsight.control.guard import Limits
from armsight.control.session.service import Service
from armsight.errors import Cancelled
from armsight.server.serving import serve
from armsight.server.web_server import ServeOptions, check_options
from armsight.store.limits_file import read_limits


def serve_robot(
    robot: str,
    arm: str | None,
    options: ServeOptions,
    log: Path,
    *,
    limits: Path | None = None,
    rsi_config: Path | None = None,
    ready: Callable[[str, str], None],
    cancelled: Callable[[], bool] = lambda: False,
) -> None:
    """Serve DRIVER:DEVICE until SIGINT or SIGTERM; ready is called once all is there.

    It is told the address, and which limits the arm stands outside of, in words; nothing within.

    arm: its file or a preset's name. limits: limits.yaml of the guard. rsi_config: of an rsi link. Raises what
    check_options, arm_model, the driver and the disk refuse.
    """
    check_options(options)
    model = arm_model(robot, arm)
    spec = RobotSpec(
        robot=robot,
        arm=model,
        limits=Limits() if limits is None else read_limits(limits),
        settings=driver_settings(robot, arm=model, rsi_config=rsi_config),
    )
    with RecordingLog(log) as kept, ProcessHost(spec) as host:
        if cancelled():
            raise Cancelled("stopped before the robot was served")
        service = Service(host, kept)
        service.authority.note("info", f"{robot} is served")
        service.pump()  # what the loop told as it took the arm over
        serve(service, options, ready=lambda url: ready(url, service.outside))
        service.authority.note("info", "the server ends")
        service.pump()
