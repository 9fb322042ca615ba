"""Claims of smoothed poses for a hand that follows no model of the product: reaches, rests, reversals and tremor."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.measure.motion.estimate import Start, smooth
from armsight.measure.motion.states import View
from armsight.optics import Camera, PackedRig, Rig, RigKind

sys.path.insert(0, str(Path(__file__).parent))
from hand_held import HEIGHT, LIGHTS, MOUNTS, WIDTH, Clocks, Mount, hand, off, record

NOISE_PX, SECONDS = 0.05, 6.0
CHI2_6 = 12.592


def packed(mount: Mount) -> PackedRig:
    places, axes = mount.axes
    f, cx, cy = mount.focal_px, (WIDTH - 1) / 2, (HEIGHT - 1) / 2
    camera = Camera.pinhole(WIDTH, HEIGHT, f, f, cx, cy)
    left, right = (
        RigidTransform.from_components(p, Rotation.from_matrix(R)) for p, R in zip(places, axes, strict=True)
    )
    return PackedRig.of(Rig(kind=RigKind.STEREO, left=camera, right=camera, T_rig_left=left, T_rig_right=right))


def inside(mount: Mount, speed: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Which poses at the left frames' times are in their 95 % ellipsoids, and how far off their positions are, mm."""
    rng = np.random.default_rng([seed, int(100 * speed)])
    way, clocks = hand(rng, speed, SECONDS, mount), Clocks(jitter_s=0.0)
    views = []
    for side, seen in enumerate(record(rng, way, mount, clocks, SECONDS, NOISE_PX)):
        for t, uv in zip(seen.t_s.tolist(), seen.uv_px, strict=True):
            if len(uv) < 3:
                continue
            at = t + side * (clocks.delay_s + 1e-6 * clocks.drift_ppm * t)
            tau = clocks.readout_s[side] * (uv[:, 1] / (HEIGHT - 1) - 0.5)
            cov = np.tile(NOISE_PX**2 * np.eye(2), (3, 1, 1))
            views.append(View(t_s=at, side=side, lights=np.arange(3), uv_px=uv, cov_px2=cov, tau_s=tau))
    views.sort(key=lambda view: view.t_s)
    p, R = way(np.array([views[0].t_s]))
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R[0].as_matrix(), p[0]
    at_s = np.array([v.t_s for v in views if v.side == 0 and 0.5 < v.t_s < SECONDS - 0.5])
    states = smooth(packed(mount), LIGHTS, views, [Start(view=0, T=T, covariance=1e-6 * np.eye(6))], at_s).states
    found, mm = [], []
    for state in states:
        assert state is not None
        e = off(state.T_rig_target, way, state.t_s)
        found.append(e @ np.linalg.solve(state.covariance, e) < CHI2_6)
        mm.append(1e3 * np.linalg.norm(e[:3]))
    return np.array(found), np.array(mm)


@pytest.mark.parametrize("speed", [0.0, 0.1])
def test_a_hands_tremor_and_reversals_are_inside_what_smoothed_poses_claim(speed: float) -> None:
    """Three runs of 5 s; poses share views, the share inside has a standard deviation of some 3 %.

    With the strength of the motion from the views before each one alone they fail (44 % and 61 % of longer runs).
    """
    runs = [inside(mount, speed, 0) for mount in MOUNTS.values()]
    assert np.mean(np.concatenate([found for found, _ in runs])) > 0.90
    assert np.sqrt(np.mean(np.concatenate([mm for _, mm in runs]) ** 2)) < 0.15  # no wider either: it was 0.09
