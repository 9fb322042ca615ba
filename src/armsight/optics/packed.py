"""A rig as plain arrays, the form in which the compiled code takes it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from armsight.optics.camera import SIDES
from armsight.records import frozen_array

if TYPE_CHECKING:
    from armsight.optics.rig import Rig

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PackedRig:
    """Intrinsics and plates k (2, 12); R (2, 3, 3), t (2, 3) with p_camera = R p_rig + t; baseline (3,) m.

    First index: left, right. covariance: (26, 26) of Rig.parameters where the calibration brings one, zero for the
    parameters it held fixed; (0, 0) where the rig is taken as exact.
    """

    k: Array
    R: Array
    t: Array
    baseline: Array
    covariance: Array

    @property
    def arrays(self) -> tuple[Array, Array, Array]:
        """The cameras as compiled code takes them, a RigK: a plain tuple is handed to it in half the time."""
        return self.k, self.R, self.t

    def camera(self, side: int) -> tuple[Array, Array, Array]:
        """Return one of them, a CameraK; side 0: left, 1: right."""
        return self.k[side], self.R[side], self.t[side]

    @classmethod
    def of(cls, rig: Rig) -> PackedRig:
        """Return a rig packed, which is done once and kept with it."""
        found = rig.found.get("packed")
        if not isinstance(found, PackedRig):
            found = rig.found["packed"] = cls._pack(rig)
        return found

    @classmethod
    def _pack(cls, rig: Rig) -> PackedRig:
        poses = [rig.T_rig_camera(side).inv() for side in SIDES]
        return cls(
            k=frozen_array("k", [rig.camera(side).packed for side in SIDES], (2, 12)),
            R=frozen_array("R", [pose.rotation.as_matrix() for pose in poses], (2, 3, 3)),
            t=frozen_array("t", [pose.translation for pose in poses], (2, 3)),
            baseline=frozen_array("baseline", rig.T_rig_right.translation - rig.T_rig_left.translation, (3,)),
            covariance=frozen_array("covariance", _covariance(rig), (None, None)),
        )


def _covariance(rig: Rig) -> Array:
    if rig.covariance is None:
        return np.empty((0, 0))
    names = rig.parameters
    named = [i for i, name in enumerate(names) if name in rig.covariance.names]
    out = np.zeros((len(names), len(names)))
    out[np.ix_(named, named)] = rig.covariance.block(tuple(names[i] for i in named))
    return out
