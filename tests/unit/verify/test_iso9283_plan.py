"""The test cube and its motions: geometry as the standard has it, and plans that the arm can really make."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.kinematics import Arm, Coupling, fk, preset
from armsight.store import read_table
from armsight.store.path_file import PLAN_COLUMNS, write_test_plan
from armsight.verify.iso9283 import PlanOptions, TestCube, plan_test
from armsight.verify.iso9283.motions import PLANES, SIDES_M


@pytest.mark.parametrize("plane", PLANES)
def test_the_poses_lie_in_the_plane_on_its_diagonals(plane):
    cube = TestCube(centre_m=[0.5, 0.1, 0.4], side_m=0.4, plane=plane)
    p = cube.points_m
    corners = np.array([cube.corners_m[f"C{i}"] for i in PLANES[plane]])
    diagonal = 0.4 * np.sqrt(3.0)
    np.testing.assert_allclose(p["P1"], cube.centre_m)
    for i, corner in enumerate(corners):
        inset = np.linalg.norm(p[f"P{i + 2}"] - corner) / diagonal
        assert 0.08 <= inset <= 0.12
    assert np.linalg.norm(p["P2"] - p["P4"]) == pytest.approx(0.8 * diagonal)
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    for path in (np.array(list(p.values())), *cube.paths_m.values()):
        np.testing.assert_allclose((path - p["P1"]) @ normal, 0.0, atol=1e-12)


def test_the_paths_have_the_standards_sizes():
    cube = TestCube(centre_m=np.zeros(3), side_m=0.63)
    paths = cube.paths_m
    for name, share in (("large_circle", 0.8), ("small_circle", 0.1)):
        np.testing.assert_allclose(np.linalg.norm(paths[name], axis=1), 0.5 * share * 0.63)
        np.testing.assert_allclose(paths[name][0], paths[name][-1], atol=1e-12)
    assert len(paths["rectangle"]) == 6
    np.testing.assert_allclose(paths["rectangle"][0], paths["rectangle"][-1])
    assert np.abs(np.array(list(paths["large_circle"]))).max() <= 0.63 / 2


@pytest.fixture(scope="module", params=["ur10", "irb120", "korayem6r"])
def planned(request):
    arm = preset(request.param)
    return arm, plan_test(arm)


def test_the_joints_of_a_plan_reach_its_poses_within_limits(planned):
    arm, plan = planned
    assert plan.cube.side_m in SIDES_M
    for motion in plan.motions:
        T = fk(arm, arm.values(motion.q))
        np.testing.assert_allclose(T[:, :3, 3], motion.xyz_m, atol=1e-6)
        wanted = Rotation.from_quat(plan.quat_xyzw).as_matrix()
        np.testing.assert_allclose(T[:, :3, :3], np.tile(wanted, (len(T), 1, 1)), atol=1e-6)
        assert arm.within_limits(motion.q).all()
    assert plan.singularity_distance > 0.0
    assert plan.limit_margin >= 0.0


def test_a_turned_and_lifted_base_carries_the_plan_with_it_and_it_is_written_with_the_controllers_readings(tmp_path):
    arm = preset("irb120")
    base = RigidTransform.from_components([1.0, 2.0, 0.5], Rotation.from_euler("z", 0.7))
    coupled = Arm(
        name="coupled", joints=arm.joints, couplings=(Coupling(joint="j3", by="j2", share=1.0),), T_world_base=base
    )
    here, there = plan_test(arm, PlanOptions(side_m=0.2)), plan_test(coupled, PlanOptions(side_m=0.2))
    for a, b in zip(here.motions, there.motions, strict=True):
        np.testing.assert_allclose(base.apply(a.xyz_m), b.xyz_m, atol=1e-9)
    write_test_plan(tmp_path / "plan.csv", there)
    table = read_table(tmp_path / "plan.csv", PLAN_COLUMNS, text=("tag", "pose"), series="q", blank=("repeats",))
    assert len(table) == sum(len(motion.names) for motion in there.motions)
    readings = table.stacked(table.series("q"))
    np.testing.assert_array_equal(readings, np.concatenate([motion.q for motion in there.motions]))
    T = fk(coupled, coupled.values(readings))
    np.testing.assert_allclose(T[:, :3, 3], table.stacked(("x_m", "y_m", "z_m")), atol=1e-6)
    assert table.text["pose"][:6] == ("P1", "P5", "P4", "P3", "P2", "P1")
    assert set(table.text["tag"]) >= {"poses", "distance", "approach_x", "line", "rectangle", "large_circle"}
