"""What the cameras saw, as rays with the line and the steady stamp of each spot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armsight.arrays import Array
from armsight.calibrate.timing.stamps import SteadyStamps
from armsight.errors import NotEnoughData
from armsight.fitting.groups import whitener
from armsight.optics import Rig
from armsight.records import SpotTrack

STEP_PX = 0.5
"""For the derivative of a ray by its pixel: a lens bends over hundreds of pixels."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Views:
    """Spots (m,) of all cameras: side, their place in the rig; light; frame time by the camera's own steady clock; line
    from -0.5 to 0.5; std_px as given; equations A (m, 2, 3) X = b (m, 2) of a point in rig axes, whitened but for its
    depth, which is depth_row (m, 3) X + depth_off (m,). pairs (p, 2): lights whose distance is the same at all times.
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
    names: tuple[str, ...]
    pairs: NDArray[np.intp]

    def __len__(self) -> int:
        return len(self.side)

    def take(self, kept: NDArray[np.bool_]) -> Views:
        """Return some of them."""
        rows = ("side", "light", "stamp_s", "line", "std_px", "A", "b", "depth_row", "depth_off")
        return Views(**{name: getattr(self, name)[kept] for name in rows}, names=self.names, pairs=self.pairs)

    def scaled(self, std: Array) -> Views:
        """Return them with the standard deviations of each camera's spots multiplied by these (V,)."""
        factor = 1.0 / std[self.side]
        A, b = self.A * factor[:, None, None], self.b * factor[:, None]
        rows = ("side", "light", "stamp_s", "line", "std_px", "depth_row", "depth_off", "names", "pairs")
        return Views(**{name: getattr(self, name) for name in rows}, A=A, b=b)


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


def views_of(rig: Rig, tracks: Sequence[SpotTrack], clocks: Sequence[SteadyStamps], names: tuple[str, ...]) -> Views:
    """Return the spots of the named lights in all cameras, tracks and clocks in the rig's order."""
    parts: dict[str, list[Array]] = {}
    for s, (side, track, clock) in enumerate(zip(rig.names, tracks, clocks, strict=True)):
        kept = np.flatnonzero([name in names for name in track.names])
        for key, value in _equations(rig, side, track.uv_px[kept], track.covariance_px2[kept]).items():
            parts.setdefault(key, []).append(value)
        parts.setdefault("side", []).append(np.full(len(kept), s))
        parts.setdefault("light", []).append(np.array([names.index(track.names[i]) for i in kept]))
        parts.setdefault("stamp_s", []).append(clock.t_s[track.frame[kept]])
        spread = np.sqrt(np.trace(track.covariance_px2[kept], axis1=1, axis2=2) / 2.0)
        parts.setdefault("std_px", []).append(spread)
        parts.setdefault("line", []).append(track.uv_px[kept, 1] / (rig.camera(side).height - 1) - 0.5)
    columns = {key: np.concatenate(values) for key, values in parts.items()}
    seen = np.asarray(np.isfinite(columns["A"]).all(axis=(1, 2)))
    return Views(
        side=columns["side"].astype(np.intp),
        light=columns["light"].astype(np.intp),
        **{key: columns[key] for key in ("stamp_s", "line", "std_px", "A", "b", "depth_row", "depth_off")},
        names=names,
        pairs=rigid_pairs(len(names)),
    ).take(seen)


def rigid_pairs(n: int) -> NDArray[np.intp]:
    """Return the pairs (p, 2) of n lights whose distances make them rigid: all of three, three for each further one."""
    pairs = [(a, b) for b in range(n) for a in range(min(b, 3))]
    return np.array(pairs, dtype=np.intp).reshape(-1, 2)


def _equations(rig: Rig, side: str, uv: Array, cov: Array) -> dict[str, Array]:
    camera, T = rig.camera(side), rig.T_rig_camera(side).inv()
    R, t = T.rotation.as_matrix(), np.asarray(T.translation)
    xy = camera.rays(uv)  # (m, 2)
    J = np.stack(
        [(camera.rays(uv + e) - camera.rays(uv - e)) / (2.0 * STEP_PX) for e in STEP_PX * np.eye(2)], axis=2
    )  # (m, 2, 2) of rays by pixels
    # X on the ray (x, y): (R1 - x R3) X = x t3 - t1, y likewise, whitened by the ray's covariance; its error is the
    # ray's times the depth
    W = whitener(J @ cov @ J.transpose(0, 2, 1))  # (m, 2, 2)
    A = W @ (R[None, :2] - xy[:, :, None] * R[None, 2:])  # (m, 2, 3)
    b = (W @ (xy * t[2] - t[:2])[:, :, None])[:, :, 0]
    return {"A": A, "b": b, "depth_row": np.tile(R[2], (len(uv), 1)), "depth_off": np.full(len(uv), t[2])}
