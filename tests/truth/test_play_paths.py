"""A path that is run is the one that was told: its deviation, speed and time, for turning tools and any override."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation
from tests.truth.play_paths import Case, cases, run, tips

from armsight.control.guard import Limits
from armsight.control.play import PlaySettings, plan_path
from armsight.errors import Inconsistent, NotEnoughData
from armsight.kinematics import preset
from armsight.records import TaughtPath
from refusals import names_it, refuses

UR10 = replace(preset("ur10"), T_flange_tool=RigidTransform.from_translation([0.0, 0.0, 0.15]))
Q = np.array([0.0, -1.0, 1.5, -0.5, 1.5, 0.0])


def rows(*steps: tuple[float, float], z_deg: float = 1.0, x_deg: float = 0.0) -> TaughtPath:
    """Return a path before the tool as it stands by steps of mm along its x and degrees of turning."""
    at, R = tips(UR10, Q[None])
    stand = RigidTransform.from_components(at[0], Rotation.from_matrix(R[0]))
    mm, deg = np.cumsum(np.array([(0.0, 0.0), *steps]), axis=0).T
    turns = Rotation.from_rotvec(np.radians(deg)[:, None] * [x_deg, 0.0, z_deg])
    T = stand * RigidTransform.from_components(1e-3 * mm[:, None] * [1.0, 0.0, 0.0] + [0.0, 0.0, 0.01], turns)
    return TaughtPath.of_poses(T, parent="base")


def case(path: TaughtPath, override=lambda _: 1.0, pauses=None, **settings) -> Case:
    asked = PlaySettings(approach_speed_m_s=0.08, retract_m=0.0, **settings)
    return Case(UR10, Q, path, asked, Limits(), 0.008, override, pauses or {}, pauses is None, "rows")


TURNING = rows(*[(20.0, 30.0)] * 3)
SWAYING = rows(*[(10.0, 40.0), (10.0, -40.0)] * 2, x_deg=0.7)
EVERY_CYCLE = np.random.default_rng(3).uniform(0.05, 1.0, 4096)


def swaying(path: TaughtPath = SWAYING) -> Case:
    """Turns to and fro as fast as the joints can, while the override changes in every cycle."""
    return case(path, lambda k: float(EVERY_CYCLE[k % 4096]), {60: True, 110: False}, speed_m_s=0.06)


@pytest.mark.parametrize("seed", [91, 186, 1007, 1011])
def test_what_is_told_is_what_runs(seed: int) -> None:
    ran = run(cases(seed))
    assert not ran.faults and not ran.limited, ran


@pytest.mark.parametrize(
    "asked",
    [swaying(), case(rows((10.0, 0.0), *[(0.0, 30.0)] * 6, (10.0, 0.0)), speed_m_s=0.02)],
    ids=["swaying at any override", "in place"],
)
def test_a_tool_that_turns_stays_on_the_path(asked: Case) -> None:
    ran = run(asked)
    assert not ran.faults and not ran.limited, ran
    assert ran.off_m < 1e-6  # all on one line


def test_rows_20_mm_and_30_degrees_apart_take_the_time_that_their_speed_tells() -> None:
    ran = run(case(TURNING, speed_m_s=0.01))
    assert not ran.faults and not ran.limited and ran.off_m < 1e-6, ran  # all on one line
    assert 6.0 < ran.planned_s < 8.0 and ran.speed < 1.001, ran


def test_a_turn_in_one_place_is_said_in_those_words() -> None:
    plan = plan_path(rows((10.0, 0.0), *[(0.0, 30.0)] * 12, (10.0, 0.0)), UR10, Limits(), Q, PlaySettings())
    assert names_it(plan.turns, "360 deg", "one place", "0.010 m")
    assert plan.rounded_m < 1e-6 and not plan_path(TURNING, UR10, Limits(), Q).turns
    with refuses(NotEnoughData, "360 deg", "positions"):
        plan_path(rows(*[(0.0, 30.0)] * 12), UR10, Limits(), Q)
    with refuses(Inconsistent, "600 deg", "one place"):
        plan_path(rows((10.0, 0.0), *[(0.0, 30.0)] * 20, (10.0, 0.0)), UR10, Limits(), Q)


def test_an_arm_of_three_joints_says_that_it_cannot_turn_its_tool() -> None:
    asked = cases(1004)
    free = plan_path(asked.path, asked.arm, asked.limits, asked.q, asked.settings)
    assert free.turned_rad > 0.01
    with refuses(Inconsistent, "3 joints", "--keep-rotation"):
        plan_path(asked.path, asked.arm, asked.limits, asked.q, replace(asked.settings, keep_rotation=False))
