"""Scenarios: the papers' numbers come out, faults happen on command, what cannot be is refused by its key."""

from __future__ import annotations

import copy
from collections.abc import Callable
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml

from armsight.errors import ArmsightError, BadFile
from armsight.ops.simulation.run import simulate
from armsight.store import read_rig, read_target
from armsight.store.arm_file import read_arm
from armsight.store.rigs import read_world
from armsight.store.tracks import read_joints, read_poses
from armsight_sim.scenario_builder import build_world
from armsight_sim.scenario_schema import Scenario
from armsight_sim.world import World


@cache
def content(name: str) -> dict[str, Any]:
    """A scenario's content in the dark, as ideal cameras see it: rooms have tests of their own."""
    found: dict[str, Any] = yaml.safe_load((files("armsight_sim") / "scenarios" / f"{name}.yaml").read_text())
    found["cameras"]["pipeline"], found["room"] = "ideal", "dark"
    return found


def world(name: str, frames: int | None = None, change: Callable[[dict[str, Any]], None] | None = None) -> World:
    mapping = copy.deepcopy(content(name))
    if change is not None:
        change(mapping)
    made: World = build_world(Scenario.model_validate(mapping), frames=frames)
    return made


def centroids(image: np.ndarray, level: int = 60) -> np.ndarray:
    """Centres of the lit patches of an image, weighted by light, from left to right."""
    grey = image.astype(float)
    count, labels = cv2.connectedComponents((image > level).astype(np.uint8))
    found = []
    for label in range(1, count):
        v, u = np.nonzero(cv2.dilate((labels == label).astype(np.uint8), np.ones((9, 9))))
        if (labels == label).sum() < 4:
            continue
        weight = np.clip(grey[v, u] - np.median(grey), 0.0, None)
        found.append([weight @ u / weight.sum(), weight @ v / weight.sum()])
    return np.array(sorted(found))


def test_a_complex_image_holds_both_views_where_the_rays_say() -> None:
    def still(mapping: dict[str, Any]) -> None:
        mapping["arm"]["vibration"]["amplitude_m"] = 0.0

    made = world("pachidis2005-static", frames=1, change=still)
    spots = centroids(made.frame(0, "image").image, level=40)
    expected = np.vstack([made.cameras[s].centres_px(made.lights, made.path, 0.0) for s in ("left", "right")])
    expected = expected[np.argsort(expected[:, 0])]
    assert len(spots) == 6
    gaps = np.linalg.norm(spots[:, None] - expected[None], axis=2).min(axis=1)
    assert gaps.max() < 0.15  # a centroid of a noisy patch


def shutter(mapping: dict[str, Any]) -> None:
    mapping["cameras"].update(readout_s=0.016, exposure_s=0.0)
    mapping["cameras"]["sensor"].update(hot_pixels=0)
    mapping["motion"].update(period_s=[1.0] * 6)


def test_a_rolling_shutter_sees_each_row_at_its_own_time() -> None:
    made = world("webcam-cell", frames=5, change=shutter)
    camera = made.cameras["left"]
    t_s = 3 / made.fps
    spots = centroids(made.frame(3, "left").image)
    now = camera.centres_px(made.lights, made.path, t_s)
    now = now[np.argsort(now[:, 0])]
    rows = [
        camera.centres_px(made.lights, made.path, t_s + 0.016 * (v / 719 - 0.5))[:, None] for v in spots[:, 1].tolist()
    ]
    then = np.array([at[np.argmin(np.linalg.norm(at[:, 0] - s, axis=1)), 0] for at, s in zip(rows, spots, strict=True)])
    assert np.abs(spots - then).max() < 0.15
    shift = np.linalg.norm(then - now, axis=1)
    assert shift.max() > 0.2, "the light moves too little for the test to tell"
    assert np.linalg.norm(spots - now, axis=1).max() > 0.5 * shift.max()


def with_event(**event: Any) -> Callable[[dict[str, Any]], None]:
    def change(mapping: dict[str, Any]) -> None:
        mapping["events"] = [{"at_s": 0.05, "for_s": 0.1, **event}]

    return change


def test_dropped_frames_leave_gaps_in_the_numbers() -> None:
    made = world("webcam-cell", frames=12, change=with_event(kind="dropped", side="right"))
    assert made.kept == (0, 1, 2, 9, 10, 11)
    assert [f[0].sequence for f in made.frames()] == [0, 1, 2, 9, 10, 11]

    def busy(mapping: dict[str, Any]) -> None:
        mapping["cameras"]["drop"] = 0.1

    lost = 1.0 - len(world("webcam-cell", frames=300, change=busy).kept) / 300
    assert lost == pytest.approx(1.0 - 0.9**2, abs=0.07)


WRONG: dict[str, tuple[str, Callable[[dict[str, Any]], Any], str]] = {
    "an unknown key": (
        "webcam-cell",
        lambda m: m["cameras"].update(exposure_ms=4.0),
        "cameras.exposure_ms.*exposure_s",
    ),
    "a number that is none": ("webcam-cell", lambda m: m.update(fps=float("nan")), "fps"),
    "both cameras in one place": (
        "webcam-cell",
        lambda m: m["cameras"]["right"]["T_rig_camera"].update(xyz_m=[0.0, 0.0, 0.0]),
        "T_rig_camera",
    ),
    "a sweep beyond the range": (
        "kapucu2005-rrp",
        lambda m: m["motion"]["sweeps"][2].update(end=1.5),
        r"sweeps\[2\].end.*j3",
    ),
    "out of reach": (
        "pachidis2005-static",
        lambda m: m["motion"]["T_world_target"].update(xyz_m=[0.2, 3.0, 0.1]),
        "motion.*does not reach",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_cannot_be_is_refused_by_its_key(case: str, tmp_path: Path) -> None:
    name, change, says = WRONG[case]
    mapping = copy.deepcopy(content(name))
    change(mapping)
    path = tmp_path / "scenario.yaml"
    path.write_text(yaml.safe_dump(mapping))
    with pytest.raises(BadFile, match=f"(?s){says}") as caught:
        simulate(str(path), tmp_path / "out", frames=1)
    assert isinstance(caught.value, ArmsightError)
    assert not (tmp_path / "out" / "rig.yaml").exists()


def test_simulate_writes_files_that_the_readers_take_and_that_make_the_run_again(tmp_path: Path) -> None:
    first, second = tmp_path / "first", tmp_path / "second"
    done = simulate("webcam-cell", first, seed=7, frames=2, room="dark")
    assert done.n_frames == 2
    assert read_rig(first / "rig.yaml").kind == "stereo"
    assert read_target(first / "target.yaml").names == ("A", "B", "C")
    assert read_joints(first / "joints.csv").q.shape == (2, 6)
    written = read_world(first / "world.yaml")
    for pose, there in zip(read_poses(first / "truth.csv"), read_poses(first / "truth_world.csv"), strict=True):
        moved = written.T_parent_rig * pose.pose
        assert np.abs(moved.as_matrix() - there.pose.as_matrix()).max() < 1e-9
    assert read_arm(first / "arm.yaml").n == read_arm(first / "arm_true.yaml").n == 6
    simulate(str(first / "scenario.yaml"), second)
    for side in ("left", "right"):
        images = sorted((first / side).iterdir())
        assert len(images) == 2
        assert all(image.read_bytes() == (second / side / image.name).read_bytes() for image in images)
    assert (first / "joints.csv").read_bytes() == (second / "joints.csv").read_bytes()
