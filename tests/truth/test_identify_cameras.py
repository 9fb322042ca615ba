"""An unknown arm identified by any number of cameras, of which some do not see its beacon at every reading.

Cameras and arm are built here and in camera_ring, by no code of the product's.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.truth import camera_ring
from tests.truth.test_identify import Row, swept, tip
from tests.truth.test_views import setup_of

from armsight.calibrate.identify import Identification, Sweeps, identify
from armsight.errors import UsageError
from armsight.measure.poses.lone_light import measure_light
from armsight.measure.poses.moments import measure_chosen
from armsight.optics import Rig
from armsight.records import PoseStatus, Spots
from armsight.store.arm_points import read_sweeps, write_sweeps
from refusals import refuses

Array = NDArray[np.float64]

ARM: list[Row] = [
    (0.2, 0.10, 0.15, np.pi / 2, True),
    (0.1, 0.02, 0.20, 0.4, True),
    (0.0, 0.05, 0.12, 0.0, True),
]
AT = np.array([-0.2, -0.1, 1.25])
"""The arm's base in rig axes, m."""
SIGMA_PX, N = 0.1, 16


def beacon(q: Array) -> Array:
    return tip(ARM, q) + AT


def sweeps(world: camera_ring.Ring, rig: Rig, seed: int, fewest: int) -> Sweeps:
    """Sweeps of which every camera shows three readings of four, those that `fewest` cameras show; places 3 mm off."""
    rng = np.random.default_rng(seed)
    start = rng.uniform(-0.9, -0.6, 3)
    joint, q = swept(start, start + 1.4, rng.uniform(-0.3, 0.3, (3, 3)), N)
    uv = world.pixels(beacon(q)) + rng.normal(0.0, SIGMA_PX, (len(q), len(world), 2))
    hidden = rng.random(uv.shape[:2]) < 0.25
    uv[hidden] = np.nan
    rows = np.flatnonzero(np.isfinite(uv[:, :, 0]).sum(axis=1) >= fewest)
    rough = beacon(q) + rng.normal(0.0, 3e-3, (len(q), 3))
    return Sweeps(joint=joint[rows], q=q[rows], xyz_m=rough[rows], uv_px=uv[rows], cameras=rig.names)


def misses(found: Identification, seed: int) -> tuple[Array, Array]:
    """The beacon's errors (k,) in m at joint values of no sweep, and their squares in claimed deviations."""
    q = np.random.default_rng(1000 + seed).uniform(-0.7, 0.6, (20, 3))
    assert found.uncertainty is not None
    X, C = found.uncertainty.positions(q)
    off = X - beacon(q)
    return np.linalg.norm(off, axis=1), np.einsum("mi,mi->m", off, np.linalg.solve(C, off[:, :, None])[:, :, 0])


@pytest.mark.parametrize("views", [2, 4])
def test_errors_are_as_claimed_by_two_and_four_cameras(views: int) -> None:
    """With every fourth sight hidden; the more cameras, the more readings count, and the smaller the errors."""
    world = camera_ring.ring(views)
    rig = setup_of(world).rig
    off, squares, used, sigma = [], [], [], []
    for seed in range(7):
        seen = sweeps(world, rig, seed, 2)
        found = identify(seen, rig=rig)
        assert [joint.type for joint in found.joints] == ["revolute"] * 3
        sigma.append(found.sigma)
        used.append(len(seen) / (3 * N))
        for all_of, one in zip((off, squares), misses(found, seed), strict=True):
            all_of.append(one)
    assert 0.75 < np.mean(squares) / 3.0 < 1.3
    assert 0.93 * SIGMA_PX < np.sqrt(np.mean(np.square(sigma))) < 1.07 * SIGMA_PX
    assert np.mean(used) > {2: 0.5, 4: 0.9}[views]
    assert np.median(off) < {2: 4e-4, 4: 1.6e-4}[views]


def test_readings_of_one_camera_count_where_their_place_is_said() -> None:
    """Each has two equations and one unknown: by all of them the arm is known better, and as claimed."""
    world = camera_ring.ring(3)
    rig = setup_of(world).rig
    claims, squares = [], []
    for seed in range(4):
        for fewest in (2, 1):
            seen = sweeps(world, rig, seed, fewest)
            found = identify(seen, rig=rig)
            assert found.uncertainty is not None
            claims.append(float(np.trace(found.uncertainty.positions(np.zeros((1, 3)))[1][0])))
        squares.append(misses(found, seed)[1])
    one, two = np.array(claims).reshape(-1, 2).T[::-1]
    assert (one < two).all() and 0.6 < np.mean(squares) / 3.0 < 1.5


def test_a_sweep_is_written_and_read_with_its_cameras_in_any_order(tmp_path: Path) -> None:
    world = camera_ring.ring(3)
    rig = setup_of(world).rig
    seen = sweeps(world, rig, 1, 1)
    write_sweeps(tmp_path / "sweep.csv", seen)
    again = read_sweeps(tmp_path / "sweep.csv")
    assert again.cameras == rig.names and seen.uv_px is not None
    np.testing.assert_array_equal(again.uv_px, seen.uv_px)
    turned = replace(seen, uv_px=seen.uv_px[:, ::-1], cameras=rig.names[::-1])
    np.testing.assert_array_equal(identify(turned, rig=rig).beacon_m, identify(again, rig=rig).beacon_m)
    unknown = replace(seen, cameras=("c0", "c1", "top"))
    with refuses(UsageError, "top", "c0, c1, c2"):
        identify(unknown, rig=rig)
    with refuses(UsageError, "one camera", "two cameras"):
        identify(replace(seen, uv_px=seen.uv_px[:, :1], cameras=("c0",)), rig=rig.only("c0"))


def one_light(world: camera_ring.Ring, place: Array, beside: dict[int, Array], hidden: tuple[int, ...]) -> list[Spots]:
    """Spots of a light by camera, with others beside it, and none of it where it is hidden."""
    uv = world.pixels(place[None])[0]
    out = []
    for s in range(len(world)):
        own = ([] if s in hidden else [uv[s]]) + ([beside[s]] if s in beside else [])
        out.append(Spots.of_centres(np.array(own).reshape(-1, 2), 0.01 * np.eye(2)) if own else Spots.none())
    return out


def test_one_light_is_placed_by_the_cameras_that_show_it() -> None:
    world = camera_ring.ring(4)
    setup = setup_of(world, np.zeros((1, 3)))
    place = np.array([0.05, -0.03, 1.3])
    for hidden, beside in (((), {}), ((1,), {1: np.array([300.0, 200.0])}), ((0, 3), {}), ((), {2: np.zeros(2) + 90})):
        found = measure_chosen(setup, 0.0, one_light(world, place, beside, hidden))
        assert found.pose.status is PoseStatus.POSITION_ONLY and found.sights is not None
        assert np.abs(found.points.xyz_m[0] - place).max() < 1e-5
        assert np.flatnonzero(~found.sights[0]).tolist() == list(hidden)
    alone = measure_light(setup, 0.0, one_light(world, place, {}, (0, 1, 2)))
    assert alone.pose.status is PoseStatus.LOST and "no two cameras" in alone.pose.why
    two = [
        Spots.of_centres(world.pixels(np.array([place, place + np.array([0.06, 0.02, 0.0])]))[:, s], 0.01 * np.eye(2))
        for s in range(4)
    ]
    assert "ambiguous" in measure_light(setup, 0.0, two).pose.why
