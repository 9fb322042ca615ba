"""A camera that swings before a target at rest, shown as it is or otherwise; the shown poses are made here."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from armsight.control.servo.premise import FEWEST, PremiseWatch

TARGET_M = np.array([0.03, -0.02, 0.5])
FRAME_S = 0.033
NOISE_M = np.array([2e-5, 2e-5, 1.5e-4])


def rigs(n: int) -> list[np.ndarray]:
    """Return poses (4, 4) of a camera that rests, then goes 10 mm and more to all sides, and turns by some degrees."""
    out = []
    for k in range(n):
        s = max(k - 10, 0) * FRAME_S
        T = np.eye(4)
        T[:3, 3] = 0.02 * np.sin([1.9 * s, 1.3 * s, 2.3 * s])
        T[:3, :3] = Rotation.from_rotvec(0.06 * np.sin([1.5 * s, 2.1 * s, 1.1 * s])).as_matrix()
        out.append(T)
    return out


def seen(T: np.ndarray) -> np.ndarray:
    """Return where (3,) a camera at T sees the target."""
    return T[:3, :3].T @ (TARGET_M - T[:3, 3])


def watched(show, n: int = 45, late: int = 0, seed: int = 0) -> PremiseWatch:
    """Return a watch that was shown show(x) of a target seen at x, `late` frames after it was so."""
    watch, rng, camera = PremiseWatch(), np.random.default_rng(seed), rigs(n)
    for k in range(n):
        xyz_m = show(seen(camera[max(k - late, 0)])) + NOISE_M * rng.normal(size=3)
        watch.see(k * FRAME_S, camera[k], xyz_m, NOISE_M)
    return watch


def turned(axis: str, deg: float):
    return Rotation.from_euler(axis, deg, degrees=True).apply


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(
    "show",
    [
        lambda x: x,
        turned("x", 1.0),  # what a calibration by hand-eye may be off
        turned("z", -1.0),
        lambda x: 1.01 * x,
        lambda x: x + 0.004 * np.array([1.0, -1.0, 1.0]),
    ],
)
def test_what_is_as_believed_is_no_wrong_premise(show, seed):
    assert watched(show, seed=seed).wrong is None


def test_who_has_looked_begins_anew_and_what_was_seen_before_the_motion_still_counts():
    watch = watched(turned("z", 180.0))
    assert watch.way_m > 0.01
    watch.forget()
    assert watch.wrong is None
    assert watch.way_m == 0.0
    for k in range(FEWEST - 1):
        watch.see(5.0 + k * FRAME_S, np.eye(4), TARGET_M, NOISE_M)
        assert watch.wrong is None
