"""A target's lights by three cameras that see some of them, against OpenCV's projection: truth and deviations."""

from __future__ import annotations

import cv2
import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation
from scipy.stats import chi2 as chi2_law

from armsight.calibrate.light_target import LitMoment, TargetResult, calibrate_lights
from armsight.errors import Ambiguous, NotEnoughData, UsageError
from armsight.ops.calibration.spots_of_frames import lights_of_pairs, naming, paired
from armsight.optics import Camera, MountedCamera, Rig
from armsight.records import Spots
from armsight.units import DEG
from refusals import refuses

CAMERA = Camera.pinhole(1280, 720, 1131.0, 1127.0, 643.5, 352.25, distortion=(-0.28, 0.09, 8e-4, -5e-4, -0.012))
SIGMA_PX, FAR_M = 0.05, 0.7
LIGHTS = np.array([[-0.045, 0.0, 0.0], [0.03, 0.03, 0.0], [0.015, -0.03, 0.0], [0.0, 0.012, 0.03]])


def about(by_deg: float) -> RigidTransform:
    """A camera that looks at (0, 0, FAR_M) from beside the first one."""
    turn = Rotation.from_euler("y", by_deg, degrees=True)
    centre = np.array([0.0, 0.0, FAR_M])
    return RigidTransform.from_components(centre - turn.apply(centre), turn)


RIG = Rig(
    cameras=[
        MountedCamera(name=name, camera=CAMERA, T_rig_camera=about(by))
        for name, by in (("front", 0.0), ("east", -35.0), ("west", 35.0))
    ]
)


def frame_axes(X: np.ndarray) -> np.ndarray:
    """Lights in Pachidis's frame, written once more from eqs. (7)-(8)."""
    G = (X[0] + X[1] + X[2]) / 3.0
    u = (G - X[0]) / np.linalg.norm(G - X[0])
    w = np.cross(X[1] - G, X[0] - G)
    w /= np.linalg.norm(w)
    return (X - G) @ np.array([u, np.cross(w, u), w]).T


def pixels(one: MountedCamera, X: np.ndarray) -> np.ndarray:
    """Points in rig axes in a camera's picture, by OpenCV."""
    back, lens = one.T_rig_camera.inv(), (CAMERA.matrix, CAMERA.distortion)
    uv, _ = cv2.projectPoints(np.ascontiguousarray(X), back.rotation.as_rotvec(), back.translation, *lens)
    return uv[:, 0]


def moments(rng: np.random.Generator, n: int, hidden: float) -> list[LitMoment]:
    """Moments of the turned target, each sight hidden by that chance, its spots in an order of their own."""
    out = []
    for number in range(n):
        T = RigidTransform.from_components(
            [*rng.uniform(-0.05, 0.05, 2), FAR_M + rng.uniform(-0.05, 0.05)],
            Rotation.from_rotvec(rng.normal(0, 14.0 * DEG, 3)),
        )
        views = []
        for one in RIG.cameras:
            uv = pixels(one, T.apply(LIGHTS))
            uv = uv[rng.permutation(len(uv))[rng.random(len(uv)) >= hidden]]
            spots = uv + rng.normal(0.0, SIGMA_PX, uv.shape)
            views.append(Spots.of_centres(spots, SIGMA_PX**2 * np.eye(2)) if len(uv) else Spots.none())
        out.append(LitMoment(name=f"moment {number}", views=tuple(views)))
    return out


def calibrated(seen: list[LitMoment]) -> TargetResult:
    return calibrate_lights(RIG, seen, len(LIGHTS), paired=paired, naming=naming)


def test_errors_are_as_large_as_the_deviations_say_where_every_sight_counts() -> None:
    total, dof, once = 0.0, 0, 0
    for seed in range(6):
        done = calibrated(moments(np.random.default_rng([5, seed]), 20, 0.22))
        values, vectors = np.linalg.eigh(done.covariance.matrix)
        free = values > 1e-9 * values.max()
        e = vectors[:, free].T @ (done.xyz_m - frame_axes(LIGHTS)).ravel()
        total, dof = total + float((e**2 / values[free]).sum()), dof + int(free.sum())
        once += int((np.isfinite(done.residual_px).all(axis=3).sum(axis=2) == 1).sum())
        assert done.n_used > 10  # two cameras see all four lights in a third of the moments
    assert once > 30  # lights that one camera alone saw
    assert chi2_law.ppf(1e-4, dof) < total < chi2_law.isf(1e-4, dof)


def test_moments_that_no_two_cameras_see_in_full_make_the_shape_surer() -> None:
    seen = moments(np.random.default_rng(3), 30, 0.3)
    both = [one for one in seen if sum(len(view) == len(LIGHTS) for view in one.views) >= 2]
    assert 3 <= len(both) < 0.7 * len(seen)
    few, every = calibrated(both), calibrated(seen)
    assert np.trace(every.covariance.matrix) < 0.7 * np.trace(few.covariance.matrix)


def test_a_target_that_no_two_cameras_see_in_full_is_refused_by_name() -> None:
    seen = moments(np.random.default_rng(4), 8, 0.0)
    alone = [LitMoment(name=one.name, views=(one.views[0], Spots.none(), Spots.none())) for one in seen]
    with refuses(NotEnoughData, ("0 of 8", "two views", "two cameras that stand")):
        calibrated(alone)
    rig = RIG.only("front")
    with refuses(UsageError, ("one camera alone", "two cameras and more")):
        calibrate_lights(rig, seen, len(LIGHTS), paired=paired, naming=naming)


NEAR = Rig(
    cameras=[
        MountedCamera(name=name, camera=CAMERA, T_rig_camera=about(by))
        for name, by in (("front", 0.0), ("east", -18.0), ("west", 18.0))
    ]
)
ANGLES_DEG = np.array([0.0, 50.0, 115.0, 170.0, 235.0, 300.0])
OUTWARD = np.column_stack([np.cos(np.deg2rad(ANGLES_DEG)), np.sin(np.deg2rad(ANGLES_DEG)), np.zeros(6)])
RING = 0.04 * OUTWARD + np.outer([0.0, 0.012, -0.008, 0.015, 0.003, -0.012], [0.0, 0.0, 1.0])
SHINES = np.cos(np.deg2rad(112.0))
"""Cosine to a light's own direction from which a camera sees it: the flange hides the others."""


def round_a_flange(rng: np.random.Generator, n: int, rig: Rig = NEAR, ring: np.ndarray = RING) -> list[LitMoment]:
    """Moments of six lights round a flange that is rotated before the cameras; none sees more than four at once."""
    out = []
    upright = Rotation.from_euler("x", 90.0, degrees=True)
    for number in range(n):
        turn = Rotation.from_rotvec(rng.normal(0, 8.0 * DEG, 3)) * upright
        turn = turn * Rotation.from_euler("z", 360.0 * number / n, degrees=True)
        T = RigidTransform.from_components([*rng.uniform(-0.03, 0.03, 2), FAR_M + rng.uniform(-0.03, 0.03)], turn)
        views = []
        for one in rig.cameras:
            to_camera = np.asarray(one.T_rig_camera.translation) - T.apply(ring)
            to_camera /= np.linalg.norm(to_camera, axis=1, keepdims=True)
            lit = (turn.apply(ring / np.linalg.norm(ring, axis=1, keepdims=True)) * to_camera).sum(axis=1) > SHINES
            uv = pixels(one, T.apply(ring[lit]))[rng.permutation(lit.sum())]
            views.append(Spots.of_centres(uv + rng.normal(0.0, SIGMA_PX, uv.shape), SIGMA_PX**2 * np.eye(2)))
        out.append(LitMoment(name=f"moment {number}", views=tuple(views)))
    assert max(len(view) for one in out for view in one.views) < len(ring) - 1
    return out


def ring_chi2(done: TargetResult) -> tuple[float, int]:
    """Squared errors of the ring's lights by what is claimed of them, and how many numbers these are."""
    apart, true = (np.linalg.norm(X[:, None] - X[None], axis=2) for X in (done.xyz_m, RING))
    # which is which: by the distances to all others
    off = np.abs(np.sort(apart, axis=1)[:, None] - np.sort(true, axis=1)[None]).max(axis=2)
    order = off.argmin(axis=1)
    assert sorted(order) == list(range(6))
    values, vectors = np.linalg.eigh(done.covariance.matrix)
    free = values > 1e-9 * values.max()
    e = vectors[:, free].T @ (done.xyz_m - frame_axes(RING[order])).ravel()
    return float((e**2 / values[free]).sum()), int(free.sum())


def test_lights_round_a_flange_that_no_camera_sees_together_are_joined_by_the_moments() -> None:
    found = []
    for seed in range(4):
        seen = round_a_flange(np.random.default_rng([9, seed]), 48)
        done = calibrate_lights(NEAR, seen, len(RING), paired=paired, naming=naming)
        assert done.n_used > 40 and done.std_m.max() < 2e-5
        found.append(ring_chi2(done))
    total, dof = np.sum(found, axis=0)
    assert chi2_law.ppf(1e-4, dof) < total < chi2_law.isf(1e-4, dof)


def test_a_pair_that_never_sees_all_lights_joins_them_too() -> None:
    first, _, last = NEAR.cameras
    pair = Rig(left=CAMERA, right=CAMERA, T_rig_left=first.T_rig_camera, T_rig_right=last.T_rig_camera)
    seen = round_a_flange(np.random.default_rng(2), 72, pair)
    done = lights_of_pairs(pair, seen, len(RING), overlaid=False)
    total, dof = ring_chi2(done)
    assert done.n_used > 40 and chi2_law.ppf(1e-4, dof) < total < chi2_law.isf(1e-4, dof)


def test_lights_of_which_some_are_never_seen_with_the_others_are_refused() -> None:
    """Of a rotation by a quarter the far side is never seen."""
    seen = round_a_flange(np.random.default_rng(9), 48)
    with refuses(NotEnoughData, ("6 lights", "joined", "three and more of the others")):
        calibrate_lights(NEAR, seen[:12], len(RING), paired=paired, naming=naming)


def test_an_even_ring_whose_lights_anybody_could_exchange_is_refused() -> None:
    angle = np.deg2rad(60.0 * np.arange(6))
    even = 0.04 * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(6)])
    seen = round_a_flange(np.random.default_rng(1), 48, ring=even)
    with refuses((Ambiguous, NotEnoughData), "6 lights"):
        calibrate_lights(NEAR, seen, len(even), paired=paired, naming=naming)
