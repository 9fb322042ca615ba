"""Planted faults: frames called base and tool, healthy arms before `verify`, two functions that answer one question."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from fresh_judge import Try, blamed, fault, forward, healthy, posed, read, run, same_poses, unblamed
from fresh_lost import TRACKER, arm_file
from fresh_world import (
    ELBOW,
    GANTRY,
    HALF,
    SCARA,
    SEVEN,
    SIDEWAYS,
    Array,
    Axis,
    Chain,
    columns,
    joints,
    pose,
    shaken,
    table,
    world_yaml,
)

# One word for two frames.


def places(T: Array) -> dict[str, Array]:
    return {f"{a}_m": T[:, i, 3] for i, a in enumerate("xyz")}


def rig_found(folder: Path, rng: np.random.Generator, arm: Chain, urdf: str, root: Array, *more: object) -> Try:
    """Find the rig from 40 points; root: T_root_base_link, where the file's base is not base_link."""
    (folder / "arm.urdf").write_text(urdf)
    q = arm.draw(rng, 40, 0.8)
    table(folder / "seen.csv", joints(q) | places(shaken(TRACKER @ arm.fk(q), rng, 2e-4)))
    words = ["calibrate", "robot-world", "--arm", folder / "arm.urdf", "--points", folder / "seen.csv", *more]
    true = root @ np.linalg.inv(TRACKER)
    return Try([*words, "-o", folder / "w.yaml"], lambda: posed(folder / "w.yaml", "T_base_rig", true, ""), flag="")


@fault(2)
def rig_before_a_gantry_whose_slide_is_turned(folder: Path, rng: np.random.Generator) -> Try:
    first = replace(GANTRY.joints[0], rpy=(0.3, HALF, -0.2))
    arm = replace(GANTRY, joints=(first, *GANTRY.joints[1:]))
    return rig_found(folder, rng, arm, arm.urdf(), np.eye(4))


@fault(2)
def rig_before_an_arm_on_a_pedestal(folder: Path, rng: np.random.Generator) -> Try:
    more = '<link name="world"/><joint name="foot" type="fixed"><parent link="world"/><child link="base_link"/>'
    more += '<origin xyz="0.7 -0.1 0.85" rpy="0 0 0.6"/></joint>'
    return rig_found(folder, rng, SEVEN, SEVEN.urdf(more=more), np.eye(4))


@fault(2)
def rig_before_an_arm_whose_base_is_asked_for(folder: Path, rng: np.random.Generator) -> Try:
    more = '<link name="base"/><joint name="b" type="fixed"><parent link="base_link"/><child link="base"/>'
    more += '<origin xyz="0.1 0 0.05" rpy="0 0 3.141592653589793"/></joint>'
    root = np.linalg.inv(pose([0.1, 0, 0.05], Rotation.from_rotvec([0, 0, np.pi])))
    return rig_found(folder, rng, SIDEWAYS, SIDEWAYS.urdf(more=more), root, "--base", "base", "--tip", "tool0")


@fault(2, r"tool|point of|beacon|no arm|not of this")
def the_beacon_is_not_the_tool(folder: Path, rng: np.random.Generator) -> Try:
    (folder / "arm.urdf").write_text(ELBOW.urdf())
    q = ELBOW.draw(rng, 40, 0.8)
    beacon = ELBOW.fk(q) @ pose([0.06, -0.035, 0.04])
    table(folder / "seen.csv", joints(q) | places(shaken(TRACKER @ beacon, rng, 2e-4)))
    words = ["calibrate", "robot-world", "--arm", folder / "arm.urdf", "--points", folder / "seen.csv"]
    true = np.linalg.inv(TRACKER)
    return Try([*words, "-o", folder / "w.yaml"], lambda: posed(folder / "w.yaml", "T_base_rig", true, ""), flag="")


@fault(2)
def positions_alone_and_a_tool_turned_by_120_degrees(folder: Path, rng: np.random.Generator) -> Try:
    arm = replace(SEVEN, tool_xyz=(0.03, -0.02, 0.11), tool_rpy=(0.4, -0.3, 2.1))
    (folder / "arm.urdf").write_text(arm.urdf())
    q, true = arm.draw(rng, 60), arm.knocked({2: 0.008, 4: -0.006})
    table(folder / "points.csv", joints(q) | places(shaken(TRACKER @ true.fk(q), rng, 1e-4)))
    words = ["calibrate", "arm", "--model", folder / "arm.urdf", "--points", folder / "points.csv"]
    ask = arm.draw(rng, 30)
    return Try(
        [*words, "-o", folder / "new.yaml"],
        lambda: forward(folder / "new.yaml", ask, TRACKER @ true.fk(ask), 3e-4, np.deg2rad(2.0)),
    )


def two_links(tips: dict[str, str]) -> str:
    more = ""
    for name, rpy in tips.items():
        more += f'<link name="{name}"/><joint name="to_{name}" type="fixed"><parent link="link6"/>'
        more += f'<child link="{name}"/><origin xyz="0.02 0 0" rpy="{rpy}"/></joint>'
    return ELBOW.urdf(more=more, tip="probe_end")


@fault(2, r"--tip")
def two_tools_and_none_is_called_so(folder: Path, rng: np.random.Generator) -> Try:
    (folder / "arm.urdf").write_text(two_links({"welder_end": "0 2.2 0"}))
    table(folder / "q.csv", joints(ELBOW.draw(rng, 5)))
    words = ["kinematics", "fk", "--arm", folder / "arm.urdf", "--joints", folder / "q.csv", "-o", folder / "p.csv"]
    return Try(words, lambda: 99.0, flag="")


@fault(2)
def a_flange_beside_a_tool(folder: Path, rng: np.random.Generator) -> Try:
    (folder / "arm.urdf").write_text(two_links({"own_flange": "0.1 1.2 -0.3"}))
    q = ELBOW.draw(rng, 9)
    table(folder / "q.csv", joints(q))
    arm = replace(ELBOW, tool_xyz=(0.02, 0, 0), tool_rpy=(0.1, 1.2, -0.3))
    words = ["kinematics", "fk", "--arm", folder / "arm.urdf", "--joints", folder / "q.csv", "-o", folder / "p.csv"]
    return Try(words, lambda: same_poses(folder / "p.csv", arm.fk(q), 1e-8, 1e-8), flag="")


@fault(2)
def a_turned_first_joint_through_arm_yaml_and_back(folder: Path, rng: np.random.Generator) -> Try:
    first = replace(SIDEWAYS.joints[0], xyz=(0.2, -0.1, 0.3), rpy=(0.7, -0.4, 1.0))
    arm, ask = replace(SIDEWAYS, joints=(first, *SIDEWAYS.joints[1:])), SIDEWAYS.draw(rng, 20)
    arm_file(folder, arm)
    run(["convert", "arm", folder / "arm.urdf", "-o", folder / "a.yaml", "--convention", "craig"])
    return Try(
        ["convert", "arm", folder / "a.yaml", "-o", folder / "b.urdf"],
        lambda: forward(folder / "b.urdf", ask, arm.fk(ask), 1e-9, 1e-9),
        flag="",
    )


@fault(2)
def a_jacobian_in_axes_of_a_turned_base(folder: Path, rng: np.random.Generator) -> Try:
    first = replace(ELBOW.joints[0], rpy=(0.9, 0.2, -0.5))
    arm = replace(ELBOW, joints=(first, *ELBOW.joints[1:]))
    q = arm.draw(rng, 1)
    table(folder / "q.csv", joints(q))
    words = ["kinematics", "jacobian", "--arm", arm_file(folder, arm), "--joints", folder / "q.csv", "--axes", "base"]

    def miss() -> float | None:
        out = read(folder / "j.csv")
        if out is None:
            return None
        J = np.array([[out[f"J{i}{k}"][0] for k in range(1, 7)] for i in range(1, 4)])
        step = 1e-6 * np.eye(6)
        true = (arm.fk(q + step)[:, :3, 3] - arm.fk(q - step)[:, :3, 3]).T / 2e-6
        return float(np.abs(J - true).max() / 1e-7)

    return Try([*words, "-o", folder / "j.csv"], miss, flag="")


@healthy(2)
def rig_before_an_arm(folder: Path, rng: np.random.Generator) -> Try:
    return rig_found(folder, rng, SIDEWAYS, SIDEWAYS.urdf(), np.eye(4))


@healthy(2)
def rig_before_a_scara(folder: Path, rng: np.random.Generator) -> Try:
    arm = replace(SCARA, tool_xyz=(0.03, 0.01, -0.03))
    return rig_found(folder, rng, arm, arm.urdf(), np.eye(4))


# Healthy arms before verify, with the geometry that arms have; and joints knocked beside it.


def before_verify(
    folder: Path, rng: np.random.Generator, arm: Chain, true: Chain, q: Array, world: bool = False
) -> Try:
    table(folder / "seen.csv", columns(shaken(TRACKER @ true.fk(q), rng, 6e-5, 2e-4)))
    table(folder / "q.csv", joints(q))
    words = ["verify", "--measured", folder / "seen.csv", "--joints", folder / "q.csv", "--arm", arm_file(folder, arm)]
    if world:
        words += ["--world", world_yaml(folder / "w.yaml", "T_base_rig", np.linalg.inv(TRACKER)), "--align", "tool"]
    return Try([*words, "-o", folder / "v"], lambda: unblamed(folder / "v"))


def built(kind: str, arm: Chain, share: float, mm: float, world: bool) -> None:
    def make(folder: Path, rng: np.random.Generator) -> Try:
        return before_verify(folder, rng, arm, arm.bent(rng, 1e-3 * mm, 1e-3 * mm), arm.draw(rng, 70, share), world)

    make.__name__ = f"a healthy {kind} with links off by {mm} mm{', rig known' if world else ''}"
    fault(9)(make)


for kind, arm, share, mm, world in (
    ("elbow arm", ELBOW, 0.6, 0.3, False),
    ("elbow arm in a corner", ELBOW, 0.12, 0.4, True),
    ("arm of parallel axes", SIDEWAYS, 0.5, 0.5, True),
    ("arm of parallel axes in a corner", SIDEWAYS, 0.1, 0.3, False),
    ("arm of seven joints", SEVEN, 0.5, 0.4, False),
    ("arm of seven joints in a corner", SEVEN, 0.15, 0.4, True),
):
    built(kind, arm, share, mm, world)


def knocked(kind: str, arm: Chain, joint: int, deg: float, share: float, world: bool) -> None:
    def make(folder: Path, rng: np.random.Generator) -> Try:
        true = arm.stretched(rng, 3e-4).knocked({joint: np.deg2rad(deg)})
        asked = before_verify(folder, rng, arm, true, arm.draw(rng, 70, share), world)
        # a corner may leave it open between this joint and others: never another joint, never a wrong zero
        return replace(asked, miss=lambda: told(folder / "v", joint, deg))

    make.__name__ = f"joint {joint} of {kind} off by {deg} degrees{', rig known' if world else ''}"
    fault(9)(make)


def told(out: Path, joint: int, deg: float) -> float | None:
    found = blamed(out, f"joint {joint}", deg)
    return blamed(out, "undecided|several joints|model") if found == 99.0 else found


for kind, arm, joint, deg, share, world in (
    ("an elbow arm", ELBOW, 5, 0.6, 0.5, False),
    ("an elbow arm in a corner", ELBOW, 2, 0.5, 0.12, True),
    ("an arm of parallel axes", SIDEWAYS, 3, -0.8, 0.4, False),
    ("an arm of parallel axes in a corner", SIDEWAYS, 4, 0.7, 0.12, True),
    ("an arm of seven joints", SEVEN, 4, 0.5, 0.4, True),
):
    knocked(kind, arm, joint, deg, share, world)


@healthy(9)
def an_exact_arm(folder: Path, rng: np.random.Generator) -> Try:
    return before_verify(folder, rng, ELBOW, ELBOW, ELBOW.draw(rng, 60), world=True)


# Two functions that answer one question.


def asked_back(folder: Path, arm: Chain, q: Array, *more: object) -> list[object]:
    """Write an arm's own poses at q; return the words that ask for their joints."""
    table(folder / "p.csv", {"t_s": np.arange(len(q)) * 0.5} | columns(arm.fk(q)))
    words = ["kinematics", "ik", "--arm", arm_file(folder, arm), "--poses", folder / "p.csv", "-o", folder / "s.csv"]
    return [*words, *more]


def reached(folder: Path, arm: Chain, true: Array, count: int) -> float | None:
    """Return how far the joints found are from bringing the tool where it was (each row's own), in um."""
    out = read(folder / "s.csv")
    if out is None:
        return None
    q = np.stack([out[f"q{k + 1}"] for k in range(len(arm.joints))], 1)
    if len(q) != count or not np.isfinite(q).all():
        return 99.0
    each = np.repeat(arm.fk(true)[:, :3, 3], count // len(true), axis=0)
    return float(np.abs(arm.fk(q)[:, :3, 3] - each).max() / 1e-6)


def ik_and_fk(name: str, arm: Chain, *more: object) -> None:
    def make(folder: Path, rng: np.random.Generator) -> Try:
        q = arm.draw(rng, 12, 0.95)
        return Try(asked_back(folder, arm, q, *more), lambda: reached(folder, arm, q, 12), flag="")

    make.__name__ = f"the joints of {name}'s own poses"
    fault(10)(make)


SHORT = Chain(
    (Axis((0, 0, 0.06), (0, 0, 1)), Axis((0.02, 0, 0.03), (0, 1, 0)), Axis((0.07, 0, 0), (0, 1, 0))), (0.05, 0, 0)
)
ik_and_fk("an elbow arm", ELBOW)
ik_and_fk("an arm of seven joints", SEVEN)
ik_and_fk("a scara", SCARA)
ik_and_fk("a gantry", GANTRY)
ik_and_fk("a short arm of three joints", SHORT)


def path_of(folder: Path, arm: Chain, q: Array, name: str) -> Path:
    return table(folder / name, {"t_s": np.arange(len(q)) * 0.4} | columns(arm.fk(q)))


def line_of_joints(arm: Chain, rng: np.random.Generator, rows: int = 30) -> Array:
    start = arm.draw(rng, 1, 0.3)[0]
    return start + np.linspace(0, 0.25, rows)[:, None] * rng.uniform(-1, 1, len(start))


def checked(name: str, arm: Chain) -> None:
    def make(folder: Path, rng: np.random.Generator) -> Try:
        q = line_of_joints(arm, rng)
        words = ["path", "check", path_of(folder, arm, q, "p.csv"), "--arm", arm_file(folder, arm)]
        table(folder / "near.csv", joints(q[:1]))
        track = ["kinematics", "path", "--arm", folder / "arm.urdf", "--poses", folder / "p.csv"]

        def agree() -> float | None:
            code, _ = run([*track, "-o", folder / "j.csv"])
            return 0.0 if code == 0 else 99.0

        return Try([*words, "--start", folder / "near.csv"], agree, flag="")

    make.__name__ = f"a path that {name} has just run"
    healthy(10)(make)


checked("an elbow arm", ELBOW)
checked("a short arm", SHORT)


@fault(10, r"reach|too far|cannot")
def a_path_beyond_reach(folder: Path, rng: np.random.Generator) -> Try:
    T = ELBOW.fk(line_of_joints(ELBOW, rng))
    T[:, :3, 3] *= np.linspace(1.0, 2.5, len(T))[:, None]
    path = table(folder / "p.csv", {"t_s": np.arange(len(T)) * 0.4} | columns(T))
    return Try(["path", "check", path, "--arm", arm_file(folder, ELBOW)], lambda: 99.0, flag="")


@fault(10, r"limit|range|cannot")
def a_path_beyond_a_joints_range(folder: Path, rng: np.random.Generator) -> Try:
    q = np.tile([0.2, 0.4, -0.9, 0.3, 0.8, 0.1], (30, 1))
    q[:, 0] = np.linspace(2.3, 3.3, 30)
    path = path_of(folder, ELBOW, q, "p.csv")
    return Try(["path", "check", path, "--arm", arm_file(folder, ELBOW)], lambda: 99.0, flag="")


@fault(10)
def one_arm_as_urdf_and_as_arm_yaml(folder: Path, rng: np.random.Generator) -> Try:
    arm_file(folder, SEVEN)
    ask = SEVEN.draw(rng, 20)
    words = ["convert", "arm", folder / "arm.urdf", "-o", folder / "a.yaml"]
    return Try(words, lambda: forward(folder / "a.yaml", ask, SEVEN.fk(ask), 1e-9, 1e-9), flag="")


@fault(10)
def all_joints_of_one_pose_of_a_wrist_in_a_point(folder: Path, rng: np.random.Generator) -> Try:
    free = replace(ELBOW, joints=tuple(replace(j, lower=-3.1, upper=3.1) for j in ELBOW.joints))
    q = np.array([[0.5, 0.3, -0.7, 0.6, 0.9, -0.4]])
    return Try(asked_back(folder, free, q, "--all"), lambda: every(folder, free, q), flag="")


def every(folder: Path, arm: Chain, q: Array) -> float | None:
    """Return 0 where all eight ways of the wrist, elbow and shoulder (those within limits) are there and right."""
    out = read(folder / "s.csv")
    if out is None:
        return None
    found = np.stack([out[f"q{k + 1}"] for k in range(6)], 1)
    apart = len({tuple(np.round(row, 3)) for row in found})
    off = np.abs(arm.fk(found) - arm.fk(q)).max()
    return float(off / 1e-6) if apart == len(found) and len(found) == ways(arm, q) else 99.0


def ways(arm: Chain, q: Array) -> int:
    """Return how many joint values within limits bring the tool there, from many starts of a plain Newton search."""
    rng, T, found = np.random.default_rng(0), arm.fk(q)[0], set()
    x = arm.draw(rng, 600, 1.0)
    for _ in range(60):
        here = arm.fk(x)
        turn = Rotation.from_matrix(T[:3, :3] @ here[:, :3, :3].transpose(0, 2, 1)).as_rotvec()
        error = np.c_[T[:3, 3] - here[:, :3, 3], turn]
        J = np.stack([jacobian(arm, x, here, k) for k in range(6)], 2)
        square = J @ J.transpose(0, 2, 1) + 1e-6 * np.eye(6)
        step = (J.transpose(0, 2, 1) @ np.linalg.solve(square, error[:, :, None]))[:, :, 0]
        x = x + np.clip(step, -0.4, 0.4)
    x = (x + np.pi) % (2 * np.pi) - np.pi
    there = np.abs(arm.fk(x) - T).max(axis=(1, 2)) < 1e-7
    for row in x[there & (np.abs(x) < 3.1).all(axis=1)]:
        found.add(tuple(np.round(row, 3)))
    return len(found)


def jacobian(arm: Chain, x: Array, here: Array, k: int) -> Array:
    moved = x.copy()
    moved[:, k] += 1e-6
    there = arm.fk(moved)
    turn = Rotation.from_matrix(there[:, :3, :3] @ here[:, :3, :3].transpose(0, 2, 1)).as_rotvec()
    return np.c_[there[:, :3, 3] - here[:, :3, 3], turn] / 1e-6
