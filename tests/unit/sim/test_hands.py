"""How a hand leads a target: from rest, at the speed asked for, along the line."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight_sim.motions import CIRCLE_M, RUN_UP_S, RoundPath, WanderingPath

START = RigidTransform.from_components([0.2, 1.2, 0.1], Rotation.from_rotvec([-2.7, 0.1, 0.0]))
T_S = np.arange(0.0, 20.0, 0.01)


def speeds(path) -> np.ndarray:
    """Speeds in m/s between moments 10 ms apart."""
    return np.linalg.norm(np.diff(path(T_S).translation, axis=0), axis=1) / 0.01


def test_a_round_path_begins_at_rest_and_keeps_its_speed():
    angle = np.linspace(0.0, 2.0 * np.pi, 721)
    path = RoundPath(CIRCLE_M * np.column_stack([np.cos(angle), np.sin(angle)]), START, 0.1, 0.0)
    v = speeds(path)
    assert path(np.zeros(1))[0].translation == pytest.approx(START.translation)
    assert v[0] < 1e-3
    assert v[T_S[1:] > RUN_UP_S + 0.01] == pytest.approx(0.1, rel=1e-3)
    centre = START.translation - [CIRCLE_M, 0.0, 0.0]
    assert np.linalg.norm(path(T_S).translation - centre, axis=1) == pytest.approx(CIRCLE_M, abs=1e-5)


def test_a_hand_at_random_begins_at_rest_and_is_never_faster():
    for seed in range(3):
        path = WanderingPath.drawn(START, 0.1, np.random.default_rng(seed))
        v = speeds(path)
        assert v[0] < 1e-3
        assert 0.04 < v.max() <= 0.1 * 1.001
        assert (path(T_S).rotation * START.rotation.inv()).magnitude().max() > 0.02
