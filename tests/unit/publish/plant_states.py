"""States as they are published."""

import numpy as np

from armsight.control.guard import GuardState
from armsight.control.status import RobotStatus
from armsight.drivers import RobotState
from armsight.records import JointReading, PoseStatus, TargetPose
from armsight.verify.supervision import Compared, Level, Limits, Seen
from armsight_plant.state import PlantState, RobotSeen

UNIX_S = 1.8e9
LIMITS = Limits(warn_m=0.003, stop_m=0.01)


def seen(at_s=100.0, error_m=0.001, std_m=0.0002, level=Level.GOOD, lost="", limits=LIMITS, blind=False):
    """A pair: the tool off by error_m along x, known to std_m."""
    covariance = np.diag([std_m**2] * 3 + [1e-8] * 3)
    T = np.eye(4)
    T[:3, 3] = 0.1, 0.2, 0.9
    whole = TargetPose(t_s=at_s, status=PoseStatus.OK, parent="rig", T_parent_target=T, covariance=covariance)
    pose = whole if not lost else TargetPose(t_s=at_s, status=PoseStatus.LOST, parent="rig", why=lost)
    compared = None
    if not lost:
        compared = Compared(
            t_s=at_s,
            error=np.array([error_m, 0, 0, 0, 0, 0]),
            random=covariance,
            systematic=np.zeros((6, 6)),
            expected_std=np.ones(6),
        )
    why = "" if level is Level.GOOD else f"{level.word}: it is off"
    return Seen(pose=pose, compared=compared, level=level, why=why, limits=limits, lost=lost, at_s=at_s, blind=blind)


def robot(at_s=100.0, guard=GuardState.RUNNING, why="", link=RobotState.READY, enabled=True):
    """A robot of two joints."""
    reading = JointReading(t_s=at_s, q=np.array([0.1, 0.2]), sequence=7, source="sim")
    status = RobotStatus(
        t_s=at_s, cycle=3, robot=link, guard=guard, why=why, reading=reading, q_sent=reading.q, enabled=enabled, late=2
    )
    return RobotSeen(name="arm", status=status, reading=reading, at_s=at_s, T_base_flange=np.eye(4))


def state(at_s=100.0, **parts):
    """All of one moment."""
    given = {"robot": robot(at_s), "seen": seen(at_s), "measures": True, **parts}
    return PlantState(source="armsight serve", made_s=at_s, made_unix_s=UNIX_S + at_s, **given)
