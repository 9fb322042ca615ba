"""Hand-eye calibration against OpenCV's seven methods: accuracy, time, honesty, refusals, and a real recording.

Run with --quick for a tenth of the trials. Simulated trials: noise of 0.05 degrees and 0.3 mm on the camera's poses.
"""

from __future__ import annotations

import argparse
import csv
from collections import Counter
from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

import bench
from armsight.calibrate.cameras import calibrate_camera
from armsight.calibrate.handeye import (
    PosePairs,
    Setup,
    calibrate_eye_in_hand,
    solve_pairs,
)
from armsight.calibrate.handeye.images import calibrate_from_views
from armsight.errors import ArmsightError, BadImage
from armsight.measure.boards import find_board
from armsight.records import TargetKind, board_target
from armsight.units import DEG, MM
from closed_forms import CLOSED_FORMS

SIGMA_RAD, SIGMA_M = 0.05 * DEG, 0.3 * MM
HAND_EYE = {
    "TSAI": cv2.CALIB_HAND_EYE_TSAI,
    "PARK": cv2.CALIB_HAND_EYE_PARK,
    "HORAUD": cv2.CALIB_HAND_EYE_HORAUD,
    "ANDREFF": cv2.CALIB_HAND_EYE_ANDREFF,
    "DANIILIDIS": cv2.CALIB_HAND_EYE_DANIILIDIS,
}
ROBOT_WORLD = {
    "SHAH": cv2.CALIB_ROBOT_WORLD_HAND_EYE_SHAH,
    "LI": cv2.CALIB_ROBOT_WORLD_HAND_EYE_LI,
}
Simulated = tuple[RigidTransform, RigidTransform, RigidTransform, RigidTransform]


def turn(rng: np.random.Generator, limit: float, n: int) -> Rotation:
    return Rotation.from_rotvec(rng.uniform(-limit, limit, (n, 3)))


def simulate(
    rng: np.random.Generator,
    n: int,
    *,
    tilt: float = 0.5,
    axis: np.ndarray | None = None,
    robot_rad: float = 0.0,
    robot_m: float = 0.0,
) -> Simulated:
    """Return T_flange_camera, T_base_target, noisy T_base_flange (n), noisy T_camera_target (n)."""
    X = RigidTransform.from_components(
        np.array([0.03, -0.06, 0.09]) + rng.normal(0, 0.02, 3), Rotation.from_rotvec(rng.normal(0, 0.4, 3))
    )
    Z = RigidTransform.from_components(
        np.array([0.6, 0.1, 0.0]) + rng.normal(0, 0.1, 3), Rotation.from_rotvec(rng.normal(0, 0.4, 3))
    )
    facing = Rotation.from_rotvec([np.pi, 0, 0])
    if axis is None:
        roll = Rotation.from_rotvec(np.outer(rng.uniform(-1.6 * tilt, 1.6 * tilt, n), [0, 0, 1]))
        R = facing * turn(rng, tilt, n) * roll
    else:
        R = facing * Rotation.from_rotvec(np.outer(rng.uniform(-tilt, tilt, n), axis))
    t = np.stack([rng.uniform(-0.12, 0.12, n), rng.uniform(-0.08, 0.08, n), rng.uniform(0.45, 0.8, n)], axis=1)
    B = RigidTransform.from_components(t, R)
    A = Z * B.inv() * X.inv()
    return X, Z, noisy(rng, A, robot_m, robot_rad), noisy(rng, B, SIGMA_M, SIGMA_RAD)


def noisy(rng: np.random.Generator, T: RigidTransform, sigma_m: float, sigma_rad: float) -> RigidTransform:
    n = len(T)
    return RigidTransform.from_components(
        T.translation + rng.normal(0, 1, (n, 3)) * sigma_m,
        Rotation.from_rotvec(rng.normal(0, 1, (n, 3)) * sigma_rad) * T.rotation,
    )


def pairs_of(A: RigidTransform, B: RigidTransform) -> PosePairs:
    return PosePairs(T_base_flange=A, T_camera_target=B, names=tuple(f"row {i + 1}" for i in range(len(A))))


def opencv(A: RigidTransform, B: RigidTransform) -> dict[str, Callable[[], tuple[np.ndarray, np.ndarray]]]:
    """Return OpenCV's seven methods as functions that give R, t of T_flange_camera."""
    MA, MB, MI = A.as_matrix(), B.as_matrix(), A.inv().as_matrix()
    RA, tA = [M[:3, :3] for M in MA], [M[:3, 3:] for M in MA]
    RB, tB = [M[:3, :3] for M in MB], [M[:3, 3:] for M in MB]
    RI, tI = [M[:3, :3] for M in MI], [M[:3, 3:] for M in MI]

    def hand_eye(method: int) -> tuple[np.ndarray, np.ndarray]:
        R, t = cv2.calibrateHandEye(RA, tA, RB, tB, method=method)
        return R, t.ravel()

    def robot_world(method: int) -> tuple[np.ndarray, np.ndarray]:
        _, _, R, t = cv2.calibrateRobotWorldHandEye(RB, tB, RI, tI, method=method)
        return R.T, (-R.T @ t).ravel()

    out: dict[str, Callable[[], tuple[np.ndarray, np.ndarray]]] = {}
    out |= {f"OpenCV {name}": lambda m=m: hand_eye(m) for name, m in HAND_EYE.items()}
    out |= {f"OpenCV {name}": lambda m=m: robot_world(m) for name, m in ROBOT_WORLD.items()}
    return out


def errors(R: np.ndarray, t: np.ndarray, X: RigidTransform) -> tuple[float, float]:
    angle = Rotation.from_matrix(R @ X.rotation.as_matrix().T).magnitude()
    return float(np.linalg.norm(t - X.translation)) / MM, float(angle) / DEG


def accuracy(trials: int) -> None:
    exact = np.array([SIGMA_M**2, SIGMA_RAD**2, 0.0])
    for n in (10, 20, 50):
        found: dict[str, list[tuple[float, float]]] = {}
        bound = []
        for trial in range(trials):
            rng = np.random.default_rng([n, trial])
            X, _, A, B = simulate(rng, n)
            arrays = pairs_of(A, B).arrays(Setup.EYE_IN_HAND)
            s = solve_pairs(arrays, Setup.EYE_IN_HAND)
            found.setdefault("armsight", []).append(errors(s.R_X, s.t_x, X))
            s = solve_pairs(arrays, Setup.EYE_IN_HAND, variances=exact)
            found.setdefault("armsight, noise known", []).append(errors(s.R_X, s.t_x, X))
            draws = rng.multivariate_normal(np.zeros(6), s.C[:6, :6], 50)
            bound.append(
                np.stack([np.linalg.norm(draws[:, :3], axis=1) / MM, np.linalg.norm(draws[:, 3:], axis=1) / DEG], 1)
            )
            for name, form in CLOSED_FORMS.items():
                RX, tX, _, _ = form(arrays)
                found.setdefault(f"armsight's {name}, start only", []).append(errors(RX, tX, X))
            for name, run in opencv(A, B).items():
                found.setdefault(name, []).append(errors(*run(), X))
        limit = np.median(np.concatenate(bound), axis=0)
        rows = []
        for name, values in found.items():
            m = np.median(values, axis=0)
            rows.append([name, float(m[0]), float(m[0] / limit[0]), float(m[1]), float(m[1] / limit[1])])
        bench.table(
            f"{n} poses, {trials} trials: median errors of T_flange_camera and their ratio to the Cramer-Rao bound "
            f"({limit[0]:.4f} mm, {limit[1]:.5f} degrees)",
            ["method", "mm", "x bound", "degrees", "x bound"],
            rows,
        )


def timing(repeats: int) -> None:
    rows = []
    for n in (10, 20, 50):
        _, _, A, B = simulate(np.random.default_rng(7), n)
        pairs = pairs_of(A, B)
        arrays = pairs.arrays(Setup.EYE_IN_HAND)
        runs: dict[str, Callable[[], object]] = {
            "armsight fit with both noises": lambda arrays=arrays: solve_pairs(arrays, Setup.EYE_IN_HAND),
            "armsight with all checks": lambda pairs=pairs: calibrate_eye_in_hand(pairs),
        }
        runs |= {name: run for name, run in opencv(A, B).items() if name in ("OpenCV PARK", "OpenCV SHAH")}
        times = {name: float(np.median(t)) for name, t in bench.interleaved_ms(runs, repeats).items()}
        park = times["OpenCV PARK"]
        rows += [[n, name, ms, ms / park] for name, ms in times.items()]
    bench.table("Time of one calibration", ["poses", "method", "median ms", "over OpenCV PARK"], rows)


def honesty(trials: int) -> None:
    rows = []
    for robot_rad, robot_m in ((0.0, 0.0), (0.05 * DEG, 0.1 * MM)):
        for n in (10, 20, 50):
            inside, noise = [], []
            for trial in range(trials):
                rng = np.random.default_rng([n, trial, 1])
                X, Z, A, B = simulate(rng, n, robot_rad=robot_rad, robot_m=robot_m)
                result = calibrate_eye_in_hand(pairs_of(A, B))
                std = np.sqrt(np.diag(result.covariance.matrix))
                off = []
                for got, true in ((result.T_parent_camera, X), (result.T_parent_target, Z)):
                    off += [got.translation - true.translation, (got.rotation * true.rotation.inv()).as_rotvec()]
                inside.append(np.abs(np.concatenate(off)) < 1.96 * std)
                noise.append(
                    (result.noise.translation_m.size, result.noise.camera_rad.size, result.noise.robot_rad.size)
                )
            share = 100.0 * np.mean(inside, axis=0)
            middle = np.median(noise, axis=0)
            rows.append(
                [
                    f"{robot_m / MM:.1f} mm, {robot_rad / DEG:.2f} deg",
                    n,
                    float(share.mean()),
                    float(share.min()),
                    float(share.max()),
                    float(middle[0] / MM),
                    float(middle[1] / DEG),
                    float(middle[2] / DEG),
                ]
            )
    bench.table(
        f"95 % intervals that hold the truth, of 12 parameters, {trials} trials; estimated noises (median)",
        ["robot's noise", "poses", "mean %", "least %", "most %", "translation mm", "camera deg", "robot deg"],
        rows,
    )


def spoilt(kind: str, trial: int) -> tuple[PosePairs, set[str]]:
    """Return a set with one fault, and the rows that are outliers."""
    n = (10, 20, 50)[trial % 3]
    rng = np.random.default_rng([trial, len(kind), 2])
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    options = {"one axis": {"axis": axis}, "turns of +-2 degrees": {"tilt": 2 * DEG}}.get(kind, {})
    _, _, A, B = simulate(rng, n, **options)  # type: ignore[arg-type]
    wrong: set[str] = set()
    MA, MB = A.as_matrix().copy(), B.as_matrix().copy()
    if kind == "shuffled":
        MB = MB[rng.permutation(n)]
    elif kind == "one row off":
        MB = np.roll(MB, 1 if trial % 2 else -1, axis=0)
    elif kind == "robot in mm":
        MA[:, :3, 3] *= 1000.0
    elif kind == "camera in mm":
        MB[:, :3, 3] *= 1000.0
    elif kind == "both in mm":
        MA[:, :3, 3] *= 1000.0
        MB[:, :3, 3] *= 1000.0
    elif kind == "robot 1000 times too small":
        MA[:, :3, 3] /= 1000.0
    elif kind == "camera inverted":
        MB = B.inv().as_matrix()
    elif kind == "robot inverted":
        MA = A.inv().as_matrix()
    elif kind == "20 % gross outliers":
        bad = rng.choice(n, n // 5, replace=False)
        wrong = {f"row {i + 1}" for i in bad}
        for i in bad:
            w, d = rng.normal(size=3), rng.normal(size=3)
            w *= rng.uniform(2.0, 40.0) * DEG / np.linalg.norm(w)
            MB[i, :3, :3] = Rotation.from_rotvec(w).as_matrix() @ MB[i, :3, :3]
            MB[i, :3, 3] += d * rng.uniform(0.01, 0.2) / np.linalg.norm(d)
    return pairs_of(RigidTransform.from_matrix(MA), RigidTransform.from_matrix(MB)), wrong


def refusals(trials: int, good: int) -> None:
    kinds = [
        "one axis", "turns of +-2 degrees", "shuffled", "one row off", "robot in mm", "camera in mm", "both in mm",
        "robot 1000 times too small", "camera inverted", "robot inverted", "20 % gross outliers",
    ]  # fmt: skip
    rows = []
    for kind in kinds:
        said: Counter[str] = Counter()
        recognised = 0
        for trial in range(trials):
            pairs, wrong = spoilt(kind, trial)
            try:
                result = calibrate_eye_in_hand(pairs)
            except ArmsightError as error:
                recognised += not wrong
                said[f"{type(error).__name__}: {error.cause[:46]} ..."] += 1
            else:
                exact = {one.name for one in result.rejected_pairs} == wrong
                recognised += bool(wrong) and exact
                said["left out exactly these rows" if exact and wrong else "accepted"] += 1
        rows.append([kind, trials, 100.0 * recognised / trials, said.most_common(1)[0][0]])
    alarms = 0
    for trial in range(good):
        try:
            result = calibrate_eye_in_hand(spoilt("good", trial)[0])
            alarms += bool(result.rejected_pairs) or bool(result.scale and result.scale.wrong)
        except ArmsightError:
            alarms += 1
    rows.append(["good: false alarms", good, 100.0 * alarms / good, "row left out, scale doubted or refused"])
    bench.table("What is wrong with the data", ["fault", "sets", "recognised %", "most often said"], rows)


def weights(trials: int) -> None:
    """Pairs known unequally well (tests/truth/handeye_far_views.py, its own projection): weighed or all alike."""

    def as_given(C: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        return C

    def boast(C: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        C = C.copy()
        C[:3] *= 1e-4
        return C

    cases: list[tuple[str, int, Callable[[np.ndarray, np.random.Generator], np.ndarray]]] = [
        ("right", 10, as_given),
        ("right", 20, as_given),
        ("right", 40, as_given),
        ("all 3 times too small", 20, lambda C, rng: C / 9.0),
        ("all 3 times too large", 20, lambda C, rng: C * 9.0),
        ("3 of 20 are 100 times too small", 20, boast),
        ("those of other pairs", 20, lambda C, rng: C[rng.permutation(len(C))]),
        ("one for all", 20, lambda C, rng: np.tile(np.diag([1e-8] * 3 + [1e-7] * 3), (len(C), 1, 1))),
    ]
    rows: list[list[object]] = []
    for name, n, change in cases:
        for weighed in (True, False):
            if not weighed and name != "right":
                continue
            moved, turned, inside, out = [], [], [], 0
            for trial in range(trials):
                world = bench.test_scene("handeye_far_views").far_views(trial, n)
                covariance = change(world.covariance, np.random.default_rng(trial)) if weighed else None
                pairs = replace(pairs_of(world.robot, world.camera), camera_covariance=covariance)
                result = calibrate_eye_in_hand(pairs)
                off = []
                for got, true in ((result.T_parent_camera, world.X), (result.T_parent_target, world.Z)):
                    off += [got.translation - true.translation, (got.rotation * true.rotation.inv()).as_rotvec()]
                moved.append(np.linalg.norm(off[0]) / MM)
                turned.append(np.linalg.norm(off[1]) / DEG)
                inside.append(np.abs(np.concatenate(off)) < 1.96 * np.sqrt(np.diag(result.covariance.matrix)))
                out += len(result.rejected_pairs)
            share = 100.0 * np.mean(inside, axis=0)
            rms = [float(np.sqrt(np.mean(np.square(x)))) for x in (moved, turned)]
            text = f"covariances {name}" if weighed else "not given: all alike"
            rows.append([text, n, *rms, float(share.mean()), float(share.min()), out / (n * trials)])
    bench.table(
        f"Pairs from 0.4 to 1.8 m, far ones worse, {trials} trials: error of T_flange_camera, 95 % intervals of 12 "
        "parameters that hold",
        ["camera's poses", "pairs", "mm RMS", "degrees RMS", "mean %", "least %", "left out, share"],
        rows,
    )


def left_out(
    A: RigidTransform, B: RigidTransform, solve: Callable[[RigidTransform, RigidTransform], RigidTransform]
) -> tuple[float, float]:
    """Return RMS of position (mm) and angle (deg) at the target when each row is predicted from the others.

    T_base_target comes from the others' own mean: OpenCV's hand-eye methods give none.
    """
    moves, turns = [], []
    for i in range(len(A)):
        rest = np.delete(np.arange(len(A)), i)
        X = solve(A[rest], B[rest])
        Z = (A[rest] * X * B[rest]).mean()
        predicted = X.inv() * A[i].inv() * Z
        moves.append(np.linalg.norm(predicted.translation - B[i].translation) / MM)
        turns.append((predicted.rotation.inv() * B[i].rotation).magnitude() / DEG)
    return float(np.sqrt(np.mean(np.square(moves)))), float(np.sqrt(np.mean(np.square(turns))))


def real() -> None:
    folder = bench.DATA / "dots_10x10_handeye"
    if not folder.exists():
        print("\nskipped: the recording dots_10x10_handeye is not here")
        return
    board = board_target(TargetKind.CIRCLES, 10, 10, 0.0254)
    views, robot = [], []
    with (folder / "robot_poses.csv").open() as file:
        for row in csv.DictReader(file):
            image = cv2.imread(str(folder / "images" / row["file"]), cv2.IMREAD_GRAYSCALE)
            try:
                views.append(find_board(image, board, source=row["file"]))
            except BadImage as error:
                print(error)
                continue
            t = [float(row[k]) for k in ("x_m", "y_m", "z_m")]
            robot.append(
                RigidTransform.from_components(t, Rotation.from_quat([float(row[k]) for k in ("qx", "qy", "qz", "qw")]))
            )
    camera = calibrate_camera(views, board).camera
    ours = calibrate_from_views(views, robot, camera, board, Setup.EYE_IN_HAND).result
    A, B = ours.pairs.T_base_flange, ours.pairs.T_camera_target
    pairs_result = calibrate_eye_in_hand(ours.pairs, target_pitch_m=board.pitch_m)
    scale = ours.scale
    if scale is None:
        raise RuntimeError("this recording's scale was always seen")
    pitch, uncertainty = 25.4 * scale.factor, 25.4 * scale.std
    M = B.as_matrix().copy()
    M[:, :3, 3] *= scale.factor
    scaled = calibrate_eye_in_hand(pairs_of(A, RigidTransform.from_matrix(M)))
    alike = calibrate_eye_in_hand(replace(ours.pairs, camera_covariance=None))
    rows: list[list[object]] = [
        ["armsight, from images", ours.loo_rms_m / MM, ours.loo_rms_rad / DEG],
        ["armsight, from poses all alike", alike.loo_rms_m / MM, alike.loo_rms_rad / DEG],
        ["armsight, from poses", pairs_result.loo_rms_m / MM, pairs_result.loo_rms_rad / DEG],
        ["armsight, target's scale as found", scaled.loo_rms_m / MM, scaled.loo_rms_rad / DEG],
    ]
    for name in [f"OpenCV {m}" for m in (*HAND_EYE, *ROBOT_WORLD)]:

        def solve(a: RigidTransform, b: RigidTransform, name: str = name) -> RigidTransform:
            R, t = opencv(a, b)[name]()
            return RigidTransform.from_components(t, Rotation.from_matrix(R))

        rows.append([name, *left_out(A, B, solve)])
    rows.append(
        ["robot taken as exact, reprojection only", *robot_exact(views, board, camera, A, B, ours.T_parent_camera)]
    )
    bench.table("Real recording, 15 poses: left-out error at the target", ["method", "mm RMS", "degrees RMS"], rows)
    print(f"\nscale: {scale.factor:.5f} +- {scale.std:.5f}, a pitch of {pitch:.2f} +- {uncertainty:.2f} mm")
    print(ours.verdict, *ours.advice, sep="\n")


def robot_exact(views, board, camera, A, B, X0) -> tuple[float, float]:  # type: ignore[no-untyped-def]
    """Return the left-out error of the usual reprojection, the robot believed to the last digit."""
    from scipy.optimize import least_squares

    def unpack(x: np.ndarray) -> tuple[RigidTransform, RigidTransform]:
        return tuple(  # type: ignore[return-value]
            RigidTransform.from_components(x[k : k + 3], Rotation.from_rotvec(x[k + 3 : k + 6])) for k in (0, 6)
        )

    moves, turns = [], []
    for i in range(len(A)):
        rest = [k for k in range(len(A)) if k != i]
        Z0 = (A[rest] * X0 * B[rest]).mean()

        def misfit(x: np.ndarray, rest: list[int] = rest) -> np.ndarray:
            X, Z = unpack(x)
            out = []
            for k in rest:
                p = (X.inv() * A[k].inv() * Z).apply(board.xyz_m[views[k].index])
                out.append((camera.project(p) - views[k].uv_px).ravel())
            return np.concatenate(out)

        start = np.concatenate([X0.translation, X0.rotation.as_rotvec(), Z0.translation, Z0.rotation.as_rotvec()])
        X, Z = unpack(least_squares(misfit, start, x_scale="jac").x)
        predicted = X.inv() * A[i].inv() * Z
        moves.append(np.linalg.norm(predicted.translation - B[i].translation) / MM)
        turns.append((predicted.rotation.inv() * B[i].rotation).magnitude() / DEG)
    return float(np.sqrt(np.mean(np.square(moves)))), float(np.sqrt(np.mean(np.square(turns))))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a tenth of the trials")
    parser.add_argument("--only", choices=["accuracy", "timing", "honesty", "refusals", "real", "weights"])
    options = parser.parse_args()
    share = 10 if options.quick else 1
    print(f"{bench.machine()}, OpenCV {cv2.__version__}")
    parts: dict[str, Callable[[], None]] = {
        "real": real,
        "timing": lambda: timing(200 // share),
        "accuracy": lambda: accuracy(1000 // share),
        "refusals": lambda: refusals(200 // share, 1000 // share),
        "honesty": lambda: honesty(1000 // share),
        "weights": lambda: weights(200 // share),
    }
    for name, part in parts.items():
        if options.only in (None, name):
            part()


if __name__ == "__main__":
    main()
