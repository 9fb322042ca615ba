"""Valid input as strangers write it, which must be read as it is meant: URDFs, tables, logs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from fresh_judge import Try, fault, forward, healthy, read, same_poses, tipped
from fresh_lost import arm_file
from fresh_world import ELBOW, SEVEN, SIDEWAYS, Array, Axis, Chain, columns, joints, pose, shaken, table


def urdf_read(folder: Path, rng: np.random.Generator, arm: Chain, text: str, bound: float = 1e-8) -> Try:
    """Read a URDF; right where its forward kinematics is the arm's."""
    (folder / "arm.urdf").write_bytes(text.encode("utf-16" if text.startswith("<?xml version='1.0' enc") else "utf-8"))
    q = arm.draw(rng, 9)
    table(folder / "q.csv", joints(q))
    words = ["kinematics", "fk", "--arm", folder / "arm.urdf", "--joints", folder / "q.csv", "-o", folder / "p.csv"]
    return Try(words, lambda: same_poses(folder / "p.csv", arm.fk(q), bound, bound), flag="")


def written(name: str, arm: Chain, change: Callable[[str], str], true: str = "nothing") -> None:
    """Add a case: a URDF of the arm, changed as an exporter changes it."""

    def make(folder: Path, rng: np.random.Generator) -> Try:
        return urdf_read(folder, rng, arm, change(arm.urdf()))

    make.__name__ = f"a urdf with {name}"
    fault(7, true)(make)


def tilted(digits: int) -> Chain:
    """Return an arm whose axes are oblique and rounded: their directions are meant."""
    axes = [np.round(Rotation.from_rotvec([0.3, -0.2, 0.5]).apply(j.axis), digits) for j in ELBOW.joints]
    return replace(ELBOW, joints=tuple(replace(j, axis=tuple(a)) for j, a in zip(ELBOW.joints, axes, strict=True)))


ROUNDED = tilted(3)
written("oblique axes of three digits", ROUNDED, lambda text: text)
written("a default namespace", SIDEWAYS, lambda t: t.replace("<robot ", '<robot xmlns="http://www.ros.org" '))
written("an undeclared prefix", SEVEN, lambda t: t.replace("</robot>", "<gz:plugin a='1'/></robot>"))
written("two bytes a letter", ELBOW, lambda text: "<?xml version='1.0' encoding='utf-16'?>" + text)
written(
    "limits of a million", SIDEWAYS, lambda t: t.replace('lower="-2.8" upper="2.8"', 'lower="-999999" upper="999999"')
)
written("no limits in a turning joint", SEVEN, lambda t: t.replace('lower="-2.8" upper="2.8"', 'lower="0" upper="0"'))
written(
    "endless joints",
    ELBOW,
    lambda t: t.replace('<joint name="ax1" type="revolute"', '<joint name="ax1" type="continuous"'),
)
written(
    "effort and velocity of zero", SEVEN, lambda t: t.replace('velocity="2" effort="90"', 'velocity="0" effort="0"')
)
written(
    "a gripper of two fingers beside the tool",
    ELBOW,
    lambda t: t.replace(
        "</robot>",
        "".join(
            f'<link name="f{k}"/><joint name="g{k}" type="prismatic"><parent link="tool0"/><child link="f{k}"/>'
            f'<axis xyz="0 1 0"/><limit lower="0" upper="0.04" velocity="1" effort="1"/></joint>'
            for k in (1, 2)
        )
        + "</robot>",
    ),
    "--tip",
)
written(
    "an axis longer than one",
    SEVEN,
    lambda t: t.replace('axis xyz="0 0 1"', 'axis xyz="0 0 2.5"'),
)


@fault(7)
def a_urdf_with_a_joint_that_mimics_the_one_before(folder: Path, rng: np.random.Generator) -> Try:
    links = (
        Axis((0, 0, 0.2), (0, 0, 1)),
        Axis((0.1, 0, 0), (0, 1, 0)),
        Axis((0.3, 0, 0), (0, 1, 0)),
        Axis((0.3, 0, 0), (1, 0, 0)),
    )
    arm = Chain(links, (0.05, 0.02, 0))
    head, tail = arm.urdf().split('<joint name="ax3"')
    text = (
        head
        + '<joint name="ax3"'
        + tail.replace("</joint>", '<mimic joint="ax2" multiplier="-1.2" offset="0.1"/></joint>', 1)
    )
    (folder / "arm.urdf").write_text(text)
    q = arm.draw(rng, 9)
    q[:, 2] = -1.2 * q[:, 1] + 0.1
    table(folder / "q.csv", {"ax1": q[:, 0], "ax2": q[:, 1], "ax4": q[:, 3]})
    words = ["kinematics", "fk", "--arm", folder / "arm.urdf", "--joints", folder / "q.csv", "-o", folder / "p.csv"]
    return Try(words, lambda: same_poses(folder / "p.csv", arm.fk(q), 1e-8, 1e-8), flag="")


# Logs and tables.


def logged(
    folder: Path, rng: np.random.Generator, arm: Chain, write: Callable[[Path, Array], object], *more: object
) -> Try:
    """Forward kinematics of a log that write(path, q) made."""
    q = arm.draw(rng, 12)
    write(folder / "q.csv", q)
    words = ["kinematics", "fk", "--arm", arm_file(folder, arm), "--joints", folder / "q.csv", "-o", folder / "p.csv"]
    return Try([*words, *more], lambda: same_poses(folder / "p.csv", arm.fk(q), 2e-7, 2e-7), flag="")


@fault(7)
def joints_by_their_names_in_another_order(folder: Path, rng: np.random.Generator) -> Try:
    return logged(folder, rng, SEVEN, lambda p, q: table(p, {f"ax{k + 1}": q[:, k] for k in (6, 2, 0, 1, 5, 4, 3)}))


@fault(7)
def decimal_commas_between_semicolons(folder: Path, rng: np.random.Generator) -> Try:
    return logged(folder, rng, ELBOW, lambda p, q: table(p, joints(q), separator=";", decimal=","))


@fault(7)
def degrees_in_the_header_and_a_byte_order_mark(folder: Path, rng: np.random.Generator) -> Try:
    def write(path: Path, q: Array) -> None:
        table(path, {f"J{k + 1} [deg]": np.rad2deg(q[:, k]) for k in range(6)})
        path.write_text("\ufeff" + path.read_text(), encoding="utf-8")

    return logged(folder, rng, SIDEWAYS, write)


@fault(7)
def remarks_and_blanks_between_numbers(folder: Path, rng: np.random.Generator) -> Try:
    def write(path: Path, q: Array) -> None:
        body = "\n".join("  ".join(f"{v:12.9f}" for v in row) for row in q)
        path.write_text(f"# logged by hand\n# q1 .. q7\n{body}\n")

    return logged(folder, rng, SEVEN, write, "--columns", "q1..q7")


@fault(7)
def a_log_in_degrees_told_by_a_flag(folder: Path, rng: np.random.Generator) -> Try:
    return logged(folder, rng, ELBOW, lambda p, q: table(p, joints(np.rad2deg(q))), "--units", "deg")


def pivoted(folder: Path, rng: np.random.Generator, write: Callable[[Path, Array], object], *more: object) -> Try:
    turn, tip = Rotation.from_rotvec(rng.uniform(-0.45, 0.45, (30, 3))), np.array([-0.02, 0.015, 0.14])
    write(folder / "p.csv", shaken(pose(np.array([0.3, -0.2, 0.4]) - turn.apply(tip), turn), rng, 1e-4, 3e-4))
    words = ["calibrate", "tooltip", "--poses", folder / "p.csv", "-o", folder / "tip.yaml", *more]
    return Try(words, lambda: tipped(folder / "tip.yaml", list(tip)), flag="")


def in_mm(T: Array) -> dict[str, Array]:
    return {a: 1e3 * T[:, i, 3] for i, a in enumerate("XYZ")}


@fault(7)
def kuka_poses(folder: Path, rng: np.random.Generator) -> Try:
    def write(path: Path, T: Array) -> None:
        abc = Rotation.from_matrix(T[:, :3, :3]).as_euler("ZYX", degrees=True)
        table(path, in_mm(T) | dict(zip("ABC", abc.T, strict=True)), separator=";", decimal=",")

    return pivoted(folder, rng, write, "--robot-format", "kuka")


@fault(7)
def fanuc_poses(folder: Path, rng: np.random.Generator) -> Try:
    def write(path: Path, T: Array) -> None:
        wpr = Rotation.from_matrix(T[:, :3, :3]).as_euler("xyz", degrees=True)
        table(path, in_mm(T) | dict(zip("WPR", wpr.T, strict=True)))

    return pivoted(folder, rng, write, "--robot-format", "fanuc")


@fault(7)
def abb_quaternions(folder: Path, rng: np.random.Generator) -> Try:
    def write(path: Path, T: Array) -> None:
        quat = Rotation.from_matrix(T[:, :3, :3]).as_quat()[:, [3, 0, 1, 2]]
        table(path, in_mm(T) | {f"q{k + 1}": quat[:, k] for k in range(4)})

    return pivoted(folder, rng, write, "--robot-format", "abb")


@fault(7)
def rotation_vectors_of_a_universal_robot(folder: Path, rng: np.random.Generator) -> Try:
    def write(path: Path, T: Array) -> None:
        vector = Rotation.from_matrix(T[:, :3, :3]).as_rotvec()
        names = {f"actual_TCP_pose_{k}": np.c_[T[:, :3, 3], vector][:, k] for k in range(6)}
        table(path, {"timestamp": 12.0 + 0.5 * np.arange(len(T))} | names, separator=" ")

    return pivoted(folder, rng, write, "--robot-format", "ur")


@fault(7)
def matrices_column_by_column(folder: Path, rng: np.random.Generator) -> Try:
    def write(path: Path, T: Array) -> None:
        table(path, {f"O_T_EE_{k}": T.transpose(0, 2, 1).reshape(-1, 16)[:, k] for k in range(16)})

    return pivoted(folder, rng, write)


@healthy(7)
def poses_in_columns_of_our_own(folder: Path, rng: np.random.Generator) -> Try:
    return pivoted(folder, rng, lambda path, T: table(path, columns(T)))


@fault(7)
def a_calibrated_table_of_nearly_parallel_axes(folder: Path, rng: np.random.Generator) -> Try:
    """A controller's own Denavit-Hartenberg table whose d are hundreds of metres, as axes 2 and 3 cross far away."""
    a, d = [0.0, -0.44, -0.4, 0.0, 0.0, 0.0], [0.155, 212.4, -212.4 - 0.02, 0.13, 0.098, 0.091]
    alpha = [np.pi / 2, 3e-4, -3e-4, np.pi / 2, -np.pi / 2, 0.0]
    keys = zip(a, d, alpha, strict=True)
    rows = [
        f"- {{name: j{k + 1}, type: revolute, a_m: {x}, d_m: {y}, alpha_rad: {z}}}" for k, (x, y, z) in enumerate(keys)
    ]
    head = "format: armsight/arm\nversion: 1\nname: own\nconvention: standard\njoints:\n"
    (folder / "arm.yaml").write_text(head + "\n".join(rows) + "\n")
    q = rng.uniform(-1.5, 1.5, (12, 6))
    T = np.tile(np.eye(4), (12, 1, 1))
    for k in range(6):
        T = (
            T
            @ pose([[0, 0, d[k]]] * 12, Rotation.from_rotvec(q[:, k, None] * [0, 0, 1]))
            @ pose([a[k], 0, 0], Rotation.from_rotvec([alpha[k], 0, 0]))
        )
    words = ["convert", "arm", folder / "arm.yaml", "-o", folder / "b.urdf"]
    return Try(words, lambda: forward(folder / "b.urdf", q, T, 1e-7, 1e-7), flag="")


@fault(7)
def joints_asked_back_by_name(folder: Path, rng: np.random.Generator) -> Try:
    q = ELBOW.draw(rng, 6, 0.6)
    table(folder / "p.csv", columns(ELBOW.fk(q)))
    table(folder / "near.csv", {f"ax{k + 1}": q[:, k] + 0.05 for k in (5, 4, 3, 2, 1, 0)})
    words = ["kinematics", "ik", "--arm", arm_file(folder, ELBOW), "--poses", folder / "p.csv", "-o", folder / "s.csv"]

    def miss() -> float | None:
        out = read(folder / "s.csv")
        if out is None:
            return None
        return float(np.abs(np.stack([out[f"q{k + 1}"] for k in range(6)], 1) - q).max() / 1e-6)

    return Try([*words, "--near", folder / "near.csv"], miss, flag="")
