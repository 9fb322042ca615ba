"""Camera and stereo calibration: what is recovered, what is refused and how it is said."""

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
import pytest

from armsight.calibrate.cameras import BoardOptions, calibrate_camera, calibrate_stereo
from armsight.calibrate.cameras.bundle_adjustment import Bundle, problem_of
from armsight.calibrate.cameras.kernels import move_poses
from armsight.calibrate.cameras.observations import pack
from armsight.errors import Degenerate, Inconsistent, NotEnoughData, UsageError
from armsight.optics import LensKind
from armsight.records import BoardView, Target, TargetKind, board_target
from refusals import refuses

SIZE = (1280, 720)
LEFT = np.array([1105.0, 1102.0, 651.0, 352.0, -0.12, 0.06, 4e-4, -3e-4, 0.0])
RIGHT = np.array([1093.0, 1096.0, 630.0, 371.0, -0.11, 0.05, -2e-4, 5e-4, 0.0])
"""fx, fy, cx, cy, k1, k2, p1, p2, k3"""
T_M = np.array([0.30, -0.004, 0.03])
W_RAD = np.array([-0.01, -0.25, -0.015])
SIGMA_PX = 0.1
BOARD = board_target(TargetKind.CHECKERBOARD, 9, 6, 0.03)
EVEN = board_target(TargetKind.CHECKERBOARD, 8, 6, 0.03)
QUICK = BoardOptions(folds=0)

Pose = tuple[np.ndarray, np.ndarray]


def see(k: np.ndarray, X: np.ndarray, w: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Project with OpenCV, which shares no code with the product."""
    K = np.array([[k[0], 0.0, k[2]], [0.0, k[1], k[3]], [0.0, 0.0, 1.0]])
    return cv2.projectPoints(X, w, t, K, k[4:])[0].reshape(-1, 2)


def right_pose(w: np.ndarray, t: np.ndarray) -> Pose:
    """T_right_board from T_left_board and the truth T_left_right."""
    S, R = cv2.Rodrigues(W_RAD)[0], cv2.Rodrigues(w)[0]
    return cv2.Rodrigues(S.T @ R)[0].ravel(), S.T @ (t - T_M)


def poses(n: int, rng: np.random.Generator, board: Target = BOARD, tilt: float = 0.6) -> list[Pose]:
    """Board poses that both cameras see whole; w turns the board about its middle."""
    out: list[Pose] = []
    middle = board.xyz_m.mean(0)
    while len(out) < n:
        w = rng.uniform(-tilt, tilt, 3)
        at = np.array([rng.uniform(-0.25, 0.35), rng.uniform(-0.25, 0.25), rng.uniform(0.6, 1.0)])
        t = at - cv2.Rodrigues(w)[0] @ middle
        views = [see(LEFT, board.xyz_m, w, t), see(RIGHT, board.xyz_m, *right_pose(w, t))]
        if all((uv > 5).all() and (uv < np.array(SIZE) - 5).all() for uv in views):
            out.append((w, t))
    return out


def view(uv: np.ndarray, source: str, index: np.ndarray | None = None) -> BoardView:
    index = np.arange(len(uv)) if index is None else index
    return BoardView(uv_px=uv, index=index, sigma_px=SIGMA_PX, width=SIZE[0], height=SIZE[1], source=source)


def pairs(
    n: int, seed: int, board: Target = BOARD, left: np.ndarray = LEFT, right: np.ndarray = RIGHT
) -> tuple[list[BoardView], list[BoardView]]:
    rng = np.random.default_rng(seed)
    out: tuple[list[BoardView], list[BoardView]] = ([], [])
    for g, (w, t) in enumerate(poses(n, rng, board)):
        for side, k, pose, name in ((0, left, (w, t), "l"), (1, right, right_pose(w, t), "r")):
            uv = see(k, board.xyz_m, *pose)
            out[side].append(view(uv + rng.normal(0.0, SIGMA_PX, uv.shape), f"{name}{g:02d}.png"))
    return out


def mirrored(views: list[BoardView]) -> list[BoardView]:
    """What a camera in mirror mode gives, numbered right-handed as the finder would."""
    out = []
    for v in views:
        flipped = np.column_stack([SIZE[0] - 1.0 - v.uv_px[:, 0], v.uv_px[:, 1]])
        out.append(replace(v, uv_px=flipped.reshape(6, -1, 2)[:, ::-1].reshape(-1, 2)))
    return out


def turned(v: BoardView) -> BoardView:
    return replace(v, uv_px=v.uv_px[::-1])


# what is recovered


def test_camera_with_a_strong_third_term_gets_it_and_one_without_does_not() -> None:
    bent = LEFT.copy()
    bent[[4, 5, 8]] = -0.35, 0.15, -0.25
    left, _ = pairs(12, 2, left=bent)
    free = calibrate_camera(left, BOARD, QUICK)
    assert abs(free.camera.intrinsics[9] + 0.25) < 4.5 * free.std["k3"]
    plain, _ = pairs(12, 2)
    held = calibrate_camera(plain, BOARD, QUICK)
    assert held.camera.intrinsics[9] == 0.0
    assert "k3" not in held.std
    assert "skew_px" not in held.std


def test_fixed_parameters_stay_and_every_name_is_known() -> None:
    left, _ = pairs(10, 3)
    found = calibrate_camera(left, BOARD, BoardOptions(folds=0, fixed=frozenset({"skew", "cx", "cy", "p1", "p2"})))
    assert found.camera.intrinsics[[2, 3]].tolist() == [639.5, 359.5]
    assert set(found.std) == {"fx_px", "fy_px", "k1", "k2"}
    with refuses(UsageError, "fx", "fy", "cx"):
        BoardOptions(fixed=frozenset({"focal"}))


def test_symmetric_board_half_a_turn_off_in_some_views_is_turned_back() -> None:
    left, right = pairs(12, 6, EVEN)
    right = [turned(v) if g % 3 == 0 else v for g, v in enumerate(right)]
    found = calibrate_stereo(left, right, EVEN, QUICK)
    assert found.n_used == 12
    assert found.rms_px == pytest.approx(0.141, rel=0.08)


def test_circles_known_diameter_removes_the_shift_of_their_centres() -> None:
    board = replace(board_target(TargetKind.CIRCLES, 7, 6, 0.04), diameter_m=0.034)
    a = np.linspace(0.0, 2.0 * np.pi, 720, endpoint=False)
    ring = 0.017 * np.stack([np.cos(a), np.sin(a), 0.0 * a], 1)
    views = []
    pinhole = np.r_[LEFT[:4], np.zeros(5)]
    for g, (w, t) in enumerate(poses(10, np.random.default_rng(7), board, tilt=0.8)):
        uv = []
        for centre in board.xyz_m:
            m = cv2.moments(see(pinhole, centre + ring, w, t).astype(np.float32))
            uv.append([m["m10"] / m["m00"], m["m01"] / m["m00"]])
        views.append(view(np.array(uv), f"{g}.png"))
    exact = calibrate_camera(views, board, QUICK)
    rough = calibrate_camera(views, replace(board, diameter_m=None), QUICK)
    assert abs(exact.camera.intrinsics[0] - 1105.0) < 0.01
    assert exact.rms_px < 0.002  # the moments are of a polygon in single precision
    assert rough.rms_px > 5.0 * exact.rms_px


# what is left out


def test_wrong_pair_and_wrong_corner_are_left_out_and_named() -> None:
    left, right = pairs(14, 8)
    right[4] = replace(right[9], source="r04.png")
    uv = left[7].uv_px.copy()
    uv[20] += [4.0, -3.0]
    left[7] = view(uv, "l07.png")
    found = calibrate_stereo(left, right, BOARD)
    assert found.n_used == 13
    assert [name for name, _ in found.rejected] == ["l04.png / r04.png"]
    assert "one moment" in found.rejected[0][1]
    assert any("l07.png: 1 of" in line for line in found.advice)
    assert abs(found.rig.baseline_m - np.linalg.norm(T_M)) < 4.5 * found.std["baseline_m"]


# what is refused


def no_tilt(board: Target) -> list[BoardView]:
    """Boards parallel to the image, all over it."""
    rng = np.random.default_rng(11)
    places = [(x, y, z) for x in (-0.4, -0.1, 0.15) for y in (-0.25, 0.1) for z in (0.9, 1.1)]
    views = []
    for g, at in enumerate(places):
        uv = see(LEFT, board.xyz_m, np.array([0.0, 0.0, 0.1 * g]), np.array(at))
        views.append(view(uv + rng.normal(0.0, SIGMA_PX, uv.shape), f"{g}.png"))
    return views


def one_tilt(board: Target) -> list[BoardView]:
    """... and all tilted in the same way."""
    rng = np.random.default_rng(12)
    places = [(x, y, z) for x in (-0.4, -0.1, 0.15) for y in (-0.25, 0.1) for z in (0.9, 1.1)]
    uvs = [see(LEFT, board.xyz_m, np.array([0.5, 0.0, 0.0]), np.array(at)) for at in places]
    return [view(uv + rng.normal(0.0, SIGMA_PX, uv.shape), f"{g}.png") for g, uv in enumerate(uvs)]


def one_corner(board: Target) -> list[BoardView]:
    """Boards far away, low on the right."""
    rng = np.random.default_rng(13)
    views = []
    for g in range(10):
        w = rng.uniform(-0.6, 0.6, 3)
        t = np.array([0.9, 0.4, 2.4]) + rng.uniform(-0.05, 0.05, 3) - cv2.Rodrigues(w)[0] @ board.xyz_m.mean(0)
        uv = see(LEFT, board.xyz_m, w, t)
        views.append(view(uv + rng.normal(0.0, SIGMA_PX, uv.shape), f"{g}.png"))
    return views


@pytest.mark.parametrize(
    ("views", "kind", "why"),
    [
        (lambda: pairs(2, 14)[0], NotEnoughData, ("2 different poses", "3")),
        (lambda: no_tilt(BOARD), Degenerate, "never"),
        (lambda: one_tilt(BOARD), Degenerate, "always"),
        (lambda: one_corner(BOARD), Degenerate, "seen around"),
    ],
)
def test_set_that_cannot_carry_a_camera_is_refused(
    views: Callable[[], list[BoardView]], kind: type[Exception], why: str
) -> None:
    with refuses(kind, why) as caught:
        calibrate_camera(views(), BOARD)
    assert "othing was calibrated" in str(caught.value)


@pytest.mark.parametrize(
    ("arrange", "why"),
    [
        (lambda a, b: (b, a), "swapped"),
        (lambda a, b: (a[1:], b[:-1]), ("out of step", "1 later")),
        (lambda a, b: (a, mirrored(b)), ("right camera are", "mirrored")),
        (lambda a, b: (mirrored(a), mirrored(b)), ("swapped", "mirrored")),
        (lambda a, b: (a, [b[i] for i in (5, 2, 8, 0, 9, 1, 7, 3, 6, 4)]), "belong"),
    ],
)
def test_pairs_that_are_none_are_refused_with_the_reason(
    arrange: Callable[[list[BoardView], list[BoardView]], tuple[list[BoardView], list[BoardView]]], why: str
) -> None:
    left, right = arrange(*pairs(10, 18))
    with refuses(Inconsistent, why):
        calibrate_stereo(left, right, BOARD)


# the compiled core


@pytest.mark.parametrize("n_cameras", [1, 2, 3])
def test_normal_equations_are_those_of_the_finite_differences(n_cameras: int) -> None:
    left, right = pairs(3, 19)
    kinds, names = (LensKind.PINHOLE,) * 3, ("left", "right", "third")
    observations = pack([left, right, left][:n_cameras], BOARD, kinds, names)
    weight = observations.weight * (np.random.default_rng(20).random(observations.weight.shape) > 0.2)
    observations = replace(observations, weight=weight)
    k = np.array([np.r_[truth[:4], 1.5, truth[4:]] for truth in (LEFT, RIGHT, LEFT)[:n_cameras]])
    truth_poses = poses(3, np.random.default_rng(19))
    local = np.array([np.r_[t + cv2.Rodrigues(w)[0] @ observations.middle, w] for w, t in truth_poses])
    start = Bundle(k=k, sides=np.array([np.r_[T_M, W_RAD], np.r_[-T_M, -W_RAD]])[: n_cameras - 1], poses=local)
    problem = problem_of(observations, start, frozenset())
    S, (G, L) = len(problem.names), local.shape
    here = problem.evaluate(problem.guess, local)
    step = np.r_[np.tile([1e-3] * 5 + [1e-6] * 5, n_cameras), [1e-6] * (6 * (n_cameras - 1))]
    Js = np.empty((G, here.residuals.shape[1], S))
    Jl = np.empty((G, here.residuals.shape[1], L))

    def at(ds: np.ndarray, dl: np.ndarray) -> np.ndarray:
        return problem.evaluate(*problem.retract(problem.guess, local, ds, dl)).residuals

    for i in range(S):
        h = np.zeros(S)
        h[i] = step[i]
        Js[:, :, i] = (at(h, 0.0 * local) - at(-h, 0.0 * local)) / (2.0 * step[i])
    for i in range(L):
        h = np.zeros_like(local)
        h[:, i] = 1e-6
        Jl[:, :, i] = (at(np.zeros(S), h) - at(np.zeros(S), -h)) / 2e-6
    c = here.condensed
    assert c is not None
    flat = Js.reshape(-1, S)
    for got, want in (
        (c.A, flat.T @ flat),
        (c.b, flat.T @ here.residuals.ravel()),
        (c.C, np.einsum("gml,gmk->glk", Jl, Jl)),
        (c.c, np.einsum("gml,gm->gl", Jl, here.residuals)),
        (c.W, np.einsum("gms,gml->gsl", Js, Jl)),
    ):
        scale = np.abs(want).max(axis=tuple(range(got.ndim - 1)), keepdims=True) + 1e-9
        assert np.abs((got - want) / scale).max() < 1e-4


def test_poses_move_by_the_exponential_from_the_left_also_through_half_a_turn() -> None:
    rng = np.random.default_rng(21)
    start = np.column_stack([rng.normal(size=(40, 3)), rng.normal(size=(40, 3)) * 1.5])
    start[0, 3:], start[1, 3:] = 0.0, [np.pi - 1e-9, 0.0, 0.0]
    step = rng.normal(size=(40, 6)) * 0.3
    step[2:5, 3:] *= 1e-9
    out = np.empty_like(start)
    move_poses(start, step, out)
    assert np.allclose(out[:, :3], start[:, :3] + step[:, :3])
    for a, d, b in zip(start, step, out, strict=True):
        want = cv2.Rodrigues(d[3:])[0] @ cv2.Rodrigues(a[3:])[0]
        assert np.abs(cv2.Rodrigues(b[3:])[0] - want).max() < 1e-8
