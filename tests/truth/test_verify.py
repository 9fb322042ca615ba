"""Injected errors of a simulated arm, found or refused by name. The truth has forward kinematics of its own."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.calibrate.timing.sampling import sampling_times
from armsight.errors import Ambiguous, Inconsistent
from armsight.kinematics import Arm, Joint, JointType, dh_arm, fk, preset
from armsight.records import PoseStatus, TargetPose
from armsight.store import write_poses
from armsight.store.verify_files import read_measured
from armsight.verify import Align, Kind, Measured, Reported, Verification, verify
from armsight.verify.alignment import align
from armsight.verify.model import Mounts
from refusals import refuses

DATA = Path(__file__).parents[3] / "shared" / "data" / "ur10_tmac"
QUARTER = np.pi / 2
TABLE = np.array(  # a, alpha, d, theta of a UR10
    [
        (0.0, QUARTER, 0.1273, 0.0),
        (-0.612, 0.0, 0.0, 0.0),
        (-0.5723, 0.0, 0.0, 0.0),
        (0.0, QUARTER, 0.163941, 0.0),
        (0.0, -QUARTER, 0.1157, 0.0),
        (0.0, 0.0, 0.0922, 0.0),
    ]
)
MIDDLE = np.array([0.0, -1.2, 1.5, -0.5, 1.0, 0.0])
BASE = RigidTransform.from_components([2.0, 1.0, -0.5], Rotation.from_rotvec([0.3, 1.0, -2.0]))
TOOL = RigidTransform.from_components([0.05, -0.08, 0.12], Rotation.from_rotvec([0.5, 0.2, 0.1]))
STD = np.array([1e-4] * 3 + [2e-4] * 3)


def flange(table: np.ndarray, q: np.ndarray) -> np.ndarray:
    """(m, 4, 4): Rz(theta) Tz(d) Tx(a) Rx(alpha), link after link."""
    T = np.tile(np.eye(4), (len(q), 1, 1))
    for (a, alpha, d, theta), angle in zip(table, q.T, strict=True):
        turn = Rotation.from_euler("z", (angle + theta)[:, None]) * Rotation.from_euler("x", alpha)
        step = np.tile(np.eye(4), (len(q), 1, 1))
        step[:, :3, :3] = turn.as_matrix()
        step[:, :3, 3] = np.stack([a * np.cos(angle + theta), a * np.sin(angle + theta), np.full(len(q), d)], axis=1)
        T = T @ step
    return T


def seen(table: np.ndarray, q: np.ndarray, rng: np.random.Generator, t_s: np.ndarray | None = None) -> Measured:
    T = BASE * RigidTransform.from_matrix(flange(table, q)) * TOOL
    noise = rng.normal(0.0, STD, (len(q), 6))
    return Measured(
        xyz_m=T.translation + noise[:, :3],
        rotation=(Rotation.from_rotvec(noise[:, 3:]) * T.rotation).as_matrix(),
        std=np.tile(STD, (len(q), 1)),
        t_s=t_s,
    )


def changed(row: int, column: int, by: float) -> np.ndarray:
    table = TABLE.copy()
    table[row, column] += by
    return table


def arm(known: bool = False) -> Arm:
    rows = TABLE[:, [0, 1, 2, 3]].tolist()
    return dh_arm("ur", rows, **({"T_world_base": BASE, "T_flange_tool": TOOL} if known else {}))


def poses(seed: int, n: int = 40) -> tuple[np.ndarray, np.random.Generator]:
    rng = np.random.default_rng(seed)
    return MIDDLE + rng.uniform(-1.2, 1.2, (n, 6)), rng


def cause_of(result: Verification) -> str:
    assert result.cause is not None
    return result.cause.cause


@pytest.mark.parametrize(("joint", "turned"), [(1, True), (4, False)])
def test_one_wrong_zero_is_named_with_its_value(joint: int, turned: bool) -> None:
    q, rng = poses(joint)
    measured = seen(changed(joint, 3, np.deg2rad(0.4)), q, rng)
    if not turned:
        measured = Measured(xyz_m=measured.xyz_m, std=measured.std)
    result = verify(arm(), Reported(q=q), measured, Align.BOTH)
    assert cause_of(result) == f"joint {joint + 1}" and result.cause is not None
    assert result.cause.kind is Kind.ZERO
    found = result.cause.joints[joint]
    assert found.offset is not None and found.std is not None
    assert abs(found.offset - np.deg2rad(0.4)) < 3.5 * found.std < np.deg2rad(0.05)
    assert [v.judged for v in result.cause.joints] == [False, True, True, True, True, False]
    open_ = {"tool.rx_rad", "tool.ry_rad", "tool.rz_rad"}
    assert set(result.undetermined) == (set() if turned else open_)


def along_the_view(q: np.ndarray, rng: np.random.Generator) -> tuple[Measured, np.ndarray]:
    """Poses whose errors go almost together, along a direction of their own in each: as of cameras that move."""
    T = BASE * RigidTransform.from_matrix(flange(TABLE, q)) * TOOL
    L = rng.standard_normal((len(q), 6, 2)) @ rng.standard_normal((len(q), 2, 6)) + 0.05 * rng.standard_normal(
        (len(q), 6, 6)
    )
    L *= 5.0 * STD[:, None]
    noise = np.einsum("mij,mj->mi", L, rng.standard_normal((len(q), 6)))
    C = L @ L.transpose(0, 2, 1)
    turned = Rotation.from_rotvec(noise[:, 3:]) * T.rotation
    return Measured(xyz_m=T.translation + noise[:, :3], rotation=turned.as_matrix(), covariance=C), C


def test_a_file_gives_the_fit_of_the_poses_in_memory_and_correlations_count(tmp_path: Path) -> None:
    q, rng = poses(3, 24)
    measured, C = along_the_view(q, rng)
    T = RigidTransform.from_components(measured.xyz_m, Rotation.from_matrix(measured.rotation)).as_matrix()
    rows = [
        TargetPose(t_s=float(i), status=PoseStatus.OK, parent="rig", T_parent_target=T[i], covariance=C[i])
        for i in range(len(q))
    ]
    write_poses(tmp_path / "poses.csv", rows)
    file = read_measured(tmp_path / "poses.csv")
    assert np.abs(file.measured.covariance - C).max() < 1e-12 * C.max() and not file.notes
    found = [
        verify(arm(), Reported(q=q), one, Align.BOTH).mounts
        for one in (measured, replace(file.measured, t_s=None), Measured(
            xyz_m=measured.xyz_m, rotation=measured.rotation, std=measured.std
        ))
    ]  # fmt: skip
    off = [np.linalg.norm((one.base * BASE.inv()).translation) for one in found]
    assert np.abs(found[0].vector - found[1].vector).max() < 1e-9
    assert off[0] < 0.5 * off[2]
    columns = (tmp_path / "poses.csv").read_text().splitlines()
    keep = columns[0].split(",").index("cov_x_y")
    (tmp_path / "old.csv").write_text("\n".join(",".join(row.split(",")[:keep]) for row in columns) + "\n")
    old = read_measured(tmp_path / "old.csv")
    assert any("uncorrelated" in note for note in old.notes)
    assert np.allclose(old.measured.covariance, measured.std[:, :, None] ** 2 * np.eye(6), rtol=1e-12, atol=0.0)


def test_a_good_arm_is_not_blamed() -> None:
    q, rng = poses(20)
    result = verify(arm(), Reported(q=q), seen(TABLE, q, rng), Align.BOTH)
    assert cause_of(result) == "measurement" and result.cause is not None
    assert result.cause.measurement_share is not None and result.cause.measurement_share > 0.7
    assert result.deciding is None and not result.rejected


def test_a_wrong_geometry_with_right_zeros_is_the_models() -> None:
    q, rng = poses(30)
    table = TABLE + rng.normal(0.0, [5e-4, 9e-4, 5e-4, 0.0], (6, 4))
    assert cause_of(verify(arm(), Reported(q=q), seen(table, q, rng), Align.BOTH)) == "model"


@pytest.mark.parametrize("joint", [3])
def test_of_a_wrist_that_is_held_straight_neither_of_two_joints_is_named(joint: int) -> None:
    """Joints 4 and 6 turn about one line there; bent by two degrees the wrist tells them apart."""
    table = np.array(
        [
            (0.0, QUARTER, 0.3, 0.0),
            (0.3, 0.0, 0.0, 0.0),
            (0.05, QUARTER, 0.0, 0.0),
            (0.0, -QUARTER, 0.3, 0.0),
            (0.0, QUARTER, 0.0, 0.0),
            (0.0, 0.0, 0.08, 0.0),
        ]
    )
    wrist = dh_arm("wrist", table.tolist(), T_world_base=BASE, T_flange_tool=TOOL)
    knocked = table.copy()
    knocked[joint, 3] += np.deg2rad(0.4)
    causes = []
    for bent in (0.01, 0.03):
        rng = np.random.default_rng(0)
        q = [0.0, -0.6, 0.8, 0.3, 0.0, 0.2] + rng.uniform(-1.0, 1.0, (60, 6)) * [1.0, 0.6, 0.6, 1.0, bent, 1.0]
        causes.append(verify(wrist, Reported(q=q), seen(knocked, q, rng), Align.NONE).cause)
    straight, told = causes
    assert straight is not None
    assert told is not None
    assert straight.cause == "undecided"
    assert "joint 4" in straight.sentence.lower() and "joint 6" in straight.sentence.lower()
    assert told.cause == f"joint {joint + 1}"


def test_two_wrong_zeros_are_several_joints() -> None:
    q, rng = poses(40)
    table = changed(1, 3, 0.005)
    table[3, 3] -= 0.006
    assert cause_of(verify(arm(), Reported(q=q), seen(table, q, rng), Align.BOTH)) == "several joints"


def test_backlash_and_eccentricity_are_told_from_a_zero() -> None:
    q, rng = poses(50, 120)
    way = np.sign(np.diff(q[:, 2], prepend=q[0, 2] - 1.0))
    for extra, kind in ((0.002 * way, Kind.BACKLASH), (0.003 * np.sin(q[:, 2]), Kind.ECCENTRICITY)):
        true = q.copy()
        true[:, 2] += extra
        result = verify(arm(), Reported(q=q), seen(TABLE, true, rng), Align.BOTH)
        assert cause_of(result) == "joint 3" and result.cause is not None
        assert result.cause.kind is kind


def test_a_palletizer_whose_wrist_keeps_level_is_judged_all_the_same() -> None:
    table = np.array(
        [(0.15, QUARTER, 0.5, 0.0), (0.6, 0, 0, 0), (0.55, 0, 0, 0), (0.1, -QUARTER, 0.0, 0.0), (0, 0, 0.1, 0)]
    )
    rng = np.random.default_rng(1)
    q = rng.uniform([-1.5, 0.5, -1.6, 0.0, -2.0], [1.5, 1.5, -0.4, 0.0, 2.0], (80, 5))
    q[:, 3] = -q[:, 1] - q[:, 2]
    true = q.copy()
    true[:, 0] += np.deg2rad(0.1) * np.sin(q[:, 0])
    result = verify(dh_arm("palletizer", table.tolist()), Reported(q=q), seen(table, true, rng), Align.BOTH)
    assert cause_of(result) == "joint 1" and result.cause is not None
    assert result.cause.kind is Kind.ECCENTRICITY


def test_too_few_rows_decide_nothing_and_poses_are_proposed() -> None:
    q, rng = poses(60, 10)
    result = verify(arm(), Reported(q=q), seen(changed(2, 3, 0.002), q, rng), Align.BOTH)
    assert cause_of(result) == "undecided"
    assert result.deciding is not None and result.deciding.shape[1] == 6


def test_joint_errors_are_those_put_in() -> None:
    q, rng = poses(70)
    true = q + rng.normal(0.0, 1e-3, q.shape)
    result = verify(arm(known=True), Reported(q=q), seen(TABLE, true, rng), Align.NONE)
    assert result.joints is not None
    known = result.joints.known
    off = (result.joints.dq - (true - q))[known] / result.joints.std[known]
    assert known.mean() > 0.9
    assert 0.9 < np.sqrt(np.mean(off**2)) < 1.1


def test_foreign_and_repeated_rows_are_named_and_the_others_kept() -> None:
    q, rng = poses(80, 60)
    good = seen(TABLE, q, rng)
    xyz, R = good.xyz_m.copy(), np.array(good.rotation)
    xyz[[5, 17, 18]] = rng.normal(0.0, 1.0, (3, 3))
    xyz[40], R[40] = xyz[39], R[39]
    result = verify(arm(), Reported(q=q), Measured(xyz_m=xyz, rotation=R), Align.BOTH)
    assert [row for row, _ in result.rejected] == [6, 18, 19, 41]
    assert "repeats row 40" in dict(result.rejected)[41]
    assert np.linalg.norm(result.task[:, :3], axis=1).max() < 6e-4


def test_rows_that_a_wrong_zero_throws_far_out_are_not_foreign() -> None:
    q, rng = poses(80, 60)  # row 25 is stretched, beyond all others
    measured = seen(changed(1, 3, np.deg2rad(-0.6)), q, rng)
    nominal = Mounts(base=RigidTransform.identity(), tools=(RigidTransform.identity(),))
    assert [row for row, _ in align(fk(arm(), q), measured, nominal, Align.BOTH).rejected] == [25]
    result = verify(arm(), Reported(q=q), measured, Align.BOTH)
    assert cause_of(result) == "joint 2" and result.rejected == () and len(result.task) == 60


def test_mirrored_millimetres_and_inverted_rotations_are_recognised() -> None:
    q, rng = poses(90, 20)
    good = seen(TABLE, q, rng)
    turned = np.swapaxes(np.array(good.rotation), 1, 2)
    for measured, said in (
        (Measured(xyz_m=good.xyz_m * [1.0, -1.0, 1.0]), "left-handed"),
        (Measured(xyz_m=20.0 * good.xyz_m), "times as far"),
        (Measured(xyz_m=good.xyz_m, rotation=turned), "inverted"),
        (Measured(xyz_m=good.xyz_m[::-1]), "misses half"),
    ):
        with refuses(Inconsistent, said):
            verify(arm(), Reported(q=q), measured, Align.BOTH)


def stream(seed: int, period: float | None = None) -> tuple[Reported, np.ndarray, np.ndarray, np.random.Generator]:
    """Joints at 125 Hz with 1 % lost, times and joint values of measurements at 50 Hz."""
    rng = np.random.default_rng(seed)
    size, rate, phase = rng.uniform(0.05, 0.3, (6, 4)), rng.uniform(0.05, 0.4, (6, 4)), rng.uniform(0, 6, (6, 4))
    if period is not None:
        rate = np.tile([1.0, 1.0, 2.0, 2.0], (6, 1)) / period

    def q_at(t: np.ndarray) -> np.ndarray:
        return np.asarray(MIDDLE + (size * np.sin(2 * np.pi * rate * t[:, None, None] + phase)).sum(axis=2))

    t_q, t_m = np.arange(0.0, 20.0, 0.008), np.arange(2.0, 18.0, 0.02)
    t_q = t_q[rng.random(len(t_q)) > 0.01]
    return Reported(q=q_at(t_q), t_s=t_q), t_m, q_at(t_m), rng


@pytest.mark.parametrize(("seed", "offset", "bursts"), [(2, -4.9, True), (3, 3000.0, False)])
def test_time_offsets_are_found_from_anywhere(seed: int, offset: float, bursts: bool) -> None:
    reported, t_m, q, rng = stream(seed)
    stamps = t_m - offset
    if bursts:
        stamps = np.repeat(stamps[9::10] + rng.normal(0.0, 1e-3, len(t_m) // 10), 10)
    kept = rng.random(len(t_m)) > 0.01
    result = verify(arm(), reported, seen(TABLE, q[kept], rng, stamps[kept]), Align.BOTH)
    clock, times = result.paired.clock, result.paired.times
    assert clock is not None and times is not None
    assert times.bursts is bursts
    assert abs(clock.offset_s - offset) < min(2e-3, 5.0 * clock.std_s)
    assert len(result.task) + len(result.rejected) == kept.sum()
    assert any("larger" in text for text in result.doubts) == (abs(offset) > 20.0)


def test_a_clock_takes_up_nothing_of_a_joint_that_is_off() -> None:
    """Ten seconds of smooth motion: a clock laid by the nominal arm alone is 0.1 ms off, and the zero 4 deviations."""
    rng = np.random.default_rng(5)
    hz, phase = rng.uniform(0.05, 0.45, (4, 6)), rng.uniform(0.0, 2.0 * np.pi, (4, 6))

    def motion(t_s: np.ndarray) -> np.ndarray:
        return MIDDLE + 0.2 * np.sin(2.0 * np.pi * hz * t_s[:, None, None] + phase).sum(axis=1)

    t = np.arange(0.8, 9.0, 0.04)
    measured = seen(changed(2, 3, 7e-3), motion(t), rng, t + 0.43)
    reported = Reported(q=motion(log := np.arange(0.0, 10.0, 0.01)), t_s=log)
    found = verify(arm(), reported, measured, Align.BOTH)
    assert found.cause is not None and found.cause.joint == 2
    assert found.paired.clock is not None and abs(found.paired.clock.offset_s + 0.43) < 4.0 * found.paired.clock.std_s
    assert found.paired.clock.std_s < 5e-5  # 2e-4 where the clock is laid once
    value, std = found.cause.parameters["zero_rad"]
    assert abs(value - 7e-3) < 3.0 * std


def test_a_repeating_motion_another_motion_and_mirrored_streams_are_refused() -> None:
    reported, t_m, q, rng = stream(5, period=4.0)
    short = t_m < 9.0
    with refuses(Ambiguous, "repeats"):
        verify(arm(), reported, seen(TABLE, q[short], rng, t_m[short]), Align.BOTH)
    other, _, _, _ = stream(6)
    _, t_m, q, rng = stream(7)
    measured = seen(TABLE, q, rng, t_m + 500.0)
    with refuses(Inconsistent, "overlap"):
        verify(arm(), other, measured, Align.BOTH)
    own, t_m, q, rng = stream(8)
    mirrored = Measured(xyz_m=seen(TABLE, q, rng).xyz_m * [1.0, 1.0, -1.0], t_s=t_m)
    with pytest.raises(Inconsistent, match="left-handed"):
        verify(arm(), own, mirrored, Align.BOTH)
    back = Reported(q=own.q * [1, 1, 1, -1, 1, 1], t_s=own.t_s)
    with refuses(Inconsistent, "j4", "other way"):
        verify(arm(), back, Measured(xyz_m=seen(TABLE, q, rng).xyz_m, t_s=t_m), Align.BOTH)


def test_stamps_that_are_none_are_refused_and_uneven_bursts_followed() -> None:
    with refuses(Inconsistent, "all 50"):
        sampling_times(np.full(50, 3.0), "the rows")
    with refuses(Inconsistent, "row 4", "falls"):
        sampling_times(np.array([0.0, 0.1, 0.2, 0.15, 0.3]), "the rows")
    rng = np.random.default_rng(0)
    t = 0.01 * np.arange(4000)
    ends = np.unique(rng.integers(0, 4000, 500))
    ends = np.append(ends[ends < 3999], 3999)
    stamps = t[ends[np.searchsorted(ends, np.arange(4000))]]
    found = sampling_times(stamps, "the rows")
    assert found.bursts and (np.diff(found.t_s) > 0.0).all()
    assert np.abs(found.t_s - t).max() < 0.015


@pytest.mark.parametrize("known", [True, False])
def test_zeros_of_small_workspaces_hold_what_lengths_and_axes_may_be(known: bool) -> None:
    off, causes = [], []
    for seed in range(4):
        rng = np.random.default_rng(100 + seed)
        q = MIDDLE + rng.uniform(-0.25, 0.25, (30, 6))
        table = TABLE + rng.normal(0.0, [5e-4, 5e-4, 5e-4, 5e-4], (6, 4))
        how = Align.NONE if known else Align.BOTH
        cause = verify(arm(known), Reported(q=q), seen(table, q, rng), how).cause
        assert cause is not None
        causes.append(cause.cause)
        off += [(v.offset - table[i, 3]) / v.std for i, v in enumerate(cause.joints) if v.offset is not None and v.std]
        if not known:  # the tool is off by a millimetre, and what is left over is a tenth of it
            assert cause.arm_off_m is not None and 5e-4 < cause.arm_off_m < 1e-2
    assert set(causes) <= {"model", "measurement", "undecided"}  # several joints, 16 deviations wrong
    assert len(off) >= 12 and np.sqrt(np.mean(np.square(off))) < 1.5 and np.abs(off).max() < 4.0


@pytest.mark.skipif(not DATA.is_dir(), reason="the real measurements are not beside the project")
def test_series_of_one_real_arm_agree_and_no_joint_is_blamed_for_its_model() -> None:
    file = read_measured(DATA / "configurations.csv")
    assert file.reported is not None
    assert file.reported.q is not None
    half = len(file.measured) // 2
    found = []
    for rows in (np.arange(half), np.arange(half, 2 * half)):
        reported = Reported(q=file.reported.q[file.measured.rows[rows] - 1])
        places = file.measured.take(rows)
        places = Measured(xyz_m=places.xyz_m, rotation=places.rotation)
        found.append(verify(preset("ur10"), reported, places, Align.BOTH).cause)
        alone = verify(preset("ur10"), reported, Measured(xyz_m=places.xyz_m), Align.BOTH).cause
        assert alone is not None
        assert alone.cause == "model"  # joint 2 of all rows, for its gear, before what it leaves was looked at
    first, second = (cause.joints for cause in found if cause is not None)
    for a, b in zip(first[1:5], second[1:5], strict=True):
        assert a.offset is not None and b.offset is not None and a.std and b.std
        assert abs(a.offset - b.offset) < 3.0 * np.hypot(a.std, b.std)


@pytest.mark.skipif(not DATA.is_dir(), reason="the real measurements are not beside the project")
def test_few_poses_of_an_arm_whose_geometry_is_off_blame_no_joint() -> None:
    file = read_measured(DATA / "configurations.csv")
    assert file.reported is not None
    assert file.reported.q is not None
    rows = np.sort(np.random.default_rng(8).permutation(len(file.measured))[:24])
    places = file.measured.take(rows)
    places = Measured(xyz_m=places.xyz_m, rotation=places.rotation)
    found = verify(preset("ur10"), Reported(q=file.reported.q[rows]), places, Align.BOTH)
    assert found.cause is not None
    # joint 2's gear was blamed: of rows left out it takes off more than the geometry can of 24, of all rows far less
    assert found.cause.cause == "model"


@pytest.mark.parametrize(("joint", "kind"), [(0, Kind.BACKLASH), (5, Kind.ECCENTRICITY)])
def test_faults_are_told_of_joints_whose_zero_base_or_tool_take_up(joint: int, kind: Kind) -> None:
    q, rng = poses(90, 120)
    way = np.sign(np.diff(q[:, joint], prepend=q[0, joint] - 1.0))
    true = q.copy()
    true[:, joint] += 0.002 * way if kind is Kind.BACKLASH else 0.002 * np.sin(q[:, joint] + 0.4)
    result = verify(arm(), Reported(q=q), seen(TABLE, true, rng), Align.BOTH)
    assert cause_of(result) == f"joint {joint + 1}" and result.cause is not None
    assert result.cause.kind is kind
    assert not result.cause.joints[joint].judged  # its zero stays open
    assert not result.rejected  # of backlash as of two sets of rows


def test_a_slide_that_runs_long_is_told_by_its_scale() -> None:
    rng = np.random.default_rng(91)
    slide = Joint(name="rail", type=JointType.PRISMATIC, alpha_rad=QUARTER)
    q = np.column_stack([rng.uniform(-1.0, 1.0, 60), poses(92, 60)[0]])
    turned = Rotation.from_euler("x", QUARTER)
    run = RigidTransform.from_components(np.outer(1.003 * q[:, 0], [0.0, 0.0, 1.0]), turned)
    T = BASE * run * RigidTransform.from_matrix(flange(TABLE, q[:, 1:])) * TOOL
    noise = rng.normal(0.0, STD, (60, 6))
    measured = Measured(
        xyz_m=T.translation + noise[:, :3], rotation=(Rotation.from_rotvec(noise[:, 3:]) * T.rotation).as_matrix()
    )
    result = verify(replace(arm(), joints=(slide, *arm().joints)), Reported(q=q), measured, Align.BOTH)
    assert cause_of(result) == "joint 1" and result.cause is not None
    assert result.cause.kind is Kind.SCALE
    value, std = result.cause.parameters["scale_m_per_m"]
    assert abs(value - 0.003) < 3.0 * std < 0.0015
