"""The servo's law and its gains against what MATH 3.3 says of them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.control.servo import (
    chosen_gain,
    delay_cycles,
    no_overshoot_gain,
    servo_error,
    servo_twist,
    stability_gain,
)
from armsight.errors import Inconsistent, UsageError

DESIRED = RigidTransform.from_components([0.02, -0.03, 0.7], Rotation.from_rotvec([0.1, 0.2, -1.3])).as_matrix()
HAND_EYES = [Rotation.identity(), *(Rotation.from_euler(a, d, degrees=True) for a in "xyz" for d in (90.0, 180.0))]


def followed(start: np.ndarray, desired: np.ndarray, gain: float, seconds: float) -> list[np.ndarray]:
    """Let a flange that obeys the law approach a target at rest; return T_flange_target at every step."""
    T_base_flange, T_base_target, dt_s = np.eye(4), start, 0.002
    seen = []
    for _ in range(round(seconds / dt_s)):
        T = np.linalg.inv(T_base_flange) @ T_base_target
        seen.append(T)
        v, omega = servo_twist(servo_error(T, desired), desired[:3, 3], gain, gain)
        step = RigidTransform.from_exp_coords(dt_s * np.concatenate([omega, v])).as_matrix()
        T_base_flange = T_base_flange @ step
    return seen


@pytest.mark.parametrize("hand_eye", HAND_EYES, ids=lambda R: str(np.round(R.as_rotvec(degrees=True))))
def test_both_errors_decay_exactly_for_every_hand_eye_rotation(hand_eye):
    desired = RigidTransform.from_components([0.05, 0.0, 0.6], hand_eye).as_matrix()
    off = RigidTransform.from_components([0.1, -0.2, 0.15], Rotation.from_rotvec([0.5, -0.8, 0.9]))
    seen = followed(off.as_matrix() @ desired, desired, 2.0, 2.0)
    first, last = servo_error(seen[0], desired), servo_error(seen[-1], desired)
    share = np.exp(-2.0 * 2.0)
    assert np.linalg.norm(last.translation_m) == pytest.approx(share * np.linalg.norm(first.translation_m), rel=0.03)
    assert np.linalg.norm(last.rotation_rad) == pytest.approx(share * np.linalg.norm(first.rotation_rad), rel=0.03)


def test_a_pure_error_of_rotation_turns_the_hand_about_the_desired_point():
    turn = Rotation.from_euler("y", 10.0, degrees=True).as_matrix()
    start = DESIRED.copy()
    start[:3, :3] = turn @ DESIRED[:3, :3]
    seen = followed(start, DESIRED, 2.0, 3.0)
    assert max(np.linalg.norm(T[:3, 3] - DESIRED[:3, 3]) for T in seen) < 1e-4  # 46 mm without the lever arm


def test_a_gain_of_rotation_of_zero_holds_the_rotation():
    T = RigidTransform.from_components([0.1, 0.0, 0.8], Rotation.from_rotvec([0.3, 0.0, 0.0])).as_matrix()
    v, omega = servo_twist(servo_error(T, DESIRED), DESIRED[:3, 3], 2.0, 0.0)
    assert not omega.any()
    assert v == pytest.approx(2.0 * (T[:3, 3] - DESIRED[:3, 3]))


def delayed(K: float, T: float, n: int, steps: int = 4000) -> np.ndarray:
    """Return e[k + 1] = e[k] - K T e[k - n] from a step of one."""
    e = np.zeros(steps + n + 1)
    e[: n + 1] = 1.0
    for k in range(n, steps + n):
        e[k + 1] = e[k] - K * T * e[k - n]
    return e


@pytest.mark.parametrize(
    ("n", "stable", "calm"), [(0, 2.0, 1.0), (1, 1.0, 0.25), (2, 0.618, 0.148), (3, 0.445, 0.1055)]
)
def test_limits_of_the_gain_are_those_of_the_delayed_loop(n, stable, calm):
    T = 0.07
    limit = stability_gain(T, n)
    assert limit * T == pytest.approx(stable, abs=5e-4)
    assert no_overshoot_gain(T, n) * T == pytest.approx(calm, abs=5e-4)
    assert np.abs(delayed(0.97 * limit, T, n)[-50:]).max() < 1e-3
    assert np.abs(delayed(1.03 * limit, T, n)[-50:]).max() > 10.0
    assert delayed(0.99 * no_overshoot_gain(T, n), T, n).min() > -1e-9
    assert delayed(1.05 * no_overshoot_gain(T, n), T, n).min() < -1e-6


def test_delays_count_begun_cycles_whole():
    assert [delay_cycles(d, 0.07) for d in (0.0, 0.01, 0.07, 0.14, 0.141)] == [0, 1, 1, 2, 3]
    with pytest.raises(UsageError, match="delay"):
        delay_cycles(-0.01, 0.07)


def test_the_gain_is_the_largest_without_overshoot_unless_asked_for():
    gain = chosen_gain(None, 0.07, 0.14)
    assert gain.used == pytest.approx(2.116, abs=1e-3)
    assert (gain.n_delay, gain.note) == (2, "")
    assert "overshoots" in chosen_gain(4.0, 0.07, 0.14).note


@pytest.mark.parametrize("asked", [8.83, 20.0, 0.0, -1.0, np.nan])
def test_a_gain_that_is_not_stable_is_refused_with_the_one_that_is(asked):
    with pytest.raises(Inconsistent, match=r"2\.116 1/s"):
        chosen_gain(asked, 0.07, 0.14)
    assert chosen_gain(8.82, 0.07, 0.14).stable == pytest.approx(8.829, abs=1e-3)
