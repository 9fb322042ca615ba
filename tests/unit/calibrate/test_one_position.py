"""Rows without names: of one place on the tool, or of several; and the names' way into arm.yaml and back."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.calibrate.arm import ArmModel, ArmPoints, Tolerance, calibrate_arm, calibrate_world
from armsight.calibrate.arm.fit import fit_arm, start, tool_points
from armsight.calibrate.arm.plausibility import check_one_position
from armsight.errors import Inconsistent
from armsight.kinematics import Arm, Joint, ToolPoint, fk, in_convention, moved, pose, preset
from refusals import refuses

Array = NDArray[np.float64]

TOOL = np.array([[0.0, 0.03, 0.1], [0.05, -0.02, 0.1], [-0.04, -0.03, 0.12]])
WHERE = RigidTransform.from_components([0.4, -0.2, 0.7], Rotation.from_rotvec([0.3, -0.5, 1.1]))


def seen(arm: Arm, q: Array, at: Array, rng: np.random.Generator, noise_m: float = 1e-4) -> Array:
    """(m, k, 3) of k points of the tool."""
    T = fk(arm, q)
    there = np.einsum("mij,kj->mki", T[:, :3, :3], at) + T[:, None, :3, 3]
    return np.asarray(WHERE.apply(there.reshape(-1, 3))).reshape(len(q), -1, 3) + rng.normal(0.0, noise_m, there.shape)


@pytest.mark.parametrize(("n", "off_deg"), [(12, 0.0), (24, 1.0)])
def test_rows_of_three_places_without_names_are_refused(n: int, off_deg: float) -> None:
    """Three lights at each joint position, and one of the three at each; the arm's zeros off or not."""
    rng = np.random.default_rng(3)
    arm = preset("kr6")
    true = moved(arm, {f"{j.name}.theta_rad": rng.normal() * np.deg2rad(off_deg) for j in arm.joints})
    q = rng.uniform(-0.9, 0.9, (n, 6))
    x = seen(true, q, TOOL, rng)
    together = ArmPoints(q=np.repeat(q, 3, axis=0), xyz_m=x.reshape(-1, 3))
    mixed = ArmPoints(q=q, xyz_m=x[np.arange(n), np.arange(n) % 3])
    for points in (together, mixed):
        with refuses(Inconsistent, "3 places", "point"):
            check_one_position(arm, points)
        with refuses(Inconsistent, "A", "3 places"):
            check_one_position(arm, replace(points, point=tuple("A") * len(points)))
    check_one_position(arm, replace(together, point=tuple("ABC") * n))
    with pytest.raises(Inconsistent, match="3 places"):
        calibrate_world(arm, together)


@pytest.mark.parametrize(("n", "repeats"), [(16, 1), (16, 4), (6, 10)])
@pytest.mark.parametrize("noise_m", [1e-4, 4e-3])
def test_rows_of_one_place_pass_with_noise_and_with_wrong_zeros(n: int, repeats: int, noise_m: float) -> None:
    for seed in range(2):
        rng = np.random.default_rng(seed)
        arm = preset("kr6")
        true = moved(arm, {f"{j.name}.theta_rad": rng.normal() * np.deg2rad(2.0) for j in arm.joints})
        q = np.repeat(rng.uniform(-0.9, 0.9, (n, 6)), repeats, axis=0)
        check_one_position(arm, ArmPoints(q=q, xyz_m=seen(true, q, TOOL[:1], rng, noise_m)[:, 0]))


def test_all_points_of_the_tool_reach_the_arm_with_true_deviations_and_place_a_rig() -> None:
    arm = Arm(name="three", joints=(Joint(name="j1", alpha_rad=np.pi / 2), Joint(name="j2", a_m=0.4), Joint(name="j3")))
    off = []
    for seed in range(5):
        rng = np.random.default_rng(seed)
        q = rng.uniform(-1.2, 1.2, (15, 3))
        points = ArmPoints(
            q=np.repeat(q, 3, axis=0), xyz_m=seen(arm, q, TOOL, rng).reshape(-1, 3), point=tuple("ABC") * 15
        )
        model = ArmModel(arm=arm, labels=points.labels, turned=False)
        found = tool_points(model, fit_arm(model, points, start(model, points), (), Tolerance()))
        assert [point.name for point in found] == ["A", "B", "C"]
        place, std = (np.array([getattr(point, key) for point in found]) for key in ("xyz_m", "std_m"))
        assert (std > 0.0).all()
        off.append((place - TOOL) / std)
    result = calibrate_arm(arm, points, scale=False)
    np.testing.assert_allclose([point.xyz_m for point in result.arm.tool_points], TOOL, atol=1e-3)
    assert 0.7 < np.sqrt(np.mean(np.square(off))) < 1.4
    again = calibrate_world(replace(result.arm, T_world_base=RigidTransform.identity()), points)
    assert again.residual_rms_m < 4e-4
    with refuses(Inconsistent, "D", "A, B, C"):
        calibrate_world(result.arm, replace(points, point=tuple("ABD") * 15))
    with refuses(Inconsistent, "by name"):
        calibrate_world(arm, points)


def test_tool_points_move_with_the_flange_from_one_convention_to_the_other() -> None:
    at = ToolPoint(name="A", xyz_m=np.array([0.01, 0.02, 0.1]), std_m=np.array([1e-4, np.inf, 2e-4]))
    arm = replace(
        preset("puma761"),
        joints=(*preset("puma761").joints[:5], Joint(name="j6", a_m=0.03, alpha_rad=np.pi / 2, d_m=0.1)),
        T_flange_tool=RigidTransform.from_components([0.0, 0.1, 0.2], Rotation.from_rotvec([0.1, 0.2, 0.3])),
        tool_points=(at,),
    )
    q = np.array([0.1, 0.2, -0.3, 0.4, 0.5, 0.6])
    places = []
    for other in (arm, in_convention(arm, "craig"), in_convention(in_convention(arm, "craig"), "standard")):
        T_world_flange = pose(other, q) * other.T_flange_tool.inv()
        places.append(T_world_flange.apply(other.tool_points[0].xyz_m))
    np.testing.assert_allclose(places[1:], places[:1] * 2, atol=1e-12)
    np.testing.assert_allclose(in_convention(arm, "craig").tool_points[0].std_m, [1e-4, 2e-4, np.inf], atol=1e-12)
    with refuses(Inconsistent, "tool points", "A, A"):
        replace(arm, tool_points=(at, at))
    with refuses(Inconsistent, "deviations", "tool point A"):
        replace(at, std_m=np.array([1e-4, -1.0, 0.0]))


@pytest.mark.parametrize(("factor", "said"), [(1.05, "further"), (0.95, "less far")])
def test_a_rig_of_another_scale_than_the_arm_is_not_placed(factor: float, said: str) -> None:
    rng = np.random.default_rng(1)
    arm, q = preset("kr6"), rng.uniform(-0.9, 0.9, (24, 6))
    x = seen(arm, q, np.zeros((1, 3)), rng, 4e-4)[:, 0]
    assert calibrate_world(arm, ArmPoints(q=q, xyz_m=x)).residual_rms_m < 1e-3
    with refuses(Inconsistent, "5", said, "squares"):
        calibrate_world(arm, ArmPoints(q=q, xyz_m=factor * x))
