"""A target that rests and then starts at once, before two to four live cameras that no wire joins: their moments' poses
against the truth. The motion is made here; cameras, delays and noise are those of test_free_cameras."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from tests.truth import test_free_cameras as free
from tests.truth.camera_ring import ring
from tests.truth.test_views import WRONG, difference, draw, setup_of

from armsight.measure.poses.moments import TargetTracker
from armsight.measure.poses.moments import _of_spots as of_spots
from armsight.measure.poses.one_time import rig_times
from armsight.records import Frame, PoseStatus

BEGINS_S, AMPLITUDE_M, TURN_RAD = 0.4, 0.06, 0.2


@dataclass(frozen=True)
class Start:
    """A target at rest that is pushed at BEGINS_S by an acceleration at once, there and back, turning as it goes."""

    acceleration_m_s2: float
    way: np.ndarray
    axis: np.ndarray

    @classmethod
    def drawn(cls, rng: np.random.Generator, acceleration_m_s2: float) -> Start:
        way, axis = rng.normal(size=(2, 3))
        return cls(acceleration_m_s2, way / np.linalg.norm(way), axis / np.linalg.norm(axis))

    def pose(self, t_s: float) -> np.ndarray:
        """Return the pose (4, 4) in rig axes: A (1 - cos w t), whose acceleration begins with A w^2."""
        share = 1.0 - np.cos(np.sqrt(self.acceleration_m_s2 / AMPLITUDE_M) * max(t_s - BEGINS_S, 0.0))
        T = np.eye(4)
        T[:3, :3] = Rotation.from_rotvec(TURN_RAD * share * self.axis).as_matrix()
        T[:3, 3] = AMPLITUDE_M * share * self.way + [0.0, 0.0, 1.3]
        return T


def moments(
    views: int, seed: int, acceleration_m_s2: float, seconds: float = 1.2
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the times of all moments after the start, errors (n, 6) and squared distances (n,), NaN where no pose is
    ok."""
    rng, world = np.random.default_rng(seed), ring(views)
    motion = Start.drawn(rng, acceleration_m_s2)
    setup = free.timed(setup_of(world), np.zeros(views))
    seen = [list(one.read()) for one in free.streams(world, rng, motion, seconds=seconds, hidden=0.1)]
    times = [setup.rig.timing[s].rig_time([one.t_s for one in each]) for s, each in enumerate(seen)]
    track, rows = None, []
    for k, t in enumerate(times[0]):
        near = [seen[s][int(np.abs(times[s] - t).argmin())] for s in range(views)]
        frames = [Frame(image=np.zeros((8, 8), np.uint8), t_s=one.t_s, sequence=k, source="view") for one in near]
        found = of_spots(setup, frames, [one.spots for one in near], rig_times(setup, frames), track)
        track, pose, d, q = found.track, found.pose, np.full(6, np.nan), np.nan
        if pose.status is PoseStatus.OK:
            assert pose.T_parent_target is not None and pose.covariance is not None
            d = difference(pose.T_parent_target, motion.pose(pose.t_s))
            q = float(d @ np.linalg.solve(pose.covariance, d))
        rows.append((pose.t_s - BEGINS_S, d, q))
    t_s, errors, squares = (np.array(column) for column in zip(*rows, strict=True))
    after = t_s > 0.0
    return t_s[after], errors[after], squares[after]


@pytest.mark.parametrize("views", [2, 3, 4])
def test_a_target_that_starts_at_once_is_not_lost(views: int) -> None:
    runs = [moments(views, seed, a) for seed, a in enumerate((2.0, 5.0, 10.0, 20.0))]
    _, errors, squares = (np.concatenate(column) for column in zip(*runs, strict=True))
    ok = np.isfinite(squares)
    shares = [np.isfinite(q)[at_s > 0.2].mean() for at_s, _, q in runs]
    assert min(shares[:3]) > 0.95 and shares[3] > 0.6  # at 1.1 m/s and 20 ms lights pass each other's places
    assert squares[ok].max() < WRONG
    assert np.mean(squares[ok] < chi2.ppf(0.95, 6)) > 0.9
    assert np.sqrt(np.mean(np.sum(errors[ok, :3] ** 2, axis=1))) < 3e-4


def test_a_live_pair_with_known_delays_is_brought_to_one_time() -> None:
    """At 0.5 m/s, 7 ms apart: as if at once the depth is off by millimetres, or no pose fits."""
    world, delay_s, way = ring(2, spread_rad=0.5), 0.007, np.array([0.3, 0.1, 0.4])
    plain = setup_of(world)
    setup = free.timed(plain, np.array([0.0, delay_s - free.DELAYS[1]]))
    late = [one and replace(one, readout_s=0.0, drift_ppm=0.0) for one in setup.rig.timing]
    setup = replace(setup, rig=setup.rig.with_each(timing=late))
    off: dict[bool, list[float]] = {True: [], False: []}
    for known, one in ((True, setup), (False, plain)):
        tracker, rng = TargetTracker(one), np.random.default_rng(3)
        for k in range(12):
            poses = [_at(way, k / 30.0 + later) for later in (0.0, delay_s)]
            frames = [replace(draw(world, T, rng)[s], t_s=k / 30.0, sequence=k) for s, T in enumerate(poses)]
            measured = tracker.take(*frames)
            if measured.pose.status is PoseStatus.OK and k > 3:
                found = np.asarray(measured.pose.T_parent_target)
                off[known].append(float(np.linalg.norm(difference(found, _at(way, measured.pose.t_s))[:3])))
    assert len(off[True]) == 8 and max(off[True]) < 5e-4
    assert len(off[False]) < 8 or np.median(off[False]) > 1e-3


def _at(way_m_s: np.ndarray, t_s: float) -> np.ndarray:
    T = np.eye(4)
    T[:3, 3] = way_m_s * (t_s - 0.2) + [0.0, 0.0, 1.3]
    return T
