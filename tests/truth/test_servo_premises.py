"""What a servo does on a wrong premise, by where the true arm comes to rest, and what it would do without the watch.

benchmarks/servo_premises.py has all premises and the statistics.
"""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from armsight.control.servo.premise import PremiseWatch

sys.path.insert(0, str(Path(__file__).parent))
import servo_premises as scene

REST_M = 0.015
PREMISES = {
    "turned 90 deg about y": 3,
    "turned 180 deg about z": 1,
    "mirrored in x": 2,
    "turned 45 deg about x": 1,
    "pictures 1 s old": 2,
    "joint 2 the other way": 1,
}


@pytest.mark.parametrize(("name", "seed"), PREMISES.items())
def test_the_arm_rests_within_a_centimetre_and_a_half_and_the_cause_is_named(name, seed):
    run = scene.run(name, seed)
    assert run.stopped()
    assert run.way_m < REST_M
    assert run.source.wrong.cause.value == scene.WRONG[name].cause


@pytest.mark.parametrize("name", ["left and right exchanged", "rig in mm", "another target"])
def test_poses_that_cannot_be_move_nothing_and_are_named(name):
    run = scene.run(name, 1)
    assert run.way_m < 1e-6
    assert run.source.wrong.cause.value == scene.WRONG[name].cause


@pytest.mark.parametrize("name", ["turned 180 deg about z", "mirrored in x", "turned 90 deg about y"])
def test_without_the_watch_the_arm_runs_off(monkeypatch, name):
    monkeypatch.setattr(PremiseWatch, "_judged", lambda _: None)
    assert scene.run(name, PREMISES[name]).way_m > 2.0 * REST_M


@pytest.mark.parametrize("seed", [39, 66, 75])
def test_fast_hands_and_hidden_targets_are_no_wrong_premise(seed):
    """Of 500 those that came nearest to one."""
    run = scene.honest_run(seed, 5.0)
    assert run.source.wrong is None
    assert "" in run.log.why


def test_the_harm_of_a_small_error_stays_small_until_it_shows():
    run = scene.run("turned 10 deg about x", 1)
    assert run.stopped()
    assert run.way_m < REST_M
