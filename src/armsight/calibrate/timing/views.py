"""What the cameras saw, as rays with the line and the steady stamp of each spot, and how far their rig may be off."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array
from armsight.calibrate.timing.stamps import SteadyStamps
from armsight.errors import NotEnoughData
from armsight.fitting.groups import whitener
from armsight.optics import INTRINSICS, Camera, PackedRig, Rig
from armsight.optics.camera import with_step
from armsight.optics.rig import PLACE
from armsight.records import SpotTrack

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


STEP = 0.01
STEP_PX = 0.5
"""For the derivative of a ray by its pixel: a lens bends over hundreds of pixels."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Views:
    """Spots (m,) of all cameras: side, their place in the rig; light; frame time by the camera's own steady clock; line
    from -0.5 to 0.5; std_px as given; equations A (m, 2, 3) X = b (m, 2) of a point in rig axes, whitened but for its
    depth, which is depth_row (m, 3) X + depth_off (m,). moves (m, 2, 4, 16): how A and b follow their camera's numbers.
    pairs (p, 2): lights whose distance is the same at all times. doubt: of the rig.
    """

    side: NDArray[np.intp]
    light: NDArray[np.intp]
    stamp_s: Array
    line: Array
    std_px: Array
    A: Array
    b: Array
    depth_row: Array
    depth_off: Array
    moves: Array
    names: tuple[str, ...]
    pairs: NDArray[np.intp]
    doubt: RigDoubt

    def __len__(self) -> int:
        return len(self.side)

    def take(self, kept: NDArray[np.bool_]) -> Views:
        """Return some of them."""
        return replace(self, **{name: getattr(self, name)[kept] for name in ROWS})

    def scaled(self, std: Array) -> Views:
        """Return them with the standard deviations of each camera's spots multiplied by these (V,)."""
        factor = 1.0 / std[self.side]
        A, b = self.A * factor[:, None, None], self.b * factor[:, None]
        return replace(self, A=A, b=b, moves=self.moves * factor[:, None, None, None])

    def equations(self, z: Array) -> tuple[Array, Array]:
        """Return A and b of the rig that is off by z (k,) of its doubt."""
        if not len(z):
            return self.A, self.b
        off = np.einsum("mrji,mi->mrj", self.moves, (self.doubt.root @ z)[self.side])
        return self.A + off[:, :, :3], self.b + off[:, :, 3]

    def by_doubt(self, X: Array) -> Array:
        """Return the derivatives (m, 2, k) of A X - b by the rig's doubt, for points X (m, 3)."""
        # camera by camera: the directions of all cameras at once would be V times the memory
        own = np.einsum("mrji,mj->mri", self.moves, np.column_stack([X, -np.ones(len(X))]))
        out = np.empty((len(self), 2, self.doubt.size))
        for s, root in enumerate(self.doubt.root):
            out[self.side == s] = own[self.side == s] @ root
        return out


ROWS = ("side", "light", "stamp_s", "line", "std_px", "A", "b", "depth_row", "depth_off", "moves")
"""Fields of Views with a row for each spot."""


def common_lights(*tracks: SpotTrack) -> tuple[str, ...]:
    """Return the names of the lights that two cameras saw, those that these saw most first. Raises NotEnoughData."""
    seen = dict.fromkeys(name for track in tracks for name in track.names)
    counts = {name: sorted(track.names.count(name) for track in tracks)[-2] for name in seen}
    names = tuple(sorted((name for name, count in counts.items() if count), key=lambda name: (-counts[name], name)))
    if not names:
        raise NotEnoughData(
            f"no light was seen by {'both' if len(tracks) == 2 else 'two'} cameras",
            consequence="No timing is given",
            cure="Wave the target where both cameras see it, and give its lights the same names in both files",
        )
    return names


def views_of(
    rig: Rig, tracks: Sequence[SpotTrack], clocks: Sequence[SteadyStamps], names: tuple[str, ...], doubt: RigDoubt
) -> Views:
    """Return the spots of the named lights in all cameras, tracks and clocks in the rig's order."""
    parts: dict[str, list[Array]] = {}
    for s, (side, track, clock) in enumerate(zip(rig.names, tracks, clocks, strict=True)):
        kept = np.flatnonzero([name in names for name in track.names])
        for key, value in _equations(rig, s, track.uv_px[kept], track.covariance_px2[kept], doubt.std[s]).items():
            parts.setdefault(key, []).append(value)
        parts.setdefault("side", []).append(np.full(len(kept), s))
        parts.setdefault("light", []).append(np.array([names.index(track.names[i]) for i in kept]))
        parts.setdefault("stamp_s", []).append(clock.t_s[track.frame[kept]])
        spread = np.sqrt(np.trace(track.covariance_px2[kept], axis1=1, axis2=2) / 2.0)
        parts.setdefault("std_px", []).append(spread)
        parts.setdefault("line", []).append(track.uv_px[kept, 1] / (rig.camera(side).height - 1) - 0.5)
    columns = {key: np.concatenate(values) for key, values in parts.items()}
    seen = np.asarray(np.isfinite(columns["A"]).all(axis=(1, 2)) & np.isfinite(columns["moves"]).all(axis=(1, 2, 3)))
    return Views(
        side=columns["side"].astype(np.intp),
        light=columns["light"].astype(np.intp),
        **{key: columns[key] for key in ROWS[2:]},
        names=names,
        pairs=rigid_pairs(len(names)),
        doubt=doubt,
    ).take(seen)


def rigid_pairs(n: int) -> NDArray[np.intp]:
    """Return the pairs (p, 2) of n lights whose distances make them rigid: all of three, three for each further one."""
    pairs = [(a, b) for b in range(n) for a in range(min(b, 3))]
    return np.array(pairs, dtype=np.intp).reshape(-1, 2)


def _equations(rig: Rig, s: int, uv: Array, cov: Array, std: Array) -> dict[str, Array]:
    camera, T = rig.cameras[s].camera, rig.cameras[s].T_rig_camera
    J = np.stack(
        [(camera.rays(uv + e) - camera.rays(uv - e)) / (2.0 * STEP_PX) for e in STEP_PX * np.eye(2)], axis=2
    )  # (m, 2, 2) of rays by pixels
    # whitened by the ray's covariance; the error of X is the ray's times the depth
    W = whitener(J @ cov @ J.transpose(0, 2, 1))  # (m, 2, 2)
    A, b = _on_ray(camera, T, uv)
    moves = np.zeros((len(uv), 2, 4, len(std)))
    # a hundredth of its deviation: where numbers hang together a lens would fold that is off in one of them alone
    for i in np.flatnonzero(std):
        step = STEP * std[i] * np.eye(len(std))[i]
        ends = [np.concatenate(_on_ray(*moved_camera(camera, T, way * step), uv), axis=2) for way in (1.0, -1.0)]
        moves[..., i] = W @ (ends[0] - ends[1]) / (2.0 * STEP)
    R, t = T.inv().rotation.as_matrix(), np.asarray(T.inv().translation)
    known = {"A": W @ A, "b": (W @ b)[:, :, 0], "moves": moves}
    return known | {"depth_row": np.tile(R[2], (len(uv), 1)), "depth_off": np.full(len(uv), t[2])}


def _on_ray(camera: Camera, T_rig_camera: RigidTransform, uv: Array) -> tuple[Array, Array]:
    """Return A (m, 2, 3) and b (m, 2, 1) of a point X on the ray (x, y): (R1 - x R3) X = x t3 - t1, y likewise."""
    T, xy = T_rig_camera.inv(), camera.rays(uv)
    R, t = T.rotation.as_matrix(), np.asarray(T.translation)
    return R[None, :2] - xy[:, :, None] * R[None, 2:], (xy * t[2] - t[:2])[:, :, None]
