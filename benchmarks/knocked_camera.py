"""Which camera was knocked: how often the right one is named, and how often a good rig raises an alarm.

The world (tests/truth/camera_ring.py) projects by itself: six lights at 1.3 m, 0.05 px, a fifth of the sights hidden.
Every run's rig file is drawn from the covariance of a calibration, lenses too: 60 boards that two cameras or more see,
and 20 that fill each one's picture, 0.05 px a corner. Then one camera is turned about its own centre, or shifted, in a
direction drawn. A knocked run goes from its spots, with two reflections, through the naming; it counts as right where
the first camera that is left out is that one. Good runs, and those of a knock during the run (--at), are of spots named
as they are, which is quicker; --search names those too.

    python benchmarks/knocked_camera.py                     # 1,000 good runs and 2 x 200 knocks for 3, 4 and 8 cameras
    python benchmarks/knocked_camera.py --good 100 --knocks 20 --views 4
    python benchmarks/knocked_camera.py --at 0.5 0.67       # knocks half way, and at two thirds of the run
    python benchmarks/knocked_camera.py --bound 20          # what the data can tell, whatever is done with them
"""

from __future__ import annotations

import argparse
import sys
from functools import cache
from pathlib import Path

import cv2
import numpy as np
from scipy.stats import beta, chi2, ncx2

from armsight.measure.consistency.run_of_cameras import CamerasCheck
from armsight.measure.poses.outcome import Measured
from armsight.measure.poses.pose import no_points, solve_pose
from armsight.measure.poses.setup import Setup, rig_slack_px
from armsight.measure.poses.sights import Sights
from armsight.measure.poses.solving import named_spots
from armsight.measure.poses.views import measure_views
from armsight.optics import Rig, moved_rig
from armsight.records import NamedCovariance, spot_target
from bench import machine, table

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from tests.truth import camera_ring as world
from tests.truth import ring_of_cameras as boards
from tests.truth import test_views as scene

LETTERS = "ABCDEF"
CORNER_PX = 0.05
MOMENTS = 60
KNOCKS = (("turned by 0.1 degrees", (0.1, 0.0)), ("shifted by 0.5 mm", (0.0, 0.5)))


@cache
def calibrated(views: int, seed: int = 1) -> tuple[Rig, np.ndarray]:
    """Return the true rig of so many cameras and the covariance of a calibration, in the order of Rig.parameters."""
    rng, ring = np.random.default_rng(seed), world.ring(views)
    k = np.tile([world.FOCAL, world.FOCAL, *world.CENTRE, 0.0, world.K1, 0.0, 0.0, 0.0, 0.0], (views, 1))
    T = np.tile(np.eye(4), (views, 1, 1))
    T[:, :3, :3], T[:, :3, 3] = ring.R, ring.t
    T = np.linalg.inv(T)
    poses, seen = [], []
    while len(poses) < 60 * (views > 1) + 20 * views:
        near = views == 1 or len(poses) >= 60
        of = max(len(poses) - 60, 0) // 20 if near else rng.integers(views)
        turn = rng.uniform(-0.5, 0.5, 3)
        if views == 2 and not near:  # 115 degrees apart: only a board that faces neither is seen by both
            turn[1] += 2.0 * of - 1.0
        own = boards.moved(np.eye(4), np.r_[0, 0, 0, turn])
        middle = [*rng.uniform(-0.1, 0.1, 2), rng.uniform(0.4, 0.6)] if near else [*rng.uniform(-0.5, 0.5, 2), 1.2]
        own[:3, 3] = middle - own[:3, :3] @ boards.BOARD.xyz_m.mean(axis=0)
        pose = T[of] @ own
        here = [s == of for s in range(views)] if near else boards.visible(k, T, pose)
        if sum(here) >= (1 if near else 2):
            poses.append(pose)
            seen.append(here)
    full = boards.Ring(k=k, T=T, boards=np.array(poses), seen=np.array(seen)).bound(CORNER_PX)
    return scene.setup_of(ring).rig, full


def drawn(views: int, rng: np.random.Generator) -> Setup:
    """Return the setup of a rig file as a calibration may have left it, with its covariance."""
    rig, C = calibrated(views)
    covariance = NamedCovariance(names=rig.parameters, matrix=C)
    told = moved_rig(Rig(cameras=rig.cameras, covariance=covariance), rng.multivariate_normal(np.zeros(len(C)), C))
    lights = spot_target({name: tuple(x) for name, x in zip(LETTERS, world.LIGHTS.tolist(), strict=True)})
    found = Rig(cameras=told.cameras, covariance=covariance)
    return Setup(found, lights, slack_px=rig_slack_px(found))


def knocked(ring: world.Ring, k: int, rng: np.random.Generator, turn_deg: float, shift_mm: float) -> world.Ring:
    """Return the world with one camera turned about its own centre and shifted, each in a direction drawn."""
    way, axis = (one / np.linalg.norm(one) for one in rng.normal(size=(2, 3)))
    turn = cv2.Rodrigues(np.radians(turn_deg) * axis)[0]
    R, t = ring.R.copy(), ring.t.copy()
    R[k], t[k] = turn @ R[k], turn @ t[k] + 1e-3 * shift_mm * way
    return world.Ring(R, t)


def by_search(setup: Setup, true: world.Ring, t_s: float, rng: np.random.Generator) -> Measured:
    """Return a moment as it is measured from spots."""
    seen = world.look(true, world.LIGHTS, world.pose(rng), rng, hidden=0.2, reflections=2)
    return measure_views(setup, t_s, [scene.spots(uv) for uv in seen.uv])


def by_name(setup: Setup, true: world.Ring, t_s: float, rng: np.random.Generator) -> Measured:
    """Return a moment whose spots are named as they are."""
    T = world.pose(rng)
    seen = world.look(true, world.LIGHTS, T, rng, hidden=0.2)
    order = [np.argsort(light) for light in seen.light]
    spots = tuple(scene.spots(uv[at]) for uv, at in zip(seen.uv, order, strict=True))
    rows = np.full((len(LETTERS), len(spots)), -1, np.intp)
    for s, (light, at) in enumerate(zip(seen.light, order, strict=True)):
        rows[light[at], s] = np.arange(len(at))
    names, views = Sights.of(setup, spots).named(setup, rows, T)
    solved = solve_pose(setup.packed, t_s, named_spots(setup, names, views), limit=np.inf, start=views.start)
    sights = rows[(rows >= 0).any(axis=1)] >= 0
    return Measured(pose=solved.pose, points=no_points(), spots=spots, names=names, seen=spots, sights=sights)


def first_named(
    views: int, seed: int, knock: tuple[float, float] | None, *, search: bool, at: float = 0.0
) -> tuple[int, list[str], int]:
    """Return which camera was knocked, the first that were left out, and after how many moments that was.

    at: share of the run before the knock; up to three moments later, so that runs differ in where in a stretch it is.
    """
    rng = np.random.default_rng(seed)
    setup, true, k = drawn(views, rng), world.ring(views), seed % views
    before = true
    if knock is not None:
        true = knocked(true, k, rng, *knock)
    check, moment = CamerasCheck(setup), by_search if search else by_name
    first = round(at * MOMENTS) + seed // views % 4 if at else 0
    for i in range(MOMENTS):
        check.add(moment(setup, before if i < first else true, 0.5 * i, rng))
        if check.left_out:
            return k, list(check.left_out[0].names), i + 1 - first
    found = check.finish()
    named = list(check.left_out[0].names) if check.left_out else []
    return k, named if named or found.verdict == "ok" else [found.verdict], MOMENTS - first


@cache
def steps(views: int) -> list[tuple[Rig, Rig, float]]:
    """Return the rig with each number of its calibration moved up and down, and how far apart these are."""
    rig, C = calibrated(views)
    sizes = 0.1 * np.sqrt(np.diag(C))
    ways = sizes[:, None] * np.eye(len(C))
    return [(moved_rig(rig, way), moved_rig(rig, -way), 2.0 * size) for way, size in zip(ways, sizes, strict=True)]


def seen_by(rig: Rig, points: np.ndarray, knock: np.ndarray | None = None) -> np.ndarray:
    """Return pixels (v, n, 2); knock (v, 6): shift and turn of each camera about its own centre, in its axes."""
    T = [boards.matrix(one) for one in (np.zeros((len(rig.cameras), 6)) if knock is None else knock)]
    own = [one.T_rig_camera.inv().as_matrix() for one in rig.cameras]
    every = zip(rig.cameras, T, own, strict=True)
    return np.array([boards.pixels(np.asarray(one.camera.intrinsics), D @ S, points) for one, D, S in every])


def information(views: int, rng: np.random.Generator, each: int = 4) -> np.ndarray:
    """Return what a run tells of all cameras' knocks (6 v, 6 v), the target's poses and the rig's numbers unknown.

    each: so many moments are taken as alike.
    """
    rig, C = calibrated(views)
    q = len(C)
    total = np.zeros((q + 6 * views, q + 6 * views))
    for _ in range(MOMENTS // each):
        pose = world.pose(rng)
        X = world.LIGHTS @ pose[:3, :3].T + pose[:3, 3]
        there = np.isfinite(world.ring(views).pixels(X)[..., 0]).T & (rng.random((views, len(X))) >= 0.2)
        columns = [(seen_by(up, X) - seen_by(down, X)) / apart for up, down, apart in steps(views)]
        ways = 1e-6 * np.eye(6 * views).reshape(-1, views, 6)
        columns += [(seen_by(rig, X, way) - seen_by(rig, X, -way)) / 2e-6 for way in ways]
        for way in 1e-6 * np.eye(6):
            ends = [X @ boards.matrix(sign * way)[:3, :3].T + sign * way[:3] for sign in (1.0, -1.0)]
            columns.append((seen_by(rig, ends[0]) - seen_by(rig, ends[1])) / 2e-6)
        J = np.array(columns).transpose(1, 2, 3, 0)[there].reshape(-1, len(columns)) / scene.SIGMA_PX
        J, of_pose = J[:, :-6], J[:, -6:]
        J = J - of_pose @ np.linalg.lstsq(of_pose, J, rcond=None)[0]
        total += each * J.T @ J
    known = total[:q, :q] + np.linalg.inv(C)
    return np.asarray(total[q:, q:] - total[q:, :q] @ np.linalg.solve(known, total[:q, q:]))


def told(views: int, what: str, knock: tuple[float, float], runs: int) -> list[object]:
    """Return one row of what the data can tell: how many deviations a knock is from none, and from another camera's.

    A test of six numbers at 1e-5 misses a knock of 9 deviations once in a thousand.
    """
    found = []
    for i in range(runs):
        rng, k = np.random.default_rng(1000 * views + i), i % views
        way, axis = (one / np.linalg.norm(one) for one in rng.normal(size=(2, 3)))
        x = np.r_[1e-3 * knock[1] * way, np.radians(knock[0]) * axis]
        blocks = information(views, rng).reshape(views, 6, views, 6)
        own, rest = blocks[k, :, k], []
        for other in (s for s in range(views) if s != k):
            across = blocks[k, :, other]
            rest.append(x @ (own - across @ np.linalg.solve(blocks[other, :, other], across.T)) @ x)
        found.append([np.sqrt(x @ own @ x), np.sqrt(min(rest))])
    least, median = np.min(found, axis=0), np.median(found, axis=0)
    missed = ncx2.cdf(chi2.isf(1e-5, 6), 6, np.array(found)[:, 0] ** 2).mean()
    return [views, what, runs, *np.stack([least, median], axis=1).ravel().tolist(), float(missed)]


def row(
    views: int, what: str, knock: tuple[float, float] | None, runs: int, *, search: bool, at: float = 0.0
) -> list[object]:
    """Return one row of the table."""
    done = [first_named(views, 1000 * views + i, knock, search=search, at=at) for i in range(runs)]
    told = [one for one in done if one[1]]
    right = sum(named == [f"c{k}"] for k, named, _ in told)
    wrong = len(told) - right if knock else len(told)
    most = 100.0 * float(beta.ppf(0.95, wrong + 1, runs - wrong)) if wrong < runs else 100.0
    after = float(np.median([n for _, _, n in told])) if told else ""
    share: object = 100.0 * right / runs if knock else ""
    out = [views, what, runs, share, wrong, most, after]
    print(*out, sep=" | ", flush=True)  # each as it comes: a thousand runs of eight cameras take an hour
    return out


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--good", type=int, default=1000)
    parser.add_argument("--knocks", type=int, default=200)
    parser.add_argument("--views", type=int, nargs="+", default=[3, 4, 8])
    parser.add_argument("--at", type=float, nargs="+", default=[0.0, 0.5], help="shares of the run before the knock")
    parser.add_argument("--search", action="store_true")
    parser.add_argument("--bound", type=int, default=0, help="of so many knocks each, what the data can tell at all")
    args = parser.parse_args()
    print(machine())
    if args.bound:
        head = ["cameras", "what happened", "knocks", "from none, least", "median", "from another camera's, least"]
        rows = [told(views, *kind, args.bound) for views in args.views for kind in KNOCKS]
        table("Deviations that a knock is off, by the data", [*head, "median", "missed at 1e-5"], rows)
        return
    head = ["cameras", "what happened", "runs", "right camera, %", "wrong or alarm", "at most, % (95 %)", "moments"]
    rows = []
    for views in args.views:
        deviations = np.sqrt(np.diag(calibrated(views)[1]))[10 * views :].reshape(-1, 6)
        place, turn = 1e3 * deviations[:, :3].max(), np.degrees(deviations[:, 3:].max())
        print(
            f"{views} cameras: places of the calibration to {place:.3f} mm and {turn:.4f} degrees or better", flush=True
        )
        for what, knock in KNOCKS:
            for at in args.at if args.knocks else ():
                when = f", after {at:.0%}" if at else ""
                rows.append(row(views, f"{what}{when}", knock, args.knocks, search=args.search or not at, at=at))
        if args.good:
            rows.append(row(views, "nothing", None, args.good, search=args.search))
    table("Knocked cameras", head, rows)


if __name__ == "__main__":
    main()
