"""Arms that warm up in a run, bases that creep, and healthy arms: what is told. The truth has kinematics of its own."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.kinematics import dh_arm
from armsight.verify import Align, Cause, Measured, Reported, verify

QUARTER = np.pi / 2
UR10 = (  # a, alpha, d
    (0.0, QUARTER, 0.1273),
    (-0.612, 0.0, 0.0),
    (-0.5723, 0.0, 0.0),
    (0.0, QUARTER, 0.163941),
    (0.0, -QUARTER, 0.1157),
    (0.0, 0.0, 0.0922),
)
MIDDLE = np.array([0.0, -1.2, 1.5, -0.5, 1.0, 0.0])
BASE = RigidTransform.from_components([2.0, 1.0, -0.5], Rotation.from_rotvec([0.3, 1.0, -2.0]))
TOOL = RigidTransform.from_translation([0.05, -0.08, 0.12])
STD_M, ROWS = 7e-5, 60
SETTLING = (1.0 - np.exp(-np.linspace(0.0, 1.0, ROWS) / 0.4)) / (1.0 - np.exp(-1.0 / 0.4))


def told(
    seed: int,
    how: Align,
    *,
    ppm: float = 0.0,
    crept_m: float = 0.0,
    off: float = 0.0,
    sag_rad: float = 0.0,
    sorted_: bool = False,
) -> Cause:
    """Return the cause of rows whose lengths grow by ppm, whose base creeps; off: of lengths and angles, m and rad;
    sag_rad: of the second joint where it lies flat."""
    rng = np.random.default_rng(seed)
    q = MIDDLE + rng.uniform(-1.2, 1.2, (ROWS, 6))
    q = q[np.argsort(q[:, 1])] if sorted_ else q
    grown = 1.0 + 1e-6 * ppm * SETTLING
    T = RigidTransform.from_translation(np.outer(SETTLING, [crept_m, 0.0, 0.0]))
    joints = q + sag_rad * np.outer(np.cos(q[:, 1]), [0.0, 1.0, 0.0, 0.0, 0.0, 0.0])
    for (a, alpha, d), angle in zip(UR10, joints.T, strict=True):
        length, height, zero = np.array([a, d, 0.0]) + rng.normal(0.0, off, 3)
        turn = angle + zero
        at = grown[:, None] * np.stack([length * np.cos(turn), length * np.sin(turn), np.full(ROWS, height)], axis=1)
        T = T * RigidTransform.from_components(
            at, Rotation.from_euler("Z", turn[:, None]) * Rotation.from_euler("X", alpha)
        )
    xyz = (BASE * T * TOOL).translation + rng.normal(0.0, STD_M, (ROWS, 3))
    arm = dh_arm("ur", [(a, alpha, d, 0.0) for a, alpha, d in UR10], T_world_base=BASE, T_flange_tool=TOOL)
    measured = Measured(xyz_m=xyz, std=np.tile([STD_M] * 3 + [2e-4] * 3, (ROWS, 1)))
    found = verify(arm, Reported(q=q), measured, how).cause
    assert found is not None
    return found


@pytest.mark.parametrize("how", [Align.BOTH, Align.NONE])
def test_an_arm_that_warms_up_is_told_with_its_growth(how: Align) -> None:
    """20 ppm/K and 22 K: half a millimetre at the end, which was laid to the measurement."""
    cause = told(3, how, ppm=440.0)
    growth, std = cause.parameters["growth"]
    assert cause.cause == "drift" and abs(1e6 * growth - 440.0) < 4e6 * std < 200.0


def test_a_base_that_creeps_is_no_growth() -> None:
    cause = told(4, Align.BOTH, crept_m=5e-4)
    assert cause.cause == "drift" and not cause.parameters


@pytest.mark.parametrize("off", [0.0, 5e-4])
@pytest.mark.parametrize("sorted_", [False, True])
def test_a_healthy_arm_does_not_drift_in_whatever_order_its_poses_come(off: float, sorted_: bool) -> None:
    for seed in range(5):
        cause = told(seed, Align.BOTH if seed % 2 else Align.NONE, off=off, sorted_=sorted_)
        assert cause.cause in ("measurement", "model", "undecided") and "in the run" not in cause.sentence


def test_a_joint_that_sags_does_not_drift_where_its_poses_come_in_order() -> None:
    cause = told(1, Align.BOTH, off=2e-4, sag_rad=1e-3, sorted_=True)
    assert cause.cause != "drift" and "in the run" not in cause.sentence
