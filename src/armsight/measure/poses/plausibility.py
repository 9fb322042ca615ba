"""Could the lights look like this at the pose that fits them? And how far may a flat one's outline be off?"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from armsight.errors import Unseen
from armsight.measure.poses.correspondence import OUTLINE
from armsight.measure.poses.pose import Solved
from armsight.measure.poses.setup import Setup
from armsight.optics import PackedRig
from armsight.records import NotSeen, Spots

Array = NDArray[np.float64]

OUTLINE_SHARE = 0.35
"""Root mean square of sin a cos a over tilts of up to 90 degrees: see _add_outline_shift."""

WRONG_SIZE = 1.6
BLOOM_PX = 2.0
"""Ratio and px by which flat lights may look larger or smaller than their diameter says: tilt, blur and bloom."""


def add_outline_shift(packed: PackedRig, left: Spots, right: Spots, cov: Array) -> None:
    """Widen cov (n, 2, 2, 2) by how far the perspective may shift a flat light's outline that is not corrected for.

    The centre of a disc's image is off by r^2 sin a cos a / f, r in px, at a tilt of a.
    """
    for side, spots in enumerate((left, right)):
        if OUTLINE not in spots.model:
            continue
        for i, kind in enumerate(spots.model):
            if kind == OUTLINE:
                shift = OUTLINE_SHARE * spots.size_px[i] ** 2 / packed.k[side][0]
                cov[i, side] += shift * shift * np.eye(2)


def impossible(setup: Setup, names: tuple[str, ...], solved: Solved, left: Spots, right: Spots) -> NotSeen | None:
    """Return why the lights cannot look like this at the pose that fits them; None where they can."""
    if solved.T is None:
        return None
    model, packed = setup.model, setup.packed
    eye = -packed.R[0].T @ packed.t[0]
    if model.one_sided and solved.T[:3, 2] @ (solved.T[:3, 3] - eye) < 0.0:
        return NotSeen(
            "the lights fit the target seen from behind: a mirror image, or y counts upwards in target.yaml; "
            "z must point away from the cameras: change the sign of every y and z there",
            Unseen.WRONG_TARGET,
        )
    if model.radius_m <= 0.0:
        return None
    shares = []
    for side, spots in enumerate((left, right)):
        rows = [i for i, kind in enumerate(spots.model) if kind == OUTLINE]
        positions = solved.T[:3, :3] @ model.xyz_m[[model.names.index(names[i]) for i in rows]].T + solved.T[:3, 3:]
        depth = packed.R[side][2] @ positions + packed.t[side][2]
        whole = packed.k[side][0] * model.radius_m / depth
        shares += [(spots.size_px[i], r) for i, r in zip(rows, whole.tolist(), strict=True)]
    off = [size < r / WRONG_SIZE - BLOOM_PX or size > WRONG_SIZE * r + BLOOM_PX for size, r in shares]
    if 2 * sum(off) <= len(off):
        return None
    seen, wanted = np.median(np.array(shares), axis=0)
    return NotSeen(
        f"the lights are {2.0 * seen:.0f} px wide and would be {2.0 * wanted:.0f} px by diameter_m in target.yaml: "
        "correct it, or leave it out",
        Unseen.WRONG_TARGET,
    )
