"""An unknown arm identified from simulated paths: the truth is built here, by matrices of the test's own."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.calibrate.identify import Identification, Sweeps, identify
from armsight.errors import Inconsistent, NotEnoughData, UsageError
from armsight.kinematics import fk
from armsight.optics import Camera, Rig, parallel_rig
from refusals import refuses

Array = NDArray[np.float64]

CAMERA = Camera.pinhole(640, 480, 757.6, 748.9, 319.5, 239.5)
RIG: Rig = parallel_rig(CAMERA, 0.126)
WHERE = RigidTransform.from_components([2.618, -3.710, 0.785], Rotation.from_euler("ZYX", [36, 0, -90], degrees=True))
"""T_base_rig: the rig of Kapucu and Baysec (2005), 4.5 m from the arm's base."""

Row = tuple[float, float, float, float, bool]
"""theta, d, a, alpha, whether it turns."""


def tip(rows: list[Row], q: Array) -> Array:
    """The beacon at the end of Denavit-Hartenberg rows, in base axes (m, 3)."""
    out = []
    for values in q:
        T = np.eye(4)
        for (theta, d, a, alpha, turns), value in zip(rows, values, strict=True):
            angle, length = (theta + value, d) if turns else (theta, d + value)
            c, s, ca, sa = np.cos(angle), np.sin(angle), np.cos(alpha), np.sin(alpha)
            step = [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, length], [0, 0, 0, 1]]
            T = T @ np.array(step)
        out.append(T[:3, 3])
    return np.array(out)


RRP: list[Row] = [(0.0, 1.27, 0.0, np.pi / 2, True), (0.0, -0.05, 0.1, np.pi / 2, True), (0.0, 0.0, 0.0, 0.0, False)]


def swept(starts: Array, ends: Array, rests: Array, n: int) -> tuple[NDArray[np.intp], Array]:
    """Joint numbers and values: each joint from start to end, the others at its row of rests."""
    joint = np.repeat(np.arange(len(starts)), n)
    q = np.repeat(rests, n, axis=0)
    q[np.arange(len(q)), joint] = np.concatenate([np.linspace(a, b, n) for a, b in zip(starts, ends, strict=True)])
    return joint, q


def rrp_sweeps(sigma_px: float, arc_deg: float, seed: int) -> Sweeps:
    """The rig's own sweeps: 324 degrees, an arc, 46 cm; ten readings each."""
    start = np.array([0.0, np.deg2rad(106.7), 0.6])
    end = np.array([np.deg2rad(324.0), np.deg2rad(106.7 - arc_deg), 1.063])
    rests = np.array([[0.0, np.deg2rad(95.33), 0.9735], [0.0, 0.0, 0.9548], [0.0, np.deg2rad(106.7), 0.0]])
    joint, q = swept(start, end, rests, 10)
    xyz = WHERE.inv().apply(tip(RRP, q))
    uv = np.stack(RIG.project(xyz), axis=1) + np.random.default_rng(seed).normal(0.0, sigma_px, (30, 2, 2))
    return Sweeps(joint=joint, q=q, xyz_m=xyz, uv_px=uv)


def entries(result: Identification) -> Array:
    """d1, a1, d2, a2, alpha2 of an identified RRP arm."""
    j = result.arm.joints
    return np.array([j[0].d_m, j[0].a_m, j[1].d_m, j[1].a_m, j[1].alpha_rad])


@pytest.mark.parametrize(("sigma_px", "arc_deg"), [(0.05, 40.0), (0.2, 60.0), (0.5, 120.0)])
def test_the_rrp_arm_is_found_within_true_deviations(sigma_px: float, arc_deg: float) -> None:
    truth = np.array([1.27, 0.0, -0.05, 0.1, np.pi / 2])
    names = ("j1.d_m", "j1.a_m", "j2.d_m", "j2.a_m", "j2.alpha_rad")
    errors, claimed, distance2 = [], [], []
    for seed in range(12):
        result = identify(rrp_sweeps(sigma_px, arc_deg, seed), rig=RIG, base=WHERE.inv().as_matrix())
        assert [joint.type for joint in result.arm.joints] == ["revolute", "revolute", "prismatic"]
        errors.append(entries(result) - truth)
        std = [joint.std for joint in result.joints]
        claimed.append([std[0]["d_m"], std[0]["a_m"], std[1]["d_m"], std[1]["a_m"], std[1]["alpha_rad"]])
        assert result.arm.covariance is not None
        distance2.append(errors[-1] @ np.linalg.solve(result.arm.covariance.block(names), errors[-1]))
    assert np.mean(distance2) / 5.0 == pytest.approx(1.0, abs=0.55)
    z2 = (np.array(errors) / np.array(claimed)) ** 2
    assert np.mean(z2) == pytest.approx(1.0, abs=0.55)  # 60 values that hang together, the noise found from 30 readings
    if sigma_px == 0.2:
        assert np.percentile(np.abs(errors), 68, axis=0)[0] < 2.5e-3  # d1


def test_of_two_arms_that_the_readings_do_not_tell_apart_the_deviations_cover_both() -> None:
    """A short arc seen from afar: the likelier arm is another than the true one, far beyond what it claims alone."""
    truth = np.array([1.27, 0.0, -0.05, 0.1, np.pi / 2])
    for sigma_px, seed, two in ((1.5, 3, True), (1.5, 16, True), (0.5, 2, False)):
        result = identify(rrp_sweeps(sigma_px, 40.0, seed), rig=RIG, base=WHERE.inv().as_matrix())
        first, second = (one.std for one in result.joints[:2])
        off = np.abs(entries(result) - truth)
        assert any("another arm explains" in note for note in result.notes) == two
        assert (off.max() > 0.3) == two
        claimed = [first["d_m"], first["a_m"], second["d_m"], second["a_m"], second["alpha_rad"]]
        assert (off < 2.5 * np.array(claimed)).all()


def test_the_method_of_the_paper_is_farther_off() -> None:
    ours, theirs = [], []
    for seed in range(8):
        sweeps = rrp_sweeps(0.2, 60.0, seed)
        base = WHERE.inv().as_matrix()
        ours.append(abs(entries(identify(sweeps, rig=RIG, base=base))[0] - 1.27))
        theirs.append(abs(entries(identify(sweeps, rig=RIG, base=base, method="paper"))[0] - 1.27))
    assert np.median(theirs) > 5.0 * np.median(ours)


def random_rows(rng: np.random.Generator, n: int) -> list[Row]:
    """Rows with parallel, intersecting, skew and coincident-free axes, of turning and sliding joints."""
    rows: list[Row] = []
    for _ in range(n):
        alpha = rng.choice([0.0, np.pi / 2, -np.pi / 2, rng.uniform(0.3, 2.8)])
        a = rng.choice([0.0, rng.uniform(0.1, 0.5)]) if alpha else rng.uniform(0.1, 0.5)
        rows.append((rng.uniform(-1, 1), rng.uniform(-0.3, 0.3), a, alpha, bool(rng.random() < 0.7)))
    last = rows[-1]
    rows[-1] = (*last[:2], 0.25, last[3], last[4])  # the beacon is not on the last axis
    return rows


def test_random_arms_move_as_the_true_ones() -> None:
    """Types right wherever decided, and the identified arm's forward kinematics within its noise of the truth."""
    worst = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        rows = random_rows(rng, int(rng.integers(3, 7)))
        n = len(rows)
        turns = np.array([row[4] for row in rows])
        start = np.where(turns, rng.uniform(-1.2, -0.6, n), -0.15)
        end = np.where(turns, rng.uniform(0.8, 1.6, n), 0.25)
        joint, q = swept(start, end, np.tile(rng.uniform(-0.4, 0.4, n), (n, 1)), 12)
        xyz = tip(rows, q)
        noisy = Sweeps(joint=joint, q=q, xyz_m=xyz + rng.normal(0.0, 2e-4, xyz.shape))
        try:
            result = identify(noisy)
        except NotEnoughData as refusal:  # the beacon lies on an axis, or close to it
            assert "did not move" in str(refusal)
            continue
        for found, right in zip(result.joints, turns, strict=True):
            assert not found.decided or found.axis.revolute == right
        further = rng.uniform(start, end, (50, n))
        if all(found.axis.revolute == right for found, right in zip(result.joints, turns, strict=True)):
            off = np.linalg.norm(fk(result.arm, further)[:, :3, 3] - tip(rows, further), axis=1)
            worst.append(float(off.max()) / 2e-4)
    assert len(worst) > 25
    assert np.median(worst) < 6.0 and np.percentile(worst, 90) < 25.0  # readings' noise, enlarged at unseen poses


def test_gross_readings_are_named_and_left_out() -> None:
    sweeps = rrp_sweeps(0.1, 120.0, 4)
    assert sweeps.uv_px is not None
    uv = sweeps.uv_px.copy()
    uv[[5, 17]] += [[[9.0, -7.0], [9.0, -7.0]], [[0.0, 8.0], [0.0, 8.0]]]
    wrong = Sweeps(joint=sweeps.joint, q=sweeps.q, xyz_m=sweeps.xyz_m, uv_px=uv)
    result = identify(wrong, rig=RIG, base=WHERE.inv().as_matrix())
    assert sorted(row for joint in result.joints for row, _ in joint.discarded) == [5, 17]
    assert any("reading 6" in note for note in result.notes)
    assert entries(result)[0] == pytest.approx(1.27, abs=5e-3)


def test_only_the_order_of_the_values_is_used_where_they_are_not_exact() -> None:
    joint, q = swept(np.array([-1.0, -1.0, 0.0]), np.array([1.5, 1.0, 0.4]), np.zeros((3, 3)), 12)
    xyz = tip([(0.0, 0.5, 0.1, np.pi / 2, True), (0.2, 0.0, 0.4, -np.pi / 2, True), (0.0, 0.3, 0.0, 0.0, False)], q)
    rough = q.copy()
    rough[np.arange(36), joint] += np.random.default_rng(0).uniform(-0.03, 0.03, 36)
    noisy = xyz + np.random.default_rng(1).normal(0.0, 1e-4, xyz.shape)
    found = identify(Sweeps(joint=joint, q=rough - 0.0, xyz_m=noisy), increments="order")
    assert found.arm.joints[0].a_m == pytest.approx(0.1, abs=2e-3)
    assert found.arm.joints[1].a_m == pytest.approx(0.4, abs=2e-3)  # of the beacon at rest, which no reading shows
    assert any("order" in note for note in found.notes)
    assert 5e-5 < max(joint.residual_rms_m for joint in found.joints) < 3e-4  # the noise across the paths
    home = Sweeps(joint=joint, q=q, xyz_m=noisy)
    off = fk(found.arm, home.q)[:, :3, 3] - xyz  # its values count from rest, which is at zero here
    assert np.linalg.norm(off, axis=1).max() < 2e-3


def test_sweeps_that_cannot_tell_an_arm_are_refused() -> None:
    sweeps = rrp_sweeps(0.1, 120.0, 0)

    def changed(**more: object) -> Sweeps:
        fields = {"joint": sweeps.joint, "q": sweeps.q, "xyz_m": sweeps.xyz_m, "uv_px": sweeps.uv_px, **more}
        return Sweeps(**fields)  # type: ignore[arg-type]

    both = sweeps.q.copy()
    both[10:20, 0] += np.linspace(0.0, 0.3, 10)
    with refuses(Inconsistent, "joint 1 moves", "sweep", "joint 2"):
        identify(changed(q=both), rig=RIG)
    with pytest.raises(NotEnoughData, match="2 readings"):
        identify(sweeps.take(np.r_[0:20, 20:22]), rig=RIG)
    with refuses(Inconsistent, "joint values"):
        identify(changed(joint=sweeps.joint + 1), rig=RIG)
    still = sweeps.q.copy()
    still[20:, 2] = 0.7
    with refuses(Inconsistent, "not moved"):
        identify(changed(q=still), rig=RIG)
    assert sweeps.uv_px is not None
    resting = sweeps.uv_px.copy()
    resting[10:20] = resting[10] + np.random.default_rng(0).normal(0.0, 0.1, (10, 2, 2))
    with refuses(NotEnoughData, "not move"):
        identify(changed(uv_px=resting), rig=RIG)
    ghost = sweeps.uv_px.copy()
    ghost[5:10] += np.array([60.0, 25.0])
    with refuses(Inconsistent, "line", "circle"):
        identify(changed(uv_px=ghost), rig=RIG)
    degrees = sweeps.q.copy()
    degrees[:, :2] = np.rad2deg(degrees[:, :2])
    with pytest.raises(Inconsistent, match=r"radians|degrees"):
        identify(changed(q=degrees), rig=RIG)
    with pytest.raises(Inconsistent, match=r"radians|degrees"):
        identify(changed(q=degrees), rig=RIG, method="paper")
    slipped = sweeps.q.copy()  # joint 1 gives way by 3 degrees while joint 2 is swept, and does not show it
    slipped[15:20, 0] += np.deg2rad(3.0)
    uv = np.stack(RIG.project(WHERE.inv().apply(tip(RRP, slipped))), axis=1)
    with pytest.raises(Inconsistent, match="joint 2"):
        identify(changed(uv_px=uv + np.random.default_rng(0).normal(0.0, 0.1, uv.shape)), rig=RIG)
    with pytest.raises(UsageError):
        identify(sweeps, rig=RIG, method="guess")
    with pytest.raises(UsageError):
        identify(sweeps, rig=RIG, method="paper", increments="order")


def test_a_joint_that_creeps_through_the_sweep_of_another_is_refused() -> None:
    sweeps = rrp_sweeps(0.1, 120.0, 0)
    creeping = sweeps.q.copy()  # by less than an encoder's noise from one reading to the next
    creeping[10:20, 0] += np.linspace(0.0, 0.015, 10)
    with refuses(Inconsistent, "joint 1 moves", "sweep", "joint 2"):
        identify(Sweeps(joint=sweeps.joint, q=creeping, xyz_m=sweeps.xyz_m, uv_px=sweeps.uv_px), rig=RIG)


def test_several_sweeps_of_a_joint_are_pooled() -> None:
    """Three short arcs of a joint with the next one elsewhere each time tell more than one of them."""
    rows: list[Row] = [(0.1, 0.4, 0.0, np.pi / 2, True), (0.0, 0.1, 0.3, 0.0, True)]
    at = np.linspace(-0.35, 0.35, 8)
    first = [np.column_stack([at, np.full(8, second)]) for second in (-1.0, 0.2, 1.4)]
    second = np.column_stack([np.full(10, 0.1), np.linspace(-1.0, 1.4, 10)])
    q = np.concatenate([*first, second])
    joint = np.repeat([0, 1], [24, 10])
    errors, claimed, alone = [], [], []
    for seed in range(10):
        seen = Sweeps(joint=joint, q=q, xyz_m=tip(rows, q) + np.random.default_rng(seed).normal(0.0, 1e-4, (34, 3)))
        result = identify(seen)
        assert [one.type for one in result.arm.joints] == ["revolute", "revolute"]
        errors.append([result.arm.joints[0].a_m, abs(result.arm.joints[0].alpha_rad) - np.pi / 2])
        claimed.append([result.joints[0].std["a_m"], result.joints[0].std["alpha_rad"]])
        alone.append(identify(seen.take(np.r_[0:8, 24:34])).joints[0].std["a_m"])
        assert result.uncertainty is not None
        further = np.random.default_rng(seed).uniform(-1.0, 1.0, (20, 2))
        places, C = result.uncertainty.positions(further)
        assert np.linalg.norm(places - tip(rows, further), axis=1).max() < 5.0 * np.sqrt(
            C.trace(axis1=1, axis2=2).max()
        )
    z2 = (np.array(errors) / np.array(claimed)) ** 2
    assert np.mean(z2) == pytest.approx(1.0, abs=0.9)  # 20 values, the noise found from 34 readings
    assert np.median(claimed, axis=0)[0] < 0.5 * np.median(alone)
    drifting = q.copy()
    drifting[24:, 0] += np.linspace(0.0, 0.2, 10)
    with refuses(Inconsistent, "joint 1 moves", "sweep", "joint 2"):
        identify(Sweeps(joint=joint, q=drifting, xyz_m=tip(rows, drifting)))
