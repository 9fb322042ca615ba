"""Runs without end of three cameras and more: the one that is knocked is named, no pose is wrong and called good."""

from __future__ import annotations

import numpy as np
import pytest
from tests.truth.camera_ring import LIGHTS, Ring, look, pose, ring
from tests.truth.test_knocked_camera import knocked
from tests.truth.test_views import difference, setup_of, spots

from armsight.measure.consistency.live_cameras import SOON, STRETCH, WatchedTracker
from armsight.measure.poses.outcome import Measured
from armsight.measure.poses.views import measure_views
from armsight.records import PoseStatus

PERIOD_S = 1.0 / 30.0
KNOCKED_AT = 40


class Live:
    """A target that is led in a circle before cameras; seen: what is left of the spots (v lists) of a moment."""

    def __init__(self, views: int, seed: int, seen=lambda uv, i: uv) -> None:
        self.rng, self.world, self._seen = np.random.default_rng(seed), ring(views), seen
        self.setup, self._at, self.i = setup_of(self.world), pose(self.rng, tilt_rad=0.1), 0
        self.tracker = WatchedTracker(self.setup)
        self.tracker._tracker = self  # moments of spots in place of frames
        self.without: tuple[str, ...] = ()
        self.track = None
        self.worst_mm = 0.0

    def take(self) -> Measured:
        uv = self._seen(look(self.now, LIGHTS, self.T, self.rng).uv, self.i)
        named = zip(self.setup.rig.names, uv, strict=True)
        seen = [spots(one if name not in self.without else one[:0]) for name, one in named]
        return measure_views(self.setup, PERIOD_S * self.i, seen)

    def run(self, moments: int, later: Ring | None = None) -> int:
        """Go on for so many moments, from KNOCKED_AT on of another world; return where something was found."""
        while self.i < moments and not self.tracker.contradictions:
            self.now = self.world if later is None or self.i < KNOCKED_AT else later
            self.T = self._at.copy()
            self.T[:3, 3] += 0.03 * np.array([np.sin(0.1 * self.i), np.cos(0.1 * self.i), 0.0])
            found = self.tracker.take().pose
            if found.status is PoseStatus.OK:
                self.worst_mm = max(
                    self.worst_mm, 1e3 * float(np.linalg.norm(difference(found.T_parent_target, self.T)[:3]))
                )
            self.i += 1
        return self.i


@pytest.mark.parametrize(
    ("views", "k", "turn_deg"), [(3, 0, 0.05), (3, 1, 0.3), (3, 2, 1.0), (4, 1, 0.02), (4, 3, 0.1)]
)
def test_a_camera_that_is_knocked_is_named_within_a_second_and_no_pose_is_wrong(
    views: int, k: int, turn_deg: float
) -> None:
    live = Live(views, seed=views + k)
    found_at = live.run(KNOCKED_AT + 2 * STRETCH, knocked(live.world, k, live.rng, np.radians(turn_deg)))
    assert KNOCKED_AT + 1 < found_at <= KNOCKED_AT + STRETCH
    assert [one.names for one in live.tracker.left_out] == [(f"c{k}",)], live.tracker.contradictions
    assert f"--again c{k}" in live.tracker.left_out[0].contradiction
    assert live.tracker.trusted_s < PERIOD_S * KNOCKED_AT
    assert live.worst_mm < 0.5


@pytest.mark.parametrize("views", [1, 3, 4])
def test_a_good_rig_raises_nothing_and_is_trusted_stretch_by_stretch(views: int) -> None:
    live = Live(views, seed=views)
    assert live.run(4 * STRETCH) == 4 * STRETCH and not live.tracker.contradictions
    assert live.tracker.trusted_s > PERIOD_S * 2 * STRETCH


def test_the_others_go_on_without_the_camera_that_is_named() -> None:
    live = Live(4, seed=2)
    later = knocked(live.world, 2, live.rng, np.radians(0.2))
    live.run(KNOCKED_AT + STRETCH, later)
    assert live.without == ("c2",)
    live.now = later
    for _ in range(STRETCH + SOON):
        live.i += 1
        found = live.tracker.take().pose
        assert found.status is PoseStatus.OK and np.linalg.norm(difference(found.T_parent_target, live.T)[:3]) < 5e-4
    assert [one.names for one in live.tracker.contradictions] == [("c2",)]


@pytest.mark.parametrize("turn_deg", [0.03, 0.1])
def test_of_two_that_see_it_none_is_named_and_no_pose_is_good(turn_deg: float) -> None:
    """The third camera sees nothing any more when one of the two others is knocked."""
    live = Live(3, seed=6, seen=lambda uv, i: [uv[0], uv[1], uv[2] if i < KNOCKED_AT else uv[2][:0]])
    live.run(KNOCKED_AT + 2 * STRETCH, knocked(live.world, 0, live.rng, np.radians(turn_deg)))
    assert not live.tracker.left_out and live.worst_mm < 0.5
    assert live.tracker.take().pose.status is not PoseStatus.OK
