"""Of a target of several lights one is the beacon, in all frames the same one; files and live cameras ask alike."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.measure.poses.from_spots import measure_spots
from armsight.measure.poses.pipeline import Setup
from armsight.ops.identification.beacon_observer import beacon_note, beacon_of
from armsight.ops.identification.solve import beacons
from armsight.optics import Camera, converged_rig
from armsight.records import Spots, spot_target
from refusals import names_it

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


def test_a_target_of_one_light_is_as_before() -> None:
    name, by_frame, notes = beacons(Setup(RIG, spot_target({"A": LIGHTS["A"]})), seen(("A",)))
    assert name == "A" and set(by_frame) == set(FRAMES) - HIDDEN and len(notes) == len(HIDDEN)
    assert beacon_note("A", 1) == ()


def test_a_light_without_a_whole_pose_is_no_beacon_of_several() -> None:
    """Two spots fit several pairs of names: neither is followed."""
    setup, (_, (left, right)) = Setup(RIG, spot_target(LIGHTS)), seen(("A", "B"))[0]
    found = measure_spots(setup, 0.0, left, right)
    assert all(beacon_of(found, name, setup.target) is None for name in LIGHTS)
