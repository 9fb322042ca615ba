"""Which cameras saw the board at one moment, how they stand by that, and the boards of all moments in one frame.

An edge joins two cameras with moments in common; its pose is what most of them agree on. A spanning tree of the best
edges places every camera; the other edges must close on it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array, Index
from armsight.calibrate.cameras.bundle_adjustment import Bundle
from armsight.calibrate.cameras.observations import Observations
from armsight.calibrate.cameras.outlier_rejection import named
from armsight.calibrate.cameras.pairing import (
    AGREEING,
    LARGEST_SHIFT,
    SAME_ANGLE_RAD,
    SAME_SHARE,
    Paired,
    as_pose,
    consensus,
    mirrored,
    spins_of,
)
from armsight.errors import Inconsistent, NotEnoughData

LEAST_SHARED = 4
"""With fewer common moments cameras that do not agree are no news: boards far off may seem to tilt either way."""
MOVING = 2.5
"""So many times further apart may views of one moment be where the board moved between them, and times tell how."""
CLOSES = 2.0
"""An edge closes within so many times what moments that agree may differ by."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Edge:
    """Cameras a < b, what their common moments agree on, and the largest angle between two boards in them, rad."""

    a: int
    b: int
    paired: Paired
    spread_rad: float

    @property
    def weight(self) -> float:
        """How well it places one camera by the other: moments that agree, and then their angle."""
        return float(self.paired.agreeing.sum()) + self.spread_rad / np.pi

    @property
    def doubted(self) -> bool:
        """Whether its moments do not agree on one pose of the cameras."""
        return len(self.paired.agreeing) >= LEAST_SHARED and self.paired.agreeing.mean() < AGREEING


def placed(
    observations: Observations, poses: Array, k: Array, turns: Sequence[Index]
) -> tuple[Observations, Bundle, list[tuple[str, str]]]:
    """Return observations without the views that do not agree, the bundle's start, and (source, why) of those views.

    poses (G, C, 2, 6): T_camera_board by the two tilts that a view may show, the likelier one first; NaN where nothing
    is seen. k (C, 10). turns: the print's symmetries, by which views are renumbered. Raises NotEnoughData where cameras
    are not connected, Inconsistent where they do not agree.
    """
    spins = spins_of(observations.X, turns)
    slack = 1.0 if observations.t_s is None else MOVING
    edges = edges_of(poses[:, :, 0], spins, slack)
    _require_connected(observations, poses, edges)
    tree, found = tree_from(edges, 0)
    T = [found[c] for c in range(observations.n_cameras)]
    _require_closed(observations, poses, spins, edges, tree, T, slack)
    kept, turn, boards = boards_of(poses, spins, T, slack)
    uv, weight = observations.uv.copy(), observations.weight * kept[:, :, None]
    for g, c in zip(*np.nonzero(turn), strict=True):
        uv[g, c], weight[g, c] = uv[g, c, turns[turn[g, c]]], weight[g, c, turns[turn[g, c]]]
    seen = np.isfinite(poses[:, :, 0, 0])
    why = "does not show the board where the other cameras see it: not of the same moment, or the board moved"
    rejected = [
        (observations.sources[g][c] if kept[g].any() else named(observations, g), why)
        for g, c in zip(*np.nonzero(seen & ~kept), strict=True)
        if kept[g].any() or c == np.flatnonzero(seen[g])[0]
    ]
    stay = np.flatnonzero(kept.any(axis=1))  # others show boards on which no two cameras agree
    sides = [np.concatenate([one.translation, one.rotation.as_rotvec()]) for one in T[1:]]
    start = Bundle(k=k, sides=np.array(sides).reshape(-1, 6), poses=boards[stay])
    return replace(observations, uv=uv, weight=weight).take(stay), start, rejected


def edges_of(poses: Array, spins: Array, slack: float) -> list[Edge]:
    """Return the edges of all cameras that have seen the board at one moment; poses (G, C, 6)."""
    seen = np.isfinite(poses[:, :, 0])
    out = []
    for a in range(seen.shape[1]):
        for b in range(a + 1, seen.shape[1]):
            g = np.flatnonzero(seen[:, a] & seen[:, b])
            if not len(g):
                continue
            # boards of one direction place two cameras by one plane alone
            normals = Rotation.from_rotvec(poses[g, a, 3:]).as_matrix()[:, :, 2]
            spread = float(np.arccos(np.clip(normals @ normals.T, -1.0, 1.0)).max())
            out.append(Edge(a=a, b=b, paired=consensus(poses[g, a], poses[g, b], spins, slack), spread_rad=spread))
    return out


def _require_connected(observations: Observations, poses: Array, edges: list[Edge]) -> None:
    """Raise NotEnoughData with the groups of cameras that no moment joins, and the picture that would."""
    group = list(range(observations.n_cameras))
    for edge in edges:
        joined, other = group[edge.a], group[edge.b]
        group = [joined if one == other else one for one in group]
    names, groups = observations.cameras, sorted(set(group))
    if len(groups) == 1:
        return
    count = np.isfinite(poses[:, :, 0, 0]).sum(axis=0)
    best = [max((c for c, one in enumerate(group) if one == each), key=lambda c: int(count[c])) for each in groups]
    told = "; ".join(", ".join(names[c] for c, one in enumerate(group) if one == each) for each in groups)
    join = ", and ".join(f"{names[best[0]]} and {names[c]}" for c in best[1:])
    raise NotEnoughData(
        f"the cameras are not connected: no moment shows the board to cameras of two of these groups: {told}",
        consequence="How the groups stand to each other is open, and nothing was calibrated",
        cure=f"Take pictures in which the board is seen at one moment by {join}; or set a further camera between them",
    )


def tree_from(edges: list[Edge], root: int) -> tuple[list[Edge], dict[int, RigidTransform]]:
    """Return the edges of the best spanning tree of a camera's group (Prim 1957), and T_root_camera by it."""
    T: dict[int, RigidTransform] = {root: RigidTransform.identity()}
    tree = []
    while further := [one for one in edges if (one.a in T) != (one.b in T)]:
        edge = max(further, key=lambda one: one.weight)
        tree.append(edge)
        step = as_pose(edge.paired.side_pose)
        if edge.a in T:
            T[edge.b] = T[edge.a] * step
        else:
            T[edge.a] = T[edge.b] * step.inv()
    return tree, T


def _require_closed(
    observations: Observations,
    poses: Array,
    spins: Array,
    edges: list[Edge],
    tree: list[Edge],
    T: list[RigidTransform],
    slack: float,
) -> None:
    """Raise Inconsistent, naming the camera, where moments of an edge do not agree or it does not close on the tree."""
    bad = [one for one in edges if one.doubted]
    for edge in edges:
        if edge in tree or edge in bad or len(edge.paired.agreeing) < LEAST_SHARED:
            continue
        off = (T[edge.a].inv() * T[edge.b]).inv() * as_pose(edge.paired.side_pose)
        reach = float(np.nanmean(np.linalg.norm(poses[:, [edge.a, edge.b], 0, :3], axis=2)))
        if (
            max(off.rotation.magnitude() / SAME_ANGLE_RAD, np.linalg.norm(off.translation) / reach / SAME_SHARE)
            > CLOSES * slack
        ):
            bad.append(edge)
    if not bad:
        return

    def doubt(c: int) -> tuple[float, int]:
        own = [one in bad for one in edges if c in (one.a, one.b)]
        return float(np.mean(own)), sum(own)

    worst = max(reversed(range(observations.n_cameras)), key=doubt)
    # its best known neighbour is what it is compared with
    edge = max((one for one in edges if worst in (one.a, one.b)), key=lambda one: len(one.paired.agreeing))
    partner = edge.a if edge.b == worst else edge.b
    _say_why(observations, poses, spins, worst, partner)


def _say_why(observations: Observations, poses: Array, spins: Array, worst: int, partner: int) -> None:
    """Raise Inconsistent with the likeliest reason why a camera does not agree with another."""
    name, other = observations.cameras[worst], observations.cameras[partner]
    seen, n = np.isfinite(poses[:, :, 0, 0]), len(poses)
    for shift in (s for k in range(1, LARGEST_SHIFT + 1) for s in (k, -k)):
        g = np.arange(max(0, -shift), n - max(0, shift))
        g = g[seen[g, partner] & seen[g + shift, worst]]
        if len(g) < LEAST_SHARED:
            continue
        if consensus(poses[g, partner, 0], poses[g + shift, worst, 0], spins).agreeing.mean() >= AGREEING:
            raise Inconsistent(
                f"the images of {name} are out of step: each image of {other} fits the one of {name} "
                f"{abs(shift)} {'later' if shift > 0 else 'earlier'}",
                consequence="Nothing was calibrated",
                cure=f"Remove the images that have no partner, so that the list of {name} begins with the same moment",
            )
    g = np.flatnonzero(seen[:, partner] & seen[:, worst])
    pair = observations.take(g)
    pair = replace(
        pair,
        uv=pair.uv[:, [partner, worst]],
        weight=pair.weight[:, [partner, worst]],
        sizes=(observations.sizes[partner], observations.sizes[worst]),
        lenses=(observations.lenses[partner], observations.lenses[worst]),
    )
    if observations.n_front is None and mirrored(pair, [poses[g, partner, 0], poses[g, worst, 0]], spins) is not None:
        raise Inconsistent(
            f"the images of {name} are mirrored",
            consequence="Nothing was calibrated",
            cure="Switch off that camera's mirror mode",
        )
    raise Inconsistent(
        f"the images of {name} do not belong to those of {other}: their moments give no common pose of the cameras",
        consequence="Nothing was calibrated",
        cure=f"Check that the list of {name} is in the same order and of the same moments, that it did not move, and "
        "that it is not another camera's",
    )


def boards_of(
    poses: Array, spins: Array, T: Sequence[RigidTransform], slack: float = 1.0
) -> tuple[NDArray[np.bool_], NDArray[np.intp], Array]:
    """Return which views agree (G, C), the symmetry of each, and T_first_board (G, 6) by the cameras' poses.

    Of all that the views of a moment say the pose is taken that most of them, and then these most closely, agree with.
    """
    G, C, tilts = poses.shape[:3]
    kept, turn, out = np.zeros((G, C), bool), np.zeros((G, C), np.intp), np.zeros((G, 6))
    R_camera = np.array([one.rotation.as_matrix() for one in T])
    t_camera = np.array([one.translation for one in T])
    S = len(spins)
    for g in range(G):
        seen = np.flatnonzero(np.isfinite(poses[g, :, 0, 0]))
        own = Rotation.from_rotvec(poses[g, seen, :, 3:].reshape(-1, 3)).as_matrix().reshape(-1, tilts, 1, 3, 3)
        R = (R_camera[seen][:, None, None] @ own @ spins).reshape(len(seen), tilts * S, 3, 3)
        t = np.einsum("cij,chj->chi", R_camera[seen], poses[g, seen, :, :3]) + t_camera[seen][:, None]
        t = np.repeat(t, S, axis=1)  # (c, h, 3)
        trace = np.einsum("chij,dkij->chdk", R, R)
        angle = np.arccos(np.clip(0.5 * (trace - 1.0), -1.0, 1.0))
        reach = np.linalg.norm(poses[g, seen, 0, :3], axis=1).mean()
        apart = np.linalg.norm(t[:, :, None, None] - t[None, None], axis=4) / reach
        score = np.maximum(angle / SAME_ANGLE_RAD, apart / SAME_SHARE) / slack
        # of equal doubt the likelier tilt, the first, wins
        best, which = score.min(axis=3), score.argmin(axis=3)
        # views that disagree count alike however far off they are
        total = np.minimum(best, 1.0).sum(axis=2) + 1e-3 * (np.arange(tilts * S) // S)
        total[:, np.arange(tilts * S) % S > 0] = np.inf
        c, h = np.unravel_index(int(np.argmin(total)), total.shape)
        agree = best[c, h] < 1.0
        out[g] = np.concatenate([t[c, h], Rotation.from_matrix(R[c, h]).as_rotvec()])
        if len(seen) == 1 or agree.sum() > 1:
            kept[g, seen], turn[g, seen] = agree, np.where(agree, which[c, h] % S, 0)
    return kept, turn, out


def tilts_of(poses: Array, across: Array) -> Array:
    """Return T_camera_board (G, 6) with the other tilt, which looks almost alike from afar (Schweighofer 2006).

    across (3,): the board's, in its own axes.
    """
    R = Rotation.from_rotvec(poses[:, 3:])
    sight = poses[:, :3] / np.linalg.norm(poses[:, :3], axis=1)[:, None]
    normal = R.as_matrix() @ across
    normal = normal * np.sign(np.einsum("gi,gi->g", normal, sight))[:, None]
    # the normal goes to its mirror image in the line of sight
    axis = np.cross(normal, sight)
    size = np.linalg.norm(axis, axis=1)
    angle = 2.0 * np.arctan2(size, np.einsum("gi,gi->g", normal, sight))
    turn = Rotation.from_rotvec(axis / np.maximum(size, 1e-12)[:, None] * angle[:, None])
    return np.column_stack([poses[:, :3], (turn * R).as_rotvec()])
