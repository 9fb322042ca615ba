"""The chain of single calibrations in motion: board, waved target, then the free-running recording of the arm.

All goes through the commands' functions and their files, as a user does it: calibrate stereo, calibrate target,
calibrate timing, measure --timing free, join, calibrate arm. The arm's recording is the world's own, cut to what is
left of the pictures.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from armsight.calibrate.arm import ArmResult, calibrate_arm
from armsight.calibrate.cameras import calibrate_stereo
from armsight.calibrate.light_target import calibrate_target
from armsight.kinematics import fk
from armsight.ops.calibrate_rig import calibrate_timing
from armsight.ops.files import join
from armsight.ops.measure import measure
from armsight.store import write_rig, write_target
from armsight.store.arm_file import write_arm
from armsight.store.arm_points import read_arm_points
from cell_chain import BOARD, BOARDS, PICTURES, board_views, lit_frames, rests_of
from cell_records import Calibrated, arm_of, called_as_built, nominal_axes

Array = NDArray[np.float64]
STILLS, WAVED_S = 60, 20.0
"""Pairs of the target held still, of which its lights are measured, and how long it is waved."""
RATE_HZ, RATE_OF_POSES_HZ = 30.0, 5.0


def wave(rng: np.random.Generator, truth: Any, watched: Any) -> tuple[Any, Any]:
    """Return what both cameras see of the target waved irregularly where the arm works, before a dark ground."""
    T = truth.flange(truth.samples[:1])[0]
    centre, lights = truth.tips(truth.samples).mean(axis=0), truth.lights - truth.lights.mean(axis=0)
    period, phase = rng.uniform(0.9, 3.2, (5, 6)), rng.uniform(0.0, 2.0 * np.pi, (5, 6))
    size = np.repeat([0.07, 0.12], 3)

    def hand(t: Array) -> tuple[Array, Rotation]:
        x = (size * np.sin(2.0 * np.pi * t[:, None, None] / period + phase)).sum(axis=1)
        return centre + x[:, :3], Rotation.from_rotvec(x[:, 3:]) * Rotation.from_matrix(T[:3, :3])

    def way(t: Array, light: int) -> Array:
        at, turn = hand(t)
        return at + turn.apply(lights[light])

    def axes(t: Array) -> Array:
        return np.stack([hand(t)[1].apply(axis) for axis in truth.normals], axis=1)

    left, right = (
        watched(rng, camera, 10.0, WAVED_S, way, axes, np.empty((0, 3))) for camera in (truth.left, truth.right)
    )
    return left, right


def spot_table(track: Any, path: Path, frames: int | None = None, names: tuple[str, ...] = ()) -> Path:
    """Write a camera's spots as a table, of so many frames at most; with names: of the lights alone, by name."""
    rows = ["t_s,u_px,v_px,su_px,sv_px" + (",spot" if names else "")]
    std = np.sqrt(np.diagonal(track.covariance_px2, axis1=1, axis2=2))
    table = np.column_stack([track.t_s[track.frame], track.uv_px, std])
    kept = np.ones(len(table), bool) if frames is None else track.frame < frames
    for row, light in zip(table[kept].tolist(), track.light[kept].tolist(), strict=True):
        if light >= 0 or not names:
            rows.append(",".join(map(repr, row)) + (f",{names[light]}" if names else ""))
    path.write_text("\n".join(rows) + "\n")
    return path


def joint_log(world: Any, path: Path) -> Path:
    """Write the robot's log."""
    head = ",".join(["t_s", *(f"q{i + 1}" for i in range(world.log_q.shape[1]))])
    np.savetxt(path, np.column_stack([world.log_t_s, world.log_q]), fmt="%.9f", delimiter=",", header=head, comments="")
    return path


@dataclass(frozen=True, kw_only=True)
class MovingChain:
    """The chain's result in motion."""

    by_arm: Calibrated
    arm: ArmResult
    poses: int


def chain_moving(world: Any, made: ModuleType, *, pictures: int = PICTURES) -> MovingChain:
    """Calibrate the world's cell step by step with so many pairs of pictures."""
    rng = np.random.default_rng([world.seed, 78])
    truth, nominal = world.truth, arm_of(world)
    stereo = calibrate_stereo(*board_views(rng, truth), BOARD)
    stills = rests_of(rng, truth, made.ENCODER_RAD, STILLS, 1)
    target = called_as_built(calibrate_target(stereo.rig, lit_frames(stills), len(truth.lights)).target, world)
    frames = pictures - BOARDS - STILLS - int(WAVED_S * RATE_HZ)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_rig(folder / "rig.yaml", stereo.rig)
        write_target(folder / "target.yaml", target)
        write_arm(folder / "arm.yaml", nominal)
        left, right = wave(rng, truth, made.watched)
        tables = {
            "left_spots": spot_table(left, folder / "l.csv", names=target.names),
            "right_spots": spot_table(right, folder / "r.csv", names=target.names),
        }
        files = {"rig": folder / "rig.yaml", "target": folder / "target.yaml"}
        calibrate_timing(**files, **tables, out=folder / "timed.yaml")
        tables = {
            "left_spots": spot_table(world.left, folder / "left.csv", frames),
            "right_spots": spot_table(world.right, folder / "right.csv", frames),
        }
        files["rig"] = folder / "timed.yaml"
        measure(**files, **tables, out=folder / "out", timing="free", rate_hz=RATE_OF_POSES_HZ)
        join(
            folder / "out" / "poses.csv",
            out=folder / "points.csv",
            joints=joint_log(world, folder / "joints.csv"),
            arm=str(folder / "arm.yaml"),
        )
        points = read_arm_points(folder / "points.csv")
    done = calibrate_arm(nominal, points)
    by_arm = Calibrated(
        rig=stereo.rig,
        target=target,
        T_nominal=nominal_axes(target, world),
        T_base_rig=done.arm.T_world_base.inv(),
        commanded=partial(fk, done.arm.based()),
    )
    return MovingChain(by_arm=by_arm, arm=done, poses=len(points))
