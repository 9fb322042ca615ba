"""What the calibration of an arm writes: arm.yaml, and beside it the URDF, the corrections, what to measure next."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from armsight.arrays import Array
from armsight.calibrate.arm import ArmResult
from armsight.errors import Inconsistent
from armsight.kinematics import Arm, JointType
from armsight.kinematics.derivatives import nearest_rigid
from armsight.store.arm_file import write_arm
from armsight.store.atomic import disk_errors, write_text
from armsight.store.tables import cells
from armsight.store.urdf import delete_urdf, urdf_text
from armsight.units import displayed

CORRECTIONS, URDF, PROPOSED = ".corrections.csv", ".urdf", ".proposed.csv"
"""Endings of what is written beside arm.yaml."""


def write_calibrated_arm(path: Path, result: ArmResult, *, inputs: Sequence[Path] = ()) -> None:
    """Write arm.yaml and what belongs beside it; what an earlier run wrote there and this one does not goes."""
    _write_proposal(path, result)
    write_arm(path, result.arm, inputs=inputs)
    write_text(path.with_suffix(CORRECTIONS), corrections(result))
    text, _ = as_urdf(result.arm)
    if text:
        write_text(path.with_suffix(URDF), text)
    else:  # an earlier run's is of another arm than the arm.yaml beside it
        delete_urdf(path.with_suffix(URDF))


def as_urdf(arm: Arm) -> tuple[str, str]:
    """Return the arm as a URDF, one that gives way as the nearest rigid one, and what is lost by that.

    '' where joint scales or couplings have no place in one.
    """
    rigid = nearest_rigid(arm) if arm.compliant else None
    try:
        return urdf_text(arm if rigid is None else rigid.arm), "" if rigid is None else rigid.lost
    except Inconsistent:
        return "", ""


def _write_proposal(out: Path, result: ArmResult) -> None:
    """Write further joint positions to measure at; without any, no such file of an earlier run stays."""
    path = out.with_suffix(PROPOSED)
    if result.proposals is None:
        with disk_errors(out):
            path.unlink(missing_ok=True)
        return
    names = ",".join(f"q{i + 1}" for i in range(result.nominal.n))
    write_text(path, "\n".join([names, *map(cells, result.proposals)]) + "\n")


def corrections(result: ArmResult) -> str:
    """Return a CSV text in a controller's terms: per joint the zero to add to its reading, its standard deviation, the
    scale.

    Where readings are coupled, value = gearing @ reading: zeros of the readings give those of the values by it.
    """
    joints = result.nominal.joints
    names = [f"{j.name}.{'theta_rad' if j.type is JointType.REVOLUTE else 'd_m'}" for j in joints]
    sign = np.array([joint.sign for joint in joints])
    to_readings = result.arm.gearing_back / sign  # (n, n): of changes of theta or d
    zeros = to_readings @ [result.change(name) for name in names]
    doubts = np.sqrt(np.diag(to_readings @ _zero_covariance(result, names) @ to_readings.T))
    rows = ["joint,zero_correction,unit,std,scale"]
    for joint, zero, std in zip(joints, zeros.tolist(), doubts.tolist(), strict=True):
        unit, size = displayed("rad" if joint.type is JointType.REVOLUTE else "m")
        uncertainty = f"{std / size:.6g}" if std > 0.0 else ""
        scale = 1.0 + result.change(f"{joint.name}.scale")
        rows.append(f"{joint.name},{zero / size + 0.0:.6g},{unit},{uncertainty},{scale:.8g}")
    return "\n".join(rows) + "\n"


def _zero_covariance(result: ArmResult, names: Sequence[str]) -> Array:
    """Return the covariance (n, n) of the joints' zeros, 0 where one is not corrected."""
    free = tuple(name for name in names if name in result.free)
    C = np.zeros((len(names), len(names)))
    if result.covariance is not None and free:
        at = [names.index(name) for name in free]
        C[np.ix_(at, at)] = result.covariance.block(free)
    return C
