"""Three cameras that no wire joins see a target that a hand waves: poses, clocks and claims against the truth."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from tests.truth.camera_ring import LIGHTS, SIZE, Ring, ring
from tests.truth.test_views import SIGMA_PX, difference, setup_of, spots

from armsight.errors import Inconsistent, NotEnoughData, UsageError
from armsight.measure.begin import SpotFrame
from armsight.measure.poses.moments import _of_spots as of_spots
from armsight.measure.poses.one_time import rig_times
from armsight.measure.poses.setup import Setup
from armsight.ops.measurement.free_running import FreeRun, measure_free_running
from armsight.ops.measurement.streams import FrameSources, Stream
from armsight.records import CameraTiming, Frame, NamedCovariance, PoseStatus, Silent
from refusals import refuses

DELAYS, DRIFTS, READOUT = (0.0, 0.0071, -0.0113, 0.004), (0.0, 40.0, -25.0, 10.0), 0.012
RATES = 30.0, 30.0, 25.0, 50.0
"""By how much each camera's stamps are early (s), its clock slow (ppm), its last line late (s), and its rate (Hz)."""


@dataclass(frozen=True)
class Waved:
    """A target on sums of sines: about 0.4 m/s and 1.5 rad/s, at rest at first."""

    phase: np.ndarray

    def pose(self, t_s: float) -> np.ndarray:
        begun = 1.0 - np.exp(-(max(t_s - 0.3, 0.0) ** 3))
        w = 2.0 * np.pi * np.array([0.7, 0.9, 0.6, 0.8, 0.5, 0.65])
        sway = begun * np.sin(w * t_s + self.phase)
        T = np.eye(4)
        T[:3, :3] = Rotation.from_rotvec(0.35 * sway[3:]).as_matrix()
        T[:3, 3] = [0.08 * sway[0], 0.07 * sway[1], 1.3 + 0.06 * sway[2]]
        return T


def streams(
    world: Ring, rng: np.random.Generator, motion: Waved, *, seconds: float = 5.0, hidden: float = 0.15
) -> tuple[Stream, ...]:
    """Return each camera's spots by its own stamps: each line exposed at its own time, lights hidden at random."""
    out = []
    for s in range(len(world)):
        stamps = np.arange(rng.uniform(0.0, 0.03), seconds, 1.0 / RATES[s])
        frames = [_frame(world, rng, motion, s, t, hidden) for t in stamps.tolist()]
        read: Callable[[], Iterator[SpotFrame]] = partial(iter, frames)
        out.append(Stream(t_s=stamps, read=read, clock_covariance=lambda at_s: np.zeros((2, 2))))
    return tuple(out)


def _frame(world: Ring, rng: np.random.Generator, motion: Waved, s: int, stamp: float, hidden: float) -> SpotFrame:
    middle = stamp + DELAYS[s] + 1e-6 * DRIFTS[s] * stamp
    uv = np.empty((len(LIGHTS), 2))
    for i, X in enumerate(LIGHTS):
        late = 0.0
        for _ in range(4):
            T = motion.pose(middle + late)
            uv[i] = world.pixels((T[:3, :3] @ X + T[:3, 3])[None])[0, s]
            late = READOUT * (uv[i, 1] / SIZE[1] - 0.5)
    there = np.isfinite(uv[:, 0]) & (rng.random(len(uv)) >= hidden * (stamp > 0.4))
    seen = uv[there] + rng.normal(0.0, SIGMA_PX, (int(there.sum()), 2))
    return SpotFrame(t_s=stamp, spots=spots(seen[rng.permutation(len(seen))]), width=SIZE[0], height=SIZE[1])


def timed(setup: Setup, off: np.ndarray, std_s: float = 1e-4) -> Setup:
    """Return the setup with the cameras' timing in its rig, delays off by these (v,)."""
    covariance = NamedCovariance(
        names=("delay_s", "drift_ppm", "readout_s"), matrix=np.diag([std_s**2, 5.0**2, 2e-4**2])
    )
    cameras = [
        replace(
            one,
            timing=CameraTiming(
                delay_s=DELAYS[k] + float(off[k]),
                drift_ppm=DRIFTS[k],
                readout_s=READOUT,
                covariance=covariance if k else None,
            ),
        )
        for k, one in enumerate(setup.rig.cameras)
    ]
    return replace(setup, rig=replace(setup.rig, cameras=tuple(cameras)))


def run(
    views: int,
    seed: int,
    *,
    off: tuple[float, ...] = (0.0,) * 4,
    knock: Callable[[Ring], Ring] | None = None,
    seconds: float = 5.0,
) -> tuple[FreeRun, Waved]:
    """Return what is measured of a waved target, which the given cameras see as they stand, and its motion."""
    rng, world = np.random.default_rng(seed), ring(views)
    motion = Waved(rng.uniform(0.0, 2.0 * np.pi, 6))
    setup = timed(setup_of(world), np.add(off[:views], np.append(0.0, rng.normal(0.0, 1e-4, views - 1))))
    seen = streams(world if knock is None else knock(world), rng, motion, seconds=seconds)
    return measure_free_running(setup, seen, None, None, Silent()), motion


def errors(done: FreeRun, motion: Waved) -> tuple[np.ndarray, np.ndarray]:
    """Return the errors (n, 6) and squared Mahalanobis distances (n,) of all whole poses."""
    d, q = [], []
    for one in done.poses:
        pose = one.pose
        if pose.status is PoseStatus.OK:
            assert pose.T_parent_target is not None and pose.covariance is not None
            d.append(difference(pose.T_parent_target, motion.pose(pose.t_s)))
            q.append(float(d[-1] @ np.linalg.solve(pose.covariance, d[-1])))
    return np.array(d), np.array(q)


def test_poses_and_clocks_of_three_cameras_are_what_they_claim() -> None:
    inside, late, n = [], [], 0
    for seed in range(1):
        done, motion = run(3, seed)
        d, q = errors(done, motion)
        n += len(d)
        inside.append(q < chi2.ppf(0.95, 6))
        assert np.sqrt(np.mean(np.sum(d[:, :3] ** 2, axis=1))) < 3e-4
        assert done.consistency.verdict == "ok" and done.figures.note is None
        clocks = done.figures.by_camera
        assert clocks is not None and done.figures.n_views is None
        for k, clock in enumerate(clocks.values()):
            assert clock.n_views > 100
            if k:
                assert clock.delay_std_s is not None and clock.delay_std_s < 1.5e-4
                middle = clock.delay_s + 1e-6 * clock.drift_ppm * 2.5
                late.append((middle - DELAYS[k] - 1e-6 * DRIFTS[k] * 2.5) / clock.delay_std_s)
    assert n > 130
    assert np.mean(np.concatenate(inside)) > 0.9
    assert np.abs(late).max() < 3.0


def test_a_camera_whose_clock_is_no_longer_as_calibrated_is_told_and_left_out() -> None:
    with pytest.warns(UserWarning, match="c1.*timing"):
        done, motion = run(3, 5, off=(0.0, 0.006, 0.0))
    assert [one.names for one in done.consistency.left_out] == [("c1",)]
    _, q = errors(done, motion)
    assert len(q) > 100 and np.mean(q < chi2.ppf(0.95, 6)) > 0.85


@pytest.mark.parametrize("turn_deg", [0.007, 0.15])
def test_a_camera_that_was_knocked_is_named_and_left_out(turn_deg: float) -> None:
    def knocked(world: Ring) -> Ring:
        turn = Rotation.from_rotvec([0.0, np.deg2rad(turn_deg), 0.0]).as_matrix()
        R, t = world.R.copy(), world.t.copy()
        R[2], t[2] = turn @ R[2], turn @ t[2]
        return Ring(R, t)

    with pytest.warns(UserWarning, match="c2"):
        done, motion = run(4, 6, knock=knocked, seconds=3.0)
    assert [one.names for one in done.consistency.left_out] == [("c2",)]
    assert {view.side for view in done.views} == {0, 1, 3}
    d, q = errors(done, motion)
    assert len(d) > 60 and np.mean(q < chi2.ppf(0.95, 6)) > 0.85


def moments(seed: int) -> tuple[np.ndarray, np.ndarray, int]:
    """Return errors (n, 6) and squared distances (n,) of moments of frames nearest in time, and how many there are."""
    rng, world = np.random.default_rng(seed), ring(3)
    motion = Waved(rng.uniform(0.0, 2.0 * np.pi, 6))
    setup = timed(setup_of(world), np.zeros(3))
    seen = [list(one.read()) for one in streams(world, rng, motion)]
    times = [setup.rig.timing[s].rig_time([one.t_s for one in each]) for s, each in enumerate(seen)]
    track, d, q = None, [], []
    for k, t in enumerate(times[0]):
        near = [seen[s][int(np.abs(times[s] - t).argmin())] for s in range(3)]
        frames = [Frame(image=np.zeros((8, 8), np.uint8), t_s=one.t_s, sequence=k, source="view") for one in near]
        found = of_spots(setup, frames, [one.spots for one in near], rig_times(setup, frames), track)
        track = found.track
        if found.pose.status is PoseStatus.OK:
            assert found.pose.T_parent_target is not None and found.pose.covariance is not None
            d.append(difference(found.pose.T_parent_target, motion.pose(found.pose.t_s)))
            q.append(float(d[-1] @ np.linalg.solve(found.pose.covariance, d[-1])))
    return np.array(d), np.array(q), len(times[0])


def test_frames_put_together_as_moments_are_brought_to_one_time() -> None:
    d, q, n = moments(0)
    assert len(d) > 0.95 * n
    assert np.sqrt(np.mean(np.sum(d[:, :3] ** 2, axis=1))) < 1.5e-4
    assert np.mean(q < chi2.ppf(0.95, 6)) > 0.92


def test_one_camera_alone_follows_too() -> None:
    done, motion = run(1, 7)
    d, q = errors(done, motion)
    assert len(d) > 100 and np.sqrt(np.mean(np.sum(d[:, :3] ** 2, axis=1))) < 2e-3
    assert np.mean(q < chi2.ppf(0.95, 6)) > 0.85


def test_frames_that_two_cameras_exchange_fit_no_motion() -> None:
    rng, world = np.random.default_rng(8), ring(3)
    motion = Waved(rng.uniform(0.0, 2.0 * np.pi, 6))
    first, second, third = streams(world, rng, motion)
    setup = timed(setup_of(world), np.zeros(3))
    with pytest.raises((NotEnoughData, Inconsistent)):
        measure_free_running(setup, (first, third, second), None, None, Silent())


def test_live_cameras_and_tables_of_a_pair_are_refused() -> None:
    rig = setup_of(ring(3)).rig
    live = FrameSources(cameras={"c0": "camera:0", "c1": "camera:1", "c2": "camera:2"})
    with refuses(UsageError, "camera:0", "Record"):
        live.streams(rig, colour=False)
