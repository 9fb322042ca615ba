"""One joint's path: circle or line by maximum likelihood, and which of the two by the chi-square test of MATH 4.3."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc, chdtri

from armsight.arrays import Array
from armsight.calibrate.identify.kernels import arc_positions
from armsight.calibrate.identify.sweeps import SweepResiduals
from armsight.columns import POSITION
from armsight.errors import NotConverged
from armsight.fitting import Evaluation, Fit, Loss, LossKind, Problem, Settings, solve
from armsight.geometry.poses import skew
from armsight.records import NamedCovariance

Start = tuple[float, Array, Array, float]

SWUNG = 8
"""Normals tried, swung about the chord: with a short arc the plane fit may be anywhere about it (MATH 4.3)."""
RARE = 1e-6
GROSS = float(np.sqrt(chdtri(3, RARE)))
"""Readings beyond so many standard deviations are discarded."""


def gross(seen: SweepResiduals) -> Array:
    """Return beyond how many standard deviations each reading (m,) is discarded: more of one that more cameras saw."""
    if seen.rig is None:
        return np.full(len(seen.sweeps), GROSS)
    return np.asarray(np.sqrt(chdtri(np.maximum(seen.counts - 1, 1), RARE)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PathFit:
    """A circle (kind 'circle') or a line, fitted to the readings of one joint.

    point_m: the circle's centre, or a point of the line. direction: the axis, its sense by the commanded values.
    radius_m: 0 of a line. phase (N,): where on it the readings are (rad or m). chi2, dof: of the readings kept.
    residual (N, rows): whitened. cost: half the robust sum of squares. names, covariance: of CIRCLE, about the basis of
    the direction, or of LINE; None where the readings leave it open.
    """

    kind: str
    point_m: Array
    direction: Array
    radius_m: float
    phase: Array
    chi2: float
    dof: int
    residual: Array
    cost: float
    names: tuple[str, ...]
    covariance: NamedCovariance | None

    @property
    def p(self) -> float:
        """Probability that noise alone leaves as much."""
        return float(chdtrc(max(self.dof, 1), self.chi2))

    def nearest(self, xyz_m: Array) -> Array:
        """Return the positions (N, 3) on the path that are nearest to xyz_m (N, 3)."""
        away = xyz_m - self.point_m
        along = np.outer(away @ self.direction, self.direction)
        if self.kind == "line":
            return np.asarray(self.point_m + along)
        across = away - along
        size = np.maximum(np.linalg.norm(across, axis=1), 1e-12)[:, None]
        return np.asarray(self.point_m + self.radius_m * across / size)

    def tangent(self, at_m: Array) -> Array:
        """Return the direction (3,) of the path at a position (3,) on it."""
        if self.kind == "line":
            return self.direction
        return np.asarray(np.cross(self.direction, at_m - self.point_m) / self.radius_m)


def fit_line(seen: SweepResiduals, order: Array) -> PathFit:
    """Return the line of greatest likelihood. order (N,): the commanded values, of which only the sense is used."""
    xyz = seen.sweeps.xyz_m
    middle = xyz.mean(axis=0)
    direction = np.linalg.svd(xyz - middle)[2][0]
    direction = direction * _sense((xyz - middle) @ direction, order)
    B = basis(direction)

    def evaluate(p: Array, t: Array) -> Evaluation:
        X, J, Jt = line(B, middle, p, t[:, 0])
        return _evaluation(seen, X, J, Jt)

    problem = Problem(
        names=LINE,
        guess=np.zeros(4),
        evaluate=evaluate,
        n_residuals=seen.rows * len(xyz),
        local_names=("t_m",),
        local_guess=((xyz - middle) @ direction)[:, None],
        loss=_loss(seen),
    )
    fit = solve(problem, ROUGH)
    d, _ = tilted(B, fit.shared[2:])
    point, t = middle + B[:, :2] @ fit.shared[:2], fit.local[:, 0]
    sense = _sense(t, order)
    return _path("line", seen, fit, point, sense * d, 0.0, sense * t, fit.covariance)


def fit_circle(
    seen: SweepResiduals, order: Array, *, starts: Sequence[Start] | None = None, coarse: bool = False
) -> PathFit:
    """Return the circle of greatest likelihood; started from the plane fit and from normals swung about the chord.

    starts: circle_starts, where they are there already. coarse: a thousandth of the cost is enough.
    """
    best: PathFit | None = None
    for _, normal, centre, radius in circle_starts(seen) if starts is None else starts:
        found = _settled(seen, normal, centre, radius, order, coarse=coarse)
        if found is None:
            continue
        if best is None or found.cost < best.cost:
            best = found
        if found.p > 1e-3:  # good enough not to try another start
            break
    if best is None:
        raise NotConverged("no circle fits the readings", cure="Take readings over a longer arc")
    return best


def _settled(
    seen: SweepResiduals, n: Array, centre: Array, radius: float, order: Array, *, coarse: bool
) -> PathFit | None:
    """Return the circle from one start, settled roughly where it will not settle finely, None where it does neither."""
    for settings in (ROUGH,) if coarse else (SETTINGS, ROUGH):
        try:
            return _circle_from(seen, n, centre, radius, order, settings)
        except NotConverged:
            continue
    return None


def line_misfit(seen: SweepResiduals) -> float:
    """Return chi-square of the line a fit would start from."""
    xyz = seen.sweeps.xyz_m
    middle = xyz.mean(axis=0)
    direction = np.linalg.svd(xyz - middle)[2][0]
    r, _ = seen.residuals(middle + np.outer((xyz - middle) @ direction, direction), np.zeros((len(xyz), 3, 1)))
    return float((r**2).sum())


def circle_starts(seen: SweepResiduals) -> list[Start]:
    """Return chi-square, normal, centre, radius of circles with normals swung about the chord, the best first.

    Each is the circle of linear least squares in its plane through the middle, every reading put to its nearest
    position.
    """
    xyz = seen.sweeps.xyz_m
    middle = xyz.mean(axis=0)
    chord, _, normal = np.linalg.svd(xyz - middle)[2]
    angle = np.arange(SWUNG)[:, None] * np.pi / SWUNG
    normals = np.cos(angle) * normal + np.sin(angle) * (skew(chord) @ normal)
    E = np.stack([np.broadcast_to(chord, normals.shape), np.cross(normals, chord)], axis=2)  # (8, 3, 2)
    x = (xyz - middle) @ E
    # |x|^2 = 2 c . x + (r^2 - |c|^2), linear in the centre and one constant (Kasa 1976): too small a circle of a short
    # arc (MATH 4.2), which does for a start
    A = np.concatenate([2.0 * x, np.ones((*x.shape[:2], 1))], axis=2)
    solved = (np.linalg.pinv(A) @ (x**2).sum(axis=2)[:, :, None])[:, :, 0]
    centre, c = solved[:, None, :2], solved[:, 2]
    radius = np.sqrt(np.maximum(c + (centre[:, 0] ** 2).sum(axis=1), 1e-12))
    away = x - centre
    nearest = centre + radius[:, None, None] * away / np.maximum(np.linalg.norm(away, axis=2), 1e-12)[:, :, None]
    positions, centres = middle + nearest @ E.transpose(0, 2, 1), middle + (centre @ E.transpose(0, 2, 1))[:, 0]
    out, still = [], np.zeros((len(xyz), 3, 1))
    for k in range(SWUNG):
        r, _ = seen.residuals(positions[k], still)
        size = float((r**2).sum())
        out.append((size if np.isfinite(size) else np.inf, normals[k], centres[k], float(radius[k])))
    return sorted(out, key=lambda start: start[0])


def _circle_from(
    seen: SweepResiduals, n: Array, centre: Array, radius: float, order: Array, settings: Settings
) -> PathFit:
    xyz = seen.sweeps.xyz_m
    index = np.argsort(order)
    # the tangent is taken at the middle reading, where a short arc knows it best
    point = xyz[index[len(index) // 2]] - centre
    point = point - (point @ n) * n
    point *= radius / max(float(np.linalg.norm(point)), 1e-12)
    tangent = skew(n) @ point / radius
    B, middle = basis(tangent), centre + point
    phi = np.arctan2((xyz - centre) @ tangent, (xyz - centre) @ point / radius)

    def evaluate(p: Array, s: Array) -> Evaluation:
        X, J, Js = arc(B, middle, p, s[:, 0])
        return _evaluation(seen, X, J, Js)

    problem = Problem(
        names=ARC,
        guess=np.array([0.0, 0.0, 0.0, 0.0, *(-B[:, :2].T @ point / radius**2)]),
        evaluate=evaluate,
        n_residuals=seen.rows * len(xyz),
        local_names=("s_m",),
        local_guess=radius * phi[:, None],
        loss=_loss(seen),
    )
    fit = solve(problem, settings)
    centre, axis, radius, D = circle_of(B, middle, fit.shared)
    phase = np.unwrap(fit.local[index, 0] / radius)
    sense = 1.0 if phase[-1] >= phase[0] else -1.0
    back = np.empty(len(phase))
    back[index] = phase
    covariance = None
    if fit.covariance is not None and fit.covariance.names == ARC:
        D[3:5] = basis(sense * axis)[:, :2].T @ basis(axis)[:, :2] @ D[3:5] * sense
        covariance = NamedCovariance(names=CIRCLE, matrix=D @ fit.covariance.matrix @ D.T)
    return _path("circle", seen, fit, centre, sense * axis, radius, sense * back, covariance)


ROUGH = Settings(max_iterations=200, allow_undetermined=True, cost_tolerance=1e-3, step_tolerance=1e-4)
"""For a line far from fitting, where it does not matter how far, and for a centre that the noise leaves open."""
SETTINGS = Settings(max_iterations=100, allow_undetermined=True, cost_tolerance=1e-6, step_tolerance=1e-6)
"""For the circle: a short arc leaves its centre in a valley; a millionth of the cost is enough."""


def _loss(seen: SweepResiduals) -> Loss:
    return Loss(kind=LossKind.HUBER, scale=float(np.sqrt(chdtri(seen.rows, 1e-3))), block=seen.rows)


def _evaluation(seen: SweepResiduals, X: Array, J: Array, Jt: Array) -> Evaluation:
    r, slopes = seen.residuals(X, np.concatenate([J, Jt[:, :, None]], axis=2))
    return Evaluation(residuals=r, shared=slopes[:, :, :-1], local=slopes[:, :, -1:])


def _path(
    kind: str,
    seen: SweepResiduals,
    fit: Fit,
    point: Array,
    direction: Array,
    radius: float,
    phase: Array,
    covariance: NamedCovariance | None,
) -> PathFit:
    r, names = fit.residuals, CIRCLE if kind == "circle" else LINE
    return PathFit(
        kind=kind,
        point_m=point,
        direction=direction,
        radius_m=radius,
        phase=phase,
        chi2=float((r**2).sum()),
        # a phase a reading is fitted too: of four pixel coordinates 3 N - 6 are left of a circle, 3 N - 4 of a line
        # (MATH 4.3)
        dof=r.size - seen.n_unseen - len(names) - len(r),
        residual=r,
        cost=fit.cost,
        names=names,
        covariance=covariance,
    )


def _sense(t: Array, order: Array) -> float:
    return 1.0 if np.dot(t - t.mean(), order - order.mean()) >= 0.0 else -1.0


# Arc and line as functions of their parameters and of where on them a reading is, with derivatives.


def basis(direction: Array) -> Array:
    """Return an orthonormal basis (3, 3) in columns whose third is the direction."""
    z = direction / np.linalg.norm(direction)
    x = np.eye(3)[int(np.argmin(np.abs(z)))]
    x = x - (x @ z) * z
    x /= np.linalg.norm(x)
    return np.stack([x, skew(z) @ x, z], axis=1)


def tilted(B: Array, uv: Array) -> tuple[Array, Array]:
    """Return the direction (3,) near B's third column, normalise(B (u, v, 1)), and its derivative (3, 2) by (u, v)."""
    b = B @ np.array([uv[0], uv[1], 1.0])
    size = np.linalg.norm(b)
    n = b / size
    return n, (B[:, :2] - np.outer(n, n @ B[:, :2])) / size


CIRCLE = (*POSITION, "tilt_u", "tilt_v", "radius_m")
ARC = ("u_m", "v_m", "tilt_u", "tilt_v", "bend_u_1_m", "bend_v_1_m")
STRAIGHT = 1e-5
"""Curvature (1/m) below which an arc is as good as straight."""
LINE = ("u_m", "v_m", "tilt_u", "tilt_v")


def arc(B: Array, middle: Array, p: Array, s: Array) -> tuple[Array, Array, Array]:
    """Return positions (N, 3) at arc lengths s, derivative (N, 3, 6) by ARC, and (N, 3) by s (kernels.arc_positions).

    A circle told by a point, its tangent there and its curvature: what a short arc knows well. By centre and radius,
    which it hardly knows, a fit creeps along a curved valley.
    """
    n = len(s)
    X, J, Js = np.empty((n, 3)), np.empty((n, 3, 6)), np.empty((n, 3))
    arc_positions(B, middle, np.array(p), np.array(s), X, J, Js)
    return X, J, Js


def circle_of(B: Array, middle: Array, p: Array) -> tuple[Array, Array, float, Array]:
    """Return centre (3,), axis (3,), radius of an arc, and the derivative (6, 6) of CIRCLE by ARC.

    The axis turns the tangent towards the centre; its tilts are along basis(axis). STRAIGHT bounds the radius.
    """
    t, dt = tilted(B, p[2:4])
    across = B[:, :2]
    g = across @ p[4:6]
    # the curvature vector across the tangent: the centre is c / |c|^2 away, the radius 1 / |c|, the axis t x c / |c|
    c = g - (g @ t) * t
    dc = np.zeros((3, 6))
    dc[:, 2:4] = -np.outer(t, g @ dt) - (g @ t) * dt
    dc[:, 4:6] = across - np.outer(t, across.T @ t)
    full = np.zeros((3, 6))
    full[:, 2:4] = dt
    bend = max(float(np.linalg.norm(c)), STRAIGHT)
    stretch = c @ dc / bend
    axis = np.cross(t, c) / bend
    daxis = (np.cross(full, c, axis=0) + np.cross(t, dc, axisb=0).T) / bend - np.outer(axis, stretch) / bend
    D = np.empty((6, 6))
    D[:3] = dc / bend**2 - 2.0 * np.outer(c, stretch) / bend**3
    D[:3, :2] += across
    D[3:5] = basis(axis)[:, :2].T @ daxis
    D[5] = -stretch / bend**2
    return middle + across @ p[:2] + c / bend**2, axis, 1.0 / bend, D


def line(B: Array, middle: Array, p: Array, t: Array) -> tuple[Array, Array, Array]:
    """Return positions (N, 3) at t along the line, derivative (N, 3, 4) by LINE, and (N, 3) by t.

    The line goes through middle + B (u, v, 0) along the tilted direction.
    """
    d, dd = tilted(B, p[2:4])
    J = np.empty((len(t), 3, 4))
    J[:, :, :2] = B[:, :2]
    J[:, :, 2:] = t[:, None, None] * dd
    return middle + B[:, :2] @ p[:2] + np.outer(t, d), J, np.tile(d, (len(t), 1))
