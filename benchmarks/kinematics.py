"""Forward and inverse kinematics against Pinocchio, EAIK, the Robotics Toolbox and ikpy, in one run, on one core.

python benchmarks/kinematics.py [--quick]. Pinocchio and EAIK are development tools (pip install armsight[dev]), the
others are not: pip install roboticstoolbox-python ikpy. One that is not installed is left out, and the table says so.
Times are medians; the ratio is the peer's over ours in the same run.
"""

from __future__ import annotations

import argparse
import importlib
import os
import tempfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import cv2
import numpy as np

from armsight.kinematics import (
    Arm,
    family_of,
    fk,
    fk_jacobian,
    ik,
    ik_many,
    parameter_jacobian,
    pose,
    preset,
    solve_numeric_many,
)
from armsight.kinematics.kernels.chain import many_poses, many_poses_jacobians
from armsight.kinematics.kernels.closed import solve_closed_many
from armsight.kinematics.kernels.numeric import solve_many
from armsight.optics import Camera, parallel_rig, triangulate
from armsight.store.urdf import urdf_text
from bench import interleaved_ms, machine, table

WARM_RAD = 0.1
"""Standard deviation of a warm start from the answer, per joint: what an arm moves in one cycle of a slow
controller."""


def optional(name: str) -> ModuleType | None:
    try:
        return importlib.import_module(name)
    except ImportError:
        return None


class Pinocchio:
    """Pinocchio in a Python loop: it has no batch of its own in Python."""

    def __init__(self, pin: ModuleType, arm: Arm, q: np.ndarray) -> None:
        self.pin, self.model = pin, pin.buildModelFromXML(urdf_text(arm))
        self.data, self.tool = self.model.createData(), self.model.getFrameId("tool")
        self.q = [self.configuration(row) for row in q]

    def configuration(self, q: np.ndarray) -> np.ndarray:
        out: list[float] = []
        for joint, value in zip(list(self.model.joints)[1:], q, strict=True):
            out += [np.cos(value), np.sin(value)] if joint.nq == 2 else [value]
        return np.array(out)

    def poses(self) -> None:
        run, model, data = self.pin.forwardKinematics, self.model, self.data
        for q in self.q:
            run(model, data, q)

    def jacobians(self) -> None:
        run, model, data = self.pin.computeJointJacobians, self.model, self.data
        for q in self.q:
            run(model, data, q)

    def ik(self, targets: np.ndarray, starts: list[np.ndarray]) -> None:
        """Damped Newton as in Pinocchio's own example, to 1 um and 1 urad."""
        pin, model, data = self.pin, self.model, self.data
        for target, start in zip(targets, starts, strict=True):
            goal = pin.SE3(target[:3, :3], target[:3, 3])
            q = start.copy()
            for _ in range(50):
                pin.framesForwardKinematics(model, data, q)
                error = pin.log6(data.oMf[self.tool].actInv(goal)).vector
                if np.abs(error).max() < 1e-6:
                    break
                J = pin.computeFrameJacobian(model, data, q, self.tool)
                step = J.T @ np.linalg.solve(J @ J.T + 1e-12 * np.eye(6), error)
                q = pin.integrate(model, q, step)


class Ikpy:
    """ikpy's numeric inverse, started from the same joints."""

    def __init__(self, chain: ModuleType, arm: Arm) -> None:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "arm.urdf"
            path.write_text(urdf_text(arm))
            joints = [False, False, *[True] * len(arm.joints), False, False]
            self.chain = chain.Chain.from_urdf_file(str(path), base_elements=["world"], active_links_mask=joints)

    def ik(self, targets: np.ndarray, starts: np.ndarray) -> None:
        for target, start in zip(targets, starts, strict=True):
            first = np.concatenate([[0.0, 0.0], start, [0.0, 0.0]])
            self.chain.inverse_kinematics_frame(target, initial_position=first, orientation_mode="all")


def toolbox(rtb: ModuleType, arm: Arm) -> Callable[[np.ndarray, np.ndarray], None]:
    """Return the Robotics Toolbox's compiled Levenberg-Marquardt, from given joints, for rows of targets."""
    links = [rtb.RevoluteDH(d=j.d_m, a=j.a_m, alpha=j.alpha_rad, offset=j.theta_rad) for j in arm.joints]
    ets = rtb.DHRobot(links).ets()

    def run(targets: np.ndarray, starts: np.ndarray) -> None:
        for target, start in zip(targets, starts, strict=True):
            ets.ik_LM(target, q0=start)

    return run


def per_pose_us(times_ms: np.ndarray, poses: int) -> float:
    return float(np.median(times_ms)) / poses * 1e3


def batches(m: int, repeats: int) -> None:
    """Forward kinematics, Jacobian and inverse kinematics of many poses."""
    arm = preset("korayem6r")
    rng = np.random.default_rng(0)
    q = rng.uniform(-np.pi, np.pi, (m, 6))
    T, J = np.empty((m, 4, 4)), np.empty((m, 6, 6))
    few = min(m, 2000)
    pin = optional("pinocchio")
    eaik = optional("eaik.IK_DH")
    runs: dict[str, tuple[int, Callable[[], object]]] = {
        "FK": (m, lambda: many_poses(arm.chain, q, T)),
        "FK + Jacobian": (m, lambda: many_poses_jacobians(arm.chain, q, T, J)),
        "FK, all cores": (m, lambda: fk(arm, q)),
        "FK + Jacobian, all cores": (m, lambda: fk_jacobian(arm, q, out=(T, J))),
        "FK, memory of its own each time": (m, lambda: fk(arm, q, all_cores=False)),
        "derivatives by all 42 parameters": (few, lambda: parameter_jacobian(arm, q[:few])),
    }
    many_poses(arm.chain, q, T)
    family = family_of(arm)
    assert family is not None  # noqa: S101
    Q, code, count = np.empty((m, 8, 6)), np.empty((m, 8), dtype=np.int64), np.empty(m, dtype=np.int64)
    here, targets = np.zeros(6), fk(arm, q)
    closed = (arm.chain, family.numbers, family.T_base_world, family.T_tool_six, targets, here, Q, code, count)
    runs["IK closed form, all solutions"] = (m, lambda: solve_closed_many(*closed))
    runs["IK closed form, public function"] = (m, lambda: ik_many(arm, targets))
    starts = q + rng.normal(size=q.shape) * WARM_RAD
    errors, reasons = np.empty((few, 2)), np.empty((few, 2), dtype=np.int64)
    weight = arm.length_m**-2

    def warm() -> None:
        solve_many(arm.chain, targets[:few], 6, weight, 1e-6, 1e-6, 50, starts[:few].copy(), errors, reasons)

    runs["IK numeric, warm start"] = (few, warm)
    runs["IK numeric, public function"] = (few, lambda: solve_numeric_many(arm, targets[:few], starts[:few]))
    if pin is not None:
        peer = Pinocchio(pin, arm, q[:few])
        peer_starts = [peer.configuration(row) for row in starts[:200]]
        runs["Pinocchio FK"] = (few, peer.poses)
        runs["Pinocchio FK + Jacobian"] = (few, peer.jacobians)
        runs["Pinocchio IK, warm start"] = (200, lambda: peer.ik(targets[:200], peer_starts))
    if eaik is not None:
        robot = eaik.DhRobot(*(np.array([getattr(j, key) for j in arm.joints]) for key in ("alpha_rad", "a_m", "d_m")))
        runs["EAIK closed form"] = (few, lambda: robot.IK_batched(targets[:few], 1))
    rtb, ikpy = optional("roboticstoolbox"), optional("ikpy.chain")
    if rtb is not None:
        lm = toolbox(rtb, arm)
        runs["Robotics Toolbox ik_LM, warm start"] = (200, lambda: lm(targets[:200], starts[:200]))
    if ikpy is not None:
        slow = Ikpy(ikpy, arm)
        runs["ikpy, warm start"] = (5, lambda: slow.ik(targets[:5], starts[:5]))
    times = interleaved_ms({name: run for name, (_, run) in runs.items()}, repeats)
    us = {name: per_pose_us(times[name], runs[name][0]) for name in runs}
    peers = {
        "FK": "Pinocchio FK",
        "FK + Jacobian": "Pinocchio FK + Jacobian",
        "IK closed form, all solutions": "EAIK closed form",
        "IK numeric, warm start": "Pinocchio IK, warm start",
    }
    targets_us = {
        "FK": 0.12,
        "FK, all cores": 0.06,
        "FK + Jacobian": 0.2,
        "IK closed form, all solutions": 0.8,
        "IK numeric, warm start": 6.0,
    }
    rows = []
    for name, value in us.items():
        fastest = float(times[name].min()) / runs[name][0] * 1e3
        other = us.get(peers.get(name, ""))
        ratio = f"{other / value:.1f}x" if other else ""
        rows.append([name, value, fastest, targets_us.get(name, ""), peers.get(name, "") if other else "", ratio])
    title = f"korayem6r, {m:,} poses (peers and numeric: fewer), us a pose, median of {repeats}"
    table(title, ["what", "median", "fastest", "wanted", "peer", "peer / ours"], rows)
    for name, module in (("Pinocchio", pin), ("EAIK", eaik), ("the Robotics Toolbox", rtb), ("ikpy", ikpy)):
        if module is None:
            print(f"\n{name} is not installed and left out.")
    print(f"\nNumeric warm starts ({WARM_RAD} rad off): {(reasons[:, 0] == 0).mean():.2%} solved, "
          f"{reasons[:, 1].mean():.1f} steps.")  # fmt: skip


def single(repeats: int) -> None:
    """One pose through the public functions."""
    arm = preset("korayem6r")
    q = np.array([0.3, -0.5, 0.8, 0.2, 0.6, 0.7])
    T = fk(arm, q)

    def often(call: Callable[[], object]) -> Callable[[], None]:
        def run() -> None:
            for _ in range(100):
                call()

        return run

    times = interleaved_ms(
        {
            "forward (matrix)": often(lambda: fk(arm, q)),
            "forward_jacobian": often(lambda: fk_jacobian(arm, q)),
            "pose (RigidTransform)": often(lambda: pose(arm, q)),
            "inverse_many of one": often(lambda: ik_many(arm, T)),
            "inverse, with records": often(lambda: ik(arm, T)),
            "Arm.fk": often(lambda: arm.fk(q)),
            "Arm.ik near q": often(lambda: arm.ik(T, q)),
            **{name: often(call) for name, call in seen_points().items()},
            **{name: often(call) for name, call in peers_of_one(arm, q).items()},
        },
        repeats,
    )
    rows = [[name, per_pose_us(values, 100), float(values.min()) * 10] for name, values in times.items()]
    table(
        "One pose through the public function, us (wanted: 2 for forward, 15 for the others)",
        ["function", "median", "fastest"],
        rows,
    )


def seen_points() -> dict[str, Callable[[], object]]:
    """Three points through a rig's public functions, and through OpenCV's."""
    camera = Camera.pinhole(640, 480, 600.0, 600.0, 320.0, 240.0)
    rig, noise = parallel_rig(camera, 0.1), 0.01 * np.eye(2)
    points = np.array([[0.0, 0.0, 1.0], [0.1, 0.0, 1.2], [0.0, 0.1, 0.9]])
    left, right = rig.project(points)
    turn, shift, zero = np.zeros(3), np.array([-0.1, 0.0, 0.0]), np.zeros(5)
    P_left, P_right = (camera.matrix @ np.column_stack([np.eye(3), t]) for t in (np.zeros(3), shift))

    def projected() -> None:
        for t in (turn, shift):
            cv2.projectPoints(points, turn, t, camera.matrix, zero)

    def placed() -> object:
        rays = [cv2.undistortPoints(uv, camera.matrix, zero, P=camera.matrix).reshape(-1, 2).T for uv in (left, right)]
        return cv2.triangulatePoints(P_left, P_right, *rays)

    return {
        "Rig.project, 3 points": lambda: rig.project(points),
        "OpenCV projectPoints, twice": projected,
        "triangulate, 3 points": lambda: triangulate(rig, left, right, noise, noise),
        "OpenCV undistort, triangulatePoints": placed,
    }


def peers_of_one(arm: Arm, q: np.ndarray) -> dict[str, Callable[[], object]]:
    pin = optional("pinocchio")
    if pin is None:
        return {}
    return {"Pinocchio forwardKinematics": Pinocchio(pin, arm, q[None]).poses}


def shares(m: int) -> None:
    """How many solutions poses have."""
    arm = preset("korayem6r")
    q = np.random.default_rng(1).uniform(-np.pi, np.pi, (m, 6))
    T = fk(arm, q)
    Q, _, count = ik_many(arm, T)
    real = np.arange(8) < count[:, None]
    gaps = np.abs((Q - q[:, None] + np.pi) % (2 * np.pi) - np.pi).max(axis=2)
    counts = Counter(count.tolist())
    rows = [[k, counts[k] / m, wanted] for k, wanted in ((8, 0.34), (6, 0.27), (4, 0.28), (2, 0.11))]
    table(f"korayem6r: share of {m:,} random poses by number of solutions", ["solutions", "share", "wanted"], rows)
    worst = np.abs(fk(arm, Q[real]) - np.repeat(T, count, axis=0)).max()
    print(f"\nWorst FK error of a solution {worst:.1e}; the original is off by at most "
          f"{np.where(real, gaps, np.inf).min(axis=1).max():.1e} rad.")  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="fewer poses and repeats")
    quick = parser.parse_args().quick
    print(machine(), f"load {os.getloadavg()[0]:.1f}")
    batches(20_000 if quick else 100_000, 5 if quick else 25)
    single(5 if quick else 25)
    shares(10_000 if quick else 100_000)


if __name__ == "__main__":
    main()
