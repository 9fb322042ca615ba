"""Fingerprints of the rig and the target of a run, by which two runs are told to share them or not."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from armsight.measure.results import MadeWith
from armsight.optics import SIDES, Rig
from armsight.records import Target

DECIMALS = 9
"""m and px are compared to so many places: what a file's text or a quaternion's rounding changes is far below."""


def made_with(rig: Rig, target: Target) -> MadeWith:
    """Return the fingerprints of a rig's cameras and of a target's points: of what is measured with, not of files.

    A comment, a covariance or another name of the file changes nothing; a camera calibrated anew does.
    """
    cameras: list[ArrayLike] = []
    for side in SIDES:
        camera = rig.camera(side)
        plate = [] if camera.plate is None else [camera.plate.thickness_m, camera.plate.index]
        cameras += [[camera.width, camera.height, *plate], camera.intrinsics, rig.T_rig_camera(side).as_matrix()]
    lenses = [str(rig.camera(side).lens) for side in SIDES]
    return MadeWith(
        rig=_fingerprint([str(rig.kind), *lenses], cameras),
        target=_fingerprint([str(target.kind), str(target.model_known), *target.names], [target.xyz_m]),
    )


def _fingerprint(words: Sequence[str], numbers: Sequence[ArrayLike]) -> str:
    """Return the SHA-256, as 64 hexadecimal digits, of words and of numbers rounded to DECIMALS."""
    digest = hashlib.sha256("\n".join([*words, ""]).encode())
    for one in numbers:
        digest.update((np.round(np.asarray(one, dtype="<f8"), DECIMALS) + 0.0).tobytes())  # + 0.0: no -0.0
    return digest.hexdigest()
