"""Fisheye lenses calibrated from boards that the simulated lens has seen; the wrong kind of lens told."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from armsight.calibrate.cameras import BoardOptions, calibrate_camera, calibrate_stereo
from armsight.errors import Inconsistent
from armsight.optics import LensKind
from armsight.records import BoardView
from armsight.store import parse_board
from armsight_sim.lens import Lens
from refusals import names_it, refuses

BOARD = parse_board("checkerboard:9x6:0.025")
D = (-0.012, 0.02, -0.015, 0.004)
FISHEYE = Lens(
    width=1280, height=1024, focal_px=(420.0, 415.0), centre_px=(640.3, 511.2), distortion=(*D, 0.0), fisheye=True
)
TANGENTIAL = Lens(
    width=1280, height=1024, focal_px=(700.0, 705.0), centre_px=(640.3, 511.2), distortion=(-0.2, 0.1, 0.01, -0.01, 0.0)
)
SIGMA_PX = 0.1
OPTIONS = BoardOptions(lens=LensKind.FISHEYE, folds=0)
SIZE = np.array([1280.0, 1024.0])


def seen(
    lens: Lens, rng: np.random.Generator, n: int = 14, baseline_m: float | None = None, other: Lens | None = None
) -> list[list[BoardView]]:
    """Return views of boards all over the image; with a baseline those of a second camera to the right, too.

    other: the second camera's lens where it is not the first's.
    """
    shifts = [np.zeros(3)] if baseline_m is None else [np.zeros(3), np.array([baseline_m, 0.0, 0.0])]
    out: list[list[BoardView]] = [[] for _ in shifts]
    X = BOARD.xyz_m - BOARD.xyz_m.mean(axis=0)
    while len(out[0]) < n:
        x, y = lens.rays(rng.uniform([150.0, 120.0], [1130.0, 904.0])[None])[0]
        ray = np.array([x, y, 1.0]) / np.hypot(np.hypot(x, y), 1.0)
        facing = Rotation.align_vectors(ray[None], np.array([[0.0, 0.0, 1.0]]))[0]
        tilt = Rotation.from_euler("zxy", rng.uniform([-30.0, -40.0, -40.0], [30.0, 40.0, 40.0]), degrees=True)
        points = (facing * tilt).apply(X) + rng.uniform(0.2, 0.5) * ray
        uv = [one.project(points - shift) for one, shift in zip((lens, other or lens), shifts, strict=False)]
        if not all(np.isfinite(one).all() and (one > 5.0).all() and (one < SIZE - 6.0).all() for one in uv):
            continue
        for side, one in zip(out, uv, strict=True):
            noisy = one + rng.normal(0.0, SIGMA_PX, one.shape)
            side.append(
                BoardView(
                    source=f"{len(side)}",
                    width=1280,
                    height=1024,
                    index=np.arange(len(X)),
                    uv_px=noisy,
                    sigma_px=SIGMA_PX,
                )
            )
    return out


def test_a_rig_is_found_within_what_it_claims() -> None:
    left, right = seen(FISHEYE, np.random.default_rng(2), baseline_m=0.12)
    done = calibrate_stereo(left, right, BOARD, OPTIONS)
    assert done.rig.left.lens is done.rig.right.lens is LensKind.FISHEYE
    assert abs(done.rig.baseline_m - 0.12) < 4.0 * done.baseline_std_m < 0.002
    assert "right.k4" in done.std
    assert done.epipolar_rms_px < 2.0 * SIGMA_PX


def test_fisheye_pictures_are_no_pinhole_calibration() -> None:
    left, right = seen(FISHEYE, np.random.default_rng(3), baseline_m=0.12)
    with refuses(Inconsistent, "fisheye"):
        calibrate_camera(left, BOARD, BoardOptions(folds=0))
    with refuses(Inconsistent, "fisheye"):
        calibrate_stereo(left, right, BOARD, BoardOptions(folds=0))


def test_pinhole_pictures_are_no_fisheye_calibration() -> None:
    views = seen(TANGENTIAL, np.random.default_rng(4))[0]
    assert calibrate_camera(views, BOARD, BoardOptions(folds=0)).camera.lens is LensKind.PINHOLE
    with refuses(Inconsistent, "pinhole"):
        calibrate_camera(views, BOARD, OPTIONS)


def test_a_pair_of_a_fisheye_and_a_pinhole() -> None:
    distortion = (-0.05, 0.01, 1e-3, 0.0, 0.0)
    pinhole = Lens(width=1280, height=1024, focal_px=(480.0, 482.0), centre_px=(650.0, 500.0), distortion=distortion)
    left, right = seen(FISHEYE, np.random.default_rng(6), baseline_m=0.12, other=pinhole)
    mixed = BoardOptions(lens=LensKind.FISHEYE, right_lens=LensKind.PINHOLE)
    done = calibrate_stereo(left, right, BOARD, mixed)
    assert (done.rig.left.lens, done.rig.right.lens) == (LensKind.FISHEYE, LensKind.PINHOLE)
    assert abs(done.rig.baseline_m - 0.12) < 4.0 * done.baseline_std_m < 0.002
    assert {"left.k4", "right.p1"} < set(done.std)
    assert done.rms_px == pytest.approx(SIGMA_PX * np.sqrt(2.0), rel=0.1)
    both_pinholes = calibrate_stereo(left, right, BOARD, BoardOptions(folds=0))  # all in the image's inner 60 %
    told = [line for line in both_pinholes.advice if names_it(line, "left camera", "fisheye")]
    assert told
    assert "fisheye,pinhole" in told[0]
    swapped = BoardOptions(lens=LensKind.PINHOLE, right_lens=LensKind.FISHEYE, folds=0)
    with refuses(Inconsistent, "left camera", "fisheye"):
        calibrate_stereo(left, right, BOARD, swapped)
