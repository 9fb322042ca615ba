"""How far a state may be trusted as time goes on, what is wrong in it, and that old data never say yes."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from armsight.control.guard import GuardState
from armsight.verify.supervision import Level, Limits
from armsight_plant.mqtt import state_json
from armsight_plant.state import NAMES, Quality, conditions, trust
from armsight_plant.values import IN_TOLERANCE, VALUES, told
from loading import module_of

states = module_of(Path(__file__).with_name("plant_states.py"))
UNIX_S, robot, seen, state = states.UNIX_S, states.robot, states.seen, states.state
STALE_S = 1.0


def tolerance(of, now_s=100.0):
    one = told(of, now_s, STALE_S)[IN_TOLERANCE]
    return one.value, one.quality


def test_an_arm_within_its_level_by_more_than_the_doubt_is_in_tolerance():
    assert tolerance(state()) == (True, Quality.GOOD)


@pytest.mark.parametrize("level", [Level.WARN, Level.STOP])
def test_a_level_that_is_raised_is_beyond_tolerance(level):
    assert tolerance(state(seen=seen(level=level))) == (False, Quality.GOOD)


@pytest.mark.parametrize(
    "of",
    [
        seen(error_m=0.001, std_m=0.0011),  # 1 mm and twice its doubt reach over 3 mm
        seen(std_m=0.1),  # a measurement worth nothing raises no level, and says nothing
        seen(limits=Limits()),
        seen(lost="the target is not seen"),
    ],
)
def test_what_cannot_be_said_is_neither(of):
    assert tolerance(state(seen=of)) == (None, Quality.UNDECIDED)


def test_a_pair_that_cannot_be_compared_is_not_called_good():
    told_of = [told(state(seen=seen(lost="dark", level=level)), 100.0, STALE_S) for level in (Level.GOOD, Level.STOP)]
    assert [one["verdict.level"].value for one in told_of] == [None, "stop"]
    assert told_of[0]["verdict.level"].quality is Quality.UNDECIDED
    assert {told_of[0][name].quality for name in ("verdict.error_m", "pose.xyz_m")} == {Quality.WAITING}


def test_what_was_never_there_is_not_the_last_one():
    lost = told(state(at_s=101.5, seen=seen(at_s=100.0, lost="dark")), 101.6, STALE_S)
    assert (lost["pose.xyz_m"].value, lost["pose.xyz_m"].quality) == (None, Quality.WAITING)


def test_a_direction_that_is_known_badly_is_doubt_though_the_error_points_elsewhere():
    deep = replace(seen().compared, random=np.diag([1e-8, 1e-8, 0.005**2, 1e-8, 1e-8, 1e-8]))
    assert deep.error_m + 2 * deep.std_m < states.LIMITS.warn_m  # along the error it is known well
    assert tolerance(state(seen=replace(seen(), compared=deep))) == (None, Quality.UNDECIDED)


@pytest.mark.parametrize("part", ["seen", "robot"])
def test_what_is_of_a_time_to_come_is_not_new(part):
    quality = getattr(trust(state(**{part: {"seen": seen, "robot": robot}[part](at_s=150.0)}), 100.0, STALE_S), part)
    assert quality is Quality.STALE


def test_a_measurement_that_stops_is_stale_and_says_nothing_of_tolerance():
    going = replace(state(at_s=101.5), seen=seen(at_s=100.0), robot=robot(101.5))
    values = told(going, 101.6, STALE_S)
    assert tolerance(going, 101.6) == (None, Quality.STALE)
    assert values["pose.xyz_m"].quality is Quality.STALE and values["pose.xyz_m"].value == pytest.approx(
        [0.1, 0.2, 0.9]
    )
    assert values["robot.joints"].quality is Quality.GOOD
    assert (values["verdict.level"].value, values["verdict.error_m"].value) == (None, pytest.approx(0.001))
    assert values["pose.xyz_m"].at_s == UNIX_S + 100.0


@pytest.mark.parametrize("now_s", [101.1, 99.0])
def test_a_source_that_is_silent_or_of_another_time_says_nothing_at_all(now_s):
    assert {one.quality for one in told(state(), now_s, STALE_S).values()} == {Quality.SILENT}
    assert {one.value for one in told(state(), now_s, STALE_S).values()} == {None}
    assert trust(None, now_s).source is Quality.SILENT


@pytest.mark.parametrize(
    ("parts", "name"),
    [
        ({"robot": None, "why": "the loop hangs"}, "robot"),
        ({"robot": robot(guard=GuardState.STOPPED, why="stopped by anna")}, "stopped"),
        ({"robot": robot(guard=GuardState.HOLDING, why="a cycle began late")}, "holding"),
        ({"recording": "the disk is full"}, "recording"),
        ({"seen": seen(level=Level.STOP)}, "beyond-stop"),
        ({"seen": seen(lost="dark", blind=True)}, "blind"),
        ({"seen": None}, "blind"),
    ],
)
def test_what_is_wrong_has_a_name(parts, name):
    assert [one.name for one in conditions(state(**parts))] == [name]


@pytest.mark.parametrize(
    "parts",
    [
        {},
        {"robot": robot(guard=GuardState.DISABLED, why="no enable", enabled=False)},
        {"seen": seen(lost="dark for one picture")},
        {"seen": None, "measures": False},
    ],
)
def test_what_is_usual_raises_nothing(parts):
    assert conditions(state(**parts)) == []


def test_json_says_what_is_stale():
    good = state_json(state(), 100.0, STALE_S)
    assert (good["in_tolerance"], good["stale"], good["online"]) == (True, False, True)
    assert good["robot"]["joints"] == [0.1, 0.2] and good["robot"]["quality"] == "good"
    old = state_json(state(), 101.5, STALE_S)
    assert (old["in_tolerance"], old["stale"], old["verdict"]["quality"]) == (None, True, "silent")
    assert state_json(None, 0.0, STALE_S)["stale"] is True


def test_the_guide_names_every_value_and_alarm():
    guide = (Path(__file__).resolve().parents[3] / "docs" / "guide" / "plant.md").read_text()
    lacking = [name for name in (*(one.name for one in VALUES), *NAMES) if f"| `{name}` |" not in guide]
    assert not lacking
