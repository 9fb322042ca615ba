"""Millimetres given as metres are refused by whatever is calibrated, identified or verified; large arms are not."""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.calibrate.arm import ArmPoints, calibrate_arm, calibrate_world
from armsight.calibrate.handeye import PosePairs, calibrate_eye_in_hand
from armsight.calibrate.identify import Sweeps, identify
from armsight.calibrate.tooltip import MeasuredPoint, calibrate_tooltip
from armsight.errors import Inconsistent
from armsight.kinematics import Arm, dh_arm, fk
from armsight.records import TargetKind, board_target, spot_target
from armsight.verify import Measured
from refusals import refuses

Array = NDArray[np.float64]
MM = 1000.0


def arm(scale: float) -> Arm:
    return dh_arm("two links", [(0.4 * scale, 0.3, 0.2 * scale, 0.0), (0.3 * scale, 0.0, 0.1 * scale, 0.0)])


def readings() -> Array:
    return np.random.default_rng(0).uniform(-1.5, 1.5, (12, 2))


def pivot(scale: float, tip_m: float = 0.18, point: MeasuredPoint | None = None, far: float = 1.0) -> None:
    rng = np.random.default_rng(1)
    R = Rotation.from_rotvec(rng.normal(0.0, 0.4, (20, 3)))
    at = scale * (far * np.array([0.5, 0.1, 0.3]) - R.apply([0.0, 0.0, tip_m]) + rng.normal(0.0, 1e-4, (20, 3)))
    calibrate_tooltip(RigidTransform.from_components(at, R), point=point)


def sweep(scale: float) -> None:
    angles = np.linspace(-1.0, 1.0, 12)
    q = np.concatenate([np.stack([angles, 0.0 * angles], axis=1), np.stack([0.0 * angles, angles], axis=1)])
    noise = np.random.default_rng(3).normal(0.0, 1e-4, (24, 3))
    identify(Sweeps(joint=np.repeat([0, 1], 12), q=q, xyz_m=fk(arm(scale), q)[:, :3, 3] + scale * noise))


def pairs(scale: float) -> None:
    rng = np.random.default_rng(2)
    F = RigidTransform.from_components(
        scale * rng.uniform(0.3, 0.8, (12, 3)), Rotation.from_rotvec(rng.normal(0.0, 0.5, (12, 3)))
    )
    X = RigidTransform.from_components([0.05 * scale, 0.0, 0.1 * scale], Rotation.from_rotvec([0.1, 0.2, 0.3]))
    seen = (F * X).inv() * RigidTransform.from_components([scale, 0.0, 0.0], Rotation.identity())
    calibrate_eye_in_hand(PosePairs(T_base_flange=F, T_camera_target=seen, names=tuple(map(str, range(12)))))


def points(scale: float) -> ArmPoints:
    return ArmPoints(q=readings(), xyz_m=fk(arm(scale), readings())[:, :3, 3])


CASES: dict[str, Callable[[float], object]] = {
    "arm": lambda k: calibrate_arm(arm(k), points(k)),  # both in mm: no ratio tells
    "robot-world": lambda k: calibrate_world(arm(k), points(k)),
    "verify": lambda k: Measured(xyz_m=points(k).xyz_m),
    "tip": pivot,
    "hand-eye": pairs,
    "identify": sweep,
    "board": lambda k: board_target(TargetKind.CHECKERBOARD, 9, 6, 0.025 * k),
    "target": lambda k: spot_target({"A": (0.0, 0.0, 0.0), "B": (0.03 * k, 0.0, 0.0)}),
}


@pytest.mark.parametrize("name", CASES)
def test_millimetres_are_refused_with_the_cure_and_metres_taken(name: str) -> None:
    CASES[name](1.0)
    with refuses(Inconsistent, "millimetres", "1000"):
        CASES[name](MM)


def test_a_tip_in_millimetres_is_refused_where_all_is_near() -> None:
    with refuses(Inconsistent, "tip", "turned"):
        pivot(MM, tip_m=0.018, far=0.05)


def test_a_point_in_millimetres_is_refused_beside_poses_in_metres() -> None:
    with refuses(Inconsistent, "tip", "rests"):
        pivot(1.0, point=MeasuredPoint(xyz_m=np.array([500.0, 100.0, 300.0]), sigma_m=1e-4))


@pytest.mark.parametrize("name", ["arm", "robot-world", "verify", "identify"])
def test_an_arm_of_twenty_metres_is_none_in_millimetres(name: str) -> None:
    CASES[name](20.0)
