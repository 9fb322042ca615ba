"""Where a cell's calibration begins: delay, lens, place of a camera and lights on the flange, without any guess.

A light fixed to the flange at p is at R(t) p + t(t) in the base, R and t being known from the joints. Seen by a camera
of unknown matrix P (3, 4) this is linear in P and in the products P[:, :3] x p (27 for each piece of a light's way): a
direct linear transform (Hartley, Zisserman, Multiple View Geometry, 2004, 7.1) in which the products are eliminated
piece by piece and the rank of one is restored by alternating.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg
from scipy.spatial.transform import Rotation

from armsight.arrays import Array, Index
from armsight.calibrate.cell.assignment import best_pieces
from armsight.calibrate.cell.observations import JointLog, Spots
from armsight.kinematics import Arm, fk

GRID_S = 0.02
LEVER_M = 0.15
"""Lights are about so far from the flange: for the speed at which its turning moves them."""
FEWEST_COMMON_S = 15.0
CANDIDATES = 6
"""Delays tried, the best correlated first."""
APART_S = 0.3
LENS_TRIED = (0.0, -0.15, 0.15, -0.3, 0.3)
"""Radial coefficients by which pixels are straightened before the linear solution, in units of r^2 over the focal
length that was found."""
ALTERNATIONS = 80
SETTLED = 1e-3
"""Relative fall of what remains, over FEW_ALTERNATIONS, below which alternating has settled."""
FEW_ALTERNATIONS = 5
STEPS_S = tuple(np.linspace(-0.12, 0.12, 7).tolist())
"""About each of them, in which the linear solution is looked for."""
QUICK_ROWS = 40
"""Spots used of each piece while delays are tried."""
QUICK_ALTERNATIONS = 40
AS_ONE_M, AS_ONE_KEPT = 0.16, 2
"""Places along each axis of the flange at which all lights may be for a start; how many of them are gone on with."""
FARTHEST_M, FAR_M = 1.0, 1e3
"""No light is further from the flange; nor, on the way to it, so far that nothing leads back."""
VIEW = (0.2, 5.0)
"""Focal length over the image's width: lenses that open less wide than a phone's or wider than a telescope's."""
VIEWS = (0.45, 0.6, 0.8, 1.1)
"""Focal lengths over the image's width that are tried where the one found explains little."""
GOOD = 3e-3
"""Of the image's width: what a right delay leaves at most, before lens and delay are found exactly."""
FINER = (-0.6, -0.3, 0.3, 0.6)
"""Parts of a step, by which the best delay is looked at again."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Start:
    """A camera to begin with: focal length, principal point, k1, T_base_camera as R (3, 3), t (3,), delay, what fits.

    lights_m (k, 3): of the pieces, in the flange's axes. rms_px: what remains. mirrored: the image shows the scene in a
    mirror.
    """

    focal_px: float
    centre_px: Array
    k1: float
    R: Array
    t: Array
    delay_s: float
    lights_m: Array
    rms_px: float
    mirrored: bool


def flange_speed(arm: Arm, log: JointLog, grid_s: Array) -> Array:
    """Return about how fast (k,) lights on the flange move in m/s."""
    T = fk(arm, log.at(np.clip(grid_s, log.t_s[0], log.t_s[-1]))[0])
    v = np.asarray(np.gradient(T[:, :3, 3], GRID_S, axis=0))
    turn = Rotation.from_matrix(T[1:, :3, :3] @ T[:-1, :3, :3].transpose(0, 2, 1)).as_rotvec()
    rate = np.linalg.norm(np.concatenate([turn, turn[-1:]]), axis=1) / GRID_S
    return np.asarray(np.hypot(np.linalg.norm(v, axis=1), LEVER_M * rate))


def image_speed(spots: Spots, ways: Sequence[Index], grid_s: Array) -> Array:
    """Return how fast (k,) the spots of a camera move in px/s, NaN where none is seen."""
    at, speed = [], []
    for rows in ways:
        t, uv = spots.stamp_s[rows], spots.uv_px[rows]
        step = np.diff(t)
        at.append(t[:-1] + 0.5 * step)
        speed.append(np.linalg.norm(np.diff(uv, axis=0), axis=1) / step)
    t, v = np.concatenate(at), np.concatenate(speed)
    order = np.argsort(t)
    out = np.interp(grid_s, t[order], v[order])
    near = np.abs(t[order][np.clip(np.searchsorted(t[order], grid_s), 0, len(t) - 1)] - grid_s) < 0.2
    return np.where(near, out, np.nan)


def delays(arm: Arm, log: JointLog, spots: Spots, ways: Sequence[Index]) -> tuple[Array, Array]:
    """Return the delays (c,) at which image and arm move alike, best first, and how well they correlate (c,)."""
    ours = np.arange(log.t_s[0], log.t_s[-1], GRID_S)
    theirs = np.arange(spots.stamp_s.min(), spots.stamp_s.max(), GRID_S)
    a, b = np.log(flange_speed(arm, log, ours) + 1e-3), np.log(image_speed(spots, ways, theirs) + 1.0)
    known = np.isfinite(b)
    # Pearson's correlation at all lags at once, over the samples where the image's speed is known
    b = np.where(known, b, 0.0)
    w = known.astype(float)
    one = np.ones(len(a))
    n = np.maximum(_correlated(one, w), 0.0)
    sa, sb, saa, sbb, sab = (_correlated(x, y) for x, y in ((a, w), (one, b), (a * a, w), (one, b * b), (a, b)))
    with np.errstate(invalid="ignore", divide="ignore"):
        r = (n * sab - sa * sb) / np.sqrt((n * saa - sa**2) * (n * sbb - sb**2))
    r[(n * GRID_S < min(FEWEST_COMMON_S, 0.5 * known.sum() * GRID_S)) | ~np.isfinite(r)] = 0.0
    worth = np.arctanh(np.clip(r, 0.0, 0.999)) * np.sqrt(n)  # Fisher's z: short overlaps correlate by chance
    lag = np.arange(len(r)) - (len(b) - 1)  # of their sample 0 in ours
    delay = ours[0] - theirs[0] + GRID_S * lag
    chosen: list[int] = []
    for k in np.argsort(worth)[::-1]:
        if all(abs(delay[k] - delay[c]) > APART_S for c in chosen):
            chosen.append(int(k))
            if len(chosen) == CANDIDATES:
                break
    return delay[chosen], r[chosen]


def _correlated(a: Array, b: Array) -> Array:
    """Return sum_i a[i + lag] b[i] for all lags from 1 - len(b) on."""
    n = len(a) + len(b) - 1
    return np.fft.irfft(np.fft.rfft(a, n) * np.fft.rfft(b[::-1], n), n)


def find_start(
    arm: Arm,
    log: JointLog,
    spots: Spots,
    ways: Sequence[Index],
    size: tuple[int, int],
    delays_s: Array,
    places: Array | None = None,
) -> Start | None:
    """Return the camera that explains the ways best, near any of the delays (c,); None where nothing does.

    places (k, 3): on the flange, at which the lights are, where that is known.
    """
    pieces = best_pieces(spots, ways)
    few = [rows[np.linspace(0, len(rows) - 1, min(QUICK_ROWS, len(rows))).astype(np.intp)] for rows in pieces]
    whole = _Look(arm=arm, log=log, spots=spots, pieces=pieces, size=size, turns=ALTERNATIONS, places=places)
    quick = replace(whole, pieces=few, turns=QUICK_ALTERNATIONS)
    best: Start | None = None
    for delay in delays_s.tolist():
        best = _better([best, *(quick.start(delay + step, size[0], 0.0) for step in STEPS_S)])
        if best is not None and best.rms_px < GOOD * size[0]:
            break
    if best is None:
        return None
    width = STEPS_S[1] - STEPS_S[0]
    # between the steps the linear solution leaves some pixels more; the bundle takes up what is left of the delay
    near = _better([best, *(quick.start(best.delay_s + part * width, best.focal_px, 0.0) for part in FINER)]) or best
    found = _better([whole.start(near.delay_s, near.focal_px, k1) for k1 in LENS_TRIED])
    if found is not None and found.rms_px < GOOD * size[0] / 5.0:
        return found
    # a wide and bent lens leads the focal length astray as well: both are tried together
    thorough = [whole.start(near.delay_s, view * size[0], k1) for view in VIEWS for k1 in LENS_TRIED]
    return _better([found, *thorough])


def _better(starts: Sequence[Start | None]) -> Start | None:
    return min((each for each in starts if each is not None), key=lambda each: each.rms_px, default=None)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Look:
    """What a camera is looked for in: pieces of ways, and how often lights and camera are found by turns."""

    arm: Arm
    log: JointLog
    spots: Spots
    pieces: Sequence[Index]
    size: tuple[int, int]
    turns: int
    places: Array | None

    def start(self, delay_s: float, focal_px: float, k1: float) -> Start | None:
        """Return the camera at a delay that explains the pieces best, straightened by k1 and a focal length."""
        log, spots = self.log, self.spots
        centre = (np.array(self.size) - 1.0) / 2.0
        times = [np.clip(spots.stamp_s[rows] + delay_s, log.t_s[0], log.t_s[-1]) for rows in self.pieces]
        T = [fk(self.arm, log.at(t)[0]) for t in times]
        middle = np.concatenate(T)[:, :3, 3].mean(axis=0)
        xy = [_straight((spots.uv_px[rows] - centre) / focal_px, k1) for rows in self.pieces]
        found = _camera(T, xy, middle, self.turns, self.places)
        if found is None:
            return None
        P, lights, rms, mirrored = found
        K, middle_px, R, t = _decomposed(P, mirrored)
        if not VIEW[0] < K * focal_px / self.size[0] < VIEW[1]:
            return None
        return Start(
            focal_px=K * focal_px,
            centre_px=centre + focal_px * middle_px,
            k1=k1 * K**2,
            R=R,
            t=t + middle,
            delay_s=delay_s,
            lights_m=lights,
            rms_px=rms * focal_px,
            mirrored=mirrored,
        )


def _straight(xy: Array, k1: float) -> Array:
    """Return rays (n, 2) of distorted ones, by two steps of a fixed point."""
    out = xy
    for _ in range(8):
        out = xy / (1.0 + k1 * np.clip((out**2).sum(axis=1, keepdims=True), 0.0, 1.0))
    return np.asarray(out)


def _camera(
    T: Sequence[Array], xy: Sequence[Array], middle: Array, turns: int, places: Array | None
) -> tuple[Array, Array, float, bool] | None:
    """Return P (3, 4) about the middle, the pieces' lights (k, 3), what remains, and whether it shows a mirror."""
    pieces = _Pieces.of(T, xy, middle)
    found: list[tuple[Array, Array, float] | None] = [] if places is None else [_resected(pieces, places, turns)]
    if places is None:
        found = [_alternated(P, pieces, turns) for P in (_eliminated(T, xy, middle), *_as_one(pieces))]
    near = [each for each in found if each is not None and np.linalg.norm(each[1], axis=1).max() < FARTHEST_M]
    best = min(near, key=lambda each: each[2], default=None)
    if best is None:
        return None
    P, lights, rms = best
    depth = pieces.places(lights) @ P[2, :3] + P[2, 3]
    if np.median(depth) < 0.0:
        P, depth = -P, -depth
    if np.mean(depth > 0.0) < 0.9:
        return None
    return P, lights, rms, bool(np.linalg.det(P[:, :3]) < 0.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Pieces:
    """All pieces' spots in one: T (m, 4, 4) of the flange about the middle, rays xy (m, 2).

    products (k 16, 64): of every piece the sums of w T_ia T_jb over its spots, a and b in the rows; in the columns i, j
    and w, which is 1, x, y, x^2 + y^2. What remains of the equations of P and of the lights is quadratic in both, and
    all of it is in these.
    """

    T: Array
    xy: Array
    of_piece: Index
    products: Array

    @classmethod
    def of(cls, T: Sequence[Array], xy: Sequence[Array], middle: Array) -> _Pieces:
        """Return them."""
        moved = np.eye(4)
        moved[:3, 3] = -middle
        every = [moved @ pose for pose in T]
        return cls(
            T=np.concatenate(every),
            xy=np.concatenate(list(xy)),
            of_piece=np.repeat(np.arange(len(T)), [len(pose) for pose in T]),
            products=np.concatenate([_products(pose, seen) for pose, seen in zip(every, xy, strict=True)]),
        )

    def places(self, lights: Array) -> Array:
        """Return where the spots' lights (k, 3) are: (m, 3)."""
        return np.asarray(np.einsum("mij,mj->mi", self.T[:, :3, :3], lights[self.of_piece]) + self.T[:, :3, 3])

    def lights(self, P: Array) -> Array:
        """Return where on the flange the light of each piece is (k, 3) for P."""
        Q = self.forms(P)
        N = Q[:, :3, :3]
        N = N + 1e-9 * np.trace(N, axis1=1, axis2=2)[:, None, None] * np.eye(3)
        return np.asarray(np.linalg.solve(N, -Q[:, :3, 3:])[:, :, 0])

    def forms(self, P: Array) -> Array:
        """Return Q (k, 4, 4): p' Q p is what remains for a piece's light at p, homogeneous, on the flange."""
        u, v, w = P[0], P[1], P[2]
        sides = [np.outer(u, u) + np.outer(v, v), -np.outer(u, w), -np.outer(v, w), np.outer(w, w)]
        forms = np.array([sides[0], sides[1] + sides[1].T, sides[2] + sides[2].T, sides[3]])
        return np.asarray((self.products @ forms.ravel()).reshape(-1, 4, 4))

    def matrix(self, lights: Array) -> Array:
        """Return P for known lights (normalised DLT)."""
        return self.of_sums(_squares(lights).ravel() @ self.products)

    def of_sums(self, sums: Array) -> Array:
        """Return P (..., 3, 4) from the products' sums (..., 64), each weighted by its light's place."""
        H = sums.reshape(*sums.shape[:-1], 4, 4, 4)
        scale = np.ones((*sums.shape[:-1], 4))
        size = np.sqrt(np.trace(H[..., 0, :3, :3], axis1=-2, axis2=-1) / (3.0 * len(self.T))) + 1e-12
        scale[..., :3] = size[..., None]
        H = H / (scale[..., :, None] * scale[..., None, :])[..., None, :, :]
        A = np.zeros((*sums.shape[:-1], 3, 4, 3, 4))
        A[..., 0, :, 0, :] = A[..., 1, :, 1, :] = H[..., 0, :, :]
        A[..., 0, :, 2, :] = A[..., 2, :, 0, :] = -H[..., 1, :, :]
        A[..., 1, :, 2, :] = A[..., 2, :, 1, :] = -H[..., 2, :, :]
        A[..., 2, :, 2, :] = H[..., 3, :, :]
        least = np.linalg.eigh(A.reshape(*sums.shape[:-1], 12, 12))[1][..., 0]
        return np.asarray(least.reshape(*sums.shape[:-1], 3, 4) / scale[..., None, :])

    def remaining(self, P: Array, places: Array) -> Array:
        """Return the median (...) of what remains in the image of places (..., m, 3) by P (..., 3, 4)."""
        seen = places @ P[..., :3].swapaxes(-1, -2) + P[..., None, :, 3]
        return np.asarray(np.sqrt(np.median(((seen[..., :2] / seen[..., 2:] - self.xy) ** 2).sum(axis=-1), axis=-1)))


def _squares(lights: Array) -> Array:
    """Return the products (k, 4, 4) of each homogeneous place (k, 3) with itself."""
    own = np.concatenate([lights, np.ones((len(lights), 1))], axis=1)
    return np.asarray(own[:, :, None] * own[:, None, :])


def _products(T: Array, xy: Array) -> Array:
    """Return a piece's products (16, 64) of poses (n, 4, 4) and rays (n, 2): see _Pieces."""
    flat, (x, y) = T.reshape(-1, 16), xy.T
    each = np.stack([np.ones_like(x), x, y, x**2 + y**2])
    sums = (each[:, None, :] * flat.T) @ flat  # (4, 16, 16): w, (i a), (j b)
    return np.asarray(sums.reshape(4, 4, 4, 4, 4).transpose(2, 4, 0, 1, 3).reshape(16, 64))


def _as_one(pieces: _Pieces) -> list[Array]:
    """Return the best P as if all lights were at one place near the flange: rough, but never short of motion."""
    steps = np.linspace(-AS_ONE_M, AS_ONE_M, 5)
    at = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)
    P = pieces.of_sums(_squares(at).reshape(len(at), 16) @ pieces.products.reshape(-1, 16, 64).sum(axis=0))
    places = np.einsum("mij,pj->pmi", pieces.T[:, :3, :3], at) + pieces.T[:, :3, 3]
    return list(P[np.argsort(pieces.remaining(P, places), kind="stable")[:AS_ONE_KEPT]])


def _eliminated(T: Sequence[Array], xy: Sequence[Array], middle: Array) -> Array:
    """Return P (3, 4) by linear least squares, the products of each piece eliminated."""
    S = np.zeros((12, 12))
    for pose, seen in zip(T, xy, strict=True):
        shared, own = _rows(pose, seen, middle)
        Q, _, _ = scipy.linalg.qr(own, mode="economic", pivoting=True)
        left = shared - Q @ (Q.T @ shared)
        S += left.T @ left
    return np.asarray(np.linalg.eigh(S)[1][:, 0].reshape(3, 4))


def _alternated(P: Array, pieces: _Pieces, turns: int) -> tuple[Array, Array, float] | None:
    """Return P, lights (k, 3) and what remains, each found from the other by turns."""
    before = np.inf
    for turn in range(turns):
        lights = pieces.lights(P)
        if not (np.abs(lights) < FAR_M).all():  # also where they are not finite
            return None
        P = pieces.matrix(lights)
        if turn % FEW_ALTERNATIONS == 0:
            rms = float(pieces.remaining(P, pieces.places(lights)))
            if rms > (1.0 - SETTLED) * before:
                return P, lights, rms
            before = rms
    return P, lights, float(pieces.remaining(P, pieces.places(lights)))


def _resected(pieces: _Pieces, places: Array, turns: int) -> tuple[Array, Array, float]:
    """Return the same of lights at known places (p, 3): from all in the middle or in one, which is which by turns."""
    own = np.concatenate([places, np.ones((len(places), 1))], axis=1)
    found = []
    for begin in (places.mean(axis=0), *places):
        lights = np.tile(begin, (len(pieces.products) // 16, 1))
        for _ in range(turns):
            P = pieces.matrix(lights)
            nearest = places[np.argmin(np.einsum("pi,kij,pj->kp", own, pieces.forms(P), own), axis=1)]
            if (nearest == lights).all():
                break
            lights = nearest
        found.append((P, lights, float(pieces.remaining(P, pieces.places(lights)))))
    return min(found, key=lambda each: each[2])


def _rows(pose: Array, xy: Array, middle: Array) -> tuple[Array, Array]:
    """Return the equations (2 m, 12) of P and (2 m, 27) of the products."""
    m = len(xy)
    tau = np.concatenate([pose[:, :3, 3] - middle, np.ones((m, 1))], axis=1)
    rho = pose[:, :3, :3].reshape(m, 9)
    out = []
    for part in (tau, rho):
        k = part.shape[1]
        block = np.zeros((m, 2, 3, k))
        block[:, 0, 0], block[:, 1, 1] = part, part
        block[:, :, 2] = -xy[:, :, None] * part[:, None, :]
        out.append(block.reshape(2 * m, 3 * k))
    return out[0], out[1]


def _decomposed(P: Array, mirrored: bool) -> tuple[float, Array, Array, Array]:
    """Return focal length, principal point (2,), T_base_camera's R (3, 3) and centre (3,) of P of positive depths."""
    M = P[:, :3] * (np.array([[-1.0], [1.0], [1.0]]) if mirrored else 1.0)
    K, R = scipy.linalg.rq(M)  # P = K R [I, -centre] (Hartley, Zisserman 6.2.4)
    turn = np.diag(np.sign(np.diag(K)))
    K, R = K @ turn, turn @ R
    centre = -np.linalg.solve(P[:, :3], P[:, 3])
    focal = float(np.sqrt(abs(K[0, 0] * K[1, 1])) / abs(K[2, 2]))
    return focal, np.asarray(K[:2, 2] / K[2, 2]), np.asarray(R.T), np.asarray(centre, np.float64)
