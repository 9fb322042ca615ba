"""What a served robot is, as the plant's systems are told it."""

from __future__ import annotations

import time
from collections.abc import Callable

from armsight.control.session.loop_host import flange_pose
from armsight.control.session.service import Service
from armsight.errors import ArmsightError
from armsight.publish.feed import Log, Source
from armsight.publish.state import PlantState, RobotSeen, Seen
from armsight.records import JointReading

SERVE = "armsight serve"


def source_of(service: Service, seen: Callable[[], Seen | None] = lambda: None) -> Source:
    """Return what looks at a service; seen: what a supervision beside it measured last, None where none goes on."""

    def look() -> PlantState:
        measured = seen()
        robot, why = None, ""
        try:
            robot = _robot(service)
        except ArmsightError as error:
            why = error.cause
        return PlantState(
            source=SERVE,
            made_s=time.monotonic(),
            made_unix_s=time.time(),
            robot=robot,
            why=why,
            seen=measured,
            recording=service.recording_failed,
            measures=measured is not None,
        )

    return look


def log_of(service: Service, tell: Callable[[str], None] = lambda _: None) -> Log:
    """Return what keeps notes in a service's log; errors are told the person too."""

    def keep(level: str, message: str) -> None:
        service.authority.note(level, message)
        if level == "error":
            tell(message)

    return keep


def monotonic_s(now_s: float, t_s: float) -> float:
    """Return a moment t_s of a clock that shows now_s on time.monotonic."""
    return time.monotonic() - (now_s - t_s)


def _robot(service: Service) -> RobotSeen:
    status = service.authority.status()
    reading: JointReading | None = status.reading
    T = None if reading is None else flange_pose(service.host.arm, reading.q)
    return RobotSeen(
        name=service.authority.robot.name,
        status=status,
        reading=reading,
        at_s=float("nan") if reading is None else monotonic_s(service.host.now_s(), reading.t_s),
        T_base_flange=None if T is None else T.as_matrix(),
    )
