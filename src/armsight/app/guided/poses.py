"""Tool tip, hand-eye and arm from poses that are taken one by one while a person or the robot moves the target."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.app.guided.step import Hint, Next, Sample, StepResult
from armsight.app.live.station import MeasurementProcess
from armsight.app.operator.robot_cell import flange_pose
from armsight.arrays import Array
from armsight.calibrate.handeye import PosePairs, Setup
from armsight.calibrate.tooltip_result import TURNED_RAD
from armsight.clock import Clock, SystemClock
from armsight.columns import POSE7
from armsight.defaults import LOOK_S
from armsight.errors import DeviceFailed, NotEnoughData
from armsight.file_names import report_path
from armsight.kinematics import Arm
from armsight.ops.arm_files import load_arm
from armsight.ops.calibrate_hand_eye import calibrate_hand_eye
from armsight.ops.calibrate_robot import calibrate_arm, calibrate_tool_tip
from armsight.records import JointReading, PoseStatus, Progress, TargetPose
from armsight.store import write_poses
from armsight.store.atomic import write_text
from armsight.store.handeye_file import write_pairs
from armsight.store.tables import cells
from armsight.units import DEG

ReadJoints = Callable[[], JointReading]
"""Returns the robot's newest joints in rad or m, their time on the machine's clock. Raises DeviceFailed."""

"""A rotation's RMS about an axis from which a lever is told well: sin 20 degrees is a third of the lever's length."""
STILL = 2e-4
"""Joints (rad or m) that moved less while a pose was taken stood still: at 1 m it is 0.2 mm."""
LATE_S = 2.0
"""How much later than a picture its joints may come, and the time between two looks for them."""
AXES = ("x", "y", "z")


def seen_pose(station: MeasurementProcess, since_s: float) -> TargetPose:
    """Return the pose in the first picture exposed at since_s or later. Raises NotEnoughData, saying why there is none,
    DeviceFailed."""
    pose = station.shown_since(since_s).pose
    if pose.status is not PoseStatus.OK:
        raise NotEnoughData(
            "the target is not seen whole" + (f": {pose.why}" if pose.why else ""),
            consequence="No pose was taken",
            cure="Bring all lights of the target into both pictures",
        )
    return pose


@dataclass(slots=True, kw_only=True)
class PoseSamples:
    """Poses of the target, with the joints where a robot moves it; what is common to the steps that take poses."""

    name: str
    folder: Path
    out: Path
    enough: int
    fewest: int
    read_joints: ReadJoints | None = None
    clock: Clock = field(default_factory=SystemClock)
    _poses: list[TargetPose] = field(default_factory=list)
    _joints: list[Array] = field(default_factory=list)
    _loaded: Arm | None = None

    def moved_by(self) -> Arm | None:
        """Return the model of the arm that moves target or cameras; None where a person does. Raises BadFile."""
        return None

    @property
    def samples(self) -> tuple[Sample, ...]:
        """The poses taken so far."""
        out = []
        for i, pose in enumerate(self._poses):
            T = np.asarray(pose.T_parent_target)
            position = " ".join(f"{1e3 * v:.1f}" for v in T[:3, 3])
            out.append(Sample(name=str(i + 1), detail=f"x y z {position} mm"))
        return tuple(out)

    def coverage(self) -> dict[str, tuple[int, ...]]:
        """Nothing: poses cover turns, not pictures."""
        return {}

    def turns(self) -> tuple[Array, Array]:
        """Return the RMS of the turns about their principal axes (3,), falling, and these axes in columns (3, 3).

        The axes are those of the hand where a robot moves it, else of the target.
        """
        if len(self._poses) < 2:
            return np.zeros(3), np.eye(3)
        vectors = self._turn_vectors()
        moments, axes = np.linalg.eigh(vectors.T @ vectors / len(vectors))
        return np.sqrt(np.maximum(moments[::-1], 0.0)), axes[:, ::-1]

    def hint(self) -> Hint:
        """Return what is missing most: turns about a second axis, the robot elsewhere, poses."""
        rms, axes = self.turns()
        if self.read_joints is None:
            wanting = len(self._poses) < max(self.fewest, self.enough) or rms[1] < TURNED_RAD
            return Hint(what=Next.TURN_TARGET if wanting else Next.RUN)
        for i in (0, 1):
            if rms[i] < TURNED_RAD:
                # of what there is, the axis of the hand that is furthest from those turned about enough
                axis = int(np.argmin(np.abs(axes[:, :i]).max(axis=1))) if i else 0
                return Hint(what=Next.TURN_HAND, axis=AXES[axis], share=float(rms[i] / TURNED_RAD))
        return Hint(what=Next.RUN if len(self._poses) >= self.enough else Next.MOVE_ROBOT)

    def spread(self) -> tuple[tuple[str, str], ...]:
        """Return how far the hand or the target has been turned, from which the result's certainty comes."""
        if len(self._poses) < 2:
            return ()
        about = np.sqrt((self._turn_vectors() ** 2).mean(axis=0)) / DEG
        rows = tuple((f"turned about its own {axis}", f"{v:.0f} deg") for axis, v in zip(AXES, about, strict=True))
        return (*rows, ("needed", f"{TURNED_RAD / DEG:.0f} deg about two of them"))

    def accept(self, station: MeasurementProcess) -> Sample:
        """Take the pose in a picture exposed from now on, and the joints, told before it and after.

        Raises NotEnoughData, DeviceFailed.
        """
        began = None if self.read_joints is None else self.read_joints()
        pose = seen_pose(station, self.clock.now_s())
        if self.read_joints is not None and began is not None:
            ended = self._joints_since(self.read_joints, pose.t_s)
            if np.abs(ended.q - began.q).max() > STILL:
                raise NotEnoughData(
                    "the robot moved while the picture was taken",
                    consequence="No pose was taken",
                    cure="Let it come to rest, then accept",
                )
            self._joints.append(ended.q)
        self._poses.append(pose)
        return self.samples[-1]

    def _joints_since(self, read_joints: ReadJoints, t_s: float) -> JointReading:
        until_s = self.clock.now_s() + LATE_S
        while (reading := read_joints()).t_s < t_s:
            if self.clock.now_s() >= until_s:
                raise DeviceFailed(
                    "the robot tells where it stands too late",
                    consequence="No pose was taken",
                    cure="Look at the robot's link, and at what else this computer does",
                )
            self.clock.sleep_until(self.clock.now_s() + LOOK_S)
        return reading

    def _turn_vectors(self) -> Array:
        """Return the turns against their mean (n, 3), rotation vectors in the axes of the hand, else of the target."""
        arm = self.moved_by()
        if arm is None:
            turns = Rotation.from_matrix(np.array([np.asarray(p.T_parent_target)[:3, :3] for p in self._poses]))
        else:
            turns = Rotation.from_matrix(arm.fk(arm.values(np.array(self._joints)))[:, :3, :3])
        return np.asarray((turns.mean().inv() * turns).as_rotvec())

    def drop(self, index: int) -> None:
        """Forget a pose."""
        del self._poses[index]
        if self._joints:
            del self._joints[index]

    def require(self) -> None:
        """Raise NotEnoughData where too few poses were taken."""
        if len(self._poses) < self.fewest:
            raise NotEnoughData(
                f"{len(self._poses)} poses were taken",
                consequence="Nothing was calibrated",
                cure=f"Take {self.fewest} at least, better {self.enough}",
            )


@dataclass(slots=True, kw_only=True)
class TipCalibrationStep(PoseSamples):
    """The tool's tip rests on a point while the target is turned about it."""

    name: str = "tooltip"
    enough: int = 30
    fewest: int = 8

    def run(self, progress: Progress) -> StepResult:
        """Write poses.csv and tip.yaml."""
        self.require()
        progress.update(0, 0, "solving")
        poses = self.folder / "poses.csv"
        poses.parent.mkdir(parents=True, exist_ok=True)
        write_poses(poses, self._poses)
        tip = calibrate_tool_tip(poses, out=self.out)
        std_m = float(np.linalg.norm(tip.std_tip.translation_m))
        rows = (
            ("tip", " ".join(f"{1e3 * v:.2f}" for v in tip.tip_m) + " mm in target axes"),
            ("± tip", f"{1e3 * std_m:.3f} mm (1 σ)"),
            ("the tip stayed within", f"{1e3 * tip.residual_rms_m:.3f} mm RMS"),
        )
        return StepResult(verdict=tip.verdict_, rows=rows, file=self.out)


@dataclass(slots=True, kw_only=True)
class HandEyeStep(PoseSamples):
    """The robot carries the cameras or the target to several poses; arm: the model that gives its flange."""

    arm: Path
    setup: Setup = Setup.EYE_IN_HAND
    name: str = "handeye"
    enough: int = 12
    fewest: int = 5

    def moved_by(self) -> Arm:
        """Return the arm's model, read once. Raises BadFile."""
        self._loaded = self._loaded or load_arm(str(self.arm))
        return self._loaded

    def run(self, progress: Progress) -> StepResult:
        """Write pairs.csv, handeye.yaml and its report."""
        self.require()
        progress.update(0, 0, "solving")
        arm = self.moved_by()
        T_base_flange = [arm.T_world_base.inv() * flange_pose(arm, q) for q in self._joints]
        seen = [RigidTransform.from_matrix(np.asarray(pose.T_parent_target)) for pose in self._poses]
        pairs = self.folder / "pairs.csv"
        pairs.parent.mkdir(parents=True, exist_ok=True)
        names = [sample.name for sample in self.samples]
        covariance = np.array([pose.covariance for pose in self._poses])
        known = bool((np.diagonal(covariance, axis1=1, axis2=2) > 0.0).all())
        write_pairs(pairs, PosePairs.of(T_base_flange, seen, names, covariance if known else None))
        done = calibrate_hand_eye(pairs=pairs, out=self.out, setup=self.setup, progress=progress)
        rows = (
            ("pairs used", f"{done.n_used} of {done.n_pairs}"),
            (
                "a pair predicted from the others",
                f"{1e3 * done.loo_rms_m:.2f} mm, {done.loo_rms_rad / DEG:.3f} deg RMS",
            ),
        )
        return StepResult(verdict=done.verdict_, rows=rows, file=self.out, report=report_path(self.out))


@dataclass(slots=True, kw_only=True)
class ArmStep(PoseSamples):
    """The robot moves the target to many poses; its geometry is corrected where the data prove a gain."""

    model: str
    name: str = "arm"
    enough: int = 40
    fewest: int = 15

    def moved_by(self) -> Arm:
        """Return the arm's model, read once. Raises BadFile."""
        self._loaded = self._loaded or load_arm(self.model)
        return self._loaded

    def run(self, progress: Progress) -> StepResult:
        """Write points.csv, arm.yaml and its report."""
        self.require()
        progress.update(0, 0, "solving")
        points = self.folder / "points.csv"
        points.parent.mkdir(parents=True, exist_ok=True)
        n = len(self._joints[0])
        header = ",".join([*(f"q{i + 1}" for i in range(n)), *POSE7])
        rows = [
            cells([*q.tolist(), *T[:3, 3].tolist(), *Rotation.from_matrix(T[:3, :3]).as_quat(canonical=True).tolist()])
            for q, T in zip(self._joints, (np.asarray(p.T_parent_target) for p in self._poses), strict=True)
        ]
        write_text(points, "\n".join([header, *rows]) + "\n")
        done = calibrate_arm(self.model, points, out=self.out)
        left_out = done.crossval
        shown = (
            ("rows", str(done.n)),
            ("left-out error before", f"{1e3 * left_out.before.rms_m:.2f} mm RMS"),
            ("left-out error after", f"{1e3 * left_out.after.rms_m:.2f} mm RMS"),
        )
        return StepResult(verdict=done.verdict_, rows=shown, file=self.out, report=report_path(self.out))
