"""A cloud of markers that keep their distances, as a body: its shape, and its pose in every frame.

The shape is the median of the markers laid on it, frame by frame (Kabsch 1976; Umeyama 1991 for the sign), which a
marker that is exchanged or slips in some frames does not move.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from armsight.arrays import Array, Index, Mask
from armsight.errors import Ambiguous, Degenerate, Inconsistent, NotEnoughData

RIGID_M, LEAST_ODD_M, ODD = 3e-3, 1e-4, 8.0
"""A marker farther off its shape's point is not that marker, and its frame is lost. Eight markers on a box, filmed by a
motion capture laboratory, are 0.26 mm (RMS) off; those on a person, taken as one body, 170 mm. Within that, so many
times what the worst marker of the better frames is off, which an exchange of neighbours exceeds sooner."""
MOST_LOST = 0.2
"""Where a larger share of the frames does not fit one shape, it is none."""
NARROWEST = 0.05
"""Markers whose spread across is a smaller share of that along lie on a line: the rotation about it is not known."""
SHAPE_FRAMES = 2000
"""The shape is of so many frames at most, evenly taken."""
ROUNDS, SETTLED_M = 50, 1e-12


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Cloud:
    """names (k,) of markers, and where they are: xyz_m (n, k, 3), NaN where one is lost."""

    names: tuple[str, ...]
    xyz_m: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CloudBody:
    """xyz_m (n, 3), quat_xyzw (n, 4) of T_tracker_body, NaN where it is lost; notes, in words."""

    xyz_m: Array
    quat_xyzw: Array
    notes: tuple[str, ...]


def body_of_cloud(cloud: Cloud, where: str) -> CloudBody:
    """Return markers as a body: origin in their middle, x from the first to the second, z across the first three.

    Of markers on a line the next is taken. Raises NotEnoughData below three, Degenerate on a line, Inconsistent where
    they do not keep their distances, Ambiguous where markers may be exchanged and their distances do not show it.
    """
    if len(cloud.names) < 3:
        raise NotEnoughData(
            f"{where}: {', '.join(cloud.names)} are two markers",
            consequence="Their rotation is not observable",
            cure="Name one marker for its position alone, or three and more of a body",
        )
    seen = np.asarray(np.isfinite(cloud.xyz_m).all(axis=2))  # (n, k)
    shape = _shape(cloud, seen, where)
    R, t, good = _laid(shape, seen, cloud.xyz_m)
    off = np.where(seen, np.linalg.norm(cloud.xyz_m - (np.einsum("nij,kj->nki", R, shape) + t[:, None]), axis=2), 0.0)
    worst = off.max(axis=1)
    limit = float(np.clip(ODD * np.quantile(worst[good], 1.0 - MOST_LOST), LEAST_ODD_M, RIGID_M))
    odd = good & (worst > limit)
    if odd.sum() > MOST_LOST * good.sum():
        raise _not_rigid(cloud, seen, where, float(np.median(worst[good])))
    good &= ~odd
    few = good & _exchangeable(shape, seen, cloud.names, limit, where)
    good &= ~few
    rms = float(np.sqrt(np.mean(off[good[:, None] & seen] ** 2)))
    axes = _axes(shape, cloud.names, where)  # (3, 3), columns
    middle = shape.mean(axis=0)
    xyz = np.full((len(t), 3), np.nan)
    quat = np.full((len(t), 4), np.nan)
    xyz[good] = R[good] @ middle + t[good]
    quat[good] = Rotation.from_matrix(R[good] @ axes).as_quat()
    notes = [
        f"{len(cloud.names)} markers as one body, rms {1e3 * rms:.2g} mm: {', '.join(cloud.names)[:200]}; origin in "
        f"their middle, x from the first to the second"
    ]
    if odd.any():
        mostly = cloud.names[int(np.argmax((off[odd] > limit).sum(axis=0)))]
        notes.append(
            f"{odd.sum()} frames in which a marker is more than {1e3 * limit:.2g} mm off the body's shape: "
            f"taken as lost; mostly it is {mostly}"
        )
    if few.any():
        notes.append(f"{few.sum()} frames whose markers would look the same if they were exchanged: taken as lost")
    return CloudBody(xyz_m=xyz, quat_xyzw=quat, notes=tuple(notes))


def _shape(cloud: Cloud, seen: Mask, where: str) -> Array:
    """Return the markers' places (k, 3) in axes of the body, from the frame that shows most of them."""
    frames = _evenly(np.flatnonzero(seen.sum(axis=1) >= 3))
    if not len(frames):
        raise NotEnoughData(
            f"{where}: three of {', '.join(cloud.names)[:200]} are never seen together",
            consequence="There is no body",
            cure="Name markers that are seen together with --body",
        )
    xyz, mask = cloud.xyz_m[frames], seen[frames]
    shape = xyz[np.argmax(mask.sum(axis=1))].copy()
    for _ in range(ROUNDS):
        R, t, good = _laid(shape, mask, xyz)
        if not good.any():
            raise _line(cloud.names, where)
        back = np.einsum("nji,nkj->nki", R, xyz - t[:, None])  # R^T (x - t)
        back[~(good[:, None] & mask)] = np.nan
        there = np.isfinite(back).any(axis=(0, 2))
        before, shape = shape, shape.copy()
        shape[there] = np.nanmedian(back[:, there], axis=0)
        if np.isfinite(before).all() and np.abs(shape - before).max() < SETTLED_M:
            break
    if not np.isfinite(shape).all():
        apart = [name for name, place in zip(cloud.names, shape, strict=True) if not np.isfinite(place).all()]
        raise NotEnoughData(
            f"{where}: {', '.join(apart)[:200]} are never seen with three others of the body",
            consequence="Where they sit on it is not observable",
            cure="Leave them out of --body",
        )
    return np.asarray(shape)


def _exchangeable(shape: Array, seen: Mask, names: Sequence[str], limit: float, where: str) -> Mask:
    """Return in which frames (n,) the markers seen can be exchanged, so that the body is rotated and nothing shows it.

    Raises Ambiguous where that holds of all markers together.
    """
    order = _alike(shape, limit)
    if order is not None:
        raise Ambiguous(
            f"{where}: the markers {', '.join(names)[:200]} have the same distances, to {1e3 * limit:.2g} mm, when "
            f"{', '.join(names[k] for k in order)[:200]} are in their places",
            consequence="Where the tracker exchanges them the body is rotated, and nothing shows it",
            cure="Name with --body those of its markers that no rotation lays on each other, or one marker for its "
            "position alone; fix a further marker off the symmetry for the next recording",
        )
    masks, which = np.unique(seen, axis=0, return_inverse=True)
    return np.array([_alike(shape[mask], limit) is not None for mask in masks])[which.ravel()]


def _alike(shape: Array, limit: float) -> tuple[int, ...] | None:
    """Return an order of markers that a rotation lays on the shape (k, 3) as well as their own, None without one."""
    apart: list[int] = []  # of markers that stand for each other within the limit one is enough
    for k, place in enumerate(shape):
        if np.linalg.norm(shape[apart] - place, axis=1).min(initial=np.inf) > 2.0 * limit:
            apart.append(k)
    places, n = shape[apart], len(apart)
    if n < 3:
        return tuple(range(len(shape)))[::-1]
    d = np.linalg.norm(places[:, None] - places, axis=2)
    own = np.sort(d, axis=1)
    may = np.abs(own[:, None] - own).max(axis=2, initial=0.0) <= 2.0 * limit  # (n, n): who can stand for whom
    orders: list[tuple[int, ...]] = [()]
    while orders and not np.array_equal(may, np.eye(n)):
        order = orders.pop()
        k = len(order)
        if k < n:
            fits = [j for j in np.flatnonzero(may[k]).tolist() if j not in order]
            orders += [(*order, j) for j in fits if (np.abs(d[k, :k] - d[j, list(order)]) <= 2.0 * limit).all()]
            continue
        R, t, good = _laid(places, np.ones((1, n), bool), places[list(order)][None])
        there = places @ R[0].T + t[0]
        off, moved = (np.linalg.norm(there - other, axis=1).max() for other in (places[list(order)], places))
        if good[0] and off <= limit < moved:
            exchanged = np.arange(len(shape))
            exchanged[apart] = np.array(apart)[list(order)]
            return tuple(exchanged.tolist())
    return None


def _evenly(index: Index) -> Index:
    return index if len(index) <= SHAPE_FRAMES else index[np.linspace(0, len(index) - 1, SHAPE_FRAMES).astype(np.intp)]


def _laid(shape: Array, seen: Mask, xyz: Array) -> tuple[Array, Array, Mask]:
    """Return rotations (n, 3, 3) and translations (n, 3) that lay a shape on what is seen, and where that is enough."""
    w = (seen & np.isfinite(shape).all(axis=1)).astype(float)  # (n, k)
    count = np.maximum(w.sum(axis=1), 1.0)[:, None]
    places, points = np.nan_to_num(shape), np.where(w[..., None] > 0.0, xyz, 0.0)
    middle, centre = w @ places / count, points.sum(axis=1) / count
    a = w[..., None] * (places - middle[:, None])  # (n, k, 3)
    b = w[..., None] * (points - centre[:, None])
    U, _, Vt = np.linalg.svd(np.einsum("nki,nkj->nij", b, a))
    sign = np.linalg.det(U @ Vt)
    U[:, :, 2] *= sign[:, None]
    R = U @ Vt
    along, across = np.sqrt(np.maximum(np.linalg.eigvalsh(np.einsum("nki,nkj->nij", a, a))[:, :0:-1], 0.0)).T
    good = (w.sum(axis=1) >= 3.0) & (across > NARROWEST * along)
    return R, centre - np.einsum("nij,nj->ni", R, middle), good


def _axes(shape: Array, names: Sequence[str], where: str) -> Array:
    x = shape[1] - shape[0]
    length = float(np.linalg.norm(x))
    for third in shape[2:]:
        z = np.cross(x, third - shape[0])
        if np.linalg.norm(z) > NARROWEST * length * max(float(np.linalg.norm(third - shape[0])), length):
            x, z = x / length, z / np.linalg.norm(z)
            return np.stack([x, np.cross(z, x), z], axis=1)
    raise _line(names, where)


def _line(names: Sequence[str], where: str) -> Degenerate:
    return Degenerate(
        f"{where}: the markers {', '.join(names)[:200]} lie on a line",
        consequence="The rotation about it is not observable",
        cure="Name a marker off the line with --body too, or one marker for its position alone",
    )


def _not_rigid(cloud: Cloud, seen: Mask, where: str, typical_m: float) -> Inconsistent:
    groups = [", ".join(cloud.names[k] for k in group) for group in _rigid_groups(cloud, seen)]
    apart = f"; these do: {'; '.join(groups)[:400]}" if groups else ""
    return Inconsistent(
        f"{where}: the markers {', '.join(cloud.names)[:200]} do not keep their distances: in most frames one is "
        f"{1e3 * typical_m:.2g} mm off a common shape{apart}",
        consequence="They are no body",
        cure="Name the markers of one body with --body, with commas between them",
    )


def _rigid_groups(cloud: Cloud, seen: Mask) -> list[list[int]]:
    """Return groups of three and more markers that keep all their distances, the largest first."""
    frames = _evenly(np.flatnonzero(seen.any(axis=1)))
    xyz, k = cloud.xyz_m[frames], len(cloud.names)
    keeps = np.zeros((k, k), bool)
    for i in range(k):
        for j in range(i):
            d = np.linalg.norm(xyz[:, i] - xyz[:, j], axis=1)
            d = d[np.isfinite(d)]
            keeps[i, j] = keeps[j, i] = len(d) > 2 and np.subtract(*np.percentile(d, [95.0, 5.0])) < RIGID_M
    groups: list[list[int]] = []
    left = list(range(k))
    while left:
        group: list[int] = []
        for marker in sorted(left, key=lambda m: -int(keeps[m, left].sum())):
            if all(keeps[marker, other] for other in group):
                group.append(marker)
        groups.append(sorted(group))
        left = [marker for marker in left if marker not in group]
    return sorted((group for group in groups if len(group) > 2), key=len, reverse=True)
