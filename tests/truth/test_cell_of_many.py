"""A cell of three cameras and more, of which some see the lights seldom: places as claimed, faults named."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from armsight.calibrate.cell import CellResult
from armsight.errors import Inconsistent
from refusals import names_it

sys.path.insert(0, str(Path(__file__).parent))
from cell_calibrated import calibrated, camera_squares
from cell_cameras import Track, WebCam
from cell_world import NAMED, CellWorld, watched_by_four

SECONDS, SEED = 40.0, 1


@pytest.fixture(scope="module")
def four() -> tuple[CellWorld, dict[str, WebCam], dict[str, Track]]:
    world, cameras, tracks = watched_by_four(SEED, SECONDS)
    return world, dict(zip(NAMED, cameras, strict=True)), dict(zip(NAMED, tracks, strict=True))


@pytest.fixture(scope="module")
def good(four: tuple[CellWorld, dict[str, WebCam], dict[str, Track]]) -> CellResult:
    world, _, tracks = four
    return calibrated(world, {name: tracks[name] for name in ("west", "left", "east")})


def test_cameras_stand_where_they_are_said_to_though_they_see_the_lights_seldom(
    four: tuple[CellWorld, dict[str, WebCam], dict[str, Track]], good: CellResult
) -> None:
    _, cameras, tracks = four
    model = good.solved.model
    assert max(camera_squares(cameras, good)) < 22.5  # chi-square of 6, 99.9 %
    # the rig's axes and stamps are the first camera's
    np.testing.assert_allclose(good.T_base_rig.as_matrix(), model.T_base_camera(good.solved.fit.x, 0).as_matrix())
    late = good.rig.cameras[2].timing.delay_s - (cameras["east"].delay_s - cameras["west"].delay_s)
    assert abs(late) < 0.02 + 2e-4 * abs(tracks["east"].t_s).max()
    assert set(good.residual_px) == {"west", "left", "east"} and good.baseline_m is None


def test_what_three_cameras_measure_is_claimed_by_what_they_see_not_by_what_is_in_their_images(
    good: CellResult,
) -> None:
    assert good.tip.measured_m < 3e-3
    assert 20 < len(good.samples) <= 60


def test_which_of_the_cameras_was_touched_is_named(
    four: tuple[CellWorld, dict[str, WebCam], dict[str, Track]],
) -> None:
    world, _, tracks = four
    track = tracks["right"]
    half = track.frame > 0.5 * len(track.t_s)
    touched = replace(track, uv_px=track.uv_px + np.where(half[:, None], [4.0, 2.5], 0.0))
    with pytest.raises(Inconsistent) as caught:
        calibrated(world, {"left": tracks["left"], "top": touched, "east": tracks["east"]})
    assert names_it(caught.value, "top camera", "Fasten")
