"""How far a rig may be off: the directions in which its cameras' numbers may be wrong, one standard deviation each."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array
from armsight.optics import INTRINSICS, Camera, PackedRig, Rig
from armsight.optics.camera import with_step
from armsight.optics.rig import PLACE

EXACT = 1e-9
"""Share of the largest below which an eigenvalue of the correlations is rounding."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RigDoubt:
    """A rig is off by z (k,) of mean 0 and deviation 1: by std (V, n + 6) times root (V, n + 6, k) z in each
    camera's n intrinsics and pose."""

    std: Array
    root: Array

    @property
    def size(self) -> int:
        """Number of directions."""
        return int(self.root.shape[2])

    def times(self, factor: float) -> RigDoubt:
        """Return that of a rig that may be off by so many times as much."""
        return replace(self, root=factor * self.root)

    @classmethod
    def none(cls, V: int, n: int = len(INTRINSICS)) -> RigDoubt:
        """Return that of a rig of V cameras, n intrinsics each, that is taken as exact."""
        return cls(std=np.zeros((V, n + len(PLACE))), root=np.zeros((V, n + len(PLACE), 0)))

    @classmethod
    def of(cls, rig: Rig) -> RigDoubt:
        """Return that of a rig's covariance; none where it brings none."""
        V, C, n = len(rig.cameras), PackedRig.of(rig).covariance, PackedRig.of(rig).n_intrinsics
        if not C.any():
            return cls.none(V, n)
        own = np.arange(n * V).reshape(V, n)
        place = n * V + np.arange(len(PLACE) * (V - 1)).reshape(V - 1, len(PLACE))
        std = np.sqrt(C.diagonal())
        free = np.flatnonzero(std)
        # of correlations: px, m and rad would put rounding of one above doubt of another
        values, axes = np.linalg.eigh(C[np.ix_(free, free)] / np.outer(std[free], std[free]))
        kept = values > EXACT * values[-1]
        L = np.zeros((len(std), int(kept.sum())))
        L[free] = axes[:, kept] * np.sqrt(values[kept])
        each = [np.concatenate([own[s], place[s - 1]]) if s else own[s] for s in range(V)]
        none = cls.none(V, n)
        root = np.zeros((*none.std.shape, L.shape[1]))
        for s, at in enumerate(each):
            none.std[s, : len(at)], root[s, : len(at)] = std[at], L[at]
        return cls(std=none.std, root=root)


def moved_camera(camera: Camera, T_rig_camera: RigidTransform, step: Array) -> tuple[Camera, RigidTransform]:
    """Return a camera and its pose moved by a step (n + 6,): intrinsics, t + dt and Exp(dw) R."""
    turned = Rotation.from_rotvec(step[-3:]) * T_rig_camera.rotation
    at = np.asarray(T_rig_camera.translation) + step[-6:-3]
    return with_step(camera, step), RigidTransform.from_components(at, turned)
