"""The ray-traced mirror rig against the closed form of MATH 3.1, which was derived and checked apart from this code."""

from __future__ import annotations

import numpy as np
import pytest

from armsight.errors import Inconsistent
from armsight.store.rigs import rig_from_mapping
from armsight_sim.lens import Lens
from armsight_sim.rigs import Mirrors, mirror_rig, mirror_views


def closed_form(left: np.ndarray, right: np.ndarray, b: float, d: float, n: float) -> np.ndarray:
    """The point of Pachidis eq. (4) with m = l = mu(U_L, V_L): exact for a plate at 45 degrees (MATH 3.1)."""
    U, V = left.T
    cos = (1 - U) / np.sqrt(2 * (1 + U**2 + V**2))
    mu = d / np.sqrt(2) * (1 - cos / np.sqrt(n**2 - 1 + cos**2))
    z = ((b + mu) + mu * U) / (U - right[:, 0]) - b / 2
    x = (z + b / 2) * right[:, 0] + b / 2
    y_right = (z + b / 2) * right[:, 1]
    y_left = (z + b / 2 - mu) * V
    return np.stack([x, y_right, y_left, z], axis=1)


def points(count: int = 500) -> np.ndarray:
    rng = np.random.default_rng(3)
    return rng.uniform([-0.12, -0.09, 0.35], [0.12, 0.09, 0.9], (count, 3))


@pytest.mark.parametrize(("b", "d", "n"), [(0.1, 1e-3, 1.5), (0.06, 1.1e-3, 1.52), (0.15, 3e-3, 1.6)])
def test_the_rays_meet_where_the_exact_form_says(b: float, d: float, n: float) -> None:
    mirrors = Mirrors(baseline_m=b, plate_m=d, index=n)
    P = points()
    found = closed_form(mirrors.image("left", P), mirrors.image("right", P), b, d, n)
    assert np.abs(found - P[:, [0, 1, 1, 2]]).max() < 1e-9


def test_the_plate_matters() -> None:
    """Without the plate's shift the exact form is millimetres off: the comparison above can fail."""
    mirrors = Mirrors(baseline_m=0.1)
    P = points(50)
    found = closed_form(mirrors.image("left", P), mirrors.image("right", P), 0.1, 0.0, 1.5)
    assert np.abs(found[:, 3] - P[:, 2]).max() > 1e-3


def test_printed_constants_of_the_paper() -> None:
    """m = 0.329 mm is the sideways shift of the chief ray (d = 1 mm, n = 1.5)."""
    place, ray = Mirrors(baseline_m=0.1).trace("left", [[0.0, 0.0]])
    assert np.allclose(ray, [[0.0, 0.0, 1.0]], atol=1e-15)
    assert place[0, 0] == pytest.approx(-0.05 - 0.32914e-3, abs=1e-8)


def test_the_right_view_is_a_pinhole() -> None:
    place, ray = Mirrors(baseline_m=0.1).trace("right", np.random.default_rng(1).uniform(-0.3, 0.3, (40, 2)))
    behind = place + ((-0.05 - place[:, 2]) / ray[:, 2])[:, None] * ray
    assert np.abs(behind - [0.05, 0.0, -0.05]).max() < 1e-15


def test_points_behind_the_mirrors_are_not_seen() -> None:
    mirrors = Mirrors(baseline_m=0.1)
    assert np.isnan(mirrors.image("left", [[0.0, 0.0, 0.05], [0.0, 0.0, -1.0]])).all()


@pytest.mark.parametrize("tilts", [((0.0, 0.0),) * 4, ((0.0, 0.0), (4e-3, -3e-3), (2e-3, 5e-3), (-6e-3, 1e-3))])
def test_the_rig_file_stands_for_the_mirrors(tilts: tuple[tuple[float, float], ...]) -> None:
    """A pinhole, and a pinhole behind a plate, describe the two traced views, whichever way the mirrors lean."""
    lens = Lens(width=768, height=576, focal_px=(1000.0, 1000.0), centre_px=(383.5, 287.5))
    views = mirror_views(lens, Mirrors(baseline_m=0.12, tilts_rad=tilts))
    rig = rig_from_mapping(mirror_rig(views))
    P = points(300)
    for side, uv in zip(("left", "right"), rig.project(P), strict=True):
        seen = views[side].project(P)
        inside = ((seen > 0) & (seen < [768, 576])).all(axis=1)
        assert inside.sum() > 50
        assert np.abs((uv - seen)[inside]).max() < 1e-6


@pytest.mark.parametrize("wrong", [{"baseline_m": 0.0}, {"index": 0.9}, {"plate_m": -1e-3}, {"gap_m": 0.0}])
def test_impossible_mirrors_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(Inconsistent):
        Mirrors(**{"baseline_m": 0.1, **wrong})
