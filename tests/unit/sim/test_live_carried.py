"""Cells in which the robot carries its rig, or cameras that stand watch a target in a hand, on one clock."""

from __future__ import annotations

import numpy as np
import pytest

from armsight.clock import ManualClock
from armsight.measure.poses.pipeline import Setup, measure_pair
from armsight.ops.simulation.scenarios import load_scenario
from armsight.records import PoseStatus
from armsight.store.rigs import rig_from_mapping
from armsight.store.targets import target_from_mapping
from armsight_sim.live import live_cell


def cell_of(name: str, clock: ManualClock, **asked):
    scenario, _ = load_scenario(name)
    return live_cell(scenario, clock, room="dark", **asked)


def setup_of(cell) -> Setup:
    target = target_from_mapping({"format": "armsight/target", "version": 1, **cell.target})
    return Setup(rig_from_mapping(dict(cell.rig)), target, overlaid=cell.one_image)


@pytest.mark.parametrize("name", ["pachidis2005-static", "webcam-cell"])
def test_what_is_measured_is_where_the_target_truly_is_while_robot_and_hand_move(name):
    clock = ManualClock(5.0)
    cell = cell_of(name, clock, hand="circle", speed_m_s=0.1, fps=20.0)
    setup, track, n = setup_of(cell), None, 0
    with cell.robot, cell.pairs:
        for left, right in cell.pairs:
            measured = measure_pair(setup, left, right, track)
            track = measured.track
            flange = cell.robot.true_flange(cell.origin_s + left.t_s)
            T_base_rig = flange * cell.T_mount_rig if cell.carried else cell.T_mount_rig
            if measured.pose.status is PoseStatus.OK:
                n += 1
                seen = (cell.robot.true.T_world_base * T_base_rig).apply(measured.pose.T_parent_target[:3, 3])
                assert np.linalg.norm(seen - cell.pairs.target_at(left.t_s).translation) < 1e-3
            if left.sequence >= 20:
                break
            cell.robot.step_joints(np.full(6, 1e-3))
    assert n >= 15
    assert clock.now_s() == pytest.approx(5.0 + 20 / 20.0 + cell.pairs.latency_s)


def test_covered_lights_are_not_seen_until_they_are_uncovered():
    cell = cell_of("pachidis2005-static", ManualClock(), hand="still")
    setup = setup_of(cell)
    with cell.robot, cell.pairs:
        cell.pairs.cover()
        assert measure_pair(setup, *cell.pairs.moment(1)).pose.status is PoseStatus.LOST
        cell.pairs.cover(False)
        cell.pairs.cover(names=("A",))
        assert measure_pair(setup, *cell.pairs.moment(2)).pose.status is not PoseStatus.OK
        cell.pairs.cover(False, names=("A",))
        assert measure_pair(setup, *cell.pairs.moment(3)).pose.status is PoseStatus.OK
