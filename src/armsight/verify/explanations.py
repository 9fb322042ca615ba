"""What zeros are worth beside links that are not nominal, a drift in the run, and poses that would decide.

A healthy arm differs from its table by a millimetre and a milliradian here and there, and over a small workspace a zero
does what a length does. So all geometry is drawn about nominal with deviations that are not known themselves: they are
averaged over a grid by restricted likelihood (Patterson, Thompson 1971; Hoeting and others 1999). Explanations are
compared by their evidence, the likelihood averaged over all that they leave open (MacKay 1992): what could explain
anything is believed less than what could explain just this.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.fitting.groups import inflation
from armsight.kinematics import fk, fk_jacobian
from armsight.units import MM
from armsight.verify.evidence import Case, Evidence, by_chance, fit_linear, placement, solved
from armsight.verify.model import Effect, Kind, Model, ModelFit, Noise, extra_noise
from armsight.verify.records import Measured

LENGTH_M, ANGLE_RAD = 1e-3, 1e-3
"""What nominal lengths are believed to, as in a cell from one recording, and axes and zeros of an arm that was
mastered: a UR10 from its factory lies 0.5 mm and 0.5 mrad beside its table, a worn one twice as far."""
SIZES = (0.03, 0.1, 0.3, 0.7, 1.5, 3.0)
"""Multiples of these that are weighed against each other, of lengths and of angles apart."""
SIZE_MIDDLE, SIZE_SPREAD = 0.5, 1.2
"""Middle and spread (natural logarithm) of what the multiples are believed to be before any row is looked at."""
SCALES = (0.7, 1.0, 1.4)
"""Multiples of the noise that are weighed against each other."""
KNOCKS = (1e-3, 1e-2)
"""Standard deviations (rad, RMS over the rows; of a slide as shares of the arm's length) of what a fault is believed to
be before any row is looked at: 0.06 and 0.6 deg."""
ROUNDS = 3
RIDGE = 1e-9


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Account:
    """One explanation: its log evidence; the joints' zeros (n,) with standard deviations, and those of the fault's
    parameters (k,), means over the grid. off_m: how far the tool may be off for zeros and links, RMS over the rows, m:
    what base and tool take up counts with it."""

    log_evidence: float
    zeros: Array
    std: Array
    fault_std: Array
    off_m: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GeometryPrior:
    """The case's rows with the noise that geometry leaves of them; what `account` weighs explanations by.

    bare: the evidence at base and tool alone, in m and rad. weight (m,): square root of each row's weight: gross rows
    count less. inflation: rows worth one independent row.
    """

    case: Case
    bare: Evidence
    noise: Noise
    weight: Array
    inflation: float

    @classmethod
    def of(cls, case: Case, aligned: ModelFit) -> GeometryPrior:
        """Return the prior with the noise that remains where geometry and zeros are freed within it."""
        plain = Noise(measurement=np.zeros((len(case.q), 2)), extra=np.ones(2))
        bare = Evidence.at(case, aligned, None, plain)
        noise, rest = aligned.noise, bare.linear.residual
        variance = _wide(case, bare)
        for _ in range(ROUNDS):
            X = _stacked(*(noise.whiten(c) for c in (bare.linear.fixed, bare.joints, bare.geometry)))
            y = noise.whiten(bare.linear.residual).ravel()
            size = _sizes(X)
            A = (X / size).T @ (X / size)
            H = A + np.diag(1.0 / (variance * size**2) + RIDGE)
            theta = np.linalg.solve(H, (X / size).T @ y) / size
            worn = float(np.trace(np.linalg.solve(H, A)))
            rest = bare.linear.residual - (_stacked(bare.linear.fixed, bare.joints, bare.geometry) @ theta).reshape(
                bare.linear.residual.shape
            )
            spent = min(worn, 0.9 * y.size)
            noise = Noise.of(case.measured, _spent(extra_noise(rest, noise.measurement, 0), rest, noise, spent))
        left = replace(bare.linear, residual=noise.whiten(rest))
        return cls(case=case, bare=bare, noise=noise, weight=left.weight, inflation=inflation(left.residual))

    def account(self, fitted: ModelFit, effect: Effect | None, loose: Iterable[int] = ()) -> Account:
        """Return the evidence of an explanation and the zeros that it believes.

        fitted: with the effect, where one is given: a fault of one joint. loose: joints (from 0) whose zeros may be
        off by as much as a fault.
        """
        found = Evidence.at(self.case, fitted, effect, self.noise)
        columns = [found.linear.fixed[:, :, : len(self.case.free)], found.joints, found.geometry]
        if effect is not None:
            columns.append(found.columns(effect))
        w = self.weight[:, None, None]
        X = _stacked(*(w * c for c in columns))
        y = (found.linear.residual * w[:, :, 0]).ravel()
        size = _sizes(X)
        X = X / size
        n = self.case.bare.n
        at = len(self.case.free) + np.arange(n)
        own = fitted.p[len(fitted.p) - (0 if effect is None else len(effect.names)) :]
        mean = np.zeros(X.shape[1])
        mean[X.shape[1] - len(own) :] = -own
        grid = self._grid(found, effect, tuple(loose))
        log, theta, covariance = _solved(X, y, mean * size, grid.precision / size**2, grid.scale**2, self.inflation)
        log = log + grid.log_prior
        top = float(log.max())
        weight = np.exp(log - top)
        evidence = top + float(np.log(weight.sum()))
        weight /= weight.sum()
        wanted = np.eye(X.shape[1])[[*at, *range(X.shape[1] - len(own), X.shape[1])]] / size  # zeros, then the fault
        start = np.append(np.zeros(n), own)
        if effect is not None and effect.kind is Kind.ZERO:  # the joint's own deviation and the fault are one zero
            wanted[[effect.joint, -1]] = wanted[effect.joint] + wanted[-1]
            start[effect.joint] = own[0]
        values = theta @ wanted.T  # (g, n + k)
        variance = np.einsum("ni,gij,nj->gn", wanted, covariance, wanted, optimize=True)
        middle = weight @ values
        std = np.sqrt(weight @ (variance + (values - middle) ** 2))
        return Account(
            log_evidence=evidence,
            zeros=(start + middle)[:n],
            std=std[:n],
            fault_std=std[n:],
            off_m=self._off_m(weight, theta / size, covariance / np.outer(size, size)),
        )

    def _off_m(self, weight: Array, theta: Array, covariance: Array) -> float:
        """Return how far zeros and links put the tool off (RMS, m), of values (g, K) with covariances, weighed (g,)."""
        moves = np.concatenate([self.bare.joints, self.bare.geometry], axis=2)[:, :3]  # (m, 3, n + g)
        arm = slice(len(self.case.free), len(self.case.free) + moves.shape[2])
        second = np.einsum("g,gij->ij", weight, covariance[:, arm, arm]) + (weight * theta[:, arm].T) @ theta[:, arm]
        return float(np.sqrt(np.einsum("mik,kl,mil->", moves, second, moves, optimize=True) / len(moves)))

    def _grid(self, found: Evidence, effect: Effect | None, loose: tuple[int, ...]) -> _Grid:
        """Return the precisions of all columns at each point of the grid."""
        bare, fixed = self.case.bare, len(self.case.free)
        faulty = effect is not None or bool(loose)
        axes = np.meshgrid(SIZES, SIZES, SCALES, KNOCKS if faulty else KNOCKS[:1], indexing="ij")
        lengths, angles, scale, knock = (a.ravel() for a in axes)
        turning, sliding = ANGLE_RAD * angles[:, None], LENGTH_M * lengths[:, None]
        joint = np.where(bare.revolute, turning, sliding)  # (g, n)
        per = np.where(bare.revolute, 1.0, bare.length_m)
        for j in loose:
            joint[:, j] = np.hypot(joint[:, j], knock * per[j])
        links = np.where(found.lengths, sliding, turning)
        parts = [np.zeros((len(scale), fixed)), joint**-2.0, links**-2.0]
        if effect is not None:
            rms = np.sqrt((effect.basis**2).mean(axis=0))
            parts.append((knock[:, None] * per[effect.joint] / np.maximum(rms, 1e-300)) ** -2.0)
        prior = sum(-0.5 * (np.log(a / SIZE_MIDDLE) / SIZE_SPREAD) ** 2 for a in (lengths, angles))
        prior = prior - np.log(np.exp(prior).sum())
        return _Grid(precision=np.concatenate(parts, axis=1), scale=scale, log_prior=np.asarray(prior))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Grid:
    """Points (g,): precisions (g, K) of the columns, 0 where free, the noise's scale, logarithm of the prior."""

    precision: Array
    scale: Array
    log_prior: Array


def _solved(X: Array, y: Array, mean: Array, precision: Array, scale2: Array, inflation: float) -> tuple[Array, ...]:
    """Return restricted log likelihoods (g,), values (g, K) and covariances (g, K, K) of unit columns X (rows, K)."""
    A, b, yy, n = X.T @ X / inflation, X.T @ y / inflation, float(y @ y) / inflation, y.size / inflation
    H = A / scale2[:, None, None] + np.eye(len(A)) * (precision + RIDGE)[:, None, :]
    right = b / scale2[:, None] + precision * mean
    covariance = np.linalg.inv(H)
    theta = np.einsum("gij,gj->gi", covariance, right)
    squares = yy / scale2 + (precision * mean**2).sum(axis=1) - (right * theta).sum(axis=1)
    random = np.where(precision > 0.0, np.log(np.maximum(precision, 1e-300)), 0.0).sum(axis=1)
    log = -0.5 * (n * np.log(scale2) + np.linalg.slogdet(H)[1] - random + squares)
    return np.asarray(log), np.asarray(theta), np.asarray(covariance)


def _stacked(*columns: Array) -> Array:
    """Return columns (m, rows, k) side by side, (m rows, K)."""
    each = np.concatenate(columns, axis=2)
    return np.asarray(each.reshape(-1, each.shape[2]))


def _sizes(X: Array) -> Array:
    """Return the columns' lengths (K,), 1 of what moves nothing, such as a joint whose axis goes through the point."""
    size = np.asarray(np.linalg.norm(X, axis=0))
    return np.where(size > 0.0, size, 1.0)


def _wide(case: Case, found: Evidence) -> Array:
    """Return the variances (K,) of base and tool, zeros and geometry that the noise is estimated beside."""
    widest = SIZES[-1]
    zeros = np.where(case.bare.revolute, KNOCKS[-1], KNOCKS[-1] * case.bare.length_m)
    links = widest * np.where(found.lengths, LENGTH_M, ANGLE_RAD)
    return np.asarray(np.concatenate([np.full(len(case.free), np.inf), zeros, links]) ** 2)


def _spent(extra: Array, rest: Array, noise: Noise, spent: float) -> Array:
    """Return extra noise (2,) lifted by the freedom that was spent on residuals (m, rows)."""
    lift = rest.size / (rest.size - spent)
    own = np.median(noise.measurement**2, axis=0)
    return np.asarray(np.sqrt(np.maximum((extra**2 + own) * lift - own, 0.0)))


# Errors that grow in the run: an arm that warms up grows, a base or a rig that is loose or warms up moves.

COURSES = (0.2, 0.6, np.inf)
"""Time constants by which a drift is tried to settle, as shares of the run; inf: it goes on evenly."""
UNLIKELY = 1e-4
"""Probability by chance, over all that are tried, below which a drift is one."""
PREDICTED = 0.6
"""Share of the time's variance that the joints predict (rows in the order of their poses) from which on a drift is
not told from errors that hang on the poses."""


Drift = tuple[str, dict[str, tuple[float, float]], float, float]
"""In words; parameters as (value, standard deviation); how far it moved the tool at the most, m; the squares it leaves
beside base and tool."""


def drifting(evidence: Evidence, noise: Noise, case: Case, base: RigidTransform) -> Drift | None:
    """Return the drift that the rows show beside zeros, links and what base and arm are off all the time, else None.

    noise: what the evidence was whitened with. It goes by the rows' times; where they have none, by their order.
    """
    count, rows = evidence.linear.residual.shape
    t = np.arange(count, dtype=float) if case.measured.t_s is None else case.measured.t_s
    share = (t - t.min()) / max(float(np.ptp(t)), 1e-300)
    if _predicted(case.q, share) > PREDICTED:
        return None
    grown = np.zeros((count, rows, 1))
    grown[:, :3, 0] = base.rotation.apply(fk(case.bare, case.q)[:, :3, 3])
    ways = grown, placement(case.measured.xyz_m, rows)
    known = [*map(noise.whiten, ways), evidence.joints]
    plain, found = evidence.with_geometry(*known), []
    for settles in COURSES:
        course = share if np.isinf(settles) else np.expm1(-share / settles) / np.expm1(-1.0 / settles)
        for columns in ways:
            drawn = columns * course[:, None, None]
            rich = evidence.with_geometry(*known, noise.whiten(drawn))
            # neighbouring rows hang together by the drift itself: what counts is how those do that it leaves
            _, theta, X, y, *_ = solved(evidence.linear, noise.whiten(drawn), None)
            linear = replace(evidence.linear, inflation=inflation((y - X @ theta).reshape(count, rows)))
            found.append((by_chance(linear, plain, rich), rich.squares, drawn))
    chance, _, drawn = min(found, key=lambda one: one[:2])
    if len(found) * chance > UNLIKELY:
        return None
    alone = fit_linear(evidence.linear, noise.whiten(drawn))
    moved_m = float(np.linalg.norm((drawn @ alone.values)[:, :3], axis=1).max())
    growth = (float(alone.values[0]), float(np.sqrt(alone.covariance[0, 0]))) if len(alone.values) == 1 else None
    return _words(growth, moved_m), {} if growth is None else {"growth": growth}, moved_m, alone.squares


def _words(growth: tuple[float, float] | None, moved_m: float) -> str:
    far = f"by up to {moved_m / MM:.2g} mm"
    if growth is None:
        return (
            f"From the first row to the last the tool moved {far} as one with the arm's base: base, rig or target is "
            "loose or grew warm in the run. Fasten them, let them warm up, and verify again."
        )
    return (
        f"The arm's lengths grew by {1e6 * growth[0]:.3g} +- {1e6 * growth[1]:.2g} ppm in the run, which moved the "
        f"tool {far}: the arm (or the rig that measures it) grew warm. Let it warm up, and verify again."
    )


def _predicted(q: Array, share: Array) -> float:
    """Return which share of the time's variance a turn's harmonics of the joints predict, beyond chance."""
    columns = np.column_stack([np.ones(len(q)), np.sin(q), np.cos(q)])
    left = share - columns @ np.linalg.lstsq(columns, share, rcond=None)[0]
    free = max(len(q) - columns.shape[1], 1)
    return float(1.0 - (left @ left / free) / np.var(share, ddof=1))


# Which joint positions would tell two explanations apart.

DECIDING_POSES = 6
CANDIDATES, SEED = 400, 11
"""Joint positions looked at, drawn evenly over what the arm may do; the same rows give the same proposal."""
OPEN_RAD, OPEN_M = np.pi, 0.3
"""Range of a joint without limits, or with wider ones, to either side of the middle of the rows'."""


def deciding_poses(case: Case, fitted: ModelFit, joints: tuple[int, ...]) -> Array:
    """Return joint values (k, n), in the order of their worth, that would best tell the zeros of these joints (from 0)
    from each other and from base and tool."""
    rng = np.random.default_rng(SEED)
    bare, middle = case.bare, case.q.mean(axis=0)
    span = np.where(bare.revolute, OPEN_RAD, OPEN_M)
    low, high = np.maximum(bare.lower, middle - span), np.minimum(bare.upper, middle + span)
    q = rng.uniform(low, high, (CANDIDATES, bare.n))
    sigma = np.median(fitted.noise.sigma, axis=0)
    chosen, _ = best_poses(case, fitted.p, sigma, joints, q, DECIDING_POSES)
    return q[chosen]


def best_poses(
    case: Case, p: Array, sigma: Array, joints: tuple[int, ...], q: Array, count: int
) -> tuple[list[int], Array]:
    """Return which of the joint positions q (c, n) to measure beside the case's, in the order of their worth, and the
    covariances (k + 1, j, j) of the joints' zeros: with all of them, then with each left out.

    p: base and tool. sigma (2,): noise of a coordinate in m and of a turn in rad.
    """
    n_joints = len(joints)
    width = len(case.free) + n_joints
    here = np.empty((0, width))
    if len(case.q):
        here = _columns(case, case.q, p, sigma, joints).reshape(-1, width)
    there = _columns(case, q, p, sigma, joints)
    every = there.reshape(-1, width)
    H = here.T @ here
    scale = np.sqrt(np.maximum(np.diag(H) + np.diag(every.T @ every), 1e-300))
    H = H / np.outer(scale, scale) + 1e-9 * np.eye(len(H))
    there = there / scale
    gained = np.swapaxes(there, 1, 2) @ there  # (c, width, width)
    chosen: list[int] = []
    for _ in range(min(count, len(q))):
        covariance = np.linalg.inv(H + gained)[:, -n_joints:, -n_joints:]
        left_open = np.linalg.slogdet(covariance)[1]
        left_open[chosen] = np.inf
        best = int(np.argmin(left_open))
        chosen.append(best)
        H = H + gained[best]
    less = [H, *(H - gained[k] for k in chosen)]
    own = scale[-n_joints:]
    return chosen, np.array([np.linalg.inv(h)[-n_joints:, -n_joints:] / np.outer(own, own) for h in less])


def _columns(case: Case, q: Array, mounts: Array, sigma: Array, joints: tuple[int, ...]) -> Array:
    """Return the whitened columns (m, rows, B + joints) of base, tool and the joints' zeros at joint values q."""
    F, J = fk_jacobian(case.bare, q)
    label = case.measured.labels[0]
    points = _placed(case, len(q), label)
    more = J[:, :, list(joints)]
    model = Model(measured=points, expected=lambda _: (F, more), extra=tuple(f"zero{i}" for i in joints))
    tool = f"tool:{label}" if label else "tool"
    names = [name for name in case.free if name.split(".")[0] in ("base", tool)]
    p = np.concatenate([mounts[:12], np.zeros(len(joints))])
    _, columns = model.linearised(p)
    out = np.zeros((*columns.shape[:2], len(case.free) + len(joints)))
    for k, name in enumerate(case.free):
        if name in names:
            out[:, :, k] = columns[:, :, model.names.index(name)]
    out[:, :, len(case.free) :] = columns[:, :, 12:]
    return np.asarray(out / np.repeat(sigma, 3)[: columns.shape[1]][:, None])


def _placed(case: Case, m: int, label: str) -> Measured:
    """Return m rows in any position: only what moves with the joints counts."""
    rotation = None if case.measured.rotation is None else np.tile(np.eye(3), (m, 1, 1))
    return Measured(xyz_m=np.zeros((m, 3)), rotation=rotation, point=(label,) * m)
