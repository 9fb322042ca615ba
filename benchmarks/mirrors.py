"""Mirror stereo: points against the Cramer-Rao bound, the paper's equations beside, pairing, time, alignment.

    python benchmarks/mirrors.py [--quick]

Truth comes from rays traced surface by surface through the plate and over the mirrors (the simulation's own), complex
images are painted here; the bound is the information of both views' pixels, their derivatives taken numerically.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from armsight.calibrate.mirrors.calibration import MirrorCalibration, calibrate_mirrors
from armsight.calibrate.mirrors.diagnosis import check_alignment
from armsight.geometry import align_points
from armsight.measure.poses.from_spots import measure_spots
from armsight.measure.poses.pipeline import Setup, measure_pair, warm_up
from armsight.measure.spots import find_spots
from armsight.optics import Camera, Plate, triangulate
from armsight.optics.mirrors import Mirrors as Design
from armsight.optics.mirrors import form_errors, paper_form, plate_constants, triangulate_paper
from armsight.records import BoardView, Frame, PoseStatus, spot_target
from armsight.store import parse_board
from armsight_sim.lens import Lens
from armsight_sim.rigs import MirrorLens, Mirrors, mirror_views
from bench import machine, table

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Pose = Callable[[np.random.Generator, "dict[str, MirrorLens]"], Array]
WIDTH, HEIGHT = 1280, 720
LENS = Lens(width=WIDTH, height=HEIGHT, focal_px=(1000.0, 1000.0), centre_px=(639.5, 359.5))
CAMERA = Camera.pinhole(WIDTH, HEIGHT, 1000.0, 1000.0, 639.5, 359.5)
BASELINE = 0.1
SPOTS = {"A": (-0.08, 0.0, 0.0), "B": (0.06, 0.064, 0.0), "C": (0.06, -0.064, 0.0)}
"""Wider than the baseline, so that the two views of the target overlap."""
BOARD = parse_board("checkerboard:9x6:0.018")
SIGMA_PX = 0.037
PAIRS = 25
TILT_DEG = 23.5


def views_of(tilts: tuple[tuple[float, float], ...] = ((0.0, 0.0),) * 4, lens: Lens = LENS) -> dict[str, MirrorLens]:
    """Return both views of the rig."""
    return mirror_views(lens, Mirrors(baseline_m=BASELINE, tilts_rad=tilts))


def board_views(
    views: dict[str, MirrorLens], rng: np.random.Generator, count: int, sigma: float
) -> tuple[list[BoardView], list[BoardView]]:
    """Return so many pairs of views of a board that both paths show whole."""
    X = BOARD.xyz_m - BOARD.xyz_m.mean(axis=0)
    out: dict[str, list[BoardView]] = {"left": [], "right": []}
    size = np.array([WIDTH, HEIGHT])
    while len(out["left"]) < count:
        z = rng.uniform(0.3, 0.75)
        middle = z * np.array([rng.uniform(-0.55, 0.55), rng.uniform(-0.3, 0.3), 1.0])
        P = Rotation.from_rotvec(rng.uniform(-0.5, 0.5, 3)).apply(X) + middle
        seen = {side: view.project(P) for side, view in views.items()}
        if any(((uv < 4.0) | (uv > size - 5.0)).any() for uv in seen.values()):
            continue
        for side, uv in seen.items():
            out[side].append(
                BoardView(uv_px=uv + rng.normal(0.0, sigma, uv.shape), index=np.arange(len(X)), sigma_px=sigma,
                          width=WIDTH, height=HEIGHT, source=f"{side} {len(out[side])}")
            )  # fmt: skip
    return out["left"], out["right"]


def bound(views: dict[str, MirrorLens], X: Array, sigma: float) -> Array:
    """Return the Cramer-Rao covariance (n, 3, 3) of places seen in both views with white noise."""
    J = np.empty((len(X), 4, 3))
    for k, step in enumerate(1e-5 * np.eye(3)):
        for s, view in enumerate(views.values()):
            J[:, 2 * s : 2 * s + 2, k] = (view.project(X + step) - view.project(X - step)) / 2e-5
    return np.asarray(np.linalg.inv(J.transpose(0, 2, 1) @ J) * sigma**2)


def places(rng: np.random.Generator, depth: float, count: int) -> Array:
    """Return places at one depth that both views show."""
    x = rng.uniform(-0.3 * depth, 0.3 * depth, count)
    return np.column_stack([x, rng.uniform(-0.2 * depth, 0.2 * depth, count), np.full(count, depth)])


def points(runs: int, count: int) -> None:
    """Print the errors of points from calibrated rigs over the bound, the paper's equations beside."""
    views = views_of()
    noise = np.eye(2) * SIGMA_PX**2
    depths = (0.4, 0.5, 0.6, 0.7, 0.8)
    ours: dict[float, list[Array]] = {z: [] for z in depths}
    laid: dict[float, list[Array]] = {z: [] for z in depths}
    theirs: dict[float, list[Array]] = {z: [] for z in depths}
    least: dict[float, list[Array]] = {z: [] for z in depths}
    seen_mm = []
    for seed in range(runs):
        rng = np.random.default_rng(seed)
        done: MirrorCalibration = calibrate_mirrors(*board_views(views, rng, PAIRS, 0.05), BOARD)
        seen_mm.append(1e3 * done.seen_m)
        lens = Camera(width=WIDTH, height=HEIGHT, intrinsics=done.rig.right.intrinsics)
        b = float(done.rig.T_rig_right.translation[0] - done.rig.T_rig_left.translation[0]) - done.shift_m
        plate = done.rig.left.plate or Plate(thickness_m=1e-3)
        form = paper_form(Design(baseline_m=b, plate=plate))
        X = np.concatenate([places(rng, z, count) for z in depths])
        uv = [view.project(X) + rng.normal(0.0, SIGMA_PX, (len(X), 2)) for view in views.values()]
        found, printed = triangulate(done.rig, *uv, noise, noise).xyz_m, triangulate_paper(lens, form, *uv)
        crb = np.sqrt(np.einsum("mii->mi", bound(views, X, SIGMA_PX)))
        for k, z in enumerate(depths):
            part = slice(k * count, (k + 1) * count)
            ours[z].append((found - X)[part])
            laid[z].append((align_points(X, found).T_a_b.apply(found) - X)[part])
            theirs[z].append((align_points(X, printed).T_a_b.apply(printed) - X)[part])
            least[z].append(crb[part])
    rows = []
    for z in depths:
        crb = np.sqrt(np.mean(np.concatenate(least[z]) ** 2, axis=0))
        e, r, p = (np.sqrt(np.mean(np.concatenate(one[z]) ** 2, axis=0)) for one in (laid, ours, theirs))
        rows.append([f"{1e3 * z:.0f}", *(f"{1e3 * v:.4f}" for v in e), *(f"{v:.3f}" for v in e / crb),
                     *(f"{v:.2f}" for v in p / crb), *(f"{v:.2f}" for v in r / crb)])  # fmt: skip
    table(
        f"{runs} rigs calibrated from {PAIRS} pairs (0.05 px), points at {SIGMA_PX} px: RMS mm, and over the bound "
        f"(wanted 1.2), the rig's axes laid onto the true ones; plate seen {np.mean(seen_mm):.3f} +- "
        f"{np.std(seen_mm):.3f} mm (true 1)",
        ["depth mm", "x", "y", "z", "x/CRB", "y/CRB", "z/CRB", "paper's form x/CRB", "y/CRB", "z/CRB",
         "ours, axes as calibrated x/CRB", "y/CRB", "z/CRB"], rows,
    )  # fmt: skip


def table_one(count: int) -> None:
    """Print the scatter of the mean of three lights at 600 mm, beside the paper's Table 1."""
    views = views_of()
    rng = np.random.default_rng(1)
    done = calibrate_mirrors(*board_views(views, rng, PAIRS, 0.05), BOARD)
    X = np.array(list(SPOTS.values())) * 0.1 + np.array([0.0, 0.0, 0.6])
    uv = [view.project(X) for view in views.values()]
    noise = np.eye(2) * SIGMA_PX**2
    found = []
    for _ in range(count):
        noisy = [one + rng.normal(0.0, SIGMA_PX, one.shape) for one in uv]
        found.append(triangulate(done.rig, *noisy, noise, noise).xyz_m.mean(axis=0))
    world = Rotation.from_euler("x", TILT_DEG, degrees=True).apply(found)
    sd = 1e3 * np.std(world, axis=0)
    table(
        f"Mean of three lights at 600 mm, b = 100 mm, {SIGMA_PX} px, {count} frames: deviations in mm in world axes, "
        f"to which the camera leans by {TILT_DEG} degrees (MATH 3.4)",
        ["", "x", "y", "z"],
        [["ours", *(f"{v:.4f}" for v in sd)], ["paper's Table 1", "0.0116", "0.0508", "0.117"]],
    )  # fmt: skip


class Painter:
    """Complex frames of round lights on noise."""

    def __init__(self, rng: np.random.Generator, level: float = 90.0, sigma: float = 2.0) -> None:
        self.grounds = [8.0 + rng.normal(0.0, 1.5, (HEIGHT, WIDTH)) for _ in range(8)]
        self.level, self.sigma = level, sigma

    def frame(self, uv: Array, number: int) -> Frame:
        """Return the frame with lights at uv (n, 2)."""
        light = self.grounds[number % len(self.grounds)].copy()
        for u, v in uv:
            c, r = round(u), round(v)
            if not (12 < c < WIDTH - 13 and 12 < r < HEIGHT - 13):
                continue
            y, x = np.mgrid[r - 12 : r + 13, c - 12 : c + 13]
            spot = np.exp(-((x - u) ** 2 + (y - v) ** 2) / (2.0 * self.sigma**2))
            light[r - 12 : r + 13, c - 12 : c + 13] += self.level * spot
        image: Image = np.clip(np.rint(light), 0, 255).astype(np.uint8)
        return Frame(image=image, t_s=0.01 * number, sequence=number, source="painted")


def random_pose(rng: np.random.Generator, views: dict[str, MirrorLens]) -> Array:
    """Return the lights (3, 3) in rig axes of a target that both views show whole, turned by up to 60 degrees."""
    X = np.array(list(SPOTS.values()))
    while True:
        lean = Rotation.from_rotvec([*rng.uniform(-0.75, 0.75, 2), 0.0])
        spin = Rotation.from_rotvec([0.0, 0.0, rng.uniform(-np.pi, np.pi)])
        z = rng.uniform(0.4, 0.8)
        P = (lean * spin).apply(X) + z * np.array([rng.uniform(-0.45, 0.45), rng.uniform(-0.28, 0.28), 1.0])
        uv = np.concatenate([view.project(P) for view in views.values()])
        if ((uv > 15.0) & (uv < np.array([WIDTH, HEIGHT]) - 16.0)).all():
            return np.asarray(P)


def meeting_pose(rng: np.random.Generator, views: dict[str, MirrorLens]) -> Array:
    """Return the lights of a target of which one, in the left view, falls within 8 px of another in the right view.

    Random poses are turned about the camera's axis and about the vertical until they do.
    """
    while True:
        P = random_pose(rng, views)
        i, j = rng.choice(len(P), 2, replace=False)
        way, length = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.0, 8.0)
        wanted = length * np.array([np.cos(way), np.sin(way)])

        def moved(x: Array, P: Array = P) -> Array:
            middle = P.mean(axis=0)
            turn = Rotation.from_euler("yz", [x[1], x[0]])
            return np.asarray(turn.apply(P - middle) + middle)

        def miss(x: Array, i: int = i, j: int = j, wanted: Array = wanted) -> Array:
            Q = moved(x)
            return np.asarray(views["left"].project(Q)[i] - views["right"].project(Q)[j] - wanted)

        found = least_squares(miss, rng.uniform([-np.pi, -0.6], [np.pi, 0.6]), max_nfev=15)
        Q = moved(found.x)
        uv = [view.project(Q) for view in views.values()]
        whole = all(((p > 15.0) & (p < np.array([WIDTH, HEIGHT]) - 16.0)).all() for p in uv)
        back = np.cross(Q[2] - Q[0], Q[1] - Q[0])  # the target's z; 60 degrees from the line of sight at most
        shown = back @ Q[0] > 0.5 * np.linalg.norm(back) * np.linalg.norm(Q[0])
        if np.linalg.norm(found.fun) < 0.1 and whole and shown:
            return Q


def pairing(title: str, count: int, pose: Pose, level: float = 90.0) -> None:
    """Print how often the six spots of both views are sorted right, and what happens where they are not."""
    views = views_of()
    rig = Design(baseline_m=BASELINE).rig(CAMERA)
    setup = Setup(rig, spot_target(SPOTS), overlaid=True)
    rng = np.random.default_rng(0)
    painter = Painter(rng, level)
    ok = right = position = lost = wrong = near = 0
    reasons: dict[str, int] = {}
    for number in range(count):
        P = pose(rng, views)
        uv = [view.project(P) for view in views.values()]
        found = measure_pair(setup, *(2 * [painter.frame(np.concatenate(uv), number)]))
        near += np.linalg.norm(uv[0][:, None] - uv[1][None], axis=2).min() < 6.0
        if found.pose.status is PoseStatus.OK:
            ok += 1
            expected = [uv[s][[list(SPOTS).index(name) for name in found.names]] for s in range(2)]
            good = all(np.abs(seen.uv_px - e).max() < 2.0 for seen, e in zip((found.left, found.right), expected,
                                                                            strict=True))  # fmt: skip
            right += good
            wrong += not good
        else:
            position += found.pose.status is PoseStatus.POSITION_ONLY
            lost += found.pose.status is PoseStatus.LOST
            why = found.pose.why.partition(";")[0]
            reasons[why] = reasons.get(why, 0) + 1
    table(
        f"{count} {title}, both views in one frame, rendered",
        ["poses", "pairs right of these", "position only", "refused", "poses with spots of the two views within 6 px"],
        [[ok, f"{100.0 * right / max(ok, 1):.3f} %", f"{100.0 * position / count:.2f} %",
          f"{100.0 * lost / count:.2f} %", near]],
    )  # fmt: skip
    table("Why", ["", "count"], [[why, n] for why, n in sorted(reasons.items(), key=lambda item: -item[1])[:6]])


def speed(count: int) -> None:
    """Print the time from a complex frame to the pose, without prior, and of its parts."""
    views = views_of()
    setup = Setup(Design(baseline_m=BASELINE).rig(CAMERA), spot_target(SPOTS), overlaid=True)
    rng = np.random.default_rng(3)
    painter = Painter(rng)
    frames = [
        painter.frame(np.concatenate([view.project(P) for view in views.values()]), number)
        for number, P in ((number, random_pose(rng, views)) for number in range(60))
    ]
    whole, search, match, brightest, blobs = [], [], [], [], []
    detector = cv2.SimpleBlobDetector.create()
    for number in range(count):
        frame = frames[number % len(frames)]
        begin = time.perf_counter()
        measure_pair(setup, frame, frame)
        middle = time.perf_counter()
        spots = find_spots(frame.image, setup.settings)
        found = time.perf_counter()
        measure_spots(setup, frame.t_s, spots, spots)
        whole.append(1e3 * (middle - begin))
        search.append(1e3 * (found - middle))
        match.append(1e3 * (time.perf_counter() - found))
        begin = time.perf_counter()
        frame.image.max()
        brightest.append(1e3 * (time.perf_counter() - begin))
        if number < 50:
            begin = time.perf_counter()
            detector.detect(frame.image)
            blobs.append(1e3 * (time.perf_counter() - begin))
    rows = [[name, float(np.median(ms)), float(np.min(ms)), float(np.percentile(ms, 99))]
            for name, ms in (("complex frame to pose (wanted 0.6)", whole), ("of it: spots", search),
                             ("of it: pairs and pose", match), ("for scale: np.max of the frame", brightest),
                             ("for scale: cv2.SimpleBlobDetector of the frame, no pose", blobs))]  # fmt: skip
    table(f"1280x720 complex frame without prior, {count} times, ms", ["", "median", "least", "99 %"], rows)


def alignment(count: int) -> None:
    """Print how often the mirror that was turned is found, with its sense and size."""
    rng = np.random.default_rng(77)
    rig = calibrate_mirrors(*board_views(views_of(), rng, PAIRS, 0.05), BOARD).rig
    right, certain, errors, false = 0, 0, [], 0
    for _ in range(count):
        mirror, size, way = int(rng.integers(4)), rng.uniform(0.5e-3, 1e-2), rng.uniform(0.0, 2.0 * np.pi)
        tilts = [(0.0, 0.0)] * 4
        tilts[mirror] = (size * np.cos(way), size * np.sin(way))
        found = check_alignment(rig, *board_views(views_of(tuple(tilts)), rng, 6, 0.05), BOARD)
        best = found.suspects[0]
        off = np.array([best.turn_rad, best.tilt_rad]) - tilts[mirror]
        right += best.mirror == mirror + 1 and bool(np.linalg.norm(off) < 0.2 * size)
        certain += found.certain
        errors.append(np.linalg.norm(off))
        false += check_alignment(rig, *board_views(views_of(), rng, 6, 0.05), BOARD).moved
    table(
        f"{count} random misalignments of one mirror, 0.5-10 mrad, 6 views of a board at 0.05 px",
        ["right mirror and sign", "told without doubt", "median error of the turn, mrad", "false alarms"],
        [[right, certain, float(1e3 * np.median(errors)), false]],
    )


def forms() -> None:
    """Print how far each form is off over the workspace."""
    grid = np.stack(np.meshgrid(np.linspace(-0.12, 0.12, 9), np.linspace(-0.09, 0.09, 7), np.linspace(0.4, 0.8, 9)), -1)
    camera = Camera.pinhole(1280, 960, 1000.0, 1000.0, 639.5, 479.5)
    rows = []
    for b in (0.06, 0.1, 0.15):
        rows += [
            [f"{1e3 * b:.0f}", one.name, *(f"{1e3 * v:.3f}" for v in (one.x_m, one.y_m, one.z_m)), one.epipolar_px]
            for one in form_errors(camera, Design(baseline_m=b), grid.reshape(-1, 3))
        ]
    m, length = plate_constants(Plate(thickness_m=1e-3))
    table(
        f"Forms of eq. (4), 400-800 mm: largest errors in mm (m {1e3 * m:.4f}, printed l {1e3 * length:.4f} mm)",
        ["b mm", "form", "x", "y", "z", "rows px"], rows,
    )  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a tenth of the runs")
    quick = parser.parse_args().quick
    warm_up()
    print(machine())
    speed(200 if quick else 2000)
    forms()
    points(3 if quick else 30, 400)
    table_one(400 if quick else 4000)
    alignment(5 if quick else 50)
    pairing("random poses", 1000 if quick else 10_000, random_pose)
    for title, level in (("poses with a spot on another view's", 90.0), ("the same, saturated", 500.0)):
        pairing(title, 20 if quick else 200, meeting_pose, level)


if __name__ == "__main__":
    main()
