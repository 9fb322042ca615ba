"""Planted faults: errors that are not independent, units and orders that do not fit, causes that have one cure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from fresh_arms import places
from fresh_judge import Try, blamed, fault, forward, healthy, posed, tipped
from fresh_lost import TRACKER, arm_file, hand, paired
from fresh_world import ELBOW, SCARA, SEVEN, SIDEWAYS, Array, Chain, columns, joints, pose, shaken, table

# Errors that rows share.


def wandering(rng: np.random.Generator, rows: int, size: float, length: float, width: int = 3) -> Array:
    """Return errors (rows, width) of this standard deviation that hang together over so many rows."""
    keep, out = np.exp(-1 / length), np.empty((rows, width))
    out[0] = rng.normal(0, size, width)
    for k in range(1, rows):
        out[k] = keep * out[k - 1] + rng.normal(0, size * np.sqrt(1 - keep**2), width)
    return out


def moved(T: Array, error: Array) -> Array:
    out = T.copy()
    out[:, :3, 3] += error
    return out


def pivot(rng: np.random.Generator, n: int, reach: float = 0.45) -> tuple[Array, Array]:
    tip = np.array([0.014, -0.009, 0.187])
    turn = Rotation.from_rotvec(rng.uniform(-reach, reach, (n, 3)))
    return pose(np.array([0.55, 0.12, 0.31]) - turn.apply(tip), turn), tip


def tip_found(folder: Path, data: dict[str, Array], tip: Array, *more: object) -> Try:
    table(folder / "p.csv", data)
    words = ["calibrate", "tooltip", "--poses", folder / "p.csv", "-o", folder / "tip.yaml", *more]
    return Try(words, lambda: tipped(folder / "tip.yaml", list(tip)), flag="")


@fault(5)
def tip_of_four_places_read_eight_times(folder: Path, rng: np.random.Generator) -> Try:
    T, tip = pivot(rng, 4)
    T = np.repeat(shaken(T, rng, 3e-4, 1e-3), 8, axis=0)
    return tip_found(folder, columns(shaken(T, rng, 5e-6, 1e-5)), tip)


@fault(5)
def tip_of_five_places(folder: Path, rng: np.random.Generator) -> Try:
    T, tip = pivot(rng, 5)
    return tip_found(folder, columns(shaken(T, rng, 2e-4, 2e-3)), tip)


@fault(5)
def tip_from_a_stream_whose_error_wanders(folder: Path, rng: np.random.Generator) -> Try:
    phase = np.linspace(0, 25, 500)
    turn = Rotation.from_rotvec(0.4 * np.c_[np.sin(phase), np.cos(1.3 * phase), np.sin(0.7 * phase + 1)])
    tip = np.array([0.014, -0.009, 0.187])
    T = pose(np.array([0.55, 0.12, 0.31]) - turn.apply(tip), turn)
    T = shaken(moved(T, wandering(rng, 500, 4e-4, 40)), rng, 2e-5, 2e-4)
    return tip_found(folder, {"t_s": 0.05 * np.arange(500.0)} | columns(T), tip)


@healthy(5)
def tip_of_thirty_places(folder: Path, rng: np.random.Generator) -> Try:
    T, tip = pivot(rng, 30)
    return tip_found(folder, columns(shaken(T, rng, 2e-4, 5e-4)), tip)


def rig_of(folder: Path, q: Array, T: Array, arm: Chain, more: dict[str, Array] | None = None) -> Try:
    table(folder / "seen.csv", (more or {}) | joints(q) | places(T))
    words = ["calibrate", "robot-world", "--arm", arm_file(folder, arm), "--points", folder / "seen.csv"]
    true = np.linalg.inv(TRACKER)
    return Try([*words, "-o", folder / "w.yaml"], lambda: posed(folder / "w.yaml", "T_base_rig", true, ""), flag="")


@fault(5)
def rig_from_nine_places_read_twelve_times(folder: Path, rng: np.random.Generator) -> Try:
    q = SIDEWAYS.draw(rng, 9)
    T = np.repeat(shaken(TRACKER @ SIDEWAYS.fk(q), rng, 6e-4), 12, axis=0)
    return rig_of(folder, np.repeat(q, 12, axis=0), shaken(T, rng, 2e-5), SIDEWAYS)


@fault(5)
def rig_from_a_stream_whose_error_wanders(folder: Path, rng: np.random.Generator) -> Try:
    middle = np.array([0, 0.25, -0.65, 0, 0, 0])
    phase = np.linspace(0, 19, 400)[:, None] * np.array([1, 0.8, 1.3, 0.7, 1.1, 0.9]) + np.arange(6.0)
    q = middle + 0.5 * np.sin(phase)
    T = moved(shaken(TRACKER @ ELBOW.fk(q), rng, 3e-5), wandering(rng, 400, 8e-4, 40))
    return rig_of(folder, q, T, ELBOW, {"t_s": 0.05 * np.arange(400.0)})


@fault(5)
def hand_of_eight_places_read_ten_times(folder: Path, rng: np.random.Generator) -> Try:
    X, robot, camera = hand(rng, 8)
    robot, camera = np.repeat(robot, 10, axis=0), np.repeat(shaken(camera, rng, 4e-4, 2e-3), 10, axis=0)
    camera = shaken(camera, rng, 2e-5, 3e-5)
    return paired(folder, columns(robot, "base_flange_") | columns(camera, "camera_target_"), X)


@fault(5)
def hand_whose_robot_reads_each_place_with_its_own_error(folder: Path, rng: np.random.Generator) -> Try:
    X, robot, camera = hand(rng, 12)
    robot, camera = np.repeat(shaken(robot, rng, 5e-4, 5e-4), 6, axis=0), np.repeat(camera, 6, axis=0)
    robot, camera = shaken(robot, rng, 1e-6, 1e-6), shaken(camera, rng, 1e-4, 3e-4)
    return paired(folder, columns(robot, "base_flange_") | columns(camera, "camera_target_"), X)


def geared(folder: Path, rng: np.random.Generator, arm: Chain, count: int, again: int) -> Try:
    """Verify a joint off by 0.33 degrees, gears erring by 0.4 mrad alike in all readings of a place."""
    q = arm.draw(rng, count)
    true = arm.knocked({3: np.deg2rad(0.33)}).fk(q + rng.normal(0, 4e-4, q.shape))
    table(folder / "seen.csv", columns(shaken(np.repeat(TRACKER @ true, again, axis=0), rng, 2e-5, 5e-5)))
    table(folder / "q.csv", joints(np.repeat(q, again, axis=0)))
    words = ["verify", "--measured", folder / "seen.csv", "--joints", folder / "q.csv", "--arm", arm_file(folder, arm)]
    return Try([*words, "-o", folder / "v"], lambda: blamed(folder / "v", "joint 3", 0.33))


@fault(5)
def a_knocked_joint_at_places_read_ten_times(folder: Path, rng: np.random.Generator) -> Try:
    return geared(folder, rng, SIDEWAYS, 25, 10)


def arm_of(folder: Path, arm: Chain, true: Chain, data: dict[str, Array], bound_m: float, *more: object) -> Try:
    """Calibrate an arm; right where its tool is within bound_m (RMS) of the true one over the places of the rows."""
    table(folder / "points.csv", data)
    words = ["calibrate", "arm", "--model", arm_file(folder, arm), "--points", folder / "points.csv", *more]
    ask = arm.draw(np.random.default_rng(1), 40, 0.5)
    out = folder / "new.yaml"
    return Try([*words, "-o", out], lambda: forward(out, ask, TRACKER @ true.fk(ask), bound_m))


@fault(5)
def arm_at_places_read_eight_times(folder: Path, rng: np.random.Generator) -> Try:
    q, true = ELBOW.draw(rng, 45), ELBOW.knocked({2: 0.006, 3: -0.009})
    T = np.repeat(TRACKER @ true.fk(q + rng.normal(0, 2e-4, q.shape)), 8, axis=0)
    return arm_of(folder, ELBOW, true, joints(np.repeat(q, 8, axis=0)) | places(shaken(T, rng, 1e-5)), 2.5e-4)


@fault(5)
def an_exact_arm_and_a_tracker_that_wanders(folder: Path, rng: np.random.Generator) -> Try:
    phase = np.linspace(0, 16, 300)[:, None] * np.array([1, 0.8, 1.3, 0.7, 1.1, 0.9]) + np.arange(6.0)
    q = np.array([0, 0.25, -0.65, 0, 0, 0]) + 0.5 * np.sin(phase)
    T = moved(shaken(TRACKER @ ELBOW.fk(q), rng, 2e-5), wandering(rng, 300, 7e-4, 30))
    return arm_of(folder, ELBOW, ELBOW, joints(q) | places(T), 1.6e-3)


@healthy(5)
def arm_of_sixty_rows(folder: Path, rng: np.random.Generator) -> Try:
    q, true = SEVEN.draw(rng, 60), SEVEN.knocked({2: 0.006, 4: -0.009})
    return arm_of(folder, SEVEN, true, joints(q) | places(shaken(TRACKER @ true.fk(q), rng, 8e-5)), 1.5e-4)


# What does not fit: units, orders, frames, other arms.


def spoilt(kind: int, true: str, name: str, spoil: Callable[[Array, Array], dict[str, Array]]) -> None:
    """Add a hand-eye case whose table is spoil(robot, camera)."""

    def make(folder: Path, rng: np.random.Generator) -> Try:
        X, robot, camera = hand(rng)
        return paired(folder, spoil(robot, camera), X)

    make.__name__ = name
    fault(kind, true)(make)


def both(robot: Array, camera: Array, units: tuple[float, float] = (1.0, 1.0)) -> dict[str, Array]:
    return columns(robot, "base_flange_", units[0]) | columns(camera, "camera_target_", units[1])


def w_first(data: dict[str, Array], prefix: str) -> dict[str, Array]:
    names = [f"{prefix}q{a}" for a in "xyzw"]
    return data | dict(zip(names, [data[f"{prefix}q{a}"] for a in "wxyz"], strict=True))


def turned(T: Array, order: str, names: str, prefix: str) -> dict[str, Array]:
    """Return a pose's columns with angles of this order under these names, in degrees."""
    angles = Rotation.from_matrix(T[:, :3, :3]).as_euler(order, degrees=True)
    place = {f"{prefix}{a}_m": T[:, i, 3] for i, a in enumerate("xyz")}
    return place | {f"{prefix}{n}_deg": angles[:, i] for i, n in enumerate(names.split())}


spoilt(6, r"cm|centi|unit|metre", "camera poses in centimetres", lambda r, c: both(r, c, (1.0, 100.0)))
spoilt(6, r"mm|milli", "hand and camera in millimetres", lambda r, c: both(r, c, (1e3, 1e3)))
spoilt(6, r"inch|unit|times|factor|size", "camera poses in inches", lambda r, c: both(r, c, (1.0, 39.3701)))
spoilt(6, r"w, x, y, z", "camera quaternions w first", lambda r, c: w_first(both(r, c), "camera_target_"))
spoilt(6, r"invert|T_flange_base|inverse", "robot poses inverted", lambda r, c: both(np.linalg.inv(r), c))
spoilt(6, r"which robot pose belongs", "pairs out of step by two", lambda r, c: both(r[2:], c[:-2]))
spoilt(
    6,
    r"euler|order|are missing",
    "angles without an order",
    lambda r, c: turned(r, "ZYX", "a b c", "base_flange_") | columns(c, "camera_target_"),
)
spoilt(
    6,
    r"size|scale|pitch|times|factor",
    "a board printed 4 percent large",
    lambda r, c: both(r, pose(c[:, :3, 3] / 1.04, Rotation.from_matrix(c[:, :3, :3]))),
)
spoilt(
    6,
    r"mirror|left-handed|y up|sign of y",
    "camera poses with y up",
    lambda r, c: both(r, np.diag([1, -1, 1, 1]) @ c @ np.diag([1, -1, 1, 1])),
)
BESIDE = pose([0.9, 0.1, 0.4], Rotation.from_rotvec([2.2, 0.3, -0.4]))
ON_HAND = pose([0.02, 0.05, 0.11], Rotation.from_rotvec([0.3, 0.2, 0.9]))
spoilt(8, r"eye-to-hand|setup", "a camera beside the robot", lambda _, c: both(BESIDE @ c @ np.linalg.inv(ON_HAND), c))


def wrong_order(folder: Path, rng: np.random.Generator, made: str, said: str) -> Try:
    X, robot, camera = hand(rng)
    data = turned(robot, made, "rx ry rz", "base_flange_") | columns(camera, "camera_target_")
    asked = paired(folder, data, X)
    return Try([*asked.words, "--euler", said], asked.miss)


@fault(6, r"order|euler|--euler|rotation|angles")
def euler_angles_of_another_order(folder: Path, rng: np.random.Generator) -> Try:
    return wrong_order(folder, rng, "XYZ", "xyz-fixed")


@healthy(6)
def euler_angles_as_said(folder: Path, rng: np.random.Generator) -> Try:
    return wrong_order(folder, rng, "xyz", "xyz-fixed")


def arm_rows(rng: np.random.Generator, arm: Chain, true: Chain, rows: int = 50) -> tuple[Array, Array]:
    q = arm.draw(rng, rows)
    return q, shaken(TRACKER @ true.fk(q), rng, 1e-4, 3e-4)


@fault(6, r"deg")
def joints_in_degrees(folder: Path, rng: np.random.Generator) -> Try:
    q, T = arm_rows(rng, ELBOW, ELBOW)
    return arm_of(folder, ELBOW, ELBOW, joints(np.rad2deg(q)) | places(T), 3e-4)


@fault(6, r"inch|unit|times|factor|mm|scale")
def places_in_inches(folder: Path, rng: np.random.Generator) -> Try:
    q, T = arm_rows(rng, SIDEWAYS, SIDEWAYS)
    return arm_of(folder, SIDEWAYS, SIDEWAYS, joints(q) | {n: 39.3701 * v for n, v in places(T).items()}, 3e-4)


@fault(6, r"mirror|left-handed|reflection")
def places_of_a_left_handed_tracker(folder: Path, rng: np.random.Generator) -> Try:
    q, T = arm_rows(rng, SEVEN, SEVEN)
    T[:, 0, 3] *= -1
    return arm_of(folder, SEVEN, SEVEN, joints(q) | places(T), 3e-4)


@fault(6, r"ax|length|longer|arm")
def an_arm_with_another_forearm(folder: Path, rng: np.random.Generator) -> Try:
    longer = replace(ELBOW.joints[4], xyz=(0.305, 0, 0))
    true = replace(ELBOW, joints=(*ELBOW.joints[:4], longer, ELBOW.joints[5]))
    q, T = arm_rows(rng, ELBOW, true)
    return arm_of(folder, ELBOW, true, joints(q) | places(T), 3e-4)


@fault(6, r"deg|limit")
def a_urdf_with_limits_in_degrees(folder: Path, rng: np.random.Generator) -> Try:
    (folder / "arm.urdf").write_text(ELBOW.urdf(limit=180 / np.pi))
    q = ELBOW.draw(rng, 5)
    table(folder / "q.csv", joints(q))
    words = ["kinematics", "fk", "--arm", folder / "arm.urdf", "--joints", folder / "q.csv", "-o", folder / "p.csv"]
    return Try(words, lambda: 99.0, flag="")


@fault(6, r"mm|milli|metre|length")
def a_urdf_in_millimetres(folder: Path, rng: np.random.Generator) -> Try:
    (folder / "arm.urdf").write_text(SEVEN.urdf(unit=1e3))
    table(folder / "q.csv", joints(SEVEN.draw(rng, 5)))
    words = ["kinematics", "fk", "--arm", folder / "arm.urdf", "--joints", folder / "q.csv", "-o", folder / "p.csv"]
    return Try(words, lambda: 99.0, flag="")


@fault(6, r"degree|turned|nominal|equal|forward")
def rotations_computed_from_the_joints(folder: Path, rng: np.random.Generator) -> Try:
    true = ELBOW.knocked({2: 0.012, 5: 0.015})
    q, T = arm_rows(rng, ELBOW, true)
    T[:, :3, :3] = (TRACKER @ ELBOW.fk(q))[:, :3, :3]
    quaternions = {n: v for n, v in columns(T).items() if n[0] == "q"}
    return arm_of(folder, ELBOW, true, joints(q) | places(T) | quaternions, 3e-4)


# Causes that have one cure.


def reversed_joints(folder: Path, rng: np.random.Generator, arm: Chain, signs: list[float], zeros: list[float]) -> Try:
    q = arm.draw(rng, 60)
    T = shaken(TRACKER @ arm.fk(q), rng, 1e-4)
    read = (q - np.array(zeros)) * np.array(signs)
    asked = arm_of(folder, arm, arm, joints(read) | places(T), 3e-4)
    ask = arm.draw(np.random.default_rng(1), 40)
    log = (ask - np.array(zeros)) * np.array(signs)
    return Try(asked.words, lambda: forward(folder / "new.yaml", log, TRACKER @ arm.fk(ask), 3e-4))


@fault(8, r"ax3|joint 3|sense|sign|revers")
def joint_3_counts_the_other_way(folder: Path, rng: np.random.Generator) -> Try:
    return reversed_joints(folder, rng, ELBOW, [1, 1, -1, 1, 1, 1], [0, 0, 0, 0, 0, 0])


@fault(8, r"ax[24]|joint [24]|sense|sign|revers")
def joints_2_and_4_count_the_other_way_from_elsewhere(folder: Path, rng: np.random.Generator) -> Try:
    return reversed_joints(folder, rng, SEVEN, [1, -1, 1, -1, 1, 1, 1], [0, 0.3, 0, -0.2, 0, 0, 0])


@fault(8)
def a_controller_that_shows_the_elbows_absolute_angle(folder: Path, rng: np.random.Generator) -> Try:
    true = SIDEWAYS.knocked({2: 0.004, 4: -0.005})
    q, T = arm_rows(rng, SIDEWAYS, true, 60)
    shown = q.copy()
    shown[:, 2] += q[:, 1]
    asked = arm_of(folder, SIDEWAYS, true, joints(shown) | places(T), 3e-4)
    ask = SIDEWAYS.draw(np.random.default_rng(1), 40)
    log = ask.copy()
    log[:, 2] += ask[:, 1]
    return Try(asked.words, lambda: forward(folder / "new.yaml", log, TRACKER @ true.fk(ask), 4e-4))


@fault(8, r"another order|exchanged")
def joints_in_another_order(folder: Path, rng: np.random.Generator) -> Try:
    q, T = arm_rows(rng, SEVEN, SEVEN)
    return arm_of(folder, SEVEN, SEVEN, joints(q[:, [0, 2, 1, 3, 4, 5, 6]]) | places(T), 3e-4)


@fault(8, r"robot-world|vertical|SCARA|one axis")
def the_hand_of_a_scara(folder: Path, rng: np.random.Generator) -> Try:
    q = SCARA.draw(rng, 25, 0.8)
    robot = SCARA.fk(q)
    X = pose([0.05, 0.01, -0.04], Rotation.from_rotvec([np.pi, 0, 0]))
    camera = np.linalg.inv(X) @ np.linalg.inv(robot) @ pose([0.35, 0.05, 0.0])
    camera = shaken(camera, rng, 2e-4, 5e-4)
    return paired(folder, columns(robot, "base_flange_") | columns(camera, "camera_target_"), X)


@fault(8, r"stale|repeat|same")
def a_robot_pose_that_stays_the_first(folder: Path, rng: np.random.Generator) -> Try:
    X, robot, camera = hand(rng)
    robot[3:] = robot[3]
    return paired(folder, both(robot, camera), X)


@fault(8, r"tilt|turn")
def a_pivot_of_five_degrees(folder: Path, rng: np.random.Generator) -> Try:
    T, tip = pivot(rng, 30, 0.06)
    return tip_found(folder, columns(shaken(T, rng, 2e-3, 3e-3)), tip)


@fault(8, r"moved|slip|two|place|drift|wander")
def a_tip_that_slips_in_the_middle(folder: Path, rng: np.random.Generator) -> Try:
    T, tip = pivot(rng, 40)
    T[20:, :3, 3] += [0.004, -0.003, 0.0]
    return tip_found(folder, columns(shaken(T, rng, 1e-4, 3e-4)), tip)


@fault(8, r"mm|unit|in m")
def a_pivot_point_in_millimetres(folder: Path, rng: np.random.Generator) -> Try:
    T, tip = pivot(rng, 30)
    return tip_found(folder, columns(shaken(T, rng, 1e-4, 3e-4)), tip, "--point", "550,120,310")


@healthy(8)
def a_hand_over_a_board(folder: Path, rng: np.random.Generator) -> Try:
    X, robot, camera = hand(rng)
    return paired(folder, both(robot, camera), X)
