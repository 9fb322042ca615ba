"""A crown of lights waved before four cameras in place of a board: errors against bounds and claims, refusals."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from armsight.calibrate.cameras import BoardOptions
from armsight.calibrate.cameras.many import solve_cameras
from armsight.calibrate.cameras.preconditions import KnownLens
from armsight.optics import Camera
from armsight.records import spot_target

sys.path.insert(0, str(Path(__file__).parent))
from ring_of_cameras import SIZE
from turning_plate import LIGHTS, crown, errors

C = ("a", "b", "c", "d")
SIGMA_PX = 0.05
OFF_M = 1e-4
PLAIN = BoardOptions(folds=0)
TARGET = spot_target({name: tuple(xyz) for name, xyz in zip("ABCDEF", LIGHTS.tolist(), strict=True)})


@pytest.mark.parametrize("off_m", [0.0, OFF_M])
def test_cameras_stand_within_the_bound_and_their_claim(off_m: float) -> None:
    """With lights known to a tenth of a millimetre only, the claim has that in it."""
    true = crown((-60.0, -20.0, 20.0, 60.0), 3)
    lenses = {
        name: KnownLens(camera=Camera(width=SIZE[0], height=SIZE[1], intrinsics=k))
        for name, k in zip(C, true.k, strict=True)
    }
    bound, chi2, own = true.bound(SIGMA_PX), [], []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        there = replace(true, points=(LIGHTS + off_m * rng.normal(size=LIGHTS.shape),))
        said = replace(TARGET, covariance=off_m**2 * np.eye(18)) if off_m else TARGET
        done = solve_cameras(there.views(C, SIGMA_PX, rng), said, PLAIN, lenses=lenses)
        e, claimed = errors(done, true), done.covariance.block(true.names(C))
        chi2.append(e @ np.linalg.solve(claimed, e))
        own.append(e**2 / np.diag(bound))
        if not off_m:
            np.testing.assert_allclose(np.sqrt(np.diag(claimed) / np.diag(bound)), 1.0, atol=0.08)
    # four chi-squares of 18 degrees of freedom: 18 +- 3
    assert np.mean(chi2) == pytest.approx(18.0, abs=9.5)
    assert (np.sqrt(np.mean(own)) < 1.35) == (off_m == 0.0)
