"""Calibration from real pictures of boards, beside OpenCV: detection, left-out errors, intrinsics; far boards, drawn.

Reads ../shared/data (opencv_stereo, dots_10x10_handeye) and says so where it is not there. One evaluator, built on
OpenCV's undistortPoints and triangulatePoints, judges every method on the pair that its fit has not seen.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from armsight.calibrate.cameras import BoardOptions, calibrate_camera, calibrate_stereo
from armsight.errors import BadImage
from armsight.measure.boards import find_board, warm_up
from armsight.records import BoardView, TargetKind, board_target
from bench import DATA, machine, table, test_scene

PAIRS = (1, 2, 3, 4, 5, 6, 7, 8, 9, 11, 12, 13, 14)
SIZE = (640, 480)
LONG_S = 0.05
BOARD = board_target(TargetKind.CHECKERBOARD, 9, 6, 0.025)
DOTS = board_target(TargetKind.CIRCLES, 10, 10, 0.0254)
X = BOARD.xyz_m.astype(np.float32)
Corners = dict[tuple[str, int], np.ndarray]


@dataclass
class Solved:
    K: list[np.ndarray]
    d: list[np.ndarray]
    R: np.ndarray
    t: np.ndarray
    rms_px: float


def images() -> dict[tuple[str, int], np.ndarray]:
    folder = DATA / "opencv_stereo"
    return {
        (side, n): cv2.imread(str(folder / f"{side}{n:02d}.jpg"), cv2.IMREAD_GRAYSCALE)
        for n in PAIRS
        for side in ("left", "right")
    }


def opencv_corners(pictures: dict[tuple[str, int], np.ndarray], window: int) -> Corners:
    """findChessboardCorners and cornerSubPix; window 0: findChessboardCornersSB."""
    out: Corners = {}
    for key, picture in pictures.items():
        if window == 0:
            found, corners = cv2.findChessboardCornersSB(picture, (9, 6))
        else:
            found, corners = cv2.findChessboardCorners(picture, (9, 6))
        if not found:
            continue
        if window:
            corners = cv2.cornerSubPix(picture, corners, (window, window), (-1, -1), (3, 100, 1e-4))
        out[key] = np.asarray(corners, float).reshape(-1, 2)
    return out


def solve_opencv(corners: Corners, pairs: list[int]) -> Solved:
    objects = [X] * len(pairs)
    uv = [[corners[side, n].astype(np.float32) for n in pairs] for side in ("left", "right")]
    mono = [cv2.calibrateCamera(objects, side, SIZE, None, None) for side in uv]
    rms, K0, d0, K1, d1, R, T, *_ = cv2.stereoCalibrate(
        objects,
        *uv,
        mono[0][1],
        mono[0][2],
        mono[1][1],
        mono[1][2],
        SIZE,
        flags=cv2.CALIB_USE_INTRINSIC_GUESS,
        criteria=(3, 200, 1e-9),
    )
    return Solved([K0, K1], [d0, d1], R, T.ravel(), rms)


def solve_ours(views: dict[tuple[str, int], BoardView], pairs: list[int]) -> Solved:
    done = calibrate_stereo(
        [views["left", n] for n in pairs], [views["right", n] for n in pairs], BOARD, BoardOptions(folds=0)
    )
    if done.rejected:
        print("left out:", done.rejected)
    T = done.rig.T_rig_right.inv()
    cameras = (done.rig.left, done.rig.right)
    return Solved(
        [c.matrix for c in cameras], [c.distortion for c in cameras], T.rotation.as_matrix(), T.translation, done.rms_px
    )


def judge(s: Solved, left: np.ndarray, right: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return errors of the squares' sides (mm), distances from the rigid board (mm), epipolar distances (px)."""
    rays = [
        cv2.undistortPoints(uv.reshape(-1, 1, 2), K, d).reshape(-1, 2)
        for uv, K, d in zip((left, right), s.K, s.d, strict=True)
    ]
    P = cv2.triangulatePoints(np.eye(3, 4), np.column_stack([s.R, s.t]), rays[0].T.copy(), rays[1].T.copy())
    P = (P[:3] / P[3]).T * 1e3
    grid = P.reshape(6, 9, 3)
    sides = [np.linalg.norm(np.diff(grid, axis=a), axis=2).ravel() - 25.0 for a in (0, 1)]
    A, B = P - P.mean(0), 1e3 * (BOARD.xyz_m - BOARD.xyz_m.mean(0))
    U, _, Vt = np.linalg.svd(A.T @ B)
    rigid = np.linalg.norm(A - B @ (U @ np.diag([1, 1, np.linalg.det(U @ Vt)]) @ Vt).T, axis=1)
    tx = np.array([[0, -s.t[2], s.t[1]], [s.t[2], 0, -s.t[0]], [-s.t[1], s.t[0], 0]])
    F = np.linalg.inv(s.K[1]).T @ tx @ s.R @ np.linalg.inv(s.K[0])
    flat = [np.column_stack([r, np.ones(len(r))]) @ K.T for r, K in zip(rays, s.K, strict=True)]
    lines = flat[1] @ F, flat[0] @ F.T
    product = (flat[1] * lines[1]).sum(1)
    epipolar = np.concatenate([product / np.hypot(line[:, 0], line[:, 1]) for line in lines])
    return np.concatenate(sides), rigid, epipolar


def leave_one_out(name: str, corners: Corners, solve: Callable[[list[int]], Solved]) -> list[object]:
    pairs = [n for n in PAIRS if ("left", n) in corners and ("right", n) in corners]
    judged = [judge(solve([m for m in pairs if m != n]), corners["left", n], corners["right", n]) for n in pairs]
    rms = [float(np.sqrt(np.mean(np.concatenate(errors) ** 2))) for errors in zip(*judged, strict=True)]
    whole = solve(pairs)
    baseline = 1e3 * float(np.linalg.norm(whole.t))
    return [name, len(pairs), f"{whole.rms_px:.3f}", f"{baseline:.2f}", *(f"{value:.3f}" for value in rms)]


def stereo(quick: bool) -> None:
    if not (DATA / "opencv_stereo").exists():
        print("opencv_stereo: not here, skipped")
        return
    pictures = images()
    views = {key: find_board(picture, BOARD, source=f"{key[0]}{key[1]:02d}") for key, picture in pictures.items()}
    ours = {key: view.uv_px for key, view in views.items()}
    rows = [leave_one_out("armsight", ours, lambda pairs: solve_ours(views, pairs))]
    rows.append(leave_one_out("armsight's corners, OpenCV's solver", ours, lambda pairs: solve_opencv(ours, pairs)))
    for window in (5,) if quick else (4, 5, 6, 7, 8, 11, 0):
        corners = opencv_corners(pictures, window)
        name = f"OpenCV, cornerSubPix window {window}" if window else "OpenCV, findChessboardCornersSB"
        rows.append(leave_one_out(name, corners, lambda pairs, corners=corners: solve_opencv(corners, pairs)))
    table(
        "opencv_stereo, leaving one pair out (RMS)",
        ["method", "pairs", "stereo fit px", "baseline mm", "square's side mm", "rigid board mm", "epipolar px"],
        rows,
    )
    done = calibrate_stereo(
        [views["left", n] for n in PAIRS], [views["right", n] for n in PAIRS], BOARD, BoardOptions(folds=len(PAIRS))
    )
    worst = max(float(np.linalg.norm(r, axis=1).max()) for r in done.residual_px.values())
    whole = sum(len(view) == 54 for view in views.values())
    print(
        f"\nimages with all 54 corners: {whole} of {len(views)}; "
        f"largest residual of {2 * 54 * done.n_used} corners {worst:.2f} px"
    )
    print(
        f"calibrate_stereo's own left-one-out figures: reprojection {done.holdout_rms_px:.3f} px, "
        f"epipolar {done.holdout_epipolar_rms_px:.3f} px, side {1e3 * done.metric['rms_m']:.3f} mm, "
        f"board {1e3 * done.metric['board_rms_m']:.3f} mm"
    )


def seconds_of(found: Callable[[np.ndarray], bool], picture: np.ndarray) -> tuple[bool, float]:
    """Return whether it is found and the least time of three, or of one that is long; this thread's time alone."""
    took = []
    for _ in range(3):
        start = time.thread_time()
        answer = found(picture)
        took.append(time.thread_time() - start)
        if took[0] > LONG_S:
            break
    return answer, min(took)


def armsight_finds(detector: str) -> Callable[[np.ndarray], bool]:
    def found(picture: np.ndarray) -> bool:
        try:
            return len(find_board(picture, BOARD, detector=detector)) == len(X)
        except BadImage:
            return False

    return found


def classic(picture: np.ndarray) -> bool:
    found, corners = cv2.findChessboardCorners(picture, (9, 6))
    if found:
        cv2.cornerSubPix(picture, corners, (5, 5), (-1, -1), (3, 100, 1e-4))
    return bool(found)


def written(rng: np.random.Generator) -> np.ndarray:
    """Return a page of text."""
    page = np.full((480, 640), 235, np.uint8)
    for line in range(20):
        letters = "".join(chr(c) for c in rng.integers(33, 127, 40))
        cv2.putText(page, letters, (10, 20 + 23 * line), cv2.FONT_HERSHEY_SIMPLEX, 0.6, 30, 2, cv2.LINE_AA)
    return page


def keyboard(rng: np.random.Generator) -> np.ndarray:
    """Return keys in rows, each with its letter."""
    page = np.full((480, 640), int(rng.integers(60, 200)), np.uint8)
    side = int(rng.integers(24, 60))
    for u, v in np.ndindex(640 // side, 480 // side):
        at = (u * side + (v * side) // 3 % side, v * side)
        cv2.rectangle(page, (at[0] + 2, at[1] + 2), (at[0] + side - 3, at[1] + side - 3), 25, -1)
        cv2.putText(page, chr(65 + (u + v) % 26), (at[0] + 6, at[1] + side // 2), 0, side / 60, 220, 1, cv2.LINE_AA)
    return page


def speed(pictures: list[np.ndarray], most: int | None = None) -> None:
    """Print finds and times beside OpenCV's, of boards and of pictures that show none; most: so many of the sets."""
    rng = np.random.default_rng(1)
    wide = [cv2.copyMakeBorder(cv2.resize(p, (1440, 1080)), 0, 0, 240, 240, cv2.BORDER_REPLICATE) for p in pictures]
    rooms = [cv2.imread(str(file), cv2.IMREAD_GRAYSCALE) for file in sorted((DATA / "rooms").glob("*/*.*g"))][:40]
    noise = [rng.integers(0, 255, (480, 640)).astype(np.uint8) for _ in range(5)]
    drawn = [*(written(rng) for _ in range(5)), *(keyboard(rng) for _ in range(5))]
    sets = {
        "boards, 640 x 480": pictures,
        "boards, 1920 x 1080": wide,
        "rooms": rooms,
        "noise, text, keyboards": noise + drawn,
    }
    methods = {
        "OpenCV, findChessboardCorners and cornerSubPix": classic,
        "OpenCV, findChessboardCornersSB": lambda p: bool(cv2.findChessboardCornersSB(p, (9, 6))[0]),
        "armsight": armsight_finds("auto"),
        "armsight, quick": armsight_finds("quick"),
    }
    rows = []
    for what, shown in list(sets.items())[:most]:
        peer = None
        for name, found in methods.items():
            done = [seconds_of(found, picture) for picture in shown]
            middle, most = 1e3 * np.percentile([seconds for _, seconds in done], [50, 99])
            peer = peer or middle
            finds = sum(one for one, _ in done)
            rows.append(
                [what, name, f"{finds} of {len(shown)}", f"{middle:.2f}", f"{most:.1f}", f"{middle / peer:.2f}"]
            )
    columns = ["pictures", "method", "all corners found", "ms median", "ms 99 %", "of findChessboardCorners'"]
    table("checkerboards of 9x6 corners, one thread", columns, rows)


def dots() -> None:
    folder = DATA / "dots_10x10_handeye" / "images"
    if not folder.exists():
        print("dots_10x10_handeye: not here, skipped")
        return
    views, refused, opencv = [], [], []
    for n in range(15):
        picture = cv2.imread(str(folder / f"{n}.png"), cv2.IMREAD_GRAYSCALE)
        try:
            views.append(find_board(picture, DOTS, source=f"{n}.png"))
        except BadImage as error:
            refused.append(str(error))
        found, centres = cv2.findCirclesGrid(picture, (10, 10), flags=cv2.CALIB_CB_SYMMETRIC_GRID)
        if found:
            opencv.append(centres)
    rows = []
    for name, options in (
        ("armsight", BoardOptions()),
        ("armsight, no point left out", BoardOptions(reject=False)),
        (
            "armsight, no distortion",
            BoardOptions(fixed=frozenset({"skew", "k1", "k2", "p1", "p2", "k3"}), reject=False),
        ),
    ):
        done = calibrate_camera(views, DOTS, options)
        rows.append([name, f"{done.n_used} of 15", len(done.uv_px), f"{done.rms_px:.3f}", f"{done.holdout_rms_px:.3f}"])
    objects = [DOTS.xyz_m[v.index].astype(np.float32) for v in views]
    rms = cv2.calibrateCamera(objects, [v.uv_px.astype(np.float32) for v in views], SIZE, None, None)[0]
    rows.append(["armsight's centres, OpenCV's solver", f"{len(views)} of 15", sum(map(len, views)), f"{rms:.3f}", ""])
    detail = "OpenCV, findCirclesGrid as it comes"
    if len(opencv) > 3:
        rms = cv2.calibrateCamera([DOTS.xyz_m.astype(np.float32)] * len(opencv), opencv, SIZE, None, None)[0]
        rows.append([detail, f"{len(opencv)} of 15", 100 * len(opencv), f"{rms:.3f}", ""])
    else:
        rows.append([detail, f"{len(opencv)} of 15", 0, "", ""])
    table("dots_10x10_handeye, intrinsics", ["method", "images", "points", "fit px", "left out (5-fold) px"], rows)
    print("\n".join(refused))


FAR_PX = (16, 20, 24, 28, 34, 45, 60)
RIGHT_PX = 0.15
"""OpenCV's corners are right where they are off by no more than this, RMS per axis."""
FALSE = 5.0


def far(n: int) -> None:
    """Print what is found of ChArUco boards whose squares have few pixels, before even and textured ground."""
    scene, rows = test_scene("far_boards"), []
    for square_px, textured in ((px, textured) for px in FAR_PX for textured in (False, True)):
        right = found = both = 0
        off, peers, seconds = [np.empty((0, 2))], [np.empty((0, 2))], []
        scaled = [np.empty((0, 2))]
        for seed in range(n):
            made = scene.far_board(seed, square_px, textured=textured)
            words = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, made.board.dictionary))
            size = made.board.columns, made.board.rows
            peer = cv2.aruco.CharucoDetector(
                cv2.aruco.CharucoBoard(size, made.board.pitch_m, made.board.marker_m, words)
            )
            begin = time.thread_time()
            corners, ids, *_ = peer.detectBoard(made.image)
            middle = time.thread_time()
            error = np.empty((0, 2)) if ids is None else corners.reshape(-1, 2) - made.uv_px[ids.ravel()]
            fair = len(error) >= 6 and np.sqrt(np.mean(error**2)) < RIGHT_PX
            try:
                view = find_board(made.image, made.board)
            except BadImage:
                view = None
            seconds.append((middle - begin, time.thread_time() - middle))
            right, found, both = right + fair, found + (view is not None), both + (fair and view is not None)
            peers.append(error)
            if view is not None:
                off.append(view.uv_px - made.uv_px[view.index])
                scaled.append(off[-1] / view.sigma_px)
        ours, theirs, units = (np.concatenate(one) for one in (off, peers, scaled))
        false = int(np.count_nonzero(np.linalg.norm(units, axis=1) > FALSE))
        rms = [float(np.sqrt(np.mean(one**2))) if len(one) else np.nan for one in (ours, units, theirs)]
        ms = 1e3 * np.median(seconds, axis=0)
        row = [square_px, "textured" if textured else "even", n, right, both, found, f"{rms[0]:.4f}", f"{rms[1]:.2f}"]
        rows.append([*row, f"{false} of {len(ours)}", f"{rms[2]:.3f}", f"{ms[1]:.1f}", f"{ms[0]:.1f}"])
    columns = ["px a square", "ground", "boards", "right of OpenCV's", "of these found", "found", "off px RMS"]
    columns += ["over claimed", f"beyond {FALSE:g}", "OpenCV px", "ms", "OpenCV ms"]
    table("ChArUco boards far away, drawn, 1280 x 720, one thread", columns, rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="only OpenCV's window 5 as the peer")
    parser.add_argument("--speed", action="store_true", help="only finds and times of checkerboards")
    parser.add_argument("--far", type=int, default=0, metavar="N", help="only N far ChArUco boards of each kind")
    asked = parser.parse_args()
    print(machine(), f"OpenCV {cv2.__version__}", sep=", ")
    if asked.far:
        cv2.setNumThreads(1)
        warm_up()
        far(asked.far)
        return
    if (DATA / "opencv_stereo").exists():
        cv2.setNumThreads(1)
        speed(list(images().values()))
    if asked.speed:
        return
    stereo(asked.quick)
    dots()


if __name__ == "__main__":
    main()
