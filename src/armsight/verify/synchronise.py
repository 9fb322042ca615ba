"""The time offset between measured rows and the arm's, searched over all lags, then fitted with base and tool.

Over all lags, not from a near start: each lag is judged by how well the whole measured path is the arm's path there,
whatever base and tool. The best lags are fitted and the best fit is taken.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import Akima1DInterpolator
from scipy.spatial.transform import Rotation, Slerp

from armsight.arrays import Array
from armsight.errors import Ambiguous, ArmsightError, Degenerate, Inconsistent, NotConverged, NotEnoughData
from armsight.fitting.groups import inflation
from armsight.geometry.poses import skew
from armsight.kinematics import Arm, fk_jacobian
from armsight.verify.alignment import SENSELESS, STARTS_M, Align, closed_form, free_names
from armsight.verify.model import Expected, Model, Mounts, fit_model
from armsight.verify.records import Measured

LAG_S = 0.04
"""Step of the lags looked at: at 0.5 m/s the arm moves 20 mm, which a fit gets over."""
SEARCH_ROWS = 160
"""Measured rows that the lags are judged by."""
FIT_ROWS, FINAL_ROWS = 200, 2000
LEAST_OVERLAP = 0.3
"""Share of the shorter stream that both must have in common at a lag."""
LEAST_OVERLAP_S = 1.5
MOST_LAGS = 200_000
CHUNK = 400
"""Lags judged at a time, for memory."""
CANDIDATES = 5
"""Lags fitted, of each kind of judgement."""
RANKED = 1e-5
"""A lag's fit ends where a step lowers its cost by less than this share: fits from wrong lags creep."""
RIVAL, APART_S = 1.3, 0.15
"""Another lag, so far away, with less than RIVAL times the error (and no worse than the noise) fits as well."""
DRIFTS = 5.0
"""A drift of so many of its standard deviations is one."""
DRIFT_LEAST_S = 1e-3
"""What drift must come to over the run to be told."""
OFFSET, DRIFT = "clock.offset_s", "clock.drift_ppm"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Clock:
    """How the clock of the measurement goes beside the arm's.

    offset_s: add it to measured times, in the middle of the run mid_s, to get the arm's. drift_ppm: and this much of
    the time since then; 0 where none is proved. p: base and tool of the fit. notes: what to know of it."""

    offset_s: float
    std_s: float
    mid_s: float
    drift_ppm: float
    p: Array
    notes: tuple[str, ...] = ()

    def on_arm(self, t_s: Array) -> Array:
        """Return measured times on the arm's clock."""
        return np.asarray(t_s + self.offset_s + 1e-6 * self.drift_ppm * (t_s - self.mid_s))


def synchronise(
    stream: Stream, measured: Measured, t_s: Array, nominal: Mounts, how: Align, near_s: float | None = None
) -> Clock:
    """Return the clock that lays measured rows, sampled at t_s (m,), on the arm's times.

    near_s: an offset that is known nearly; without it all are tried.

    Raises NotEnoughData for too short streams, Inconsistent where no lag makes them agree, Ambiguous where several do,
    Degenerate where the arm does not move.
    """
    if near_s is None:
        rows = _thinned(len(t_s), SEARCH_ROWS)
        found = _candidates(stream, measured.take(rows), t_s[rows], nominal, _lags(stream.t_s, t_s))
    else:
        found = np.array([near_s])
    rows = _thinned(len(t_s), FIT_ROWS)
    fits = [
        fit for lag in found if (fit := _fitted(stream, measured.take(rows), t_s[rows], nominal, how, lag)) is not None
    ]
    if not fits:
        raise _apart(stream.t_s, t_s, "no lag can be fitted")
    fits.sort(key=lambda fit: fit[0])
    _check(stream, measured, t_s, fits)
    return _final(stream, measured, t_s, fits[0][2], fits[0][1], how)


def _thinned(n: int, most: int) -> NDArray[np.intp]:
    return np.unique(np.linspace(0, n - 1, min(n, most)).astype(np.intp))


def _lags(t_arm: Array, t_s: Array) -> Array:
    """Return the lags at which the streams have enough in common."""
    shorter = min(float(np.ptp(t_arm)), float(np.ptp(t_s)))
    least = max(LEAST_OVERLAP * shorter, LEAST_OVERLAP_S)
    if shorter < least:
        raise NotEnoughData(
            f"the streams last {np.ptp(t_s):.3g} s (measured) and {np.ptp(t_arm):.3g} s (the arm)",
            consequence="No time offset can be told",
            cure="Record ten seconds of irregular motion, or leave t_s out of both where rows belong together by order",
        )
    low, high = t_arm[0] - t_s[-1] + least, t_arm[-1] - t_s[0] - least
    count = min(int((high - low) / LAG_S) + 1, MOST_LAGS)
    return np.linspace(low, high, max(count, 2))


def _candidates(stream: Stream, measured: Measured, t_s: Array, nominal: Mounts, lags: Array) -> Array:
    """Return the lags worth a fit: the best minima of the misfit for several tools, and of turns alone."""
    from scipy.signal import argrelmin  # imported here: it takes longer than most commands need to begin

    first = measured.labels[0]
    mine = np.array([point == first for point in measured.point])
    xyz, t = measured.xyz_m[mine], t_s[mine]
    grid = np.arange(stream.t_s[0], stream.t_s[-1] + 0.5 * LAG_S, 0.25 * LAG_S)
    F, V = stream.at(grid)
    tools = [nominal.tools[0].translation, np.zeros(3), *(STARTS_M * np.vstack([np.eye(3), -np.eye(3)]))]
    known = covered(stream.t_s, grid)
    scores = [_misfit(at_tool(F, V, x)[0], grid, known, xyz, t, lags) for x in tools]
    if measured.rotation is not None:
        scores.append(_turn_misfit(F, grid, known, measured.rotation[mine], t, lags))
    best: list[float] = []
    for score in (np.min(scores[: len(tools)], axis=0), *scores[:1], *scores[len(tools) :]):
        low = np.union1d(argrelmin(score, order=2, mode="clip")[0], [int(np.argmin(score))])
        best += lags[low[np.argsort(score[low])[:CANDIDATES]]].tolist()
    merged: list[float] = []
    for lag in best:
        if all(abs(lag - other) > LAG_S for other in merged):
            merged.append(lag)
    return np.array(merged)


def _misfit(p: Array, grid: Array, known: NDArray[np.bool_], xyz: Array, t: Array, lags: Array) -> Array:
    """Return for each lag the share of both paths' variance that no turn lays on each other: 0 at a perfect fit."""
    out = np.full(len(lags), 1.0)
    for i in range(0, len(lags), CHUNK):
        part = slice(i, i + CHUNK)
        at = (t[None, :] + lags[part, None] - grid[0]) / (grid[1] - grid[0])
        k = np.clip(np.rint(at).astype(np.intp), 0, len(grid) - 1)
        w = ((at >= 0) & (at <= len(grid) - 1) & known[k]).astype(float)
        total = np.maximum(w.sum(axis=1), 1.0)
        a = p[k]
        a = (a - (np.einsum("lm,lmi->li", w, a) / total[:, None])[:, None]) * w[:, :, None]
        b = xyz[None] * w[:, :, None]
        b = (xyz[None] - (b.sum(axis=1) / total[:, None])[:, None]) * w[:, :, None]
        H = np.einsum("lmi,lmj->lij", a, b)
        s = np.linalg.svd(H, compute_uv=False)
        s[:, 2] *= np.sign(np.linalg.det(H))
        both = (a**2).sum(axis=(1, 2)) + (b**2).sum(axis=(1, 2))
        enough = w.sum(axis=1) >= LEAST_OVERLAP * 0.5 * len(t)
        out[part] = np.where(enough & (both > 0.0), 1.0 - 2.0 * s.sum(axis=1) / np.maximum(both, 1e-300), 1.0)
    return out


def _turn_misfit(F: Array, grid: Array, known: NDArray[np.bool_], R: Array, t: Array, lags: Array) -> Array:
    """Return one minus the correlation of how far both turn from row to row: base and tool have no part in it."""
    turned = _angles(R[:-1], R[1:])
    step = grid[1] - grid[0]
    out = np.full(len(lags), 1.0)
    for n, lag in enumerate(lags):
        at = (t + lag - grid[0]) / step
        k = np.clip(np.rint(at).astype(np.intp), 0, len(grid) - 1)
        good = (at >= 0) & (at <= len(grid) - 1) & known[k]
        both = good[:-1] & good[1:]
        if both.sum() < max(LEAST_OVERLAP * 0.5 * len(t), 8):
            continue
        a, b = _angles(F[k[:-1][both], :3, :3], F[k[1:][both], :3, :3]), turned[both]
        size = float(a.std() * b.std())
        out[n] = 1.0 - float(((a - a.mean()) * (b - b.mean())).mean()) / size if size > 0.0 else 1.0
    return out


def _angles(A: Array, B: Array) -> Array:
    """Return the angles (m,) between rotations (m, 3, 3)."""
    cosine = 0.5 * (np.einsum("mij,mij->m", A, B) - 1.0)
    return np.asarray(np.arccos(np.clip(cosine, -1.0, 1.0)))


def _fitted(
    stream: Stream, measured: Measured, t_s: Array, nominal: Mounts, how: Align, lag: float
) -> tuple[float, float, Array] | None:
    """Return the median error in m, the offset and base and tool of the fit from one lag; None where there is none."""
    inside = np.flatnonzero(covered(stream.t_s, t_s + lag))
    part = measured.take(inside)
    if len(part) < 12 or part.labels != measured.labels:
        return None
    F, _ = stream.at(t_s[inside] + lag)
    try:
        guess = closed_form(F, part, nominal, how)
        expected = _timed(stream, t_s[inside], lag, float(t_s.mean()))
        model = Model(measured=part, expected=expected, extra=(OFFSET, DRIFT))
        free = (*free_names(part, how), OFFSET)
        fit = fit_model(model, np.append(guess.vector, [0.0, 0.0]), free, settled=RANKED)
    except (NotConverged, Degenerate):
        return None
    if abs(fit.p[-2]) > 10.0 * LAG_S:  # ran off to another lag, which is looked at by itself
        return None
    size = np.linalg.norm(fit.residual[:, :3], axis=1)
    return float(np.median(size)), lag + float(fit.p[-2]), fit.p[:-2]


def _timed(stream: Stream, t_s: Array, offset_s: float, mid_s: float) -> Expected:
    """Return the expectation at measured times with two more parameters: change of the offset in s, drift in ppm."""

    def expected(p: Array) -> tuple[Array, Array]:
        since = 1e-6 * (t_s - mid_s)
        F, V = stream.at(t_s + offset_s + p[0] + p[1] * since)
        return F, np.stack([V, V * since[:, None]], axis=2)

    return expected


def _check(stream: Stream, measured: Measured, t_s: Array, fits: list[tuple[float, float, Array]]) -> None:
    """Raise Inconsistent where the best fit is none, Ambiguous where another one is as good."""
    error, offset, _ = fits[0]
    spread = float(np.median(np.linalg.norm(measured.xyz_m - np.median(measured.xyz_m, axis=0), axis=1)))
    if error > SENSELESS * spread:
        raise _apart(stream.t_s, t_s, f"at the best one they miss by {1e3 * error:.3g} mm")
    rivals = [fit for fit in fits if abs(fit[1] - offset) > APART_S and fit[0] < RIVAL * error + 1e-6]
    if rivals:
        raise Ambiguous(
            f"the motion repeats itself: offsets of {offset:.3f} s and {rivals[0][1]:.3f} s fit alike",
            consequence="Which rows belong together is not known; nothing is verified",
            cure="Move irregularly while recording, or record from rest to rest so that beginning and end are seen",
        )


def _apart(t_arm: Array, t_s: Array, why: str) -> ArmsightError:
    over = min(t_arm[-1], t_s[-1]) - max(t_arm[0], t_s[0])
    said = "" if over > 0.0 else "the streams do not overlap in time, and "
    return Inconsistent(
        f"{said}no time offset makes the measured path the arm's ({why}): measured from {t_s[0]:.6g} to "
        f"{t_s[-1]:.6g} s, the arm from {t_arm[0]:.6g} to {t_arm[-1]:.6g} s",
        consequence="Which rows belong together is not known; nothing is verified",
        cure="Check that both files are of the same motion and the arm's model is the right one; look for mirrored "
        "positions, millimetres, and readings in degrees",
    )


def _final(stream: Stream, measured: Measured, t_s: Array, p: Array, offset: float, how: Align) -> Clock:
    """Return the clock fitted to all rows, with a drift where one is proved."""
    inside = np.flatnonzero(covered(stream.t_s, t_s + offset))
    chosen = inside[_thinned(len(inside), FINAL_ROWS)]
    mid = float(0.5 * (t_s[chosen[0]] + t_s[chosen[-1]]))
    part = measured.take(chosen)
    model = Model(measured=part, expected=_timed(stream, t_s[chosen], offset, mid), extra=(OFFSET, DRIFT))
    free = (*free_names(part, how), OFFSET)
    plain = fit_model(model, np.append(p, [0.0, 0.0]), free)
    if any(OFFSET in group for group in plain.fit.undetermined):
        raise Degenerate(
            "the motion leaves the time offset open: what it does, base or tool do as well",
            consequence="Nothing is compared by time",
            cure="Move several joints, irregularly, with stops",
        )
    drifting = fit_model(model, plain.p, (*free, DRIFT))
    wide = np.sqrt(inflation(drifting.noise.whiten(drifting.residual)))
    drift, drift_std = float(drifting.p[-1]), wide * drifting.std(DRIFT)
    over = 1e-6 * abs(drift) * float(np.ptp(t_s[chosen]))
    proved = np.isfinite(drift_std) and abs(drift) > DRIFTS * drift_std and over > DRIFT_LEAST_S
    fit = drifting if proved else plain
    wide = np.sqrt(inflation(fit.noise.whiten(fit.residual)))
    found = offset + float(fit.p[-2])
    return Clock(
        offset_s=found,
        std_s=float(wide * fit.std(OFFSET)),
        mid_s=mid,
        drift_ppm=drift if proved else 0.0,
        p=fit.p[:-2],
        notes=_notes(stream, t_s, found, drift if proved else 0.0, over),
    )


def _notes(stream: Stream, t_s: Array, offset: float, drift_ppm: float, over_s: float) -> tuple[str, ...]:
    notes = []
    longest = max(float(np.ptp(t_s)), float(np.ptp(stream.t_s)))
    if abs(offset) > longest:
        notes.append(
            f"the time offset of {offset:.6g} s is larger than the run of {longest:.3g} s: the two files' clocks have "
            "another zero"
        )
    if drift_ppm:
        notes.append(f"the clocks drift by {drift_ppm:.3g} ppm, {1e3 * over_s:.2g} ms over the run; taken out")
    if isinstance(stream, PoseStream):
        notes.append("the offset to a commanded path holds the controller's lag too")
    return tuple(notes)


# What the arm, or the command, says at any time: pose and velocity between the rows, and where rows are missing.

GAP_PERIODS = 6.0
"""Rows further apart than so many usual periods leave a gap in which nothing is known."""
GAP_LEAST_S = 0.05
STEP_S = 1e-3
"""Over which the velocity of a commanded path is taken."""


def gap_s(t_s: Array) -> float:
    """Return the time between rows (n,) from which on nothing is known between them."""
    return max(GAP_PERIODS * float(np.median(np.diff(t_s))), GAP_LEAST_S)


def covered(t_s: Array, at_s: Array) -> NDArray[np.bool_]:
    """Return which times (m,) lie between rows t_s (n,) that are no gap apart."""
    i = np.clip(np.searchsorted(t_s, at_s, side="right") - 1, 0, len(t_s) - 2)
    inside = (at_s >= t_s[0]) & (at_s <= t_s[-1])
    return np.asarray(inside & (t_s[i + 1] - t_s[i] <= gap_s(t_s)))


@dataclass(frozen=True, eq=False)
class JointStream:
    """Joint values q (n, joints) at times t_s (n,), growing; bare: the arm without base and tool."""

    bare: Arm
    t_s: Array
    q: Array

    @cached_property
    def _curve(self) -> Akima1DInterpolator:
        return Akima1DInterpolator(self.t_s, self.q)

    def q_at(self, at_s: Array) -> Array:
        """Return joint values (m, joints); times beyond the rows take the first or last one's."""
        return np.asarray(self._curve(self._inside(at_s)))

    def speed_at(self, at_s: Array) -> Array:
        """Return joint speeds (m, joints)."""
        return np.asarray(self._curve(self._inside(at_s), 1))

    def acceleration_at(self, at_s: Array) -> Array:
        """Return joint accelerations (m, joints)."""
        return np.asarray(self._curve(self._inside(at_s), 2))

    def at(self, at_s: Array) -> tuple[Array, Array]:
        """Return F (m, 4, 4), base to flange, and its velocity (m, 6) in base axes."""
        F, J = fk_jacobian(self.bare, self.q_at(at_s))
        return F, np.einsum("mij,mj->mi", J, self.speed_at(at_s))

    def _inside(self, at_s: Array) -> Array:
        return np.clip(at_s, self.t_s[0], self.t_s[-1])


@dataclass(frozen=True, eq=False)
class PoseStream:
    """Commanded poses T (n, 4, 4) at times t_s (n,), growing."""

    t_s: Array
    T: Array

    @cached_property
    def _position(self) -> Akima1DInterpolator:
        return Akima1DInterpolator(self.t_s, self.T[:, :3, 3])

    @cached_property
    def _turn(self) -> Slerp:
        return Slerp(self.t_s, Rotation.from_matrix(self.T[:, :3, :3]))

    def at(self, at_s: Array) -> tuple[Array, Array]:
        """Return the commanded poses (m, 4, 4) and their velocity (m, 6) in their frame's axes."""
        t = np.clip(at_s, self.t_s[0] + STEP_S, self.t_s[-1] - STEP_S)
        F = np.tile(np.eye(4), (len(t), 1, 1))
        F[:, :3, 3] = self._position(t)
        F[:, :3, :3] = self._turn(t).as_matrix()
        turn = (self._turn(t + STEP_S) * self._turn(t - STEP_S).inv()).as_rotvec() / (2.0 * STEP_S)
        return F, np.concatenate([self._position.derivative()(t), turn], axis=1)


Stream = JointStream | PoseStream


def at_tool(F: Array, V: Array, x_m: Array) -> tuple[Array, Array]:
    """Return the positions (m, 3) and velocities (m, 3) of a point x_m (3,) of the flange."""
    arm = F[:, :3, :3] @ x_m
    return F[:, :3, 3] + arm, V[:, :3] - np.einsum("mij,mj->mi", skew(arm), V[:, 3:])
