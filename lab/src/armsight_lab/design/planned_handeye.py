"""How sure a robot-world calibration will be before it is done, and what it adds to the tool's pose in the base."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.calibrate.handeye.known_noise import CONDITION, linearise
from armsight.calibrate.handeye.pairs import components
from armsight.errors import Degenerate
from armsight.fitting import inverse_information
from armsight.fitting.groups import whitener
from armsight.geometry.poses import skew

UNKNOWN = tuple(
    f"{pose}.{part}" for pose in ("T_base_rig", "T_flange_target") for part in ("x", "y", "z", "rx", "ry", "rz")
)
"""The unknowns of planned_handeye, in their order."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RobotNoise:
    """Standard deviations of one component of where the flange truly is: position, and orientation."""

    position_m: float
    orientation_rad: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlannedHandEye:
    """T_base_rig and T_flange_target with what a calibration will leave open of them.

    covariance (12, 12): dt, dw of T_base_rig, then of T_flange_target, from the noise of cameras and robot.
    slopes (12, p): how both follow the p parameters that all camera poses hang on.
    """

    T_base_rig: RigidTransform
    T_flange_target: RigidTransform
    covariance: Array
    slopes: Array


def planned_handeye(
    T_base_rig: RigidTransform,
    T_flange_target: RigidTransform,
    T_base_flange: RigidTransform,
    camera: tuple[Array, Array],
    robot: RobotNoise,
) -> PlannedHandEye:
    """Return what a calibration of a rig beside the arm from n poses T_base_flange will give.

    camera: of the rig's poses of the target, their covariances (n, 6, 6), and how they follow p common parameters
    (n, 6, p). Raises Degenerate where the poses leave something open.
    """
    random, common = camera
    X, Z = components(T_base_rig), components(T_flange_target)
    T_rig_target = T_base_rig.inv() * T_base_flange * T_flange_target
    arrays = (*components(T_base_flange.inv()), *components(T_rig_target))
    at = linearise(arrays, X, Z, 1.0, to_hand=True)
    unit = np.zeros((6, 6))
    unit[:3, :3] = np.eye(3)
    V = random + robot.position_m**2 * unit + robot.orientation_rad**2 * at.L  # (n, 6, 6)
    W = whitener(V, CONDITION)
    J = W @ at.J[:, :, :12]
    information = np.einsum("nia,nib->ab", J, J)
    C, open_ = inverse_information(information, np.diag(information), UNKNOWN)
    if open_:
        raise Degenerate(
            "the planned poses of the arm leave the rig's place open",
            consequence="Nothing can be said of the tool in the arm's base",
            cure="Plan more poses, or a volume in which the target can be turned about two axes",
        )
    # least squares: d unknowns = -C J' W d camera pose
    slopes = -C @ np.einsum("nia,nij,njp->ap", J, W, common)
    return PlannedHandEye(T_base_rig=T_base_rig, T_flange_target=T_flange_target, covariance=C, slopes=slopes)


def tool_slopes(
    known: PlannedHandEye, T_rig_target: RigidTransform, T_flange_tool: RigidTransform
) -> tuple[Array, Array]:
    """Return how T_base_tool = X B Z^-1 T_flange_tool follows the rig's poses B (m, 6, 6), and X and Z (m, 6, 12).

    Each moves as t + dt, Exp(dw) R in its parent's axes.
    """
    RX, _ = components(known.T_base_rig)
    RZ, tZ = components(known.T_flange_target)
    RB, _ = components(T_rig_target)
    m = len(RB)
    tip = np.asarray(T_flange_tool.translation) - tZ  # (3,) from the target, in flange axes
    seen = RB @ (RZ.T @ tip)  # (m, 3): from the target, in rig axes
    place = T_rig_target.translation + seen
    of_camera, of_known = np.zeros((m, 6, 6)), np.zeros((m, 6, 12))
    of_camera[:, :3, :3] = of_camera[:, 3:, 3:] = RX
    of_camera[:, :3, 3:] = RX @ -skew(seen)
    turn = RX @ RB @ RZ.T  # (m, 3, 3): T_base_flange's
    of_known[:, :3, :3] = np.eye(3)
    of_known[:, :3, 3:6] = -skew(place @ RX.T)
    of_known[:, :3, 6:9] = -turn
    of_known[:, :3, 9:] = turn @ skew(tip)
    of_known[:, 3:, 3:6] = np.eye(3)
    of_known[:, 3:, 9:] = -turn
    return of_camera, of_known
