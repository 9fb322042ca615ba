"""Smoothing of a motion of which the beginning is hardly known, against the same in fractions, which lose no digit."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from armsight.measure.motion.kernels import smoothing
from armsight.measure.motion.kernels.state import STATE, N

TAU, JERK, NOISE = Fraction(1, 64), Fraction(1, 4), Fraction(1, 2**28)
"""Time between views in s, strength of the jerk in m^2/s^5, variance of a view's position in m^2."""
BEGIN = (Fraction(4), Fraction(2**14), Fraction(2**26))
"""Variances of position, speed and acceleration before the first view."""
AXIS = (0, 6, 12)
"""Of x: position, speed, acceleration in the state of 18."""


def times(A: Any, B: Any) -> Any:
    return [[sum(a * b for a, b in zip(row, column, strict=True)) for column in zip(*B, strict=True)] for row in A]


def turned(A: Any) -> Any:
    return [list(row) for row in zip(*A, strict=True)]


def plus(A: Any, B: Any, sign: int = 1) -> Any:
    return [[a + sign * b for a, b in zip(one, other, strict=True)] for one, other in zip(A, B, strict=True)]


def inverse(A: Any) -> Any:
    """By cofactors, of three rows."""
    minors = [
        [
            A[(i + 1) % 3][(j + 1) % 3] * A[(i + 2) % 3][(j + 2) % 3]
            - A[(i + 1) % 3][(j + 2) % 3] * A[(i + 2) % 3][(j + 1) % 3]
            for j in range(3)
        ]
        for i in range(3)
    ]
    det = sum(A[0][j] * minors[0][j] for j in range(3))
    return [[minors[j][i] / det for j in range(3)] for i in range(3)]


F = [[Fraction(1), TAU, TAU**2 / 2], [Fraction(0), Fraction(1), TAU], [Fraction(0), Fraction(0), Fraction(1)]]
Q = [
    [JERK * TAU**5 / 20, JERK * TAU**4 / 8, JERK * TAU**3 / 6],
    [JERK * TAU**4 / 8, JERK * TAU**3 / 3, JERK * TAU**2 / 2],
    [JERK * TAU**3 / 6, JERK * TAU**2 / 2, JERK * TAU],
]


def exact(n: int) -> tuple[list[Any], list[Any], list[Any]]:
    """Return covariances before and after each of n positions, and of all of them (Kalman; Rauch, Tung, Striebel)."""
    before, after = [], []
    C = [[BEGIN[i] if i == j else Fraction(0) for j in range(3)] for i in range(3)]
    for k in range(n):
        C = C if k == 0 else plus(times(times(F, C), turned(F)), Q)
        before.append(C)
        C = [[C[i][j] - C[i][0] * C[0][j] / (C[0][0] + NOISE) for j in range(3)] for i in range(3)]
        after.append(C)
    smoothed = [after[-1]]
    for k in range(n - 2, -1, -1):
        K = times(times(after[k], turned(F)), inverse(before[k + 1]))
        smoothed.insert(0, plus(after[k], times(times(K, plus(smoothed[0], before[k + 1], -1)), turned(K))))
    return before, after, smoothed


def in_a_state(covariance: Any) -> Any:
    """Return x as one axis of 18 of which the others are known alike."""
    C = np.eye(N)
    C[np.ix_(AXIS, AXIS)] = [[float(value) for value in row] for row in covariance]
    return C


@pytest.mark.parametrize("n", (3, 6, 12))
def test_a_vague_beginning_costs_no_digits(n: int) -> None:
    """Of the first speeds 1e-10 of the variance is left, which the difference of two covariances does not hold."""
    before, after, smoothed = exact(n)
    Cp, Cs = (np.array([in_a_state(one) for one in some]) for some in (before, after))
    xs = np.zeros((n, STATE))
    xs[:, 3:12] = np.eye(3).ravel()
    Fs = np.zeros((n, N, N))
    Fs[1:] = np.eye(N)
    Fs[1:, *np.ix_(AXIS, AXIS)] = [[float(value) for value in row] for row in F]
    none = np.zeros((n, N, 0))
    t = float(TAU) * np.arange(n)
    motion = (np.full(n, float(JERK)), 1.0)
    assert smoothing.smooth(t, motion, (xs, Cs, none), (xs.copy(), Cp, none, Fs))
    got = Cs[:, AXIS, AXIS]
    right = np.array([[float(one[i][i]) for i in range(3)] for one in smoothed])
    assert (got > 0.0).all()
    assert np.allclose(got, right, rtol=1e-3, atol=0.0)
