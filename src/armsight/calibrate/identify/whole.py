"""The whole arm fitted at once: starts, gross readings, deviations widened by what the fit leaves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from armsight.calibrate.identify.chain import Axis, ChainModel, at_zero, fit_chain, moved_by
from armsight.calibrate.identify.joint import GROSS, swung_axes
from armsight.calibrate.identify.paths import LOST_SHARE, Found, measured
from armsight.calibrate.identify.seen import Seen
from armsight.calibrate.identify.sweeps import Sweeps
from armsight.errors import Inconsistent, NotConverged
from armsight.fitting import Fit

Array = NDArray[np.float64]

SLOPES = {1.0: "", np.pi / 180.0: "degrees given as radians", 180.0 / np.pi: "radians given as degrees",
          0.01: "centimetres given as metres", 100.0: "metres given as centimetres",
          0.001: "millimetres given as metres", 1000.0: "metres given as millimetres"}  # fmt: skip
SLOPE_NEAR = 0.25
SUSPECT = 1.2
"""A whole arm that misses its readings by so much more (variance) than single paths do may have started wrong."""
WORTH = 8.0
"""Gain in half chi-square for which another start is taken, of which a joint's other type costs two parameters."""
SHORT_RAD = 2.6
"""Arcs shorter than this may have their plane swung about the chord by the noise."""
SWINGS = 4


def _check_slopes(found: Sequence[Found], sweeps: Sweeps) -> None:
    """Raise Inconsistent where the paths' lengths are not those of the commanded values: units, or not exact."""
    for j, item in enumerate(found):
        if not item.decided:
            continue
        q = sweeps.q[item.rows, j]
        slope = abs(float(np.polyfit(q, item.path.phase, 1)[0]))
        if abs(slope - 1.0) < 4 * SLOPE_NEAR and slope > 0.2:
            continue
        near = min(SLOPES, key=lambda unit: abs(np.log(max(slope, 1e-9) / unit)))
        why = SLOPES[near] if abs(slope / near - 1.0) < SLOPE_NEAR and SLOPES[near] else "another unit, or not known"
        raise Inconsistent(
            f"joint {j + 1} moved {slope:.3g} times as far as its commanded values say",
            consequence="The arm is not identified",
            cure=f"Correct the values ({why}), or use only their order (--increments order)",
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WholeFit:
    """The whole arm: model, fit, the rows kept and those discarded, and how much larger its misfit's variance is."""

    model: ChainModel
    fit: Fit
    rows: NDArray[np.intp]
    dropped: tuple[tuple[int, str], ...]

    @property
    def scale2(self) -> float:
        """Variance of the whitened residuals: 1 where the noise of single paths explains all."""
        return 2.0 * self.fit.cost / max(self.fit.dof, 1)


def fit_whole(seen: Seen, found: Sequence[Found]) -> WholeFit:
    """Return the fit of the whole arm to all readings, the joint values known.

    Started from the paths; where it misses more than they do, or a joint's type is not decided, also from every short
    arc's plane swung about its chord, from slides mirrored in depth, and from undecided joints as turning ones.
    Raises Inconsistent where the paths' lengths contradict the joint values, NotConverged.
    """
    _check_slopes(found, seen.sweeps)
    rows = np.sort(np.concatenate([item.rows for item in found]))
    starts = _starts(seen, found)
    best = _fit_from(seen, min(starts, key=lambda model: _start_cost(seen.take(rows), model)), rows)
    if best.scale2 <= SUSPECT and all(item.decided for item in found):
        return best
    for start in starts:
        try:
            again = _fit_from(seen, start, rows)
        except NotConverged:
            continue
        gained = best.fit.cost - again.fit.cost
        if gained > max(0.1 * best.fit.cost, WORTH) and len(again.rows) >= len(best.rows):
            best = again
    return best


def _starts(seen: Seen, found: Sequence[Found]) -> list[ChainModel]:
    """Return starts of the whole arm: the paths as fitted, and each short arc's plane swung about its chord."""
    sweeps = seen.sweeps
    rests = [sweeps.q[item.rows[0], :j] for j, item in enumerate(found)]
    own = [measured(item, sweeps) for item in found]
    rows = np.concatenate([item.rows for item in found])
    variants: list[list[Axis]] = [own]
    other_types: list[list[Axis]] = []
    for j, item in enumerate(found):
        before, after = own[:j], own[j + 1 :]
        circle = item.path.kind == "circle"
        if (circle and np.ptp(item.path.phase) < SHORT_RAD) or not item.decided:
            for centre, direction in swung_axes(seen.take(item.rows), sweeps.q[item.rows, j], SWINGS):
                swung = [*before, Axis(point_m=centre, direction=direction, revolute=True), *after]
                (variants if circle else other_types).append(swung)
        if not circle:  # depth is the weakest: the slide's mirror image in it looks nearly the same
            sight = own[j].point_m / np.linalg.norm(own[j].point_m)
            turned = own[j].direction - 2.0 * (own[j].direction @ sight) * sight
            variants.append([*before, Axis(point_m=own[j].point_m, direction=turned, revolute=False), *after])
    variants += other_types  # last: what they gain is over the best of the types the paths show
    out = []
    for variant in variants:
        axes = at_zero(variant, rests)
        out.append(ChainModel(axes=tuple(axes), beacon_m=beacon_at_zero(axes, sweeps, rows)))
    return out


def _start_cost(seen: Seen, model: ChainModel) -> float:
    """Return the misfit of a start, gross readings counting little."""
    r, _ = seen.residuals(*model.predict(np.zeros(len(model.names)), seen.sweeps.q))
    size = np.nan_to_num((r**2).sum(axis=1), nan=1e30)
    return float(np.log1p(size).sum())


def _fit_from(seen: Seen, model: ChainModel, rows: NDArray[np.intp]) -> WholeFit:
    """Fit the whole arm to the rows from one start, discarding gross readings."""
    dropped: list[tuple[int, str]] = []
    robust = float(np.sqrt(chi2.ppf(0.999, seen.rows)))
    while True:
        fit = fit_chain(seen.take(rows), model, robust=robust)
        size = np.sqrt((fit.residuals.reshape(len(rows), -1) ** 2).sum(axis=1))
        scale = max(1.0, float(np.sqrt(np.median(size**2) / chi2.median(seen.rows))))
        bad = size > GROSS * scale
        if not bad.any() or len(dropped) > LOST_SHARE * len(rows):
            return WholeFit(model=model, fit=fit, rows=rows, dropped=tuple(dropped))
        dropped += [(int(r), f"off the arm by {s:.0f} deviations") for r, s in zip(rows[bad], size[bad], strict=True)]
        rows = rows[~bad]


def all_covariance(names: tuple[str, ...], covariance: object, widen: float) -> Array:
    """Return the covariance of all parameters; those the data leave open get an infinite-like variance."""
    out = np.zeros((len(names), len(names)))
    known = getattr(covariance, "names", ())
    index = [names.index(one) for one in known]
    if known:
        out[np.ix_(index, index)] = widen * covariance.matrix  # type: ignore[attr-defined]
    for i, one in enumerate(names):
        if one not in known:
            out[i, i] = 1e6
    return out


def beacon_at_zero(axes: Sequence[Axis], sweeps: Sweeps, rows: NDArray[np.intp]) -> Array:
    """Return the beacon with all joints at zero: every reading moved back, the median."""
    X = sweeps.xyz_m[rows]
    for axis, q in zip(axes, sweeps.q[rows].T, strict=True):
        X = moved_by(axis, -q, X)
    return np.asarray(np.median(X, axis=0))
