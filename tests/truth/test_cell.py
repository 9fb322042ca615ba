"""A whole cell from one recording: the tip within what is claimed, and each fault refused by its own name."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.calibrate.cell import CellResult
from armsight.errors import DataRefused, Degenerate, Inconsistent, NotEnoughData
from armsight.measure.poses.from_spots import measure_spots
from armsight.measure.poses.setup import Setup
from armsight.records import Spots
from refusals import names_it

sys.path.insert(0, str(Path(__file__).parent))
from cell_calibrated import calibrated
from cell_world import CellWorld, make_cell

SECONDS, SEED = 40.0, 1
EXACT_PX = 1e-3


@pytest.fixture(scope="module")
def good() -> tuple[CellWorld, CellResult]:
    world = make_cell(SEED, seconds=SECONDS)
    return world, calibrated(world)


def test_the_tip_is_where_both_cameras_see_it_within_what_is_claimed(good: tuple[CellWorld, CellResult]) -> None:
    world, found = good
    truth, q = world.truth, world.truth.samples
    T = truth.flange(q)
    points = np.einsum("mij,lj->mli", T[:, :3, :3], truth.lights) + T[:, None, :3, 3]
    left, right = (camera.project(points) for camera in (truth.left, truth.right))
    setup, off = Setup(rig=found.rig, target=found.target), []
    for k, tip in enumerate(truth.tips(q)):
        pair = [Spots.of_centres(uv[k], EXACT_PX**2 * np.eye(2)) for uv in (left, right)]
        pose = measure_spots(setup, 0.0, pair[0], pair[1]).pose.T_parent_target
        assert pose is not None
        T_rig = RigidTransform.from_matrix(np.asarray(pose))
        off.append((found.T_base_rig * T_rig).apply(truth.tip_target_m) - tip)
    size = np.linalg.norm(off, axis=1)
    assert np.sqrt(np.mean(size**2)) < 2.8 * found.tip.measured_m  # 95 % of a normal error in space
    assert size.max() < 2e-3


def test_the_tip_is_where_the_joints_say_within_what_is_claimed(good: tuple[CellWorld, CellResult]) -> None:
    world, found = good
    q = world.truth.samples
    T = np.asarray(found.arm.fk(q))
    off = T[:, :3, :3] @ world.truth.tip_target_m + T[:, :3, 3] - world.truth.tips(q)
    assert np.sqrt(np.mean(np.sum(off**2, axis=1))) < 2.8 * found.tip.commanded_m


def test_parameters_are_off_as_far_as_is_claimed(good: tuple[CellWorld, CellResult]) -> None:
    world, found = good
    learned = {one.name: one for one in found.learned}
    z = []
    for side, camera in (("left", world.truth.left), ("right", world.truth.right)):
        names = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
        pairs = [*zip(names, camera.intrinsics.tolist(), strict=True), ("readout_s", camera.readout_s)]
        pairs += [("drift_ppm", camera.drift_ppm)]
        z += [(learned[f"{side}.{name}"].value - true) / learned[f"{side}.{name}"].std for name, true in pairs]
    assert np.abs(z).max() < 5.0
    assert 0.4 < np.sqrt(np.mean(np.square(z))) < 2.0


def test_the_left_camera_is_the_rigs_axes(good: tuple[CellWorld, CellResult]) -> None:
    world, found = good
    true = world.truth.left.T_base_camera
    std = found.std
    assert np.all(np.abs(found.T_base_rig.translation - true[:3, 3]) < 5.0 * np.array(std.translation_m))
    turn = (found.T_base_rig.rotation * Rotation.from_matrix(true[:3, :3]).inv()).as_rotvec()
    assert np.all(np.abs(turn) < 5.0 * np.array(std.rotation_rad))


FAULTS: dict[str, tuple[type[DataRefused], tuple[str, ...]]] = {
    "slipping_target": (Inconsistent, ("target slipped", "Clamp the target")),
    "clock_jump": (Inconsistent, ("clock jumped", "stamps")),
    "wrong_arm": (Inconsistent, ("--model", "of this arm")),
    "degrees": (Inconsistent, ("radians", "degrees")),
    "mirrored": (Inconsistent, ("mirror", "mirroring")),
    "other_day": (Inconsistent, ("never move alike", "of this very recording")),
    "wrong_target": (Inconsistent, ("target's file", "armsight calibrate target")),
    "joint_zero_jump": (Inconsistent, ("joint reading jumped", "encoder")),
    "dark_frames": (NotEnoughData, ("left", "of its frames", "shine all the time")),
    "still_joint": (Degenerate, ("did not move", "every joint turns")),
    "one_camera_blind": (NotEnoughData, ("saw", "see that the target's lights shine")),
}
"""What is planted -> how it is refused: cause and cure. A touched camera is in test_cell_of_many.py, an arm that gives
way in benchmarks/cell.py."""


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_refused_and_the_recording_without_it_is_the_cure(
    good: tuple[CellWorld, CellResult], fault: str
) -> None:
    kind, says = FAULTS[fault]
    world = make_cell(SEED, seconds=SECONDS, fault=fault)
    with pytest.raises(DataRefused) as caught:
        calibrated(world)
    assert good[1].tip.measured_m < 2e-3  # of the same motion without it
    error = caught.value
    assert type(error) is kind, error
    assert error.consequence
    assert error.cure
    for part in says:
        assert part.lower() in str(error).lower(), error
    told = world.truth.told
    if fault in ("clock_jump", "mirrored", "one_camera_blind"):
        assert names_it(error, told["side"])
    if fault in ("still_joint", "joint_zero_jump"):
        assert names_it(error, f"j{int(str(told['joint'])) + 1}")


def test_a_target_whose_file_says_another_size_is_refused_and_its_size_as_built_is_the_cure(
    good: tuple[CellWorld, CellResult],
) -> None:
    world, found = good
    grown = {name: tuple(1.03 * x for x in place) for name, place in world.target.items()}
    with pytest.raises(Inconsistent) as caught:
        calibrated(replace(world, target=grown))
    assert names_it(caught.value, "target", "--model", "as built") and "0.97" in caught.value.cause
    assert abs(found.scale.ratio - 1.0) < 4.0 * found.scale.std


def test_a_missing_camera_is_refused(good: tuple[CellWorld, CellResult]) -> None:
    world, _ = good
    empty = type(world.right)(
        t_s=world.right.t_s,
        frame=np.zeros(0, np.intp),
        uv_px=np.zeros((0, 2)),
        covariance_px2=np.zeros((0, 2, 2)),
        size=world.right.size,
        light=np.zeros(0, np.intp),
    )
    with pytest.raises(NotEnoughData) as caught:
        calibrated(replace(world, right=empty))
    assert names_it(caught.value, "right")


def test_too_short_a_motion_is_refused() -> None:
    world = make_cell(SEED, seconds=15.0)
    with pytest.raises(NotEnoughData) as caught:
        calibrated(world)
    assert "15.0 s" in str(caught.value)
