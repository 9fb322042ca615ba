"""Target poses from independent projections (OpenCV): truth, claimed covariances, degenerate cases by name."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation
from scipy.stats import chi2 as chi2_law

from armsight.errors import Degenerate, Unseen
from armsight.geometry import align_points, pose_difference
from armsight.measure.poses.from_spots import measure_spots
from armsight.measure.poses.kernels import rig_covariance
from armsight.measure.poses.pipeline import Measured, Setup
from armsight.optics import INTRINSICS, RIG_PARAMETERS, Camera, Rig, converged_rig, triangulate_closed
from armsight.optics.kernels.camera import RigK
from armsight.optics.parallelism import moved_rig
from armsight.records import NamedCovariance, PoseStatus, Spots, Target, spot_target, unmeasured_target
from refusals import names_it, refuses

CAMERA = Camera.pinhole(1280, 720, 1131.0, 1127.0, 643.5, 352.25, distortion=(-0.28, 0.09, 8e-4, -5e-4, -0.012))
RIG = converged_rig(CAMERA, CAMERA, 0.12, 0.08, -0.08)
TRIANGLE = {"A": (-0.04, 0.0, 0.0), "B": (0.03, 0.035, 0.0), "C": (0.015, -0.03, 0.0)}
SIGMA_PX = 0.05


def project(points: np.ndarray, rig: Rig = RIG) -> list[np.ndarray]:
    out = []
    for camera, T in ((rig.left, rig.T_rig_left.inv()), (rig.right, rig.T_rig_right.inv())):
        uv, _ = cv2.projectPoints(
            np.ascontiguousarray(points), T.rotation.as_rotvec(), T.translation, camera.matrix, camera.distortion
        )
        out.append(uv[:, 0])
    return out


def spots(
    uv: np.ndarray,
    rng: np.random.Generator | None,
    sigma_px: float = SIGMA_PX,
    model: str = "gaussian",
    size_px: float = 2.0,
) -> Spots:
    """Spots in an order of their own, with the noise they claim (none where rng is None)."""
    n = len(uv)
    order = np.arange(n) if rng is None else rng.permutation(n)
    noise = 0.0 if rng is None else rng.normal(0.0, sigma_px, uv.shape)
    return Spots(
        uv_px=(uv + noise)[order],
        covariance_px2=np.tile(sigma_px**2 * np.eye(2), (n, 1, 1)),
        peak=np.full(n, 100.0),
        size_px=np.full(n, size_px),
        model=(model,) * n,
    )


def random_pose(rng: np.random.Generator, tilt_rad: float = 0.3) -> RigidTransform:
    return RigidTransform.from_components(
        rng.uniform([-0.1, -0.08, 0.5], [0.1, 0.08, 0.8]), Rotation.from_rotvec(rng.normal(0.0, tilt_rad, 3))
    )


def measure(target: Target, points: np.ndarray, rng: np.random.Generator | None) -> Measured:
    left, right = project(points)
    return measure_spots(Setup(RIG, target), 0.0, spots(left, rng), spots(right, rng))


def whole(measured: Measured) -> tuple[RigidTransform, np.ndarray]:
    assert measured.pose.status is PoseStatus.OK, measured.pose.why
    assert measured.pose.pose is not None and measured.pose.covariance is not None
    return measured.pose.pose, measured.pose.covariance


def test_ellipsoids_hold_the_truth_and_likelihood_beats_kabsch() -> None:
    """300 poses: the 95 % share has a standard deviation of 1.3 %; four of them are allowed."""
    rng, n, model = np.random.default_rng(2), 300, np.array(list(TRIANGLE.values()))
    q, ours, theirs = [], [], []
    for _ in range(n):
        T = random_pose(rng)
        measured = measure(spot_target(TRIANGLE), T.apply(model), rng)
        found, covariance = whole(measured)
        difference = pose_difference(found, T)
        q.append(difference @ np.linalg.solve(covariance, difference))
        points = triangulate_closed(
            RIG, measured.left.uv_px, measured.right.uv_px, measured.left.covariance_px2, measured.right.covariance_px2
        )
        kabsch = pose_difference(align_points(points.xyz_m, model).T_a_b, T)
        ours.append(difference)
        theirs.append(kabsch)
    assert abs((np.array(q) < chi2_law.ppf(0.95, 6)).mean() - 0.95) < 0.05
    assert abs(np.mean(q) / 6.0 - 1.0) < 5.0 * np.sqrt(2.0 / (6.0 * n))
    rms = [np.sqrt((np.array(e)[:, 3:] ** 2).sum(axis=1).mean()) for e in (ours, theirs)]
    assert rms[0] <= rms[1]


def test_frame_of_a_target_nobody_measured() -> None:
    """Pachidis (7)-(8): origin at the mean, u from A to it, w away from the camera; covariance by simulation."""
    rng, q = np.random.default_rng(4), []
    model = np.array([[-0.05, 0.0, 0.0], [0.025, 0.045, 0.0], [0.025, -0.045, 0.0]])
    assert np.allclose(model.mean(axis=0), 0.0)
    for _ in range(200):
        T = random_pose(rng, tilt_rad=0.15)
        found, covariance = whole(measure(unmeasured_target(), T.apply(model), rng))
        d = pose_difference(found, T)
        q.append(d @ np.linalg.solve(covariance, d))
    assert abs(np.mean(q) / 6.0 - 1.0) < 5.0 * np.sqrt(2.0 / (6.0 * 200))


def outline_centre(rig: Rig, T: RigidTransform, centre: np.ndarray, radius: float, side: int) -> np.ndarray:
    """Centroid of the image of a disc in the plane z = 0 of T, from 2,000 points of its outline."""
    a = np.linspace(0.0, 2.0 * np.pi, 2000, endpoint=False)
    ring = centre + radius * np.column_stack([np.cos(a), np.sin(a), np.zeros_like(a)])
    uv = project(T.apply(ring), rig)[side]
    nxt = np.roll(uv, -1, axis=0)
    cross = uv[:, 0] * nxt[:, 1] - nxt[:, 0] * uv[:, 1]
    return np.asarray(((uv + nxt) * cross[:, None]).sum(axis=0) / (3.0 * cross.sum()))


@pytest.mark.parametrize(("distortion", "left_over"), [((0.0,) * 5, 1e-3), (tuple(CAMERA.distortion), 0.01)])
def test_perspective_shift_of_flat_lights_is_taken_out(distortion: tuple[float, ...], left_over: float) -> None:
    """Discs of 24 mm tilted by 50 degrees: their outlines' centres lie 0.2 px off the centres' images.

    Without distortion the correction is exact; with it the bending of the outline is taken to second order.
    """
    camera = Camera.pinhole(1280, 720, 1131.0, 1127.0, 643.5, 352.25, distortion=distortion)
    rig = converged_rig(camera, camera, 0.12, 0.08, -0.08)
    T = RigidTransform.from_components([0.02, 0.01, 0.45], Rotation.from_rotvec([0.6, -0.6, 0.2]))
    X = np.array(list(TRIANGLE.values()))
    seen = [np.array([outline_centre(rig, T, x, 0.012, side) for x in X]) for side in range(2)]
    assert max(np.abs(uv - p).max() for uv, p in zip(seen, project(T.apply(X), rig), strict=True)) > 0.15

    def error(diameter: float | None, model: str) -> np.ndarray:
        views = [spots(uv, None, model=model, size_px=1131.0 * 0.012 / 0.45) for uv in seen]
        found, _ = whole(measure_spots(Setup(rig, spot_target(TRIANGLE, diameter_m=diameter)), 0.0, *views))
        return np.abs(pose_difference(found, T))

    plain, corrected = error(None, "ellipse"), error(0.024, "ellipse")
    assert corrected[3:].max() < left_over * plain[3:].max()
    assert corrected[:3].max() < left_over * plain[:3].max()
    np.testing.assert_allclose(error(0.024, "gaussian"), plain, rtol=1e-6)  # only outlines are shifted


def test_two_spots_one_spot_none() -> None:
    rng, X = np.random.default_rng(6), np.array(list(TRIANGLE.values()))
    points = random_pose(rng).apply(X)
    two = measure(spot_target(TRIANGLE), points[:2], rng)
    assert two.pose.status is PoseStatus.POSITION_ONLY and "2 of 3" in two.pose.why
    assert two.pose.pose is not None and two.pose.covariance is not None
    d = two.pose.pose.translation - points[:2].mean(axis=0)
    assert d @ np.linalg.solve(two.pose.covariance, d) < chi2_law.ppf(0.9999, 3)
    assert measure(spot_target(TRIANGLE), points[:1], rng).pose.status is PoseStatus.POSITION_ONLY
    none = measure_spots(Setup(RIG, spot_target(TRIANGLE)), 0.0, Spots.none(), Spots.none())
    assert none.pose.status is PoseStatus.LOST and none.cause is Unseen.NO_SPOT


def test_beacon_is_a_position() -> None:
    rng = np.random.default_rng(7)
    points = np.array([[0.05, -0.02, 0.6]])
    measured = measure(spot_target({"A": (0.0, 0.0, 0.0)}), points, rng)
    assert measured.pose.status is PoseStatus.POSITION_ONLY and measured.names == ("A",)
    assert measured.pose.pose is not None and measured.pose.covariance is not None
    d = measured.pose.pose.translation - points[0]
    assert d @ np.linalg.solve(measured.pose.covariance, d) < chi2_law.ppf(0.9999, 3)


def test_spots_on_one_line_are_refused_before_any_frame() -> None:
    with refuses(Degenerate, "one line"):
        Setup(RIG, spot_target({"A": (0.0, 0.0, 0.0), "B": (0.05, 0.0, 0.0), "C": (0.1, 0.0, 0.0)}))


def test_wrong_measures_of_the_target_are_said() -> None:
    rng = np.random.default_rng(8)
    shrunk = 0.95 * np.array(list(TRIANGLE.values()))
    measured = measure(spot_target(TRIANGLE), random_pose(rng).apply(shrunk), rng)
    assert measured.pose.status is PoseStatus.LOST and measured.cause is Unseen.MISFIT


def test_one_wrong_spot_of_five_is_left_out_with_the_reason() -> None:
    rng = np.random.default_rng(9)
    five = {**TRIANGLE, "D": (0.05, 0.01, -0.01), "E": (-0.02, 0.04, 0.0)}
    X = np.array(list(five.values()))
    T = random_pose(rng)
    points = T.apply(X)
    points[3] += T.rotation.apply([0.01, 0.0, 0.0])  # D has been knocked 10 mm out of place
    measured = measure(spot_target(five), points, rng)
    found, _ = whole(measured)
    assert measured.names == ("A", "B", "C", "E")
    assert len(measured.notes) == 1 and names_it(measured.notes[0], "D", "left out")
    assert np.linalg.norm(found.translation - T.translation) < 1e-3


def noisy_rig(rng: np.random.Generator, covariance: NamedCovariance) -> Rig:
    """The rig as a calibration would give it, wrong by a draw from its covariance, parameter by parameter."""
    draw = dict(zip(covariance.names, rng.multivariate_normal(np.zeros(26), covariance.matrix), strict=True))
    cameras = {}
    for side, camera in (("left", RIG.left), ("right", RIG.right)):
        k = camera.intrinsics + [draw[f"{side}.{name}"] for name in INTRINSICS]
        cameras[side] = Camera(width=camera.width, height=camera.height, intrinsics=k)
    dt, dw = np.array([draw[f"right.t{a}"] for a in "xyz"]), np.array([draw[f"right.r{a}"] for a in "xyz"])
    T = RIG.T_rig_right
    moved = RigidTransform.from_components(T.translation + dt, Rotation.from_rotvec(dw) * T.rotation)
    return Rig(kind=RIG.kind, **cameras, T_rig_left=RIG.T_rig_left, T_rig_right=moved, covariance=covariance)


@pytest.mark.parametrize("target", [spot_target(TRIANGLE), unmeasured_target()], ids=["measured", "unmeasured"])
def test_errors_of_the_calibration_are_in_the_deviations(target: Target) -> None:
    """300 calibrations, each wrong within its own covariance; the spots' noise is small beside it."""
    rng, q, rig_covariance = np.random.default_rng(10), {"pose": [], "point": []}, []
    sigma = dict.fromkeys(RIG_PARAMETERS, 1e-3)  # k1 .. k3
    for side in ("left", "right"):
        sigma |= {f"{side}.{a}": s for a, s in (("fx", 0.4), ("fy", 0.4), ("cx", 0.2), ("cy", 0.2), ("skew", 0.05))}
        sigma |= {f"{side}.p1": 5e-5, f"{side}.p2": 5e-5}
    sigma |= {f"right.t{a}": 5e-5 for a in "xyz"} | {f"right.r{a}": 1e-4 for a in "xyz"}
    covariance = NamedCovariance(names=RIG_PARAMETERS, matrix=np.diag([sigma[n] ** 2 for n in RIG_PARAMETERS]))
    model = np.array([[-0.05, 0.0, 0.0], [0.025, 0.045, 0.0], [0.025, -0.045, 0.0]])
    places = model if not target.model_known else np.array(list(TRIANGLE.values()))
    for _ in range(300):
        T = random_pose(rng, 0.1)
        points = T.apply(places)
        views = [spots(uv, rng) for uv in project(points)]
        setup = Setup(noisy_rig(rng, covariance), target, slack_px=0.5)
        measured = measure_spots(setup, 0.0, *views)
        found, C = whole(measured)
        d = pose_difference(found, T)
        q["pose"].append(d @ np.linalg.solve(C, d) / 6.0)
        e = measured.points.xyz_m[0] - points[0]
        q["point"].append(e @ np.linalg.solve(measured.points.covariance_m2[0], e) / 3.0)
        exact = measure_spots(Setup(RIG, target, slack_px=0.5), 0.0, *views)
        rig_covariance.append(np.trace(whole(exact)[1][:3, :3]) / np.trace(C[:3, :3]))
    assert np.mean(rig_covariance) < 0.3
    for name, dof in (("pose", 6.0), ("point", 3.0)):
        assert abs(np.mean(q[name]) - 1.0) < 5.0 * np.sqrt(2.0 / (dof * 300)), name


@pytest.mark.parametrize("side", [0, 1], ids=["left", "right"])
def test_derivatives_of_pixels_by_the_rig(side: int) -> None:
    """All 26 against differences: signs matter where the calibration's parameters depend on each other."""
    packed, point = Setup(RIG, spot_target(TRIANGLE)).packed, np.array([0.05, 0.03, 0.6])
    uv, J, D, expected = np.empty(2), np.empty((2, 3)), np.empty((2, 26)), np.empty((2, 26))
    rig_covariance.pixel_slopes(RigK(*packed.arrays), point, side, uv, J, D)
    for i, name in enumerate(RIG_PARAMETERS):
        step = np.zeros(26)
        step[i] = 1e-3 if name[-2:] in ("fx", "fy", "cx", "cy", "ew") else 1e-6
        views = [moved_rig(RIG, s * step).project(point)[side][0] for s in (1.0, -1.0)]
        expected[:, i] = (views[0] - views[1]) / (2.0 * step[i])
    np.testing.assert_allclose(D, expected, atol=1e-4 * np.abs(expected).max())
    np.testing.assert_allclose(D[:, :10], expected[:, :10], atol=1e-5 * np.abs(expected[:, :10]).max())
