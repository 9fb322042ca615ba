"""Planted faults: frames that were lost, as trackers, cameras and controllers write them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from fresh_judge import Try, blamed, fault, forward, healthy, posed, read, tipped
from fresh_world import ELBOW, SEVEN, SIDEWAYS, Array, Chain, columns, joints, motion, pose, shaken, table

TRACKER = pose([1.42, -0.37, 0.28], Rotation.from_rotvec([0.4, -0.2, 2.1]))
"""T_tracker_base."""
LOST = np.array([11, 12, 13, 14, 40, 41, 66])
KNOCK_DEG = 0.37


def arm_file(folder: Path, arm: Chain) -> Path:
    path = folder / "arm.urdf"
    path.write_text(arm.urdf())
    return path


def knocked(
    folder: Path, rng: np.random.Generator, lose: Callable[[dict[str, Array]], object], arm: Chain = ELBOW
) -> Try:
    """Verify an arm whose joint 3 stands KNOCK_DEG further than it reads; lose(columns) spoils the tracker's table."""
    q = arm.draw(rng, 90)
    seen = shaken(TRACKER @ arm.knocked({3: np.deg2rad(KNOCK_DEG)}).fk(q), rng, 6e-5, 2e-4)
    data = columns(seen)
    lose(data)
    table(folder / "seen.csv", data)
    table(folder / "q.csv", joints(q))
    words = ["verify", "--measured", folder / "seen.csv", "--joints", folder / "q.csv", "--arm", arm_file(folder, arm)]
    return Try([*words, "-o", folder / "v"], lambda: blamed(folder / "v", "joint 3", KNOCK_DEG))


def filled(value: float, names: str = "", rows: Array = LOST) -> Callable[[dict[str, Array]], None]:
    def lose(data: dict[str, Array]) -> None:
        for name in data:
            if not names or name in names.split():
                data[name][rows] = value

    return lose


@fault(3)
def tracker_writes_zeros_and_no_rotation(folder: Path, rng: np.random.Generator) -> Try:
    return knocked(folder, rng, filled(0.0))


@fault(3)
def tracker_writes_minus_3_7e28(folder: Path, rng: np.random.Generator) -> Try:
    return knocked(folder, rng, filled(-3.697314e28), SIDEWAYS)


@fault(3)
def tracker_writes_minus_9999(folder: Path, rng: np.random.Generator) -> Try:
    return knocked(folder, rng, filled(-9999.0), SIDEWAYS)


@fault(3)
def tracker_writes_minus_1_in_every_cell(folder: Path, rng: np.random.Generator) -> Try:
    return knocked(folder, rng, filled(-1.0))


@fault(3)
def tracker_loses_single_cells(folder: Path, rng: np.random.Generator) -> Try:
    return knocked(folder, rng, lambda data: (filled(np.nan, "y_m")(data), filled(np.nan, "qz", LOST + 2)(data)))


@fault(3)
def tracker_holds_the_last_pose(folder: Path, rng: np.random.Generator) -> Try:
    def hold(data: dict[str, Array]) -> None:
        for values in data.values():
            values[50:58], values[71:74] = values[49], values[70]

    return knocked(folder, rng, hold)


@fault(3)
def tracker_keeps_the_rotation_and_zeroes_the_place(folder: Path, rng: np.random.Generator) -> Try:
    return knocked(folder, rng, filled(0.0, "x_m y_m z_m"), SIDEWAYS)


@fault(3)
def tracker_keeps_the_place_and_writes_the_identity(folder: Path, rng: np.random.Generator) -> Try:
    def lose(data: dict[str, Array]) -> None:
        filled(0.0, "qx qy qz")(data)
        filled(1.0, "qw")(data)

    return knocked(folder, rng, lose)


def streams(rng: np.random.Generator, arm: Chain = ELBOW, seconds: float = 12.0) -> tuple[Array, Array, Array, Array]:
    """Return t_s and readings of a log at 100 Hz, t_s and poses of a tracker at 40 Hz whose clock is 0.43 s later."""
    q = motion([(j.lower + j.upper) / 2 for j in arm.joints], 0.4, rng)
    log, seen = np.arange(0, seconds, 0.01), np.arange(0.8, seconds - 1.0, 0.025)
    return log, q(log), seen + 0.43, shaken(TRACKER @ arm.fk(q(seen)), rng, 8e-5, 3e-4)


def joined(folder: Path, log: dict[str, Array], seen: dict[str, Array], arm: Chain, T: Array) -> Try:
    """Join both; right where each row's joints put the tool where it was seen. T: poses of all rows of seen."""
    table(folder / "log.csv", log)
    table(folder / "seen.csv", seen)

    def miss() -> float | None:
        out = read(folder / "points.csv")
        if out is None:
            return None
        place = np.stack([out[f"{a}_m"] for a in "xyz"], 1)
        at = np.argmin(np.linalg.norm(place[:, None] - T[None, :, :3, 3], axis=2), axis=1)
        q = np.stack([out[f"q{k + 1}"] for k in range(len(arm.joints))], 1)
        error = np.linalg.norm((TRACKER @ arm.fk(q))[:, :3, 3] - T[at, :3, 3], axis=1)
        return float(np.max(error) / 1.2e-3)

    words = ["join", "--measured", folder / "seen.csv", "--joints", folder / "log.csv", "--arm", arm_file(folder, arm)]
    return Try([*words, "-o", folder / "points.csv"], miss, flag="")


@fault(3, r"straight|interpolat|left out|foreign")
def a_gap_is_filled_with_a_straight_line(folder: Path, rng: np.random.Generator) -> Try:
    log, q, t, T = streams(rng)
    seen, true = {"t_s": t} | columns(T), T.copy()
    for values in list(seen.values())[1:]:
        values[150:190] = np.linspace(values[149], values[190], 42)[1:-1]
    return joined(folder, {"t_s": log} | joints(q), seen, ELBOW, true)


@fault(3)
def the_log_freezes_while_the_arm_moves(folder: Path, rng: np.random.Generator) -> Try:
    log, q, t, T = streams(rng, SIDEWAYS)
    q[420:480] = q[419]
    return joined(folder, {"t_s": log} | joints(q), {"t_s": t} | columns(T), SIDEWAYS, T)


@fault(3)
def the_log_writes_zeros_now_and_then(folder: Path, rng: np.random.Generator) -> Try:
    log, q, t, T = streams(rng, SEVEN)
    q[[200, 201, 505, 506, 507, 800]] = 0.0
    return joined(folder, {"t_s": log} | joints(q), {"t_s": t} | columns(T), SEVEN, T)


@fault(3)
def one_joint_of_the_log_drops_to_zero(folder: Path, rng: np.random.Generator) -> Try:
    log, q, t, T = streams(rng)
    q[[300, 301, 302, 650], 1] = 0.0
    return joined(folder, {"t_s": log} | joints(q), {"t_s": t} | columns(T), ELBOW, T)


@fault(3)
def pivot_with_lost_frames_of_minus_3_7e28(folder: Path, rng: np.random.Generator) -> Try:
    turn, tip = Rotation.from_rotvec(rng.uniform(-0.45, 0.45, (40, 3))), np.array([-0.012, 0.021, 0.164])
    data = columns(shaken(pose(np.array([0.3, -0.2, 0.9]) - turn.apply(tip), turn), rng, 1e-4, 4e-4))
    filled(-3.697314e28, rows=np.array([5, 6, 22]))(data)
    table(folder / "p.csv", data)
    words = ["calibrate", "tooltip", "--poses", folder / "p.csv", "-o", folder / "tip.yaml"]
    return Try(words, lambda: tipped(folder / "tip.yaml", list(tip)), flag="")


def hand(rng: np.random.Generator, n: int = 22) -> tuple[Array, Array, Array]:
    """Return T_flange_camera, and the poses T_base_flange and T_camera_target (n, 4, 4) of a hand over a board."""
    X = pose([0.041, 0.017, 0.066], Rotation.from_rotvec([0.05, -0.12, 1.1]))
    facing = Rotation.from_rotvec([np.pi, 0, 0]) * Rotation.from_rotvec(rng.uniform(-0.45, 0.45, (n, 3)))
    camera = pose(rng.uniform([-0.08, -0.08, 0.4], [0.08, 0.08, 0.6], (n, 3)), facing)
    robot = pose([0.52, -0.24, 0.03], Rotation.from_rotvec([0, 0, 0.7])) @ np.linalg.inv(camera) @ np.linalg.inv(X)
    return X, robot, shaken(camera, rng, 3e-4, 1e-3)


def paired(folder: Path, data: dict[str, Array], X: Array) -> Try:
    table(folder / "pairs.csv", data)
    words = ["calibrate", "handeye", "--pairs", folder / "pairs.csv", "-o", folder / "hand.yaml"]
    return Try(words, lambda: posed(folder / "hand.yaml", "T_flange_camera", X, "camera."))


@fault(3)
def camera_loses_the_board_in_four_pairs(folder: Path, rng: np.random.Generator) -> Try:
    X, robot, camera = hand(rng)
    camera[[3, 9, 10, 17]] = np.eye(4)
    return paired(folder, columns(robot, "base_flange_") | columns(camera, "camera_target_"), X)


@fault(3)
def camera_repeats_its_pose_in_three_pairs(folder: Path, rng: np.random.Generator) -> Try:
    X, robot, camera = hand(rng)
    camera[[6, 14, 15]] = camera[[5, 13, 13]]
    return paired(folder, columns(robot, "base_flange_") | columns(camera, "camera_target_"), X)


@fault(3)
def beacon_lost_as_minus_9999_in_a_sweep(folder: Path, rng: np.random.Generator) -> Try:
    arm = Chain(ELBOW.joints[:4], (0.05, 0.02, 0.03))
    rest, rows = np.array([0.2, 0.3, -0.6, 0.5]), 14
    q = np.tile(rest, (4 * rows, 1))
    for k in range(4):
        q[k * rows : (k + 1) * rows, k] += np.linspace(-0.8, 0.7, rows)
    place = shaken(arm.fk(q), rng, 1e-4)[:, :3, 3]
    place[[5, 20, 21, 48]] = -9999.0
    number = np.repeat(np.arange(1.0, 5.0), rows)
    table(folder / "sweep.csv", {"joint": number} | joints(q) | dict(zip(("x_m", "y_m", "z_m"), place.T, strict=True)))
    ask = rest + rng.uniform(-0.6, 0.6, (30, 4))
    words = ["identify", "--sweep", folder / "sweep.csv", "-o", folder / "found.yaml"]
    return Try(words, lambda: forward(folder / "found.yaml", ask, arm.fk(ask), 6e-4))


@healthy(3)
def nothing_lost(folder: Path, rng: np.random.Generator) -> Try:
    log, q, t, T = streams(rng)
    return joined(folder, {"t_s": log} | joints(q), {"t_s": t} | columns(T), ELBOW, T)


@healthy(3)
def an_arm_that_rests_between_poses(folder: Path, rng: np.random.Generator) -> Try:
    X, robot, camera = hand(rng)
    return paired(folder, columns(robot, "base_flange_") | columns(camera, "camera_target_"), X)
