"""Where the rig was when a frame was exposed: always the same, or carried by the robot."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from scipy.spatial.transform import RigidTransform

from armsight.kinematics import Arm
from armsight.records.motion import JointHistory


class RigPlace(Protocol):
    """Tells T_world_rig at a moment."""

    def __call__(self, t_s: float) -> RigidTransform:
        """Return T_world_rig at t_s. Raises StaleData where it is not known."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StandingRig:
    """A rig beside the robot, or without one."""

    T_world_rig: RigidTransform

    def __call__(self, t_s: float) -> RigidTransform:
        """Return T_world_rig, the same at any moment."""
        return self.T_world_rig


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CarriedRig:
    """A rig on the flange of an arm whose readings come into history; T_flange_rig: by hand-eye calibration."""

    arm: Arm
    history: JointHistory
    T_flange_rig: RigidTransform

    def __call__(self, t_s: float) -> RigidTransform:
        """Return T_world_rig with the joints interpolated to t_s. Raises StaleData where they are not known there."""
        arm = self.arm
        T_world_tool = RigidTransform.from_matrix(arm.fk(arm.values(self.history.at(t_s).q)))
        return T_world_tool * arm.T_flange_tool.inv() * self.T_flange_rig
