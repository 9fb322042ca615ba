"""Poses: time from two frames in memory to pose with covariance, truth of the covariances, and the peers beside it.

Peers: the same matched spots triangulated by cv2.undistortPoints + cv2.triangulatePoints and aligned by Kabsch (numpy).
Projections come from cv2.projectPoints and from the simulated cell's own lens, not from the product's optics.
`--quick` takes a tenth of the repeats.
"""

from __future__ import annotations

import argparse
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation
from scipy.stats import chi2

from armsight.geometry import pose_difference, pose_from_quat
from armsight.measure.poses.from_spots import measure_spots
from armsight.measure.poses.kernels import pose as kernels
from armsight.measure.poses.pipeline import Measured, Setup, measure_pair, warm_up
from armsight.measure.poses.pose import UNKNOWN
from armsight.optics import SIDES, Camera, PackedRig, Rig, converged_rig
from armsight.records import PoseStatus, Spots, Target, spot_target, unmeasured_target
from armsight.store import rig_from_mapping
from armsight_sim.cells import LedCellOptions, led_cell
from bench import interleaved_ms, machine, table

Array = NDArray[np.float64]

CAMERA = Camera.pinhole(1280, 720, 1131.0, 1127.0, 643.5, 352.25, distortion=(-0.12, 0.05, 8e-4, -5e-4, -0.012))
RIG = converged_rig(CAMERA, CAMERA, 0.12, 0.08, -0.08)
TARGETS = {
    "3 lights, scalene": {"A": (-0.04, 0.0, 0.0), "B": (0.03, 0.035, 0.0), "C": (0.015, -0.03, 0.0)},
    "3 lights, isosceles": {"A": (-0.04, 0.0, 0.0), "B": (0.03, 0.032, 0.0), "C": (0.03, -0.032, 0.0)},
    "6 lights": {
        "A": (-0.04, 0.0, 0.0),
        "B": (0.03, 0.035, 0.0),
        "C": (0.015, -0.03, 0.0),
        "D": (0.06, 0.0, 0.02),
        "E": (-0.02, 0.05, 0.01),
        "F": (-0.05, -0.04, 0.0),
    },
}
SIGMA_PX = 0.05

DARK: dict[str, Any] = {"room": "dark", "pipeline": "ideal"}
"""The scenes of this script; those before ordinary backgrounds are in rooms.py and rooms_simulated.py."""


def see(points: Array) -> list[Array]:
    """Return the pixels (n, 2) of points (n, 3) in both cameras, by OpenCV."""
    out = []
    for side in SIDES:
        T, camera = RIG.T_rig_camera(side).inv(), RIG.camera(side)
        uv, _ = cv2.projectPoints(
            np.ascontiguousarray(points), T.rotation.as_rotvec(), T.translation, camera.matrix, camera.distortion
        )
        out.append(uv[:, 0])
    return out


def spots(uv: Array, rng: np.random.Generator) -> Spots:
    """Return noisy spots in an order of their own."""
    n = len(uv)
    order = rng.permutation(n)
    return Spots(
        uv_px=(uv + rng.normal(0.0, SIGMA_PX, uv.shape))[order],
        covariance_px2=np.tile(SIGMA_PX**2 * np.eye(2), (n, 1, 1)),
        peak=np.full(n, 100.0),
        size_px=np.full(n, 2.0),
        model=("gaussian",) * n,
    )


def random_pose(rng: np.random.Generator) -> RigidTransform:
    """Return a target before the cameras, tilted by 20 degrees or so."""
    return RigidTransform.from_components(
        rng.uniform([-0.1, -0.08, 0.5], [0.1, 0.08, 0.8]), Rotation.from_rotvec(rng.normal(0.0, 0.2, 3))
    )


def kabsch_numpy(points: Array, model: Array) -> tuple[Array, Array]:
    """Return R, t of the plain Kabsch alignment."""
    mean, origin = points.mean(axis=0), model.mean(axis=0)
    U, _, Vt = np.linalg.svd((points - mean).T @ (model - origin))
    R = U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))]) @ Vt
    return R, mean - R @ origin


def peer(left: Array, right: Array, model: Array, P: list[Array]) -> tuple[Array, Array]:
    """Return R, t by OpenCV's triangulation and Kabsch, of spots that are matched and named already."""
    flat = [
        cv2.undistortPoints(uv, RIG.camera(side).matrix, RIG.camera(side).distortion)[:, 0].T
        for side, uv in zip(SIDES, (left, right), strict=True)
    ]
    X = cv2.triangulatePoints(P[0], P[1], flat[0], flat[1])
    return kabsch_numpy((X[:3] / X[3]).T, model)


def projections(rig: Rig) -> list[Array]:
    """Return the (3, 4) projections of both cameras for normalised coordinates."""
    packed = PackedRig.of(rig)
    return [np.hstack([R, t[:, None]]) for R, t in zip(packed.R, packed.t, strict=True)]


def drawn_noise(repeats: int) -> None:
    """Coverage and errors where the spots' noise is drawn directly."""
    rows, P = [], projections(RIG)
    for name, places in TARGETS.items():
        rng, model = np.random.default_rng(1), np.array(list(places.values()))
        setup, q, ours, theirs, wrong = Setup(RIG, spot_target(places)), [], [], [], 0
        for _ in range(repeats):
            T = random_pose(rng)
            measured = measure_spots(setup, 0.0, *(spots(uv, rng) for uv in see(T.apply(model))))
            d = difference(measured, T)
            if d is None or np.linalg.norm(d[3:]) > 0.5:
                wrong += 1
                continue
            q.append(mahalanobis(measured, d))
            ours.append(d)
            R, t = peer(measured.left.uv_px, measured.right.uv_px, model, P)
            theirs.append(np.concatenate([t - T.translation, (Rotation.from_matrix(R) * T.rotation.inv()).as_rotvec()]))
        rows.append([name, len(q), wrong, *coverage(q), *ratios(ours, theirs)])
    header = ["target", "poses", "not given or wrong", "in 95 % ellipsoid", "mean chi2 / 6"]
    header += ["rms mm", "Kabsch / ML, mm", "rms mrad", "Kabsch / ML, mrad"]
    table(f"Poses, spot noise {SIGMA_PX} px drawn directly (aim: 93-97 % in the ellipsoids)", header, rows)


def frame_of_unmeasured(repeats: int) -> None:
    """Coverage of the frame after Pachidis (7)-(8)."""
    rng, q = np.random.default_rng(2), []
    model = np.array([[-0.05, 0.0, 0.0], [0.025, 0.045, 0.0], [0.025, -0.045, 0.0]])
    setup = Setup(RIG, unmeasured_target())
    for _ in range(repeats):
        T = random_pose(rng)
        measured = measure_spots(setup, 0.0, *(spots(uv, rng) for uv in see(T.apply(model))))
        d = difference(measured, T)
        if d is not None:
            q.append(mahalanobis(measured, d))
    header = ["poses", "in 95 % ellipsoid", "mean chi2 / 6"]
    table("Frame of three lights nobody has measured", header, [[len(q), *coverage(q)]])


def rendered(repeats: int) -> None:
    """Coverage through rendered frames of the simulated cells, full search and windows."""
    rows = []
    for name, cell in (
        ("webcams, LEDs of 2 px", led_cell(3, repeats, **DARK)),
        ("webcams, LEDs of 2 px, nothing goes wrong", led_cell(4, repeats, LedCellOptions(faults=False), **DARK)),
        (
            "webcams, flat lights of 12 mm",
            led_cell(5, max(repeats // 4, 50), LedCellOptions(diameter_m=0.012, faults=False), **DARK),
        ),
    ):
        setup = Setup(rig_from_mapping(cell.rig), target_of(cell.target))
        for tracking in (True, False):
            q, states, track, tracked = [], dict.fromkeys(PoseStatus, 0), None, 0
            for (left, right), (_, xyz, quat) in zip(cell.frames(), cell.truth, strict=True):
                measured = measure_pair(setup, left, right, track)
                track = measured.track if tracking else None
                states[measured.pose.status] += 1
                tracked += measured.tracked
                d = difference(measured, pose_from_quat(xyz, quat))
                if d is not None:
                    q.append(mahalanobis(measured, d))
            gross = int((np.array(q) > chi2.ppf(1.0 - 1e-7, 6)).sum())
            mode = "windows" if tracking else "whole frames"
            rows.append([name, mode, tracked, *states.values(), gross, *coverage(q)])
    header = ["cell", "search", "in windows", "ok", "position only", "lost", "gross errors", "in 95 % ellipsoid"]
    table("Poses through rendered frames", [*header, "mean chi2 / 6"], rows)


def target_of(mapping: dict[str, dict[str, tuple[float, float, float]]]) -> Target:
    """Return the target of a cell."""
    return spot_target(
        {name: tuple(map(float, xyz)) for name, xyz in mapping["spots_m"].items()},  # type: ignore[misc]
        diameter_m=mapping.get("diameter_m"),  # type: ignore[arg-type]
    )


def difference(measured: Measured, truth: RigidTransform) -> Array | None:
    """Return (dt, dw), None where no whole pose was given."""
    return pose_difference(measured.pose.pose, truth) if measured.pose.status is PoseStatus.OK else None


def mahalanobis(measured: Measured, d: Array) -> float:
    """Return the squared error in units of the claimed covariance."""
    return float(d @ np.linalg.solve(measured.pose.covariance, d))


def coverage(q: list[float]) -> list[object]:
    """Return the share within the 95 % ellipsoid and the mean over its expectation."""
    return [f"{100.0 * np.mean(np.array(q) < chi2.ppf(0.95, 6)):.1f} %", float(np.mean(q) / 6.0)]


def ratios(ours: list[Array], theirs: list[Array]) -> list[float]:
    """Return rms in mm, ratio of the peer's, rms in mrad, ratio of the peer's."""
    out = []
    for part in (slice(0, 3), slice(3, 6)):
        a, b = (np.sqrt((np.array(e)[:, part] ** 2).sum(axis=1).mean()) for e in (ours, theirs))
        out += [1e3 * float(a), float(b / a)]
    return out


def time(repeats: int) -> None:
    """Time from two frames in memory to pose, and of the parts."""
    cell = led_cell(1, 12, LedCellOptions(faults=False), **DARK)
    rig, target = rig_from_mapping(cell.rig), target_of(cell.target)
    setup, model = Setup(rig, target), np.array(list(target.xyz_m))
    pairs = [cell.pair(i) for i in range(12)]
    tracks, track = [], None
    for left, right in pairs:
        tracks.append(track)
        track = measure_pair(setup, left, right, track).track
    steps = [(pair, track) for pair, track in zip(pairs, tracks, strict=True) if track is not None][1:]
    turn = {"full": 0, "tracked": 0}

    def full() -> Measured:
        turn["full"] += 1
        return measure_pair(setup, *pairs[turn["full"] % len(pairs)])

    def tracked() -> Measured:
        turn["tracked"] += 1
        (left, right), track = steps[turn["tracked"] % len(steps)]
        measured = measure_pair(setup, left, right, track)
        if not measured.tracked:
            raise RuntimeError("a frame of the timing was not tracked")
        return measured

    seen = full()
    packed, n = setup.packed, len(model)
    uv = np.ascontiguousarray(np.stack([seen.left.uv_px, seen.right.uv_px], axis=1))
    cov = np.ascontiguousarray(np.stack([seen.left.covariance_px2, seen.right.covariance_px2], axis=1))
    P = projections(RIG)
    room = np.empty((n, 3)), np.empty((n, 3, 3)), np.empty((4, 4)), np.empty((6, 6)), np.zeros((n, 2, 2))
    flat, normal = np.zeros((n, 2)), np.array([0.0, 0.0, 1.0])
    times = interleaved_ms(
        {
            "two frames -> pose with covariance, no prior": full,
            "two frames -> pose with covariance, tracked": tracked,
            "match and pose of spots found": lambda: measure_spots(setup, 0.0, seen.left_seen, seen.right_seen),
            "compiled: points, maximum likelihood, covariance": lambda: kernels.solve_named(
                packed.arrays, (uv, cov), 0.06, (setup.model.xyz_m, flat, normal), UNKNOWN, *room
            ),
            "peer: OpenCV triangulation + Kabsch (matched, no covariance)": lambda: peer(
                seen.left.uv_px, seen.right.uv_px, model, P
            ),
            "reading both frames once (np.max)": lambda: [frame.image.max() for frame in pairs[0]],
        },
        repeats,
    )
    rows = [[name, *np.percentile(ms, [50, 5, 99]).tolist()] for name, ms in times.items()]
    table(
        "Time in ms, 1280x720, three lights (aim: 1.0 without prior, 0.3 tracked)", ["", "median", "5 %", "99 %"], rows
    )


def main() -> None:
    """Print all tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    quick = parser.parse_args().quick
    print(machine())
    warm_up()
    time(200 if quick else 2000)
    drawn_noise(200 if quick else 2000)
    frame_of_unmeasured(200 if quick else 2000)
    rendered(200 if quick else 2000)


if __name__ == "__main__":
    main()
