"""Some cameras round a place, of which never all see the board: errors against claims and bounds, delays, refusals."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from armsight.calibrate.cameras import BoardOptions
from armsight.calibrate.cameras.bundle_adjustment import Bundle, problem_of
from armsight.calibrate.cameras.many import ManySolved, extend_rig, moments_of, solve_cameras
from armsight.calibrate.cameras.many_result import rig_of
from armsight.calibrate.cameras.pairing import as_pose, in_frame
from armsight.calibrate.cameras.preconditions import KnownLens
from armsight.errors import Inconsistent, NotEnoughData
from armsight.optics import Camera, Rig
from armsight.records import NamedCovariance
from refusals import refuses

sys.path.insert(0, str(Path(__file__).parent))
from ring_of_cameras import BOARD, NAMES, SIZE, Ring, matrix, moved, off, ring, rolled, seen_from, views, visible, waved

C = ("a", "b", "c", "d")
SIGMA_PX = 0.1
AXES = np.array([0.3, -0.2, 0.5, 0.4, 0.1, -0.3])
FREE = BoardOptions(folds=0, fixed=frozenset(), automatic_k3=False)
PLAIN = BoardOptions(folds=0)


@pytest.fixture(scope="module")
def four() -> Ring:
    return ring(np.random.default_rng(7))


def known(of: Ring, c: int, covariance: NamedCovariance | None = None) -> KnownLens:
    return KnownLens(camera=Camera(width=SIZE[0], height=SIZE[1], intrinsics=of.k[c]), covariance=covariance)


def held(of: Ring) -> dict[str, KnownLens]:
    return {name: known(of, c) for c, name in enumerate(C[: len(of.k)])}


def noisy(of: Ring, seed: int) -> np.ndarray:
    clean = of.uv()
    return clean + np.random.default_rng(seed).normal(0.0, SIGMA_PX, clean.shape)


def errors(done: ManySolved, true: Ring) -> np.ndarray:
    sides = [off(matrix(found), T) for found, T in zip(done.state.sides, true.T[1:], strict=True)]
    return np.r_[(done.state.k - true.k).ravel(), np.ravel(sides)]


def test_all_58_numbers_reach_the_bound_and_claim_what_they_reach(four: Ring) -> None:
    bound, names, own, chi2 = four.bound(SIGMA_PX), tuple(four.names(C)), [], []
    assert not four.seen.all(axis=1).any()
    for seed in range(4):
        done = solve_cameras(views(noisy(four, seed), C, SIGMA_PX), BOARD, FREE)
        e = errors(done, four)
        claimed = done.covariance.block(names)
        own.append(e**2 / np.diag(bound))
        chi2.append(e @ np.linalg.solve(claimed, e))
        np.testing.assert_allclose(np.sqrt(np.diag(claimed) / np.diag(bound)), 1.0, atol=0.05)
    # four chi-squares of 58 degrees of freedom: 58 +- 5.4; what is strongly correlated leaves fewer in the other
    assert np.mean(chi2) == pytest.approx(58.0, abs=17.0)
    assert np.sqrt(np.mean(own)) == pytest.approx(1.0, abs=0.35)


def test_lenses_known_before_move_within_their_doubt_and_the_middle_of_the_picture_is_enough(four: Ring) -> None:
    """Boards in the middle only: unknown lenses are refused for it, known ones are not, and come out surer.

    The first camera stands in the middle, and the outer ones are reached over later ones.
    """
    four = seen_from(four, [2, 0, 3, 1])
    std = np.array([2.0, 2.0, 2.0, 2.0, 0.1, 0.005, 0.01, 2e-4, 2e-4, 0.01])
    doubt = NamedCovariance(names=NAMES, matrix=np.diag(std**2))
    chi2 = []
    for seed in range(4):
        rng = np.random.default_rng(40 + seed)
        uv = noisy(four, seed)
        uv[(np.abs(uv - np.array(SIZE) / 2) > [310.0, 175.0]).any(axis=(2, 3))] = np.nan
        lenses = {}
        for c, name in enumerate(C):
            told = replace(four, k=four.k + rng.normal(size=four.k.shape) * std)
            lenses[name] = known(told, c, doubt)
        done = solve_cameras(views(uv, C, SIGMA_PX), BOARD, PLAIN, lenses=lenses)
        e = errors(done, four)
        chi2.append(e @ np.linalg.solve(done.covariance.block(tuple(four.names(C))), e))
        assert all(done.covariance.std()[f"{name}.fx"] < 2.0 for name in C)
        assert not any("exact" in one for one in done.advice)
    assert np.mean(chi2) == pytest.approx(58.0, abs=17.0)
    other = {**lenses, "b": known(replace(four, k=four.k * 1.05), 1, doubt)}
    with refuses(Inconsistent, "b"):
        solve_cameras(views(uv, C, SIGMA_PX), BOARD, PLAIN, lenses=other)


def test_delays_are_found_from_the_boards_motion_within_what_they_claim(four: Ring) -> None:
    film, at = waved(four)
    late = np.array([0.0, 0.060, -0.050, 0.015])
    # a clock that is late by d shows t - d at the true time t: the image stamped t is of t + d
    clean = film.uv(late, at)
    uv = clean + np.random.default_rng(3).normal(0.0, 0.3, clean.shape)
    stamps = {name: [0.1 * g for g in range(len(film.boards))] for name in C}
    done = solve_cameras(views(uv, C, 0.3), BOARD, PLAIN, lenses=held(film), times_s=stamps)
    std = np.array([done.covariance.std()[f"{name}.delay"] for name in C[1:]])
    assert (std < 2e-3).all()
    assert (np.abs(done.delays_s[1:] - late[1:]) < 3.5 * std + 2e-4).all()
    still = solve_cameras(views(uv, C, 0.3), BOARD, PLAIN, lenses=held(film))
    assert done.robust.fit.scale < 1.2 < still.robust.fit.scale
    assert any("exact" in one and "a, b, c, d" in one for one in done.advice)
    places = np.linalg.norm([off(matrix(found), T)[:3] for found, T in zip(done.state.sides, film.T[1:], strict=True)])
    assert places < 2e-3


def test_read_outs_are_found_beside_the_delays_within_what_they_claim(four: Ring) -> None:
    film, at = waved(four)
    late, took = np.array([0.0, 0.060, -0.050, 0.015]), np.array([0.016, 0.0, 0.030, 0.010])
    clean = rolled(film, at, late, took)
    uv = clean + np.random.default_rng(3).normal(0.0, 0.3, clean.shape)
    stamps = {name: [0.1 * g for g in range(len(film.boards))] for name in C}
    done = solve_cameras(views(uv, C, 0.3), BOARD, PLAIN, lenses=held(film), times_s=stamps)
    claimed = done.covariance.std()
    found = np.r_[done.delays_s[1:] - late[1:], done.readouts_s - took]
    std = np.array([claimed[f"{name}.delay"] for name in C[1:]] + [claimed[f"{name}.readout"] for name in C])
    assert (std < 3e-3).all()
    assert (np.abs(found) < 3.5 * std + 2e-4).all()
    assert done.robust.fit.scale < 1.1
    places = np.array([off(matrix(pose), T)[:3] for pose, T in zip(done.state.sides, film.T[1:], strict=True)])
    doubt = np.array([[claimed[f"{name}.t{axis}"] for axis in "xyz"] for name in C[1:]])
    assert (np.abs(places) < 4.0 * doubt).all()
    at_once = film.uv(late, at) + np.random.default_rng(3).normal(0.0, 0.3, clean.shape)
    assert not solve_cameras(views(at_once, C, 0.3), BOARD, PLAIN, lenses=held(film), times_s=stamps).readouts_s.any()


def test_delays_of_boards_held_still_are_held_at_zero(four: Ring) -> None:
    stamps = {name: [3.0 * g + 0.01 * c for g in range(len(four.boards))] for c, name in enumerate(C)}
    done = solve_cameras(views(noisy(four, 5), C, SIGMA_PX), BOARD, PLAIN, lenses=held(four), times_s=stamps)
    assert not done.delays_s.any()
    assert any("zero" in text for text in done.advice)


def test_normal_equations_of_a_moving_board_are_those_of_the_finite_differences(four: Ring) -> None:
    film, at = waved(four, 9, 1.0)
    late = np.array([0.0, 0.03, -0.05, 0.02])
    stamps = {name: [1.0 * g for g in range(9)] for name in C}
    seen, _ = moments_of(views(film.uv(late, at), C, 1.0), BOARD, PLAIN, {}, stamps)
    kept = film.seen.any(axis=1)
    boards = [np.r_[T[:3, 3] + T[:3, :3] @ seen.middle, cv2.Rodrigues(T[:3, :3])[0].ravel()] for T in film.boards[kept]]
    sides = np.array([np.r_[T[:3, 3], cv2.Rodrigues(T[:3, :3])[0].ravel()] for T in film.T[1:]])
    start = Bundle(k=film.k, sides=sides, poses=np.array(boards), delays_s=0.5 * late[1:])
    problem = problem_of(seen, start, frozenset())
    here = problem.evaluate(problem.guess, problem.local_guess)
    normal = here.condensed
    assert normal is not None
    n, L = len(problem.guess), problem.local_guess.shape
    step = np.r_[np.tile([1e-3] * 5 + [1e-6] * 5, 4), [1e-6] * 18, [1e-6] * 3]

    def residuals(by: np.ndarray, local: np.ndarray) -> np.ndarray:
        return problem.evaluate(*problem.retract(problem.guess, problem.local_guess, by, local)).residuals.ravel()

    J = np.array(
        [
            (residuals(h, np.zeros(L)) - residuals(-h, np.zeros(L))) / (2 * s)
            for s, h in zip(step, np.diag(step), strict=True)
        ]
    )
    np.testing.assert_allclose(normal.A, J @ J.T, rtol=2e-4, atol=1e-6 * np.abs(np.diag(J @ J.T)).max() ** 0.5)
    np.testing.assert_allclose(
        normal.b, J @ here.residuals.ravel(), rtol=1e-3, atol=1e-2 * np.abs(normal.b).min() + 1e-3
    )
    local = np.array(
        [
            (residuals(np.zeros(n), h.reshape(L)) - residuals(np.zeros(n), -h.reshape(L))) / 2e-6
            for h in 1e-6 * np.eye(L[0] * L[1])
        ]
    )
    for s in range(L[0]):
        own = local[s * L[1] : (s + 1) * L[1]]
        used = np.abs(own).sum(axis=1) > 0.0
        np.testing.assert_allclose(
            normal.C[s][np.ix_(used, used)], (own @ own.T)[np.ix_(used, used)], rtol=1e-3, atol=10.0
        )
        np.testing.assert_allclose(normal.W[s][-3:][:, used], (J[-3:] @ own.T)[:, used], rtol=1e-3, atol=10.0)


# one more camera, and one again


@pytest.fixture(scope="module")
def standing(four: Ring) -> Rig:
    """The four as a rig whose axes are no camera's."""
    done = solve_cameras(views(noisy(four, 11), C, SIGMA_PX), BOARD, FREE)
    return in_frame(rig_of(done, 0.1), as_pose(AXES))


@pytest.mark.parametrize("name", ["e", "c", "a"])
def test_a_camera_beside_a_rig_is_placed_within_its_claim_and_the_others_stay(
    four: Ring, standing: Rig, name: str
) -> None:
    """e: a fifth one. c, a: knocked ones, placed anew with the lens that they had; a is the first."""
    if name == "e":
        five = ring(np.random.default_rng(13), 5, 40)
        fifth = four.T[3] @ np.linalg.inv(five.T[3]) @ five.T[4]
        true = replace(five, k=np.r_[four.k, five.k[4:]], T=np.r_[four.T, fifth[None]])
    else:
        knocked = moved(four.T[C.index(name)], np.r_[0.05, -0.02, 0.03, 0.05, -0.04, 0.02])
        true = replace(four, T=np.array([knocked if one == name else T for one, T in zip(C, four.T, strict=True)]))
    names = (*C, "e")[: len(true.k)]
    true = replace(true, seen=np.array([visible(true.k, true.T, board) for board in true.boards]))
    uv = true.uv() + np.random.default_rng(17).normal(0.0, SIGMA_PX, (*true.seen.shape, 54, 2))
    done, whole = extend_rig(standing, name, views(uv, names, SIGMA_PX), BOARD, FREE)
    assert done.rejected == ()
    assert whole.names == names
    for one in standing.cameras:
        assert one.name == name or whole.cameras[names.index(one.name)] is one
    # what the whole rig claims of all its cameras, each in axes of the first one as it is now
    first = true.T[0]
    poses = [(whole.T_rig_camera("a").inv() * one.T_rig_camera).as_matrix() for one in whole.cameras]
    turned = in_frame(whole, whole.T_rig_camera("a").inv())
    e = np.r_[
        np.ravel([one.camera.intrinsics - k for one, k in zip(whole.cameras, true.k, strict=True)]),
        np.ravel([off(pose, np.linalg.inv(first) @ T) for pose, T in zip(poses[1:], true.T[1:], strict=True)]),
    ]
    assert turned.covariance is not None
    block = tuple(true.names(names))
    at = [i for i, one in enumerate(block) if one.startswith(f"{name}.")]
    for used in (np.arange(len(block)), np.array(at)):
        chi2 = e[used] @ np.linalg.solve(turned.covariance.block(tuple(block[i] for i in used)), e[used])
        assert abs(chi2 - len(used)) < 3.3 * np.sqrt(2.0 * len(used))


def test_a_rig_that_is_no_longer_so_is_not_built_on_until_it_is_mended(four: Ring, standing: Rig) -> None:
    b = moved(four.T[1], np.r_[0, 0, 0, 0, 0.02, 0])
    knocked = replace(four, T=np.array([b if c == 1 else T for c, T in enumerate(four.T)]))
    seen = views(noisy(knocked, 19), C, SIGMA_PX)
    with refuses(Inconsistent, "--again b"):
        extend_rig(standing, "d", seen, BOARD, FREE)
    _, mended = extend_rig(standing, "b", seen, BOARD, FREE)
    assert extend_rig(mended, "d", seen, BOARD, FREE)[1].names == C


# what is refused


def test_groups_that_no_moment_connects_are_named(four: Ring) -> None:
    uv = noisy(four, 2)
    for g in range(len(uv)):  # a, b see nothing where c, d do
        uv[g, 2:] = np.nan if four.seen[g, :2].sum() > 1 else uv[g, 2:]
        uv[g, :2] = np.nan if four.seen[g, :2].sum() <= 1 else uv[g, :2]
    with refuses(NotEnoughData, "a, b; c, d"):
        solve_cameras(views(uv, C, SIGMA_PX), BOARD, PLAIN, lenses=held(four))


@pytest.mark.parametrize("late", [1, -1])
def test_a_list_a_moment_late_is_named(four: Ring, late: int) -> None:
    uv = noisy(four, 2)
    uv[:, 2] = np.roll(uv[:, 2], late, axis=0)
    with refuses(Inconsistent, "c", "1 later" if late > 0 else "1 earlier"):
        solve_cameras(views(uv, C, SIGMA_PX), BOARD, PLAIN, lenses=held(four))


def test_a_mirrored_camera_is_named(four: Ring) -> None:
    uv = noisy(four, 2)
    flip = np.arange(54).reshape(6, 9)[:, ::-1].ravel()  # as a detector numbers what it sees
    uv[:, 1] = uv[:, 1][:, flip] * [-1.0, 1.0] + [SIZE[0] - 1.0, 0.0]
    with refuses(Inconsistent, "b", "mirrored"):
        solve_cameras(views(uv, C, SIGMA_PX), BOARD, PLAIN, lenses=held(four))


def test_one_source_by_two_names_another_size_and_clocks_seconds_apart_are_named(four: Ring) -> None:
    uv = noisy(four, 2)
    two = views(uv, C, SIGMA_PX)
    with refuses(Inconsistent, "a and d"):
        solve_cameras({**two, "d": two["a"]}, BOARD, PLAIN, lenses=held(four))
    small = views(uv[:, 1:2] / 2.0, ("b",), SIGMA_PX, (640, 360))
    with refuses(Inconsistent, "b", "640x360"):
        solve_cameras({**two, **small}, BOARD, PLAIN, lenses=held(four))
    stamps = {name: [0.1 * g + (7.0 if name == "c" else 0.0) for g in range(len(uv))] for name in C}
    with refuses(Inconsistent, "c", "7.0 s"):
        solve_cameras(two, BOARD, PLAIN, lenses=held(four), times_s=stamps)
    again = {name: [0.1 * max(g, 1) for g in range(len(uv))] for name in C}
    with refuses(Inconsistent, "two images"):
        solve_cameras(two, BOARD, PLAIN, lenses=held(four), times_s=again)
