"""What an identification returns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armsight.calibrate.identify.chain import Axis
from armsight.kinematics import Arm

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointFound:
    """One joint.

    axis: with all joints at zero, in rig axes. measured: as its sweep saw it, with centre or a point of the line.
    radius_m: of the circle, 0 of a line. p_line: probability that a line leaves as much. decided: whether the type is
    beyond doubt. std: of the table's entries, NaN where an entry is chosen and not measured. rows: of its sweep, kept;
    discarded: (row, why).
    """

    axis: Axis
    measured: Axis
    radius_m: float
    p_line: float
    decided: bool
    std: dict[str, float]
    travel: tuple[float, float]
    rows: NDArray[np.intp]
    discarded: tuple[tuple[int, str], ...]
    residual_rms_m: float
    residual_rms_px: float | None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Identification:
    """The arm, its joints, and what to know about them.

    sigma: noise found, px with a rig, else m (or a factor on the given covariances). predicted_m: (m, 3) where the
    result puts the beacon at each reading. beacon_m: with all joints at zero, in rig axes.
    """

    arm: Arm
    joints: tuple[JointFound, ...]
    method: str
    notes: tuple[str, ...]
    sigma: float
    predicted_m: Array
    beacon_m: Array
