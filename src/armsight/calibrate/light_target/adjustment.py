"""All frames at once: one shape of the target, one pose per frame, least reprojection error in all views."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from math import comb

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from armsight.arrays import Array, Index
from armsight.errors import Inconsistent
from armsight.fitting import Evaluation, Fit, Problem, solve
from armsight.fitting.groups import whitener, without
from armsight.geometry.poses import skew
from armsight.optics import SIDES, PackedRig, Rig, Triangulation, moved_rig, triangulate
from armsight.optics.kernels.light_image import see_all
from armsight.records import NotSeen, Spots

MAX_CHOICES = 150
"""Choices of lights searched in one frame: of the brightest pairs, as many as give no more; ten for three lights."""

SLACK_PX = 0.1
"""What a good calibration leaves beside a spot's own standard deviation; it decides what belongs together, not the
answer."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LitFrame:
    """Pairs of spots of one moment: row i of left and row i of right may be the same light.

    A spot may stand in several rows where the epipolar lines do not decide; name: how the frame is called to people.
    """

    name: str
    left: Spots
    right: Spots

    def __post_init__(self) -> None:
        if len(self.left) != len(self.right):
            raise Inconsistent(f"{self.name}: {len(self.left)} spots at left, {len(self.right)} at right: no pairs")

    def __len__(self) -> int:
        return len(self.left)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sight:
    """A frame's choices: rows (c, n) of its pairs; xyz_m (c, n, 3), cov_m2 (c, n, 3, 3) with slack, in rig axes."""

    frame: int
    rows: Index
    xyz_m: Array
    cov_m2: Array


def sights_of(rig: Rig, frames: Sequence[LitFrame], n: int) -> tuple[list[Sight], list[tuple[int, str]]]:
    """Return the frames in which n lights may be seen, and (number, why) of those in which not."""
    sights: list[Sight] = []
    rejected: list[tuple[int, str]] = []
    points = _triangulated(rig, frames)
    ends = np.cumsum([len(frame) for frame in frames])
    for number, (frame, end) in enumerate(zip(frames, ends.tolist(), strict=True)):
        of = slice(end - len(frame), end)
        choices = _choices(frame, points.found[of], n)
        if isinstance(choices, NotSeen):
            rejected.append((number, choices.why))
        else:
            xyz, cov = points.xyz_m[of], points.covariance_m2[of]
            sights.append(Sight(frame=number, rows=choices, xyz_m=xyz[choices], cov_m2=cov[choices]))
    return sights, rejected


def _triangulated(rig: Rig, frames: Sequence[LitFrame]) -> Triangulation:
    """Return the points of all frames, one after the other."""
    slack = SLACK_PX**2 * np.eye(2)
    views = [[getattr(frame, side) for frame in frames] for side in SIDES]
    uv = [np.concatenate([np.empty((0, 2)), *(spots.uv_px for spots in view)]) for view in views]
    cov = [np.concatenate([np.empty((0, 2, 2)), *(spots.covariance_px2 for spots in view)]) for view in views]
    return triangulate(rig, *uv, *(c + slack for c in cov))


def _choices(frame: LitFrame, found: NDArray[np.bool_], n: int) -> Index | NotSeen:
    """Return (c, n) rows of the frame that are n different lights, or why there are none."""
    if len(frame) < n:
        return NotSeen(f"{len(frame)} of {n} lights are seen in both views")
    good = _brightest(frame, np.flatnonzero(found), n)
    sides = [np.unique(s.uv_px, axis=0, return_inverse=True)[1].reshape(-1) for s in (frame.left, frame.right)]
    rows = [c for c in combinations(good, n) if all(len(set(side[list(c)].tolist())) == n for side in sides)]
    if not rows:
        return NotSeen(f"{len(good)} pairs of spots, among them no {n} different lights")
    return np.array(rows, dtype=np.intp)


def _brightest(frame: LitFrame, good: Index, n: int) -> list[int]:
    """Return the rows among which to search: all, or of too many those brightest in the view that shows them darker."""
    most = n
    while comb(most + 1, n) <= MAX_CHOICES:
        most += 1
    peak = np.minimum(frame.left.peak, frame.right.peak)[good]
    return sorted(good[np.argsort(-peak, kind="stable")[:most]].tolist())


# The target's own frame, and the names of its lights by their positions in the images (MATH 3.2).

LETTERS = "ABCDEF"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Layout:
    """Shape parameters of n lights: spots = (basis @ values) reshaped to (n, 3); basis (3 n, k), names (k,).

    on_line: all lights on the frame's x axis, their mean at the origin: the turn about it is not known.
    """

    names: tuple[str, ...]
    basis: Array
    on_line: bool

    def spots(self, values: Array) -> Array:
        """Return the lights (n, 3) in m."""
        return (self.basis @ values).reshape(-1, 3)


def plane_layout(n: int) -> Layout:
    """Return the frame of Pachidis 2005, eqs. (7)-(8): origin G at the mean of A, B, C, u from A to G, w = (B - G) x
    (A - G), v = w x u. A = (-a, 0, 0), B = (a/2 + s, h, 0), C = (a/2 - s, -h, 0); the other lights are free.
    """
    names = ["a_m", "s_m", "h_m"] + [f"{LETTERS[i]}.{axis}_m" for i in range(3, n) for axis in "xyz"]
    basis = np.zeros((3 * n, len(names)))
    basis[[0, 3, 6], 0] = -1.0, 0.5, 0.5
    basis[[3, 6], 1] = 1.0, -1.0
    basis[[4, 7], 2] = 1.0, -1.0
    basis[9:, 3:] = np.eye(3 * (n - 3))
    return Layout(names=tuple(names), basis=basis, on_line=False)


def line_layout(n: int) -> Layout:
    """Return the frame of lights on one line: positions along x from A on, their mean at the origin."""
    names = [f"{LETTERS[i]}.along_m" for i in range(1, n)]
    basis = np.zeros((3 * n, n - 1))
    basis[3 * np.arange(1, n), np.arange(n - 1)] = 1.0
    basis[3 * np.arange(n)] -= 1.0 / n
    return Layout(names=tuple(names), basis=basis, on_line=True)


def plane_frame(X: Array) -> tuple[Array, Array]:
    """Return R (3, 3), whose columns are u, v, w, and G (3,) of the lights X (n, 3), A, B, C first."""
    G = X[:3].mean(axis=0)
    u = G - X[0]
    w = np.cross(X[1] - G, X[0] - G)
    u, w = u / np.linalg.norm(u), w / np.linalg.norm(w)
    return np.stack([u, np.cross(w, u), w], axis=1), G


def line_frame(X: Array) -> tuple[Array, Array]:
    """Return R (3, 3), whose first column is the direction from the first light on, and the mean (3,) of X (n, 3)."""
    G = X.mean(axis=0)
    axis = np.linalg.svd(X - G)[2][0]
    axis = axis if axis @ (X[-1] - X[0]) > 0.0 else -axis
    side = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    side /= np.linalg.norm(side)
    return np.stack([axis, side, np.cross(axis, side)], axis=1), G


def name_order(X: Array, away: Array, u_px: Array) -> Index:
    """Return the order (n,) in which the lights X (n, 3) become A, B, C, D ...

    A is leftmost in the mean of the left images, u_px (n,); B and C make the largest triangle with it, in the sense
    that turns w away from the camera (away (3,), in the axes of X): B lower right, C upper right. The rest follows
    from left to right.
    """
    order = np.argsort(u_px, kind="stable")
    first, rest = order[0], order[1:]
    if len(rest) < 2:
        return np.asarray(order)

    def normal(b: int, c: int) -> Array:
        return np.cross(X[b] - X[first], X[c] - X[first])

    b, c = max(combinations(rest.tolist(), 2), key=lambda pair: float(np.linalg.norm(normal(*pair))))
    # w = (B - G) x (A - G) = -(B - A) x (C - A) / 3
    if normal(b, c) @ away > 0.0:
        b, c = c, b
    return np.array([first, b, c, *(i for i in rest if i not in (b, c))], dtype=np.intp)


POSE = ("tx_m", "ty_m", "tz_m", "rx_rad", "ry_rad", "rz_rad")

HOLD = 1.0
"""Information per rad^2 that holds the turn about a line of lights, of which nothing is known; pixels say 1e6."""

SMALL = 1e-2
"""Step, in standard deviations of the calibration, of the differences that tell how the answer follows the rig."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LightObservations:
    """Named spots of the frames: uv_px (g, n, V, 2) [frame, light, camera, axis], cov_px2 (g, n, V, 2, 2).

    NaN where a camera does not see a light.
    """

    uv_px: Array
    cov_px2: Array

    @property
    def seen(self) -> NDArray[np.bool_]:
        """Which camera sees which light (g, n, V)."""
        return np.asarray(np.isfinite(self.uv_px).all(axis=-1))

    def dof(self, layout: Layout) -> NDArray[np.intp]:
        """Return the degrees of freedom (g,) that each frame's pose leaves."""
        return np.asarray(2 * self.seen.sum(axis=(1, 2)) - (5 if layout.on_line else 6))

    def take(self, keep: NDArray[np.bool_]) -> LightObservations:
        """Return the frames of the mask."""
        return LightObservations(uv_px=self.uv_px[keep], cov_px2=self.cov_px2[keep])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LightBundle:
    """The fit. values (k,): of the layout. poses (g, 6): t, rotation vector. residual_px (g, n, V, 2) predicted minus
    seen, NaN where a light is not; left_out_px: the same with the shape of the other frames. frame_chi2 (g,).
    covariance (k, k): from the spots' standard deviations alone; rig_share (k, k): of the rig's calibration.
    """

    values: Array
    poses: Array
    residual_px: Array
    left_out_px: Array
    frame_chi2: Array
    covariance: Array
    rig_share: Array
    dof: int

    @property
    def scale2(self) -> float:
        """Chi-square by degree of freedom."""
        return float(self.frame_chi2.sum()) / max(self.dof, 1)


def fit_bundle(
    rig: Rig, layout: Layout, sightings: LightObservations, values: Array, R: Array, t: Array
) -> LightBundle:
    """Return the bundle from a guess: values (k,) of the layout, R (g, 3, 3), t (g, 3) of the frames."""
    packed = PackedRig.of(rig)
    there = sightings.seen[..., None, None]
    whiten = np.where(there, whitener(np.where(there, sightings.cov_px2, np.eye(2))), 0.0)  # (g, n, V, 2, 2)
    g, n, V = sightings.uv_px.shape[:3]

    def evaluate(shared: Array, local: Array) -> Evaluation:
        return _evaluate(packed, layout, sightings, whiten, shared, local)

    fit = solve(
        Problem(
            names=layout.names,
            guess=values,
            evaluate=evaluate,
            n_residuals=2 * V * n * g + (g if layout.on_line else 0),
            local_names=POSE,
            local_guess=np.concatenate([t, Rotation.from_matrix(R).as_rotvec()], axis=1),
            retract=_retract,
        )
    )
    return _judge(rig, layout, sightings, fit, evaluate(fit.shared, fit.local), whiten)


def _evaluate(
    packed: PackedRig, layout: Layout, sightings: LightObservations, whiten: Array, shared: Array, local: Array
) -> Evaluation:
    g, n, V = sightings.uv_px.shape[:3]
    turned, uv, J = _project(packed, layout, shared, local)
    there = sightings.seen[..., None]
    off, J = np.where(there, uv - sightings.uv_px, 0.0), np.where(there[..., None], J, 0.0)
    WJ = whiten @ J  # (g, n, V, 2, 3)
    residuals = (whiten @ off[..., None]).reshape(g, -1)
    # p = R X + t moves by dt + dw x (R X): as J by dt, as -J [R X]x by dw
    own = np.concatenate([WJ, -WJ @ skew(turned)[:, :, None]], axis=-1).reshape(g, 2 * V * n, 6)
    R = _rotations(local)
    shape = (WJ @ R[:, None, None] @ layout.basis.reshape(1, n, 1, 3, -1)).reshape(g, 2 * V * n, -1)
    if layout.on_line:  # a row without residual that holds the turn about the line
        held = np.sqrt(HOLD) * np.concatenate([np.zeros((g, 3)), R[:, :, 0]], axis=1)
        residuals = np.concatenate([residuals, np.zeros((g, 1))], axis=1)
        own = np.concatenate([own, held[:, None]], axis=1)
        shape = np.concatenate([shape, np.zeros((g, 1, shape.shape[2]))], axis=1)
    return Evaluation(residuals=residuals, shared=shape, local=own)


def _judge(
    rig: Rig, layout: Layout, sightings: LightObservations, fit: Fit, at: Evaluation, whiten: Array
) -> LightBundle:
    """Return the bundle with its uncertainty, the rig's share and the left-out residuals."""
    g, n, V = sightings.uv_px.shape[:3]
    Js, Jl, r = at.shared, at.local, at.residuals
    # residuals and shape as they are once each frame's pose has followed
    free = np.eye(r.shape[1]) - Jl @ np.linalg.solve(Jl.transpose(0, 2, 1) @ Jl, Jl.transpose(0, 2, 1))
    Js, e = free @ Js, (free @ r[:, :, None])[:, :, 0]
    S = Js.transpose(0, 2, 1) @ Js  # (g, k, k)
    information = S.sum(axis=0)
    covariance = np.linalg.inv(information)
    step = np.zeros((g, len(information)))
    if g > 1:
        step = without(information, S, (Js.transpose(0, 2, 1) @ e[:, :, None])[:, :, 0])
    # the pose of a frame follows the shape that the others give: e and Js are by what is left of both
    left_out = (e + (Js @ step[:, :, None])[:, :, 0])[:, : 2 * V * n].reshape(g, n, V, 2)
    share = np.zeros_like(covariance)
    if rig.covariance is not None:
        D = _by_rig(rig, layout, fit, whiten, sightings.seen)
        if layout.on_line:
            D = np.concatenate([D, np.zeros((g, 1, D.shape[2]))], axis=1)
        # where the minimum goes when the rig changes: dx = -(J'J)^-1 J' dr, with each frame's pose following
        A = -covariance @ np.einsum("gmk,gmp->kp", Js, D)
        share = A @ PackedRig.of(rig).covariance @ A.T
    there = sightings.seen[..., None]
    colour = np.where(there[..., None], np.linalg.inv(np.where(there[..., None], whiten, np.eye(2))), np.nan)
    return LightBundle(
        values=fit.shared,
        poses=fit.local,
        residual_px=(colour @ r[:, : 2 * V * n].reshape(g, n, V, 2)[..., None])[..., 0],
        left_out_px=(colour @ left_out[..., None])[..., 0],
        frame_chi2=(r**2).sum(axis=1),
        covariance=covariance,
        rig_share=share,
        dof=int(sightings.dof(layout).sum()) - len(layout.names),
    )


def _by_rig(rig: Rig, layout: Layout, fit: Fit, whiten: Array, seen: NDArray[np.bool_]) -> Array:
    """Return (g, 2 V n, 16 V - 6): whitened residuals by the rig's parameters, by central differences."""
    sigma = np.sqrt(np.diag(PackedRig.of(rig).covariance))
    g, n, V = whiten.shape[:3]
    D = np.zeros((g, 2 * V * n, len(sigma)))
    for p in np.flatnonzero(sigma > 0.0):
        step = np.zeros(len(sigma))
        step[p] = max(SMALL * sigma[p], 1e-9)
        plus, minus = (
            _project(PackedRig.of(moved_rig(rig, s * step)), layout, fit.shared, fit.local)[1] for s in (1.0, -1.0)
        )
        moved = np.where(seen[..., None], (plus - minus) / (2.0 * step[p]), 0.0)
        D[:, :, p] = (whiten @ moved[..., None])[..., 0].reshape(g, -1)
    return D


def _project(packed: PackedRig, layout: Layout, values: Array, poses: Array) -> tuple[Array, Array, Array]:
    """Return R X (g, n, 3), pixels (g, n, V, 2) and their derivatives (g, n, V, 2, 3) by the position in rig axes."""
    X = layout.spots(values)
    g, n = len(poses), len(X)
    turned = np.einsum("gij,nj->gni", _rotations(poses), X)
    positions = np.ascontiguousarray(turned + poses[:, None, :3]).reshape(-1, 3)
    V = len(packed.k)
    uv, J = np.empty((g * n, V, 2)), np.empty((g * n, V, 2, 3))
    see_all(packed.k, packed.R, packed.t, positions, uv, J)
    return turned, uv.reshape(g, n, V, 2), J.reshape(g, n, V, 2, 3)


def _rotations(poses: Array) -> Array:
    return np.asarray(Rotation.from_rotvec(np.array(poses[:, 3:])).as_matrix())


def _retract(shared: Array, local: Array, step_shared: Array, step_local: Array) -> tuple[Array, Array]:
    turned = Rotation.from_rotvec(step_local[:, 3:]) * Rotation.from_rotvec(np.array(local[:, 3:]))
    return shared + step_shared, np.concatenate([local[:, :3] + step_local[:, :3], turned.as_rotvec()], axis=1)
