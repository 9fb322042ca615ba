"""A moving target seen by two free-running cameras with rolling shutters; paths and pinholes are made here."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import chi2 as chi2_law

from armsight.measure.motion.estimate import MotionFilter, Start, smooth
from armsight.measure.motion.states import MotionState, TimingEstimate, TimingPrior, View
from armsight.optics import Camera, PackedRig, parallel_rig

Array = NDArray[np.float64]
F, CX, CY, HEIGHT, BASE = 950.0, 639.5, 359.5, 720, 0.12
PACKED = PackedRig.of(parallel_rig(Camera.pinhole(1280, HEIGHT, F, F, CX, CY), BASE))
LIGHTS = np.array([[-0.04, 0.0, 0.0], [0.03, 0.032, 0.0], [0.03, -0.032, 0.0]])
LIGHTS.setflags(write=False)  # as those of a target: kernels are compiled for it already
NOISE, READOUT = 0.05, 0.02
CENTRE = np.array([0.05, 0.0, 0.8])
Path = Callable[[Array | float], tuple[Array, Rotation]]
"""Where the target is at moments (...), and how it is turned there (flat)."""


def path(rng: np.random.Generator, speed: float, *, begins_s: float = -1.0) -> Path:
    """A hand's motion of this RMS speed, turning three radians for each metre; at rest until begins_s."""
    f, phase = rng.uniform(0.2, 1.5, (2, 6, 5)) * [[[1.0]], [[4.0]]]
    amplitude = rng.uniform(0.5, 1.0, (6, 5)) / f
    rate = np.sqrt(((2 * np.pi * f * amplitude) ** 2 / 2).sum(axis=1))
    amplitude *= (
        np.repeat([speed, 3.0 * speed], 3)[:, None]
        / np.repeat([np.linalg.norm(rate[:3]), np.linalg.norm(rate[3:])], 3)[:, None]
    )

    def at(t: Array | float) -> tuple[Array, Rotation]:
        s = np.maximum(np.asarray(t) - begins_s, 0.0)
        ease = s - 0.15 * (1.0 - np.exp(-s / 0.15))  # sets off within a third of a second
        way = (amplitude * np.sin(2 * np.pi * f * ease[..., None, None] + phase)).sum(axis=-1)
        turned = Rotation.from_rotvec(way[..., 3:].reshape(-1, 3) if ease.ndim else way[3:])
        return CENTRE + way[..., :3], turned * Rotation.from_euler("x", 0.4)

    return at


def pixels(way: Path, t: Array, side: Array) -> tuple[Array, Array]:
    """Where the lights are seen (n, 3, 2) by a rolling shutter, and when after the middle line (n, 3)."""
    tau = np.zeros((len(t), 3))
    for _ in range(5):
        p, R = way(t[:, None] + tau)
        P = p + R.apply(np.tile(LIGHTS, (len(t), 1))).reshape(-1, 3, 3)
        P[..., 0] -= BASE * side[:, None]
        uv = np.stack([F * P[..., 0] / P[..., 2] + CX, F * P[..., 1] / P[..., 2] + CY], axis=-1)
        tau = READOUT * (uv[..., 1] / (HEIGHT - 1) - 0.5)
    return uv, tau


def views(way: Path, rng: np.random.Generator, seconds: float, *, delay: float = 0.012) -> list[View]:
    """Views of both cameras at 30 a second, 2 % of them lost."""
    taken = sorted((n / 30.0 + delay * side, side) for n in range(int(30 * seconds)) for side in (0, 1))
    seen = []
    for (t, side), uv, tau in zip(taken, *pixels(way, *np.array(taken).T), strict=True):
        if rng.random() < 0.02 and t > 0.1:
            continue
        noisy = uv + rng.normal(0.0, NOISE, uv.shape)
        cov = np.tile(NOISE**2 * np.eye(2), (3, 1, 1))
        seen.append(View(t_s=t, side=side, lights=np.arange(3), uv_px=noisy, cov_px2=cov, tau_s=tau))
    return seen


def start(way: Path) -> Start:
    """A rough pose at the first view."""
    p, R = way(0.0)
    T = np.eye(4)
    T[:3, :3] = (Rotation.from_rotvec([0.03, -0.02, 0.05]) * R).as_matrix()
    T[:3, 3] = p + np.array([0.003, -0.002, 0.006])
    return Start(view=0, T=T, covariance=1e-6 * np.eye(6))


def errors(states: list[MotionState], way: Path) -> tuple[Array, Array]:
    """Errors of the poses (n, 6) and their squares over the claims (n,)."""
    p, R = way(np.array([state.t_s for state in states]))
    T = np.array([state.T_rig_target for state in states])
    d = np.hstack([T[:, :3, 3] - p, (Rotation.from_matrix(T[:, :3, :3]) * R.inv()).as_rotvec()])
    C = np.array([state.covariance for state in states])
    return d, np.einsum("ni,ni->n", d, np.linalg.solve(C, d[..., None])[..., 0])


def told(states: Sequence[MotionState | None]) -> list[MotionState]:
    """The states, all of which there are."""
    assert all(state is not None for state in states)
    return [state for state in states if state is not None]


@pytest.mark.parametrize("speed", [0.5, 1.0])
def test_smoothed_poses_and_velocities_are_as_good_as_claimed(speed: float) -> None:
    """Poses share views, so that the shares inside have a standard deviation of some 4 %."""
    rng = np.random.default_rng([0, int(10 * speed)])
    way = path(rng, speed)
    at = np.arange(0.5, 5.5, 1.0 / 30.0)
    states = told(smooth(PACKED, LIGHTS, views(way, rng, 6.0), [start(way)], at).states)
    d, q = errors(states, way)
    assert np.mean(q < 12.59) > 0.88
    assert np.sqrt(np.mean(np.sum(d[:, :3] ** 2, axis=1))) < 2.6e-4  # a pair of one moment has 0.20 to 0.26 mm
    h = 1e-4
    (p0, R0), (p1, R1) = way(at - h), way(at + h)
    e = np.array([s.velocity for s in states]) - np.hstack([p1 - p0, (R1 * R0.inv()).as_rotvec()]) / (2.0 * h)
    C = np.array([s.velocity_covariance for s in states])
    assert np.mean(np.einsum("ni,ni->n", e, np.linalg.solve(C, e[..., None])[..., 0]) < 12.59) > 0.86


def test_the_onset_of_a_motion_is_covered() -> None:
    inside = []
    for seed in range(2):
        rng = np.random.default_rng(seed)
        way = path(rng, 0.5, begins_s=2.0)
        states = told(
            smooth(PACKED, LIGHTS, views(way, rng, 4.0), [start(way)], np.arange(1.8, 3.0, 1.0 / 30.0)).states
        )
        inside.append(np.mean(errors(states, way)[1] < 12.59))
    assert np.mean(inside) > 0.85


def test_the_causal_filter_holds_its_claims_also_while_one_camera_is_covered() -> None:
    rng = np.random.default_rng(6)
    way = path(rng, 0.3)
    first = start(way)
    seen = [v for v in views(way, rng, 6.0) if not (v.side == 1 and 3.0 < v.t_s < 3.5)]
    causal = MotionFilter.begin(PACKED, LIGHTS, 0.0, first.T, first.covariance)
    states = []
    for view in seen:
        causal = causal.add(view)
        states.append(causal.state)
    _, q = errors(states[60:], way)
    assert np.mean(q < 12.59) > 0.88
    covered = [s for s in states if 3.05 < s.t_s < 3.5]
    d, q = errors(covered, way)
    assert len(covered) > 10 and np.mean(q < 16.8) > 0.9
    assert np.abs(d[:, :3]).max() < 0.02
    smoothed = told(smooth(PACKED, LIGHTS, seen, [first], np.arange(3.0, 3.5, 0.02)).states)
    assert np.linalg.norm(errors(smoothed, way)[0][:, :3], axis=1).max() < np.linalg.norm(d[:, :3], axis=1).max()


def test_nothing_is_said_far_from_any_view_and_a_track_may_begin_anew() -> None:
    rng = np.random.default_rng(7)
    way = path(rng, 0.2)
    seen = [v for v in views(way, rng, 8.0) if not 2.0 < v.t_s < 5.0]
    again = next(i for i, v in enumerate(seen) if v.t_s >= 5.0)
    p, R = way(seen[again].t_s)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R.as_matrix(), p + 0.004
    starts = [start(way), Start(view=again, T=T, covariance=1e-6 * np.eye(6))]
    at = np.array([1.0, 3.5, 6.0, 7.0])
    states = smooth(PACKED, LIGHTS, seen, starts, at).states
    assert states[1] is None
    _, q = errors([s for s in states if s is not None], way)
    assert (q < 25.0).all()


def test_measured_poses_enter_the_filter_as_they_claim_and_a_turn_of_one_of_them_stands_out() -> None:
    rng = np.random.default_rng(9)
    way = path(rng, 0.3)
    std = np.array([2e-4, 2e-4, 1e-3, 5e-3, 5e-3, 2e-3])

    def measured(t: float) -> Array:
        p, R = way(t)
        T, e = np.eye(4), rng.normal(0.0, std)
        T[:3, 3], T[:3, :3] = p + e[:3], (Rotation.from_rotvec(e[3:]) * R).as_matrix()
        return T

    C = np.diag(std**2)
    follower = MotionFilter.begin(PACKED, LIGHTS, 0.0, measured(0.0), C)
    states, sizes = [], []
    for n in range(1, 240):
        follower, mahalanobis2, knocked = follower.add_pose(n / 30.0, measured(n / 30.0), C)
        states.append(follower.state)
        sizes.append(mahalanobis2)
        assert knocked <= mahalanobis2 + 1e-9
    _, q = errors(states[20:], way)
    assert np.mean(q < 12.59) > 0.88
    assert 3.0 < np.mean(sizes[20:]) < 9.0 and np.max(sizes[20:]) < 37.0
    wrong = measured(8.0)
    wrong[:3, :3] = Rotation.from_rotvec([0.35, 0.0, 0.0]).as_matrix() @ wrong[:3, :3]
    _, mahalanobis2, knocked = follower.add_pose(8.0, wrong, C)
    assert mahalanobis2 > 200.0 and knocked > 37.0


PRIOR_S = 2e-4
PRIOR = TimingPrior(mid_s=2.5, covariance=np.diag([PRIOR_S**2, 20.0**2, 1e-8, 1e-8]), readout_s=(READOUT, READOUT))


def believed(seen: list[View], off: Array) -> list[View]:
    """The views as somebody has them whose delay, drift and read-outs are off by (4,)."""
    late = PRIOR.lines(seen) @ off
    ends = np.concatenate([[0], np.cumsum([len(view.lights) for view in seen])]).tolist()
    return [replace(view, tau_s=view.tau_s - late[a:b]) for view, a, b in zip(seen, ends, ends[1:], strict=False)]


@cache
def found(seed: int, speed: float) -> tuple[Array, TimingEstimate, Array, Array]:
    """What was off, the estimate, and the squares of the poses' errors over claims with and without the timing's."""
    rng = np.random.default_rng([seed, 14])
    way = path(rng, speed)
    off = rng.multivariate_normal(np.zeros(4), PRIOR.covariance)
    at = np.arange(0.5, 4.5, 0.1)
    done = smooth(PACKED, LIGHTS, believed(views(way, rng, 5.0), off), [start(way)], at, PRIOR)
    assert done.timing is not None
    states = told(done.states)
    d, _ = errors(states, way)
    claimed = [s.covariance + s.by_timing[:6] @ done.timing.covariance @ s.by_timing[:6].T for s in states]
    q = np.einsum("ni,ni->n", d, np.linalg.solve(np.array(claimed), d[..., None])[..., 0])
    return off, done.timing, q, d


def test_a_moving_target_tells_the_timing_as_well_as_claimed() -> None:
    """Four estimates of four unknowns."""
    mahalanobis2, gain = [], []
    for seed in range(4):
        off, timing, _, _ = found(seed, 0.5)
        error = timing.change - off
        mahalanobis2.append(error @ np.linalg.solve(timing.covariance, error))
        gain.append(np.sqrt(timing.covariance[0, 0]) / PRIOR_S)
    assert chi2_law.ppf(1e-3, 16) < np.sum(mahalanobis2) < chi2_law.isf(1e-3, 16)
    assert np.median(gain) < 0.25


def test_poses_are_as_good_as_claimed_with_the_timing_they_told() -> None:
    """Depth is 7 times as sensitive as the sides: 0.2 ms would be 0.7 mm at 0.5 m/s."""
    inside, depth = [], []
    for seed in range(3):
        _, _, q, d = found(seed, 0.5)
        inside.append(np.mean(q < 12.59))
        depth.append(d[:, 2])
    assert np.mean(inside) > 0.88
    assert np.sqrt(np.mean(np.square(depth))) < 2.5e-4


def test_a_target_at_rest_tells_nothing_of_the_timing() -> None:
    _, timing, _, _ = found(0, 0.0)
    assert np.sqrt(timing.covariance[0, 0]) > 0.95 * PRIOR_S
    assert np.abs(timing.change[0]) < PRIOR_S
