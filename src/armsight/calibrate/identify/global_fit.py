"""The whole arm fitted at once: axes to start from, gross readings, standard deviations widened by what is left."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from armsight.arrays import Array
from armsight.calibrate.identify.chain import Axis, ChainModel, at_home, fit_chain, moved_by, suggest_coupling
from armsight.calibrate.identify.joint_paths import LOST_SHARE, JointPath
from armsight.calibrate.identify.kernels import axis_costs, settle_axis
from armsight.calibrate.identify.path_fit import gross
from armsight.calibrate.identify.sweeps import SweepResiduals, Sweeps, background_shifts, or_inexact, rig_shifts
from armsight.errors import Inconsistent, NotConverged
from armsight.fitting import Fit
from armsight.optics import Rig
from armsight.records import NamedCovariance

SLOPES = {
    1.0: "",
    np.pi / 180.0: "degrees given as radians",
    180.0 / np.pi: "radians given as degrees",
    0.01: "centimetres given as metres",
    100.0: "metres given as centimetres",
    0.001: "millimetres given as metres",
    1000.0: "metres given as millimetres",
}
SLOPE_NEAR = 0.25
WORTH = 8.0
"""Half chi-square by which a turning joint must be better than a sliding one where the path alone does not decide."""
RIVAL = 5.0
"""Half chi-square, by the noise about the whole arm, within which two arms explain the readings alike (odds of 150 to
1): of 80 short arcs of 1 and 1.5 px the first of two arms was wrong in 11, by up to 3.3 of it."""
SURE = 1e-12
"""Where a line is rejected less clearly than this, by one noisy sweep in ten thousand, its values decide as well."""
PLAIN = 1e6
"""Huber's scale from which all readings weigh alike."""
STARTED = 12
"""Combinations of axes fitted at most."""


def check_slopes(found: Sequence[JointPath], seen: SweepResiduals, axes: Sequence[Sequence[Candidate]]) -> None:
    """Raise Inconsistent where a path does not go with the commanded values: another unit, or not exact.

    The lengths are compared only where no axis explains the path at those values: an arc whose centre the noise leaves
    open has no length to speak of.
    """
    for j, (item, possible) in enumerate(zip(found, axes, strict=True)):
        best = min((chi2 for chi2, _ in possible), default=np.inf)
        if best < 3.0 * item.path.chi2 + PLAUSIBLE:
            continue
        q = seen.sweeps.q[item.main, j]
        slope = abs(float(np.polyfit(q, item.path.phase, 1)[0]))
        if abs(slope - 1.0) < 4 * SLOPE_NEAR and slope > 0.2:
            continue
        near = min(SLOPES, key=lambda unit: abs(np.log(max(slope, 1e-9) / unit)))
        why = SLOPES[near] if abs(slope / near - 1.0) < SLOPE_NEAR and SLOPES[near] else "another unit, or not known"
        raise Inconsistent(
            f"joint {j + 1} moved {slope:.3g} times as far as its commanded values say",
            consequence="The arm is not identified",
            cure=f"Correct the values ({why}){or_inexact(seen, j)}",
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GlobalFit:
    """The whole arm: model, fit, the rows kept and those discarded, and how much larger its misfit's variance is.

    n_unseen: residuals of cameras that did not see a reading. alternatives: other arms of the same types that explain
    as many readings.
    """

    model: ChainModel
    fit: Fit
    rows: NDArray[np.intp]
    dropped: tuple[tuple[int, str], ...]
    n_unseen: int = 0
    alternatives: tuple[GlobalFit, ...] = ()

    @property
    def scale2(self) -> float:
        """Variance of the whitened residuals: 1 where the noise of single paths explains all."""
        return 2.0 * self.fit.cost / max(self.fit.dof - self.n_unseen, 1)

    @property
    def price(self) -> float:
        """The fit's cost, and what its turning joints cost beside sliding ones."""
        return self.fit.cost + WORTH * sum(axis.revolute for axis in self.model.axes)

    def rivals(self, variance: float) -> tuple[GlobalFit, ...]:
        """Return the alternatives that readings of this variance, over that of single paths, do not tell from it."""
        return tuple(one for one in self.alternatives if one.price - self.price < RIVAL * variance)

    def systematic(self, seen: SweepResiduals, rig: Rig | None) -> Array:
        """Return what errors that no residual shows add to the covariance (P, P): of the rig, which is wrong alike in
        every reading, and of what is behind the beacon, which shifts it alike in both views."""
        out = np.zeros((len(self.fit.names), len(self.fit.names)))
        kept = seen.take(self.rows)
        predicted, J = self.model.predict(self.fit.shared, kept.sweeps.q)
        shifts = np.hstack([rig_shifts(kept, rig, predicted), background_shifts(kept)])
        if self.fit.covariance is None or not shifts.shape[1]:
            return out
        free = [self.fit.names.index(name) for name in self.fit.covariance.names]
        slopes = kept.residuals(predicted, J)[1].reshape(len(shifts), -1)[:, free]
        # where the fit goes when all readings are shifted so: its own normal equations with the shifts for residuals
        moved = np.linalg.lstsq(slopes, -shifts, rcond=None)[0]
        out[np.ix_(free, free)] = moved @ moved.T
        return out


def fit_globally(seen: SweepResiduals, found: Sequence[JointPath]) -> GlobalFit:
    """Return the fit of the whole arm to all readings, the joint values known.

    Started from the axes that explain each sweep best, and from all others the noise does not exclude; joints whose
    type is not decided are tried as both. Raises NotConverged, Inconsistent where the paths contradict the values.
    """
    axes = [possible_axes(seen, item, j) for j, item in enumerate(found)]
    check_slopes(found, seen, axes)
    rows = np.sort(np.concatenate([item.rows for item in found]))
    best: GlobalFit | None = None
    tried: list[GlobalFit] = []
    for least, start in _starts(seen, found, axes):
        if best is not None and least > best.price + RIVAL:
            break  # the arm explains its sweeps at best as well as each sweep's own axis does
        try:
            again = _fit_from(seen, start, rows)
        except NotConverged:
            continue
        tried.append(again)
        if best is None or (-len(again.rows), again.price) < (-len(best.rows), best.price):
            best = again
    if best is not None:
        _check_dropped(seen, found, best, rows)
    if best is None:
        raise NotConverged(
            "no arm explains the sweeps",
            consequence="The arm is not identified",
            cure="Sweep again, slower and over longer arcs",
        )
    return replace(best, alternatives=tuple(one for one in tried if _alike(one, best)))


def _check_dropped(
    seen: SweepResiduals, found: Sequence[JointPath], arm_fit: GlobalFit, rows: NDArray[np.intp]
) -> None:
    """Raise Inconsistent where an arm explains its other sweeps, and too little of one."""
    dropped = [row for row, _ in arm_fit.dropped]
    for j, item in enumerate(found, 1):
        off = len(item.discarded) + int(np.isin(item.rows, dropped).sum())
        count = len(item.discarded) + len(item.rows)
        if off > LOST_SHARE * count:
            raise Inconsistent(
                f"{off} of the {count} readings of joint {j} do not agree with any arm that explains the other sweeps",
                consequence="The arm is not identified",
                cure=" ".join(
                    [
                        "Another joint may have moved with it, or its commanded values are not exact: sweep again"
                        + or_inexact(seen, j - 1),
                        *_suspected(seen.take(rows), arm_fit.model),
                    ]
                ),
            )


def _suspected(seen: SweepResiduals, model: ChainModel) -> list[str]:
    """Return what coupling the readings suggest, with none of them discarded."""
    try:
        fit = fit_chain(seen, model, robust=PLAIN)
    except NotConverged:
        return []
    return [f"({note})" for note in suggest_coupling(seen, model, fit.shared)]


def _alike(one: GlobalFit, best: GlobalFit) -> bool:
    """Whether an arm is another of the best one's types that explains as many readings."""
    types = [[axis.revolute for axis in each.model.axes] for each in (one, best)]
    return one is not best and types[0] == types[1] and len(one.rows) == len(best.rows)


def possible_axes(seen: SweepResiduals, item: JointPath, joint: int) -> list[Candidate]:
    """Return a joint's axes as its sweep shows them: of its type, and of both where that is not decided."""
    part, q = seen.take(item.main), seen.sweeps.q[item.main, joint]
    circle = item.path.kind == "circle"
    own = candidates(part, q, revolute=circle)
    sure = item.decided and (not circle or item.p_line < SURE)
    other = [] if sure else candidates(part, q, revolute=not circle)
    best = min((chi2 for chi2, _ in (*own, *other)), default=np.inf)
    return plausible(own, best) + plausible(other, best)


def _starts(
    seen: SweepResiduals, found: Sequence[JointPath], axes: Sequence[Sequence[Candidate]]
) -> list[tuple[float, ChainModel]]:
    """Return starts of the whole arm, the best first, with the least price each can have."""
    sweeps = seen.sweeps
    rests = [sweeps.q[item.main[0], :j] for j, item in enumerate(found)]
    rows = np.sort(np.concatenate([item.rows for item in found]))
    combined: list[tuple[float, list[Axis]]] = [(0.0, [])]
    # a beam: the best combinations of the joints so far are carried on, since all would be a product over the joints
    for possible in axes:
        more = [
            (penalised_cost + 0.5 * chi2 + WORTH * axis.revolute, [*before, axis])
            for penalised_cost, before in combined
            for chi2, axis in possible
        ]
        combined = sorted(more, key=lambda item: item[0])[:STARTED]
    out = []
    for penalised_cost, chosen in combined:
        turned = at_home(chosen, rests)
        out.append((penalised_cost, ChainModel(axes=tuple(turned), beacon_m=beacon_at_zero(turned, sweeps, rows))))
    return out


def _fit_from(seen: SweepResiduals, model: ChainModel, rows: NDArray[np.intp]) -> GlobalFit:
    """Fit the whole arm to the rows from one start, discarding gross readings."""
    dropped: list[tuple[int, str]] = []
    robust = float(np.sqrt(chdtri(seen.rows, 1e-3)))
    while True:
        kept = seen.take(rows)
        fit = fit_chain(kept, model, robust=robust)
        size = np.sqrt((fit.residuals.reshape(len(rows), -1) ** 2).sum(axis=1))
        scale = max(1.0, float(np.sqrt(np.median(size**2) / chdtri(np.mean(kept.counts), 0.5))))
        bad = size > gross(kept) * scale
        if not bad.any() or len(dropped) > LOST_SHARE * len(rows):
            return GlobalFit(model=model, fit=fit, rows=rows, dropped=tuple(dropped), n_unseen=kept.n_unseen)
        dropped += [
            (int(r), f"off the arm by {s:.0f} standard deviations") for r, s in zip(rows[bad], size[bad], strict=True)
        ]
        rows = rows[~bad]


def all_covariance(names: tuple[str, ...], covariance: NamedCovariance | None, widen: float) -> Array:
    """Return the covariance (P, P) of all parameters; those the data leave open get an infinite-like variance."""
    out = 1e6 * np.eye(len(names))
    if covariance is not None:
        index = [names.index(one) for one in covariance.names]
        out[np.ix_(index, index)] = widen * covariance.matrix
    return out


def beacon_at_zero(axes: Sequence[Axis], sweeps: Sweeps, rows: NDArray[np.intp]) -> Array:
    """Return the beacon with all joints at zero: every reading moved back, the median."""
    X = sweeps.xyz_m[rows]
    # the beacon is M1(q1) .. Mn(qn) of where it is at zero: undone from the base outwards
    for axis, q in zip(axes, sweeps.q[rows].T, strict=True):
        X = moved_by(axis, -q, X)
    return np.asarray(np.median(X, axis=0))


# Where a joint's axis may be, its values known: the best of all directions, and others that noise does not exclude.

DIRECTIONS = 400
"""Directions tried, spread over the sphere 10 degrees apart."""
APART_COS = np.cos(np.deg2rad(25.0))
"""Minima nearer to each other than this are followed once."""
SAME_COS = np.cos(np.deg2rad(2.0))
FOLLOWED = 4
PLAUSIBLE = 60.0
"""Chi-square above the best one's up to which an axis is worth a start: positions are linearised there."""


Candidate = tuple[float, Axis]
"""An axis as one sweep shows it, the other joints at rest, behind the sweep's chi-square with it."""


def candidates(seen: SweepResiduals, q: Array, *, revolute: bool) -> list[Candidate]:
    """Return the axes that explain a sweep best at the joint's values q (m,), the best first.

    For a direction the rest of the motion is linear, so that all directions can be tried: no start can be wrong. A
    turning joint's position is a + cos q b + sin q n x b, a sliding one's a + q n.
    """
    xyz, W = seen.sweeps.xyz_m, _information(seen)
    middle, mean = 0.5 * (q.min() + q.max()), xyz.mean(axis=0)
    centred, value = xyz - mean, q - middle
    grid = _sphere(DIRECTIONS)
    costs = np.empty(len(grid))
    axis_costs(revolute, grid, centred, W, value, costs)
    out: list[Candidate] = []
    for start in _minima(grid, costs):
        direction, p = start.copy(), np.empty(6)
        cost = settle_axis(revolute, direction, 0.1, centred, W, value, p)
        if not np.isfinite(cost) or any(axis.direction @ direction > SAME_COS for _, axis in out):
            continue
        out.append((cost, Axis(point_m=mean + p[:3], direction=direction, revolute=revolute)))
    return sorted(out, key=lambda one: one[0])


def plausible(found: Sequence[Candidate], best: float) -> list[Candidate]:
    """Return those candidates that the noise does not exclude beside one of chi-square best."""
    return [one for one in found if one[0] < best + PLAUSIBLE]


def _information(seen: SweepResiduals) -> Array:
    """Return the information (m, 3, 3) of every position."""
    m = len(seen.sweeps)
    W: Array
    if seen.rig is None and seen.whitener is not None:
        W = seen.whitener.transpose(0, 2, 1) @ seen.whitener / seen.sigma**2
    elif seen.sweeps.covariance_m2 is not None:
        W = np.asarray(np.linalg.inv(seen.sweeps.covariance_m2) / seen.relative**2)
    else:
        W = np.tile(np.eye(3) / seen.sigma**2, (m, 1, 1))
    return np.ascontiguousarray(W)


def _minima(grid: Array, costs: Array) -> list[Array]:
    """Return the best directions of the grid that lie apart."""
    out: list[Array] = []
    for i in np.argsort(costs):
        if len(out) == FOLLOWED or not np.isfinite(costs[i]):
            break
        if all(grid[i] @ one < APART_COS for one in out):
            out.append(grid[i])
    return out


def _sphere(n: int) -> Array:
    """Return n directions (n, 3), evenly spread."""
    # a spiral of golden angles at even heights: even heights are even areas on a sphere
    i = np.arange(n) + 0.5
    z, turn = 1.0 - 2.0 * i / n, np.pi * (1.0 + np.sqrt(5.0)) * i
    r = np.sqrt(1.0 - z**2)
    return np.column_stack([r * np.cos(turn), r * np.sin(turn), z])
