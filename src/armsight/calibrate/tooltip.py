"""Where a tool's end is: in the target's frame (the driver of Pachidis 2005 section 4.1) or the flange's (TCP).

The end P rests on a fixed point while the target (or the flange) is turned about it: every pose T_i says
R_i tip + t_i = point. Pachidis takes the point from a measurement and averages (eqs. 10-13), so that an error of the
point goes straight into the tip; with the point unknown as well (MATH 3.2) no measurement of it is needed, and one
that exists counts for as much as it is sure. Poses with times are of one recording: their errors may drift.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array
from armsight.calibrate.correlation import widened
from armsight.calibrate.tooltip_result import ToolTipResult, require_one_tool, require_point_there
from armsight.calibrate.tooltip_rows import (
    FAR,
    MIN_POSES,
    PivotStream,
    TipFit,
    checked_times,
    place_numbers,
    places_of,
    slopes,
)
from armsight.defaults import TIP_GOAL_M
from armsight.errors import Degenerate, Inconsistent, NotEnoughData
from armsight.fitting.groups import leave_one_out, regions, whitener
from armsight.fitting.quantiles import f_isf, student_factor
from armsight.geometry.poses import skew
from armsight.records import NamedCovariance, frozen_array
from armsight.records.checks import FAR_M, TOOL_M, check_metres, check_spread
from armsight.units import DEG, MM

NAMES = ("tip.x_m", "tip.y_m", "tip.z_m", "point.x_m", "point.y_m", "point.z_m")

LEAST_TURN_RAD = 2.5 * DEG
"""Least root-mean-square turn about the second axis: below it noise is blown up more than 20 times."""

LEAST_NOISE_M2 = 1e-24
"""Variance that exact poses have all the same."""

LEAST_SHARE = 0.6
FALSE_ALARM = 1e-5
"""Chance that any pose of a good recording is called an outlier."""

UNRELATED = 0.25
"""Residuals above this share of how far the frame moved, and above LOOSE_M, mean that there is no resting point."""

LOOSE_M = 2.0 * MM
TIP_ROUNDS = 20
TIP_SETTLED = 1e-10
"""Weights follow the tip's position; the fit is settled when it moves by less (m)."""

NOISE_M = 0.1 * MM
NOISES_RAD_M = (1.0, 3.0, 10.0, 30.0, 100.0)
"""Noise of orientation over that of position, weighed by their likelihood where poses bring no covariance; their common
size is estimated. The likeliest alone holds 87 % inside 95 % with four poses, and 91 with five."""

WELL_TILTED_RAD = 10.0 * DEG
"""Root-mean-square turn about the second axis below which noise of the poses alone may hide the resting point."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MeasuredPoint:
    """The point that the tool rests on, measured: xyz_m (3,) in the poses' parent frame, sigma_m of one coordinate."""

    xyz_m: Array
    sigma_m: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "xyz_m", frozen_array("xyz_m", self.xyz_m, (3,)))
        if not self.sigma_m > 0.0:
            raise Inconsistent(
                f"a point measured to {self.sigma_m} m is not believed",
                consequence="It is not used",
                cure="Give the standard deviation of one coordinate",
            )

    def information(self) -> tuple[Array, Array]:
        """Return (tip, point) as it wants them, (6,), and how sure it is of each, (6, 6) in 1/m^2: of the tip not."""
        sure = np.diag([0.0, 0.0, 0.0, *[1.0 / self.sigma_m**2] * 3])
        return np.concatenate([np.zeros(3), self.xyz_m]), sure


def calibrate_tooltip(
    poses: RigidTransform | Sequence[RigidTransform],
    covariances: ArrayLike | None = None,
    point: MeasuredPoint | None = None,
    t_s: ArrayLike | None = None,
) -> ToolTipResult:
    """Return the tip from poses of the turned frame in a fixed one, the tip resting on one point.

    covariances: (n, 6, 6) of the poses, translation then rotation vector in the parent's axes; without them one noise
    of position and orientation is assumed and its size estimated. point: where it rests, if measured; without a
    sigma worth having leave it out. t_s (n,): times in s, where the poses are of one recording: how long their errors
    are alike is estimated then, and they are weighed and believed by it; without, how much regions of the turning
    differ (an arm's own errors) widens the covariance. Raises NotEnoughData below MIN_POSES,
    Degenerate for too little turning or one axis, Inconsistent where the poses share no point.
    """
    R, t = _split(poses)
    _require_metres(t, point)
    times = None if t_s is None else checked_times(np.asarray(t_s, float), len(R))
    C = None if covariances is None else frozen_array("covariances", covariances, (len(R), 6, 6))
    _require_turning(_turns(R))
    if point is not None:
        require_point_there(calibrate_tooltip(poses, covariances, None, t_s), point.xyz_m, point.sigma_m)
    place = np.arange(len(R)) if times is not None else place_numbers(R)
    poses_there, fine = places_of(R, t, C, place)
    keep_places, (x, cov, e, V, _, _) = _agreed(*poses_there, point)
    keep, used = fine & keep_places[place], poses_there[0][keep_places]
    turn = _require_turning(_turns(used))
    require_one_tool(R[keep], t[keep], np.flatnonzero(keep), None if times is None else times[keep])
    _require_point(e[keep_places], poses_there[1][keep_places], len(e), turn[1], cov)
    check_metres(np.linalg.norm(x[:3]), TOOL_M, "the tip would be off the turned frame by")
    prior = None if point is None else point.information()
    if times is not None:
        found = PivotStream(R=R, t=t, V=V, t_s=times, prior=prior).fit(x, keep, _turned(R, keep))
    else:
        found = _weighed(*poses_there, keep_places, point)
    e = R @ found.x[:3] + t - found.x[3:]
    return ToolTipResult(
        tip_m=found.x[:3],
        point_m=found.x[3:],
        covariance=NamedCovariance(names=NAMES, matrix=found.C),
        residuals_m=e,
        left_out_m=found.left_out_m if times is not None else e + np.where(keep[:, None], found.left_out_m[place], 0.0),
        used=keep,
        rejected_rows=_rejected(e, keep),
        rotation_excitation_rms_rad=turn,
        mean_tip_m=None if point is None else mean_tip(R[keep], t[keep], point.xyz_m),
        correlation=found.correlation,
        n_places=None if times is not None else len(used),
    )


def _rejected(e: Array, keep: NDArray[np.bool_]) -> tuple[tuple[int, str], ...]:
    """Return the rows left out, from 0, and why, from residuals (n, 3)."""
    off = (np.linalg.norm(e, axis=1) / MM).tolist()
    return tuple(
        (i, f"the tip is {off[i]:.3g} mm from the point where the others rest") for i in np.flatnonzero(~keep).tolist()
    )


def _weighed(R: Array, t: Array, C: Array | None, keep: NDArray[np.bool_], point: MeasuredPoint | None) -> TipFit:
    """Return the tip of poses of one place each; left_out_m (n, 3) is by how much its residual grows without a pose."""
    models = _models(R, t, C, keep, point)
    steps, weight = np.array([fit[0] for _, _, fit in models]), np.array([weight for weight, _, _ in models])
    x = np.asarray(weight @ steps)
    # what is not known of the ratio of the noises widens the answer, and Student's factor what is not of their size;
    # the ratio, where it is looked for, costs a degree of freedom: without that 92.7 % of four or five poses are inside
    _, likeliest, e, V, scale2, dof = models[0][2]
    student = float(student_factor(dof - (len(models) > 1))) ** 2
    spread = steps - x
    cov = student * np.einsum("k,kab->ab", weight, np.array([fit[1] for _, _, fit in models]))
    cov = cov + (spread.T * weight) @ spread
    part = regions(R[keep].reshape(-1, 9))
    once = student * likeliest
    cov = cov + widened(once, slopes(R[keep]), V[keep] * scale2, e[keep], part) - once
    step, _ = _left_out(R, e, V * scale2, likeliest, keep)
    grown = np.einsum("nia,na->ni", slopes(R), step)
    return TipFit(x=x, C=cov, left_out_m=grown, correlation=None)


_Fit = tuple[Array, Array, Array, Array, float, int]


def _agreed(R: Array, t: Array, C: Array | None, point: MeasuredPoint | None) -> tuple[NDArray[np.bool_], _Fit]:
    """Return which poses agree on a tip, and the fit to them; Inconsistent where too few do."""
    n = len(R)
    keep = _consensus(R, t)
    C = _models(R, t, C, keep, point)[0][1]
    for _ in range(TIP_ROUNDS):
        fit = _fit(R, t, C, keep, point)
        _, cov, e, V, scale2, dof = fit
        _, q = _left_out(R, e, V * scale2, cov, keep)
        limit = 3.0 * float(f_isf(FALSE_ALARM / n, 3, dof))
        fitting = q <= limit
        if (fitting == keep).all():
            break
        if fitting.sum() < max(MIN_POSES, LEAST_SHARE * n):
            raise _no_point(int(fitting.sum()), n)
        keep = fitting
    return keep, fit


def mean_tip(R: Array, t: Array, point_m: Array) -> Array:
    """Return the tip of Pachidis eqs. (12), (13): the mean of T_i^-1 point, R (n, 3, 3), t (n, 3)."""
    return np.asarray(np.einsum("nji,nj->ni", R, point_m - t).mean(axis=0))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TipRecording:
    """Poses recorded so far while the operator pivots, and what they are worth; every `with_pose` is a new one."""

    poses: tuple[RigidTransform, ...] = ()
    t_s: tuple[float, ...] = ()
    point: MeasuredPoint | None = None
    good_m: float = TIP_GOAL_M
    latest: ToolTipResult | None = field(default=None)
    waiting: str = "turn the tool about its end"

    def with_pose(self, pose: RigidTransform, t_s: float | None = None) -> TipRecording:
        """Return the recording with one more pose, and the calibration that it now allows. t_s: when it was measured,
        in s; poses are taken as of one recording where all come with one."""
        poses = (*self.poses, pose)
        times = self.t_s if t_s is None else (*self.t_s, t_s)
        try:
            timed = times if len(times) == len(poses) else None
            latest, waiting = calibrate_tooltip(poses, point=self.point, t_s=timed), ""
        except (NotEnoughData, Degenerate, Inconsistent) as error:
            latest, waiting = None, error.cause
        return TipRecording(
            poses=poses, t_s=times, point=self.point, good_m=self.good_m, latest=latest, waiting=waiting
        )

    @property
    def std_m(self) -> float:
        """The largest standard deviation of the tip in m; infinite while nothing can be said."""
        return float("inf") if self.latest is None else max(self.latest.std.values())

    @property
    def good_enough(self) -> bool:
        """Whether the standard deviation has fallen below good_m."""
        return self.std_m <= self.good_m

    def progress(self) -> str:
        """Return one line for the operator."""
        if self.latest is None:
            return f"{len(self.poses)} poses: {self.waiting}"
        state = "good enough" if self.good_enough else f"aim: {self.good_m / MM:.3g} mm"
        return f"{len(self.poses)} poses: tip known to {self.std_m / MM:.3g} mm ({state})"


def _split(poses: RigidTransform | Sequence[RigidTransform]) -> tuple[Array, Array]:
    """Return rotations (n, 3, 3) and translations (n, 3)."""
    if isinstance(poses, RigidTransform):
        M = np.atleast_3d(poses.as_matrix()) if not poses.single else poses.as_matrix()[None]
    else:
        M = np.stack([pose.as_matrix() for pose in poses]) if len(poses) else np.empty((0, 4, 4))
    if len(M) < MIN_POSES:
        raise NotEnoughData(
            f"{len(M)} poses, of which {MIN_POSES} are the fewest that can be checked",
            consequence="No tip is given",
            cure="Turn the tool about its end and record 20 to 50 poses",
        )
    if not np.isfinite(M).all():
        raise Inconsistent(f"pose {int(np.argmax(~np.isfinite(M).all(axis=(1, 2)))) + 1} is not finite")
    return M[:, :3, :3], M[:, :3, 3]


def _models(
    R: Array, t: Array, C: Array | None, keep: NDArray[np.bool_], point: MeasuredPoint | None
) -> list[tuple[float, Array, _Fit]]:
    """Return (weight, covariances (n, 6, 6), fit) of each ratio of the noises, the likeliest first, by their restricted
    likelihood for the kept poses; of covariances that are given, these alone."""
    each = np.array([np.diag([1.0] * 3 + [ratio**2] * 3) for ratio in NOISES_RAD_M]) * NOISE_M**2
    given = [np.tile(one, (len(R), 1, 1)) for one in each] if C is None else [C]
    fits = [_fit(R, t, one, keep, point) for one in given]
    likelihood = np.empty(len(fits))
    for k, (_, cov, _, V, scale2, dof) in enumerate(fits):
        scale2 = max(scale2, 1e-300)
        # the restricted likelihood with the common factor at its best value, which leaves dof log scale2 of it
        logdet = np.linalg.slogdet(V[keep])[1].sum() - np.linalg.slogdet(cov / scale2)[1]
        likelihood[k] = -0.5 * (float(logdet) + dof * float(np.log(scale2)))
    weight = np.exp(likelihood - likelihood.max())
    weight = weight / weight.sum()
    return [(float(weight[k]), given[k], fits[k]) for k in np.argsort(-weight, kind="stable").tolist()]


def _fit(R: Array, t: Array, C: Array, keep: NDArray[np.bool_], point: MeasuredPoint | None) -> _Fit:
    """Return x (6,) = tip, point; its covariance; residuals (n, 3); their covariances V (n, 3, 3) in given units; the
    estimated factor on V; degrees of freedom."""
    n = len(R)
    J = slopes(R)
    x = np.asarray(np.linalg.lstsq(J[keep].reshape(-1, 6), -t[keep].reshape(-1), rcond=None)[0], np.float64)
    dof = max(3 * int(keep.sum()) - 6, 1)
    for _ in range(TIP_ROUNDS):
        # the noise of the end hangs on the lever, and so on the tip: again until it stays
        lever = np.einsum("nij,j->ni", R, x[:3])  # (n, 3)
        A = np.concatenate([np.tile(np.eye(3), (n, 1, 1)), -skew(lever)], axis=2)  # (n, 3, 6): dt + dw x lever
        V = A @ C @ A.transpose(0, 2, 1)
        W = np.linalg.inv(V)
        WJ = W[keep] @ J[keep]
        H = np.einsum("nia,nib->ab", J[keep], WJ)
        g = -np.einsum("nia,ni->a", WJ, t[keep])
        new = np.linalg.solve(H, g)
        e = np.einsum("nia,a->ni", J, new) + t
        scale2 = float(np.einsum("ni,nij,nj->", e[keep], W[keep], e[keep])) / dof
        if point is not None:  # a measurement of the point, in its own units: the poses' factor must be known first
            wanted, sure = point.information()
            H = H + sure * max(scale2, 1e-30)
            new = np.linalg.solve(H, g + sure @ wanted * max(scale2, 1e-30))
            e = np.einsum("nia,a->ni", J, new) + t
        moved = float(np.abs(new - x).max())
        x = new
        if moved < TIP_SETTLED:
            break
    return x, np.linalg.inv(H) * scale2, e, V, scale2, dof


def _left_out(R: Array, e: Array, V: Array, cov: Array, keep: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Return the steps (n, 6) to the fits without each pose, and the squared length (n,) of each residual by them,
    against its own noise V (n, 3, 3) and the answer's."""
    W = whitener(V + LEAST_NOISE_M2 * np.eye(3))
    return leave_one_out(np.einsum("nij,nj->ni", W, e), W @ slopes(R), cov, keep)


def _consensus(R: Array, t: Array) -> NDArray[np.bool_]:
    """Return the poses that agree with the best of many small samples (least median of squares)."""
    n = len(R)
    rng = np.random.default_rng(41)
    order = np.lexsort(t.T)  # the answer does not depend on the order of the poses
    J = slopes(R)[order]
    b = t[order]
    samples = np.argsort(rng.random((60, n)), axis=1)[:, : min(n, 5)]
    A = J[samples].reshape(len(samples), -1, 6)
    # five poses a sample, R tip + t = point solved for each of them at once
    H = A.transpose(0, 2, 1) @ A + 1e-12 * np.eye(6)
    x = -np.linalg.solve(H, A.transpose(0, 2, 1) @ b[samples].reshape(len(samples), -1, 1))[:, :, 0]
    errors = np.linalg.norm(np.einsum("nia,sa->sni", J, x) + b, axis=2)  # (S, n)
    best = errors[int(np.argmin(np.median(errors, axis=1)))]
    keep = np.empty(n, bool)
    keep[order] = best <= FAR * max(float(np.median(best)), 1e-12)
    return keep


def _turns(R: Array) -> Array:
    """Return the root mean square turn (3,) about the principal axes, falling, in rad."""
    rotations = Rotation.from_matrix(R)
    w = (rotations.mean().inv() * rotations).as_rotvec()
    w = w - w.mean(axis=0)
    return np.sqrt(np.maximum(np.linalg.eigvalsh(w.T @ w / len(w))[::-1], 0.0))


def _turned(R: Array, keep: NDArray[np.bool_]) -> Array:
    """Return how far each frame (n,) is turned from the mean of the kept ones, in rad."""
    rotations = Rotation.from_matrix(R)
    return np.asarray((rotations[np.flatnonzero(keep)].mean().inv() * rotations).magnitude())


def _require_metres(t: Array, point: MeasuredPoint | None) -> None:
    """Raise Inconsistent where the frame's positions (n, 3) or the point are so far away that they must be mm."""
    check_spread(t, "the turned frame's positions")
    check_metres(np.linalg.norm(t, axis=1), FAR_M, "the turned frame is away by")
    if point is not None:
        check_metres(np.linalg.norm(point.xyz_m), FAR_M, "the point that the tip rests on is away by")


def _require_turning(turn: Array) -> Array:
    if turn[1] >= LEAST_TURN_RAD:
        return turn
    what = "about one axis only" if turn[0] >= LEAST_TURN_RAD else f"by only {turn[0] / DEG:.2g} degrees"
    raise Degenerate(
        f"the tool turns {what}",
        consequence="Where its end is along that axis cannot be known; no tip is given",
        cure="Tilt the tool by 20 degrees and more in at least two directions while its end stays on the point",
    )


def _require_point(e: Array, t: Array, n: int, turn_rad: float, cov: Array) -> None:
    """Raise where the residuals (k, 3) are as large as the motion of the frame (k, 3): Degenerate where the tool turned
    so little that noise of the poses is enough for it, else Inconsistent. cov (6, 6): of tip and point."""
    std_m = float(np.sqrt(np.diag(cov)[:3].max()))
    rms, moved = (float(np.sqrt((v**2).sum(axis=1).mean())) for v in (e, t - t.mean(axis=0)))
    if not (rms > LOOSE_M and rms > UNRELATED * moved):
        return
    if turn_rad < WELL_TILTED_RAD:
        raise Degenerate(
            f"the tool turns by only {turn_rad / DEG:.2g} degrees (RMS), and the poses scatter by {rms / MM:.2g} mm "
            "about one point",
            consequence=f"Its end would be known to {std_m / MM:.2g} mm at best; no tip is given",
            cure="Tilt the tool by 25 degrees and more in at least two directions while its end stays on the point",
        )
    raise _no_point(int((np.linalg.norm(e, axis=1) <= LOOSE_M).sum()), n)


def _no_point(agree: int, n: int) -> Inconsistent:
    return Inconsistent(
        f"only {agree} of {n} poses share one resting point of the tip",
        consequence="The tip moved, or the poses do not belong to one recording; no tip is given",
        cure="Keep the end of the tool on one point, a small cone or centre punch, and record again",
    )
