"""A lit target's geometry against an independent world (OpenCV's projection): truth, standard deviations, refusals by
name."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import RigidTransform, Rotation
from scipy.stats import chi2 as chi2_law

from armsight.calibrate.light_target import LitFrame, LitMoment, TargetResult, calibrate_target
from armsight.errors import Ambiguous, Degenerate, Inconsistent, NotEnoughData, UsageError
from armsight.ops.calibration.spots_of_frames import lights_of_pairs
from armsight.optics import RIG_PARAMETERS, Camera, Rig, converged_rig
from armsight.optics.parallelism import moved_rig
from armsight.records import NamedCovariance, Spots
from armsight.units import DEG, MM
from refusals import refuses

CAMERA = Camera.pinhole(1280, 720, 1131.0, 1127.0, 643.5, 352.25, distortion=(-0.28, 0.09, 8e-4, -5e-4, -0.012))
RIG = converged_rig(CAMERA, CAMERA, 0.12, 0.08, -0.08)
SIGMA_PX = 0.05

# A left, B lower right, C upper right of the camera (x right, y down): the frame's x is u, its z is w
SCALENE = np.array([[-0.045, 0.0, 0.0], [0.03, 0.03, 0.0], [0.015, -0.03, 0.0]])
ISOSCELES = np.array([[-0.05, 0.0, 0.0], [0.025, 0.03, 0.0], [0.025, -0.03, 0.0]])
EQUILATERAL = 0.045 * np.array([[-1.0, 0.0, 0.0], [0.5, np.sqrt(0.75), 0.0], [0.5, -np.sqrt(0.75), 0.0]])
LINE = np.array([[-0.05, 0.0, 0.0], [0.01, 0.0, 0.0], [0.05, 0.0, 0.0]])


def frame_axes(X: np.ndarray) -> np.ndarray:
    """Lights in Pachidis's frame, written once more from eqs. (7)-(8)."""
    G = (X[0] + X[1] + X[2]) / 3.0
    u = (G - X[0]) / np.linalg.norm(G - X[0])
    w = np.cross(X[1] - G, X[0] - G)
    w /= np.linalg.norm(w)
    return (X - G) @ np.array([u, np.cross(w, u), w]).T


def look(points: np.ndarray, rig: Rig = RIG) -> list[np.ndarray]:
    return [
        cv2.projectPoints(
            np.ascontiguousarray(points), T.rotation.as_rotvec(), T.translation, camera.matrix, camera.distortion
        )[0][:, 0]
        for camera, T in ((rig.left, rig.T_rig_left.inv()), (rig.right, rig.T_rig_right.inv()))
    ]


def spots(uv: np.ndarray, sigma_px: float) -> Spots:
    n = len(uv)
    return Spots(
        uv_px=uv,
        covariance_px2=np.tile(sigma_px**2 * np.eye(2), (n, 1, 1)),
        peak=np.full(n, 100.0),
        size_px=np.full(n, 2.0),
        model=("gaussian",) * n,
    )


def poses(rng: np.random.Generator, n: int, tilt_deg: float = 25.0) -> list[RigidTransform]:
    return [
        RigidTransform.from_components(
            rng.uniform([-0.1, -0.08, 0.5], [0.1, 0.08, 0.7]),
            Rotation.from_rotvec(rng.normal(0, tilt_deg * DEG / 1.7, 3)),
        )
        for _ in range(n)
    ]


def see(
    points: np.ndarray, name: str, rng: np.random.Generator, sigma_px: float = SIGMA_PX, rig: Rig = RIG
) -> LitFrame:
    """A frame of points in rig axes, the pairs in an order of its own."""
    order = rng.permutation(len(points))
    left, right = (spots((uv + rng.normal(0, sigma_px, uv.shape))[order], sigma_px) for uv in look(points, rig))
    return LitFrame(name=name, left=left, right=right)


def recording(
    X: np.ndarray, rng: np.random.Generator, n: int = 12, *, sigma_px: float = SIGMA_PX, rig: Rig = RIG
) -> list[LitFrame]:
    return [see(T.apply(X), f"frame {i}", rng, sigma_px, rig) for i, T in enumerate(poses(rng, n))]


def free_chi2(done: TargetResult, truth: np.ndarray) -> tuple[float, int]:
    """Whitened squared error in the directions that the frame's convention leaves free."""
    values, vectors = np.linalg.eigh(done.covariance.matrix)
    free = values > 1e-9 * values.max()
    e = vectors[:, free].T @ (done.xyz_m - truth).ravel()
    return float((e**2 / values[free]).sum()), int(free.sum())


def test_exact_spots_give_the_exact_shape_in_pachidis_frame() -> None:
    done = calibrate_target(RIG, recording(SCALENE, np.random.default_rng(1), sigma_px=1e-6))
    np.testing.assert_allclose(done.xyz_m, frame_axes(SCALENE), atol=2e-9)
    assert done.names == ("A", "B", "C") and done.n_used == 12 and not done.rejected
    assert done.loo_rms_px < 1e-4


@pytest.mark.parametrize("shape", [SCALENE, ISOSCELES], ids=["scalene", "isosceles"])
def test_errors_are_as_large_as_the_deviations_say(shape: np.ndarray) -> None:
    total = dof = 0.0
    for seed in range(15):
        done = calibrate_target(RIG, recording(shape, np.random.default_rng([7, seed])))
        chi2, free = free_chi2(done, frame_axes(shape))
        total, dof = total + chi2, dof + free
    assert dof == 45
    assert chi2_law.ppf(1e-4, dof) < total < chi2_law.isf(1e-4, dof)


def test_errors_of_the_rig_enter_the_deviations() -> None:
    sigma = np.zeros(len(RIG_PARAMETERS))
    sigma[[RIG_PARAMETERS.index(name) for name in ("left.fx", "right.fx", "right.tx", "right.ry")]] = (
        1.0,
        1.0,
        2e-4,
        5e-4,
    )
    given = Rig(
        kind=RIG.kind,
        left=RIG.left,
        right=RIG.right,
        T_rig_left=RIG.T_rig_left,
        T_rig_right=RIG.T_rig_right,
        covariance=NamedCovariance(names=RIG_PARAMETERS, matrix=np.diag(sigma**2)),
    )
    total = dof = without = 0.0
    for seed in range(15):
        rng = np.random.default_rng([8, seed])
        true = moved_rig(RIG, rng.normal(0.0, sigma))
        frames = recording(SCALENE, rng, rig=true)
        done = calibrate_target(given, frames)
        assert done.rig_share is not None and done.rig_share > 0.7
        chi2, free = free_chi2(done, frame_axes(SCALENE))
        total, dof = total + chi2, dof + free
        without += free_chi2(calibrate_target(RIG, frames), frame_axes(SCALENE))[0]
    assert chi2_law.ppf(1e-4, dof) < total < chi2_law.isf(1e-4, dof)
    assert without > chi2_law.isf(1e-6, dof)  # the rig taken as exact claims too much


def test_spots_worse_than_they_say_widen_the_deviations() -> None:
    total = dof = 0.0
    for seed in range(12):
        frames = recording(SCALENE, np.random.default_rng([9, seed]), sigma_px=0.2)
        claimed = [replace(f, left=spots(f.left.uv_px, 0.05), right=spots(f.right.uv_px, 0.05)) for f in frames]
        chi2, free = free_chi2(calibrate_target(RIG, claimed), frame_axes(SCALENE))
        total, dof = total + chi2, dof + free
    assert chi2_law.ppf(1e-4, dof) < total < chi2_law.isf(1e-4, dof)


def test_left_out_residuals_are_those_of_a_shape_fitted_without_the_frame() -> None:
    frames = recording(SCALENE, np.random.default_rng(3), 6)
    done = calibrate_target(RIG, frames)
    assert done.loo_rms_px > done.residual_rms_px
    own, other = (np.sort(r[0].ravel()) for r in (done.residual_px, done.left_out_px))
    shape = calibrate_target(RIG, frames[1:]).xyz_m
    T = poses(np.random.default_rng(3), 6)[0]
    seen = np.stack([frames[0].left.uv_px, frames[0].right.uv_px])
    order = [int(np.argmin(np.linalg.norm(seen[0] - uv, axis=1))) for uv in look(T.apply(SCALENE))[0]]

    def residuals(p: np.ndarray) -> np.ndarray:
        moved = RigidTransform.from_components(p[:3], Rotation.from_rotvec(p[3:]))
        return (np.stack(look(moved.apply(shape))) - seen[:, order]).ravel() / SIGMA_PX

    T = T * RigidTransform.from_translation(SCALENE.mean(axis=0))
    fit = least_squares(residuals, np.concatenate([T.translation, T.rotation.as_rotvec()]), xtol=1e-14, ftol=1e-14)
    expected = np.sort(fit.fun * SIGMA_PX)
    assert np.abs(own - other).max() > 0.1 * SIGMA_PX  # leaving it out makes a difference, and the right one:
    np.testing.assert_allclose(other, expected, atol=0.03 * SIGMA_PX)


@pytest.mark.parametrize("n", [4, 5, 6])
def test_more_lights_in_space(n: int) -> None:
    X = np.vstack([SCALENE, [[0.0, 0.045, 0.02], [-0.03, -0.04, -0.015], [0.05, 0.0, 0.03]]])[:n]
    frames = recording(X, np.random.default_rng([5, n]), 8)
    done = calibrate_target(RIG, frames, lights=n)
    lengths = np.linalg.norm(X[:, None] - X[None], axis=-1)[np.triu_indices(n, 1)]
    np.testing.assert_allclose(
        np.sort([d.value_m for d in done.distances_m.values()]), np.sort(lengths), atol=6 * max(done.std_m.max(), 1e-6)
    )
    assert done.n_used == 8 and done.names == tuple("ABCDEF"[:n])
    # one rigid body: not its mirror image
    T = np.linalg.det(done.xyz_m[1:4] - done.xyz_m[0])
    order = [int(np.argmin(np.abs(np.sort(_to_others(done.xyz_m)[i]) - np.sort(_to_others(X), axis=1)).max(axis=1)))
             for i in range(4)]  # fmt: skip
    assert np.sign(T) == np.sign(np.linalg.det(X[order[1:]] - X[order[0]]))


def _to_others(X: np.ndarray) -> np.ndarray:
    return np.linalg.norm(X[:, None] - X[None], axis=-1)


def test_two_lights_give_their_distance() -> None:
    X = np.array([[-0.04, 0.0, 0.0], [0.04, 0.0, 0.0]])
    errors = []
    for seed in range(25):
        done = calibrate_target(RIG, recording(X, np.random.default_rng([6, seed])), lights=2)
        d = done.distances_m["AB"]
        errors.append((d.value_m - 0.08) / d.std_m)
    assert chi2_law.ppf(1e-4, 25) < np.square(errors).sum() < chi2_law.isf(1e-4, 25)
    assert any("two lights" in text for text in done.advice)


def test_wrong_frames_are_named_and_left_out() -> None:
    rng = np.random.default_rng(11)
    frames = recording(SCALENE, rng, 12)
    reflection = SCALENE.copy()
    reflection[1] += [0.012, 0.009, 0.02]
    slight = SCALENE.copy()
    slight[2] += [0.0, 0.0012, 0.0]
    shown = iter(poses(rng, 9))
    frames[2] = see(next(shown).apply(reflection), "reflection", rng)
    frames[5] = see(next(shown).apply(slight), "slight", rng)
    frames[7] = see(next(shown).apply(SCALENE[:2]), "hidden", rng)
    frames[9] = see(next(shown).apply(SCALENE * [1.0, -1.0, 1.0]), "mirror", rng)
    done = calibrate_target(RIG, frames)
    why = dict(done.rejected)
    assert set(why) == {"reflection", "slight", "hidden", "mirror"}
    assert "differ by" in why["reflection"] and "2 of 3 lights" in why["hidden"] and "mirror" in why["mirror"]
    assert "frame 2" not in done.used and done.n_used == 8 and done.n_frames == 12
    assert free_chi2(done, frame_axes(SCALENE))[0] < chi2_law.isf(1e-4, 3)


def test_clutter_beside_the_lights_is_not_taken_for_them() -> None:
    rng = np.random.default_rng(12)
    lamp = np.array([[0.15, -0.1, 0.9], [-0.2, 0.1, 0.85]])
    frames = [see(np.vstack([T.apply(SCALENE), lamp]), str(i), rng) for i, T in enumerate(poses(rng, 10))]
    done = calibrate_target(RIG, frames)
    assert done.n_used == 10 and free_chi2(done, frame_axes(SCALENE))[0] < chi2_law.isf(1e-4, 3)


def test_many_dim_things_of_a_room_are_not_searched_for_the_lights() -> None:
    rng = np.random.default_rng(19)
    frames = []
    for i, T in enumerate(poses(rng, 8)):
        room = rng.uniform([-0.2, -0.15, 0.6], [0.2, 0.15, 1.2], (20, 3))  # none stands still
        seen = see(np.vstack([room, T.apply(SCALENE)]), str(i), np.random.default_rng(i))
        lit = np.random.default_rng(i).permutation(23) >= 20
        peak = np.where(lit, 100.0, rng.uniform(5.0, 60.0, 23))
        views = (replace(view, peak=peak) for view in (seen.left, seen.right))
        frames.append(LitFrame(name=str(i), left=next(views), right=next(views)))
    done = calibrate_target(RIG, frames)
    assert done.n_used == 8 and free_chi2(done, frame_axes(SCALENE))[0] < chi2_law.isf(1e-4, 3)


def test_a_spot_on_two_epipolar_lines_is_used_once() -> None:
    rng = np.random.default_rng(13)
    frames = []
    for frame in recording(SCALENE, rng, 8):
        left, right = [0, 1, 2, 0, 1], [0, 1, 2, 1, 0]  # also A with B's image, and B with A's
        frames.append(LitFrame(name=frame.name, left=frame.left.take(left), right=frame.right.take(right)))
    done = calibrate_target(RIG, frames)
    assert done.n_used == 8 and free_chi2(done, frame_axes(SCALENE))[0] < chi2_law.isf(1e-4, 3)


def test_equilateral_target_is_three_fold_ambiguous() -> None:
    with refuses(Ambiguous, "3-fold") as refusal:
        calibrate_target(RIG, recording(EQUILATERAL, np.random.default_rng(14)))
    assert "isosceles" in refusal.value.cure


def test_nearly_equilateral_target_is_named_where_the_frames_allow() -> None:
    X = EQUILATERAL * [[1.0, 1.0, 1.0], [1.03, 1.03, 1.0], [1.0, 1.0, 1.0]]
    total = 0.0
    for seed in range(10):
        done = calibrate_target(RIG, recording(X, np.random.default_rng([22, seed])))
        assert done.n_used >= 8 and all("told apart" in why for _, why in done.rejected)
        total += min(free_chi2(done, frame_axes(X[np.roll(range(3), k)]))[0] for k in range(3))
    assert total < chi2_law.isf(1e-4, 30)


def test_lights_on_a_line_tell_only_their_distances() -> None:
    with refuses(Degenerate, "distances", "AB") as refusal:
        calibrate_target(RIG, recording(LINE, np.random.default_rng(15)))
    assert "line" in refusal.value.cure


def test_target_that_bends_a_little_is_not_rigid() -> None:
    rng = np.random.default_rng(17)
    frames = [
        see(T.apply(SCALENE + rng.normal(0, 0.3 * MM, (3, 3))), str(i), rng) for i, T in enumerate(poses(rng, 12))
    ]
    with refuses(Inconsistent, "rigid"):
        calibrate_target(RIG, frames)


def test_target_shown_from_both_sides_leaves_the_sense_of_w_open() -> None:
    rng = np.random.default_rng(18)
    sides = [SCALENE, SCALENE * [1.0, -1.0, 1.0]]
    frames = [see(T.apply(sides[i % 2]), str(i), rng) for i, T in enumerate(poses(rng, 12))]
    with refuses(Ambiguous, "6 frames", "round"):
        calibrate_target(RIG, frames)


def test_exchanged_views_are_refused() -> None:
    frames = recording(SCALENE, np.random.default_rng(23))
    with pytest.raises(Inconsistent) as refusal:
        calibrate_target(RIG, [LitFrame(name=f.name, left=f.right, right=f.left) for f in frames])
    assert "left one" in refusal.value.cure


def test_exchanged_views_that_meet_far_away_are_refused() -> None:
    """Of cameras toed in by 5 degrees the exchanged views of lights at one distance make lights ten times as large."""
    rng = np.random.default_rng(3)
    rig = converged_rig(CAMERA, CAMERA, 0.12, 0.0, -0.0873)
    moments = []
    for i in range(40):
        T = RigidTransform.from_components(
            rng.uniform([-0.1, -0.08, 0.74], [0.1, 0.08, 0.76]), Rotation.from_rotvec(rng.normal(0.0, 0.15, 3))
        )
        moments.append(LitMoment(name=str(i), views=tuple(spots(uv, 0.1) for uv in look(T.apply(ISOSCELES), rig))))
    assert lights_of_pairs(rig, moments, 3, overlaid=False).residual_px.max() < 1.0
    with refuses(Inconsistent, "swapped"):
        lights_of_pairs(rig, [replace(one, views=one.views[::-1]) for one in moments], 3, overlaid=False)


def test_too_little_is_refused() -> None:
    frames = recording(SCALENE, np.random.default_rng(19), 2)
    with refuses(NotEnoughData, "2 of 2"):
        calibrate_target(RIG, frames)
    with refuses(NotEnoughData, "0 of 2", "3 of 4"):
        calibrate_target(RIG, frames, lights=4)
    with pytest.raises(UsageError, match="7 lights"):
        calibrate_target(RIG, frames, lights=7)
    with refuses(Inconsistent, "no pairs"):
        LitFrame(name="odd", left=frames[0].left, right=frames[0].right.take([0]))


def test_a_target_that_stands_still_is_not_told_from_the_lamps_of_a_room() -> None:
    rng = np.random.default_rng(21)
    lamps = np.array([[-0.5, -0.3, 1.6], [0.4, -0.35, 1.9], [0.1, 0.3, 1.4]])
    still = RigidTransform.from_components([0.02, 0.01, 0.6], Rotation.from_rotvec([0.1, 0.2, 0.0]))
    frames = [see(np.vstack([still.apply(SCALENE), lamps]), str(i), rng) for i in range(6)]
    with refuses(NotEnoughData, "still"):
        calibrate_target(RIG, frames, lights=6)


def test_advice_says_what_is_missing() -> None:
    rng = np.random.default_rng(20)
    frames = [see(T.apply(SCALENE), str(i), rng) for i, T in enumerate(poses(rng, 5, tilt_deg=3.0))]
    done = calibrate_target(RIG, frames)
    said = " ".join(done.advice)
    assert "5 frames" in said and "tilted by" in said and "no covariance" in said
