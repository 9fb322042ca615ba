"""Planned sweeps: expected standard deviations against many identifications, views and limits against projection by
hand."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.calibrate.identify import Sweeps, identify
from armsight.calibrate.identify.plan import Plan, expected_deviations, probe, propose_sweeps
from armsight.calibrate.identify.rough_arm import RoughArm, known_arm, rough_arm
from armsight.kinematics import fk, preset
from armsight.optics import Camera, parallel_rig

Array = NDArray[np.float64]

FU, FV, CX, CY, BASELINE = 757.6, 748.9, 319.5, 239.5, 0.126
RIG = parallel_rig(Camera.pinhole(640, 480, FU, FV, CX, CY), BASELINE)
WHERE = RigidTransform.from_components([2.618, -3.710, 0.785], Rotation.from_euler("ZYX", [36, 0, -90], degrees=True))
BASE = WHERE.inv().as_matrix()
LIMITS = np.array([[-0.5, 5.2], [-0.4, 1.9], [0.3, 1.1]])
START = np.array([0.0, 1.66, 0.97])
SIGMA = 0.2


def pixels(q: Array, where: RigidTransform = WHERE) -> Array:
    """The beacon at the tip of the RRP arm by hand: (m, 2, 2) as [reading, side]."""
    t1, t2, d3 = q.T
    up = np.array([0.0, 0.0, 1.0])
    out = np.stack([np.cos(t1), np.sin(t1), 0.0 * t1], axis=1)  # where the second link points at joint 2 = 0
    side = np.stack([np.sin(t1), -np.cos(t1), 0.0 * t1], axis=1)  # the second axis
    along = np.cos(t2)[:, None] * out + np.sin(t2)[:, None] * up
    slide = np.sin(t2)[:, None] * out - np.cos(t2)[:, None] * up
    xyz = 1.27 * up - 0.05 * side + 0.1 * along + d3[:, None] * slide
    x, y, z = where.inv().apply(xyz).T
    v = FV * y / z + CY
    return np.stack([np.stack([FU * (x - shift) / z + CX, v], axis=1) for shift in (0.0, BASELINE)], axis=1)


def seen(joint: NDArray[np.intp], q: Array, seed: int, sigma: float = SIGMA) -> Sweeps:
    """Readings with noise."""
    uv = pixels(q) + np.random.default_rng(seed).normal(0.0, sigma, (len(q), 2, 2))
    return Sweeps(joint=joint, q=q, xyz_m=np.zeros((len(q), 3)), uv_px=uv)


def rows(plan: Plan) -> tuple[NDArray[np.intp], Array]:
    """Joints and poses of all readings of a plan."""
    joint = np.concatenate([np.full(len(sweep.q), sweep.joint) for sweep in plan.sweeps])
    return joint, np.concatenate([sweep.q for sweep in plan.sweeps])


@pytest.fixture(scope="module")
def arm() -> RoughArm:
    """The arm as it is."""
    return known_arm(preset("stanford-rrp"), BASE, SIGMA)


@pytest.fixture(scope="module")
def plan(arm: RoughArm) -> Plan:
    """The plan for the arm as it is."""
    return propose_sweeps(arm, RIG, LIMITS, START, base=BASE)


def test_the_planned_accuracy_is_what_many_identifications_scatter_by(plan: Plan) -> None:
    joint, q = rows(plan)
    values = []
    for seed in range(40):
        j = identify(seen(joint, q, seed), rig=RIG, base=BASE, sigma=SIGMA).arm.joints
        values.append([j[0].d_m, j[0].a_m, j[0].alpha_rad, j[1].theta_rad, j[1].d_m, j[1].a_m, j[1].alpha_rad])
    one, two, _ = plan.expected
    expected = [one["d_m"], one["a_m"], one["alpha_rad"], two["theta_rad"], two["d_m"], two["a_m"], two["alpha_rad"]]
    ratio = np.std(values, axis=0, ddof=1) / expected
    # a standard deviation from 40 runs is known to 11 %
    assert (ratio > 0.65).all() and (ratio < 1.35).all(), ratio


def test_every_planned_pose_is_within_limits_and_in_both_images(plan: Plan) -> None:
    at = START
    for sweep in plan.sweeps:
        corners = np.vstack([at, sweep.way, sweep.q])
        moves = np.diff(corners, axis=0)
        assert ((np.abs(moves) > 1e-12).sum(axis=1) <= 1).all()
        fine = (corners[:-1, None] + np.linspace(0.0, 1.0, 50)[:, None] * moves[:, None]).reshape(-1, 3)
        assert (fine >= LIMITS[:, 0] - 1e-12).all() and (fine <= LIMITS[:, 1] + 1e-12).all()
        uv = pixels(fine)
        assert (uv > 5.0).all() and (uv < np.array([634.0, 474.0])).all()
        at = sweep.q[-1]
    assert sorted(sweep.joint for sweep in plan.sweeps) == [0, 1, 2]


def test_a_probe_leads_to_nearly_the_plan_of_the_true_arm(plan: Plan) -> None:
    """A tenth of each joint's travel; the slide is given as one, as a straight path does not decide it."""
    q = np.concatenate([probe(LIMITS, START, j, share=share) for j, share in enumerate((0.2, 0.4, 0.4))])
    found = identify(seen(np.repeat([0, 1, 2], 6), q, 0), rig=RIG)
    assert [joint.axis.revolute for joint in found.joints] == [True, True, False]
    rough = rough_arm(found, q, RIG)
    proposed = propose_sweeps(rough, RIG, LIMITS, START, base=BASE)
    truly, _ = expected_deviations(known_arm(preset("stanford-rrp"), BASE, SIGMA), RIG, rows(proposed)[1], BASE)
    for j, key in ((0, "d_m"), (0, "alpha_rad"), (1, "d_m"), (1, "a_m")):
        assert truly[j][key] < 1.5 * plan.expected[j][key], (j, key)
        assert 0.5 < proposed.expected[j][key] / truly[j][key] < 2.0, (j, key)


def test_what_is_hardly_known_is_not_sent_to_the_border(arm: RoughArm) -> None:
    """With doubt about the arm the beacon must be inside the images by three standard deviations of where it may be."""
    longer = parallel_rig(Camera.pinhole(640, 480, 1.5 * FU, 1.5 * FV, CX, CY), BASELINE)
    uncertainty = np.diag([0.01**2] * len(arm.model.names))
    vague = RoughArm(axes=arm.axes, beacon_m=arm.beacon_m, sigma_px=SIGMA, covariance=uncertainty)
    room = []
    for one in (arm, vague):
        uv = 1.5 * (pixels(rows(propose_sweeps(one, longer, LIMITS, START))[1]) - [CX, CY]) + [CX, CY]
        room.append(min(uv.min(), (np.array([639.0, 479.0]) - uv).min()))
    assert 10.0 < room[0] < 30.0 and room[1] > room[0] + 10.0, room


def test_six_joints_with_parallel_and_intersecting_axes_are_told_as_they_will_be_found() -> None:
    tool = RigidTransform.from_translation([0.05, 0.02, 0.1])
    robot = replace(preset("irb120"), T_flange_tool=tool)
    rig = parallel_rig(Camera.pinhole(1280, 960, 1100.0, 1100.0, 639.5, 479.5), 0.2)
    looks = Rotation.from_matrix([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    where = RigidTransform.from_components([2.0, -0.1, 0.6], looks)
    base = where.inv().as_matrix()
    limits = np.array([[-1.2, 1.2], [-0.8, 0.8], [-0.8, 0.5], [-1.5, 1.5], [-1.2, 1.2], [-2.5, 2.5]])
    shown = propose_sweeps(known_arm(robot, base, 0.1), rig, limits, np.full(6, 0.1), base=base)
    joint, q = rows(shown)
    uv = np.stack(rig.project(where.inv().apply(fk(robot, q)[:, :3, 3])), axis=1)
    uv += np.random.default_rng(3).normal(0.0, 0.1, uv.shape)
    found = identify(Sweeps(joint=joint, q=q, xyz_m=np.zeros((len(q), 3)), uv_px=uv), rig=rig, base=base)
    pairs = [
        (expected[key], one.std[key])
        for expected, one in zip(shown.expected, found.joints, strict=True)
        for key in ("a_m", "d_m", "alpha_rad", "theta_rad")
    ]
    both = [expected / claimed for expected, claimed in pairs if np.isfinite(expected) and np.isfinite(claimed)]
    assert len(both) >= 18 and min(both) > 0.7 and max(both) < 1.4, pairs
    assert sum(np.isfinite(expected) != np.isfinite(claimed) for expected, claimed in pairs) <= 1, pairs
