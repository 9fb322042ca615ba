"""Picks found in the other view, on a plane rendered by ray casting with cameras written out here."""

import math
from functools import lru_cache

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.errors import Ambiguous, Degenerate, Inconsistent, NotEnoughData
from armsight.measure.correspondence import PatchSettings, StereoViews, find_in_other_view
from armsight.optics import Camera, Rig, RigKind
from refusals import refuses

WIDTH, HEIGHT, FOCAL, BASELINE, TURN = 320, 240, 400.0, 0.1, math.radians(-6)
K1 = -0.15
# the plane z = 0.7 + 0.3 x - 0.2 y in the left camera's axes
OFFSET, SLOPE = 0.7, np.array([0.3, -0.2])
CAMERA = Camera.pinhole(
    width=WIDTH, height=HEIGHT, fx=FOCAL, fy=FOCAL, cx=160.3, cy=119.6, distortion=(K1, 0.0, 0.0, 0.0, 0.0)
)
RIG = Rig(
    kind=RigKind.STEREO,
    left=CAMERA,
    right=CAMERA,
    T_rig_left=RigidTransform.identity(),
    T_rig_right=RigidTransform.from_components([BASELINE, 0.0, 0.0], Rotation.from_rotvec([0.0, TURN, 0.0])),
)
SETTINGS = PatchSettings(near_m=0.4, far_m=1.6)


def directions(uv):
    """Rays (n, 3) of pixels (n, 2): the lens's k1 undone by fixed-point steps."""
    distorted = (uv - [160.3, 119.6]) / FOCAL
    xy = distorted.copy()
    for _ in range(30):
        xy = distorted / (1 + K1 * np.sum(xy**2, axis=1, keepdims=True))
    return np.append(xy, np.ones((len(xy), 1)), axis=1)


def on_plane(uv, side):
    """Points (n, 3) of the plane seen at pixels (n, 2) of a view, in the left camera's axes."""
    c, s = math.cos(TURN), math.sin(TURN)
    R = np.eye(3) if side == "left" else np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    centre = np.zeros(3) if side == "left" else np.array([BASELINE, 0.0, 0.0])
    way = directions(uv) @ R.T
    normal = np.array([-SLOPE[0], -SLOPE[1], 1.0])
    return centre + way * ((OFFSET - centre @ normal) / (way @ normal))[:, None]


def waves(points, seed=1):
    rng = np.random.default_rng(seed)
    k = rng.normal(0.0, 250.0, (40, 2))  # periods of 25 mm and more: 15 px
    phase = rng.uniform(0, 2 * math.pi, 40)
    return 128 + 12 * np.sum(np.cos(points[:, :2] @ k.T + phase), axis=1)


def flat(points):
    return np.full(len(points), 128.0)


def stripes(points):
    """Grey levels that repeat every 20 mm: 11 px."""
    return 128 + 50 * np.cos(points[:, 0] * math.pi / 0.01) + 30 * np.cos(points[:, 1] * math.pi / 0.017)


def edge_along(points):
    """One edge along the baseline."""
    return 128 + 60 * np.tanh(points[:, 1] / 0.002)


@lru_cache
def rendered(texture, side, noise=1.0):
    """An image of the plane, two by two rays a pixel."""
    u, v = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    pixels = np.stack([u.ravel(), v.ravel()], axis=1).astype(float)
    shifts = [[-0.25, -0.25], [0.25, -0.25], [-0.25, 0.25], [0.25, 0.25]]
    grey = np.mean([texture(on_plane(pixels + shift, side)) for shift in shifts], axis=0)
    grey = grey + np.random.default_rng(7 + (side == "left")).normal(0.0, noise, len(grey))
    return np.clip(np.round(grey), 0, 255).astype(np.uint8).reshape(HEIGHT, WIDTH)


def views(texture):
    return StereoViews(rig=RIG, left=rendered(texture, "left"), right=rendered(texture, "right"))


@pytest.fixture(scope="module")
def textured():
    return views(waves)


@pytest.mark.parametrize("side", ["left", "right"])
def test_points_are_where_the_plane_is_within_what_they_claim(textured, side):
    rng = np.random.default_rng(4)
    picks = rng.uniform([60, 30], [WIDTH - 60, HEIGHT - 30], (25, 2))
    settings = PatchSettings(near_m=0.4, far_m=1.6, pick_std_px=1e-6)
    found = [find_in_other_view(textured, side, px, settings) for px in picks]
    error = np.array([one.xyz_m for one in found]) - on_plane(picks, side)
    chi2 = [e @ np.linalg.solve(one.covariance_m2 + 1e-14 * np.eye(3), e) for e, one in zip(error, found, strict=True)]
    assert np.abs(error).max() < 1e-3  # 1 mm at 0.7 m: 0.08 px
    assert max(one.std_px for one in found) < 0.1
    assert np.mean([e[2] ** 2 / one.covariance_m2[2, 2] for e, one in zip(error, found, strict=True)]) < 2.0
    assert np.median(chi2) < 4.0


def test_the_pick_s_own_error_moves_the_point_along_the_surface(textured):
    px, moved = np.array([150.0, 100.0]), np.array([150.6, 99.8])
    one = find_in_other_view(textured, "left", px, SETTINGS)
    with_pick = find_in_other_view(textured, "left", px, PatchSettings(near_m=0.4, far_m=1.6, pick_std_px=1.0))
    more = with_pick.covariance_m2 - one.covariance_m2
    way = np.diff(on_plane(np.stack([px, moved]), "left"), axis=0)[0]
    normal = np.array([-SLOPE[0], -SLOPE[1], 1.0]) / np.linalg.norm([*SLOPE, 1.0])
    # 1 px instead of 0.5 px: 0.75 px^2 more, all of it in the plane
    assert way @ np.linalg.pinv(more, rcond=1e-3) @ way == pytest.approx((0.36 + 0.04) / 0.75, rel=0.05)
    assert math.sqrt(normal @ more @ normal) < 0.1 * math.sqrt(np.trace(more))


@pytest.mark.parametrize(
    ("texture", "px", "kind", "why"),
    [
        (flat, (160, 120), Degenerate, ("no texture", "grey levels")),
        (stripes, (160, 120), Ambiguous, "two places"),
        (edge_along, (160, 120), Degenerate, "epipolar line"),
        (waves, (3, 120), Inconsistent, "outside the image"),
        (waves, (1000, 120), Inconsistent, "outside the image"),
        (waves, (12, 120), NotEnoughData, ("epipolar line", "correlation")),
    ],
    ids=["flat", "repeating", "edge along the line", "border", "outside", "seen by one camera alone"],
)
def test_what_cannot_be_told_is_refused(texture, px, kind, why):
    with refuses(kind, why):
        find_in_other_view(views(texture), "left", np.array(px, float), SETTINGS)
