"""Poses by one, three, four and eight cameras in a world of its own: bounds, ellipsoids, names, single sights."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation
from scipy.stats import chi2 as chi2_law
from tests.truth.camera_ring import CENTRE, FOCAL, K1, LIGHTS, SIZE, Ring, look, pose, ring

from armsight.errors import Inconsistent, Unseen
from armsight.measure.poses.from_spots import measure_spots
from armsight.measure.poses.kernels import completion, one_view
from armsight.measure.poses.moments import TargetTracker, measure_moment
from armsight.measure.poses.outcome import Measured
from armsight.measure.poses.setup import Setup
from armsight.measure.poses.views import measure_views
from armsight.optics import Camera, MountedCamera, Rig
from armsight.records import Frame, NamedCovariance, PoseStatus, Spots, spot_target, unmeasured_target
from refusals import names_it, refuses

SIGMA_PX = 0.05
FLAT = LIGHTS[:5] * [1.0, 1.0, 0.0]
CUT_PX = 2.2
WRONG = chi2_law.isf(1e-8, 6)


def setup_of(world: Ring, X: np.ndarray = LIGHTS, covariance: NamedCovariance | None = None) -> Setup:
    camera = Camera.pinhole(*SIZE, FOCAL, FOCAL, *CENTRE, distortion=(K1, 0.0, 0.0, 0.0, 0.0))
    names = ("left", "right") if len(world) == 2 else [f"c{s}" for s in range(len(world))]
    mounted = [
        MountedCamera(
            name=name, camera=camera, T_rig_camera=RigidTransform.from_components(t, Rotation.from_matrix(R)).inv()
        )
        for name, R, t in zip(names, world.R, world.t, strict=True)
    ]
    target = spot_target({c: tuple(x) for c, x in zip("ABCDEF", X.tolist(), strict=False)})
    return Setup(Rig(cameras=mounted, covariance=covariance), target)


def spots(uv: np.ndarray) -> Spots:
    return Spots.of_centres(uv, SIGMA_PX**2 * np.eye(2)) if len(uv) else Spots.none()


def difference(found: np.ndarray, T: np.ndarray) -> np.ndarray:
    turn = Rotation.from_matrix(found[:3, :3] @ T[:3, :3].T).as_rotvec()
    return np.concatenate([found[:3, 3] - T[:3, 3], turn])


def mahalanobis2(measured: Measured, T: np.ndarray) -> float:
    found, C = measured.pose.T_parent_target, measured.pose.covariance
    assert found is not None and C is not None
    d = difference(found, T)
    return float(d @ np.linalg.solve(C, d))


def shown(measured: Measured, m: int, v: int) -> np.ndarray:
    out = np.zeros((m, v), bool)
    assert measured.sights is not None
    out[["ABCDEF".index(name) for name in measured.names]] = measured.sights
    return out


@pytest.mark.parametrize("views", [1, 3, 4, 8])
def test_poses_reach_the_bound_and_ellipsoids_hold_the_truth(views: int) -> None:
    """Lights hidden by a fifth (of one camera none), two reflections beside the target in every other moment."""
    rng, world, n = np.random.default_rng(views), ring(views), 120
    setup, q, squares = setup_of(world), [], []
    for i in range(n):
        T = pose(rng)
        seen = look(world, LIGHTS, T, rng, hidden=0.0 if views == 1 else 0.2, reflections=i % 2 * 2)
        measured = measure_views(setup, 0.0, [spots(uv) for uv in seen.uv])
        if measured.pose.status is not PoseStatus.OK:
            continue
        q.append(mahalanobis2(measured, T))
        bound = np.diag(world.bound(LIGHTS, T, shown(measured, 6, views), SIGMA_PX))
        squares.append(difference(np.asarray(measured.pose.T_parent_target), T) ** 2 / bound)
    assert len(q) >= (0.75 if views == 1 else 0.97) * n
    assert max(q) < WRONG
    inside = (np.array(q) < chi2_law.ppf(0.95, 6)).mean()
    assert abs(inside - 0.95) < 4.0 * np.sqrt(0.95 * 0.05 / len(q))
    assert abs(np.mean(squares) - 1.0) < 5.0 * np.sqrt(2.0 / (6.0 * len(q)))


def test_a_light_that_one_camera_alone_sees_has_no_point_but_counts() -> None:
    rng, world = np.random.default_rng(1), ring(3)
    setup = setup_of(world)
    for _ in range(10):
        T = pose(rng)
        seen = look(world, LIGHTS, T, rng)
        before = measure_views(setup, 0.0, [spots(uv) for uv in seen.uv])
        # A, B, C by both of the first two; D, E, F by the third alone
        kept = [uv[(light < 3) == (s < 2)] for s, (uv, light) in enumerate(zip(seen.uv, seen.light, strict=True))]
        measured = measure_views(setup, 0.0, [spots(uv) for uv in kept])
        assert before.pose.status is measured.pose.status is PoseStatus.OK
        assert measured.points.names == ("A", "B", "C") and measured.names == tuple("ABCDEF")
        assert shown(measured, 6, 3).sum(axis=1).tolist() == [2, 2, 2, 1, 1, 1]
        assert mahalanobis2(measured, T) < WRONG
        alone = measure_views(setup, 0.0, [*(spots(uv) for uv in kept[:2]), Spots.none()])
        if alone.pose.status is PoseStatus.OK:
            C, D = measured.pose.covariance, alone.pose.covariance
            assert C is not None and D is not None
            assert np.trace(C[3:, 3:]) < 0.5 * np.trace(D[3:, 3:])


def test_a_camera_without_spots_is_not_counted() -> None:
    rng, world = np.random.default_rng(2), ring(4)
    T = pose(rng)
    uv = look(world, LIGHTS, T, rng).uv
    measured = measure_views(setup_of(world), 0.0, [spots(uv[0]), Spots.none(), spots(uv[2]), spots(uv[3])])
    assert measured.pose.status is PoseStatus.OK and mahalanobis2(measured, T) < WRONG
    assert shown(measured, 6, 4).any(axis=0).tolist() == [True, False, True, True]
    assert len(measured.pose.residual_px) == 2 * shown(measured, 6, 4).sum()


def test_parts_of_a_target_that_are_alike_are_told_by_the_motion_alone() -> None:
    """A, B and F lie to each other as E, D and F do, to 0.03 mm: which three are seen no picture tells."""
    rng, world = np.random.default_rng(5), ring(3)
    crown = np.array(
        [
            [0.05, 0.0, -0.06],
            [0.0354, -0.0354, -0.03],
            [-0.025, -0.0433, -0.06],
            [-0.0483, 0.0129, -0.03],
            [-0.025, 0.0433, -0.06],
            [0.025, 0.0433, -0.03],
        ]
    )
    setup = setup_of(world, crown)
    for _ in range(6):
        T = pose(rng)
        whole = look(world, crown, T, rng)
        part = [spots(uv[np.isin(light, [0, 1, 5])]) for uv, light in zip(whole.uv, whole.light, strict=True)]
        alone = measure_views(setup, 0.03, part)
        assert alone.pose.status is PoseStatus.LOST and alone.cause is Unseen.AMBIGUOUS
        before = measure_views(setup, 0.0, [spots(uv) for uv in whole.uv])
        then = measure_views(setup, 0.03, part, before.track)
        assert before.pose.status is then.pose.status is PoseStatus.OK
        assert then.names == ("A", "B", "F") and mahalanobis2(then, T) < WRONG


def test_lights_that_no_two_cameras_share_are_named_together() -> None:
    """One camera shows four of the lights, and two others two each, of which one alone is among the four."""
    rng, world, named = np.random.default_rng(12), ring(4), 0
    for _ in range(30):
        T = pose(rng, tilt_rad=0.3)
        uv = look(world, LIGHTS, T, rng).uv
        kept = [uv[0][:4], uv[1][3:5], Spots.none().uv_px, uv[3][4:]]
        measured = measure_views(setup_of(world), 0.0, [spots(rng.permutation(one)) for one in kept])
        if measured.pose.status is PoseStatus.OK:
            named += 1
            assert mahalanobis2(measured, T) < WRONG
    assert named > 25


def complete(setup: Setup, X: np.ndarray, T: np.ndarray, uv: np.ndarray, view: int) -> list[int]:
    """Which of the spots uv of one view each light is under a pose; other views show nothing."""
    found, rows = spots(uv), np.full((len(X), len(setup.packed.k)), -1, np.intp)
    first = np.array([0] * (view + 1) + [len(uv)] * (rows.shape[1] - view), np.intp)
    near = (
        (np.array(found.uv_px), np.array(found.covariance_px2), first),
        (0.01, 16.0),
    )  # the layout of all views' spots
    X = np.array(X)
    X.setflags(write=False)  # and of a target's lights: no other kernel is compiled than measuring does
    assert completion.complete(setup.packed.arrays, X, T, 1e-10 * np.eye(6), setup.packed.covariance, *near, rows)
    assert (np.delete(rows, view, axis=1) == -1).all()
    return list(rows[:, view].tolist())


def test_three_spots_give_the_pose_among_at_most_four() -> None:
    rng, missed = np.random.default_rng(5), 0
    for _ in range(300):
        X, T = rng.normal(0.0, 0.05, (3, 3)), np.eye(4)
        T[:3, :3], T[:3, 3] = (
            Rotation.random(random_state=rng).as_matrix(),
            rng.uniform([-0.3, -0.2, 0.5], [0.3, 0.2, 2.0]),
        )
        P = X @ T[:3, :3].T + T[:3, 3]
        poses = np.empty((4, 3, 4))
        n = one_view.poses_by_three(X, P / np.linalg.norm(P, axis=1)[:, None], poses)
        missed += min((float(np.abs(one - T[:3]).max()) for one in poses[:n]), default=1.0) > 1e-6
    assert missed <= 9, "where two solutions meet or three lights are on a line"


@pytest.mark.parametrize("camera", [1, 2])
def test_what_one_cameras_place_leaves_in_the_pose_is_what_moving_it_does(camera: int) -> None:
    """Only this camera's tx, ty, tz are uncertain: the systematic covariance is that of poses with it moved."""
    rng, world, step = np.random.default_rng(6), ring(3), 1e-4
    T = pose(rng)
    uv = world.pixels(LIGHTS @ T[:3, :3].T + T[:3, 3])
    names = tuple(f"c{camera}.{axis}" for axis in ("tx", "ty", "tz"))
    covariance = NamedCovariance(names=names, matrix=step**2 * np.eye(3))
    seen = [spots(uv[:, s]) for s in range(3)]
    measured = measure_views(setup_of(world, covariance=covariance), 0.0, seen)
    expected = np.zeros((6, 6))
    for axis in np.eye(3):
        ends = []
        for sign in (1.0, -1.0):
            t = world.t.copy()
            t[camera] -= world.R[camera] @ (sign * step * axis)
            found = measure_views(setup_of(Ring(world.R, t)), 0.0, seen).pose.T_parent_target
            assert found is not None
            ends.append(difference(found, T))
        d = 0.5 * (ends[0] - ends[1])
        expected += np.outer(d, d)
    found = measured.pose.systematic_covariance
    assert found is not None
    assert (np.abs(found - expected) < 0.02 * np.sqrt(np.outer(np.diag(expected), np.diag(expected)))).all()


def test_one_camera_before_a_flat_target_calls_no_flipped_tilt_ok() -> None:
    rng, world = np.random.default_rng(7), ring(1)
    setup, ok = setup_of(world, FLAT), 0
    for _ in range(60):
        T = pose(rng)
        measured = measure_views(setup, 0.0, [spots(uv) for uv in look(world, FLAT, T, rng, sigma_px=2 * SIGMA_PX).uv])
        ok += measured.pose.status is PoseStatus.OK
        assert measured.pose.status is not PoseStatus.OK or mahalanobis2(measured, T) < 4 * WRONG
    assert ok > 20


def draw(
    world: Ring, T: np.ndarray, rng: np.random.Generator, cut: tuple[int, int] | None = None, radius_px_m: float = 6.5
) -> list[Frame]:
    """Pictures of all cameras; of one light (light, view) an edge hides a part. Lights of 14 mm are 5 px at 1.3 m."""
    frames, P = [], LIGHTS @ T[:3, :3].T + T[:3, 3]
    for s, uv in enumerate(np.swapaxes(world.pixels(P), 0, 1)):
        image, depth_m = np.full((720, 1280), 12.0), P @ world.R[s][2] + world.t[s][2]
        for light, (u, v) in enumerate(uv):
            a, b = int(u), int(v)
            y, x = np.mgrid[b - 15 : b + 16, a - 15 : a + 16]
            disc = 200.0 * np.clip(0.5 + radius_px_m / depth_m[light] - np.hypot(x - u, y - v), 0.0, 1.0)
            image[b - 15 : b + 16, a - 15 : a + 16] += np.where((light, s) == cut, disc * (x < u + CUT_PX), disc)
        image += rng.normal(0.0, 1.0, image.shape)
        frames.append(Frame(image=np.clip(image, 0, 255).astype(np.uint8), t_s=0.0, sequence=0, source=f"view {s}"))
    return frames


def test_pictures_are_tracked_a_lost_camera_is_left_and_a_half_hidden_light_goes_from_its_view_alone() -> None:
    rng, world = np.random.default_rng(8), ring(3)
    setup, T = setup_of(world), pose(rng, tilt_rad=0.1)
    track = None
    for number in range(3):
        T[0, 3] += 0.001
        frames: list[Frame | None] = [
            Frame(image=f.image, t_s=0.01 * number, sequence=number, source=f.source) for f in draw(world, T, rng)
        ]
        if number == 2:
            frames[1] = None
        measured = measure_moment(setup, frames, track)
        track = measured.track
        assert measured.pose.status is PoseStatus.OK, measured.pose.why
        assert measured.tracked == (number > 0) and mahalanobis2(measured, T) < WRONG
        assert shown(measured, 6, 3).any(axis=0).tolist() == [True, number < 2, True]
    measured = measure_moment(setup, draw(world, T, rng, cut=(2, 0)))
    assert measured.pose.status is PoseStatus.OK and mahalanobis2(measured, T) < WRONG
    sights = shown(measured, 6, 3)
    assert not sights[2, 0] and sights[2, 1:].all() and sights[:, 0].sum() == 5
    assert len(measured.notes) == 1 and names_it(measured.notes[0], "C")


def test_one_camera_gives_a_spot_to_the_light_before_another_that_it_hides() -> None:
    """The light behind comes first in the target's order, and its image lies 1.5 px from the spot."""
    rng, world = np.random.default_rng(11), ring(1)
    for _ in range(10):
        T, X = pose(rng), LIGHTS.copy()
        before = X[3] @ T[:3, :3].T + T[:3, 3]
        X[0] = (before * 1.03 + [2e-3, 0.0, 0.0] - T[:3, 3]) @ T[:3, :3]
        seen = look(world, X[1:], T, rng)
        measured = measure_views(setup_of(world, X), 0.0, [spots(seen.uv[0])])
        assert measured.pose.status is PoseStatus.OK, measured.pose.why
        assert measured.names == tuple("BCDEF") and mahalanobis2(measured, T) < WRONG


@pytest.mark.parametrize("views", [2, 3])
def test_a_pose_beyond_its_claims_that_jumped_begins_no_motion(views: int) -> None:
    """A crown under wrong names fits badly and a sixth of a turn away; the right names that follow are believed."""
    rng, world = np.random.default_rng(12), ring(views)
    setup, T, track = setup_of(world), pose(rng), None

    def measured(number: int, sigma_px: float = SIGMA_PX) -> Measured:
        seen = [spots(uv) for uv in look(world, LIGHTS, T, rng, sigma_px=sigma_px).uv]
        if views == 2:
            return measure_spots(setup, 0.03 * number, *seen, track)
        return measure_views(setup, 0.03 * number, seen, track)

    for number in range(5):
        T[0, 3] += 0.001
        track = measured(number).track
    assert track is not None
    turn, before = Rotation.from_euler("z", np.pi / 3.0).as_matrix(), T[:3, :3].copy()
    T[:3, :3] = before @ turn
    wrong = measured(5, 0.3)
    assert wrong.pose.status is PoseStatus.LOST and wrong.cause is Unseen.MOTION
    assert wrong.track is not None and np.array_equal(wrong.track.xyz_m, track.xyz_m)
    track, T[:3, :3] = wrong.track, before
    right = measured(6)
    assert right.pose.status is PoseStatus.OK and mahalanobis2(right, T) < WRONG


def test_a_followed_target_goes_on_where_a_view_is_missing_or_cannot_be_read() -> None:
    rng, world = np.random.default_rng(9), ring(3)
    setup, T = setup_of(world), pose(rng, tilt_rad=0.1)
    tracker, states = TargetTracker(setup), []
    for number in range(5):
        T[0, 3] += 0.001
        moment: list[Frame | None] = [replace(f, t_s=0.01 * number) for f in draw(world, T, rng)]
        if number == 1:
            moment[0] = replace(draw(world, T, rng)[0], t_s=0.01, unreadable="cut off")  # whatever it shows
        if number == 2:
            moment[2] = None
        if number == 3:
            moment = [None, replace(draw(world, T, rng)[1], t_s=0.03, unreadable="cut off"), None]
        measured = tracker.take(*moment)
        states.append(measured.pose.status)
        if number == 3:
            assert "cut off" in measured.pose.why and measured.pose.t_s == 0.03
            continue
        assert mahalanobis2(measured, T) < WRONG
        assert shown(measured, 6, 3).any(axis=0).tolist() == [number != 1, True, number != 2]
    assert states == [PoseStatus.OK] * 3 + [PoseStatus.LOST, PoseStatus.OK]
    with refuses(Inconsistent, "c1", "view 1"):
        tracker.take(None, replace(draw(world, T, rng)[1], image=np.zeros((10, 10), np.uint8)), None)


def unknown(setup: Setup) -> Setup:
    return Setup(setup.rig, unmeasured_target())


def by_order(P: np.ndarray, world: Ring) -> np.ndarray:
    """Three points (3, 3) as A left, B lower right, C upper right in the first camera's picture."""
    R, t = world.R[0], world.t[0]
    xy = ((P @ R.T + t)[:, :2]) / (P @ R.T + t)[:, 2:]
    a = int(np.argmin(xy[:, 0]))
    b, c = sorted((i for i in range(3) if i != a), key=lambda i: -xy[i, 1])
    return P[[a, b, c]]


def pachidis(P: np.ndarray) -> np.ndarray:
    """The frame of A, B, C: origin at their mean, x from A to it, z across their plane."""
    G = P.mean(axis=0)
    u, w = G - P[0], np.cross(P[1] - G, P[0] - G)
    u, w = u / np.linalg.norm(u), w / np.linalg.norm(w)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = np.column_stack([u, np.cross(w, u), w]), G
    return T


@pytest.mark.parametrize("views", [3, 4, 8])
def test_three_unmeasured_lights_have_the_frame_that_their_order_gives(views: int) -> None:
    """A fifth of the sights hidden: two cameras may be left to a light, and the third tells which pairing is right."""
    rng, world, q = np.random.default_rng(views), ring(views, spread_rad=1.0), []
    setup, X = unknown(setup_of(world)), LIGHTS[[0, 2, 4]]
    for _ in range(60):
        T = pose(rng)
        measured = measure_views(setup, 0.0, [spots(uv) for uv in look(world, X, T, rng, hidden=0.2).uv])
        if measured.pose.status is PoseStatus.OK:
            q.append(mahalanobis2(measured, pachidis(by_order(X @ T[:3, :3].T + T[:3, 3], world))))
            assert measured.names == ("A", "B", "C") and len(measured.points) == 3
    assert len(q) >= (15 if views == 3 else 40)
    assert max(q) < WRONG and abs(np.mean(np.array(q) < chi2_law.ppf(0.95, 6)) - 0.95) < 0.12


@pytest.mark.parametrize("views", [3, 4])
def test_two_lights_have_the_place_of_their_mean(views: int) -> None:
    rng, world, q = np.random.default_rng(views), ring(views, spread_rad=1.0), []
    X = LIGHTS[[1, 4]]
    setup = Setup(setup_of(world).rig, spot_target({"A": tuple(X[0]), "B": tuple(X[1])}))
    other = Setup(setup.rig, spot_target({"A": tuple(X[0]), "B": tuple(0.5 * X[1])}))
    for _ in range(60):
        T = pose(rng)
        seen = [spots(uv) for uv in look(world, X, T, rng).uv]
        measured = measure_views(setup, 0.0, seen)
        if measured.pose.status is PoseStatus.POSITION_ONLY:
            d = np.asarray(measured.pose.T_parent_target)[:3, 3] - (X @ T[:3, :3].T + T[:3, 3]).mean(axis=0)
            q.append(float(d @ np.linalg.solve(np.asarray(measured.pose.covariance), d)))
            assert measure_views(other, 0.0, seen).cause in (Unseen.WRONG_TARGET, Unseen.AMBIGUOUS)
    assert len(q) >= 50
    assert max(q) < chi2_law.isf(1e-8, 3) and abs(np.mean(np.array(q) < chi2_law.ppf(0.95, 3)) - 0.95) < 0.12


def test_lights_that_no_third_camera_tells_apart_are_not_guessed() -> None:
    """Two lights in one epipolar plane of the only two cameras that see them may be two others."""
    rng, world = np.random.default_rng(3), ring(3, spread_rad=1.0)
    X, T = np.array([[0.03, 0.0, 0.03], [-0.03, 0.0, -0.03]]), np.eye(4)
    T[2, 3] = 1.3
    setup = Setup(setup_of(world).rig, spot_target({"A": tuple(X[0]), "B": tuple(X[1])}))
    seen = [spots(uv) for uv in look(world, X, T, rng).uv]
    assert measure_views(setup, 0.0, [seen[0], Spots.none(), seen[2]]).pose.status is not PoseStatus.OK
    assert len(measure_views(setup, 0.0, seen).points) <= 2
    bright = [
        spots((one.uv_px[None] + np.array([[[0.0, 0.0]], [[30.0, 0.0]], [[-35.0, 5.0]]])).reshape(-1, 2))
        for one in seen
    ]
    crowd = measure_views(unknown(setup), 0.0, bright)
    assert crowd.pose.status is PoseStatus.LOST and crowd.cause in (Unseen.CROWD, Unseen.AMBIGUOUS)
