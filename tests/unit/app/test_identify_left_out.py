"""Joints left out of a live identification: held, told, and never claimed to be known."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from armsight.app.operator.identify_run import entries
from armsight.errors import DeviceFailed, UsageError
from armsight.kinematics import presets
from armsight.ops.identification.left_out import FirstJoints, consequence, first_joints, swept_joints
from armsight.records import JointReading
from armsight.store.arm_file import read_arm
from armsight.store.arm_points import read_sweeps
from loading import module_of
from refusals import names_it, refuses


def of_live_tests() -> Any:
    """The simulated cell of the tests of live identification, which stand beside this file."""
    return module_of(Path(__file__).with_name("test_identify_live.py"))


def true_place(q1: float, q2: float, q3: float) -> np.ndarray:
    """Where the light of Kapucu and Baysec's arm is in world (3,), link by link from its published table."""
    place = np.array([0.0, 0.0, q3])
    place = np.array([0.1, 0.0, -0.05]) + Rotation.from_euler("x", 90, degrees=True).apply(place)
    place = Rotation.from_euler("z", q2).apply(place)
    place = np.array([0.0, 0.0, 1.27]) + Rotation.from_euler("x", 90, degrees=True).apply(place)
    return np.asarray(Rotation.from_euler("z", q1).apply(place))


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """The cell and what came out with joint 3 left out."""
    live, folder = of_live_tests(), tmp_path_factory.mktemp("left-out")
    cell = live.Cell(folder)
    model = live.nearly_right(folder)
    return cell, cell.run(model=model, left_out=(3,), nominal=str(model)), folder


def test_a_joint_left_out_stands_still_and_is_told(done: Any) -> None:
    cell, out, folder = done
    asked = np.array(cell.asked)
    assert np.ptp(asked[:, 2]) == 0.0 and np.ptp(asked[:, :2], axis=0).min() > 1.0
    assert [joint.index for joint in out.joints] == [1, 2] and [one.joint for one in out.left_out] == [3]
    assert out.left_out[0].held_at == pytest.approx(asked[0, 2], abs=1e-3)
    assert names_it(out.notes[0], "joint 3", "left out", "whole robot")
    assert out.plan.notes[0] == out.notes[0], "told before anything moves, too"
    assert read_sweeps(folder / "arm.sweep.csv").n == 2
    assert [one.joint for one in out.plan.sweeps] in ([1, 2], [2, 1])


def test_the_arm_of_the_swept_joints_is_right_while_the_other_stands(done: Any) -> None:
    _, out, folder = done
    arm = read_arm(folder / "arm.yaml")
    assert arm.n == 2 and arm.name == "arm, joints 1 and 2 of 3"
    for q1, q2 in ((0.3, 0.4), (2.0, 1.2), (4.5, -0.2)):
        off_m = arm.fk([q1, q2])[:3, 3] - true_place(q1, q2, out.left_out[0].held_at)
        assert np.linalg.norm(off_m) < 3e-3
    first = out.joints[0]
    assert (
        abs(first.d_m - 1.27) < 4.0 * first.std["d_m"]
        and abs(first.alpha_rad - np.pi / 2) < 4.0 * first.std["alpha_rad"]
    )


def test_only_the_last_joints_can_be_left_out(done: Any) -> None:
    cell, _, _ = done
    assert swept_joints(6, ()) == 6 and swept_joints(6, (6, 5)) == 4 and consequence(6, ()) == ""
    assert names_it(consequence(6, (5, 6)), "joints 5 and 6", "behind joint 4")
    sent = len(cell.asked)
    for wrong, said in (((2,), ("joint 2", "joint 3", "swept")), ((1, 2, 3), "all joints"),
                        ((4,), ("4", "out of 3"))):  # fmt: skip
        with refuses(UsageError, said):
            cell.run(left_out=wrong)
    assert len(cell.asked) == sent


class Arm6:
    """Stands for a robot of six joints that stands where it is told."""

    name, cycle_s, n_joints = "six", 0.01, 6

    def __init__(self) -> None:
        self.q = np.linspace(0.1, 0.6, 6)

    def read(self) -> JointReading:
        return JointReading(q=self.q, t_s=0.0, sequence=0, source=self.name)


def test_a_held_joint_that_moves_ends_it() -> None:
    robot = Arm6()
    first = FirstJoints(robot=robot, m=4)  # type: ignore[arg-type]
    np.testing.assert_array_equal(first.held, [0.5, 0.6])
    np.testing.assert_array_equal(first.read().q, robot.q[:4])
    robot.q = robot.q + np.array([0.3, 0.0, 0.0, 0.0, 0.0, 0.02])
    with refuses(DeviceFailed, "joint 6", "moved"):
        first.read()


def test_the_first_joints_carry_the_tool_where_the_whole_arm_has_it() -> None:
    arm, held = presets.ur10(), np.array([0.4, -1.1])
    first = first_joints(arm, 4, held)
    for q in np.random.default_rng(2).uniform(-2.0, 2.0, (5, 4)):
        np.testing.assert_allclose(first.fk(q), arm.fk(np.concatenate([q, held])), atol=1e-12)


def test_an_entry_that_is_chosen_is_not_held_against_the_model(done: Any) -> None:
    _, out, folder = done
    table = entries(out, read_arm(folder / "model.yaml"))
    chosen = [one for one in table if np.isnan(one.std)]
    assert {one.joint for one in chosen} == {2} and all(np.isnan(one.deviation) for one in chosen)
    assert next(one for one in table if (one.joint, one.name) == (1, "d")).deviation == pytest.approx(-3.0, abs=2.0)
