"""What lying cameras can do to the servo, by where the true arm goes, and what they could without each rule.

benchmarks/servo_lies.py has all lies and the statistics.
"""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from armsight.control.servo import ServoSource, TargetTrack
from armsight.control.servo.law import Reaction
from armsight.control.servo.premise import PremiseWatch

sys.path.insert(0, str(Path(__file__).parent))
import servo_lies as scene

BOUND_M, WITHOUT_M = 0.02, 0.025


def way_m(name: str, seed: int, after_s: float) -> float:
    kind = scene.LIES[name]
    start = scene.begun(seed, hand=kind.hand, mount=kind.mount, well=kind.well, frame_s=kind.frame_s)
    return scene.judged(scene.told(name, start, after_s), scene.honest(start, after_s)).way_m


@pytest.mark.parametrize(
    ("name", "seed", "after_s", "rule"),
    [
        ("frozen while followed well", 2, 2.0, (Reaction, "see")),
        ("frame before last", 6, 3.5, (PremiseWatch, "_judged")),
        ("aside by 60 mm, 14 Hz", 4, 2.0, (TargetTrack, "_sudden")),
        ("turned by 180 deg about z", 4, 2.0, (ServoSource, "_jumped_away")),
        ("dark, then turned by 180 deg", 4, 3.0, (TargetTrack, "_turned_away")),
    ],
)
def test_a_lie_is_harmless_and_without_its_rule_it_is_not(monkeypatch, name, seed, after_s, rule):
    assert way_m(name, seed, after_s) < BOUND_M
    monkeypatch.setattr(*rule, lambda *_, **__: None)
    assert way_m(name, seed, after_s) > WITHOUT_M


@pytest.mark.parametrize("seed", [22, 5])
def test_an_honest_target_that_is_hidden_now_and_then_needs_no_fresh_enable(seed):
    log = scene.honest_run(seed, 4.0)
    assert not [why for why in log.why if scene.for_good(why)]
    assert "" in log.why
