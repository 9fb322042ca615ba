"""A printed board before one, three, four and eight cameras, by OpenCV's projection: bounds, numbers, knocks."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform
from scipy.stats import chi2 as chi2_law
from tests.truth.ring_of_cameras import BOARD, SIZE, Ring, matrix, off, pixels, ring

from armsight.errors import Unseen
from armsight.measure.consistency.check import advice, sentence
from armsight.measure.consistency.run_of_cameras import CamerasCheck
from armsight.measure.poses.outcome import Measured
from armsight.measure.poses.setup import Setup
from armsight.measure.poses.views import measure_views
from armsight.optics import Camera, MountedCamera, Rig
from armsight.records import PoseStatus, Spots, TargetKind, board_target
from refusals import names_it

SIGMA_PX = 0.1
WRONG = chi2_law.isf(1e-8, 6)


def setup_of(world: Ring, target=BOARD) -> Setup:
    mounted = [
        MountedCamera(
            name=f"c{i}",
            camera=Camera(width=SIZE[0], height=SIZE[1], intrinsics=k),
            T_rig_camera=RigidTransform.from_matrix(T),
        )
        for i, (k, T) in enumerate(zip(world.k, world.T, strict=True))
    ]
    return Setup(Rig(cameras=mounted), target)


def corners(uv: np.ndarray, point: np.ndarray | None = None) -> Spots:
    n = len(uv)
    return Spots(
        uv_px=uv,
        covariance_px2=np.tile(SIGMA_PX**2 * np.eye(2), (n, 1, 1)),
        peak=np.zeros(n),
        size_px=np.zeros(n),
        model=("corner",) * n,
        point=np.arange(n) if point is None else point,
    )


def seen(uv: np.ndarray, rng: np.random.Generator) -> list[Spots]:
    """What each camera shows of pixels (C, n, 2)."""
    noise = rng.normal(0.0, SIGMA_PX, uv.shape)
    return [corners(one) if np.isfinite(one).all() else Spots.none() for one in uv + noise]


def mahalanobis2(measured: Measured, T: np.ndarray) -> float:
    d = off(np.asarray(measured.pose.T_parent_target), T)
    return float(d @ np.linalg.solve(np.asarray(measured.pose.covariance), d))


def world_of(views: int, n: int = 60) -> Ring:
    world = ring(np.random.default_rng(views), max(views, 2), n, apart_deg=55.0 if views < 5 else 30.0)
    return Ring(k=world.k[:views], T=world.T[:views], boards=world.boards, seen=world.seen[:, :views])


@pytest.mark.parametrize("views", [1, 3, 4, 8])
def test_ellipsoids_hold_the_truth(views: int) -> None:
    world, rng, q = world_of(views), np.random.default_rng(views), []
    setup = setup_of(world)
    for uv, T, sees in zip(world.uv(), world.boards, world.seen, strict=True):
        if sees.any():
            measured = measure_views(setup, 0.0, seen(uv, rng))
            assert measured.pose.status is PoseStatus.OK, measured.pose.why
            assert [len(spots) for spots in measured.spots] == [len(uv[0]) * bool(one) for one in sees]
            q.append(mahalanobis2(measured, T))
    assert max(q) < WRONG and abs(np.mean(q) / 6.0 - 1.0) < 5.0 * np.sqrt(2.0 / (6.0 * len(q)))


def test_one_likelihood_has_corners_that_one_camera_alone_shows() -> None:
    """Halves of the board by two cameras, none of them by both: no corner has a point, the pose has all of them."""
    world, rng = world_of(4), np.random.default_rng(2)
    setup, half = setup_of(world), np.arange(len(BOARD.xyz_m)) % 9 < 4
    g = int(np.argmax(world.seen.sum(axis=1) == 2))
    first, second = np.flatnonzero(world.seen[g]).tolist()
    parts = [Spots.none()] * 4
    for s, mine in ((first, half), (second, ~half)):
        uv = world.uv()[g, s][mine] + rng.normal(0.0, SIGMA_PX, (mine.sum(), 2))
        parts[s] = corners(uv, np.flatnonzero(mine))
    both = measure_views(setup, 0.0, parts)
    assert both.pose.status is PoseStatus.OK and len(both.names) == len(BOARD.names) and len(both.points) == 0
    assert mahalanobis2(both, world.boards[g]) < WRONG
    for s in (first, second):
        alone = measure_views(setup, 0.0, [one if k == s else Spots.none() for k, one in enumerate(parts)])
        assert np.trace(np.asarray(both.pose.covariance)) < np.trace(np.asarray(alone.pose.covariance))
    few = measure_views(setup, 0.0, [one.take([0, 1, 2]) if len(one) else one for one in parts])
    assert few.pose.status is PoseStatus.LOST and few.cause is Unseen.IN_PART


def test_a_print_that_looks_alike_when_turned_is_counted_as_the_first_camera_does() -> None:
    even, world, rng = board_target(TargetKind.CIRCLES, 8, 6, 0.04), world_of(3), np.random.default_rng(3)
    setup = setup_of(world, even)
    for g in range(12):
        views: list[Spots] = []
        for s, sees in enumerate(world.seen[g]):
            uv = pixels(world.k[s], np.linalg.inv(world.T[s]) @ world.boards[g], even.xyz_m)
            turned = np.arange(48)[:: -1 if views and any(map(len, views)) else 1]  # the others count from the end
            views.append(corners(uv + rng.normal(0.0, SIGMA_PX, uv.shape), turned) if sees else Spots.none())
        measured = measure_views(setup, 0.0, views)
        assert measured.pose.status is PoseStatus.OK and mahalanobis2(measured, world.boards[g]) < WRONG


def test_a_wrong_corner_is_left_out_and_a_wrong_board_refused() -> None:
    world, rng = world_of(3), np.random.default_rng(4)
    views = seen(world.uv()[0], rng)
    s = next(k for k, one in enumerate(views) if len(one))
    uv = np.array(views[s].uv_px)
    uv[7] += [12.0, -5.0]
    views[s] = corners(uv)
    measured = measure_views(setup_of(world), 0.0, views)
    assert measured.pose.status is PoseStatus.OK and mahalanobis2(measured, world.boards[0]) < WRONG
    assert len(measured.spots[s]) == len(uv) - 1 and any(names_it(note, f"c{s}") for note in measured.notes)
    uv += rng.normal(0.0, 20.0, uv.shape)
    views[s] = corners(uv)
    assert measure_views(setup_of(world), 0.0, views).cause is Unseen.MISFIT


@pytest.mark.parametrize(("k", "degrees"), [(1, 0.1), (0, 0.3), (3, 3.0)])
def test_the_camera_that_was_knocked_is_named(k: int, degrees: float) -> None:
    world, rng = world_of(4, 24), np.random.default_rng(k)
    T = world.T.copy()
    T[k] = T[k] @ matrix(np.r_[0.0, 0.0, 0.0, np.radians(degrees), 0.0, 0.0])
    setup = setup_of(Ring(k=world.k, T=np.linalg.inv(T[0]) @ T, boards=world.boards, seen=world.seen))
    check = CamerasCheck(setup)
    for g, uv in enumerate(world.uv()):
        check.add(measure_views(setup, 0.5 * g, seen(uv, rng)))
    found = check.finish()
    assert check.without == (f"c{k}",) and names_it(advice(found), f"c{k}"), sentence(found)


@pytest.mark.parametrize("views", [1, 3, 4])
def test_a_good_rig_raises_no_alarm(views: int) -> None:
    world, rng = world_of(views, 40), np.random.default_rng(views)
    setup = setup_of(world)
    check = CamerasCheck(setup)
    for g, uv in enumerate(world.uv()):
        check.add(measure_views(setup, 0.5 * g, seen(uv, rng)))
    assert check.finish().verdict == "ok" and not check.without
