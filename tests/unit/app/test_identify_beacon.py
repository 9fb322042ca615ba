"""Of a target of several lights one is the beacon, in all frames the same one; files and live cameras ask alike."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation
from tests.truth import camera_ring
from tests.truth.test_views import setup_of

from armsight.calibrate.identify.chain import Axis
from armsight.calibrate.identify.rough_arm import RoughArm, View
from armsight.clock import ManualClock
from armsight.errors import NotEnoughData
from armsight.measure.poses.from_spots import measure_spots
from armsight.measure.poses.pipeline import Setup
from armsight.ops.identification.beacon_observer import (
    LOST_FRAMES,
    CameraBeaconObserver,
    beacon_note,
    beacon_of,
    reach_m,
)
from armsight.ops.identification.solve import beacons
from armsight.optics import Camera, converged_rig
from armsight.records import Frame, Spots, spot_target
from refusals import names_it, refuses

CAMERA = Camera.pinhole(1280, 720, 1131.0, 1127.0, 643.5, 352.25)
RIG = converged_rig(CAMERA, CAMERA, 0.12, 0.08, -0.08)
LIGHTS = {"A": (-0.04, 0.0, 0.0), "B": (0.03, 0.035, 0.0), "C": (0.015, -0.03, 0.0), "D": (0.06, 0.0, 0.02)}
HIDDEN = {3, 4, 5, 9, 10, 14}
"""Frames in which A is behind the hand, in the left picture."""
FRAMES = range(20)


def poses() -> list[RigidTransform]:
    turns = Rotation.from_rotvec([[0.2, -0.3 + 0.02 * k, 0.03 * k] for k in FRAMES])
    return [RigidTransform.from_components([-0.05 + 0.006 * k, 0.004 * k - 0.03, 0.6], turns[k]) for k in FRAMES]


def seen(names: tuple[str, ...]) -> list[tuple[int, list[Spots]]]:
    """Return the spots of these lights in each frame, in a random order."""
    rng, out = np.random.default_rng(4), []
    for k, T in enumerate(poses()):
        pair = []
        for side in (0, 1):
            shown = [name for name in names if not (name == "A" and side == 0 and k in HIDDEN)]
            uv = RIG.project(T.apply(np.array([LIGHTS[name] for name in shown]).reshape(-1, 3)))[side]
            pair.append(
                Spots.of_centres(uv[rng.permutation(len(uv))] + rng.normal(0.0, 0.03, uv.shape), 9e-4 * np.eye(2))
            )
        out.append((k, pair))
    return out


def test_one_light_of_four_is_followed_where_the_first_is_hidden_at_times() -> None:
    name, by_frame, notes = beacons(Setup(RIG, spot_target(LIGHTS)), seen(tuple(LIGHTS)))
    assert name != "A" and set(by_frame) == set(FRAMES) and notes == []
    truth = np.array([T.apply(LIGHTS[name]) for T in poses()])
    assert np.abs(np.array([one.xyz_m for one in by_frame.values()]) - truth).max() < 1e-3
    left, right = RIG.project(truth)
    assert np.abs(np.array([one.uv_px for one in by_frame.values()]) - np.stack([left, right], axis=1)).max() < 0.3
    assert names_it(beacon_note(name, 4)[0], "4 lights", name)


def test_a_beacon_is_in_view_where_all_within_reach_of_it_is() -> None:
    """Against the projection of a sphere about it; the margin holds what the slope of the projection leaves."""
    axis = Axis(point_m=np.array([0.05, 0.0, 0.7]), direction=np.array([0.0, 0.0, 1.0]), revolute=True)
    arm = RoughArm(axes=(axis,), beacon_m=np.array([0.32, 0.0, 0.7]), sigma_px=0.1)
    q, reach = np.linspace(-np.pi, np.pi, 361), reach_m(spot_target({"A": (0.0, 0.0, 0.0), "B": (0.0, 0.04, 0.0)}))
    away = np.random.default_rng(1).standard_normal((300, 3))
    away *= 0.04 / np.linalg.norm(away, axis=1, keepdims=True)
    centres = np.column_stack([0.05 + 0.27 * np.cos(q), 0.27 * np.sin(q), np.full(len(q), 0.7)])
    uv = np.stack([RIG.project((centres[:, None] + away).reshape(-1, 3))[s].reshape(len(q), -1, 2) for s in (0, 1)])
    inside = np.minimum(uv, np.array([1279.0, 719.0]) - uv).min(axis=(0, 2, 3))
    seen = View.of(arm, RIG, reach).seen(q[:, None])
    assert (inside[seen] > 5.0).all() and seen[inside > 40.0].all() and 60 < seen.sum() < 300
    assert seen.sum() < 0.9 * View.of(arm, RIG).seen(q[:, None]).sum()


def test_a_target_of_one_light_is_as_before() -> None:
    name, by_frame, notes = beacons(Setup(RIG, spot_target({"A": LIGHTS["A"]})), seen(("A",)))
    assert name == "A" and set(by_frame) == set(FRAMES) - HIDDEN and len(notes) == len(HIDDEN)
    assert beacon_note("A", 1) == ()


def test_a_light_without_a_whole_pose_is_no_beacon_of_several() -> None:
    """Two spots fit several pairs of names: neither is followed."""
    setup, (_, (left, right)) = Setup(RIG, spot_target(LIGHTS)), seen(("A", "B"))[0]
    found = measure_spots(setup, 0.0, left, right)
    assert all(beacon_of(found, name, setup.target) is None for name in LIGHTS)


def test_three_live_cameras_show_a_beacon_that_one_misses_and_lose_it_with_one_alone() -> None:
    world = camera_ring.ring(3)
    setup, place = setup_of(world, np.zeros((1, 3))), np.array([[0.02, 0.01, 1.3]])
    uv = world.pixels(place)[0]
    v, u = np.mgrid[:720, :1280]

    def frame(s: int, *, lit: bool) -> Frame:
        bright = 150.0 * lit * np.exp(-0.5 * ((u - uv[s, 0]) ** 2 + (v - uv[s, 1]) ** 2) / 1.5**2)
        return Frame(image=(10.0 + bright).round().astype(np.uint8), t_s=1.0, sequence=0, source=f"c{s}")

    both = [frame(0, lit=True), None, frame(2, lit=True)]
    one = [frame(0, lit=True), frame(1, lit=False), None]
    observer = CameraBeaconObserver(setup, iter([both, *[one] * LOST_FRAMES]), ManualClock())
    seen = observer.observe("here")
    assert seen.uv_px is not None and seen.xyz_m is not None
    assert np.isnan(seen.uv_px[1]).all() and np.abs(seen.uv_px[[0, 2]] - uv[[0, 2]]).max() < 0.05
    assert np.abs(seen.xyz_m - place[0]).max() < 1e-4
    for _ in range(LOST_FRAMES - 1):
        assert observer.observe("here").uv_px is None
    with refuses(NotEnoughData, "lost", "two cameras"):
        observer.observe("here")
