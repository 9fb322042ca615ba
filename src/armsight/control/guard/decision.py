"""What the guard is told each cycle and what it says: plain records."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.drivers import RobotState


class GuardState(StrEnum):
    """What the guard does just now. Only RUNNING and RETREATING set the arm in motion; the others bring it to rest."""

    DISABLED = "disabled"
    """Nobody holds the enable."""
    RUNNING = "running"
    HOLDING = "holding"
    """At rest, or on the way to it, until the cause is gone; then the source's set points are followed again."""
    RETREATING = "retreating"
    """On the way to the set pose at low speed, because the target has been away for long."""
    STOPPED = "stopped"
    """At rest, or on the way to it; only a reset ends it."""


class TargetState(StrEnum):
    """What a source that follows a target says of it."""

    FRESH = "fresh"
    STALE = "stale"
    LOST = "lost"
    JUMPED = "jumped"


@dataclass(frozen=True, slots=True, kw_only=True)
class Inputs:
    """All but set point and reading that the guard decides by.

    now_s: on the loop's clock. enabled: whether the operator's enable is alive. robot, robot_why: what its link says,
    and why it does not go on. late_s: by how much this cycle began too late. stop: why a stop is asked for, empty where
    none is. target, target_age_s: of the target that the source depends on and of the frame it was seen in; None where
    there is none. waiting: the controller has not taken the last step yet, so that none can be sent.
    """

    now_s: float
    enabled: bool
    robot: RobotState = RobotState.READY
    robot_why: str = ""
    late_s: float = 0.0
    stop: str = ""
    target: TargetState | None = None
    target_age_s: float | None = None
    waiting: bool = False


@dataclass(frozen=True, slots=True)
class GuardEvent:
    """Something that happened, for the recording; level: info, warning or error."""

    t_s: float
    level: str
    message: str


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Decision:
    """What is sent this cycle.

    step (n,): from where the robot was last told to go, in rad or m; None: send nothing. q, qd (n,): where it is then
    told to go, and at which velocity. T_base_tool: of q by the arm's model. stop_robot: call its stop() now.
    state and why; limited: the limits that cut what was asked; at_rest: nothing moves any more by command.
    """

    step: Array | None
    q: Array
    qd: Array
    T_base_tool: RigidTransform
    state: GuardState
    why: str = ""
    limited: tuple[str, ...] = ()
    at_rest: bool = True
    stop_robot: bool = False
    events: tuple[GuardEvent, ...] = ()
