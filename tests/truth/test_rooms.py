"""Lights before ordinary backgrounds: found, named and measured as well as claimed, or refused; never wrong.

Pictures are drawn here, in linear light with oversampling, and go through a webcam's curve, sharpening and JPEG: no
code is shared with the product or its simulation.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation
from scipy.stats import binom

from armsight.measure.poses.outcome import Measured, Track
from armsight.measure.poses.pipeline import Setup, measure_pair
from armsight.measure.spots import find_spots
from armsight.optics import Camera, parallel_rig
from armsight.records import Frame, PoseStatus, spot_target
from refusals import names_it

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

WIDTH, HEIGHT, FOCAL, BASELINE = 640, 480, 700.0, 0.12
RIG = parallel_rig(Camera.pinhole(WIDTH, HEIGHT, FOCAL, FOCAL, 320.0, 240.0), BASELINE)
LIGHTS = {"A": (-0.045, 0.0, 0.0), "B": (0.035, 0.03, 0.0), "C": (0.01, -0.04, 0.0)}
MODEL = np.array(list(LIGHTS.values()))
SETUP = Setup(RIG, spot_target(LIGHTS))
OVERSAMPLED = 8


@dataclass(frozen=True)
class Webcam:
    """sharpen: amount of an unsharp mask. quality: of the JPEG."""

    sharpen: float = 0.8
    quality: int = 88

    def develop(self, light: Array, rng: np.random.Generator) -> Image:
        """Return the picture of light (h, w), full scale 1."""
        raw = np.clip(light + rng.normal(0.0, 0.004, light.shape) * np.sqrt(0.2 + np.clip(light, 0.0, 1.0)), 0.0, 1.0)
        grey = np.where(raw < 0.0031308, 12.92 * raw, 1.055 * raw ** (1 / 2.4) - 0.055)
        grey += self.sharpen * (grey - cv2.GaussianBlur(grey, (0, 0), 1.0))
        picture = np.clip(np.rint(255.0 * grey), 0, 255).astype(np.uint8)
        _, jpeg = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, self.quality])
        return np.asarray(cv2.imdecode(jpeg, cv2.IMREAD_GRAYSCALE), dtype=np.uint8)


def room(rng: np.random.Generator) -> Array:
    """Return a textured wall with boxes before it and a window in it (h, w), linear light."""
    wall = np.full((HEIGHT, WIDTH), 0.15)
    for cells, depth in ((4, 0.06), (16, 0.03), (64, 0.02)):
        coarse = rng.normal(0.0, depth, (cells, cells))
        wall += cv2.resize(coarse, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC)
    for _ in range(14):
        x, y, w, h = rng.integers((0, 0, 20, 20), (WIDTH, HEIGHT, 160, 120))
        wall[y : y + h, x : x + w] = rng.uniform(0.01, 0.5)
    x = rng.integers(0, WIDTH - 90)
    wall[:40, x : x + 90] = 3.0
    return np.asarray(cv2.GaussianBlur(np.maximum(wall, 0.0), (0, 0), 0.8))


def shine(light: Array, uv: Array, radius_px: float, level: float, blur_px: float = 0.8) -> None:
    """Draw a disc over light (h, w) in place, its rim blurred; nothing where it would meet the border."""
    reach = int(radius_px + 4.0 * blur_px + 2.0)
    x0, y0 = (int(v) - reach for v in uv)
    n = 2 * reach + 1
    if not (0 <= x0 <= light.shape[1] - n and 0 <= y0 <= light.shape[0] - n):
        return
    at = (np.arange(n * OVERSAMPLED) + 0.5) / OVERSAMPLED - 0.5
    inside = (np.hypot(at[None, :] + x0 - uv[0], at[:, None] + y0 - uv[1]) < radius_px).astype(float)
    inside = cv2.GaussianBlur(inside, (0, 0), blur_px * OVERSAMPLED)
    share = inside.reshape(n, OVERSAMPLED, n, OVERSAMPLED).mean(axis=(1, 3))
    part = light[y0 : y0 + n, x0 : x0 + n]
    part += share * (level - part)


def images_of(points: Array) -> tuple[Array, Array]:
    """Return the pixels (n, 2) of points (n, 3) in both cameras of the parallel rig."""
    left = FOCAL * points[:, :2] / points[:, 2:] + (320.0, 240.0)
    right = FOCAL * (points[:, :2] - (BASELINE, 0.0)) / points[:, 2:] + (320.0, 240.0)
    return left, right


def random_pose(rng: np.random.Generator) -> RigidTransform:
    place = rng.uniform((-0.05, -0.12, 0.55), (0.17, 0.12, 0.85))
    return RigidTransform.from_components(place, Rotation.from_rotvec(rng.normal(0.0, 0.2, 3)))


def pair_of(
    rng: np.random.Generator, *sets: Array, hidden: int | None = None, level: float = 1.5, webcam: Webcam | None = None
) -> tuple[Frame, Frame]:
    """Return both frames of a room with lights at sets of points (n, 3); hidden: the light the right one lacks."""
    frames = []
    for side in range(2):
        light = room(rng)
        for points in sets:
            for k, uv in enumerate(images_of(points)[side]):
                if not (side == 1 and k == hidden):
                    shine(light, uv, 3.2, level)
        image = (webcam or Webcam()).develop(light, rng)
        frames.append(Frame(image=image, t_s=0.0, sequence=0, source="drawn"))
    return frames[0], frames[1]


def position_error(measured: Measured, T: RigidTransform) -> tuple[float, float]:
    """Return the error of the position in m, and squared over its covariance."""
    assert measured.pose.pose is not None and measured.pose.covariance is not None
    error = np.asarray(measured.pose.pose.translation - T.translation)
    return float(np.linalg.norm(error)), float(error @ np.linalg.solve(measured.pose.covariance[:3, :3], error))


def test_lights_before_a_room_are_found_and_as_uncertain_as_they_say() -> None:
    """30 rooms, another one in each camera: 95 % of the ellipsoids hold, one chance in a thousand allowed."""
    rng, n, q = np.random.default_rng(21), 30, []
    for k in range(n):
        T = random_pose(rng)
        level, webcam = rng.uniform(0.5, 4.0), Webcam(sharpen=rng.uniform(0.0, 1.5), quality=int(rng.integers(60, 96)))
        measured = measure_pair(SETUP, *pair_of(rng, T.apply(MODEL), level=level, webcam=webcam))
        if measured.pose.status is not PoseStatus.OK:
            continue
        far_m, squared = position_error(measured, T)
        assert far_m < 2e-3, k
        q.append(squared)
    assert len(q) >= n - 1
    inside = int(np.sum(np.array(q) < 7.815))
    assert inside >= binom.ppf(0.001, len(q), 0.95)


def test_lights_that_hardly_stand_out_are_found_and_as_uncertain_as_they_say() -> None:
    """15 grey levels above a wall, beside a window: too little for the first look."""
    rng, q = np.random.default_rng(30), []
    for _ in range(8):
        T, frames = random_pose(rng), []
        for side in range(2):
            light = np.full((HEIGHT, WIDTH), 0.2)
            light[:40, 100:190] = 3.0
            for uv in images_of(T.apply(MODEL))[side]:
                shine(light, uv, 3.2, 0.255)
            frames.append(Frame(image=Webcam().develop(light, rng), t_s=0.0, sequence=0, source="drawn"))
        measured = measure_pair(SETUP, *frames)
        assert measured.pose.status is PoseStatus.OK, measured.pose.why
        q.append(position_error(measured, T)[1])
    assert int(np.sum(np.array(q) < 7.815)) >= binom.ppf(0.001, len(q), 0.95)


def test_a_light_of_which_one_view_is_hidden_is_not_replaced_by_the_room() -> None:
    rng = np.random.default_rng(22)
    for _ in range(12):
        T = random_pose(rng)
        measured = measure_pair(SETUP, *pair_of(rng, T.apply(MODEL), hidden=1))
        assert measured.pose.status is not PoseStatus.OK
        assert measured.pose.why


def test_a_second_target_like_the_first_is_no_matter_of_chance() -> None:
    rng = np.random.default_rng(23)
    T = RigidTransform.from_translation([0.0, -0.08, 0.7])
    other = RigidTransform.from_translation([0.1, 0.08, 0.75])
    measured = measure_pair(SETUP, *pair_of(rng, T.apply(MODEL), other.apply(MODEL)))
    assert measured.pose.status is not PoseStatus.OK and "ambiguous" in measured.pose.why


def test_a_wall_of_equal_lights_names_nothing_wrongly() -> None:
    rng = np.random.default_rng(24)
    x, y = np.meshgrid(np.arange(-0.3, 0.45, 0.035), np.arange(-0.25, 0.26, 0.035))
    wall = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 0.9)])
    for _ in range(3):
        T = random_pose(rng)
        measured = measure_pair(SETUP, *pair_of(rng, wall, T.apply(MODEL)))
        if measured.pose.status is PoseStatus.OK:
            assert position_error(measured, T)[0] < 2e-3


def test_a_target_that_moves_in_a_room_is_tracked() -> None:
    rng = np.random.default_rng(26)
    walls, track, tracked = [room(rng), room(rng)], None, 0
    for number in range(8):
        T = RigidTransform.from_translation([0.05 + 0.006 * number, 0.0, 0.7])
        frames = []
        for side in range(2):
            light = walls[side].copy()
            for uv in images_of(T.apply(MODEL))[side]:
                shine(light, uv, 3.2, 1.5)
            frames.append(Frame(image=Webcam().develop(light, rng), t_s=number / 30.0, sequence=number, source="drawn"))
        measured: Measured = measure_pair(SETUP, frames[0], frames[1], track)
        assert measured.pose.status is PoseStatus.OK and position_error(measured, T)[0] < 1e-3
        tracked += measured.tracked
        track = measured.track
    assert tracked >= 6  # the first step's speed is not known


def test_a_flat_light_before_the_edge_of_a_bright_region_is_found() -> None:
    """Under a threshold by tiles the light and the region are one area."""
    picture = np.full((HEIGHT, WIDTH), 5.0)
    picture[:, 300:] = 50.0 + 10.0 * np.sin(np.arange(340) / 9.0)
    shine(picture, np.array([302.3, 200.7]), 8.0, 190.0, 1.0)
    noisy = picture + np.random.default_rng(27).normal(0.0, 1.5, picture.shape)
    spots = find_spots(np.clip(np.rint(noisy), 0, 255).astype(np.uint8))
    near = np.linalg.norm(spots.uv_px - (302.3, 200.7), axis=1)
    assert near.min() < 0.3
    at = int(near.argmin())
    error = spots.uv_px[at] - (302.3, 200.7)
    assert error @ np.linalg.solve(spots.covariance_px2[at], error) < 13.8


def test_a_mildly_clipped_flat_light_is_one_light() -> None:
    rng = np.random.default_rng(28)
    for level in (1.02, 1.2, 2.0, 6.0):
        light = room(rng)
        light[180:300, 240:420] = 0.02
        shine(light, np.array([330.4, 240.3]), 6.0, level)
        spots = find_spots(Webcam().develop(light, rng))
        near = np.linalg.norm(spots.uv_px - (330.4, 240.3), axis=1)
        assert near.min() < 0.15 and np.sum(near < 8.0) == 1


def test_pictures_without_the_target_give_no_pose() -> None:
    rng = np.random.default_rng(29)
    white = np.full((HEIGHT, WIDTH), 255, np.uint8)
    lamps = [room(rng), room(rng)]
    for light in lamps:
        for _ in range(40):
            shine(light, rng.uniform((40.0, 40.0), (WIDTH - 40.0, HEIGHT - 40.0)), rng.uniform(2.0, 12.0), 5.0)
    pictures = [(white, white), tuple(Webcam(quality=20).develop(light, rng) for light in lamps)]
    track: Track | None = None
    for left, right in pictures:
        frames = [Frame(image=image, t_s=0.0, sequence=0, source="drawn") for image in (left, right)]
        assert measure_pair(SETUP, frames[0], frames[1], track).pose.status is PoseStatus.LOST


def test_a_search_that_stopped_early_is_told() -> None:
    rng = np.random.default_rng(3)
    grain = cv2.GaussianBlur(rng.normal(0.0, 1.0, (HEIGHT, WIDTH)), (0, 0), 1.5)
    image = np.clip(128.0 + 70.0 * grain / grain.std(), 0, 255).astype(np.uint8)
    frames = [Frame(image=image, t_s=0.0, sequence=0, source="grain") for _ in range(2)]
    pose = measure_pair(SETUP, frames[0], frames[1]).pose
    assert pose.status is PoseStatus.LOST and names_it(pose.why, "search for spots", "stopped")
