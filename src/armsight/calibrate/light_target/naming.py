"""Which light is which from frame to frame: by the distances between them, not by their order in the images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from armsight.arrays import Array, Index
from armsight.calibrate.light_target.adjustment import Sight
from armsight.fitting.quantiles import chi2_isf
from armsight.geometry.poses import skew

HYPOTHESES = 600
"""Shapes tried, each what one choice in one frame shows; every one is held against all frames. All choices of a frame
are tried or none: of many only one is right."""

NAMING_GATE = 1e-5
"""Chance that a frame's true distances are called foreign (with SLACK_PX, so in truth rarer)."""

WIDE = 400.0
"""Namings whose distances are off by less (chi-square) are compared by alignment as well."""

BEHIND = 60.0
"""Added to chi-square where the lights would be seen from behind: isosceles lights turned over fit as well, but lights
shine to one side. A naming that is wrong by its distances is off by hundreds."""

NAMING_ROUNDS = 4
"""Of naming all frames by the shape, and taking the shape from all frames."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Named:
    """The shape X (n, 3), labels in an order of their own, and the frames named by it.

    number (g,): position in the sights. rows (g, n): the pair that is each light. R (g, 3, 3), t (g, 3): its position
    in rig axes. behind (g,): seen from the other side than the rest. information (g, n, 3, 3): of the points.
    misfit: for the other frames, (number, largest difference of a distance in m).
    """

    X: Array
    number: Index
    rows: Index
    R: Array
    t: Array
    behind: NDArray[np.bool_]
    information: Array
    misfit: tuple[tuple[int, float], ...]

    def take(self, keep: NDArray[np.bool_]) -> Named:
        """Return the frames of the mask (g,)."""
        of = ("number", "rows", "R", "t", "behind", "information")
        return replace(self, **{name: getattr(self, name)[keep] for name in of})


def distances(X: Array) -> Array:
    """Return (..., m) the distances of X (..., n, 3), pairs in the order of pairs_of(n)."""
    i, j = pairs_of(X.shape[-2])
    return np.asarray(np.linalg.norm(X[..., i, :] - X[..., j, :], axis=-1))


def pairs_of(n: int) -> tuple[Index, Index]:
    """Return the two lights of each distance."""
    i, j = np.triu_indices(n, 1)
    return i, j


def find_shape(sights: Sequence[Sight]) -> Named:
    """Return the shape that most frames share, and their lights named by it."""
    n = sights[0].rows.shape[1]
    perms = np.array(list(permutations(range(n))), dtype=np.intp)
    X, variances = _best_hypothesis(sights, perms)
    for last in range(NAMING_ROUNDS):
        named = _name_all(sights, X, variances, perms)
        if last == NAMING_ROUNDS - 1 or len(named.number) == 0:
            break
        X = _mean_shape(sights, named)
        variances = np.zeros(len(variances))
    return named


def _variances(xyz: Array, cov: Array) -> Array:
    """Return (..., m) the variances of the distances."""
    i, j = pairs_of(xyz.shape[-2])
    v = xyz[..., i, :] - xyz[..., j, :]
    v = v / np.linalg.norm(v, axis=-1, keepdims=True)
    return np.asarray(np.einsum("...i,...ij,...j->...", v, cov[..., i, :, :] + cov[..., j, :, :], v))


def _orders(perms: Index) -> Index:
    """Return (p, m): which distance each becomes when the lights are renumbered."""
    n = perms.shape[1]
    at = np.zeros((n, n), dtype=np.intp)
    i, j = pairs_of(n)
    at[i, j] = at[j, i] = np.arange(len(i))
    return np.asarray(at[perms[:, i], perms[:, j]])


def _best_hypothesis(sights: Sequence[Sight], perms: Index) -> tuple[Array, Array]:
    """Return the shape (n, 3) of one choice of one frame that most frames share, and its distances' variances."""
    order = _orders(perms)
    gate = float(chi2_isf(NAMING_GATE, order.shape[1]))
    xyz, cov = (np.concatenate([getattr(s, name) for s in sights]) for name in ("xyz_m", "cov_m2"))
    first = np.cumsum([0] + [len(s.rows) for s in sights[:-1]])  # each frame's first choice
    D, V = distances(xyz)[:, order], _variances(xyz, cov)[:, order]  # (c, p, m)
    # so many frames' choices are hypotheses: about HYPOTHESES in all, of three frames and more
    mean = sum(len(s.rows) for s in sights) / len(sights)
    tries = min(len(sights), max(int(HYPOTHESES / mean), 3))
    frames = np.linspace(0, len(sights) - 1, tries).astype(np.intp)
    tried = np.concatenate([first[s] + np.arange(len(sights[s].rows)) for s in frames])
    costs = []
    for c in tried:
        spread = V + V[c, 0]  # perms[0] is the identity
        chi2 = ((D - D[c, 0]) ** 2 / spread).sum(axis=-1)  # (c, p)
        # an uncertain shape fits everything: likelihood counts its width against it
        cost = (np.minimum(chi2, gate) + np.log(spread).sum(axis=-1)).min(axis=1)
        costs.append(float(np.minimum.reduceat(cost, first).sum()))
    best = tried[int(np.argmin(costs))]
    return xyz[best], V[best, 0]


def _name_all(sights: Sequence[Sight], X: Array, variances: Array, perms: Index) -> Named:
    tried, misfit = near(sights, distances(X), variances, perms)
    n = len(X)
    P = np.array([sights[s].xyz_m[c][perms[p]] for s, c, p in tried]).reshape(-1, n, 3)
    W = np.linalg.inv(np.array([sights[s].cov_m2[c][perms[p]] for s, c, p in tried]).reshape(-1, n, 3, 3))
    R, t, chi2 = align(X, P, W)
    behind = facing(R, t, X, _normal(X)) < 0.0
    cost = chi2 + BEHIND * behind
    of = np.array([s for s, _, _ in tried], dtype=np.intp)
    best = np.array([np.flatnonzero(of == s)[np.argmin(cost[of == s])] for s in np.unique(of)], dtype=np.intp)
    rows = [sights[s].rows[c][perms[p]] for s, c, p in (tried[b] for b in best)]
    return Named(
        X=X,
        number=of[best],
        rows=np.array(rows, dtype=np.intp).reshape(-1, n),
        R=R[best],
        t=t[best],
        behind=behind[best],
        information=W[best],
        misfit=misfit,
    )


def near(
    sights: Sequence[Sight], d: Array, variances: Array, perms: Index
) -> tuple[list[tuple[int, int, int]], tuple[tuple[int, float], ...]]:
    """Return (sight, choice, naming) whose distances come near d (m,), and for sights without any by how much not."""
    order, gate = _orders(perms), float(chi2_isf(NAMING_GATE, len(d)))
    tried: list[tuple[int, int, int]] = []
    misfit: list[tuple[int, float]] = []
    for s, sight in enumerate(sights):
        D, V = distances(sight.xyz_m)[:, order], _variances(sight.xyz_m, sight.cov_m2)[:, order]
        chi2 = ((D - d) ** 2 / (V + variances)).sum(axis=-1)  # (c, p)
        at = np.unravel_index(int(np.argmin(chi2)), chi2.shape)
        if chi2[at] <= gate:
            tried += [(s, int(c), int(p)) for c, p in np.argwhere(chi2 <= chi2[at] + WIDE)]
        else:
            misfit.append((s, float(np.abs(D[at] - d).max())))
    return tried, tuple(misfit)


def _mean_shape(sights: Sequence[Sight], named: Named) -> Array:
    """Return the shape (n, 3) of least squares from the frames as they are placed, in its former axes."""
    P = np.stack([_points(sights[s], rows) for s, rows in zip(named.number, named.rows, strict=True)])
    RW = named.R.transpose(0, 2, 1)[:, None] @ named.information
    H = (RW @ named.R[:, None]).sum(axis=0)
    g = (RW @ (P - named.t[:, None])[..., None]).sum(axis=0)
    return np.asarray(np.linalg.solve(H, g)[:, :, 0])


def _points(sight: Sight, rows: Index) -> Array:
    """Return the points (n, 3) of the pairs rows (n,), in that order."""
    choice = int(np.flatnonzero((np.sort(sight.rows, axis=1) == np.sort(rows)).all(axis=1))[0])
    return np.asarray(sight.xyz_m[choice][[int(np.flatnonzero(sight.rows[choice] == r)[0]) for r in rows]])


def _normal(X: Array) -> Array:
    """Return the normal (3,) of the plane through the lights that points away from the camera where X was seen."""
    centre = X.mean(axis=0)
    normal = np.linalg.svd(X - centre)[2][2]
    return np.asarray(normal if normal @ centre > 0.0 else -normal)


def facing(R: Array, t: Array, X: Array, normal: Array) -> Array:
    """Return (b,): cosine between the turned normal and the ray to the lights; below 0 they are seen from behind."""
    centre = R @ X.mean(axis=0) + t
    return np.asarray((R @ normal * centre).sum(axis=-1) / np.linalg.norm(centre, axis=-1))


# A known shape laid onto points of unequal certainty, in batches.

ALIGN_STEPS = 6
"""Gauss-Newton steps from the unweighted answer; each gains two digits."""

HELD = 1e-9
"""Share of the largest information that holds a turn nothing is known about (lights on one line)."""


def align(X: Array, P: Array, W: Array) -> tuple[Array, Array, Array]:
    """Return R (b, 3, 3), t (b, 3), chi2 (b,) of the least (P - R X - t)' W (P - R X - t).

    X (n, 3) or (b, n, 3), P (b, n, 3), W (b, n, 3, 3) the inverse covariances. R is a rotation, never a mirror.
    """
    X = np.broadcast_to(X, P.shape)
    R, t = _kabsch(X, P)
    for _ in range(ALIGN_STEPS):
        q = np.einsum("bij,bnj->bni", R, X)
        e = P - q - t[:, None]
        J = np.concatenate([np.broadcast_to(np.eye(3), (*q.shape, 3)), -skew(q)], axis=-1)  # (b, n, 3, 6)
        WJ = W @ J
        H = np.einsum("bnia,bnic->bac", J, WJ)
        g = np.einsum("bnia,bni->ba", WJ, e)
        scale = 1.0 / np.sqrt(np.einsum("baa->ba", H) + 1e-300)
        H = H * scale[:, :, None] * scale[:, None, :] + HELD * np.eye(6)
        step = np.linalg.solve(H, (g * scale)[:, :, None])[:, :, 0] * scale
        R = Rotation.from_rotvec(step[:, 3:]).as_matrix() @ R
        t = t + step[:, :3]
    e = P - np.einsum("bij,bnj->bni", R, X) - t[:, None]
    return R, t, np.einsum("bni,bnij,bnj->b", e, W, e)


def _kabsch(X: Array, P: Array) -> tuple[Array, Array]:
    x0, p0 = X.mean(axis=1), P.mean(axis=1)
    M = np.einsum("bni,bnj->bij", P - p0[:, None], X - x0[:, None])
    U, _, Vt = np.linalg.svd(M)
    U[:, :, 2] *= np.sign(np.linalg.det(U) * np.linalg.det(Vt))[:, None]
    R = U @ Vt
    return R, p0 - np.einsum("bij,bj->bi", R, x0)
