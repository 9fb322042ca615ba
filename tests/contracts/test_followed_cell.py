"""Simulated cameras that watch a controller's arm through its link, held to the controller's own motion."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from armsight.measure.poses.pipeline import Setup, measure_pair
from armsight.ops.simulation.following import followed_cell
from armsight.ops.simulation.scenarios import load_scenario, with_arm
from armsight.store import rig_from_mapping, target_from_mapping
from armsight.store.arm_file import arm_from_mapping, write_arm
from armsight.store.yamls import dump_yaml
from armsight_sim.twins.base import small_arm

SPEED_RAD_S = np.deg2rad(15.0)
PAIRS = 24


@pytest.fixture(scope="module")
def scenario(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scenario of the twins' own arm, before small cameras, in the dark."""
    folder = tmp_path_factory.mktemp("scenario")
    mapping = small_arm().mapping(small_arm().T_world_base)
    write_arm(folder / "arm.yaml", arm_from_mapping({"format": "armsight/arm", "version": 1, **mapping}, "small"))
    model, _ = with_arm("webcam-cell", load_scenario("webcam-cell")[0], str(folder / "arm.yaml"), None)
    keys = model.model_dump() | {"room": "dark"}
    keys["cameras"] |= {"width": 640, "height": 360}
    for side in ("left", "right"):
        lens = keys["cameras"][side]
        lens |= {name: 0.5 * lens[name] for name in ("fx", "fy", "cx", "cy")}
    keys["cameras"]["pipeline"] = "ideal"  # whose noise is what the spots claim
    keys["target"]["sigma_px"] = 1.5
    file = folder / "cell.yaml"
    file.write_text(dump_yaml(keys))
    return file


def flange(q: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return T_base_flange (4, 4) of the twins' arm, by its table and the textbook's four factors."""
    T = np.eye(4)
    for joint, value in zip(small_arm().joints, q, strict=True):
        for turn, along in (((0.0, 0.0, value + joint.theta_rad), (0.0, 0.0, joint.d_m)),
                            ((joint.alpha_rad, 0.0, 0.0), (joint.a_m, 0.0, 0.0))):  # fmt: skip
            step = np.eye(4)
            step[:3, :3], step[:3, 3] = Rotation.from_rotvec(turn).as_matrix(), along
            T = T @ step
    return T


def errors(pair: Any, scenario: Path, joints: Callable[[Any], Callable[[float], Any]] | None = None) -> Any:
    """Return (PAIRS, 3): the target's place as the cameras see it minus that by the controller's own log, whitened.

    The arm goes to and fro at SPEED_RAD_S. joints: in place of what the cameras follow, made of the driver.
    """
    cell = followed_cell(str(scenario), pair.robot, pair.clock)
    if joints is not None:
        cell.robot.follow(joints(pair.robot))
    setup = Setup(rig=rig_from_mapping(cell.rig, "rig"), target=target_from_mapping(cell.target, "target"))
    keys = load_scenario(str(scenario))[0]
    T_rig_base = keys.cameras.T_mount_rig.pose().inv().as_matrix()
    T_flange_target = keys.target.T_flange_target.pose().as_matrix()
    log, seen, due = [], [], 30  # the arm is at its speed by then
    pair.prove()
    with cell.pairs as pairs:
        while len(seen) < PAIRS:
            way = WAY if int((pair.clock.now_s() - cell.origin_s) / TURN_S) % 2 == 0 else -WAY
            pair.robot.step_joints(way * SPEED_RAD_S * pair.cycle_s)
            pair.advance(pair.cycle_s)
            log.append((pair.clock.now_s(), *pair.twin.q))
            if pair.clock.now_s() > cell.origin_s + due / pairs.fps + pairs.latency_s:
                pose = measure_pair(setup, *pairs.pair(due)).pose
                seen.append((cell.origin_s + pose.t_s, pose))
                due += 3
    found, rows = [], np.array(log)
    for t_s, pose in seen:
        q = np.array([np.interp(t_s, rows[:, 0], column) for column in rows[:, 1:].T])
        true = (T_rig_base @ flange(q) @ T_flange_target)[:3, 3]
        found.append(np.linalg.solve(np.linalg.cholesky(pose.covariance[:3, :3]), pose.T_parent_target[:3, 3] - true))
    return np.array(found)


WAY, TURN_S = np.array([1.0, 0.4, -0.4, 0.0, 0.0, 1.0]), 0.6
"""Shares of the speed by joint, and how long it goes one way."""


def test_a_moving_arm_is_seen_where_its_controller_had_it_at_the_exposure(make_link: Any, scenario: Path) -> None:
    pair = make_link()
    with pair.robot:
        rms = np.sqrt(np.mean(errors(pair, scenario) ** 2))
    assert 0.7 < rms < 1.35, f"{rms:.2f} of the cameras' own deviations"


def held(robot: Any) -> Callable[[float], Any]:
    """Return what gives the reading that was newest at a moment: nothing between two is worked out."""
    log: list[tuple[float, Any]] = []
    robot.listen(lambda t_s, q: log.append((t_s, q)))
    return lambda t_s: next(q for at_s, q in reversed(log) if at_s <= t_s)


NOT_BETWEEN = {"newest": lambda robot: lambda t_s: robot.read().q, "held": held}


@pytest.mark.parametrize("how", NOT_BETWEEN)
def test_readings_as_they_come_would_not_do(make_egm: Any, scenario: Path, how: str) -> None:
    """The same arm drawn where the newest reading has it, or the last one before the exposure."""
    pair = make_egm()
    with pair.robot:
        rms = np.sqrt(np.mean(errors(pair, scenario, NOT_BETWEEN[how]) ** 2))
    assert rms > 2.0, f"{rms:.2f} of the cameras' own deviations"
