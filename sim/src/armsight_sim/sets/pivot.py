"""A driver with a target at its grip, whose tip rests on a point while it is turned; and a robot's tool alike."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array
from armsight.records import Frame
from armsight_sim.cells import hand_cell
from armsight_sim.rigs import SIDES
from armsight_sim.sets.dataset import QUATERNION, Dataset, checked_size, row_of, with_noise

USUAL, LEAST = 60, 12
TIP_M = np.array([0.004, 0.118, 0.021])
"""The tip in the target's axes."""
POINT_M = np.array([0.05, 0.09, 0.80])
"""Where it rests, in the rig's axes."""
TOOL_M = np.array([0.012, -0.007, 0.164])
"""The tip of the robot's tool in the flange's axes."""
REST_M = np.array([0.55, -0.12, 0.15])
"""Where that tip rests, in the base's axes."""
TRUTH = {
    "target": {"tip_m": TIP_M.tolist(), "point_m": POINT_M.tolist()},
    "flange": {"tip_m": TOOL_M.tolist(), "point_m": REST_M.tolist()},
}
ROBOT_M, ROBOT_RAD = 0.00005, 0.0002
FPS = 10.0
TURN_RAD = np.array([0.40, 0.35, 0.45])
FLANGE_STREAM = 7


@dataclass(frozen=True, slots=True, eq=False)
class _Pivoting:
    """T_rig_target of a target whose tip stays where it is."""

    phase: Array

    def __call__(self, t_s: Array) -> RigidTransform:
        swing = np.sin(2.0 * np.pi * np.asarray(t_s)[:, None] / np.array([3.1, 4.3, 5.9]) + self.phase) * TURN_RAD
        turn = Rotation.from_rotvec(swing)
        return RigidTransform.from_components(POINT_M - turn.apply(TIP_M), turn)


def pivot_set(seed: int, size: int | None = None) -> Dataset:
    """Return a set for `calibrate pivot` and `calibrate tooltip`: frames of a pivoting target, and a robot's poses.

    size: how many frames of each camera. Raises UsageError for too few.
    """
    n = checked_size(size, USUAL, LEAST, "frames")
    phase = np.random.default_rng([seed, FLANGE_STREAM]).uniform(0.0, 2.0 * np.pi, 3)
    cell = replace(hand_cell(seed, n), name="pivot", fps=FPS, path=_Pivoting(phase), events=())
    t_s = np.arange(n) / FPS
    rng = np.random.default_rng([seed, FLANGE_STREAM, 1])

    def images() -> Iterator[tuple[str, Frame]]:
        for index, pair in enumerate(cell.frames()):
            for side, frame in zip(SIDES, pair, strict=True):
                yield f"{side}/{index:06d}", frame

    return Dataset(
        name="pivot",
        seed=seed,
        n_images=2 * n,
        images=images,
        rigs={"rig.yaml": cell.rig},
        targets={"target.yaml": cell.target},
        tables={
            "times.csv": (("t_s",), [[float(at)] for at in t_s]),
            "flange.csv": (("t_s", *QUATERNION), _flange(t_s, phase, rng)),
        },
        truths={"tip_true.yaml": TRUTH},
        commands=(
            "armsight calibrate pivot --rig rig.yaml --target target.yaml --left left --right right -o tip.yaml",
            "armsight measure --rig rig.yaml --target target.yaml --left left --right right -o run",
            "armsight calibrate tooltip --poses run/poses.csv -o tip-of-poses.yaml",
            "armsight calibrate tooltip --poses flange.csv -o tool.yaml",
        ),
        assumptions=(
            *cell.assumptions,
            f"tip: {TIP_M.tolist()} m in the target, on {POINT_M.tolist()} m of the rig; turned up to "
            f"{np.rad2deg(TURN_RAD).round().tolist()} deg about x, y, z",
            f"robot: tip {TOOL_M.tolist()} m in the flange, read with normal errors of {ROBOT_M} m and {ROBOT_RAD} rad",
        ),
    )


def _flange(t_s: Array, phase: Array, rng: np.random.Generator) -> list[list[float | str]]:
    """Return rows of T_base_flange of a robot that turns its tool about the tip."""
    rows: list[list[float | str]] = []
    for at_s in t_s.tolist():
        swing = np.sin(2.0 * np.pi * at_s / np.array([3.7, 4.9, 2.9]) + phase) * TURN_RAD
        turn = Rotation.from_rotvec([np.pi, 0.0, 0.0]) * Rotation.from_rotvec(swing)
        pose = RigidTransform.from_components(REST_M - turn.apply(TOOL_M), turn)
        rows.append([at_s, *row_of(with_noise(pose, rng, length_m=ROBOT_M, angle_rad=ROBOT_RAD))])
    return rows
