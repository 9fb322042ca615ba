"""Free-running frames of a moving target, one of them after the other; images and pinholes are made here."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from armsight.measure.follow import Follower
from armsight.measure.motion.estimate import smooth
from armsight.measure.poses.setup import Setup
from armsight.optics import Camera, parallel_rig
from armsight.records import CameraTiming, Frame, spot_target

Array = NDArray[np.float64]
WIDTH, HEIGHT, F, BASE = 640, 480, 700.0, 0.1
RIG = parallel_rig(Camera.pinhole(WIDTH, HEIGHT, F, F, 319.5, 239.5), BASE)
TARGET = spot_target({"A": (-0.05, 0.0, 0.0), "B": (0.03, 0.04, 0.0), "C": (0.02, -0.03, 0.0)})
READOUT, DELAY, RATE = 0.02, 0.013, 30.0
LAMP = np.array([-0.3, 0.2, 1.5])


def path(t: float) -> tuple[Array, Rotation]:
    """A hand's motion of some 0.2 m/s that begins from rest."""
    s = t - 0.3 * (1.0 - np.exp(-t / 0.3))
    way = 0.08 * np.array([np.sin(2.1 * s), np.sin(1.7 * s + 0.4) - np.sin(0.4), np.sin(2.6 * s)])
    return np.array([0.05, 0.0, 0.8]) + way, Rotation.from_rotvec([0.3 * np.sin(1.9 * s), 0.2, 0.4 * np.sin(1.3 * s)])


def seen(t: float, side: int) -> Array:
    """Pixels (n, 2) of the target's lights and of a lamp, each at its line's time."""
    out = []
    for n in range(len(TARGET.names) + 1):
        late = 0.0
        for _ in range(5):
            p, R = path(t + late)
            P = (LAMP if n == len(TARGET.names) else p + R.apply(TARGET.xyz_m[n].copy())) - [BASE * side, 0.0, 0.0]
            uv = np.array([F * P[0] / P[2] + 319.5, F * P[1] / P[2] + 239.5])
            late = READOUT * (uv[1] / (HEIGHT - 1) - 0.5)
        out.append(uv)
    return np.array(out)


def frame(t: float, side: int, number: int, *, covered: bool = False) -> Frame:
    """A dark image with Gaussian lights and noise of two grey levels."""
    image = np.random.default_rng([side, number]).normal(12.0, 2.0, (HEIGHT, WIDTH))
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    for n, (u, v) in enumerate(seen(t, side)):
        if covered and n < len(TARGET.names):
            continue
        box = np.s_[max(int(v) - 9, 0) : int(v) + 10, max(int(u) - 9, 0) : int(u) + 10]
        image[box] += 150.0 * np.exp(-((x[box] - u) ** 2 + (y[box] - v) ** 2) / (2.0 * 1.6**2))
    picture = np.clip(np.rint(image), 0, 255).astype(np.uint8)
    return Frame(image=picture, t_s=t, sequence=number, source="left" if side == 0 else "right")


def followed(*, covered: tuple[float, float] = (9.0, 9.0), seconds: float = 2.5) -> Follower:
    """Follow the target through both cameras' frames; the right one is covered between two times."""
    timing = CameraTiming(readout_s=READOUT)
    stamps = replace(timing, delay_s=DELAY)  # the right camera's clock is behind by the delay
    follower = Follower(setup=Setup(RIG, TARGET), timing=(timing, stamps))
    taken = sorted((n / RATE + DELAY * side, side, n) for n in range(int(seconds * RATE)) for side in (0, 1))
    for t, side, n in taken:
        hidden = side == 1 and covered[0] < t < covered[1]
        shot = frame(t, side, n, covered=hidden)
        follower.add(shot if side == 0 else replace(shot, t_s=t - DELAY), side)
    return follower


def check(follower: Follower, at: Array) -> None:
    """Poses at all times, within their claims and a millimetre."""
    states = smooth(follower.setup.packed, follower.setup.model.xyz_m, follower.views, follower.starts, at).states
    q = []
    for state in states:
        assert state is not None
        p, R = path(state.t_s)
        T = state.T_rig_target
        d = np.concatenate([T[:3, 3] - p, (Rotation.from_matrix(T[:3, :3]) * R.inv()).as_rotvec()])
        assert np.linalg.norm(d[:3]) < 0.001 and np.linalg.norm(d[3:]) < 0.02
        q.append(d @ np.linalg.solve(state.covariance, d))
    assert np.mean(np.array(q) < 12.59) > 0.85


def test_free_running_rolling_shutters_give_poses_at_any_time() -> None:
    follower = followed()
    assert len(follower.starts) == 1
    assert len(follower.views) > 0.95 * 2 * 2.5 * RATE
    check(follower, np.arange(0.2, 2.3, 0.02))


def test_a_covered_camera_leaves_the_other_to_go_on() -> None:
    follower = followed(covered=(1.0, 1.4))
    assert len(follower.starts) == 1
    check(follower, np.arange(0.9, 1.5, 0.02))


def test_without_both_cameras_nothing_begins_and_it_is_said_why() -> None:
    follower = Follower(setup=Setup(RIG, TARGET))
    assert follower.add(frame(0.0, 0, 0), 0) is None
    assert "two cameras" in follower.why
    empty = replace(frame(0.0, 1, 0), image=np.full((HEIGHT, WIDTH), 12, np.uint8))
    assert follower.add(empty, 1) is None
    assert follower.why != "" and follower.views == []


@pytest.mark.parametrize("gap", [0.2, 1.0])
def test_a_track_goes_over_a_short_gap_and_begins_anew_after_a_long_one(gap: float) -> None:
    follower = Follower(setup=Setup(RIG, TARGET), timing=(CameraTiming(readout_s=READOUT),) * 2)
    taken = sorted((n / RATE + DELAY * side, side, n) for n in range(60) for side in (0, 1))
    for t, side, n in taken:
        if not 0.8 < t < 0.8 + gap:
            follower.add(frame(t, side, n), side)
    assert len(follower.starts) == (1 if gap < 0.5 else 2)
