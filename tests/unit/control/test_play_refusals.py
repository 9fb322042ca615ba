"""What playing refuses before any motion, and what it does not: each of these was run once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from armsight.control.guard import Limits
from armsight.control.paths import PathTrouble, check_path, outliers, resampled
from armsight.control.paths.outliers import jump_step
from armsight.control.play import PlaySettings, Weave, plan_path
from armsight.errors import Inconsistent, UsageError
from armsight.kinematics import presets
from armsight.records import TaughtPath
from refusals import names_it, refuses

ARM = replace(presets.ur10(), T_flange_tool=RigidTransform.from_translation([0.0, 0.0, 0.15]))
Q = np.array([0.0, -1.0, 1.5, -0.5, 1.5, 0.0])
STAND = ARM.T_world_base.inv() * RigidTransform.from_matrix(ARM.fk(ARM.values(Q)))
FAST = PlaySettings(speed_m_s=0.05, approach_speed_m_s=0.1, retract_m=0.01)
SEAM = np.stack([np.arange(61) * 1e-3, np.zeros(61), np.full(61, 0.01)], axis=1)  # a row each millimetre


def through(xyz) -> TaughtPath:
    """Return a path through places in the axes of the tool as it stands."""
    rows = [(STAND * RigidTransform.from_translation(place)).as_matrix() for place in xyz]
    return TaughtPath.of_poses(RigidTransform.from_matrix(np.array(rows)), parent="base")


def outlier(row: int, m: float):
    out = SEAM.copy()
    out[row, 1] += m
    return out


def shifted(row: int, m: float):
    out = SEAM.copy()
    out[row:, 1] += m
    return out


@pytest.mark.parametrize(
    ("places", "step"),
    [
        (outlier(30, 0.02), 29),
        (outlier(0, 0.02), 0),
        (shifted(30, 0.04), 29),
        (np.concatenate([SEAM, SEAM[-1:] + np.array([0.06, 0.0, 0.0])]), 60),  # straight on, and too far
    ],
)
def test_a_row_far_off_a_dense_path_is_refused(places, step: int) -> None:
    assert jump_step(places, np.full(len(places), np.nan)) == step
    with pytest.raises(Inconsistent, match=rf"jumps .* row ({step}|{step + 1})\."):
        plan_path(through(places), ARM, Limits(), Q, FAST)
    checked = check_path(through(places), ARM, Limits(), start=Q)  # one rule decides for both
    told = [issue.row for issue in checked.issues if issue.trouble is PathTrouble.JUMP and "path jumps" in issue.text]
    assert told[0] in (step, step + 1)


@pytest.mark.parametrize(("step_m", "pitch_m"), [(0.005, 0.01), (0.01, 0.015)])
def test_the_turning_points_of_a_raster_are_no_outliers(step_m: float, pitch_m: float) -> None:
    corners = [[x, pitch_m * k, 0.01] for k in range(5) for x in ((0.0, 0.1) if k % 2 == 0 else (0.1, 0.0))]
    raster = resampled(through(corners), step_m)
    assert not outliers(raster)
    assert check_path(raster, ARM, Limits(), start=Q).ok
    assert plan_path(raster, ARM, Limits(), Q, FAST).length_m == pytest.approx(0.5 + 4 * pitch_m, rel=1e-9)
    T = raster.T_world_tip.copy()
    T[12, 2, 3] += 0.02
    spoiled = replace(raster, T_world_tip=T)
    with refuses(Inconsistent, "row 12"):
        plan_path(spoiled, ARM, Limits(), Q, FAST)
    assert any(names_it(issue.text, "back", "row 12") for issue in check_path(spoiled, ARM, Limits(), start=Q).issues)


def test_what_is_led_evenly_or_meant_is_no_jump() -> None:
    hand = np.concatenate(
        [np.full(20, 5e-5), [0.01], np.full(10, 0.03), [0.01], np.full(20, 5e-5)]
    )  # rests, goes, rests
    along = np.stack([np.cumsum(hand), np.zeros(len(hand)), np.zeros(len(hand))], axis=1)
    straight = np.concatenate(
        [SEAM, SEAM[-1:] + np.array([0.03, 0.0, 0.0]), SEAM + np.array([0.091, 0.0, 0.0])]
    )  # a gap straight on
    polyline = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.1, 0.1, 0.0], [0.101, 0.1, 0.0]])
    for places in (SEAM, along, straight, polyline, polyline[:2], polyline[:3]):
        assert jump_step(places, np.full(len(places), np.nan)) is None
        assert jump_step(places, 0.2 * np.arange(len(places))) is None
    assert jump_step(straight, 0.02 * np.arange(len(straight))) == 60  # 30 mm in 20 ms


@pytest.mark.parametrize(
    ("text", "key", "most_m"), [("sine:2:6", "amplitude_m", 0.025), ("zigzag:0.05:0.02", "amplitude_m", 0.025)]
)
def test_a_weave_in_millimetres_is_refused(text: str, key: str, most_m: float) -> None:
    with refuses(UsageError, key, most_m) as refused:
        Weave.parse(text)
    assert "Give metres" in str(refused.value)


def test_a_path_in_millimetres_is_refused_before_it_is_sampled(monkeypatch: pytest.MonkeyPatch) -> None:
    turn = np.linspace(0.0, 6.0, 20_000)  # rows 18 mm apart: no jump
    places = np.stack([400.0 + 60.0 * np.cos(turn), 60.0 * np.sin(turn), np.full(len(turn), 300.0)], axis=1)

    def sampled(*_: object) -> None:
        raise AssertionError("minutes of work")

    monkeypatch.setattr("armsight.control.play.plan.shaped", sampled)
    with pytest.raises(Inconsistent) as refused:
        plan_path(through(places), ARM, Limits(), Q, FAST)
    assert "millimetres" in refused.value.cure
