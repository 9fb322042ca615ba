"""What is said of an arm whose zeros, or whose geometry, are off."""

from __future__ import annotations

from armsight.arrays import Array
from armsight.kinematics import Arm
from armsight.verify.model import JointVerdict, shown


def far_zeros(arm: Arm, joints: tuple[JointVerdict, ...], least: Array) -> str:
    """Return in words the zeros that are off by more than four deviations and least (n,); "" for none."""
    names = ["zero_rad" if turning else "zero_m" for turning in arm.revolute]
    off = [f"joint {i + 1} ({shown(names[i], *pair)})" for i, pair in _far(joints) if abs(pair[0]) > least[i]]
    return ", ".join(off)


def _far(joints: tuple[JointVerdict, ...]) -> list[tuple[int, tuple[float, float]]]:
    """Return the joints (from 0) whose zeros are off by more than four deviations: zero, deviation."""
    known = [(i, (v.offset, v.std)) for i, v in enumerate(joints) if v.offset is not None and v.std is not None]
    return [(i, (zero, std)) for i, (zero, std) in known if abs(zero) > 4.0 * std]


def several_off(joints: tuple[JointVerdict, ...], gains: dict[str, float]) -> str:
    """Return in words that several zeros are off; gains: shares that they take off."""
    far = [i + 1 for i, _ in _far(joints)]
    beyond = f" (those beyond four standard deviations: {', '.join(map(str, far))})" if far else ""
    return (
        f"Several joints' zeros are off{beyond}: together they take {100 * gains['zeros']:.3g} % off left-out squares."
    )


def model_off(gains: dict[str, float], joint: int, off: str) -> str:
    """Return in words that the geometry is the cause; joint (from 0): the best single one. off: zeros as far_zeros."""
    rows = "on these rows (of measurements and joints in two files `armsight join --as points` makes one)"
    either = f" Zeros ({off}) explain much as well: rows over more of the arm's range tell which it is." if off else ""
    return (
        f"The arm's model is the cause: correcting its geometry takes {100 * gains['model']:.3g} % off the squared "
        f"errors of rows left out, the best single joint (joint {joint + 1}) {100 * gains['joint']:.3g} "
        f"%.{either} Joint zeros read from a wrong model are not to be believed: run `armsight calibrate arm` {rows}."
    )
