"""The arms known by name against the joints of their public URDFs, and against flange poses known from elsewhere.

The chains are written down from the makers' and ROS-Industrial's descriptions, as numbers; the forward kinematics here
is the test's own. They share no figure with the presets: those come from the makers' tables and drawings.
"""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.kinematics import fk, ik, preset

Array = NDArray[np.float64]
Joint = tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]

H = 1.570796327  # as UR's default_kinematics.yaml writes a quarter turn
PI = 3.141592653589793
Q = PI / 2
Z = (0.0, 0.0, 1.0)
NO_TURN = (0.0, 0.0, 0.0)


def ur(z1: float, x2: float, x3: float, z4: float, y5: float, y6: float) -> list[Joint]:
    """base_link_inertia to wrist_3_link, which is tool0."""
    return [
        ((0.0, 0.0, z1), NO_TURN, Z),
        ((0.0, 0.0, 0.0), (H, 0.0, 0.0), Z),
        ((x2, 0.0, 0.0), NO_TURN, Z),
        ((x3, 0.0, z4), NO_TURN, Z),
        ((0.0, y5, 0.0), (H, 0.0, 0.0), Z),
        ((0.0, y6, 0.0), (H, PI, PI), Z),
    ]


CHAINS: dict[str, tuple[list[Joint], RigidTransform]] = {
    # UniversalRobots/Universal_Robots_ROS2_Description and ros-industrial/universal_robot, ur_description,
    # config/*/default_kinematics.yaml
    "ur3": (ur(0.1519, -0.24365, -0.21325, 0.11235, -0.08535, 0.0819), RigidTransform.identity()),
    "ur5": (ur(0.089159, -0.425, -0.39225, 0.10915, -0.09465, 0.0823), RigidTransform.identity()),
    "ur10": (ur(0.1273, -0.612, -0.5723, 0.163941, -0.1157, 0.0922), RigidTransform.identity()),
    "ur3e": (ur(0.15185, -0.24355, -0.2132, 0.13105, -0.08535, 0.0921), RigidTransform.identity()),
    "ur5e": (ur(0.1625, -0.425, -0.3922, 0.1333, -0.0997, 0.0996), RigidTransform.identity()),
    "ur10e": (ur(0.1807, -0.6127, -0.57155, 0.17415, -0.11985, 0.11655), RigidTransform.identity()),
    "ur16e": (ur(0.1807, -0.4784, -0.36, 0.17415, -0.11985, 0.11655), RigidTransform.identity()),
    # ros-industrial/kuka_experimental, kuka_kr6_support/urdf/kr6r900sixx_macro.xacro: base_link to tool0, which is
    # the controller's FLANGE
    "kr6": (
        [
            ((0.0, 0.0, 0.4), NO_TURN, (0.0, 0.0, -1.0)),
            ((0.025, 0.0, 0.0), NO_TURN, (0.0, 1.0, 0.0)),
            ((0.455, 0.0, 0.0), NO_TURN, (0.0, 1.0, 0.0)),
            ((0.0, 0.0, 0.035), NO_TURN, (-1.0, 0.0, 0.0)),
            ((0.42, 0.0, 0.0), NO_TURN, (0.0, 1.0, 0.0)),
            ((0.08, 0.0, 0.0), NO_TURN, (-1.0, 0.0, 0.0)),
        ],
        RigidTransform.from_rotation(Rotation.from_euler("xyz", (0.0, Q, 0.0))),
    ),
    # IFL-CAMP/iiwa_stack, iiwa_description/urdf/iiwa14.xacro: link_0 to link_ee_kuka
    "iiwa14": (
        [
            ((0.0, 0.0, 0.1575), NO_TURN, Z),
            ((0.0, 0.0, 0.2025), (Q, 0.0, PI), Z),
            ((0.0, 0.2045, 0.0), (Q, 0.0, PI), Z),
            ((0.0, 0.0, 0.2155), (Q, 0.0, 0.0), Z),
            ((0.0, 0.1845, 0.0), (-Q, PI, 0.0), Z),
            ((0.0, 0.0, 0.2155), (Q, 0.0, 0.0), Z),
            ((0.0, 0.081, 0.0), (-Q, PI, 0.0), Z),
        ],
        RigidTransform.from_components((0.0, 0.0, 0.045), Rotation.from_euler("xyz", (PI, PI, PI))),
    ),
    # frankaemika/franka_ros, franka_description/robots/panda_arm.xacro: link0 to link8
    "panda": (
        [
            ((0.0, 0.0, 0.333), NO_TURN, Z),
            ((0.0, 0.0, 0.0), (-Q, 0.0, 0.0), Z),
            ((0.0, -0.316, 0.0), (Q, 0.0, 0.0), Z),
            ((0.0825, 0.0, 0.0), (Q, 0.0, 0.0), Z),
            ((-0.0825, 0.384, 0.0), (-Q, 0.0, 0.0), Z),
            ((0.0, 0.0, 0.0), (Q, 0.0, 0.0), Z),
            ((0.088, 0.0, 0.0), (Q, 0.0, 0.0), Z),
        ],
        RigidTransform.from_translation((0.0, 0.0, 0.107)),
    ),
}


def of_chain(name: str, q: Array) -> Array:
    """T_base_flange (4, 4) of a URDF's joints."""
    joints, flange = CHAINS[name]
    T = RigidTransform.identity()
    for (xyz, rpy, axis), value in zip(joints, q, strict=True):
        T = T * RigidTransform.from_components(xyz, Rotation.from_euler("xyz", rpy))
        T = T * RigidTransform.from_rotation(Rotation.from_rotvec(value * np.array(axis)))
    return np.asarray((T * flange).as_matrix())


@pytest.mark.parametrize("name", CHAINS)
def test_a_preset_is_where_its_public_urdf_puts_it(name: str) -> None:
    """To 1e-9 m and rad: UR's file writes a quarter turn with nine decimals, which is 2e-10 rad on 1.3 m."""
    arm = preset(name)
    rng = np.random.default_rng(3)
    low, high = np.maximum(arm.lower, -PI), np.minimum(arm.upper, PI)
    for q in rng.uniform(low, high, (20, arm.n)):
        np.testing.assert_allclose(fk(arm, q), of_chain(name, q), atol=1e-9)
    assert np.all(arm.lower < arm.upper)
    assert np.abs(arm.chain[1:-1, 9:11])[np.isfinite(arm.chain[1:-1, 9:11])].max() < 2 * PI + 1e-9  # rad, not degrees


@pytest.mark.parametrize(
    ("name", "q", "xyz_m", "within_m"),
    [
        ("ur5e", (0, 0, 0, 0, 0, 0), (-0.8172, -0.2329, 0.0628), 1e-12),  # the controller's display at zero
        ("kr6", (0, -Q, Q, 0, 0, 0), (0.525, 0.0, 0.890), 1e-12),  # KUKA's data sheet, A2 -90, A3 +90 degrees
        ("iiwa14", (0, 0, 0, 0, 0, 0, 0), (0.0, 0.0, 1.306), 1e-12),  # KUKA's drawing: stretched upwards
        # FCI's ready pose; libfranka's O_T_EE there, less the 103.4 mm of the hand
        ("panda", (0, -Q / 2, 0, -1.5 * Q, 0, Q, Q / 2), (0.306891, 0.0, 0.486882 + 0.1034), 1e-6),
    ],
)
def test_a_flange_is_where_it_is_known_to_be(
    name: str, q: tuple[float, ...], xyz_m: tuple[float, ...], within_m: float
) -> None:
    np.testing.assert_allclose(fk(preset(name), np.array(q))[:3, 3], xyz_m, atol=within_m)


@pytest.mark.parametrize("name", [name for name in CHAINS if name not in ("iiwa14", "panda")])
def test_all_solutions_of_a_six_joint_preset_reach_the_pose(name: str) -> None:
    arm = preset(name)
    q = np.array([0.4, -1.1, 1.3, 0.5, 0.8, -0.6])
    T = of_chain(name, q)
    answer = ik(arm, T, q_seed=q)
    assert len(answer.solutions) >= 2
    assert np.abs(answer.solutions[0].q - q).max() < 1e-6
    for solution in answer.solutions:
        np.testing.assert_allclose(of_chain(name, solution.q), T, atol=2e-9)


def test_every_preset_tells_its_source() -> None:
    for name in CHAINS:
        assert len(preset(name).source) > 60
        assert preset(name).name == name
