"""Zoom lenses: what is claimed between settings against a simulated lens traced by its own code; refusals by name."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom

from armsight.errors import Inconsistent, NotEnoughData, UsageError
from armsight.optics import INTRINSICS, Camera, Rig, RigKind, ZoomLens, ZoomSetting, at_zoom, parallel_rig, with_zoom
from armsight.optics.zoom_curves import curves
from armsight.records import NamedCovariance
from armsight_sim.lens import SETTINGS, random_zoom_lens
from armsight_sim.lens import ZoomLens as SimZoomLens
from refusals import refuses

N_LENSES = 60
NAMES = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2")
RELATIVE = 2e-4
"""Standard deviation of a calibration's focal length; the others follow as boards give them."""


def camera(lens: SimZoomLens, zoom: float) -> Camera:
    made = lens.lens(zoom)
    return Camera(width=made.width, height=made.height, intrinsics=made.vector[:10])


def setting(lens: SimZoomLens, zoom: float, rng: np.random.Generator | None = None) -> ZoomSetting:
    """The camera at a setting with the error of a calibration, and its covariance."""
    true = camera(lens, zoom)
    fx = true.intrinsics[0]
    s = fx / 735.0
    std = np.array([RELATIVE * fx, RELATIVE * fx, 0.3, 0.3, 4e-4 * s**2, 1e-3 * s**4, 3e-5 * s, 3e-5 * s])
    shared = np.zeros((8, 8))
    shared[0, 1] = shared[1, 0] = 0.9 * std[0] * std[1]
    matrix = np.diag(std**2) + shared
    error = np.zeros(10)
    if rng is not None:
        error[[INTRINSICS.index(name) for name in NAMES]] = rng.multivariate_normal(np.zeros(8), matrix)
    return ZoomSetting(
        zoom=zoom,
        camera=replace(true, intrinsics=true.intrinsics + error),
        covariance=NamedCovariance(names=NAMES, matrix=matrix),
    )


@pytest.fixture(scope="module")
def plain() -> SimZoomLens:
    return SimZoomLens(width=1280, height=720)


@pytest.fixture(scope="module")
def lens(plain: SimZoomLens) -> ZoomLens:
    return ZoomLens(settings=tuple(setting(plain, zoom) for zoom in SETTINGS))


@pytest.fixture(scope="module")
def focal_errors() -> np.ndarray:
    """Errors of the focal length between settings, in its claimed standard deviations, of N_LENSES lenses."""
    errors = []
    for number in range(N_LENSES):
        rng = np.random.default_rng([5, number])
        made = random_zoom_lens(rng, 1280, 720)
        found = ZoomLens(settings=tuple(setting(made, zoom, rng) for zoom in SETTINGS))
        zoom = float(rng.uniform(*made.zoom))
        state = found.at(zoom)
        error = state.camera.intrinsics[0] - camera(made, zoom).intrinsics[0]
        errors.append(error / state.covariance.std()["fx"])
    return np.array(errors)


def test_between_settings_the_focal_length_lies_within_its_claim(focal_errors: np.ndarray) -> None:
    hits = (np.abs(focal_errors) < 1.959964).sum()
    # chance alone keeps a share of 95 % within these counts in 999 of 1000 runs
    low, high = binom.ppf(0.0005, N_LENSES, 0.95), binom.ppf(0.9995, N_LENSES, 0.95)
    assert low <= hits <= min(high, N_LENSES - 1), f"{hits} of {N_LENSES}"


def test_the_claim_holds_calibration_and_interpolation(lens: ZoomLens, plain: SimZoomLens) -> None:
    exact = ZoomLens(settings=tuple(replace(one, covariance=None) for one in lens.settings))
    both, alone = lens.at(250.0), exact.at(250.0)
    assert both.covariance.std()["fx"] > both.interpolation["fx"] > 0.0
    assert alone.covariance.std()["fx"] == pytest.approx(alone.interpolation["fx"])
    assert both.covariance.std()["cx"] > 0.1  # 0.3 px at each of the settings


def test_a_straight_line_is_found_exactly() -> None:
    x, at = np.linspace(0.0, 1.0, 5), np.array([0.1, 0.62])
    found = curves(x, np.stack([2.0 + 3.0 * x, np.full(5, 7.0)]), np.zeros((2, 5)), at)
    np.testing.assert_allclose(found.weights.sum(axis=1), 1.0, atol=1e-9)
    np.testing.assert_allclose(found.weights @ x, at, atol=1e-9)
    np.testing.assert_allclose(found.variance, 0.0, atol=1e-12)


def test_left_out_settings_are_predicted_and_their_error_told(lens: ZoomLens) -> None:
    told = lens.left_out()
    assert [one.zoom for one in told] == [200.0, 300.0, 400.0]
    for one in told:
        assert one.focal_std_px is not None
        assert abs(one.focal_error_px) < 4.0 * one.focal_std_px
        assert 0.0 < one.image_rms_px < 20.0
    three = ZoomLens(settings=lens.settings[::2])
    (only,) = three.left_out()
    assert only.focal_std_px is None


def test_what_cannot_be_asked_for_is_refused(lens: ZoomLens) -> None:
    for zoom in (99.0, 501.0):
        with refuses(NotEnoughData, "100", "500", "outside") as info:
            lens.at(zoom)
        assert info.value.consequence and "--zoom" in info.value.cure
    for n in (1, 2):
        few = ZoomLens(settings=lens.settings[:n])
        assert few.at(100.0).camera is lens.settings[0].camera
        with refuses(NotEnoughData, "calibrated at", "100"):
            few.at(150.0)


def test_settings_that_are_not_of_one_camera_are_refused(lens: ZoomLens, plain: SimZoomLens) -> None:
    a, b = lens.settings[:2]
    small = replace(b, camera=replace(b.camera, width=640))
    with refuses(Inconsistent, "1280x720", "640x720"):
        ZoomLens(settings=(a, small))
    with refuses(Inconsistent, "high"):
        ZoomLens(settings=(a, setting(replace(plain, aspect=1.02), 200.0)))
    with refuses(Inconsistent, "one way"):
        ZoomLens(settings=(*lens.settings, replace(a, zoom=450.0)))
    moved = replace(b.camera, intrinsics=b.camera.intrinsics + np.r_[0, 0, 400.0, np.zeros(7)])
    with refuses(Inconsistent, "centre", "moves"):
        ZoomLens(settings=(a, replace(b, camera=moved)))
    with refuses(Inconsistent, "twice"):
        ZoomLens(settings=(a, replace(b, zoom=100.0)))
    with refuses(Inconsistent, "pupil"):
        ZoomLens(settings=(a, replace(b, pupil_m=0.01)))


def zoom_rig(lens: ZoomLens) -> Rig:
    covariance = NamedCovariance(
        names=("left.fx", "right.tx", "right.tz", "right.ry"), matrix=np.diag([0.04, 1e-8, 4e-8, 1e-8])
    )
    rig = replace(parallel_rig(lens.settings[0].camera, 0.2), covariance=covariance)
    return with_zoom(rig, (lens, lens), (100.0, 100.0))


def test_the_lens_goes_into_the_rigs_covariance(lens: ZoomLens) -> None:
    rig = zoom_rig(lens)
    found = at_zoom(rig, (250.0, 300.0)).rig
    std = found.covariance.std()
    assert std["left.fx"] == pytest.approx(lens.at(250.0).covariance.std()["fx"])
    assert std["right.fx"] == pytest.approx(lens.at(300.0).covariance.std()["fx"])
    assert std["right.ry"] == pytest.approx(1e-4)
    assert found.zoom == (None, None)
    kept = at_zoom(rig, (100.0, 300.0)).rig  # the left one stands as it did for the rig
    assert kept.covariance.std()["left.fx"] == pytest.approx(0.2)
    assert kept.left is rig.left


def test_pupils_move_the_cameras_and_their_doubt_comes_along(plain: SimZoomLens) -> None:
    settings = [replace(setting(plain, z), pupil_m=plain.pupil_m(z), pupil_std_m=1e-4) for z in SETTINGS]
    lens = ZoomLens(settings=tuple(settings))
    found = at_zoom(zoom_rig(lens), (300.0, 100.0)).rig
    ahead = plain.pupil_m(300.0) - plain.pupil_m(100.0)
    np.testing.assert_allclose(found.T_rig_left.translation, [0.0, 0.0, ahead], atol=1e-12)
    np.testing.assert_allclose(found.T_rig_right.translation, [0.2, 0.0, 0.0], atol=1e-12)
    assert found.covariance.std()["right.tz"] == pytest.approx(np.sqrt(4e-8 + 2e-8))
    between = lens.at(250.0)
    assert abs(between.pupil_m - plain.pupil_m(250.0)) < 4.0 * between.pupil_std_m


def test_rigs_and_zooms_that_do_not_fit_are_refused(lens: ZoomLens, plain: SimZoomLens) -> None:
    rig = zoom_rig(lens)
    with refuses(UsageError, "zoom", "not given") as info:
        at_zoom(rig, (None, 100.0))
    assert "--zoom-left" in info.value.cure
    with refuses(UsageError, "no zoom", "settings"):
        at_zoom(replace(rig, zoom=(None, None)), (100.0, None))
    bare = replace(rig, zoom=(None, None))
    with refuses(Inconsistent, "focal length"):
        with_zoom(bare, (lens, None), (300.0, None))
    with refuses(UsageError, "left camera", "--zoom-left"):
        with_zoom(bare, (lens, None), (None, None))
    with refuses(Inconsistent, "mirror rig"):
        with_zoom(replace(bare, kind=RigKind.MIRROR), (lens, None), (100.0, None))


def test_the_simulated_lens_is_two_thin_groups(plain: SimZoomLens) -> None:
    """Against tracing a ray that comes in parallel, and the chief ray, through both groups by hand."""
    for zoom in SETTINGS:
        f = plain.focal_mm(zoom)
        d = plain.front_mm + plain.rear_mm - plain.front_mm * plain.rear_mm / f
        slope = -1.0 / plain.front_mm  # a ray 1 mm high, behind the front group
        height = 1.0 + slope * d
        bent = slope - height / plain.rear_mm
        assert -1.0 / bent == pytest.approx(f)
        back = -height / bent
        # the chief ray crosses the axis in the stop, at the rear group; before the front group it aims at the pupil
        seen = -1.0 / (-1.0 / d + 1.0 / plain.front_mm)
        assert plain.pupil_m(zoom) == pytest.approx(1e-3 * (back + d - seen))
