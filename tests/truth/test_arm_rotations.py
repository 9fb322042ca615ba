"""Rotations beside positions in an arm's calibration: how much they weigh, and whether they are those of the tool."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from armsight.calibrate.arm import ArmPoints, calibrate_arm
from armsight.errors import BadFile, Inconsistent
from armsight.kinematics import dh_arm, fk
from armsight.store.arm_points import read_arm_points
from armsight.store.verify_files import read_measured
from armsight.verify import Align, Measured, Reported, verify
from refusals import names_it, refuses

Array = NDArray[np.float64]

UR10 = np.array([  # a, alpha, d
    (0.0, np.pi / 2, 0.1273), (-0.612, 0.0, 0.0), (-0.5723, 0.0, 0.0),
    (0.0, np.pi / 2, 0.163941), (0.0, -np.pi / 2, 0.1157), (0.0, 0.0, 0.0922),
])  # fmt: skip
NOMINAL = dh_arm("ur10", [(a, alpha, d, 0.0) for a, alpha, d in UR10])
BASE, BASE_M = Rotation.from_rotvec([0.1, 0.2, 0.9]), np.array([1.0, 2.0, 0.3])
TOOL, TOOL_M = Rotation.from_rotvec([0.3, -0.2, 0.5]), np.array([0.05, 0.02, 0.12])


def chain(lengths: Array, zeros: Array, q: Array) -> tuple[Array, Rotation]:
    """Return where the tool is (m, 3) and how it is turned, in the frame that is measured in."""
    R, x = BASE, np.tile(BASE_M, (len(q), 1))
    for (a, alpha, d), zero, values in zip(lengths, zeros, q.T, strict=True):
        x = x + R.apply([0.0, 0.0, d])
        R = R * Rotation.from_rotvec((values + zero)[:, None] * [0.0, 0.0, 1.0])
        x = x + R.apply([a, 0.0, 0.0])
        R = R * Rotation.from_rotvec([alpha, 0.0, 0.0])
    return x + R.apply(TOOL_M), R * TOOL


def simulated(seed: int, noise_rad: float, m: int = 60, held: int = 200) -> tuple[ArmPoints, Array, Array]:
    """Return measurements of an arm off by 0.3 mm, 0.03 and 0.2 degrees, then readings and true places left out."""
    rng = np.random.default_rng(seed)
    lengths = UR10 + rng.normal(0.0, 1.0, UR10.shape) * [3e-4, 5e-4, 3e-4]
    zeros = rng.normal(0.0, 3e-3, 6)
    q = rng.uniform(-1.5, 1.5, (m + held, 6))
    x, R = chain(lengths, zeros, q)
    turned = (R * Rotation.from_rotvec(rng.normal(0.0, noise_rad, (m + held, 3)))).as_matrix()[:m]
    seen = x[:m] + rng.normal(0.0, 5e-5, (m, 3))
    return ArmPoints(q=q[:m], xyz_m=seen, rotation=turned), q[m:], x[m:]


def test_rotations_better_than_any_arm_turns_its_tool_do_not_rule_the_positions() -> None:
    points, q, truth = simulated(0, 0.0)
    result = calibrate_arm(NOMINAL, points)
    alone = calibrate_arm(NOMINAL, replace(points, rotation=None))
    off, off_alone = (np.linalg.norm(fk(x.arm, q)[:, :3, 3] - truth, axis=1).mean() for x in (result, alone))
    assert off < off_alone < 4e-5  # weighed as they claim they left 0.29 to 0.87 mm
    assert any("any arm" in note for note in result.notes)


def computed(points: ArmPoints) -> ArmPoints:
    """Return the points with rotations that the controller computed: the nominal arm's, to six digits."""
    quat = np.round(chain(UR10, np.zeros(6), points.q)[1].as_quat(), 6)
    return replace(points, rotation=Rotation.from_quat(quat).as_matrix())


def test_rotations_that_the_controller_computed_prove_nothing() -> None:
    points, q, truth = simulated(2, 1e-4)
    result = calibrate_arm(NOMINAL, computed(points))
    alone = calibrate_arm(NOMINAL, replace(points, rotation=None))
    assert [note for note in result.notes if names_it(note, "computed", "left out")]
    assert np.allclose(result.fitted.p, alone.fitted.p)
    assert np.linalg.norm(fk(result.arm, q)[:, :3, 3] - truth, axis=1).mean() < 1e-4


def test_an_arm_is_not_verified_by_rotations_that_it_computed_itself() -> None:
    """Its zeros are off by some tenths of a degree; taken as measured the rotations blame the measurement."""
    points, _, _ = simulated(2, 1e-4)
    seen = computed(points)
    found = verify(NOMINAL, Reported(q=points.q), Measured(xyz_m=seen.xyz_m, rotation=seen.rotation), Align.BOTH)
    assert [doubt for doubt in found.doubts if names_it(doubt, "computed", "left out")]
    assert found.cause is not None and found.cause.cause != "measurement"


def wrong(points: ArmPoints, how: str) -> ArmPoints:
    R = np.array(points.rotation)
    turned = {
        "inverted": R.transpose(0, 2, 1),
        "w first": Rotation.from_quat(np.roll(Rotation.from_matrix(R).as_quat(), 1, axis=1)).as_matrix(),
        "same": np.tile(np.eye(3), (len(R), 1, 1)),
        "other rows": np.roll(R, 1, axis=0),
        "other frame": Rotation.from_rotvec([0.5, 0.2, 1.0]).as_matrix() @ R,
    }
    return replace(points, rotation=turned[how])


@pytest.mark.parametrize(
    ("how", "told"),
    [
        ("inverted", "inverted"),
        ("w first", "w, x, y, z"),
        ("same", "the same in"),
        ("other rows", "0% of the rows"),
        ("other frame", "the positions' frame"),
    ],
)
def test_rotations_that_are_not_the_tools_are_refused_by_name(how: str, told: str) -> None:
    points, _, _ = simulated(1, 1e-4)
    with refuses(Inconsistent, told):
        calibrate_arm(NOMINAL, wrong(points, how))


def test_a_holdout_in_another_frame_is_laid_anew_and_another_arms_is_refused() -> None:
    points, _, _ = simulated(4, 1e-4, m=120)
    points = replace(points, rotation=None)
    rows, held = points.take(np.arange(60)), points.take(np.arange(60, 120))
    moved = replace(held, xyz_m=Rotation.from_rotvec([0.4, 0.1, 2.0]).apply(np.array(held.xyz_m)) + np.ones(3))
    here, there = (calibrate_arm(NOMINAL, rows, holdout=x) for x in (held, moved))
    assert here.gain and there.gain  # 3.35e+03 mm, and no gain, before
    assert there.left_after.mean_m < 1.2 * here.left_after.mean_m < 2e-4
    assert any("another frame" in note for note in there.notes)
    assert not any("another frame" in note for note in here.notes)
    with refuses(Inconsistent, "base", "anew"):
        calibrate_arm(NOMINAL, rows, holdout=replace(held, xyz_m=np.array(held.xyz_m)[::-1]))


def test_columns_that_verify_passes_over_are_read_past_and_slips_are_not(tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    path.write_text("q1,q2,x_m,y_m,z_m,goal_x_m,temperature_c\n0.1,0.2,0.3,0.4,0.5,7,warm\n")
    assert read_arm_points(path).xyz_m.tolist() == [[0.3, 0.4, 0.5]]
    path.write_text("q1,q2,x_m,y_m,z_m,points\n0.1,0.2,0.3,0.4,0.5,A\n")
    with refuses(BadFile, "point", "mean"):
        read_arm_points(path)


def test_a_measured_file_that_verify_takes_is_taken_and_rows_keep_their_numbers(tmp_path: Path) -> None:
    points, _, _ = simulated(4, 1e-4, m=60)
    xyz = np.array(points.xyz_m)
    xyz[50] += 0.05
    rows = [
        [str(k), *map(repr, (*points.q[k].tolist(), *xyz[k].tolist())), "1e-4", "1e-4", "1e-4", "ok"] for k in range(60)
    ]
    rows[3][7:] = ["", "", "", "", "", "", "lost"]
    rows[5][-1] = "doubtful"
    path = tmp_path / "measured.csv"
    header = "t_s,q1,q2,q3,q4,q5,q6,x_m,y_m,z_m,sx_m,sy_m,sz_m,status"
    path.write_text("\n".join([header, *(",".join(row) for row in rows)]) + "\n")
    assert read_measured(path).measured.rows.tolist() == [k + 1 for k in range(60) if k not in (3, 5)]
    read = read_arm_points(path)
    assert len(read) == 58 and read.row is not None and read.row[-1] == 59
    result = calibrate_arm(NOMINAL, replace(read, t_s=None))
    assert 50 in [row for row, _ in result.outlier_rows]
    path.write_text(path.read_text().replace(",lost", ",ok"))  # nothing was measured there, whatever its status says
    assert np.array_equal(read_arm_points(path).q, read.q)


def test_single_wrong_rotations_are_named() -> None:
    points, q, truth = simulated(2, 1e-4)
    R = np.array(points.rotation)
    R[[4, 17]] = R[[17, 4]]
    result = calibrate_arm(NOMINAL, replace(points, rotation=R))
    assert any("rows 5, 18 (2 of 60)" in note for note in result.notes)
    assert np.linalg.norm(fk(result.arm, q)[:, :3, 3] - truth, axis=1).mean() < 5e-5


def test_zeros_off_by_degrees_are_no_reason_to_refuse_rotations_of_a_tool_that_hardly_turns() -> None:
    points, _, _ = simulated(3, 1e-4)
    off = np.deg2rad([2.0, -2.0, 2.0, 2.0, -2.0, 2.0])
    assert calibrate_arm(NOMINAL, replace(points, q=points.q - off)).gain
