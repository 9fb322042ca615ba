"""Cells that were calibrated again and again, without the calibrations: the results as they would be filed."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import numpy as np
from scipy.spatial.transform import Rotation

from armsight.kinematics import preset
from armsight.records import NamedCovariance
from armsight_lab.history.entry import Entry, Quantity, utc
from armsight_lab.history.figures import parameters_of
from armsight_lab.history.filing import entry_of_result

START = datetime(2026, 1, 5, 8, 0, tzinfo=UTC)
DEG = np.pi / 180.0
ZERO_STD = np.array([0.0030, 0.0029, 0.0037, 0.0111, 0.0102, 0.0110]) * DEG
"""What `armsight calibrate arm` tells of joint zeros for the set of `armsight simulate arm-points`; of the first and
the last, which it leaves to base and tool, those of the second and the fourth."""


def runs(
    cell: str,
    n: int,
    *,
    every_days: float = 7.0,
    seed: int = 0,
    drift: Mapping[int, np.ndarray] | None = None,
    scatter: float = 1.0,
    start: datetime = START,
) -> Iterator[Entry]:
    """Yield n calibrations of an arm; drift: by joint from 1 what is added to its zero, rad (n,); scatter: of the runs
    over what they tell.
    """
    rng = np.random.default_rng(seed)
    nominal = preset("ur10")
    for i in range(n):
        moved = rng.standard_normal(6) * ZERO_STD * scatter
        for joint, course in (drift or {}).items():
            moved[joint - 1] += course[i]
        yield arm_run(nominal, cell, moved, start + timedelta(days=every_days * i))


def arm_run(nominal, cell: str, moved: np.ndarray, when: datetime) -> Entry:
    """Return the calibration of an arm that finds its zeros moved, rad (6,)."""
    added = zip(nominal.joints, moved.tolist(), strict=True)
    joints = tuple(replace(one, theta_rad=one.theta_rad + by) for one, by in added)
    names = tuple(f"{one.name}.theta_rad" for one in joints)
    covariance = NamedCovariance(names=names, matrix=np.diag(ZERO_STD[: len(joints)] ** 2))
    arm = replace(nominal, joints=joints, covariance=covariance)
    content = {"n": 60, "after": {"rms_m": 7e-5}, "gain": True, "verdict": "Correcting geometry takes the error down."}
    made = {"command": "calibrate arm", "cell": cell, "created": utc(when)}
    return entry_of_result(content, parameters_of(content, arm), (), **made)


def handeye_run(cell: str, xyz_m, rotation, when: datetime, std: float = 1e-4, *, concerns=()) -> Entry:
    """Return a hand-eye calibration."""
    names = ("x_m", "y_m", "z_m", "rx_rad", "ry_rad", "rz_rad")
    content = {
        "T_flange_camera": {"xyz_m": list(xyz_m), "quat_xyzw": rotation.as_quat().tolist()},
        "std": dict.fromkeys(names, std),
        "concerns": list(concerns),
        "residual_rms_m": 2e-4,
        "verdict": "known",
    }
    made = {"command": "calibrate handeye", "cell": cell, "created": utc(when)}
    return entry_of_result(content, parameters_of(content, None), (), **made)


def baseline_runs(cell: str, values: Sequence[float], std: float | None) -> Iterator[Entry]:
    """Yield weekly runs that tell a baseline, m; one whose deviation nobody tells is a figure alone."""
    for i, value in enumerate(values):
        number = (Quantity(name="baseline_m", value=value, std=std, unit="m"),)
        entry = handeye_run(cell, [0.1, 0.0, 0.05], Rotation.identity(), START + timedelta(days=7 * i))
        yield replace(entry, poses=(), figures=number, parameters=number if std else ())
