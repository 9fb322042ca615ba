"""Nominal figures of another arm are called so: by simulated arms of the test's own, and by real ones.

Simulated by matrices of the test's own, at a maker's tolerance (0.3 mm, 0.05 deg), zeros off by 0.3 deg, 0.1 mm of
noise. False alarms and misses over many arms are counted by `benchmarks/other_arm.py`.
"""

from __future__ import annotations

import csv
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.calibrate.arm import ArmPoints, Tolerance, calibrate_arm
from armsight.errors import Inconsistent
from armsight.kinematics import Arm, in_convention, preset
from armsight.store.arm_points import read_arm_points
from refusals import names_it, refuses

Array = NDArray[np.float64]

DATA = Path(__file__).parents[3] / "shared" / "data"
WHERE = RigidTransform.from_components([0.4, -0.2, 0.7], Rotation.from_rotvec([0.3, -0.5, 1.1])).as_matrix()
TOOL = np.array([0.03, -0.05, 0.12])

real = pytest.mark.skipif(not DATA.is_dir(), reason="the real measurements are not beside the project")


def measured(arm: Arm, seed: int, *, n: int = 24, off_m: Array | float = 3e-4, scale: float = 1.0) -> ArmPoints:
    """A tool point at n joint positions of an arm built to a tolerance; scale: joint 1 turns so much further."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(np.maximum(arm.lower, -1.4), np.minimum(arm.upper, 1.4), (n, arm.n))
    T = np.tile(WHERE, (n, 1, 1))
    for k, joint in enumerate(in_convention(arm, "standard").joints):
        a, d = (value + rng.normal() * off_m for value in (joint.a_m, joint.d_m))
        alpha = joint.alpha_rad + rng.normal() * np.deg2rad(0.05)
        theta = joint.sign * q[:, k] * (scale if k == 1 else 1.0) + joint.theta_rad + rng.normal() * np.deg2rad(0.3)
        c, s, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
        zero, one = np.zeros(n), np.ones(n)
        rows = ((c, -s * ca, s * sa, a * c), (s, c * ca, -c * sa, a * s), (zero, sa * one, ca * one, d * one))
        A = np.zeros((n, 4, 4))
        A[:, :3], A[:, 3, 3] = np.array(rows).transpose(2, 0, 1), 1.0
        T = T @ A
    return ArmPoints(q=q, xyz_m=T[:, :3, :3] @ TOOL + T[:, :3, 3] + rng.normal(0.0, 1e-4, (n, 3)))


def typed(name: str, joint: int, **values: float) -> Arm:
    arm = preset(name)
    changed = tuple(replace(j, **values) if k == joint else j for k, j in enumerate(arm.joints, 1))  # type: ignore[arg-type]
    return replace(arm, name="own", joints=changed)


@pytest.mark.parametrize(
    ("built", "nominal", "name", "wanted_m"),
    [("ur5e", preset("ur5"), "j4.d_m", 0.1333), ("ur5e", typed("ur5e", 2, a_m=-0.452), "j2.a_m", -0.425)],
)
def test_another_arms_figures_are_no_gain_and_the_wrong_one_is_named(
    built: str, nominal: Arm, name: str, wanted_m: float
) -> None:
    result = calibrate_arm(nominal, measured(preset(built), 2))
    other = result.other_arm
    assert other is not None and not result.gain
    assert other.found[0].name == name
    assert abs(other.found[0].wanted - wanted_m) < 1.5e-3 and other.found[0].std < 1e-3
    assert other.known is None or other.known[0] == built
    assert names_it(result.verdict, "nominal", name)
    assert result.free == () and [j.a_m for j in result.arm.joints] == [j.a_m for j in nominal.joints]


def test_figures_of_quite_another_arm_are_refused_with_its_name() -> None:
    with refuses(Inconsistent, "panda"):
        calibrate_arm(preset("iiwa14"), measured(preset("panda"), 2))


def test_a_joint_with_other_gears_is_told() -> None:
    result = calibrate_arm(preset("kr6"), measured(preset("kr6"), 3, n=30, scale=1.012))
    assert result.other_arm is not None and [item.name for item in result.other_arm.found] == ["j2.scale"]
    assert abs(result.other_arm.found[0].wanted - 1.012) < 5e-4
    assert re.search(r"\bj2 .* 1\.2\d* .*% more", result.verdict)


def test_a_length_that_is_believed_so_is_corrected() -> None:
    own = typed("irb120", 2, a_m=0.21)  # like no arm known by name
    nominal = replace(own, joints=(*own.joints[:3], replace(own.joints[3], d_m=0.313), *own.joints[4:]))
    points = measured(own, 3, n=30)
    refused = calibrate_arm(nominal, points, scale=False)
    assert refused.other_arm is not None and "--tolerance-mm 5" in refused.verdict
    believed = calibrate_arm(nominal, points, tolerance=Tolerance(length_m=5e-3), scale=False)
    assert believed.gain and abs(believed.change("j4.d_m") + 0.011) < 1e-3


@real
def test_a_real_ur10_is_no_ur10e() -> None:
    with (DATA / "ur10_tmac" / "grid.csv").open() as file:
        rows = list(csv.DictReader(file))[::80]
    q = np.array([[float(row[f"q{k}"]) for k in range(1, 7)] for row in rows])
    points = ArmPoints(q=q, xyz_m=np.array([[float(row[key]) for key in ("x_m", "y_m", "z_m")] for row in rows]))
    right = calibrate_arm(preset("ur10"), points, scale=False)
    assert right.gain and right.left_after.mean_m < 0.6e-3
    wrong = calibrate_arm(preset("ur10e"), points, scale=False)
    assert not wrong.gain and wrong.other_arm is not None
    assert wrong.other_arm.known is not None and wrong.other_arm.known[0] == "ur10"
    assert wrong.other_arm.found[0].name == "j4.d_m" and abs(wrong.other_arm.found[0].wanted - 0.163941) < 1.5e-3


@real
def test_noisy_poses_of_a_real_ur10e_are_not_of_a_ur10() -> None:
    """Without the question a gain: 12 mm to 4 mm, by turning joint 1 by 0.8 % more than it says."""
    wrong = calibrate_arm(preset("ur10"), read_arm_points(DATA / "ur10_positions" / "points.csv"))
    assert not wrong.gain and wrong.other_arm is not None
    assert wrong.other_arm.known is not None and wrong.other_arm.known[0] == "ur10e"
