"""Guard, servo, teach, play."""

from armsight.control.setpoints import (
    CycleState,
    Finished,
    FlangePose,
    Hold,
    JointGoal,
    JointStep,
    JointVelocity,
    Motion,
    SetPoint,
    SetPointSource,
    ToolPose,
    ToolTwist,
)
from armsight.control.status import RobotStatus
