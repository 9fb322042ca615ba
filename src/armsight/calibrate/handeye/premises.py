"""What a hand-eye calibration of pairs rests on: a camera and a target that stay where they are."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from armsight.calibrate.handeye.result import HandEyeResult
from armsight.calibrate.tooltip_premises import two_settings
from armsight.errors import Inconsistent
from armsight.units import DEG, MM


def require_one_mount(found: HandEyeResult, place: NDArray[np.intp]) -> None:
    """Raise Inconsistent where the pairs, in their order, fall into two parts with a camera and a target each.

    place (n,): at which pose of the robot each was taken; what follows at the same one counts once, by its
    mean: their errors are alike. Where target and robot differ in scale, that explains what is left, and is told.
    """
    if found.scale is not None and found.scale.wrong:
        return
    t_s = np.arange(len(place), dtype=np.float64) if found.pairs.t_s is None else found.pairs.t_s
    rows = np.flatnonzero(found.used)
    rows = rows[np.argsort(t_s[rows], kind="stable")]
    RF, tF, RB, tB = (a[rows] for a in found.pairs.arrays(found.setup))
    at = np.flatnonzero(np.diff(place[rows], prepend=-1))
    count = np.diff(at, append=len(rows))[:, None]
    RFX = RF @ found.T_parent_camera.rotation.as_matrix()
    turns = Rotation.from_matrix(RFX @ RB) * found.T_parent_target.rotation.inv()
    # with X's turn known F X B = Z asks of X's shift what a pivot asks of a tip; of X's small turn likewise
    for values, unit, word in ((np.einsum("nij,nj->ni", RFX, tB) + tF, MM, "mm"), (turns.as_rotvec(), DEG, "degrees")):
        told = two_settings(RF[at], np.add.reduceat(values, at) / count, t_s[rows[at]])
        if told is None:
            continue
        first = found.pairs.names[rows[at[told[0]]]]
        camera, target = (float(np.linalg.norm(v)) / unit for v in np.split(told[1], 2))
        raise Inconsistent(
            f"from {first} on the pairs want the camera elsewhere than those before, by {camera:.3g} {word}, and the "
            f"target, by {target:.3g} {word}",
            consequence="Camera or target slipped in between, or two recordings were put together; no calibration is "
            "given",
            cure=f"Calibrate the pairs before {first} and those from it on apart, or record again with both clamped",
        )
