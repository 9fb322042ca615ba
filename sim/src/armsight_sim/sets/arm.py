"""Joint readings of an arm that is not quite its data sheet, with where its tool was measured; and a holdout."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from armsight_sim.arms import SimArm, SimJoint, pose_mapping
from armsight_sim.sets.dataset import Dataset, Table, checked_size

USUAL, LEAST, HOLDOUT, OBSERVED = 60, 30, 20, 24
LENGTH_M, ANGLE_RAD = 0.0006, 0.0006
"""Normal errors of the arm that was built, of lengths and of angles."""
TRACKER_M, CAMERAS_M = 0.00005, 0.0003
"""Normal errors of a measured place along each axis: by a tracker, and by the rig's cameras."""
HALF = np.pi / 2.0
NOMINAL = SimArm(
    joints=(
        SimJoint(name="j1", d_m=0.1273, alpha_rad=HALF, lower=-2.0 * np.pi, upper=2.0 * np.pi),
        SimJoint(name="j2", a_m=-0.612, lower=-2.0 * np.pi, upper=2.0 * np.pi),
        SimJoint(name="j3", a_m=-0.5723, lower=-2.0 * np.pi, upper=2.0 * np.pi),
        SimJoint(name="j4", d_m=0.163941, alpha_rad=HALF, lower=-2.0 * np.pi, upper=2.0 * np.pi),
        SimJoint(name="j5", d_m=0.1157, alpha_rad=-HALF, lower=-2.0 * np.pi, upper=2.0 * np.pi),
        SimJoint(name="j6", d_m=0.0922, lower=-2.0 * np.pi, upper=2.0 * np.pi),
    )
)
"""The UR10's data sheet."""
HOME = np.array([0.0, -1.2, 1.5, -0.5, 1.4, 0.0])
REACH = np.array([1.4, 0.6, 0.8, 1.2, 1.0, 2.5])
TOOL_M = {"A": np.array([0.03, 0.0, 0.12]), "B": np.array([-0.05, 0.06, 0.09])}
T_TRACKER_BASE = RigidTransform.from_components([1.9, -0.4, 0.3], Rotation.from_euler("z", 130.0, degrees=True))
T_BASE_RIG = RigidTransform.from_components(
    [-1.7, -0.1, 0.3], Rotation.from_euler("ZYX", [-90.0, 0.0, -90.0], degrees=True)
)


def arm_set(seed: int, size: int | None = None) -> Dataset:
    """Return a set for `calibrate arm` and `calibrate robot-world`: a UR10 beside its data sheet.

    size: rows of points.csv. Raises UsageError for too few.
    """
    n = checked_size(size, USUAL, LEAST, "rows")
    rng = np.random.default_rng(seed)
    true = NOMINAL.with_errors(rng, LENGTH_M, ANGLE_RAD)
    tool = RigidTransform.from_translation(TOOL_M["A"])
    return Dataset(
        name="arm-points",
        seed=seed,
        arms={
            "arm.yaml": NOMINAL.mapping(RigidTransform.identity()),
            "arm_tool.yaml": true.mapping(tool),
            "arm_true.yaml": true.mapping(tool),
        },
        tables={
            "points.csv": _measured(true, n, rng, T_TRACKER_BASE, TRACKER_M, tuple(TOOL_M)),
            "holdout.csv": _measured(true, HOLDOUT, rng, T_TRACKER_BASE, TRACKER_M, tuple(TOOL_M)),
            "observed.csv": _measured(true, OBSERVED, rng, T_BASE_RIG.inv(), CAMERAS_M, ("A",)),
        },
        truths={
            "places_true.yaml": {
                "T_tracker_base": pose_mapping(T_TRACKER_BASE),
                "T_base_rig": pose_mapping(T_BASE_RIG),
                "points_m": {name: position.tolist() for name, position in TOOL_M.items()},
            }
        },
        commands=(
            "armsight calibrate arm --model arm.yaml --points points.csv --holdout holdout.csv -o calibrated.yaml",
            "armsight calibrate robot-world --arm arm_tool.yaml --points observed.csv -o world.yaml",
        ),
        assumptions=(
            f"arm: a UR10 whose lengths differ from the data sheet by {LENGTH_M} m, whose angles by {ANGLE_RAD} rad",
            f"places measured with normal errors of {TRACKER_M} m an axis (observed.csv: {CAMERAS_M} m)",
            f"joints: {HOME.tolist()} rad, up to {REACH.tolist()} rad to either side; points {sorted(TOOL_M)} in turn",
        ),
    )


def _measured(
    arm: SimArm,
    n: int,
    rng: np.random.Generator,
    T_tracker_base: RigidTransform,
    noise_m: float,
    points: tuple[str, ...],
) -> Table:
    """Return joint readings with where a point of the tool was measured, the points in turn."""
    rows: list[list[float | str]] = []
    for index in range(n):
        q = HOME + rng.uniform(-REACH, REACH)
        name = points[index % len(points)]
        position = T_tracker_base.apply(arm.flange(q).apply(TOOL_M[name])) + rng.normal(0.0, noise_m, 3)
        rows.append([*q.tolist(), *position.tolist(), name])
    columns = (*(f"q{i + 1}" for i in range(arm.n)), "x_m", "y_m", "z_m", "point")
    return columns, rows
