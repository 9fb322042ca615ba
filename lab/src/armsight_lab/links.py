"""An arm's links as lines with a thickness: what they keep from walls and boxes, and from each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array, Mask
from armsight.kinematics import Arm, Convention, fk, in_convention

SHORT_M = 1e-3
"""A part of the chain that is shorter is none."""
NEAR = 1.5
"""Parts with less of the chain between them than so many thicknesses are built not to hit each other."""
MANY = 4096
"""Readings that are looked at together, so that memory stays small."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Wall:
    """A box by its corners (3,): room: to stay in, and else to stay out of. name: what messages call it."""

    name: str
    lower: Array
    upper: Array
    room: bool = False


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Links:
    """Where an arm's links are clear of walls by keep_m beside their radius_m, and of each other.

    A link is straight from one joint's axis to the next: along the axis, then across. The first part, along the first
    axis, stands on the base and is exempt from walls; a face of the room that the base is beyond is none for links.
    parts (k, 2): between which points of the chain; names (k,) of them.
    """

    arm: Arm
    radius_m: float
    keep_m: float
    walls: Sequence[Wall]
    prefixes: tuple[Arm, ...] = field(init=False)
    parts: NDArray[np.intp] = field(init=False)
    names: tuple[str, ...] = field(init=False)
    pairs: NDArray[np.intp] = field(init=False)

    def __post_init__(self) -> None:
        base = in_convention(self.arm.based(), Convention.STANDARD)
        joints = tuple(replace(joint, compliance=0.0, driven=True) for joint in base.joints)
        tool = RigidTransform.identity()
        bare = replace(base, joints=joints, couplings=(), tool_points=(), covariance=None, T_flange_tool=tool)
        ends = (*(joint.name for joint in joints), "the flange")
        object.__setattr__(self, "prefixes", tuple(replace(bare, joints=joints[: i + 1]) for i in range(self.arm.n)))
        rests = self.chain(np.zeros((1, self.arm.n)))[0]
        long_m = np.linalg.norm(np.diff(rests, axis=0), axis=1)
        slides = np.repeat(~self.arm.revolute, 2)
        kept = np.flatnonzero((long_m > SHORT_M) | slides)
        object.__setattr__(self, "parts", np.column_stack([kept, kept + 1]))
        object.__setattr__(self, "names", tuple(f"{ends[k // 2]} to {ends[k // 2 + 1]}" for k in kept.tolist()))
        object.__setattr__(self, "pairs", _pairs(long_m[kept], 2.0 * self.radius_m))

    def chain(self, q: Array) -> Array:
        """Return the points (m, 2 n + 1, 3) of the chain at readings (m, n), in base axes."""
        values = self.arm.values(q)
        T = [np.tile(self.prefixes[0].T_base_frame0.as_matrix(), (len(q), 1, 1))]
        T += [fk(prefix, values[:, : i + 1]) for i, prefix in enumerate(self.prefixes)]
        out = [T[0][:, :3, 3]]
        for before, after in pairwise(T):
            # along the joint's axis z first, then across it to the next one's
            axis, way = before[:, :3, 2], after[:, :3, 3] - before[:, :3, 3]
            out += [before[:, :3, 3] + (way * axis).sum(axis=1, keepdims=True) * axis, after[:, :3, 3]]
        return np.stack(out, axis=1)

    def __call__(self, q: Array) -> Mask:
        """Return at which readings (m, n) all links are clear."""
        parts = [self._clear(q[first : first + MANY]) for first in range(0, len(q), MANY)]
        return np.concatenate([np.ones(0, bool), *parts])

    def _clear(self, q: Array) -> Mask:
        walled, near = self._struck(q)
        return np.asarray(~walled.any(axis=(1, 2)) & ~near.any(axis=1))

    def struck(self, q: Array) -> str:
        """Return which link at a reading (n,) is too near to what, empty where none is."""
        walled, near = self._struck(q[None])
        said = [f"the link from {self.names[k]} at {self.walls[w].name}" for w, k in np.argwhere(walled[0]).tolist()]
        for pair in np.flatnonzero(near[0]).tolist():
            a, b = self.pairs[pair].tolist()
            said.append(f"the link from {self.names[a]} at that from {self.names[b]}")
        return "; ".join(dict.fromkeys(said))

    def _struck(self, q: Array) -> tuple[Mask, Mask]:
        """Return which links (m, walls, k) are too near to walls, and which pairs (m, p) to each other."""
        chain = self.chain(q)
        a, b = chain[:, self.parts[:, 0]], chain[:, self.parts[:, 1]]
        walled = np.zeros((len(q), len(self.walls), len(self.parts)), bool)
        standing = int(self.parts[0, 0] == 0) if len(self.parts) else 0
        for w, wall in enumerate(self.walls):
            for k in range(standing, len(self.parts)):
                walled[:, w, k] = self._at(wall, a[:, k], b[:, k])
        i, j = self.pairs[:, 0], self.pairs[:, 1]
        return walled, apart(a[:, i], b[:, i], a[:, j], b[:, j]) < 2.0 * self.radius_m

    def _at(self, wall: Wall, a: Array, b: Array) -> Mask:
        """Return where the straight part from a to b (m, 3) is nearer to a wall than its thickness."""
        keep = self.radius_m + self.keep_m
        if wall.room:
            low = np.where(wall.lower <= 0.0, wall.lower + keep, -np.inf)
            high = np.where(wall.upper >= 0.0, wall.upper - keep, np.inf)
            return np.asarray((np.minimum(a, b) < low).any(axis=1) | (np.maximum(a, b) > high).any(axis=1))
        out = np.zeros(len(a), bool)
        # only what comes into the box about the box is looked at closely
        reach = (np.minimum(a, b) < wall.upper + keep) & (np.maximum(a, b) > wall.lower - keep)
        near = np.flatnonzero(reach.all(axis=1))
        out[near] = _from_box(a[near], b[near], wall.lower, wall.upper) < keep
        return out


def _pairs(long_m: Array, thick_m: float) -> NDArray[np.intp]:
    """Return the pairs (p, 2) of parts that may meet: with more of the chain between them than they are thick."""
    at = np.concatenate([[0.0], np.cumsum(long_m)])
    n = len(long_m)
    found = [(i, j) for i in range(n) for j in range(i + 2, n) if at[j] - at[i + 1] > NEAR * thick_m]
    return np.array(found, dtype=np.intp).reshape(-1, 2)


def _from_box(a: Array, b: Array, lower: Array, upper: Array) -> Array:
    """Return the distance (m,) of straight parts from a to b (m, 3) to a box.

    The distance to a convex body is convex along a line: halving by its slope finds the least.
    """
    low, high = np.zeros(len(a)), np.ones(len(a))
    for _ in range(20):
        s = 0.5 * (low + high)
        p = a + s[:, None] * (b - a)
        off = p - np.clip(p, lower, upper)
        rises = ((off * (b - a)).sum(axis=1)) > 0.0
        low, high = np.where(rises, low, s), np.where(rises, s, high)
    p = a + (0.5 * (low + high))[:, None] * (b - a)
    return np.asarray(np.linalg.norm(p - np.clip(p, lower, upper), axis=1))


def apart(a: Array, b: Array, c: Array, d: Array) -> Array:
    """Return the distance (...) of the straight parts from a to b and from c to d (..., 3) (Ericson 2005, 5.1.9)."""
    u, v, w = b - a, d - c, a - c
    uu, vv, uv = (u * u).sum(-1), (v * v).sum(-1), (u * v).sum(-1)
    uw, vw = (u * w).sum(-1), (v * w).sum(-1)
    # where both are in step any place of the first does: its beginning
    across = uu * vv - uv * uv
    with np.errstate(divide="ignore", invalid="ignore"):
        s = np.where(across > 1e-12 * uu * vv, np.clip((uv * vw - uw * vv) / across, 0.0, 1.0), 0.0)
        t = np.clip(np.where(vv > 0.0, (uv * s + vw) / vv, 0.0), 0.0, 1.0)
        s = np.clip(np.where(uu > 0.0, (uv * t - uw) / uu, 0.0), 0.0, 1.0)
    return np.asarray(np.linalg.norm(w + s[..., None] * u - t[..., None] * v, axis=-1))
