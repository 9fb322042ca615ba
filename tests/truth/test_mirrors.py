"""Mirror rigs: calibrated, checked and measured with, from rays traced surface by surface by the simulation."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.calibrate.light_target import calibrate_target
from armsight.calibrate.mirrors.calibration import MirrorCalibration, calibrate_mirrors
from armsight.calibrate.mirrors.diagnosis import adjust_to_parallel, check_alignment, mirrors_from_target
from armsight.errors import Degenerate, NotEnoughData
from armsight.geometry import align_points
from armsight.measure.poses.from_spots import measure_spots
from armsight.measure.poses.pipeline import Setup
from armsight.ops.calibration.spots_of_frames import lit_frame
from armsight.optics import Camera, PackedRig, Plate, Rig, RigKind, triangulate
from armsight.optics.mirrors import Mirrors as Design
from armsight.optics.mirrors import corrected_l, form_errors, plate_constants
from armsight.records import BoardView, PoseStatus, Spots, spot_target
from armsight.store import parse_board
from armsight_sim.lens import Lens
from armsight_sim.rigs import MirrorLens, Mirrors, mirror_views
from refusals import refuses

Array = NDArray[np.float64]
Tilts = tuple[tuple[float, float], ...]

WIDTH, HEIGHT = 1280, 960
UPRIGHT: Tilts = ((0.0, 0.0),) * 4
BOARD = parse_board("checkerboard:9x6:0.02")
SPOTS = {"A": (-0.04, 0.0, 0.0), "B": (0.03, 0.032, 0.0), "C": (0.03, -0.032, 0.0)}


def views_of(
    tilts: Tilts = UPRIGHT, *, plate_m: float = 1e-3, baseline_m: float = 0.1, plain: bool = False
) -> dict[str, MirrorLens]:
    """The two views of a lens with some distortion, or with none."""
    distortion = (0.0,) * 5 if plain else (0.05, -0.1, 5e-4, -3e-4, 0.0)
    lens = Lens(
        width=WIDTH, height=HEIGHT, focal_px=(1000.0, 1003.0), centre_px=(645.0, 470.0), distortion=distortion
    )  # fmt: skip
    return mirror_views(lens, Mirrors(baseline_m=baseline_m, plate_m=plate_m, tilts_rad=tilts))


def board_views(
    views: dict[str, MirrorLens], seed: int, count: int = 20, sigma: float = 0.05
) -> tuple[list[BoardView], list[BoardView]]:
    """Noisy pairs of views of a board that both paths show whole."""
    rng = np.random.default_rng(seed)
    X = BOARD.xyz_m - BOARD.xyz_m.mean(axis=0)
    out: dict[str, list[BoardView]] = {"left": [], "right": []}
    while len(out["left"]) < count:
        turn = Rotation.from_rotvec(rng.uniform(-0.5, 0.5, 3))
        P = turn.apply(X) + rng.uniform([-0.2, -0.17, 0.28], [0.2, 0.17, 0.75])
        seen = {side: view.project(P) for side, view in views.items()}
        if any(((uv < 5.0) | (uv > [WIDTH - 5, HEIGHT - 5])).any() for uv in seen.values()):
            continue
        for side, uv in seen.items():
            noisy = uv + rng.normal(0.0, sigma, uv.shape)
            out[side].append(
                BoardView(
                    uv_px=noisy,
                    index=np.arange(len(X)),
                    sigma_px=sigma,
                    width=WIDTH,
                    height=HEIGHT,
                    source=f"{side} {len(out[side])}",
                )
            )
    return out["left"], out["right"]


@pytest.fixture(scope="module")
def calibrated() -> MirrorCalibration:
    return calibrate_mirrors(*board_views(views_of(), 100, 25), BOARD)


def spots(uv: Array, sigma: float = 0.05) -> Spots:
    """Spots at pixels (n, 2)."""
    n = len(uv)
    return Spots(
        uv_px=uv, covariance_px2=np.tile(sigma**2 * np.eye(2), (n, 1, 1)), peak=np.full(n, 90.0),
        size_px=np.full(n, 2.0), model=("gaussian",) * n,
    )  # fmt: skip


def ideal_rig(views: dict[str, MirrorLens]) -> Rig:
    """The rig as designed, of the lens without distortion."""
    lens = views["left"]
    camera = Camera.pinhole(WIDTH, HEIGHT, *lens.focal_px, *lens.centre_px)
    return Design(baseline_m=lens.mirrors.baseline_m).rig(camera)


def test_the_rig_is_found_with_its_plate() -> None:
    seen = []
    for seed in range(4):
        done = calibrate_mirrors(*board_views(views_of(), seed), BOARD)
        assert done.one_lens and done.rig.kind is RigKind.MIRROR
        seen.append((done.seen_m - 1e-3) / done.seen_std_m)
        k = done.rig.right.intrinsics
        assert np.array_equal(k, done.rig.left.intrinsics)
        std = done.pair.std
        assert abs(k[0] - 1000.0) < 4.0 * std["left.fx_px"] and abs(k[2] - 645.0) < 4.0 * std["left.cx_px"]
        assert done.rig.T_rig_right.translation == pytest.approx([0.05, 0.0, -0.05], abs=3e-4)
    assert np.abs(seen).max() < 4.0 and np.std(seen) > 0.1


def test_points_are_as_good_as_the_pixels_allow(calibrated: MirrorCalibration) -> None:
    views, rng, sigma = views_of(), np.random.default_rng(1), 0.05
    X = rng.uniform([-0.1, -0.08, 0.4], [0.1, 0.08, 0.8], (400, 3))
    uv = [view.project(X) + rng.normal(0.0, sigma, (400, 2)) for view in views.values()]
    found = triangulate(calibrated.rig, uv[0], uv[1], sigma**2 * np.eye(2), sigma**2 * np.eye(2))
    laid = align_points(X, found.xyz_m).T_a_b.apply(found.xyz_m) - X
    d2 = np.einsum("mi,mij,mj->m", laid, np.linalg.inv(found.covariance_m2), laid)
    assert np.mean(d2) / 3.0 == pytest.approx(1.0, abs=0.25)  # calibration's own error included; 1,200 numbers


def test_views_of_two_lenses_are_told() -> None:
    left, right = board_views(views_of(), 5)
    middle = np.array([640.0, 480.0])
    other = [
        BoardView(
            uv_px=middle + 1.01 * (view.uv_px - middle), index=view.index, sigma_px=view.sigma_px, width=WIDTH,
            height=HEIGHT, source=view.source,
        )
        for view in right
    ]  # fmt: skip
    done = calibrate_mirrors(left, other, BOARD)
    assert not done.one_lens
    assert done.rig.right.intrinsics[0] == pytest.approx(1010.0, abs=1.5)
    assert any("one lens" in line for line in done.advice)


@pytest.mark.parametrize("mirror", range(4))
def test_the_turned_mirror_is_named_with_its_sense(calibrated: MirrorCalibration, mirror: int) -> None:
    rng = np.random.default_rng(mirror)
    size, way = rng.uniform(0.5e-3, 1e-2), rng.uniform(0.0, 2.0 * np.pi)
    tilts = [(0.0, 0.0)] * 4
    tilts[mirror] = (size * np.cos(way), size * np.sin(way))
    found = check_alignment(calibrated.rig, *board_views(views_of(tuple(tilts)), 20 + mirror, 5), BOARD)
    best = found.suspects[0]
    assert found.certain and best.mirror == mirror + 1
    assert (best.turn_rad, best.tilt_rad) == pytest.approx(tilts[mirror], abs=2e-4)
    assert f"mirror {mirror + 1}" in found.advice()


def test_mirrors_that_stand_still_are_left_alone(calibrated: MirrorCalibration) -> None:
    chi2 = []
    for seed in range(8):
        found = check_alignment(calibrated.rig, *board_views(views_of(), 40 + seed, 3), BOARD)
        chi2.append(found.chi2)
        assert not found.moved and "as they did" in found.advice()
    assert 2.0 < np.mean(chi2) < 12.0  # six numbers; the calibration's own error is in all of them


def test_two_turned_mirrors_are_more_than_one(calibrated: MirrorCalibration) -> None:
    tilts: Tilts = ((0.0, 0.0), (4e-3, -3e-3), (2e-3, 5e-3), (0.0, 0.0))
    found = check_alignment(calibrated.rig, *board_views(views_of(tilts), 60, 5), BOARD)
    assert "more than one" in found.advice()


def test_forms_of_the_paper_and_how_far_they_are_off() -> None:
    """The figures of MATH 3.1, for b = 100 mm over 400-800 mm."""
    m, printed = plate_constants(Plate(thickness_m=1e-3))
    assert (m, printed) == pytest.approx((0.32914e-3, 0.37796e-3), abs=1e-8)
    assert corrected_l(Plate(thickness_m=1e-3)) == pytest.approx((0.3291e-3, 0.5991e-3), abs=5e-8)
    side = np.linspace(-1.0, 1.0, 9)
    grid = np.stack(np.meshgrid(0.12 * side, 0.09 * side, np.linspace(0.4, 0.8, 9)), axis=-1).reshape(-1, 3)
    camera = Camera.pinhole(1280, 960, 1000.0, 1000.0, 639.5, 479.5)
    found = {one.name: one for one in form_errors(camera, Design(baseline_m=0.1), grid)}
    assert found["paper, l printed"].z_m == pytest.approx(0.77e-3, abs=1e-5)
    assert found["paper, l tangential"].z_m == pytest.approx(0.39e-3, abs=1e-5)
    assert found["paper, l none"].z_m == pytest.approx(1.41e-3, abs=1e-5)
    assert found["no plate"].z_m == pytest.approx(4.0e-3, abs=1e-4)
    assert found["no plate"].epipolar_px == pytest.approx(0.21, abs=0.01)
    assert found["exact per ray"].z_m < 1e-12


def random_lights(rng: np.random.Generator, views: dict[str, MirrorLens]) -> tuple[Array, list[Array]]:
    """The target's lights anywhere in both views, and their pixels in each."""
    X = np.array(list(SPOTS.values()))
    while True:
        lean = Rotation.from_rotvec([*rng.uniform(-0.7, 0.7, 2), 0.0])
        spin = Rotation.from_rotvec([0.0, 0.0, rng.uniform(-np.pi, np.pi)])
        P = (lean * spin).apply(X) + rng.uniform([-0.2, -0.12, 0.4], [0.2, 0.12, 0.8])
        uv = [view.project(P) for view in views.values()]
        if all(((one > 10.0) & (one < [WIDTH - 10, HEIGHT - 10])).all() for one in uv):
            return P, uv


def test_six_spots_are_sorted_into_three_pairs() -> None:
    """Spots of both views in one list, in any order: every pair right, or the moment refused."""
    views = views_of(plain=True)
    setup = Setup(ideal_rig(views), spot_target(SPOTS), overlaid=True)
    rng, refused = np.random.default_rng(7), 0
    for _ in range(150):
        P, uv = random_lights(rng, views)
        both = np.concatenate(uv) + rng.normal(0.0, 0.05, (6, 2))
        order = rng.permutation(6)
        seen = spots(both[order])
        found = measure_spots(setup, 0.0, seen, seen)
        if found.pose.status is not PoseStatus.OK:
            refused += 1
            continue
        of = [list(SPOTS).index(name) for name in found.names]
        for side, matched in enumerate((found.left, found.right)):
            assert np.abs(matched.uv_px - uv[side][of]).max() < 0.5
        assert np.linalg.norm(found.points.xyz_m - P[of], axis=1).max() < 5e-3
    assert refused <= 3


def test_few_lights_dark_paths_ghosts_and_spots_on_each_other() -> None:
    views = views_of(plain=True)
    rig = ideal_rig(views)
    setup = Setup(rig, spot_target(SPOTS), overlaid=True)
    rng = np.random.default_rng(2)
    _, uv = random_lights(rng, views)

    def measured(*rows: Array) -> tuple[PoseStatus, str]:
        seen = spots(np.concatenate(rows) + rng.normal(0.0, 0.02, (sum(map(len, rows)), 2)))
        pose = measure_spots(setup, 0.0, seen, seen).pose
        return pose.status, pose.why

    assert measured(uv[0], uv[1])[0] is PoseStatus.OK
    status, why = measured(uv[0])  # the right path is dark
    assert status is PoseStatus.LOST and "dark" in why
    for keep in ([0], [0, 2]):
        assert measured(uv[0][keep], uv[1][keep])[0] is PoseStatus.POSITION_ONLY
    ghost = np.array([[300.0, 200.0], [512.0, 640.0], [900.0, 333.0]])  # a third reflection of everything
    assert measured(uv[0], uv[1], ghost)[0] is PoseStatus.OK
    merged = np.delete(np.concatenate(uv), 3, axis=0)  # one view's spot lies under another's: five are left
    status, why = measured(merged)
    assert status is PoseStatus.POSITION_ONLY or (status is PoseStatus.LOST and "5 of the 6" in why)
    nothing = measure_spots(setup, 0.0, Spots.none(), Spots.none()).pose
    assert nothing.status is PoseStatus.LOST and "no spot" in nothing.why
    with refuses(Degenerate, "one line"):
        Setup(rig, spot_target({"A": (0, 0, 0), "B": (0.02, 0, 0), "C": (0.05, 0, 0)}), overlaid=True)


def test_the_target_is_measured_through_the_mirrors() -> None:
    """An unknown triangle from complex images: the candidates of one image are cleared of a spot's second role."""
    views = views_of(plain=True)
    rig = ideal_rig(views)
    packed, rng = PackedRig.of(rig), np.random.default_rng(8)
    frames = []
    for number in range(12):
        _, uv = random_lights(rng, views)
        seen = spots(np.concatenate(uv) + rng.normal(0.0, 0.05, (6, 2)))
        frames.append(lit_frame(packed, str(number), seen, seen, overlaid=True))
    done = calibrate_target(rig, frames, 3)
    truth = np.array(list(SPOTS.values()))
    sides = sorted(float(np.linalg.norm(truth[i] - truth[j])) for i, j in ((0, 1), (0, 2), (1, 2)))
    found = sorted((d.value_m, d.std_m) for d in done.distances_m.values())
    assert done.n_used >= 11
    for (value, std), side in zip(found, sides, strict=True):
        assert abs(value - side) < 4.0 * std + 1e-6 and std < 2e-4


def test_the_mirrors_are_calibrated_from_the_lit_target() -> None:
    """The lens known, mirrors a little out: three lights, seen in many places, tell how the views stand."""
    tilts: Tilts = ((0.0, 0.0), (4e-4, -2e-4), (-3e-4, 1e-4), (0.0, 0.0))
    views = views_of(tilts, plain=True)
    start, target = ideal_rig(views), spot_target(SPOTS)
    setup = Setup(start, target, overlaid=True, slack_px=4.0)
    rng = np.random.default_rng(4)
    pairs, poses = [], []
    for number in range(30):
        _, uv = random_lights(rng, views)
        seen = spots(np.concatenate(uv) + rng.normal(0.0, 0.05, (6, 2)))
        found = measure_spots(setup, 0.0, seen, seen)
        if found.pose.status is not PoseStatus.OK:
            continue
        index = np.array([target.names.index(name) for name in found.names])
        left, right = (
            BoardView(uv_px=one.uv_px, index=index, sigma_px=0.05, width=WIDTH, height=HEIGHT, source=str(number))
            for one in (found.left, found.right)
        )
        pairs.append((left, right))
        poses.append(found.pose)
    done = mirrors_from_target(start, pairs, poses, target)
    mirrors = views["left"].mirrors
    truth = mirrors.pose("left").inv() * mirrors.pose("right")
    off: RigidTransform = truth.inv() * (done.rig.T_rig_left.inv() * done.rig.T_rig_right)
    known = done.pair.rig.covariance
    assert known is not None
    std = np.sqrt(np.diag(known.matrix))[-6:]
    z = np.concatenate([off.translation, off.rotation.as_rotvec()]) / std
    assert np.abs(z).max() < 4.0
    assert std[:3].max() < 5e-4
    with pytest.raises(NotEnoughData, match="images"):
        mirrors_from_target(start, pairs[:2], poses[:2], target)


def axis_angles(tilts: Tilts) -> Array:
    """How far the right view's chief ray turns from the left one's about x, y and z (3,), rad, traced ray by ray."""
    mirrors = Mirrors(baseline_m=0.1, tilts_rad=tilts)
    frames = []
    for side in ("left", "right"):
        ahead, beside, below = (mirrors.trace(side, [uv])[1][0] for uv in ((0.0, 0.0), (0.05, 0.0), (0.0, 0.05)))
        x = (beside - ahead * (beside @ ahead)) / np.linalg.norm(beside - ahead * (beside @ ahead))
        frames.append(np.column_stack([x, np.cross(ahead, x), ahead]))
        assert below @ frames[-1][:, 1] > 0.0
    return np.asarray(Rotation.from_matrix(frames[0].T @ frames[1]).as_rotvec())


def test_the_turns_that_are_told_make_the_axes_parallel() -> None:
    """All four mirrors are off; after mirrors 2 and 4 were turned as told, chief rays and their images are parallel."""
    tilts: Tilts = ((1e-3, -2e-3), (4e-3, 2e-3), (-2e-3, 1e-3), (1e-3, -3e-3))
    camera = ideal_rig(views_of(plain=True)).left
    left, right = board_views(views_of(tilts, plain=True), 7, 4)
    found = adjust_to_parallel(camera, Design(baseline_m=0.1), left, right, BOARD)
    assert not found.parallel and "turn mirror 2" in found.advice()
    assert np.abs(axis_angles(tilts)).max() > 5e-3
    turned = [list(tilt) for tilt in tilts]
    for one in found.turns:
        turned[one.mirror - 1][0] += one.turn_rad
        turned[one.mirror - 1][1] += one.tilt_rad
    after = axis_angles(tuple((turn, tilt) for turn, tilt in turned))
    assert (np.abs(after) < 4.0 * found.std_rad + 2e-5).all() and np.abs(after).max() < 2e-4


def test_turns_are_as_the_words_say() -> None:
    """A positive turn is clockwise seen from above, a positive tilt brings a mirror's upper edge back (y is down)."""
    for mirror, side in ((1, 1.0), (3, -1.0)):
        for angle in ((1e-3, 0.0), (0.0, 1e-3)):
            tilts = [[0.0, 0.0] for _ in range(4)]
            tilts[mirror] = list(angle)
            normal = Mirrors(baseline_m=0.1, tilts_rad=tuple((a, b) for a, b in tilts)).normals()[mirror]
            upright = Mirrors(baseline_m=0.1).normals()[mirror]
            turn = np.cross(upright, normal)
            if angle[0]:
                assert turn[1] > 0.9e-3, "about y, which points down: clockwise for who looks down"
            else:
                upper = np.cross(turn, [0.0, -1.0, 0.0])  # where a place above the middle goes
                assert upper[2] < -0.5e-3 and upper[0] * side > 0.0
