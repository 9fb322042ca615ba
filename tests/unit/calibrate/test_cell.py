"""The mathematics of a cell's calibration, each part held against a plainer way to the same number."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.calibrate.cell.assignment import moves, tracklets
from armsight.calibrate.cell.calibrate import _alone
from armsight.calibrate.cell.fit import WAVES, CellData, blocks_of, fit_cell
from armsight.calibrate.cell.knowledge import ArmTolerance, default_knowledge
from armsight.calibrate.cell.model import BlockNormals, CellModel, start_vector
from armsight.calibrate.cell.observations import Spots, recording_of
from armsight.calibrate.cell.result import tip_slopes
from armsight.calibrate.cell.rounds import _bearing
from armsight.calibrate.cell.wander import JointDrift
from armsight.geometry import align_points
from armsight.kinematics import fk, preset
from armsight.records import Motion, SpotTrack
from armsight.records.target import Target, TargetKind

LIGHTS = np.array([[0.05, 0.01, 0.08], [-0.04, 0.03, 0.06], [0.0, -0.05, 0.075]])
SIZE = (1280, 720)


def moving(t):
    """Joints (m, 6) of a smooth motion."""
    middle = np.array([0.2, -1.2, 1.5, -1.8, -1.5, 0.3])
    size = np.array([0.25, 0.2, 0.25, 0.35, 0.4, 0.6])
    return middle + size * np.sin(np.outer(t, 0.3 + 0.11 * np.arange(6)) + np.arange(6))


def camera_before(T, aside_m):
    """Return PER_CAMERA's values of a camera that looks at a flange T (4, 4) from before it."""
    axis = T[:3, 2]
    side = np.cross(axis, [0.0, 0.0, 1.0])
    at = T[:3, 3] + 1.1 * axis + aside_m * side / np.linalg.norm(side)
    z = (T[:3, 3] - at) / np.linalg.norm(T[:3, 3] - at)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    turn = Rotation.from_matrix(np.stack([x, np.cross(z, x), z], axis=1)).as_rotvec()
    return np.array([950.0, 952.0, 640.0, 355.0, 0.0, -0.1, 0.02, 1e-3, -1e-3, 0.0, *at, *turn, 0.4, 20.0, 0.02])


@pytest.fixture(scope="module")
def cell():
    """A model with true parameters (P,), whose spots are where the lights would be seen."""
    arm = preset("ur5e")
    log_s, stamps = np.arange(0.0, 32.0, 0.008), np.arange(0.0, 30.0, 1.0 / 30.0)
    track = SpotTrack(
        t_s=stamps,
        frame=np.repeat(np.arange(len(stamps)), 3),
        names=("",) * 3 * len(stamps),
        uv_px=np.tile([640.0, 360.0], (3 * len(stamps), 1)),
        covariance_px2=np.tile(0.01 * np.eye(2), (3 * len(stamps), 1, 1)),
    )
    recording = recording_of(arm, Motion(t_s=log_s, q=moving(log_s)), (track, track), (SIZE, SIZE))
    model = CellModel(recording=recording, lights=("A", "B", "C"))
    T = fk(arm, moving(np.array([15.0])))[0]
    return model, start_vector(model, [camera_before(T, -0.3), camera_before(T, 0.3)], LIGHTS)


def some(model):
    """Spots of all lights in every twentieth frame of both cameras, with lines of their own."""
    every = model.recording.spots
    spots = every.of_lights(np.tile(np.arange(3), len(every) // 3))
    spots = spots.take(spots.frame % 20 == 0)
    line = np.random.default_rng(1).uniform(-0.5, 0.5, len(spots))
    return Spots(**{name: line if name == "line" else getattr(spots, name) for name in Spots.__slots__})


def test_cameras_that_never_look_at_one_moment_are_named(cell):
    model, x = cell
    spots = some(model)

    def alone(kept):
        return _alone(SimpleNamespace(model=model, fit=SimpleNamespace(x=x, spots=spots.take(kept))))

    early = spots.frame < 400
    assert alone(np.ones(len(spots), bool)) == []
    assert alone((spots.side == 0) == early) == ["left", "right"]
    assert alone((spots.side == 0) | (spots.frame > 500)) == []


def test_derivatives_of_the_pixels_are_their_differences(cell):
    model, x = cell
    spots = some(model)
    _, J = model.columns(x, spots)
    for k, name in enumerate(model.names):
        step = np.zeros(len(x))
        step[k] = 1e-2 if name.split(".")[1] in ("fx", "fy", "cx", "cy", "drift_ppm") else 1e-5
        ahead, behind = (model.retract(x, np.zeros(0), sign * step, np.zeros(0))[0] for sign in (1.0, -1.0))
        slope = (model.pixels(ahead, spots) - model.pixels(behind, spots)) / (2.0 * step[k])
        if name.endswith(".sag"):  # the lever is held where the joints rest
            assert np.abs(slope - J[:, :, k]).max() <= 2e-2 * np.abs(slope).max() + 1e-6, name
        else:
            assert np.abs(slope - J[:, :, k]).max() <= 1e-4 * np.abs(slope).max() + 1e-6, name


def test_the_tip_moves_with_the_parameters_as_a_measurement_anew_says(cell):
    model, x = cell
    q, tip, T_flange_target = moving(np.array([14.0, 16.5])), np.array([0.0, 0.02, 0.1]), RigidTransform.identity()
    slopes = tip_slopes(model, x, q, T_flange_target, tip, (0.1, 0.1))
    seen, _ = model.standing(x, q)
    rng = np.random.default_rng(2)
    step = np.zeros(len(x))
    at = [k for k, name in enumerate(model.names) if not model.arm_at <= k < model.lights_at and "skew" not in name]
    step[at] = rng.normal(0.0, 1e-5, len(at))
    moved, _ = model.retract(x, np.zeros(0), step, np.zeros(0))
    for k in range(len(q)):
        # the arm's place by which the changed cell explains the old pixels, by Gauss and Newton over T_base_flange
        T, lights = model.flange(x, q[k : k + 1])[0], model.lights_m(moved)
        pose = np.zeros(6)

        def off(pose, T=T, lights=lights, k=k):
            R = Rotation.from_rotvec(pose[3:]).as_matrix() @ T[:3, :3]
            X = lights @ R.T + T[:3, 3] + pose[:3]
            uv = [model.camera(moved, side).project(model.T_base_camera(moved, side).inv().apply(X)) for side in (0, 1)]
            return (np.stack(uv) - seen[k]).ravel()

        for _ in range(4):
            J = np.stack([(off(pose + e) - off(pose - e)) / 2e-6 for e in 1e-6 * np.eye(6)], axis=1)
            pose = pose - np.linalg.lstsq(J, off(pose), rcond=None)[0]
        R = Rotation.from_rotvec(pose[3:]).as_matrix() @ T[:3, :3]
        on_flange = align_points(lights, LIGHTS).T_a_b.apply(tip)
        found = R @ on_flange + T[:3, 3] + pose[:3]
        before = T[:3, :3] @ tip + T[:3, 3]
        assert np.abs(found - before - slopes.measured[k] @ step).max() < 2e-2 * np.abs(found - before).max() + 1e-9


def test_what_gears_do_wherever_their_joints_come_by_is_within_what_is_claimed(cell):
    model, x = cell
    spots, block = blocks_of(model, x, some(model))
    t = model.times_s(x, spots)
    q, _ = model.recording.log.at(t)
    columns = np.array([model.names.index(f"{joint.name}.theta_rad") for joint in model.arm.arm.joints])
    std, strays = 5e-4, np.zeros((len(spots), 6))
    strays[:, 1] = 5e-4 * np.sin(WAVES[5] * q[:, 1])
    _, J = model.columns(x, spots)
    uv = model.pixels(x, spots) + np.einsum("mik,mk->mi", J[:, :, columns], strays)
    target = Target(kind=TargetKind.SPOTS, names=("A", "B", "C"), xyz_m=LIGHTS)
    data = CellData(
        spots=replace(spots, uv_px=uv),
        block=block,
        scale=(1.0, 1.0),
        wander=JointDrift(
            std=np.full(6, std), time_s=20.0, columns=columns, t_s=np.bincount(block, t) / np.bincount(block)
        ),
    )
    poses = [f"{side}.{name}" for side in ("left", "right") for name in ("tx", "ty", "tz", "rx", "ry", "rz")]
    free = (*poses, "j2.theta_rad", "j3.theta_rad", *model.names[model.lights_at :])
    found = fit_cell(model, x, data, free, default_knowledge(model, x, ArmTolerance(), target))
    at, step = found.places, model.difference(found.x, x)
    along = found.information(model)[np.ix_(at, at)] @ step[at]
    square = along @ step[at]
    # beside what the process in time leaves open, this wave is one of as many of which each may be all of it
    assert along @ found.covariance(model)[np.ix_(at, at)] @ along > 0.95 * (square + square**2 / len(WAVES))


def test_what_a_joint_that_is_held_stiff_does_where_it_gives_way_is_within_what_is_claimed(cell):
    model, x = cell
    spots, block = blocks_of(model, x, some(model))
    soft = x.copy()
    soft[model.names.index("j2.sag")] = 1e-3
    data = CellData(spots=replace(spots, uv_px=model.pixels(soft, spots)), block=block, scale=(1.0, 1.0))
    target = Target(kind=TargetKind.SPOTS, names=("A", "B", "C"), xyz_m=LIGHTS)
    free = (
        "j4.theta_rad",
        *(f"{side}.{name}" for side in ("left", "right") for name in ("tx", "ty", "tz", "rx", "ry")),
    )
    found = fit_cell(model, x, data, free, default_knowledge(model, x, ArmTolerance(), target))
    at, step = found.places, model.difference(found.x, x)
    off, also = (
        np.abs(step[at]) / np.sqrt(np.diag(found.covariance(model, stiff=stiff)))[at] for stiff in (True, False)
    )
    assert off.max() > 5.0  # of what stiff joints leave open
    assert also.max() < 1.5


def test_no_joint_rises_under_the_arms_weight_and_the_arm_that_is_written_is_the_fitted_one(cell):
    """An arm's file has no compliance below nothing: what was fitted with one would be told and never hold."""
    model, x = cell
    spots, block = blocks_of(model, x, some(model))
    risen = x.copy()
    risen[model.names.index("j2.sag")] = -5e-4
    spots = replace(spots, uv_px=model.pixels(risen, spots))
    target = Target(kind=TargetKind.SPOTS, names=("A", "B", "C"), xyz_m=LIGHTS)
    known = default_knowledge(model, x, ArmTolerance(), target)
    free = ("j2.sag", "j4.theta_rad", *(f"right.{name}" for name in ("tx", "ty", "tz", "rx", "ry", "rz")))
    rising = fit_cell(model, x, CellData(spots=spots, block=block, scale=(1.0, 1.0)), free, known)
    found = _bearing(model, rising)
    assert rising.x[model.names.index("j2.sag")] < -1e-4
    arm, q = model.arm.arm_at(model.arm_vector(found.x), None), moving(np.linspace(2.0, 26.0, 9))
    np.testing.assert_allclose(fk(arm, arm.values(q)), model.flange(found.x, q), rtol=0.0, atol=1e-9)


def test_eliminating_the_straying_is_generalised_least_squares():
    rng = np.random.default_rng(3)
    b, m, P, n = 6, 8, 5, 2
    J, r = rng.normal(size=(b, m, P)), rng.normal(size=(b, m))
    normals = BlockNormals(
        A=J.transpose(0, 2, 1) @ J,
        g=np.einsum("bmp,bm->bp", J, r),
        chi2=(r**2).sum(axis=1),
        count=np.full(b, float(m)),
        residuals=r.reshape(-1, 2),
    )
    t_s, columns, std, time_s = np.array([0.0, 1.0, 2.0, 4.0, 5.0, 7.0]), np.array([1, 3]), np.array([0.3, 0.7]), 2.5
    reduced = JointDrift(std=std, time_s=time_s, columns=columns, t_s=t_s).reduced(normals)
    alike = np.exp(-np.abs(t_s[:, None] - t_s) / time_s)
    V = np.eye(b * m)
    for k in range(n):
        B = np.zeros((b * m, b))
        for a in range(b):
            B[a * m : (a + 1) * m, a] = J[a, :, columns[k]]
        V += std[k] ** 2 * B @ alike @ B.T
    flat, every = J.reshape(-1, P), r.ravel()
    W = np.linalg.inv(V)
    np.testing.assert_allclose(reduced.A, flat.T @ W @ flat, rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(reduced.g, flat.T @ W @ every, rtol=1e-8, atol=1e-8)
    wander = JointDrift(std=std, time_s=time_s, columns=columns, t_s=t_s)
    left = wander.left_of(normals, np.einsum("bmp,bm->bp", J, r)[:, :, None])
    np.testing.assert_allclose(left[:, 0], flat.T @ W @ every, rtol=1e-8, atol=1e-8)
    assert reduced.square == pytest.approx(every @ W @ every, rel=1e-8)
    assert reduced.logdet == pytest.approx(np.linalg.slogdet(V)[1], rel=1e-8)


def test_lights_that_pass_each_other_are_not_mixed_up():
    frames = np.arange(120)
    one, two = (
        np.stack([3.0 * frames, 100.0 + 0.0 * frames], axis=1),
        np.stack([360.0 - 3.0 * frames, 102.0 + 0.0 * frames], axis=1),
    )
    uv = np.stack([one, two], axis=1).reshape(-1, 2)
    m = len(uv)
    spots = Spots(
        side=np.zeros(m, np.intp),
        light=np.full(m, -1),
        frame=np.repeat(frames, 2),
        stamp_s=np.repeat(frames / 30.0, 2),
        line=np.zeros(m),
        uv_px=uv,
        covariance_px2=np.tile(0.01 * np.eye(2), (m, 1, 1)),
    )
    ways = tracklets(spots, frames)
    assert ways
    for rows in ways:
        assert len(set((rows % 2).tolist())) == 1


def test_a_lamp_that_jumps_where_a_camera_is_hit_does_not_move_as_the_arm_does():
    t = np.arange(900) / 30.0
    noise = np.random.default_rng(5).normal(0.0, 0.2, (900, 2))
    lamp = 300.0 + np.where(t < 14.0, 0.0, 12.0)[:, None] + noise
    # goes on for a second and rests for two, as an arm does that is taught by hand
    on_arm = 300.0 + 40.0 * np.floor(t / 3.0 + 2.0 / 3.0)[:, None] * [1.0, 0.5] + noise
    assert not moves(lamp)
    assert moves(on_arm)
    assert not moves(lamp[:450])
