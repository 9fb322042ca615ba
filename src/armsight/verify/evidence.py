"""What explains the residuals of a fit: linear models of them (base and tool, joints, links, a rig that moved),
compared on rows left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from armsight.arrays import Array
from armsight.calibrate.arm import ArmModel, Tolerance
from armsight.fitting.groups import inflation, without
from armsight.fitting.quantiles import chi2_sf, t_sf
from armsight.geometry.poses import skew
from armsight.kinematics import Arm, fk_jacobian, parameter_jacobian, parameter_names
from armsight.verify.model import Effect, Expected, Kind, Model, ModelFit, Mounts, Noise, fit_model
from armsight.verify.records import Measured


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Case:
    """An arm (bare: without base and tool), its joints q (m, n), what was measured there, and which parameters of base
    and tool are free; block (m,): rows left out together."""

    bare: Arm
    q: Array
    measured: Measured
    free: tuple[str, ...]
    block: NDArray[np.intp]

    def expected(self, effect: Effect | None) -> Expected:
        """Return the flange's poses as a function of an effect's parameters."""
        basis = np.zeros((len(self.q), 0)) if effect is None else effect.basis

        def expected(p: Array) -> tuple[Array, Array]:
            q = self.q
            if effect is not None:
                q = q.copy()
                q[:, effect.joint] += basis @ p
            F, J = fk_jacobian(self.bare, q)
            turn = J[:, :, 0] if effect is None else J[:, :, effect.joint]
            return F, turn[:, :, None] * basis[:, None, :]

        return expected

    def fit(self, mounts: Array, effect: Effect | None) -> ModelFit:
        """Return the fit of base and tool, and of an effect's parameters where one is given."""
        names = () if effect is None else effect.names
        model = Model(measured=self.measured, expected=self.expected(effect), extra=names)
        return fit_model(model, np.append(mounts, np.zeros(len(names))), (*self.free, *names))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Evidence:
    """Whitened residuals (m, rows) at a fit, and columns (m, rows, ...): of base and tool with the fitted effect, of
    each joint (m, rows, n), of the geometry without zeros (m, rows, g) with its tolerances (g,) and which of it are
    lengths (g,)."""

    linear: Linear
    joints: Array
    geometry: Array
    tolerance: Array
    lengths: NDArray[np.bool_]

    @classmethod
    def at(cls, case: Case, fitted: ModelFit, effect: Effect | None, noise: Noise) -> Evidence:
        """Return the evidence at a fit with this effect."""
        names = () if effect is None else effect.names
        model = Model(measured=case.measured, expected=case.expected(effect), extra=names)
        residual, J = model.linearised(fitted.p)
        index = [model.names.index(name) for name in (*case.free, *names)]
        q = case.q.copy()
        if effect is not None:
            q[:, effect.joint] += effect.basis @ fitted.p[model.n_mounts :]
        joints, geometry, tolerance, lengths = _columns(case, q, Mounts.of(fitted.p, len(case.measured.labels)))
        r = noise.whiten(residual)
        linear = Linear(residual=r, fixed=noise.whiten(J[:, :, index]), block=case.block, inflation=inflation(r))
        return cls(
            linear=linear,
            joints=noise.whiten(joints[:, : model.rows]),
            geometry=noise.whiten(geometry[:, : model.rows]),
            tolerance=tolerance,
            lengths=lengths,
        )

    @property
    def none(self) -> Array:
        """No column (m, rows, 0)."""
        return self.joints[:, :, :0]

    def columns(self, effect: Effect) -> Array:
        """Return the columns (m, rows, k) of an effect."""
        return self.joints[:, :, effect.joint, None] * effect.basis[:, None, :]

    def plain(self) -> Fitted:
        """Return the fit of base and tool (and the effect that was fitted)."""
        return fit_linear(self.linear, self.none)

    def with_joints(self, which: NDArray[np.intp]) -> Fitted:
        """Return the fit with the zeros of these joints."""
        return fit_linear(self.linear, self.joints[:, :, which])

    def std(self, which: NDArray[np.intp], region: NDArray[np.intp]) -> Array:
        """Return the standard deviations of these joints' zeros, beside the geometry, that regions left out show."""
        added = np.concatenate([self.joints[:, :, which], self.geometry], axis=2)
        prior = np.concatenate([np.full(len(which), np.inf), self.tolerance])
        return jackknife_std(self.linear, added, region, prior)[: len(which)]

    def with_geometry(self, *more: Array) -> Fitted:
        """Return the fit with the links' geometry, within its tolerances, and with more columns before it."""
        added = np.concatenate([*more, self.geometry], axis=2)
        free = np.full(added.shape[2] - len(self.tolerance), np.inf)
        return fit_linear(self.linear, added, np.concatenate([free, self.tolerance]))

    def backlash(self, offered: Sequence[Effect], able: NDArray[np.intp]) -> dict[int, tuple[float, float]]:
        """Return the backlash of each joint (from 0) that came from both sides: rad or m, and its deviation.

        All are fitted at once, beside base, tool, the zeros that can be told, the geometry within its tolerances, and
        what else joints may have wrong: the side that a joint came from goes with its reading, as sag and gears do. The
        deviations are those of the scatter that this leaves, of rows that hang together.
        """
        played = [effect for effect in offered if effect.kind is Kind.BACKLASH]
        if not played:
            return {}
        beside = [effect for effect in offered if effect.kind in (Kind.LOAD, Kind.ECCENTRICITY, Kind.SCALE)]
        columns = np.concatenate([self.columns(effect) for effect in (*played, *beside)], axis=2)
        fit = self.with_geometry(columns, self.joints[:, :, able])
        scatter = fit.squares / max(self.linear.residual.size - fit.rank, 1) * self.linear.inflation
        std = np.sqrt(scatter * np.diag(fit.covariance))
        return {effect.joint: (float(fit.values[k]), float(std[k])) for k, effect in enumerate(played)}


def _columns(case: Case, q: Array, mounts: Mounts) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
    """Return how the tool's pose follows each joint (m, 6, n) and the geometry (m, 6, g), the tolerances (g,), and
    which of it are lengths (g,)."""
    bare, measured = case.bare, case.measured
    names = parameter_names(bare)
    model = ArmModel(arm=bare, labels=measured.labels, turned=measured.rotation is not None)
    zeros = {f"{j.name}.{'theta_rad' if r else 'd_m'}" for j, r in zip(bare.joints, bare.revolute, strict=True)}
    chosen = [name for name in model.geometry if name not in zeros]
    index = [names.index(name) for name in chosen]
    drive = [
        names.index(f"{j.name}.{'theta_rad' if r else 'd_m'}") for j, r in zip(bare.joints, bare.revolute, strict=True)
    ]
    sign = np.array([joint.sign for joint in bare.joints])
    joints, geometry = np.empty((len(q), 6, bare.n)), np.empty((len(q), 6, len(index)))
    for k, tool in enumerate(mounts.tools):
        rows = measured.which == k
        _, J = parameter_jacobian(replace(bare, T_world_base=mounts.base, T_flange_tool=tool), q[rows])
        joints[rows], geometry[rows] = J[:, :, drive] * sign, J[:, :, index]
    tolerance = Tolerance()
    lengths = np.array([name.endswith("_m") for name in chosen])
    return joints, geometry, np.array([tolerance.of(name) for name in chosen]), lengths


# Linear models of whitened residuals, compared on rows left out: what each gains, and whether by more than chance.

BLOCKS = 10
RIDGE = 1e-9
"""Keeps directions that no row tells where they are, in scaled information."""
SAME_POSE = 5e-3
"""Joint values (rad or m) rounded to this are one pose: its repeats do not say what another pose would."""
ROBUST = 4.0
"""Whitened rows beyond so many robust standard deviations count less."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Linear:
    """A fit's residuals with the columns that explanations are compared beside.

    residual (m, k): in standard deviations. fixed (m, k, B): columns that are always fitted (base and tool). block
    (m,): which rows are left out together. inflation: rows worth one independent row.
    """

    residual: Array
    fixed: Array
    block: NDArray[np.intp]
    inflation: float

    @property
    def weight(self) -> Array:
        """Return (m,) the square root of each row's weight: gross rows count less."""
        size = np.sqrt((self.residual**2).sum(axis=1) / self.residual.shape[1])
        limit = ROBUST * max(float(np.median(size)), 1e-300)
        return np.asarray(np.sqrt(np.minimum(1.0, limit / np.maximum(size, 1e-300))))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fitted:
    """A linear fit: values (K,) and covariance (K, K) of the columns added, in-sample sum of squares, left-out squares
    by block (b,), and how many directions were fitted."""

    values: Array
    covariance: Array
    squares: float
    left: Array
    rank: int

    @property
    def left_out(self) -> float:
        """The sum of squares on rows left out."""
        return float(self.left.sum())


def blocks(m: int, group: NDArray[np.intp] | None = None) -> NDArray[np.intp]:
    """Return (m,) which block each row is of: stretches of neighbouring rows, groups never apart."""
    if group is None:
        group = np.arange(m)
    _, first, which = np.unique(group, return_index=True, return_inverse=True)
    order = np.argsort(np.argsort(first))[which]
    block = order * BLOCKS // (order.max() + 1)
    return np.asarray(np.unique(block, return_inverse=True)[1], dtype=np.intp)  # no number without rows


def jackknife_std(problem: Linear, added: Array, region: NDArray[np.intp], prior: Array | None = None) -> Array:
    """Return the standard deviations (K,) of the values of columns added (m, k, K), by fits without each region.

    What the model has wrong differs from region to region and does not average out over rows; the scatter of the
    residuals says nothing of it (delete-a-group jackknife, Kott 2001).
    """
    parts = np.unique(region)
    left = []
    for part in parts:
        rows = np.flatnonzero(region != part)
        some = Linear(
            residual=problem.residual[rows],
            fixed=problem.fixed[rows],
            block=np.zeros(len(rows), dtype=np.intp),
            inflation=problem.inflation,
        )
        left.append(solved(some, added[rows], prior)[0])
    if len(left) < 2:
        return np.zeros(added.shape[2])
    return np.asarray(np.sqrt((len(left) - 1.0) * np.var(left, axis=0)))


def poses_of(q: Array) -> NDArray[np.intp]:
    """Return (m,) which pose each row of joint values (m, n) is at."""
    return np.unique(np.round(q / SAME_POSE), axis=0, return_inverse=True)[1].reshape(-1)


def fit_linear(problem: Linear, added: Array, prior: Array | None = None) -> Fitted:
    """Fit the fixed columns and those added (m, k, K), to all rows and with each block left out.

    prior (K,): standard deviations about zero of the added ones, none where inf.
    """
    n_fixed, rows = problem.fixed.shape[2], problem.residual.shape[1]
    _, theta, X, y, size, H, A = solved(problem, added, prior)
    squares = float(((y - X @ theta) ** 2).sum())
    block = np.repeat(problem.block, rows)
    left = np.zeros(problem.block.max() + 1)
    for k in range(len(left)):
        part, own = X[block == k], y[block == k]
        rest = theta + without(H, part.T @ part, part.T @ (part @ theta - own))
        left[k] = float(((own - part @ rest) ** 2).sum())
    inverse = np.linalg.inv(H) / np.outer(size, size)
    rank = int(np.linalg.matrix_rank(A, tol=1e-8 * len(A), hermitian=True)) if len(A) else 0
    return Fitted(
        values=(theta / size)[n_fixed:],
        covariance=inverse[n_fixed:, n_fixed:],
        squares=squares,
        left=left,
        rank=rank,
    )


def solved(problem: Linear, added: Array, prior: Array | None) -> tuple[Array, ...]:
    """Return the values (K,) of the columns added, then the scaled solution (B + K,), columns (m k, B + K), residuals
    (m k,), the columns' sizes, information with priors and without."""
    w, n_fixed = problem.weight, problem.fixed.shape[2]
    X = np.concatenate([problem.fixed, added], axis=2) * w[:, None, None]
    X = np.asarray(X.reshape(problem.residual.size, X.shape[2]))
    y = (problem.residual * w[:, None]).ravel()
    size = np.linalg.norm(X, axis=0)
    size[size == 0.0] = 1.0
    X /= size
    precision = np.zeros(X.shape[1])
    if prior is not None:
        precision[n_fixed:] = 1.0 / (prior * size[n_fixed:]) ** 2
    A = X.T @ X
    H = A + np.diag(precision + RIDGE)
    theta = np.linalg.solve(H, X.T @ y)
    return np.asarray((theta / size)[n_fixed:]), np.asarray(theta), X, y, np.asarray(size), np.asarray(H), np.asarray(A)


def gain(poorer: Fitted, richer: Fitted) -> float:
    """Return the share by which the left-out sum of squares falls; negative where it rises."""
    return 1.0 - richer.left_out / max(poorer.left_out, 1e-300)


def falls(poorer: Fitted, richer: Fitted) -> float:
    """Return the one-sided probability that left-out squares fall by such factors, block by block, by chance.

    Factors, for blocks differ: where a fault hardly moved the tool, little could fall, however well it explains it.
    """
    if not richer.left_out < poorer.left_out:
        return 1.0
    fall = np.log(np.maximum(poorer.left, 1e-300) / np.maximum(richer.left, 1e-300))
    spread = float(fall.std(ddof=1)) / np.sqrt(len(fall))
    if not spread > 0.0:
        return 0.0 if fall.sum() > 0.0 else 1.0
    return float(t_sf(fall.mean() / spread, len(fall) - 1))


def by_chance(problem: Linear, poorer: Fitted, richer: Fitted) -> float:
    """Return the probability that columns without meaning take as much off the sum of squares (likelihood ratio).

    The noise is what the richer fit leaves; neighbouring rows that hang together count as fewer.
    """
    count = problem.residual.size
    freedom = max(count - richer.rank, 1)
    k = max(richer.rank - poorer.rank, 1)
    noise = richer.squares / freedom
    if not noise > 0.0:
        return 0.0 if poorer.squares > 0.0 else 1.0
    worth = max(freedom / problem.inflation, 4.0)
    ratio = worth * np.log(max(poorer.squares, 1e-300) / max(richer.squares, 1e-300))
    return float(chi2_sf(ratio, k))


# A rig that moved between two rows, or two recordings put together: one placement for the rows before, one after.

FEWEST_ROWS = 6
"""Rows on either side of a split that are the least."""
SPLITS = 60
"""Positions, evenly spread over the rows, at which a split is tried."""
CHANCE = 1e-6
"""Probability by chance, over all splits, below which a split is one."""
SHARE = 0.25
"""A split counts that leaves less than this share of the squares that joints and geometry leave: half the error."""


def moved_rig(evidence: Evidence, noise: Noise, case: Case, explained: float) -> str:
    """Return where the rows fall into two placements of the measuring frame, in words; "" where they do not.

    noise: what the evidence was whitened with. explained: the squares that the best of joints and geometry
    leaves. A crash between two rows is told the same way where it turned the base or the rig.
    """
    m = len(case.q)
    if m < 2 * FEWEST_ROWS:
        return ""
    splits = np.unique(np.linspace(FEWEST_ROWS, m - FEWEST_ROWS, SPLITS).astype(int))
    columns = noise.whiten(placement(case.measured.xyz_m, evidence.linear.residual.shape[1]))
    plain = evidence.plain()
    tried = {int(k): fit_linear(evidence.linear, columns * (np.arange(m) >= k)[:, None, None]) for k in splits}
    at = min(tried, key=lambda k: tried[k].squares)
    best = tried[at]
    if best.squares > SHARE * explained or len(tried) * by_chance(evidence.linear, plain, best) > CHANCE:
        return ""
    row = int(case.measured.rows[at])
    jump = 1e3 * float(np.linalg.norm(best.values[:3]))
    return (
        f"From about row {row} on the rows lie apart from those before, by {jump:.3g} mm: the rig, the base or the "
        "tool was moved in between, or two recordings were put together. Verify the two parts apart."
    )


def placement(xyz: Array, rows: int) -> Array:
    """Return how residuals (m, rows) follow a small move (m, rows, 6) of the measuring frame about their mean."""
    columns = np.zeros((len(xyz), rows, 6))
    columns[:, :3, :3] = np.eye(3)
    columns[:, :3, 3:] = -skew(xyz - xyz.mean(axis=0))
    if rows == 6:
        columns[:, 3:, 3:] = np.eye(3)
    return columns
