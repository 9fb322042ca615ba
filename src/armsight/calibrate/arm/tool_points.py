"""Where the tool's points are on the flange, with standard deviations."""

from __future__ import annotations

import numpy as np

from armsight.calibrate.arm.fit import ArmFit
from armsight.calibrate.arm.model import POSE, ArmModel
from armsight.kinematics import ToolPoint


def tool_points(model: ArmModel, fitted: ArmFit) -> tuple[ToolPoint, ...]:
    """Return the places of all points with a name, in flange axes; none where the one point has no name.

    Standard deviations hold the uncertainty of the fitted geometry too; they are infinite where a fit leaves a
    direction open.
    """
    std = fitted.fit.std()
    return tuple(
        ToolPoint(
            name=label,
            xyz_m=np.asarray(model.pose(fitted.p, k).translation),
            std_m=np.array([std.get(f"tool:{label}.{key}", np.inf) for key in POSE[:3]]),
        )
        for k, label in enumerate(model.labels, start=1)
        if label
    )
