"""A known arm corrected from simulated measurements, against the truth and the Cramer-Rao prediction; and on real ones.

The arms are simulated here, by Denavit-Hartenberg matrices of the test's own.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.calibrate.arm import ArmModel, ArmPoints, ArmResult, calibrate_arm, calibrate_world, propose
from armsight.errors import Ambiguous, Inconsistent, NotEnoughData
from armsight.kinematics import Arm, Joint, preset
from armsight.store.arm_points import read_arm_points
from armsight.store.saving import corrections
from refusals import names_it, refuses

Array = NDArray[np.float64]

DATA = Path(__file__).parents[3] / "shared" / "data"
NOISE_M = 1.3e-4
REACH = np.array([1.5, 0.8, 0.8, 2.0, 1.5, 2.5])
WHERE = RigidTransform.from_components([0.4, -0.2, 0.7], Rotation.from_rotvec([0.3, -0.5, 1.1]))

real = pytest.mark.skipif(not DATA.is_dir(), reason="the real measurements are not beside the project")


def flange(rows: Array, q: Array) -> Array:
    """T_base_flange (m, 4, 4) of rows (theta, d, a, alpha) at q (m, n)."""
    T = np.tile(np.eye(4), (len(q), 1, 1))
    for (theta, d, a, alpha), values in zip(rows, q.T, strict=True):
        c, s, ca, sa = np.cos(values + theta), np.sin(values + theta), np.cos(alpha), np.sin(alpha)
        A = np.zeros((len(q), 4, 4))
        A[:, 0], A[:, 1] = (np.stack(row, axis=1) for row in (
            (c, -s * ca, s * sa, a * c), (s, c * ca, -c * sa, a * s)))  # fmt: skip
        A[:, 2], A[:, 3, 3] = (0.0, sa, ca, d), 1.0
        T = T @ A
    return T


def table(arm: Arm) -> Array:
    return np.array([[j.theta_rad, j.d_m, j.a_m, j.alpha_rad] for j in arm.joints])


@dataclass(frozen=True)
class Cell:
    """An arm with zeros off by about 2 degrees and lengths by about 0.5 mm, and a tool with points."""

    arm: Arm
    true: Array
    tools: Array

    def points(self, q: Array, rng: np.random.Generator, noise_m: float = NOISE_M) -> ArmPoints:
        T = WHERE.as_matrix() @ flange(self.true, q)
        x = np.einsum("mij,kj->mki", T[:, :3, :3], self.tools) + T[:, None, :3, 3]
        n = len(self.tools)
        return ArmPoints(
            q=np.repeat(q, n, axis=0),
            xyz_m=x.reshape(-1, 3) + rng.normal(0.0, noise_m, (n * len(q), 3)),
            point=tuple(f"P{k}" for k in range(n)) * len(q),
        )


def cell(rng: np.random.Generator) -> Cell:
    arm = preset("irb120")
    off = rng.normal(size=(arm.n, 4)) * [np.deg2rad(2.0), 5e-4, 5e-4, 0.0]
    return Cell(arm, table(arm) + off, rng.normal([0.0, 0.0, 0.1], 0.08, (3, 3)))


@cache
def calibrated(seed: int) -> tuple[Cell, ArmPoints, ArmResult]:
    """A cell measured at 36 configurations of 3 tool points, what is seen at 100 more, and its calibration."""
    rng = np.random.default_rng(seed)
    made = cell(rng)
    points = made.points(rng.uniform(-1.0, 1.0, (36, 6)) * REACH, rng)
    far = made.points(rng.uniform(-1.0, 1.0, (100, 6)) * REACH, rng)
    return made, far, calibrate_arm(made.arm, points, holdout=far)


def test_left_out_errors_are_what_the_cramer_rao_bound_predicts() -> None:
    """The prediction is the noise and the parameters' doubt at further places."""
    ratios, inside = [], []
    for seed in range(500, 502):
        _, far, result = calibrated(seed)
        assert result.gain and result.level == "geometry"
        assert result.left_before.mean_m > 5e-3
        assert result.fitted.sigma_m == pytest.approx(NOISE_M, rel=0.2)  # 324 coordinates: 4 %, from medians 7 %
        _, J = result.model.predict(result.fitted.p, far)
        assert result.covariance is not None
        A = J[:, :3, [result.model.names.index(name) for name in result.covariance.names]]
        C = np.einsum("mij,jk,mlk->mil", A, result.covariance.matrix, A)
        claimed = C + NOISE_M**2 * np.eye(3)
        e = result.model.errors(result.fitted.p, far)[0]
        ratios.append(np.sqrt(np.mean(np.sum(e**2, axis=1)) / np.mean(np.trace(claimed, axis1=1, axis2=2))))
        inside.append(np.mean(np.einsum("mi,mij,mj->m", e, np.linalg.inv(claimed), e) < 7.815))
    assert np.mean(ratios) < 1.1
    assert 0.91 < np.mean(inside) < 0.985  # 95 %; rows of one calibration hang together


def test_an_elbow_whose_reading_is_absolute_is_found() -> None:
    rng = np.random.default_rng(3)
    made = cell(rng)
    points = made.points(rng.uniform(-1.0, 1.0, (40, 6)) * REACH, rng)
    reading = points.q.copy()
    reading[:, 2] += reading[:, 1]  # the controller shows q3 + q2: the arm turns by q3 - q2 of the readings
    absolute = ArmPoints(q=reading, xyz_m=points.xyz_m, point=points.point)
    result = calibrate_arm(made.arm, absolute)
    names = [joint.name for joint in made.arm.joints]
    assert result.couplings == ((names[2], names[1], -1.0),)
    assert names[2] in result.verdict
    assert result.before.mean_m > 0.05  # without the coupling
    assert result.left_after.mean_m < 3.0 * NOISE_M
    assert calibrated(500)[2].couplings == ()
    # To add to readings: joint 3 turns by its reading minus joint 2's, so its zero is to be added to its own value.
    rows = {row[0]: row for row in (line.split(",") for line in corrections(result).splitlines()[1:])}
    zeros = np.rad2deg(made.true[:, 0] - table(made.arm)[:, 0])
    zeros[2] += zeros[1]
    for name, wanted in zip(names[1:5], zeros[1:5], strict=True):
        assert abs(float(rows[name][1]) - wanted) < max(4.0 * float(rows[name][3]), 0.01), name
    arm = result.arm  # takes the controller's readings, and as a nominal arm asks for them
    np.testing.assert_allclose(arm.values(reading), points.q, atol=1e-12)
    np.testing.assert_allclose(arm.readings(points.q), reading, atol=1e-12)
    again = calibrate_arm(arm, ArmPoints(q=arm.values(reading), xyz_m=points.xyz_m, point=points.point))
    assert again.couplings == () and again.arm.couplings == arm.couplings


def test_zeros_are_found_within_their_deviations_where_all_lengths_are_off_too() -> None:
    """Zeros off by 2 degrees, lengths by 0.5 mm: Hayati's beta must not take a joint zero's place (MATH 4.5)."""
    chi2 = []
    for seed in range(500, 502):
        made, _, result = calibrated(seed)
        assert not set(result.free) & set(dict(result.fixed))
        assert {result.change(name) for name, _ in result.fixed} == {0.0}
        geometry = result.model.names[: result.model.n_geometry]
        assert {name for name in geometry if result.change(name) != 0.0} == set(result.free)
        std, off = result.std(), made.true - table(made.arm)
        names = [joint.name for joint in made.arm.joints]
        zeros = [(f"{name}.theta_rad", true) for name, true in zip(names, off[:, 0], strict=True)]
        free = [(name, true) for name, true in zeros if name in result.free]
        assert [name for name, _ in free] == [f"{name}.theta_rad" for name in names[1:5]]  # the others: base and tool
        assert [name for name in result.free if "beta" in name] == [f"{names[1]}.beta_rad"]  # parallel: joints 2, 3
        assert f"{names[1]}.d_m" in dict(result.fixed)
        chi2 += [((result.change(name) - true) / std[name]) ** 2 for name, true in free]
    assert np.mean(chi2) == pytest.approx(1.0, abs=0.9)  # 8 terms: 1 +- 0.5
    assert max(chi2) < 16.0


def test_beta_is_offered_for_parallel_axes_only_and_in_both_conventions() -> None:
    scara = [Joint(name="s1", a_m=0.3), Joint(name="s2", a_m=0.2, alpha_rad=np.pi), Joint(name="s3", type="prismatic")]
    model = ArmModel(arm=Arm(name="scara", joints=tuple(scara)), labels=("",), turned=False)
    assert model.parallel == ((0, "s1.beta_rad"), (1, "s2.beta_rad"))
    assert model.replaced == ("s1.d_m", "s2.d_m") and "s3.d_m" in model.geometry
    craig = replace(preset("irb120"), convention="craig")
    assert ArmModel(arm=craig, labels=("",), turned=False).parallel == (
        (0, f"{craig.joints[1].name}.beta_rad"),
        (4, f"{craig.joints[5].name}.beta_rad"),
    )


def test_points_of_one_joint_position_are_left_out_together() -> None:
    """Each position's places are all off by the same 5 mm: what only the other points of a position tell is no gain."""
    rng = np.random.default_rng(21)
    arm = preset("irb120")
    made = Cell(arm, table(arm), np.array([[0.05, 0.02, 0.1], [-0.06, 0.01, 0.12], [0.0, 0.05, 0.15]]))
    points = made.points(rng.uniform(-1.0, 1.0, (9, 6)) * REACH, rng)
    assert points.position.tolist() == np.repeat(np.arange(9), 3).tolist()
    off = np.repeat(rng.normal(0.0, 5e-3, (9, 3)), 3, axis=0)
    result = calibrate_arm(arm, replace(points, xyz_m=points.xyz_m + off))
    assert not result.gain
    assert result.cross_before.mean_m > 5e-3


def test_a_holdout_must_prove_the_gain_too() -> None:
    rng = np.random.default_rng(22)
    made = cell(rng)
    points = made.points(rng.uniform(-1.0, 1.0, (30, 6)) * REACH, rng)
    other = Cell(made.arm, table(made.arm), made.tools).points(rng.uniform(-1.0, 1.0, (30, 6)) * REACH, rng)
    result = calibrate_arm(made.arm, points, holdout=other)  # of an arm that is as nominal
    assert not result.gain and result.free == () and result.level == "nominal"
    assert "holdout" in result.verdict and "cross-validation" in result.verdict
    np.testing.assert_array_equal(table(result.arm), table(made.arm))
    with pytest.raises(Inconsistent, match="Q0"):
        named = replace(other, point=tuple(name.replace("P", "Q") for name in other.point))
        calibrate_arm(made.arm, points, holdout=named)


def test_rows_that_are_not_of_the_arm_are_refused_by_number() -> None:
    rng = np.random.default_rng(23)
    made = cell(rng)
    points = made.points(rng.uniform(-1.0, 1.0, (24, 6)) * REACH, rng)
    mirrored = points.xyz_m.copy()
    mirrored[24:48, 0] = 2.2 - mirrored[24:48, 0]  # places of a reflection
    with refuses(Inconsistent, "agree"):
        calibrate_arm(made.arm, replace(points, xyz_m=mirrored))
    with refuses(Inconsistent, "step"):
        calibrate_arm(made.arm, replace(points, q=np.roll(points.q, 3, axis=0)))
    with refuses(Inconsistent, "this arm"):
        calibrate_arm(made.arm, replace(points, xyz_m=rng.normal(0.0, 0.5, points.xyz_m.shape)))


def test_a_lack_of_joint_positions_is_said_as_such() -> None:
    rng = np.random.default_rng(24)
    made = cell(rng)
    q = rng.uniform(-1.0, 1.0, (3, 6)) * REACH
    for positions, said in ((q[[0] * 10], ("30 rows", "1 joint position")), (q[:2], "2 joint positions")):
        with refuses(NotEnoughData, said):
            calibrate_arm(made.arm, made.points(positions, rng))
        with refuses(NotEnoughData, said):
            calibrate_world(made.arm, made.points(positions, rng))
    hardly = np.tile(q[0], (10, 1))
    hardly[:, 0] = np.linspace(0.0, 5e-4, 10)
    with refuses(NotEnoughData, "hardly"):
        calibrate_world(made.arm, made.points(hardly, rng))


def test_a_perfect_arm_is_left_alone_and_gross_rows_are_named() -> None:
    rng = np.random.default_rng(8)
    arm = preset("irb120")
    made = Cell(arm, table(arm), np.array([[0.05, 0.02, 0.1], [-0.06, 0.01, 0.12], [0.0, 0.05, 0.15]]))
    points = made.points(rng.uniform(-1.0, 1.0, (30, 6)) * REACH, rng)
    moved = points.xyz_m.copy()
    moved[[7, 40]] += [[0.02, 0.0, 0.0], [0.0, -0.03, 0.01]]
    result = calibrate_arm(arm, ArmPoints(q=points.q, xyz_m=moved, point=points.point))
    assert not result.gain and result.free == () and "No gain" in result.verdict
    assert [row for row, _ in result.outlier_rows] == [7, 40]
    np.testing.assert_array_equal(table(result.arm), table(arm))


def test_joints_that_did_not_move_tell_nothing() -> None:
    rng = np.random.default_rng(9)
    made = cell(rng)
    q = rng.uniform(-1.0, 1.0, (40, 6)) * REACH
    q[:, 3:] = 0.2
    result = calibrate_arm(made.arm, made.points(q, rng))
    wrist = {f"{joint.name}.{key}" for joint in made.arm.joints[3:5] for key in ("theta_rad", "a_m", "d_m")}
    assert not wrist & set(result.free)
    assert {name for name, _ in result.fixed} >= wrist
    names = [joint.name for joint in made.arm.joints]
    assert result.still == tuple(names[3:])
    assert names_it(dict(result.fixed)[f"{names[3]}.theta_rad"], names[3], "move")


def test_wrong_units_counts_and_rows_are_refused() -> None:
    rng = np.random.default_rng(10)
    made = cell(rng)
    points = made.points(rng.uniform(-1.0, 1.0, (20, 6)) * REACH, rng)
    for factor, unit in ((1000.0, "millimetres"), (100.0, "centimetres")):
        wrong = ArmPoints(q=points.q, xyz_m=factor * points.xyz_m, point=points.point)
        with refuses(Inconsistent, unit):
            calibrate_arm(made.arm, wrong)
    with pytest.raises(Inconsistent, match="degrees"):
        calibrate_arm(made.arm, ArmPoints(q=np.rad2deg(points.q), xyz_m=points.xyz_m, point=points.point))
    with pytest.raises(Inconsistent, match="6 joints"):
        calibrate_arm(made.arm, ArmPoints(q=points.q[:, :5], xyz_m=points.xyz_m, point=points.point))
    with pytest.raises(NotEnoughData):
        calibrate_arm(made.arm, points.take(np.arange(4)))


def test_proposed_positions_are_worth_more_than_random_ones() -> None:
    rng = np.random.default_rng(12)
    made = cell(rng)
    points = made.points(rng.uniform(-0.3, 0.3, (15, 6)) * REACH, rng)
    result = calibrate_arm(made.arm, points, scale=False)
    told = propose(result.model, result.fitted, points, 4)
    assert told.q.shape == (4, 6) and made.arm.within_limits(told.q).all()
    assert all(told.expected_std[name] < told.std_now[name] for name in told.expected_std)

    def size(q: Array) -> float:
        more = calibrate_arm(made.arm, joined(points, made.points(q, np.random.default_rng(1))), scale=False)
        std = more.std()
        return float(np.mean([np.log(std[name]) for name in result.free if name in std]))

    assert size(told.q) < size(rng.uniform(-0.3, 0.3, (4, 6)) * REACH) - 0.3
    assert len(propose(result.model, result.fitted, points, 1, visible=lambda xyz: xyz[:, 2] > 0.7).q) == 1
    with refuses(NotEnoughData, "both cameras"):
        propose(result.model, result.fitted, points, 4, visible=lambda xyz: np.zeros(len(xyz), bool))


def joined(a: ArmPoints, b: ArmPoints) -> ArmPoints:
    return ArmPoints(q=np.concatenate([a.q, b.q]), xyz_m=np.concatenate([a.xyz_m, b.xyz_m]), point=(*a.point, *b.point))


def test_the_rig_is_found_at_the_base_with_true_deviations() -> None:
    arm = preset("irb120")
    chi2 = []
    for seed in range(5):
        rng = np.random.default_rng(seed)
        q = rng.uniform(-1.0, 1.0, (25, 6)) * REACH
        base = flange(table(arm), q)[:, :3, 3]
        seen = WHERE.inv().apply(base) + rng.normal(0.0, 1e-3, (25, 3))
        seen[3] += 0.05
        found = calibrate_world(arm, ArmPoints(q=q, xyz_m=seen))
        assert [row for row, _ in found.rejected_rows] == [3]
        error = np.append(
            found.pose.translation - WHERE.translation, (found.pose.rotation * WHERE.rotation.inv()).as_rotvec()
        )
        chi2.append(error @ np.linalg.solve(found.covariance.matrix, error) / 6.0)
    assert np.mean(chi2) == pytest.approx(1.0, abs=0.5)  # 30 terms: 1 +- 0.26, the noise estimated


def test_the_rig_is_found_where_a_half_of_the_rows_is_wrong() -> None:
    rng = np.random.default_rng(31)
    arm = preset("irb120")
    q = rng.uniform(-1.0, 1.0, (20, 6)) * REACH
    seen = WHERE.inv().apply(flange(table(arm), q)[:, :3, 3]) + rng.normal(0.0, 2e-4, (20, 3))
    mirrored = seen.copy()
    mirrored[10:, 0] = 1.0 - mirrored[10:, 0]
    found = calibrate_world(arm, ArmPoints(q=q, xyz_m=mirrored))
    assert [row for row, _ in found.rejected_rows] == list(range(10, 20))
    np.testing.assert_allclose(found.pose.translation, WHERE.translation, atol=1e-3)
    moved = seen.copy()
    moved[10:] += [0.3, 0.0, 0.1]
    with pytest.raises(Ambiguous, match=r"11-20|1-10"):
        calibrate_world(arm, ArmPoints(q=q, xyz_m=moved))
    with refuses(Inconsistent, "this arm"):
        calibrate_world(arm, ArmPoints(q=np.roll(q, 3, axis=0), xyz_m=seen))


@real
def test_a_real_positioner_is_corrected_as_far_as_it_can_be() -> None:
    base = RigidTransform.from_components([2.2, 0.0, 1.6], Rotation.from_euler("x", 90, degrees=True))
    joints = (Joint(name="j1", alpha_rad=-np.pi / 2), Joint(name="j2", d_m=-0.475, theta_rad=-np.pi / 2))
    arm = Arm(name="positioner", joints=joints, T_world_base=base)
    train, holdout = (read_arm_points(DATA / "positioner" / f"{name}.csv") for name in ("train", "holdout"))
    scales = calibrate_arm(arm, train, holdout=holdout)
    assert scales.gain and scales.left_after.mean_m < 0.365e-3
