"""A plate with a print on each side before cameras on opposite sides: errors against bounds and claims, refusals."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from armsight.calibrate.cameras import BoardOptions
from armsight.calibrate.cameras.many import solve_cameras
from armsight.calibrate.cameras.preconditions import KnownLens
from armsight.calibrate.cameras.two_sides import TwoSided
from armsight.errors import Inconsistent, NotEnoughData
from armsight.optics import Camera
from refusals import refuses

sys.path.insert(0, str(Path(__file__).parent))
from ring_of_cameras import SIZE
from turning_plate import BACK, FRONT, Turning, errors, plate

C = ("a", "b", "c", "d")
SIGMA_PX = 0.1
PLAIN = BoardOptions(folds=0)
BOTH = TwoSided(FRONT, BACK)


def held(of: Turning) -> dict[str, KnownLens]:
    each = zip(C, of.k, strict=True)
    return {name: KnownLens(camera=Camera(width=SIZE[0], height=SIZE[1], intrinsics=k)) for name, k in each}


def test_cameras_on_opposite_sides_stand_within_the_bound_and_their_claim() -> None:
    """Cameras of one side see nothing that those of the other do: only the turning joins them."""
    true = plate((-25.0, 25.0, 155.0, 205.0), 5)
    bound, chi2, own = true.bound(SIGMA_PX), [], []
    for seed in range(4):
        done = solve_cameras(true.views(C, SIGMA_PX, np.random.default_rng(seed)), BOTH, PLAIN, lenses=held(true))
        e, claimed = errors(done, true), done.covariance.block(true.names(C))
        np.testing.assert_allclose(np.sqrt(np.diag(claimed) / np.diag(bound)), 1.0, atol=0.05)
        chi2.append(e @ np.linalg.solve(claimed, e))
        own.append(e**2 / np.diag(bound))
        assert not done.rejected
    # four chi-squares of 24 degrees of freedom: 24 +- 3.5
    assert np.mean(chi2) == pytest.approx(24.0, abs=11.0)
    assert np.sqrt(np.mean(own)) == pytest.approx(1.0, abs=0.35)


def test_a_plate_that_turns_about_one_axis_only_does_not_join_opposite_sides() -> None:
    true = plate((-25.0, 25.0, 155.0, 205.0), 5, most_tilt=0.0)
    with refuses(NotEnoughData, "a, b", "c, d", "one axis"):
        solve_cameras(true.views(C, SIGMA_PX, np.random.default_rng(1)), BOTH, PLAIN, lenses=held(true))


def test_sides_that_are_never_seen_at_one_moment_are_named() -> None:
    true = plate((-25.0, 25.0, 155.0, 205.0), 5, towards=2)
    both = (true.seen == 0).any(axis=1) & (true.seen == 1).any(axis=1)
    odd = np.arange(len(both))[:, None] % 2
    seen = np.where(both[:, None] & (true.seen == odd), -1, true.seen)
    apart = replace(true, seen=seen)
    with refuses(NotEnoughData, "0 moments", "a, b", "c, d"):
        solve_cameras(apart.views(C, SIGMA_PX, np.random.default_rng(1)), BOTH, PLAIN, lenses=held(true))


def test_a_back_of_another_size_is_told_by_how_much() -> None:
    """What a back 2 % larger than said makes is also told where only the plate's turning joins the sides."""
    true = plate((-25.0, 25.0, 155.0, 205.0), 5)
    said = replace(BACK, xyz_m=BACK.xyz_m / 1.02)
    with refuses(Inconsistent, "2.0 % larger"):
        solve_cameras(
            true.views(C, SIGMA_PX, np.random.default_rng(1)), TwoSided(FRONT, said), PLAIN, lenses=held(true)
        )


def test_prints_on_two_plates_are_no_two_sides_of_one() -> None:
    true = plate((0.0, 80.0, 180.0, 260.0), 5)
    loose = np.random.default_rng(4).permutation(len(true.boards))
    seen = true.views(C, SIGMA_PX, np.random.default_rng(1))
    backs = true.seen[loose] == 1
    for c, name in enumerate(C):
        own = [view if side == 0 else None for view, side in zip(seen[name], true.seen[:, c], strict=True)]
        seen[name] = [seen[name][loose[g]] if backs[g, c] and own[g] is None else one for g, one in enumerate(own)]
    with refuses(Inconsistent, "as one"):
        solve_cameras(seen, BOTH, PLAIN, lenses=held(true))
