"""Where an arm may go before two cameras that see its lights: places of the joints, and the ways between them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array, Mask
from armsight.calibrate.cell.model import CellModel
from armsight.errors import NotEnoughData
from armsight.kinematics import Arm, family_of, ik_many
from armsight.units import DEG
from armsight_lab.cell_plan.path import MotionBounds

Free = Callable[[Array], Mask]
"""Readings (m, n) -> at which of them the arm touches nothing and is where it may be."""

PLACES, ENOUGH, ROUNDS = 450, 1500, 6
"""Places that are kept, found before that is enough, and rounds in which they are looked for."""
DRAWN = 3000
"""Places drawn in a round, of each sort."""
STRAY = 0.12
"""Of a joint's range: how far from a good place others are looked for, standard deviation."""
WIDER = 1.5
"""Places are looked for in a space so many times as wide as the volume: its edges are told from both sides."""
NEIGHBOURS = 14
LOOK_RAD, LOOK_M = 0.06, 0.02
"""How far a joint goes between two looks along a way."""
LEAST_SEEN = 0.5
"""Share of a way between two places on which the lights are seen; with less the way is not gone."""
UNSEEN = 4.0
"""How many times longer a way counts of which nothing is seen."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scene:
    """An arm, lights on its flange and two cameras as they are thought to be: the parameters x of a model.

    volume (3, 2): of the tip, tip_m (3,) in flange axes, in base axes, where it is to be known. normal (3,) of the
    lights in flange axes; facing_rad: how far it may be turned from the way to a camera. margin_px: (2,) from the edges
    of the images.
    """

    model: CellModel
    x: Array
    bounds: MotionBounds
    free: Free
    tip_m: Array
    volume: Array
    normal: Array
    facing_rad: float
    margin_px: tuple[float, float]

    @property
    def arm(self) -> Arm:
        """The arm as it is thought to be, in base axes."""
        return self.model.recording.arm

    def tips(self, q: Array) -> Array:
        """Return the tip (m, 3) in base axes."""
        T = self.model.flange(self.x, q)
        return np.asarray(T[:, :3, :3] @ self.tip_m + T[:, :3, 3])

    def inside(self, q: Array) -> Mask:
        """Return at which readings (m, n) the tip is in the volume."""
        tips = self.tips(q)
        return np.asarray(((tips >= self.volume[:, 0]) & (tips <= self.volume[:, 1])).all(axis=1))

    def allowed(self, q: Array) -> Mask:
        """Return at which readings (m, n) the arm may be."""
        out = self.bounds.within(q)
        out[out] = self.free(q[out])
        return out

    def seen(self, q: Array) -> Mask:
        """Return at which readings (m, n) both cameras see all lights."""
        T = self.model.flange(self.x, q)
        lights = self.model.lights_m(self.x)
        points = np.einsum("mij,lj->mli", T[:, :3, :3], lights) + T[:, None, :3, 3]
        axis = T[:, :3, :3] @ self.normal
        out = np.ones(len(q), bool)
        for side, (size, margin) in enumerate(zip(self.model.recording.sizes, self.margin_px, strict=True)):
            at = self.model.T_base_camera(self.x, side)
            way = np.asarray(at.translation) - points.mean(axis=1)
            out &= np.einsum("mi,mi->m", way, axis) > np.cos(self.facing_rad) * np.linalg.norm(way, axis=1)
            flat = np.asarray(at.inv().apply(points[out].reshape(-1, 3)))
            uv = self.model.camera(self.x, side).project(flat).reshape(-1, len(lights), 2)
            with np.errstate(invalid="ignore"):
                inside = (uv >= margin) & (uv <= np.array(size) - 1.0 - margin)
            out[out] = inside.all(axis=(1, 2))
        return out


def places(scene: Scene, rng: np.random.Generator, start: Array) -> Array:
    """Return readings (k, n) at which the arm may be and both cameras see its lights; start comes first.

    Raises NotEnoughData where there are none, with what keeps the arm from them.
    """
    found = np.empty((0, scene.arm.n))
    counts = np.zeros(3, dtype=int)  # drawn, allowed, seen
    for _ in range(ROUNDS):
        drawn = [_anywhere(scene, rng), _facing(scene, rng, start)]
        if len(found):
            width = STRAY * (scene.bounds.upper - scene.bounds.lower)
            drawn.append(found[rng.choice(len(found), DRAWN)] + rng.normal(size=(DRAWN, scene.arm.n)) * width)
        q = np.concatenate(drawn)
        allowed = q[scene.allowed(q)]
        seen = allowed[scene.seen(allowed)]
        counts += (len(q), len(allowed), len(seen))
        found = np.concatenate([found, seen])
        if len(found) >= ENOUGH and scene.inside(found).sum() >= PLACES // 4:
            break
    if not len(found):
        raise _none(counts)
    order = rng.permutation(len(found))
    # those in the volume first: of them it is to be known most
    order = order[np.argsort(~scene.inside(found[order]), kind="stable")]
    half = order[: PLACES // 2]
    rest = rng.permutation(order[PLACES // 2 :])[: PLACES - len(half)]
    kept = found[np.concatenate([half, rest])]
    return np.concatenate([start[None], kept])


def _anywhere(scene: Scene, rng: np.random.Generator) -> Array:
    return np.asarray(rng.uniform(scene.bounds.lower, scene.bounds.upper, (DRAWN, scene.arm.n)))


def _facing(scene: Scene, rng: np.random.Generator, start: Array) -> Array:
    """Return readings that bring the tip near the volume and turn the lights towards the cameras; none without a
    closed form."""
    arm, family = scene.arm, family_of(scene.arm)
    if family is None or not family.exact:
        return np.empty((0, arm.n))
    m = DRAWN // 8
    middle, half = scene.volume.mean(axis=1), 0.5 * np.ptp(scene.volume, axis=1)
    half = np.where(rng.random((m, 1)) < 0.5, 1.0, WIDER) * half
    tips = middle + rng.uniform(-1.0, 1.0, (m, 3)) * half
    eyes = np.mean([scene.model.T_base_camera(scene.x, side).translation for side in (0, 1)], axis=0)
    lean = scene.facing_rad if scene.facing_rad < 90.0 * DEG else 90.0 * DEG
    away = Rotation.from_rotvec(rng.normal(size=(m, 3)) * 0.5 * lean)
    axis = away.apply((eyes - tips) / np.linalg.norm(eyes - tips, axis=1, keepdims=True))
    # turned about the way to the cameras, they still face them
    roll = Rotation.from_rotvec(axis * rng.uniform(-np.pi, np.pi, (m, 1)))
    towards = Rotation.concatenate([_turned_to(scene.normal, way) for way in axis])
    R = roll * towards
    flange = RigidTransform.from_components(tips - R.apply(scene.tip_m), R)
    q, _, _ = ik_many(arm, arm.T_world_base * flange * arm.T_flange_tool)
    q = q.reshape(-1, arm.n)
    q = q[np.isfinite(q).all(axis=1)]
    near = start
    return arm.readings(q) + np.where(
        arm.revolute, 2.0 * np.pi * np.rint((near - arm.readings(q)) / (2.0 * np.pi)), 0.0
    )


def _turned_to(a: Array, b: Array) -> Rotation:
    """Return a rotation that takes the direction a to b."""
    return Rotation.align_vectors(b[None], a[None])[0]


def _none(counts: NDArray[np.int_]) -> NotEnoughData:
    drawn, allowed, _ = counts.tolist()
    if not allowed:
        return NotEnoughData(
            f"of {drawn} positions of the joints the arm may be at none",
            consequence="No motion is planned",
            cure="Look at the joints' limits, the workspace and the forbidden boxes (--limits)",
        )
    return NotEnoughData(
        f"at none of {allowed} positions where the arm may be do both cameras see all lights",
        consequence="No motion is planned",
        cure="Check where the rig stands (--world) and how the target sits on the flange (--mount); turn the cameras "
        "to the arm, allow more (--facing-deg), or say how well the rig's place is known (--rough-mm, --rough-deg)",
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Roadmap:
    """Places q (k, n) that can be gone to from the first one; how long the ways take (k, k), and by which neighbour."""

    q: Array
    long_s: Array
    by: NDArray[np.int32]

    def between(self, a: int, b: int) -> list[int]:
        """Return the places from a to b, without a."""
        out = [b]
        while self.by[a, out[-1]] != a:
            out.append(int(self.by[a, out[-1]]))
        return out[::-1]


def roadmap(scene: Scene, q: Array) -> Roadmap:
    """Return which places q (k, n) can be gone to from the first, on ways that are free and mostly seen.

    Raises NotEnoughData where none can.
    """
    k = len(q)
    far = scene.bounds.apart_s(q[:, None], q[None])
    near = np.argsort(far, axis=1)[:, 1 : NEIGHBOURS + 1]
    a, b = np.repeat(np.arange(k), near.shape[1]), near.ravel()
    pairs = np.unique(np.sort(np.column_stack([a, b]), axis=1), axis=0)
    weight = _ways(scene, q[pairs[:, 0]], q[pairs[:, 1]], far[pairs[:, 0], pairs[:, 1]], pairs[:, 0] == 0)
    fine = np.isfinite(weight)
    graph = csr_matrix((weight[fine], (pairs[fine, 0], pairs[fine, 1])), shape=(k, k))
    label = connected_components(graph, directed=False)[1]
    reached = np.flatnonzero(label == label[0])
    if len(reached) < 2:
        raise NotEnoughData(
            f"from where the arm stands no way leads to any of {k - 1} positions in view",
            consequence="No motion is planned",
            cure="Bring the arm to where both cameras see its lights, and begin there (--start); or look at the "
            "forbidden boxes",
        )
    part = graph[reached][:, reached]
    long_s, by = dijkstra(part, directed=False, return_predecessors=True)
    return Roadmap(q=q[reached], long_s=long_s, by=by)


def _ways(scene: Scene, a: Array, b: Array, far: Array, first: Mask) -> Array:
    """Return what each straight way from a to b (m, n) counts, infinite where it is not free or hardly seen."""
    look = np.where(scene.arm.revolute, LOOK_RAD, LOOK_M)
    steps = np.maximum(np.ceil((np.abs(b - a) / look).max(axis=1)).astype(np.intp), 2)
    way = np.repeat(np.arange(len(a)), steps + 1)
    at = np.concatenate([np.arange(n + 1) / n for n in steps.tolist()])
    q = a[way] + at[:, None] * (b - a)[way]
    # all ways at once: rows of all are looked at together, and counted by way
    blocked = np.bincount(way, weights=~scene.allowed(q), minlength=len(a)) > 0
    seen = np.bincount(way, weights=scene.seen(q), minlength=len(a)) / (steps + 1)
    moved = np.linalg.norm(np.diff(scene.tips(q), axis=0), axis=1) * (np.diff(way) == 0)
    tool = np.bincount(way[1:], weights=moved, minlength=len(a)) / scene.bounds.speed_m_s
    out = np.hypot(far, tool) * (1.0 + UNSEEN * (1.0 - seen)) + 1e-6
    out[blocked | ((seen < LEAST_SEEN) & ~first)] = np.inf
    return np.asarray(out)
