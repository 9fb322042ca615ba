"""A coloured beacon and what may be taken for it; the images are made here."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from armsight.errors import Unseen
from armsight.measure.poses.pipeline import Measured, Setup, measure_pair
from armsight.measure.spots import SpotSettings, find_spots
from armsight.optics import Camera, parallel_rig
from armsight.records import Frame, PoseStatus, Target, spot_target
from armsight.records.target import RED
from refusals import names_it

WIDTH, HEIGHT = 640, 480
CAMERA = Camera.pinhole(WIDTH, HEIGHT, 750.0, 750.0, 319.5, 239.5)
RIG = parallel_rig(CAMERA, 0.12)
COLOUR_ALONE = spot_target({"A": (0.0, 0.0, 0.0)}, colour=RED)
BEACON = replace(COLOUR_ALONE, diameter_m=0.011)
"""As wide as a light of 3 px standard deviation looks at 1.2 m."""
PLACE = np.array([0.05, -0.04, 1.2])
LED = (0.05, 0.08, 1.0)
AMBER = (0.05, 0.50, 1.0)
Picture = NDArray[np.uint8]
Colours = tuple[float, float, float]


def ground(seed: int, level: float = 90.0, *, room: bool = True) -> NDArray[np.float64]:
    """A wall of one level with dark and white things on it, too many and too large for lights; BGR."""
    image = np.full((HEIGHT, WIDTH, 3), level)
    if room:
        rng = np.random.default_rng(seed)
        for _ in range(60):
            x, y = rng.integers(0, WIDTH - 80), rng.integers(0, HEIGHT - 60)
            image[y : y + rng.integers(10, 60), x : x + rng.integers(10, 80)] = level * rng.uniform(0.2, 1.1)
        cv2.circle(image, (520, 60), 40, (250.0, 250.0, 250.0), -1)
    return image


def light(image: NDArray[np.float64], uv: NDArray[np.float64], colour: Colours, level: float, sigma: float) -> None:
    """Add a Gaussian light."""
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    spot = level * np.exp(-((x - uv[0]) ** 2 + (y - uv[1]) ** 2) / (2.0 * sigma**2))
    image += spot[:, :, None] * np.array(colour)


def stored(image: NDArray[np.float64], seed: int, quality: int | None = None) -> Picture:
    """The picture with noise of 2 grey levels, through JPEG where a quality is given."""
    noisy = image + np.random.default_rng(seed).normal(0.0, 2.0, image.shape)
    picture = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
    if quality is None:
        return picture
    _, data = cv2.imencode(".jpg", picture, (cv2.IMWRITE_JPEG_QUALITY, quality))
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), np.uint8)


def seen(
    *lights: tuple[NDArray[np.float64], Colours, float, float],
    painted: tuple[Colours, ...] = (),
    room: bool = True,
    quality: int | None = None,
    target: Target = BEACON,
    settings: SpotSettings | None = None,
) -> Measured:
    """What is measured of lights (place, colour, level, sigma in px) and of painted balls 50 mm wide beside them."""
    frames = []
    for side in range(2):
        image = ground(3, room=room)
        for n, colour in enumerate(painted):
            u, v = RIG.project(np.array([[-0.3 + 0.2 * n, 0.15, 1.3]]))[side][0]
            cv2.circle(image, (round(u), round(v)), 14, tuple(float(c) for c in colour), -1, cv2.LINE_AA)
        for place, colour, level, sigma in lights:
            light(image, RIG.project(place[None])[side][0], colour, level, sigma)
        frames.append(Frame(image=stored(image, 10 + side, quality), t_s=0.0, sequence=0, source="test"))
    return measure_pair(Setup(RIG, target, settings or SpotSettings()), *frames)


def found(measured: Measured) -> bool:
    """Whether there is a position; it is then the beacon's."""
    if measured.pose.status is PoseStatus.LOST:
        return False
    error = measured.points.xyz_m[0] - PLACE
    assert np.linalg.norm(error) < 0.01
    assert error @ np.linalg.solve(measured.points.covariance_m2[0], error) < 25.0  # chi-square of 3: once in 60,000
    return True


@pytest.mark.parametrize(("room", "level", "quality"), [(True, 170.0, 50), (False, 400.0, 50)])
def test_a_beacon_is_found_however_compressed(room: bool, level: float, quality: int | None) -> None:
    assert found(seen((PLACE, LED, level, 3.0), room=room, quality=quality))


@pytest.mark.parametrize("room", [True, False])
def test_an_overexposed_beacon_is_found_by_its_halo(room: bool) -> None:
    """Red is clipped over 14 px, and the middle is white by what leaks into blue and green."""
    masked = SpotSettings(mask=np.ones((HEIGHT, WIDTH), np.bool_))  # blooming makes it larger than its diameter_m
    assert found(seen((PLACE, (0.2, 0.22, 1.0), 1500.0, 3.0), room=room, target=COLOUR_ALONE, settings=masked))


@pytest.mark.parametrize("colour", [AMBER, (1.0, 1.0, 1.0)])
def test_lights_of_near_colours_are_neither_taken_nor_in_the_way(colour: Colours) -> None:
    other = (np.array([-0.2, 0.1, 1.5]), colour, 300.0, 3.0)
    assert found(seen((PLACE, LED, 170.0, 3.0), other))
    assert not found(seen(other))


def test_painted_things_are_neither_taken_nor_in_the_way() -> None:
    painted = ((20.0, 20.0, 95.0), (15.0, 25.0, 70.0))
    assert found(seen((PLACE, LED, 170.0, 3.0), painted=painted))
    alone = seen(painted=painted[:1])
    assert alone.pose.status is PoseStatus.LOST and "must glow" in alone.pose.why


def test_two_beacons_are_refused_and_none_is_not_found() -> None:
    second = (np.array([-0.2, 0.1, 1.5]), LED, 150.0, 3.5)
    two = seen((PLACE, LED, 170.0, 3.0), second)
    assert two.pose.status is PoseStatus.LOST and names_it(two.pose.why, "2 lights", "colour")
    none = seen()
    assert none.pose.status is PoseStatus.LOST and none.cause is Unseen.UNPAIRED


def test_a_lamp_is_not_taken_for_a_beacon_that_is_hidden() -> None:
    lamp = (PLACE, LED, 250.0, 1.3)
    for size in (1.3, 3.0, 6.0):
        alone = seen((PLACE, LED, 250.0, size), target=COLOUR_ALONE)
        assert alone.pose.status is PoseStatus.LOST and names_it(alone.pose.why, "a lamp", "give diameter_m")
    small = seen(lamp, target=replace(BEACON, diameter_m=0.005))
    assert small.pose.status is PoseStatus.LOST and names_it(small.pose.why, "a lamp", "1.6 px")
    half = seen((PLACE, LED, 250.0, 2.0), target=BEACON)
    assert half.pose.status is PoseStatus.LOST and half.cause is Unseen.WRONG_TARGET
    masked = SpotSettings(mask=np.ones((HEIGHT, WIDTH), np.bool_))
    assert found(seen(lamp, target=COLOUR_ALONE, settings=masked))


@pytest.mark.parametrize("sigma", [1.3, 12.0])
@pytest.mark.parametrize("xy_m", [(-0.2, 0.1)])
def test_the_diameter_tells_the_beacon_from_other_lights_where_lamps_are_masked(
    sigma: float, xy_m: tuple[float, float]
) -> None:
    """Wherever the other light stands in the order in which lights are found."""
    both = ((PLACE, LED, 170.0, 3.0), (np.array([*xy_m, 1.2]), LED, 200.0, sigma))
    masked = SpotSettings(mask=np.ones((HEIGHT, WIDTH), np.bool_))
    assert found(seen(*both, settings=masked))
    unknown = seen(*both, settings=masked, target=COLOUR_ALONE)
    assert not found(unknown) and names_it(unknown.pose.why, "2 lights", "--mask", "or give diameter_m")
    before_a_room = seen(*both)
    if sigma > 5.0:  # larger than any light of the target: no rival
        assert found(before_a_room)
        return
    assert before_a_room.pose.status is PoseStatus.LOST and names_it(before_a_room.pose.why, "2 lights", "colour")


def without(place: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return the mask that hides a place from both cameras, 60 px about it."""
    hidden = np.zeros((HEIGHT, WIDTH), np.uint8)
    for uv in RIG.project(place[None]):
        cv2.circle(hidden, (round(uv[0][0]), round(uv[0][1])), 60, 1, -1)
    return hidden == 0


@pytest.mark.parametrize("target", [BEACON, COLOUR_ALONE])
def test_of_lights_that_look_alike_the_one_that_a_mask_leaves_is_the_beacon(target: Target) -> None:
    """A size would not tell them apart, and is not asked for."""
    both = ((PLACE, LED, 170.0, 3.0), (np.array([-0.2, 0.1, 1.2]), LED, 170.0, 3.0))
    told = seen(*both, target=target)
    assert not found(told) and names_it(told.pose.why, "2 lights", "--mask") and "give diameter_m" not in told.pose.why
    assert found(seen(*both, target=target, settings=SpotSettings(mask=without(both[1][0]))))


def test_claimed_ellipses_hold_before_uneven_grounds() -> None:
    rng, chi2 = np.random.default_rng(8), 0.0
    for seed in range(30):
        image = ground(seed, room=True)
        uv = np.array([rng.uniform(60, 440), rng.uniform(120, 420)])
        light(image, uv, LED, 170.0, 3.0)
        spots = find_spots(stored(image, seed), SpotSettings(colour=RED))
        away = np.linalg.norm(spots.uv_px - uv, axis=1)
        d = spots.uv_px[int(away.argmin())] - uv
        chi2 += d @ np.linalg.solve(spots.covariance_px2[int(away.argmin())], d)
    assert chi2 < 99.6  # of 60 degrees of freedom: once in 1000


def test_an_edge_between_greys_behind_a_light_is_in_its_claim() -> None:
    """No edge in the colour's signal, but sRGB's curve makes the same light less over the brighter grey."""
    off, claimed = [], []
    for k, edge in enumerate(range(-8, 9, 2)):
        image = np.full((HEIGHT, WIDTH, 3), 0.16)
        image[200 + edge :] = 0.012
        light(image, np.array([300.0, 200.0]), LED, 0.7, 3.0)
        levels = 255.0 * np.where(
            image < 0.0031308, 12.92 * image, 1.055 * np.clip(image, 1e-9, 1) ** (1 / 2.4) - 0.055
        )
        spots = find_spots(stored(levels, k), SpotSettings(colour=RED))
        assert len(spots) == 1
        off.append(spots.uv_px[0, 1] - 200.0)
        claimed.append(float(np.sqrt(spots.covariance_px2[0, 1, 1])))
    assert np.abs(off).max() > 0.3
    assert (np.abs(off) / claimed).max() < 2.5


@pytest.mark.parametrize("quality", [None, 80])
def test_a_light_across_the_edge_of_something_nearly_white_is_refused(quality: int | None) -> None:
    """Where the wall leaves its red no room, only the other half of it is coloured."""
    image = ground(1, level=60.0, room=False)
    image[:, 300:340] = (190.0, 205.0, 235.0)
    for u, shown in ((297.0, False), (302.0, False), (240.0, True)):
        picture = image.copy()
        light(picture, np.array([u, 200.0]), LED, 300.0, 3.0)
        spots = find_spots(stored(picture, 3, quality), SpotSettings(colour=RED))
        assert (len(spots) == 1) == shown
        if quality is None:  # compression leaves too little of its colour to say so
            assert any("nearly white" in why for *_, why in spots.rejected) != shown
