"""Lights that something covers in part, drawn here: none of them may make a pose that is called good and is not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import RigidTransform, Rotation
from scipy.stats import chi2

from armsight.errors import Unseen
from armsight.measure.poses import solving
from armsight.measure.poses.pipeline import Measured, Setup, Track, measure_pair
from armsight.optics import Camera, converged_rig
from armsight.records import Frame, PoseStatus, spot_target

CAMERA = Camera.pinhole(640, 480, 700.0, 700.0, 320.0, 240.0)
RIG = converged_rig(CAMERA, CAMERA, 0.12, 0.08, -0.08)
LIGHTS = {"A": (-0.04, 0.0, 0.0), "B": (0.03, 0.035, 0.0), "C": (0.015, -0.03, 0.0)}
XYZ = np.array(list(LIGHTS.values()))
SETUP = Setup(RIG, spot_target(LIGHTS))
RADIUS_PX, BLUR_PX, FINE = 4.0, 0.9, 6
POSE = RigidTransform.from_components([0.02, 0.01, 0.62], Rotation.from_rotvec([0.3, -0.25, 0.4]))
WITHIN = float(chi2.isf(1e-3, 6))

Cut = tuple[float, float]
"""Angle of the direction into the cover, and how far its edge stands behind the light's middle, in px."""


def draw(
    uv: np.ndarray,
    heights: np.ndarray,
    cuts: dict[int, Cut],
    rng: np.random.Generator,
    *,
    shade: float = 0.0,
    radius: float = RADIUS_PX,
    shapes: np.ndarray | None = None,
) -> np.ndarray:
    """Return a picture of discs at uv (n, 2), each with what a straight edge leaves of it.

    shade: grey levels of what has the edge above the background. shapes (n, 2, 2): px of a flat light's two radii.
    """
    image = np.full((480, 640), 12.0)
    half = 20
    for i, (u, v) in enumerate(uv):
        x0, y0 = int(u) - half, int(v) - half
        at = (np.arange((2 * half + 1) * FINE) + 0.5) / FINE - 0.5
        x, y = np.meshgrid(at + x0 - u, at + y0 - v)
        within = 1.0 - np.hypot(x, y) / radius
        if shapes is not None:
            within = 1.0 - np.hypot(*np.einsum("ij,jkl", np.linalg.inv(shapes[i]), np.array([x, y])))
        disc = heights[i] * np.clip(within * radius * FINE + 0.5, 0.0, 1.0)
        if i in cuts:
            angle, behind = cuts[i]
            seen = np.clip((behind - x * np.cos(angle) - y * np.sin(angle)) * FINE + 0.5, 0.0, 1.0)
            disc = seen * disc + shade * (1.0 - seen)
        soft = gaussian_filter(disc, BLUR_PX * FINE, mode="nearest")
        soft = soft.reshape(2 * half + 1, FINE, 2 * half + 1, FINE).mean(axis=(1, 3))
        image[y0 : y0 + 2 * half + 1, x0 : x0 + 2 * half + 1] += soft
    return np.clip(np.rint(image + rng.normal(0.0, 1.5, image.shape)), 0, 255).astype(np.uint8)


def measured(
    cuts: tuple[dict[int, Cut], dict[int, Cut]] = ({}, {}),
    *,
    heights: tuple[float, float, float] = (180.0, 180.0, 180.0),
    shade: float = 0.0,
    radius: float = RADIUS_PX,
    seed: int = 0,
    track: Track | None = None,
    t_s: float = 0.0,
) -> Measured:
    """Return what is measured of the target at POSE under these covers."""
    rng = np.random.default_rng(seed)
    views = RIG.project(POSE.apply(XYZ))
    images = [
        draw(uv, np.array(heights), cut, rng, shade=shade, radius=radius) for uv, cut in zip(views, cuts, strict=True)
    ]
    return measure_pair(SETUP, *(Frame(image=i, t_s=t_s, sequence=0, source="drawn") for i in images), track)


def mahalanobis2(found: Measured) -> float:
    """Return the squared error of a complete pose over its claim."""
    T, C = found.pose.T_parent_target, found.pose.covariance
    assert T is not None and C is not None
    turn = Rotation.from_matrix(T[:3, :3] @ POSE.rotation.as_matrix().T).as_rotvec()
    error = np.concatenate([T[:3, 3] - POSE.translation, turn])
    return float(error @ np.linalg.solve(C, error))


FOUND = ({1: (0.3, -1.0)}, {1: (0.3, 1.0)})
"""An edge over most of light B in the left view and over less of it in the right one."""


def test_a_light_that_an_edge_covers_for_the_most_part_in_both_views_is_left_out() -> None:
    found = measured(FOUND)
    assert found.pose.status is PoseStatus.POSITION_ONLY
    assert found.cause is Unseen.HALF_HIDDEN and "light B" in found.pose.why
    assert found.names == ("A", "C")


@pytest.mark.parametrize("seed", range(4))
def test_a_light_cut_off_a_little_makes_the_pose_as_uncertain_as_it_makes_it_wrong(seed: int) -> None:
    rng = np.random.default_rng(seed)
    angle, behind = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.35, 0.7, 2) * RADIUS_PX
    one = {int(rng.integers(3)): (angle, float(behind[0]))}
    for cuts in ((one, {}), (one, {light: (a, float(behind[1])) for light, (a, _) in one.items()})):
        found = measured(cuts, seed=seed)
        assert found.pose.status is not PoseStatus.OK or mahalanobis2(found) < WITHIN


@pytest.mark.parametrize(("light", "angle", "share"), [(0, 1.6, 0.85), (0, 4.7, 0.85), (2, 4.7, 0.85)])
def test_what_both_views_lack_a_little_makes_the_pose_more_uncertain(
    light: int, angle: float, share: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    cut = {light: (angle, share * RADIUS_PX)}
    assert mahalanobis2(measured((cut, cut))) < WITHIN
    monkeypatch.setattr(solving.outlines, "judge_lights", lambda *_: int(solving.outlines.NO_DOUBT))
    assert mahalanobis2(measured((cut, cut))) > WITHIN


def test_a_light_taken_together_with_what_touches_it_is_left_out_however_little_it_claims_to_know() -> None:
    rng = np.random.default_rng(0)
    found = measured()
    images = [draw(uv, np.full(3, 180.0), {}, rng) for uv in RIG.project(POSE.apply(XYZ))]
    at = np.array(found.right.uv_px)
    at[0] += [8.0, 0.0]
    y, x = np.mgrid[0:480, 0:640]
    images[1][np.hypot(x - at[0, 0], y - at[0, 1]) < 13.0] = 180
    cov, size = np.array(found.right.covariance_px2), np.array(found.right.size_px)
    cov[0], size[0] = 0.57**2 * np.eye(2), 13.0
    right = replace(found.right, uv_px=at, covariance_px2=cov, size_px=size)
    solved = solving.solve_spots(SETUP, 0.0, found.names, found.left, found.right)
    frames = tuple(Frame(image=image, t_s=0.0, sequence=0, source="drawn") for image in images)
    _, out = solving.compare(SETUP, solved.points.xyz_m, solved.T, (found.left, right), frames)
    assert out[:, :, solving.outlines.ODD].any(axis=0).tolist() == [True, False, False]


def test_a_light_that_an_edge_reaches_on_a_track_is_left_out_and_the_track_goes_on() -> None:
    track = None
    for k in range(3):
        track = measured(seed=k, t_s=k / 30.0, track=track).track
    found = measured(FOUND, seed=3, t_s=0.1, track=track)
    assert found.cause is Unseen.HALF_HIDDEN and not found.tracked
    after = measured(seed=4, t_s=4 / 30.0, track=found.track)
    assert after.pose.status is PoseStatus.OK and mahalanobis2(after) < WITHIN


@pytest.mark.parametrize("heights", [(180.0, 180.0, 180.0), (180.0, 90.0, 180.0), (600.0, 300.0, 180.0)])
def test_whole_lights_of_unequal_brightness_are_taken_as_they_are(heights: tuple[float, float, float]) -> None:
    for seed in range(4):
        found = measured(heights=heights, seed=seed)
        assert found.pose.status is PoseStatus.OK and mahalanobis2(found) < WITHIN
        sigma_mm = 1e3 * np.sqrt(np.trace(found.pose.covariance[:3, :3]))
        assert sigma_mm < 0.3


def test_only_lights_of_the_target_that_touch_each_other_are_not_compared() -> None:
    found = measured().left
    joint = replace(found, model=("joint", "joint", found.model[2]))
    beside = replace(joint, uv_px=found.uv_px[[0, 0, 2]] + [[0.0, 0.0], [9.0, 0.0], [0.0, 0.0]])
    size = found.size_px.tolist()
    assert solving.sizes(joint, overlaid=False).tolist() == size
    assert solving.sizes(beside, overlaid=False).tolist() == [0.0, 0.0, size[2]]
    assert solving.sizes(joint, overlaid=True).tolist() == [0.0, 0.0, size[2]]


@pytest.mark.parametrize("light", [0, 1])
def test_a_small_light_across_the_edge_of_something_is_as_uncertain_as_that_may_make_it(light: int) -> None:
    cut = {light: (4.7, 0.75)}
    found = measured((cut, cut), shade=20.0, radius=1.5)
    assert found.pose.status is not PoseStatus.OK or mahalanobis2(found) < WITHIN


def test_flat_lights_are_compared_as_seen_from_one_side() -> None:
    rng = np.random.default_rng(0)
    pose = RigidTransform.from_components([0.0, 0.0, 0.35], Rotation.from_rotvec([0.2, 0.8, 0.0]))
    turning = np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False)
    rims = np.stack([np.cos(turning), np.sin(turning), np.zeros(40)], axis=1) * 0.004
    images = []
    for side, uv in enumerate(RIG.project(pose.apply(XYZ))):
        uvs = [RIG.project(pose.apply(xyz + rims))[side] - at for xyz, at in zip(XYZ, uv, strict=True)]
        shapes = np.array([np.linalg.lstsq(rims[:, :2] / 0.004, rim, rcond=None)[0].T for rim in uvs])
        images.append(draw(uv, np.full(3, 180.0), {}, rng, shapes=shapes))
    frames = tuple(Frame(image=image, t_s=0.0, sequence=0, source="drawn") for image in images)
    with_diameter, without = (
        measure_pair(Setup(RIG, spot_target(LIGHTS, diameter_m=diameter_m)), *frames) for diameter_m in (0.008, None)
    )
    assert with_diameter.pose.status is PoseStatus.OK
    assert without.cause is Unseen.HALF_HIDDEN


BEACON = Setup(RIG, spot_target({"A": (0.0, 0.0, 0.0)}))


def beacon(cuts: tuple[dict[int, Cut], dict[int, Cut]], *, shade: float = 0.0, seed: int = 0) -> tuple[float, float]:
    """Return the squared error of a beacon's position over its claim, and its claim in mm."""
    rng = np.random.default_rng(seed)
    views = RIG.project(POSE.translation[None])
    images = [draw(uv, np.full(1, 180.0), cut, rng, shade=shade) for uv, cut in zip(views, cuts, strict=True)]
    found = measure_pair(BEACON, *(Frame(image=i, t_s=0.0, sequence=0, source="drawn") for i in images))
    T, C = found.pose.T_parent_target, found.pose.covariance
    assert found.pose.status is PoseStatus.POSITION_ONLY and T is not None and C is not None
    error = T[:3, 3] - POSE.translation
    return float(error @ np.linalg.solve(C[:3, :3], error)), 1e3 * float(np.sqrt(np.trace(C[:3, :3])))


@pytest.mark.parametrize(
    ("cuts", "shade"),
    [(({0: (0.3, 1.0)}, {}), 0.0), (({}, {0: (3.3, 1.5)}), 0.0), (({0: (4.7, 1.5)}, {0: (4.7, 1.5)}), 20.0)],
)
def test_a_beacon_is_placed_as_surely_as_its_outlines_allow(
    cuts: tuple[dict[int, Cut], dict[int, Cut]], shade: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    within = float(chi2.isf(1e-3, 3))
    assert beacon(cuts, shade=shade)[0] < within
    monkeypatch.setattr(solving.outlines, "judge_lights", lambda *_: int(solving.outlines.NO_DOUBT))
    assert beacon(cuts, shade=shade)[0] > within


def test_a_whole_beacon_claims_what_its_noise_leaves() -> None:
    for seed in range(4):
        off, claimed_mm = beacon(({}, {}), seed=seed)
        assert off < chi2.isf(1e-3, 3) and claimed_mm < 0.2
