"""How well a light's centre can be placed: the Cramer-Rao bound of its image, for a camera whose noise is known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.spatial.distance import pdist
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array, Mask
from armsight.geometry.poses import skew
from armsight.measure.poses.kernels.rig_covariance import FOLDED_FROM
from armsight.measure.poses.pose import TWO, UNKNOWN, NamedSpots, solve_pose
from armsight.measure.poses.setup import Setup, symmetries
from armsight.optics import Rig, moved_rig
from armsight.optics.camera import EMPTY_PLACE
from armsight.optics.parallelism import difference_step
from armsight.records import NoiseModel, PoseStatus, Target, TargetPose
from armsight.units import DEG

LEVEL = 180.0
"""Grey levels of a wide light above its surroundings: bright, and not clipped."""
GROUND = 10.0
"""Grey level of what is round it."""
BLUR_PX = 0.8
"""Gaussian sigma of lens and pixel together."""
FINE = 4
"""Samples per pixel and axis of the light's image."""
ABOVE_BOUND = 1.13
"""Deviation over the bound of centres that find_spots gives: 1.08 of lights 3 px across to 1.18 of 20 px (rendered
pictures, benchmarks/design.py): their width, height and ground are fitted with them."""
SIZES_PX = np.geomspace(1.0, 64.0, 13)
"""Widths at which the bound is worked out; between them it is a power of the width."""


def centre_deviation(noise: NoiseModel, size_px: Array) -> Array:
    """Return the standard deviation in px of one coordinate of the centres of round lights so many px across.

    A light of LEVEL on GROUND is blurred by BLUR_PX; var(u) = 1 / sum over the pixels of (d level / d u)^2 / variance
    (level), widened by what neighbours share of their noise. A light of unknown size (0) is taken to be 4 px across.
    """
    known = [_bound(noise, float(size)) for size in SIZES_PX]
    size = np.where(size_px > 0.0, size_px, 4.0)
    return np.asarray(ABOVE_BOUND * np.exp(np.interp(np.log(size), np.log(SIZES_PX), np.log(known))))


def _bound(noise: NoiseModel, size_px: float) -> float:
    half = int(np.ceil(0.5 * size_px + 5.0 * BLUR_PX)) + 1
    at = (np.arange(FINE * (2 * half + 1)) + 0.5) / FINE - half - 0.5  # px from the centre
    inside = at[:, None] ** 2 + at[None] ** 2 <= (0.5 * size_px) ** 2
    share = 0.25 * np.pi * size_px**2 / max(inside.sum() / FINE**2, 1e-9)  # of the true area, over the samples'
    light = gaussian_filter(LEVEL * share * inside.astype(float), FINE * BLUR_PX)
    middle = slice(FINE // 2, None, FINE)
    slope = np.gradient(light, 1.0 / FINE, axis=1)[middle, middle]
    variance = noise.variance_at(GROUND + light[middle, middle])
    information = float((slope**2 / variance).sum())
    wide = float(noise.widening(float(np.hypot(BLUR_PX, 0.25 * size_px))).max())
    return float(np.sqrt(max(wide, 1e-6) / information))


SpotNoise = Callable[[Array, int], Array]
"""Standard deviation in px of lights of so many px across, on a side (0: left), in their shape."""

ALIKE = "the target looks the same when it is turned, so its lights cannot be named"
NO_TURN = {1: "1 light tells no orientation", 2: "2 lights tell no orientation"}
POINT_STEP_M = 1e-6
Hides = Callable[[RigidTransform, Array], Mask]
"""Which ways are hidden, (m, n, v), from lights (m, n, 3) at poses of the target, in rig axes, to the cameras."""

LEAST_SIGHTS = 4
"""Of a whole pose: fewer leave it open."""
LEAST_LIGHTS = 3
"""Fewer tell a position alone."""
STEEPEST_RAD = 70.0 * DEG
"""A flat light or board is not seen at more than this from square on: a third of its width is left."""
EDGE_PX = 3.0
"""What must lie between a light's outline and the edge of the image."""
LEAST_GAP_PX = 4.0
"""Outlines of two lights nearer than this run into each other: one spot is found of both, or none (rendered discs of
10 and 20 px: no pair of ten at 3 px, eight or nine of ten at 4 px)."""
LEAST_STEP_PX, LEAST_CELLS_PX = 8.0, 2.0
"""Corners of a board nearer than this are not found (rendered: none at 5 px); of markers, so wide is each cell."""
MARKER_CELLS = 8
"""Cells along a marker, its border among them."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Lights:
    """How m poses of n lights are seen by v cameras: uv_px (m, n, v, 2), size_px (m, n, v) across; 0: not known.

    seen (m, n, v): what counts; of a pair a light that both views show, else every sight. why: of each pose, what hides
    most of the others; "" where nothing does.
    """

    uv_px: Array
    size_px: Array
    seen: Mask
    why: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Points:
    """The lights by themselves: xyz_m (m, n, 3) in rig axes, random (m, n, 3, 3) of the spots' noise, slopes
    (m, n, 3, 16 v - 6): d point / d rig. NaN where a light is not seen in two views."""

    xyz_m: Array
    random: Array
    slopes: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Expected:
    """The expected errors of the measured pose at m places, in the rig's axes: translation, then rotation vector.

    whole (m,): position and orientation; placed (m,): position at least, else `why`. random (m, 6, 6): of one frame's
    spots. slopes (m, 6, p): d pose / d what is the same in every frame, in the order of Setup.covariance: the rig's
    parameters, then the places of the target's lights. NaN where there is no such thing. seen: see Lights.
    """

    T_rig_target: RigidTransform
    whole: Mask
    placed: Mask
    why: tuple[str, ...]
    random: Array
    slopes: Array
    points: Points
    seen: Mask

    def take(self, index: NDArray[np.intp]) -> Expected:
        """Return some of the places."""
        return Expected(
            T_rig_target=self.T_rig_target[index],
            whole=self.whole[index],
            placed=self.placed[index],
            why=tuple(self.why[i] for i in index.tolist()),
            random=self.random[index],
            slopes=self.slopes[index],
            seen=self.seen[index],
            points=Points(
                xyz_m=self.points.xyz_m[index],
                random=self.points.random[index],
                slopes=self.points.slopes[index],
            ),
        )


def expected_poses(
    setup: Setup, T_rig_target: RigidTransform, noise: SpotNoise, *, least_px: float, hides: Hides | None = None
) -> Expected:
    """Return what the setup measures of its target at poses; least_px: lights smaller than this are not found.

    hides: tells which of the ways from lights to cameras something before them hides.
    """
    rig, target = setup.rig, setup.target
    lights = look(rig, target, T_rig_target, least_px, hides)
    m, n, v = lights.seen.shape
    sigma = np.stack([noise(lights.size_px[..., side], side) for side in range(v)], axis=2)  # (m, n, v)
    points = _points(target, T_rig_target)
    J, D = (np.where(lights.seen[..., None, None], each, 0.0) for each in _slopes(rig, points))
    whole, placed, why = np.zeros(m, bool), np.zeros(m, bool), list(lights.why)
    random = np.full((m, 6, 6), np.nan)
    slopes = np.full((m, 6, len(rig.parameters) + 3 * n), np.nan)
    many, R = n >= LEAST_LIGHTS, T_rig_target.rotation.as_matrix()
    alike = many and not target.is_board and bool(symmetries(target))
    for i in np.flatnonzero(_enough(lights.seen)).tolist():
        seen = np.flatnonzero(lights.seen[i].any(axis=1))
        W = np.where(lights.seen[i, seen], 1.0 / sigma[i, seen] ** 2, 0.0)[..., None] * np.ones(2)  # (k, v, 2)
        at = Linear(J=J[i, seen], D=D[i, seen], W=W, R=R[i], X=target.xyz_m[seen], index=seen, n=n)
        pose = _solved(setup, lights, i, seen, sigma[i, seen], T_rig_target[i]) if many and not alike else None
        if pose is not None and pose.status is PoseStatus.OK:
            whole[i], placed[i], why[i] = True, True, ""
            bound, slopes[i] = at.pose()
            random[i] = _widened(pose, bound)
            continue
        why[i] = ALIKE if alike else pose.why if pose is not None else NO_TURN[n]
        placed[i] = (pose is None or pose.status is not PoseStatus.LOST) and lights.seen[i, seen].sum(axis=1).min() > 1
        if placed[i]:
            random[i, :3, :3], slopes[i, :3] = at.points()
    if target.covariance is None:
        slopes = slopes[:, :, : len(rig.parameters)]
    return Expected(
        T_rig_target=T_rig_target,
        whole=whole,
        placed=placed,
        why=tuple(why),
        random=random,
        slopes=slopes,
        points=_alone(points, lights.seen, J, D, sigma),
        seen=lights.seen,
    )


def _enough(seen: Mask) -> Mask:
    """Return at which places there are sights enough for a pose, or of one or two lights a position."""
    n = seen.shape[1]
    lights = seen.any(axis=2).sum(axis=1) >= min(n, LEAST_LIGHTS)
    return np.asarray(lights & (seen.sum(axis=(1, 2)) >= (LEAST_SIGHTS if n >= LEAST_LIGHTS else 2 * n)))


def _alone(points: Array, sights: Mask, J: Array, D: Array, sigma: Array) -> Points:
    """Return what each light by itself is placed to."""
    seen = sights.sum(axis=2) >= 2
    random = np.full((*seen.shape, 3, 3), np.nan)
    slopes = np.full((*seen.shape, 3, D.shape[-1]), np.nan)
    JW = J[seen] / sigma[seen][..., None, None] ** 2  # (k, 2, 2, 3)
    random[seen] = np.linalg.inv(np.einsum("ksia,ksib->kab", JW, J[seen]))
    slopes[seen] = -random[seen] @ np.einsum("ksia,ksip->kap", JW, D[seen])
    return Points(xyz_m=points, random=random, slopes=slopes)


def look(rig: Rig, target: Target, T_rig_target: RigidTransform, least_px: float, hides: Hides | None = None) -> Lights:
    """Return which lights the cameras see at m poses."""
    points = _points(target, T_rig_target)
    m, n, _ = points.shape
    uv = _pixels(rig, points)
    facing = T_rig_target.rotation.as_matrix()[:, :, 2]  # away from the cameras, as of printed boards
    hidden: list[tuple[str, Mask]] = []
    size, seen = np.zeros((m, n, len(rig.names))), np.zeros((m, n, len(rig.names)), bool)
    behind_arm = hides(T_rig_target, points) if hides is not None else None
    for s, side in enumerate(rig.names):
        before = len(hidden)
        camera, T = rig.camera(side), rig.T_rig_camera(side)
        way = points - np.asarray(T.translation)
        distance = np.linalg.norm(way, axis=2)
        behind = ~np.isfinite(uv[:, :, s]).all(axis=2) | ((way @ T.rotation.as_matrix()[:, 2]) <= 0.0)
        if target.diameter_m and not target.is_board:
            size[..., s] = np.where(behind, 0.0, camera.intrinsics[0] * target.diameter_m / distance)
        edge = 0.5 * size[..., s, None] + EDGE_PX
        high = np.array([camera.width, camera.height]) - 1.0
        outside = ((uv[:, :, s] < edge) | (uv[:, :, s] > high - edge)).any(axis=2)
        hidden += [(f"behind the {side} camera", behind), (f"outside the {side} image", outside & ~behind)]
        if target.is_board or target.diameter_m:
            steep = np.einsum("mnj,mj->mn", way, facing) < np.cos(STEEPEST_RAD) * distance
            hidden.append((f"turned away from the {side} camera", steep & ~behind & ~outside))
        small = (size[..., s] > 0.0) & (size[..., s] < least_px)
        hidden.append((f"a light is smaller than {least_px:g} px in the {side} image", small & ~behind & ~outside))
        near = _gaps(uv[:, :, s], size[..., s]) < _least_gap(target)
        what = "corners of the board are too close together" if target.is_board else "lights run into each other"
        hidden.append((f"{what} in the {side} image", near & ~behind & ~outside & ~small))
        if behind_arm is not None:
            hidden.append((f"the arm is before the {side} camera", behind_arm[..., s] & ~behind & ~outside))
        seen[..., s] = ~np.logical_or.reduce([mask for _, mask in hidden[before:]])
    if rig.is_pair:
        seen &= seen.all(axis=2, keepdims=True)
    if target.is_board:  # a board counts as a whole
        seen &= seen.all(axis=1, keepdims=True)
    counts = np.array([mask.sum(axis=1) for _, mask in hidden])  # (reasons, m)
    most = counts.argmax(axis=0)
    why = tuple(hidden[k][0] if counts[k, i] else "" for i, k in enumerate(most.tolist()))
    return Lights(uv_px=uv, size_px=size, seen=seen, why=why)


def _gaps(uv: Array, size_px: Array) -> Array:
    """Return what lies between each light's outline and its nearest neighbour's, (m, n) px: uv (m, n, 2) of a side."""
    out = np.full(size_px.shape, np.inf)
    for i, (at, size) in enumerate(zip(uv, size_px, strict=True)):
        gap = np.linalg.norm(at[:, None] - at, axis=2) - 0.5 * (size[:, None] + size)
        np.fill_diagonal(gap, np.inf)
        out[i] = np.nan_to_num(gap, nan=np.inf).min(axis=1)
    return out


def _least_gap(target: Target) -> float:
    """Return how far apart a target's points must look, px, so that each is found by itself."""
    if not target.is_board:
        return LEAST_GAP_PX
    if not target.marker_m:
        return LEAST_STEP_PX
    # the nearest points of a marker board are a square, or a gap between two tags, apart
    step_m = float(pdist(target.xyz_m).min())
    return max(LEAST_STEP_PX, LEAST_CELLS_PX * MARKER_CELLS * step_m / target.marker_m)


def _solved(
    setup: Setup, lights: Lights, i: int, seen: NDArray[np.intp], sigma: Array, T: RigidTransform
) -> TargetPose:
    """Return the pose that the product gives of these lights, seen without noise; of other rigs than pairs, where one
    view alone may show a light, found from where they are."""
    model, sights = setup.model, lights.seen[i, seen]
    names = tuple(model.names[j] for j in seen.tolist())
    spots = NamedSpots(
        names=names,
        xyz_m=np.ascontiguousarray(model.xyz_m[seen]),
        uv_px=np.where(sights[..., None], lights.uv_px[i, seen], 0.0),
        cov_px2=np.where(sights[..., None, None], sigma[..., None, None] ** 2 * np.eye(2), np.inf),
        radius_m=np.zeros(sights.shape),
        normal=model.normal,
    )
    carried = setup.covariance_of(names)
    start, slack_px = UNKNOWN if sights.shape[1] == TWO else T.as_matrix(), setup.slack_px
    return solve_pose(setup.packed, 0.0, spots, limit=np.inf, slack_px=slack_px, covariance=carried, start=start).pose


def _widened(pose: TargetPose, bound: Array) -> Array:
    """Return the spots' part of the covariance (6, 6) that the product states: wider than the bound where a tilt to the
    other side of the line of sight fits nearly as well."""
    if pose.covariance is None:
        return bound
    own = pose.covariance if pose.systematic_covariance is None else pose.covariance - pose.systematic_covariance
    return own if np.trace(own[3:, 3:]) > FOLDED_FROM * np.trace(bound[3:, 3:]) else bound


def _points(target: Target, poses: RigidTransform) -> Array:
    """Return the lights (m, n, 3) in rig axes."""
    R, t = poses.rotation.as_matrix(), np.asarray(poses.translation)
    return np.asarray(np.einsum("mij,nj->mni", R, target.xyz_m) + t[:, None])


def _pixels(rig: Rig, points: Array) -> Array:
    """Return the pixels (m, n, v, 2) of points (m, n, 3) as [.., camera, (u, v)]."""
    return np.stack([uv.reshape(*points.shape[:2], 2) for uv in rig.project(points.reshape(-1, 3))], axis=2)


def _slopes(rig: Rig, points: Array) -> tuple[Array, Array]:
    """Return d pixels / d point (m, n, v, 2, 3) and d pixels / d rig.parameters (m, n, v, 2, 16 v - 6)."""
    J = [(_pixels(rig, points + h) - _pixels(rig, points - h)) / (2.0 * POINT_STEP_M) for h in POINT_STEP_M * np.eye(3)]
    D, v = [], len(rig.names)
    for i, name in enumerate(rig.parameters):
        if name.endswith(f".{EMPTY_PLACE}"):  # an empty place, which nothing follows
            D.append(np.zeros((*points.shape[:2], v, 2)))
            continue
        step = np.zeros(len(rig.parameters))
        step[i] = difference_step(name)
        plus, minus = (_pixels(moved_rig(rig, sign * step), points) for sign in (1.0, -1.0))
        D.append((plus - minus) / (2.0 * step[i]))
    return np.stack(J, axis=-1), np.stack(D, axis=-1)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Linear:
    """One place: of the k lights seen d pixel / d point J (k, v, 2, 3), d pixel / d rig D (k, v, 2, q), the weights W
    (k, v, 2), their places X (k, 3) in target axes and their index among all n; R (3, 3) of T_rig_target."""

    J: Array
    D: Array
    W: Array
    R: Array
    X: Array
    index: NDArray[np.intp]
    n: int

    def pose(self) -> tuple[Array, Array]:
        """Return C (6, 6) of the spots' noise, and A (6, q + 3 n) = -C G' W D."""
        # t + dt, Exp(dw) R: d point = dt + dw x R X, and R d X of the target's own places
        G = np.concatenate([self.J, self.J @ -skew(self.X @ self.R.T)[:, None]], axis=-1)  # (k, v, 2, 6)
        GW = G * self.W[..., None]
        C = np.linalg.inv(np.einsum("ksia,ksib->ab", GW, G))
        of_rig = -C @ np.einsum("ksia,ksip->ap", GW, self.D)
        of_lights = -C @ np.einsum("ksia,ksij->kaj", GW, self.J @ self.R)  # (k, 6, 3)
        return C, np.concatenate([of_rig, self._spread(of_lights)], axis=1)

    def points(self) -> tuple[Array, Array]:
        """Return the same (3, .) of the mean of the points by themselves: what is left without an orientation."""
        JW = self.J * self.W[..., None]
        S = np.linalg.inv(np.einsum("ksia,ksib->kab", JW, self.J))
        of_rig = -(S @ np.einsum("ksia,ksip->kap", JW, self.D)).mean(axis=0)
        k = len(S)
        # the mean of the lights stands where they are, not where they are said to be
        of_lights = np.tile(-self.R / k, (k, 1, 1))
        return S.sum(axis=0) / k**2, np.concatenate([of_rig, self._spread(of_lights)], axis=1)

    def _spread(self, of_seen: Array) -> Array:
        """Return slopes (a, 3 n) by all lights from those (k, a, 3) of the lights seen."""
        out = np.zeros((of_seen.shape[1], self.n, 3))
        out[:, self.index] = of_seen.transpose(1, 0, 2)
        return out.reshape(len(out), -1)
