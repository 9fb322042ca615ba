"""Pachidis et al. 2005: the plate's m and l, places by eq. (4), lit areas and their pairs."""

from __future__ import annotations

import numpy as np
import pytest

from armsight.errors import Degenerate, NotEnoughData
from armsight_sim.papers.pachidis2005 import Psvs, light_pairs, lit_areas, plate_shift
from refusals import refuses

ABC_M = np.array([[-0.008, 0.0, 0.6], [0.006, 0.0064, 0.6], [0.006, -0.0064, 0.6]])


def psvs() -> Psvs:
    m, shift = plate_shift(0.001, 1.5)
    return Psvs(au_px=1000.0, av_px=990.0, u0_px=383.5, v0_px=287.5, baseline_m=0.12, m_m=m, l_m=shift)


def views(rig: Psvs, P: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two pinholes of the paper's eqs. (3), by hand: centres (-b/2 - m, 0, -b/2 + l) and (b/2, 0, -b/2)."""
    half, f = rig.baseline_m / 2.0, np.array([rig.au_px, rig.av_px])
    out = []
    for centre in ([-half - rig.m_m, 0.0, -half + rig.l_m], [half, 0.0, -half]):
        d = P - centre
        out.append(f * d[:, :2] / d[:, 2:] + [rig.u0_px, rig.v0_px])
    return out[0], out[1]


def test_m_and_l_are_the_printed_ones() -> None:
    m, shift = plate_shift(0.001, 1.5)
    assert (round(m * 1e3, 3), round(shift * 1e3, 3)) == (0.329, 0.378)


def test_places_come_back_from_their_pixels() -> None:
    rig = psvs()
    P = np.random.default_rng(0).uniform([-0.1, -0.1, 0.4], [0.1, 0.1, 0.8], (100, 3))
    left, right = views(rig, P)
    assert rig.positions(left, right) == pytest.approx(P, abs=1e-12)
    with pytest.raises(Degenerate, match="disparity"):
        rig.positions(right, left)


def test_six_areas_are_found_and_paired_and_small_ones_are_not() -> None:
    rig = psvs()
    left, right = views(rig, ABC_M)
    rows, columns = np.mgrid[0:576, 0:768]
    image = np.full((576, 768), 10, np.uint8)
    for u, v in np.vstack([left, right]):
        image[np.hypot(columns - round(u), rows - round(v)) < 3.6] = 200
    image[200:202, 300:302] = 255  # no cross fits
    image[500:520, 100:120] = 255  # outside the mask
    centres = lit_areas(image, 40.0, rows < 400)
    found_left, found_right = light_pairs(centres)
    assert found_left == pytest.approx(np.rint(left), abs=1e-9)
    assert found_right == pytest.approx(np.rint(right), abs=1e-9)
    with refuses(NotEnoughData, "5 lit"):
        light_pairs(centres[:5])
    assert lit_areas(np.zeros((576, 768), np.uint8), 40.0, rows < 400).shape == (0, 2)
