"""Delays, drifts and read-outs by least squares, with the paths of the lights, quintic splines, eliminated."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import scipy  # loads its interpolation, a tenth of a second, where it is used: every measurement imports this
from numpy.typing import NDArray
from scipy.linalg import cho_solve_banded, cholesky_banded

from armsight.arrays import Array
from armsight.calibrate.timing.views import Views
from armsight.errors import Inconsistent
from armsight.fitting import Evaluation, Fit, Prior, Problem, Settings, solve
from armsight.fitting.kernels import add_rows, add_transposed_times, rows_times

PPM = 1e-6
JERK_M_S3 = 3e3
"""Standard deviation of the jerk that ties a path together where no camera sees it: a hand waves with 10 to 500."""
RIGID_M = 1e-5
"""How well the distances of a target's lights are held: 0.01 px at 1 m."""
DRIFT_PPM = 1000.0
DISTANCE_M = 0.3
"""Standard deviations known beforehand: of clocks, and of the lights' distances where nothing is known of them."""
RIGID_ROUNDS = 2
SPACINGS = (4.0, 3.0, 2.5, 2.0, 1.5, 1.2, 1.0)
"""Grids tried, in periods of the slower camera."""
PROBES = 8
"""Random vectors for a trace: known to a hundredth with a thousand views."""
MARGIN_S = 0.1
"""By which the grid reaches beyond the time that both cameras saw."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PathFit:
    """The paths' best coefficients (size,) at given times, with what led there."""

    c: Array
    band: Band
    parts: tuple[Rows, ...]
    residuals: tuple[Array, ...]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PathModel:
    """Views on a grid. mid_s (V,): each camera's stamp at which its delay is taken. depth (m,): of each view, nearly.

    x (3 V - 2 + p + k,): of every camera but the first delay_s and drift_ppm, of every one readout_s, then the lights'
    distances, and how far the rig is off in its deviations. c (size,): paths that are near, about which rigid distances
    are taken as linear. together: of so many spots, whose errors hang together, one is new.
    """

    views: Views
    grid: Grid
    mid_s: Array
    depth: Array
    c: Array
    together: float = 1.0

    @property
    def n_times(self) -> int:
        """How many numbers of x are times."""
        return 3 * len(self.mid_s) - 2

    @property
    def size(self) -> int:
        """Number of coefficients."""
        return self.grid.n_coefficients * self.n_lights * 3

    @property
    def n_lights(self) -> int:
        """Number of lights."""
        return len(self.views.names)

    def times_s(self, x: Array) -> tuple[Array, Array]:
        """Return when each view was exposed (m,) by the first camera's clock, and its derivatives (m, 3 V - 2)."""
        v, n = self.views, self.n_times
        # a line was exposed at stamp + readout line, but for the first camera + delay + drift (stamp - mid): linear, as
        # J says
        J = np.zeros((len(v), n))
        rows, others = np.arange(len(v)), np.flatnonzero(v.side)
        J[others, 2 * v.side[others] - 2] = 1.0
        J[others, 2 * v.side[others] - 1] = PPM * (v.stamp_s[others] - self.mid_s[v.side[others]])
        J[rows, n - len(self.mid_s) + v.side] = v.line
        return v.stamp_s + J @ x[:n], J

    def seen(self, t_s: Array, x: Array, derivative: int = 0) -> Rows:
        """Return the equations (2 m,) of all views, or their derivatives by time."""
        first, weight = self.grid.basis(t_s, derivative)
        columns = self._columns(first, self.views.light)  # (m, 18)
        A, b = self.views.equations(x[self.n_times + len(self.views.pairs) :])
        A = A / self.depth[:, None, None]
        values = np.einsum("mj,mrk->mrjk", weight, A).reshape(-1, ORDER * 3)
        return Rows(
            columns=np.repeat(columns, 2, axis=0),
            values=values,
            right=(b / self.depth[:, None]).ravel(),
        )

    def smooth(self) -> Rows:
        """Return the equations that hold the jerk within what a hand can do."""
        first, weight = self.grid.basis(self.grid.middles, 3)
        columns = np.concatenate([self._columns(first, np.full(len(first), i)) for i in range(self.n_lights)])
        n = len(columns)
        values = np.zeros((n, 3, ORDER, 3))
        for k in range(3):
            values[:, k, :, k] = np.tile(weight, (self.n_lights, 1)) / JERK_M_S3
        return Rows(columns=np.repeat(columns, 3, axis=0), values=values.reshape(-1, ORDER * 3), right=np.zeros(3 * n))

    def rigid(self, c: Array, distances: Array) -> Rows:
        """Return the equations that hold the lights' distances (p,), linear about paths c."""
        first, weight = self.grid.basis(self.grid.middles)
        columns, values = [], []
        for a, b in self.views.pairs:
            both = np.stack(
                [self._columns(first, np.full(len(first), i)).reshape(-1, ORDER, 3) for i in (a, b)], axis=2
            )
            apart = np.einsum("mj,mjk->mk", weight, c[both[:, :, 1]] - c[both[:, :, 0]])
            # |x_b - x_a| = distance, linear about the paths so far: n . (x_b - x_a) = distance along the unit vector n
            n = apart / np.maximum(np.linalg.norm(apart, axis=1, keepdims=True), 1e-9)
            each = np.einsum("mj,s,mk->mjsk", weight, [-1.0, 1.0], n) / RIGID_M
            columns.append(both.reshape(len(first), -1))
            values.append(each.reshape(len(first), -1))
        return Rows(
            columns=np.concatenate(columns),
            values=np.concatenate(values),
            right=np.repeat(distances, len(first)) / RIGID_M,
        )

    def points(self, t_s: Array, c: Array) -> Array:
        """Return where the light of each view was (m, 3) on paths c."""
        first, weight = self.grid.basis(t_s)
        at = c[self._columns(first, self.views.light)].reshape(-1, ORDER, 3)
        return np.asarray(np.einsum("mj,mjk->mk", weight, at))

    def _columns(self, first: NDArray[np.intp], light: NDArray[np.intp]) -> NDArray[np.intp]:
        """Return the unknowns (m, 18) of the lights' coordinates from their first coefficients on."""
        start = ((first[:, None] + np.arange(ORDER)) * self.n_lights + light[:, None]) * 3  # (m, 6)
        return np.asarray((start[:, :, None] + np.arange(3)).reshape(len(first), -1))

    def fit_paths(self, x: Array) -> PathFit:
        """Return the paths for x."""
        t, _ = self.times_s(x)
        fixed = (self.seen(t, x), self.smooth())
        c, width = self.c, ORDER * self.n_lights * 3 - 1
        parts: tuple[Rows, ...] = fixed
        if not len(self.views.pairs):
            band = Band(parts, self.size, width)
            c = band.solution()
        else:
            for _ in range(RIGID_ROUNDS):
                parts = (*fixed, self.rigid(c, x[self.n_times :][: len(self.views.pairs)]))
                band = Band(parts, self.size, width)
                c = band.solution()
        residuals = tuple(times(rows, c[:, None])[:, 0] - rows.right for rows in parts)
        return PathFit(c=c, band=band, parts=parts, residuals=residuals)

    def evaluate(self, x: Array, local: Array) -> Evaluation:
        """Return residuals and derivatives by x, both with the paths eliminated (variable projection)."""
        del local
        n_seen, p, n = 2 * len(self.views), len(self.views.pairs), self.n_times
        k = self.views.doubt.size
        t, Jt = self.times_s(x)
        if not self.grid.inside(t):
            nothing = np.full((1, n_seen), np.nan)
            return Evaluation(
                residuals=nothing, shared=np.zeros((1, n_seen, n + p + k)), local=np.zeros((1, n_seen, 0))
            )
        paths = self.fit_paths(x)
        # a view of another moment is of another point of the path: the residual moves with the path's speed
        speed = times(self.seen(t, x, 1), paths.c[:, None])  # (2 m, 1)
        J = [np.zeros((len(r), n + p + k)) for r in paths.residuals]
        J[0][:, :n] = speed * np.repeat(Jt, 2, axis=0)
        if k:
            J[0][:, n + p :] = (self.views.by_doubt(self.points(t, paths.c)) / self.depth[:, None, None]).reshape(-1, k)
        if p:
            cells = self.grid.n_cells
            for i in range(p):
                J[2][i * cells : (i + 1) * cells, n + i] = -1.0 / RIGID_M
        # Variable projection (Golub, Pereyra 1973): of each derivative only what the paths' coefficients cannot make is
        # left. The term by the residuals is dropped (Kaufman 1975), which leaves the minimum where it is
        pull = paths.band.solve(transposed_times(paths.parts, J, self.size))
        J = [own - times(rows, pull) for own, rows in zip(J, paths.parts, strict=True)]
        shared, residuals = np.concatenate(J)[None], np.concatenate(paths.residuals)[None]
        if self.together != 1.0:
            shared, residuals = shared / np.sqrt(self.together), residuals / np.sqrt(self.together)
        return Evaluation(residuals=residuals, shared=shared, local=np.zeros((1, shared.shape[1], 0)))

    @property
    def dof(self) -> int:
        """Number of equations less that of coefficients."""
        return 2 * len(self.views) + len(self.views.pairs) * self.grid.n_cells - self.size

    def scale(self, paths: PathFit) -> float:
        """Return the standard deviation of the whitened residuals."""
        return float(np.sqrt(paths.residuals[0] @ paths.residuals[0] / max(self.dof, 1)))

    def side_scales(self, x: Array, *, alike: bool = False) -> Array:
        """Return the same (V,) for the views of each camera alone; alike: one for all.

        Of more than two cameras each has its own degrees of freedom (variance components, Foerstner 1979): paths follow
        the one that sees best and most often, whose residuals would else be taken for too small.
        """
        paths = self.fit_paths(x)
        if alike:
            return np.full(len(self.mid_s), self.scale(paths))
        r = (paths.residuals[0] ** 2).reshape(-1, 2).sum(axis=1)
        if len(self.mid_s) > 2:
            return np.asarray(np.sqrt(np.bincount(self.views.side, r) / np.maximum(self._free_equations(paths), 1.0)))
        share = 2.0 * len(self.views) / max(self.dof, 1)
        return np.array([np.sqrt(share * r[self.views.side == s].mean() / 2.0) for s in range(len(self.mid_s))])

    def _free_equations(self, paths: PathFit) -> Array:
        """Return the equations of each camera (V,) less what they tell of the paths: a trace, by random signs."""
        side, V = np.repeat(self.views.side, 2), len(self.mid_s)
        signs = np.random.default_rng(0).choice([-1.0, 1.0], (len(side), PROBES))
        each = np.concatenate([signs * (side == s)[:, None] for s in range(V)], axis=1)
        none = [np.zeros((len(rows.right), V * PROBES)) for rows in paths.parts[1:]]
        made = times(paths.parts[0], paths.band.solve(transposed_times(paths.parts, [each, *none], self.size)))
        told = (each * made).sum(axis=0).reshape(V, PROBES).mean(axis=1)
        return np.asarray(np.bincount(side, minlength=V) - told, dtype=np.float64)


def build(views: Views, spacing_s: float, mid_s: Array, x: Array, depth: Array) -> PathModel:
    """Return the model on a grid of this spacing, about paths without rigid distances at x."""
    v = views
    p, n = len(v.pairs), 3 * len(mid_s) - 2
    plain = replace(v, pairs=v.pairs[:0])
    clock = np.concatenate([[0.0, 0.0], x[: 2 * len(mid_s) - 2]])
    ends = v.stamp_s + (clock[2 * v.side] + PPM * clock[2 * v.side + 1] * (v.stamp_s - mid_s[v.side]))
    grid = Grid.over(float(ends.min()) - MARGIN_S, float(ends.max()) + MARGIN_S, spacing_s)
    empty = np.zeros(grid.n_coefficients * len(v.names) * 3)
    model = PathModel(views=plain, grid=grid, mid_s=mid_s, depth=depth, c=empty)
    c = model.fit_paths(np.delete(x, slice(n, n + p))).c
    return PathModel(views=v, grid=grid, mid_s=mid_s, depth=depth, c=c)


def depths(model: PathModel, x: Array, names: tuple[str, ...]) -> Array:
    """Return the depth (m,) of each view along the model's paths. names: of the cameras.

    Raises Inconsistent where they lie behind.
    """
    X = model.points(model.times_s(x)[0], model.c)
    depth = np.einsum("mk,mk->m", model.views.depth_row, X) + model.views.depth_off
    middle = float(np.median(depth))
    if not middle > 0.0:
        raise Inconsistent(
            "the lights seem to lie behind the cameras",
            consequence="No timing is given",
            cure=f"Check that {' and '.join(names)} are not swapped, and that rig.yaml is of these cameras",
        )
    return np.asarray(np.clip(depth, 0.2 * middle, 5.0 * middle))


def distances_along(model: PathModel) -> Array:
    """Return the median distances (p,) of the lights along the paths."""
    c = model.c.reshape(-1, model.n_lights, 3)
    return np.array([np.median(np.linalg.norm(c[:, b] - c[:, a], axis=1)) for a, b in model.views.pairs])


def solve_model(model: PathModel, guess: Array, priors: dict[str, Prior], held: Collection[str] = ()) -> Fit:
    """Return the fit of x from a guess. priors: of every number of x, in its order. held: names that stay."""
    problem = Problem(
        names=tuple(priors),
        guess=guess,
        evaluate=model.evaluate,
        n_residuals=model.dof,
        priors=priors,
        fixed=frozenset(held),
    )
    own = model.together == 1.0
    return solve(problem, Settings(estimate_noise=own, cost_tolerance=1e-8, step_tolerance=1e-6))


def best_spacing(views: Views, period_s: float, mid_s: Array, x: Array, depth: Array) -> tuple[float, float]:
    """Return the grid's spacing in s with the least generalised cross-validation error, and the residuals' scale."""
    least, chosen, scale = np.inf, SPACINGS[-1] * period_s, 1.0
    for factor in SPACINGS:
        model = build(views, factor * period_s, mid_s, x, depth)
        n = model.dof + model.size
        if model.dof < 0.1 * n:
            break
        # generalised cross-validation (Craven, Wahba 1979): RSS n / dof^2 is the square of scale over sqrt(dof / n)
        own = model.scale(model.fit_paths(x))
        score = own / np.sqrt(model.dof / n)
        if score < least:
            least, chosen, scale = score, factor * period_s, own
    return chosen, scale


# Paths of lights as quintic B-splines over a uniform grid, found from rays by banded least squares.
#
# With rays given, a path's coefficients are linear: a point X seen along the ray (x, y) of a camera fulfils
# (R1 - x R3) X = x t3 - t1 and the like for y; over the depth this is the reprojection residual in px.

DEGREE = 5
ORDER = DEGREE + 1
RIDGE = 1e-14
"""Of the largest diagonal: keeps rounding from making a coefficient's pivot negative where nothing is seen."""


@cache
def _pieces() -> Array:
    """Return the polynomials (ORDER, ORDER): value of local basis j is sum_k pieces[j, k] u^k, u from 0 to 1."""
    bump = scipy.interpolate.BSpline.basis_element(np.arange(ORDER + 1.0))
    u = np.linspace(0.1, 0.9, ORDER)
    values = np.stack([bump(DEGREE - j + u) for j in range(ORDER)], axis=1)
    return np.ascontiguousarray(np.linalg.solve(np.vander(u, increasing=True), values).T)


@dataclass(frozen=True, slots=True, kw_only=True)
class Grid:
    """When the pieces of the lights' paths begin and end.

    n_cells cells of spacing_s from begin_s on, with n_cells + DEGREE coefficients.
    """

    begin_s: float
    spacing_s: float
    n_cells: int

    @classmethod
    def over(cls, begin_s: float, end_s: float, spacing_s: float) -> Grid:
        """Return the grid that covers a span."""
        return cls(begin_s=begin_s, spacing_s=spacing_s, n_cells=int(np.ceil((end_s - begin_s) / spacing_s)))

    @property
    def n_coefficients(self) -> int:
        """For each coordinate."""
        return self.n_cells + DEGREE

    @property
    def middles(self) -> Array:
        """Middles of the cells in s."""
        return np.asarray(self.begin_s + (np.arange(self.n_cells) + 0.5) * self.spacing_s, dtype=np.float64)

    def inside(self, t_s: Array) -> bool:
        """Tell whether all times lie on it."""
        return bool(((t_s >= self.begin_s) & (t_s <= self.begin_s + self.n_cells * self.spacing_s)).all())

    def basis(self, t_s: Array, derivative: int = 0) -> tuple[NDArray[np.intp], Array]:
        """Return the first coefficient (m,) that counts at each time, and the weights (m, ORDER)."""
        x = (t_s - self.begin_s) / self.spacing_s
        cell = np.clip(np.floor(x).astype(np.intp), 0, self.n_cells - 1)
        u = x - cell
        powers = np.zeros((len(x), ORDER))
        for k in range(derivative, ORDER):
            factor = np.prod(np.arange(k, k - derivative, -1.0)) if derivative else 1.0
            powers[:, k] = factor * u ** (k - derivative)
        return cell, powers @ _pieces().T / self.spacing_s**derivative


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rows:
    """Linear equations values . coefficients = right (m,).

    columns, values (m, k): unknowns that each row touches, ascending.
    """

    columns: NDArray[np.intp]
    values: Array
    right: Array


class Band:
    """Normal equations of rows, factorised; width: how far columns of a row are apart at most."""

    def __init__(self, parts: Sequence[Rows], size: int, width: int) -> None:
        band, self._b = np.zeros((width + 1, size)), np.zeros(size)
        for rows in parts:
            add_rows(rows.columns, rows.values, rows.right, band, self._b)
        band[0] += RIDGE * band[0].max()
        self._factor = cholesky_banded(band, lower=True, check_finite=False)

    def solution(self) -> Array:
        """Return the coefficients (size,)."""
        return self.solve(self._b)

    def solve(self, right: Array) -> Array:
        """Return the solution for right-hand sides (size,) or (size, q)."""
        return np.asarray(cho_solve_banded((self._factor, True), right, check_finite=False))


def times(rows: Rows, x: Array) -> Array:
    """Return the rows times x (size, q): (m, q)."""
    out = np.empty((len(rows.right), x.shape[1]))
    rows_times(rows.columns, rows.values, np.ascontiguousarray(x), out)
    return out


def transposed_times(parts: Sequence[Rows], y: Sequence[Array], size: int) -> Array:
    """Return the transposed rows of all parts times y (m, q) of each: (size, q)."""
    out = np.zeros((size, y[0].shape[1]))
    for rows, each in zip(parts, y, strict=True):
        add_transposed_times(rows.columns, rows.values, np.ascontiguousarray(each), out)
    return out
