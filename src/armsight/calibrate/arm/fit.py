"""One fit of an arm's parameters, with the noise estimated and gross errors held down; what stands at its limit; the
tool's points."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array
from armsight.calibrate.arm.model import ArmModel
from armsight.calibrate.arm.points import ArmPoints
from armsight.columns import POSITION, ROTATION_VECTOR
from armsight.defaults import ANGLE_RAD, JOINT_SCALE, LENGTH_M, SAG
from armsight.errors import Degenerate
from armsight.fields import Doc
from armsight.fitting import Fit, Loss, LossKind, Prior, Problem, Settings, solve
from armsight.fitting.quantiles import MEDIAN_3, chi2_ppf
from armsight.geometry import align_points
from armsight.kinematics import ToolPoint, fk
from armsight.records.output import Output, output

TURNS = 60
"""Turns of placing the base with the tools held, then the tools with the base held."""
ENOUGH = 200
"""Rows that a start is looked for with."""


def start(model: ArmModel, points: ArmPoints, like: Array | None = None) -> Array:
    """Return the parameters of the nominal geometry with base and tools put where they fit the positions best.

    By turns: base by Kabsch with the tool's points held, points by linear least squares with the base held; from the
    nominal tool, from the flange's origin and from points beside it, the best of all; or from the tools of `like` only.
    """
    if len(points) > ENOUGH:
        rows = np.linspace(0, len(points) - 1, ENOUGH).astype(np.intp)
        part = points.take(rows)
        points = part if part.labels == points.labels else points
    bare = model.arm_at(model.vector(RigidTransform.identity(), [RigidTransform.identity()] * len(model.labels)))
    F = fk(bare, points.q)  # base to flange
    which = np.array([model.labels.index(label) for label in points.point])
    size = max(model.arm.length_m, 1e-3)
    nominal, n = np.asarray(model.arm.T_flange_tool.translation), len(model.labels)
    beside = [nominal, np.zeros(3), *(0.5 * size * np.eye(3)), *(-0.5 * size * np.eye(3))]
    firsts = [np.tile(first, (n, 1)) for first in beside]
    if like is not None:
        firsts = [np.stack([model.pose(like, k + 1).translation for k in range(n)])]
    base, at = mounts_by_turns(F, points.xyz_m, which, firsts)
    turn = model.arm.T_flange_tool.rotation  # positions do not tell it, and what they do not tell stays nominal
    if points.rotation is not None:
        turn = Rotation.from_matrix(
            np.swapaxes(base.rotation.as_matrix() @ F[:, :3, :3], 1, 2) @ points.rotation
        ).mean()
    return model.vector(base, [RigidTransform.from_components(x, turn) for x in at])


def placed(there_m: Array, here_m: Array) -> RigidTransform:
    """Return the pose that takes positions (m, 3) to others. Raises Degenerate, in an arm's words."""
    try:
        return align_points(there_m, here_m).T_a_b
    except Degenerate:
        raise Degenerate(
            "the tool's positions lie on one line, or all in one place",
            consequence="The turn of the base about that line cannot be known",
            cure="Move at least two joints, or one far along an arc",
        ) from None


def mounts_by_turns(
    F: Array, xyz_m: Array, which: NDArray[np.intp], firsts: Sequence[Array]
) -> tuple[RigidTransform, Array]:
    """Return the base and the tool's points (k, 3) in flange axes that fit positions best.

    F (m, 4, 4): base to flange. xyz_m (m, 3): positions of the points which (m,), counted from 0. firsts, each (k, 3):
    where searches begin; the best of them counts. Raises Degenerate for positions on one line.
    """
    sums = _Sums.of(F, xyz_m, which, len(firsts[0]))

    def carried(at: Array) -> Array:
        return np.asarray(np.einsum("mij,mj->mi", F[:, :3, :3], at[which]) + F[:, :3, 3])

    def misfit(at: Array) -> float:
        x, y = xyz_m - xyz_m.mean(axis=0), carried(at)
        y = y - y.mean(axis=0)
        return float(((y @ _kabsch(x.T @ y).T - x) ** 2).sum())

    at = min(sums.turns(np.array(firsts)), key=misfit)
    return placed(xyz_m, carried(at)), at


@dataclass(frozen=True, slots=True, kw_only=True)
class _Sums:
    """All that turns need of the rows: both problems are linear in sums over them, which are made once.

    Positions x and the flange's p are counted from their means; R is the flange's rotation, k the tool's point. rows
    (3 k,): of each point, three times; r (3, 3 k): of R; rp (3 k,): of R' p; xp (9,): of x p'; xr (9, 3 k): of
    x_i R_jl; xx, pp: of squares.
    """

    rows: Array
    r: Array
    rp: Array
    xp: Array
    xr: Array
    xx: float
    pp: float

    @classmethod
    def of(cls, F: Array, xyz_m: Array, which: NDArray[np.intp], k: int) -> _Sums:
        x, R = xyz_m - xyz_m.mean(axis=0), F[:, :3, :3]
        p = F[:, :3, 3] - F[:, :3, 3].mean(axis=0)
        member = (which[:, None] == np.arange(k)).astype(np.float64)
        return cls(
            rows=np.repeat(member.sum(axis=0), 3),
            r=np.einsum("mk,mij->ikj", member, R).reshape(3, -1),
            rp=np.einsum("mk,mji,mj->ki", member, R, p).ravel(),
            xp=(x.T @ p).ravel(),
            xr=np.einsum("mk,mijl->ijkl", member, np.einsum("mi,mjl->mijl", x, R)).reshape(9, -1),
            xx=float((x**2).sum()),
            pp=float((p**2).sum()),
        )

    def turns(self, firsts: Array) -> Array:
        """Return the points (s, k, 3) after TURNS from each of s firsts, or as many as bring its RMS down.

        Each half of a turn is the exact minimum in its own unknowns, so that the misfit never rises.
        """
        a, n = firsts.reshape(len(firsts), -1), float(self.rows[::3].sum())
        out, going, rms = a.copy(), np.arange(len(a)), np.full(len(a), np.inf)
        cross, total = self._carried(a)
        for _ in range(TURNS):
            R = _kabsch(cross)
            # R' R is one, so each point is a mean, R' t being -total / n; one without rows stays as before
            sums = R.reshape(-1, 9) @ self.xr + (total / n) @ self.r - self.rp
            a = np.where(self.rows > 0.0, sums / np.maximum(self.rows, 1.0), a)
            t, (cross, total) = total, self._carried(a)
            # of fits to 1e-8 of the positions' spread only its size
            moved = (a * a) @ self.rows + 2.0 * (a @ self.rp) + self.pp + ((t - 2.0 * total) * t).sum(axis=1) / n
            squares = moved - 2.0 * (R * cross).sum(axis=(1, 2)) + self.xx
            before, rms = rms, np.sqrt(np.maximum(squares, 0.0) / (3.0 * n))
            out[going] = a
            live = before - rms >= 1e-7 * rms
            if not live.any():
                break
            if not live.all():
                a, cross, total, rms, going = a[live], cross[live], total[live], rms[live], going[live]
        return out.reshape(len(out), -1, 3)

    def _carried(self, a: Array) -> tuple[Array, Array]:
        """Return of what the flange carries the sums (s, 3, 3) of x times it, and its sums (s, 3)."""
        return (self.xp + a @ self.xr.T).reshape(-1, 3, 3), a @ self.r.T


def _kabsch(cross: Array) -> Array:
    """Return the rotations (..., 3, 3) that fit sums of products best (Kabsch 1976), the reflection excluded."""
    U, _, Vt = np.linalg.svd(cross)
    U[..., 2] *= np.sign(np.linalg.det(U @ Vt))[..., None]
    return np.asarray(U @ Vt)


FIT_ROUNDS = 4
"""Fits with the noise of the one before; the ratio of the two noises settles in two or three."""
SUNK_RAD = 1e-6
"""Joints that sag by so much less or more than the round before have settled: 1e-6 m at a metre."""
LEAST_POSITION_M = 1e-6
"""No position of a tool is measured better: interferometers say 1e-6 m, arms come back to 1e-5. Positions that agree
better (a simulation's) count as so good, or the fit is numerically stiff and stops before its minimum."""
LEAST_TURN_RAD = 3e-5
"""No arm turns its tool more exactly: six arc seconds, the step of a good joint encoder, and 0.03 mm at a metre.
Rotations that agree better (a simulation's) and are weighed as they claim (1e-6) leave 0.9 mm where 0.02 can be had."""

ADDED_TRIED = 80
"""Sizes of what is added to covariances, a seventh apart over five decades: weights do not hang on it more finely."""
TAILS = 5.0
"""Degrees of freedom of errors' tails: of normal ones the answer is right to a tenth, gross ones count little."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Tolerance:
    """What a nominal arm is believed to: standard deviations of its lengths, angles, joint scales and couplings.

    sag: rad per metre of lever of the weight that a joint carries. A humanoid's shoulder carries 10 kg on 1e-3 rad/Nm:
    0.1; an industrial arm's gives way by 0.001.
    """

    length_m: float = LENGTH_M
    angle_rad: float = ANGLE_RAD
    scale: float = JOINT_SCALE
    coupling: float = 0.1
    sag: float = SAG

    def of(self, name: str) -> float:
        """Return the standard deviation of a parameter by its name."""
        if name.endswith(".scale"):
            return self.scale
        if name.endswith(".sag"):
            return self.sag
        if ".by_" in name:
            return self.coupling
        return self.length_m if name.endswith("_m") else self.angle_rad


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ArmFit:
    """Parameters p, the fit they came from, and the noise of positions and rotations found.

    sigma_m: of rows with covariances what is added to these. free: names of what was fitted, base and tools included.
    prior_weight: 1 / tolerance^2 of each, 0 without one.
    """

    p: Array
    fit: Fit
    sigma_m: float
    sigma_rad: float
    free: tuple[str, ...]
    prior_weight: Array


def fit_arm(model: ArmModel, points: ArmPoints, guess: Array, free: Collection[str], tolerance: Tolerance) -> ArmFit:
    """Return the parameters named in free, and base and tools, by maximum likelihood with priors from the tolerances.

    Base and tools may leave directions open (a tool on the last
    axis); they then stay near the guess. Raises NotConverged.
    """
    mounts = [name for name in model.mounts if points.rotation is not None or not is_tool_turn(name)]
    fixed = frozenset(model.names) - set(free) - set(mounts)
    priors = {name: Prior(mean=0.0, sigma=tolerance.of(name)) for name in free}
    rows = 6 if points.rotation is not None else 3
    # of good rows one in a hundred is beyond the scale and held down, which costs the answer next to nothing
    loss = Loss(kind=LossKind.HUBER, scale=float(np.sqrt(chi2_ppf(0.99, rows))), block=rows)
    sigma = estimate_noise(model, guess, points, len(free) + len(mounts))
    p = guess
    lever = model.lever_m(p, points)
    for _ in range(FIT_ROUNDS):
        problem = Problem(
            names=model.names,
            guess=p,
            n_residuals=rows * len(points),
            fixed=fixed,
            priors=priors,
            loss=loss,
            evaluate=lambda q, _, s=sigma, held=lever: model.evaluate(q, points, s[0], s[1], held),  # type: ignore[misc]
            retract=model.retract,
        )
        fit = solve(problem, Settings(allow_undetermined=True, max_iterations=200))
        p = fit.shared
        before, sigma = sigma, estimate_noise(model, p, points, len(free) + len(mounts))
        held, lever = lever, model.lever_m(p, points)
        sunk = float(np.abs(model.give(p) * (lever - held)).max())
        if max(abs(np.log(np.divide(sigma, before)))) < 0.01 and sunk < SUNK_RAD:
            break
    fitted = tuple(name for name in model.names if name not in fixed)
    weight = np.array([tolerance.of(name) ** -2 if name in priors else 0.0 for name in fitted])
    return ArmFit(p=p, fit=fit, sigma_m=sigma[0], sigma_rad=sigma[1], free=fitted, prior_weight=weight)


def is_tool_turn(name: str) -> bool:
    """Tell whether a parameter turns a tool, which positions of its one point do not show."""
    return name.startswith("tool") and name.rsplit(".", 1)[1] in ROTATION_VECTOR


def estimate_noise(model: ArmModel, p: Array, points: ArmPoints, n_free: int) -> tuple[float, float]:
    """Return the standard deviations of one coordinate of position and of rotation, from the medians of the residuals.

    Of rows with covariances that of position is what these leave unexplained. n_free: parameters that were fitted to
    these rows.
    """
    position, turn = model.errors(p, points)
    m = len(points)
    rows = 6 if points.rotation is not None else 3
    # residuals are smaller than the noise by what was fitted to them: N / (N - p), at most twofold
    spent = np.sqrt(rows * m / max(rows * m - n_free, 0.25 * rows * m))

    def one(r: Array, least: float) -> float:
        return max(float(np.sqrt(np.median((r**2).sum(axis=1)) / MEDIAN_3) * spent), least)

    sigma_m = one(position, LEAST_POSITION_M) if points.covariance is None else added_noise(position * spent, points)
    return sigma_m, one(turn, LEAST_TURN_RAD) if points.rotation is not None else 1.0


def added_noise(position: Array, points: ArmPoints) -> float:
    """Return what is to be added to one coordinate of all rows' covariances so that they explain errors (m, 3).

    Maximum likelihood with Student's tails: all rows have a say, so that a few whose covariances are too small cannot
    take the fit over, and gross errors have little.
    """
    largest = float(np.sqrt((position**2).mean()))
    candidates = np.geomspace(LEAST_POSITION_M, max(largest, 2.0 * LEAST_POSITION_M), ADDED_TRIED)
    cost = np.empty(ADDED_TRIED)
    for k, sigma in enumerate(candidates.tolist()):
        # -2 log of Student's density in three dimensions, log det V + (nu + 3) log(1 + r' V^-1 r / nu) (Lange, Little,
        # Taylor 1989)
        q = (points.whiten(position, sigma) ** 2).sum(axis=1)
        size = np.linalg.slogdet(points.covariance + sigma**2 * np.eye(3))[1]
        cost[k] = float((size + (TAILS + 3.0) * np.log1p(q / TAILS)).sum())
    return float(candidates[np.argmin(cost)])


# Corrections that stand at the limit of what the nominal arm is believed to.

BINDS = 0.9
"""Share of its tolerance from which a correction stands at the limit. What is freed is known to half its tolerance, so
the tolerance holds a correction back by a fifth at most: one that is really beyond it is not missed."""


@output
class LimitReached(Output):
    """A correction as large as the nominal arm is believed to."""

    name: Annotated[str, Doc("The parameter.")]
    change: Annotated[float, Doc("Its change to the nominal arm, unit in the name.")]
    limit: Annotated[float, Doc("What the nominal arm is believed to, unit in the name.")]
    flag: Annotated[str | None, Doc("The option that raises it; null where there is none.")]

    @property
    def sentence(self) -> str:
        """What to tell the person, without a full stop."""
        factor, unit = (1e3, " mm") if self.name.endswith("_m") else (float(np.rad2deg(1.0)), " degrees")
        if self.flag is None:
            factor, unit = 1.0, ""
        said = f"{self.name} stands at its limit of {self.limit * factor:.3g}{unit} (it changed by "
        said += f"{self.change * factor:.3g}{unit}): "
        if self.name.endswith(".sag"):
            return said + "check the links' masses, or whether the tool is heavier than they say"
        if self.flag is None:
            return said + "check the gear ratio and the unit of the joint's readings"
        return said + f"raise {self.flag} if the arm may be so far off"


def limits_reached(model: ArmModel, p: Array, free: Sequence[str], tolerance: Tolerance) -> tuple[LimitReached, ...]:
    """Return the freed parameters whose change in p (P,) stands at the limit of its tolerance, or beyond."""
    found = []
    for name in free:
        change, limit = float(p[model.names.index(name)]), tolerance.of(name)
        if abs(change) >= BINDS * limit:
            found.append(LimitReached(name=name, change=change, limit=limit, flag=_flag(name)))
    return tuple(found)


def _flag(name: str) -> str | None:
    if name.endswith("_m"):
        return "--tolerance-mm"
    return "--tolerance-deg" if name.endswith("_rad") else None


# Where the tool's points are on the flange, with standard deviations.


def tool_points(model: ArmModel, fitted: ArmFit) -> tuple[ToolPoint, ...]:
    """Return the positions of all points with a name, in flange axes; none where the one point has no name.

    Standard deviations hold the uncertainty of the fitted geometry too; they are infinite where a fit leaves a
    direction open.
    """
    std = fitted.fit.std()
    return tuple(
        ToolPoint(
            name=label,
            xyz_m=np.asarray(model.pose(fitted.p, k).translation),
            std_m=np.array([std.get(f"tool:{label}.{key}", np.inf) for key in POSITION]),
        )
        for k, label in enumerate(model.labels, start=1)
        if label
    )
