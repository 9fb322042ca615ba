"""Runs of rigs that are no pairs: the camera that is wrong is named and left out, a good rig raises no alarm."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from tests.truth.camera_ring import LIGHTS, SIZE, Ring, look, pose, ring
from tests.truth.test_views import difference, mahalanobis2, setup_of, spots

from armsight.measure.consistency.check import advice, sentence
from armsight.measure.consistency.findings import Consistency
from armsight.measure.consistency.run_of_cameras import CamerasCheck
from armsight.measure.poses.outcome import Measured
from armsight.measure.poses.setup import Setup, rig_slack_px
from armsight.measure.poses.views import measure_views
from armsight.optics import Rig, moved_rig
from armsight.records import NamedCovariance, PoseStatus
from refusals import names_it

MOMENTS = 24
TURN_RAD, SHIFT_M = np.radians(0.1), 5e-4


def knocked(world: Ring, k: int, rng: np.random.Generator, turn_rad: float = 0.0, shift_m: float = 0.0) -> Ring:
    """The world with camera k turned about its own centre, then shifted."""
    axis, way = (one / np.linalg.norm(one) for one in rng.normal(size=(2, 3)))
    turn, R, t = cv2.Rodrigues(turn_rad * axis)[0], world.R.copy(), world.t.copy()
    R[k], t[k] = turn @ R[k], turn @ t[k] + shift_m * way
    return Ring(R, t)


class Run:
    """A run of moments at places drawn; `change` makes other spots of those that the cameras see."""

    def __init__(
        self, setup: Setup, true: Ring, seed: int, change=lambda uv, i: uv, n: int = MOMENTS, later=None
    ) -> None:
        rng, self.true_poses, self.check = np.random.default_rng(seed), [], CamerasCheck(setup)
        self.measured: list[Measured] = []
        for i in range(n):
            T = pose(rng)
            world = later if later is not None and i >= n // 2 else true
            uv = change(look(world, LIGHTS, T, rng, hidden=0.1).uv, i)
            self.true_poses.append(T)
            self.measured.append(self.check.add(measure_views(setup, 0.5 * i, [spots(one) for one in uv])))
        self.found: Consistency = self.check.finish()

    def told(self, *names: str) -> None:
        assert set(self.check.without) == set(names), sentence(self.found)
        assert all(names_it(sentence(self.found), name) and names_it(advice(self.found), name) for name in names)


@pytest.mark.parametrize(("views", "k"), [(3, 0), (3, 2), (4, 1), (8, 5)])
@pytest.mark.parametrize("by", ["turn", "shift"])
def test_the_camera_that_was_knocked_is_named_and_the_poses_go_on_without_it(views: int, k: int, by: str) -> None:
    rng, world = np.random.default_rng(10 * views + k), ring(views)
    sizes = {"turn_rad": TURN_RAD} if by == "turn" else {"shift_m": SHIFT_M}
    run = Run(setup_of(world), knocked(world, k, rng, **sizes), seed=k)
    run.told(f"c{k}")
    assert run.found.verdict == "ok" and f"--again c{k}" in advice(run.found)
    after = list(run.check.again())
    assert len(after) == MOMENTS
    off = [
        mahalanobis2(one, T) for one, T in zip(after, run.true_poses, strict=True) if one.pose.status is PoseStatus.OK
    ]
    assert len(off) > 0.6 * MOMENTS and max(off) < 60.0 and np.median(off) < 9.0
    assert all(len(one.spots[k]) == 0 for one in after)


@pytest.mark.parametrize(
    ("views", "k", "seed", "n", "sizes"),
    [
        (4, 2, 3, 40, {"turn_rad": TURN_RAD}),
        *((3, *at, {"shift_m": SHIFT_M}) for at in ((0, 0, 44), (2, 11, 44), (1, 1, 102))),
        (3, 0, 3, MOMENTS, {"shift_m": 9e-5}),  # told as a shift alone: six free numbers prove nothing of it
    ],
)
def test_a_camera_that_is_knocked_during_the_run_is_named_with_the_moment(
    views: int, k: int, seed: int, n: int, sizes: dict[str, float]
) -> None:
    """Also within a stretch of the run, and where the sums of its frames are no longer kept one by one."""
    world = ring(views)
    later = knocked(world, k, np.random.default_rng(seed), **sizes)
    run = Run(setup_of(world), world, seed=seed, n=n, later=later)
    run.told(f"c{k}")
    assert names_it(sentence(run.found), f"{0.5 * (n // 2):.1f} s"), sentence(run.found)


@pytest.mark.parametrize("views", [1, 3, 4])
def test_a_rig_as_uncertain_as_it_claims_raises_no_alarm(views: int) -> None:
    """The rig's file is drawn from its covariance: what it leaves open is many times the spots' noise."""
    world, rng = ring(views), np.random.default_rng(views)
    exact = setup_of(world).rig
    lens = [0.5, 0.5, 0.5, 0.5, 0.02, 1e-3, 3e-3, 5e-5, 5e-5, 1e-3]
    std = np.array([*lens * views, *([3e-4] * 3 + [3e-4] * 3) * (views - 1)])
    covariance = NamedCovariance(names=exact.parameters, matrix=np.diag(std**2))
    told = moved_rig(Rig(cameras=exact.cameras, covariance=covariance), rng.normal(size=len(std)) * std)
    told = Rig(cameras=told.cameras, covariance=covariance)
    run = Run(replace(setup_of(world), rig=told, slack_px=rig_slack_px(told)), world, seed=views)
    assert run.found.verdict == "ok" and not run.check.left_out, sentence(run.found)
    sure = Run(replace(setup_of(world), rig=Rig(cameras=told.cameras)), world, seed=views)
    assert views == 1 or sure.found.verdict != "ok" or sure.check.left_out  # the same rig, had it claimed to be exact


def exchanged(uv: list[np.ndarray], i: int) -> list[np.ndarray]:
    return [uv[1], uv[0], *uv[2:]]


def mirrored(uv: list[np.ndarray], i: int) -> list[np.ndarray]:
    return [uv[0], np.array([SIZE[0] - 1.0, 0.0]) + uv[1] * [-1.0, 1.0], *uv[2:]]


def given_twice(uv: list[np.ndarray], i: int) -> list[np.ndarray]:
    return [uv[0], uv[0], *uv[2:]]


@pytest.mark.parametrize(("change", "names"), [(exchanged, ("c0", "c1")), (mirrored, ("c1",)), (given_twice, ("c1",))])
def test_pictures_that_are_not_the_cameras_are_told(change, names: tuple[str, ...]) -> None:
    world = ring(4)
    run = Run(setup_of(world), world, seed=5, change=change)
    run.told(*names)


def test_exchanged_pictures_of_three_cameras_leave_too_few_and_are_told_with_the_cure() -> None:
    world = ring(3)
    run = Run(setup_of(world), world, seed=6, change=exchanged)
    assert run.found.verdict == "inconsistent" and not run.check.left_out
    assert names_it(sentence(run.found), "c0") and names_it(sentence(run.found), "c1")


def test_a_camera_of_another_place_and_one_of_another_time_are_told() -> None:
    world = ring(4)
    far = knocked(world, 1, np.random.default_rng(8), np.radians(12.0), 0.2)
    Run(setup_of(world), far, seed=8).told("c1")
    old: list[np.ndarray] = []

    def late(uv: list[np.ndarray], i: int) -> list[np.ndarray]:
        old.append(uv[1])
        return [uv[0], old[max(i - 6, 0)], *uv[2:]]

    Run(setup_of(world), world, seed=9, change=late).told("c1")


@pytest.mark.parametrize("views", [3, 4])
def test_total_uncertainty_holds_the_error_of_rigs_drawn_from_their_covariance(views: int) -> None:
    world, rng = ring(views), np.random.default_rng(20 + views)
    exact = setup_of(world).rig
    lens = [0.3, 0.3, 0.3, 0.3, 0.01, 3e-4, 1e-3, 1e-5, 1e-5, 5e-4]
    std = np.array([*lens * views, *([2e-4] * 3 + [3e-4] * 3) * (views - 1)])
    covariance, q, squares = NamedCovariance(names=exact.parameters, matrix=np.diag(std**2)), [], []
    slack_px = rig_slack_px(Rig(cameras=exact.cameras, covariance=covariance))  # of all drawn rigs, to first order
    for _ in range(250):
        told = moved_rig(Rig(cameras=exact.cameras, covariance=covariance), rng.normal(size=len(std)) * std)
        told, T = Rig(cameras=told.cameras, covariance=covariance), pose(rng)
        setup = replace(setup_of(world), rig=told, slack_px=slack_px)
        measured = measure_views(setup, 0.0, [spots(uv) for uv in look(world, LIGHTS, T, rng).uv])
        if measured.pose.status is PoseStatus.OK:
            assert measured.pose.covariance is not None and measured.pose.T_parent_target is not None
            q.append(mahalanobis2(measured, T))
            squares.append(difference(measured.pose.T_parent_target, T) ** 2 / np.diag(measured.pose.covariance))
    assert len(q) > 240
    assert abs(np.mean(np.array(q) < 12.592) - 0.95) < 0.045
    assert abs(np.sqrt(np.mean(squares)) - 1.0) < 0.08
