"""Guard, servo, teach, play."""

from armsight.control.setpoints import (
    CycleState,
    Finished,
    Hold,
    JointGoal,
    JointVelocity,
    SetPoint,
    SetPointSource,
    ToolPose,
    ToolTwist,
)

__all__ = [
    "CycleState",
    "Finished",
    "Hold",
    "JointGoal",
    "JointVelocity",
    "SetPoint",
    "SetPointSource",
    "ToolPose",
    "ToolTwist",
]
