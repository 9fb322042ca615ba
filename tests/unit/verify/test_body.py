"""Three points of one body at each visit: its pose is judged, turns too, and how rigid the points are."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from armsight.verify import Measured, Repeats
from armsight.verify.iso9283 import evaluate
from armsight.verify.repeats import Command, iso9283_test

POINTS = {"A": [0.08, 0.0, 0.0], "B": [-0.05, 0.07, 0.01], "C": [-0.04, -0.06, 0.0], "D": [0.0, 0.02, 0.06]}
STD_M, TURN_RAD, MOVE_M = 1e-5, 2e-3, 1e-4
POSES = {"P1": [0.5, 0.0, 0.4], "P2": [0.6, 0.3, 0.2]}


def visited(names: str = "ABCD", *, loose_m: float = 0.0, turn_rad: float = TURN_RAD, hidden: tuple[int, ...] = ()):
    """30 visits of two poses: the body turns by turn_rad about z from visit to visit; D is loose."""
    rng = np.random.default_rng(7)
    xyz, pose, visit, point, wanted = [], [], [], [], []
    for v in range(30):
        for name, place in POSES.items():
            turn = Rotation.from_rotvec([0.0, 0.0, rng.normal(0.0, turn_rad)])
            off, slip = rng.normal(0.0, MOVE_M, 3), rng.normal(0.0, loose_m, 3) if loose_m else np.zeros(3)
            for label in names:
                if v in hidden and label != "A":
                    continue
                arm = np.array(POINTS[label]) + (slip if label == "D" else 0.0)
                xyz.append(np.array(place) + off + turn.apply(arm) + rng.normal(0.0, STD_M, 3))
                wanted.append(np.array(place) + np.array(POINTS[label]))
                pose.append(name), visit.append(str(v)), point.append(label)
    m = len(xyz)
    std = np.concatenate([np.full((m, 3), STD_M), np.zeros((m, 3))], axis=1)
    measured = Measured(xyz_m=np.array(xyz), std=std, point=tuple(point))
    none = ("",) * m
    repeats = Repeats(pose=tuple(pose), visit=tuple(visit), run=none, path=none, approach=none)
    T = np.tile(np.eye(4), (m, 1, 1))
    T[:, :3, 3] = wanted
    return measured, repeats, Command(row=measured.rows, T=T, turned=False, in_frame=True)


def test_positions_and_turns_of_the_body_are_judged_not_one_point() -> None:
    measured, repeats, command = visited()
    test, notes = iso9283_test(measured, repeats, command)
    figures = evaluate(test)
    assert figures["RP_c_rad P1"].value == pytest.approx(3.0 * TURN_RAD, rel=0.4)
    assert figures["RP_a_rad P1"].value < 0.2 * TURN_RAD and figures["RP_b_rad P2"].value < 0.2 * TURN_RAD
    centre = np.mean(list(POINTS.values()), axis=0)
    radius = np.hypot(*(np.array(POINTS["A"]) - centre)[:2])
    assert figures["RP_m P1"].value < 3.6 * MOVE_M < 3.0 * TURN_RAD * radius  # that is what A alone shows
    assert figures["AP_m P1"].value < 1e-4 and figures["AP_c_rad P1"].value < 2e-3
    assert sum("one body" in note for note in notes) == 1 and not any("only" in note for note in notes)
    assert not any("distances" in note for note in notes)


def test_visits_that_show_too_little_are_left_out_and_told_and_a_lone_command_gives_no_accuracy() -> None:
    measured, repeats, command = visited(hidden=(3, 4))
    T = command.T.copy()
    T[:, :3, 3] = T[0, :3, 3]
    test, notes = iso9283_test(measured, repeats, Command(row=command.row, T=T, turned=False, in_frame=True))
    assert [len(visits.visit) for visits in test.poses] == [28, 28]
    assert any("4 visits" in note for note in notes) and any("withheld" in note for note in notes)
    assert evaluate(test)["AP_m P1"].withheld
