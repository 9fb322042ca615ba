"""Expected against measured: T_measured = base * F * tool, with base, tool and a few more parameters to be found."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array
from armsight.columns import POSE6
from armsight.fitting import Evaluation, Fit, Loss, LossKind, Problem, Settings, solve
from armsight.fitting.groups import whitener
from armsight.fitting.quantiles import MEDIAN_3, chi2_ppf
from armsight.geometry.poses import skew, stepped
from armsight.kinematics import Arm, link_frames
from armsight.verify.records import Measured

Expected = Callable[[Array], tuple[Array, Array]]
"""More parameters (k,) -> F (m, 4, 4), base to flange, and its derivative (m, 6, k): (dt, dw) of the flange in base
axes."""

LEAST_SIGMA = 1e-9
"""Noise (m, rad) of data without any; a test's, never a measurement's."""
ROUNDING = 2e-9
"""Share of a variance that is added to it: twice what files may be off by (NOT_POSITIVE of store.covariances)."""
NOISE_ROUNDS = 5
SETTLED = 0.01


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mounts:
    """Where the base stands in the measuring frame, and each measured point or target on the flange."""

    base: RigidTransform
    tools: tuple[RigidTransform, ...]

    @property
    def vector(self) -> Array:
        """Positions and rotation vectors of base and tools, (6 + 6 k,)."""
        return np.concatenate([np.r_[T.translation, T.rotation.as_rotvec()] for T in (self.base, *self.tools)])

    @classmethod
    def of(cls, p: Array, n_tools: int) -> Mounts:
        """Return what a vector says."""
        parts = np.array(p[: 6 * (n_tools + 1)]).reshape(-1, 6)
        poses = [RigidTransform.from_components(v[:3], Rotation.from_rotvec(v[3:])) for v in parts]
        return cls(base=poses[0], tools=tuple(poses[1:]))


def mount_names(labels: tuple[str, ...]) -> tuple[str, ...]:
    """Return the names of the parameters of base and tools."""
    tools = ["tool" if not label else f"tool:{label}" for label in labels]
    return tuple(f"{part}.{key}" for part in ("base", *tools) for key in POSE6)


def nothing_more(F: Array) -> Expected:
    """Return an expectation without parameters of its own."""
    none = np.zeros((len(F), 6, 0))
    return lambda _: (F, none)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Model:
    """Measurements and what is expected of them; extra: names of the expectation's own parameters."""

    measured: Measured
    expected: Expected
    extra: tuple[str, ...] = ()
    _which: NDArray[np.intp] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_which", self.measured.which)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all parameters: base, tools, then the expectation's."""
        return (*mount_names(self.measured.labels), *self.extra)

    @property
    def n_mounts(self) -> int:
        """How many parameters base and tools have."""
        return 6 * (1 + len(self.measured.labels))

    @property
    def rows(self) -> int:
        """Residuals of one measurement: 6, or 3 of a position."""
        return 3 if self.measured.rotation is None else 6

    def linearised(self, p: Array) -> tuple[Array, Array]:
        """Return measured minus expected (m, rows) and the derivative (m, rows, P) of the expected.

        In the measuring frame's axes: m, and a rotation vector in rad.
        """
        F, C = self.expected(p[self.n_mounts :])
        mounts = np.array(p[: self.n_mounts]).reshape(-1, 6)
        turns = Rotation.from_rotvec(mounts[:, 3:]).as_matrix()
        R_base, t_base = turns[0], mounts[0, :3]
        x = mounts[1:, :3][self._which]
        R = R_base @ F[:, :3, :3]  # of the flange
        arm = np.einsum("mij,mj->mi", R, x)  # flange to tool
        origin = F[:, :3, 3] @ R_base.T + t_base
        position = origin + arm
        J = np.zeros((len(F), 6, len(p)))
        J[:, :3, :3] = np.eye(3)
        J[:, :3, 3:6] = -skew(position - t_base)
        J[:, 3:, 3:6] = np.eye(3)
        for k in range(len(mounts) - 1):
            mine, at = self._which == k, 6 * (k + 1)
            J[mine, :3, at : at + 3] = R[mine]
            J[mine, 3:, at + 3 : at + 6] = R[mine]
        v, w = R_base @ C[:, :3], R_base @ C[:, 3:]
        J[:, :3, self.n_mounts :] = v - skew(arm) @ w
        J[:, 3:, self.n_mounts :] = w
        off = self.measured.xyz_m - position
        if self.measured.rotation is None:
            return off, J[:, :3]
        R_tool = turns[1:][self._which]
        turn = Rotation.from_matrix(self.measured.rotation @ (R @ R_tool).transpose(0, 2, 1)).as_rotvec()
        return np.concatenate([off, turn], axis=1), J

    def retract(self, p: Array, local: Array, step: Array, step_local: Array) -> tuple[Array, Array]:
        """Move by a step: poses as t + dt, Exp(dw) R, all else by addition."""
        return stepped(p, step, range(3, self.n_mounts, 6)), local + step_local


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Noise:
    """Standard deviations (m, 2) of one coordinate in m and of one turn in rad: of the measurement where that is known,
    with extra (2,) for all that it does not explain, alike in all directions. covariance (m, 6, 6): of the measurement,
    by which residuals are whitened; None where nobody says."""

    measurement: Array
    extra: Array
    covariance: Array | None = None
    _whitener: Array | None = field(init=False, repr=False, default=None)

    def __post_init__(self) -> None:
        if self.covariance is not None:
            floor = np.repeat(np.maximum(self.extra, LEAST_SIGMA) ** 2, 3)
            own = self.covariance * (1.0 + ROUNDING * np.eye(6))  # (m, 6, 6)
            object.__setattr__(self, "_whitener", whitener(own + np.diag(floor)))

    @classmethod
    def of(cls, measured: Measured, extra: Array) -> Noise:
        """Return the noise of measurements."""
        return cls(measurement=measurement_std(measured), extra=extra, covariance=measured.covariance)

    @property
    def sigma(self) -> Array:
        """Both together, (m, 2)."""
        return np.asarray(np.maximum(np.hypot(self.measurement, self.extra), LEAST_SIGMA))

    def whiten(self, a: Array) -> Array:
        """Return residuals (m, rows, ...) in standard deviations."""
        if self._whitener is not None:
            rows = a.shape[1]  # of a lower triangle the first rows whiten the position alone
            W = self._whitener[:, :rows, :rows]
            return np.asarray((W @ a.reshape(len(a), rows, -1)).reshape(a.shape))
        sigma = np.repeat(self.sigma, 3, axis=1)[:, : a.shape[1]]
        return np.asarray(a / sigma.reshape(*sigma.shape, *[1] * (a.ndim - 2)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ModelFit:
    """Parameters p, the fit they come from, the noise that it was weighed with, residuals (m, rows) in m and rad."""

    p: Array
    fit: Fit
    noise: Noise
    residual: Array

    def mounts(self, labels: tuple[str, ...]) -> Mounts:
        """Return base and tools."""
        return Mounts.of(self.p, len(labels))

    def std(self, name: str) -> float:
        """Return a parameter's standard deviation; infinite where it is not determined."""
        return self.fit.std().get(name, 0.0)


def measurement_std(measured: Measured) -> Array:
    """Return (m, 2): the standard deviations of a coordinate and of a turn as the file says them, 0 where not."""
    if measured.std is None:
        return np.zeros((len(measured), 2))
    return np.asarray(np.sqrt(np.mean(measured.std.reshape(-1, 2, 3) ** 2, axis=2)))


def extra_noise(residual: Array, measurement: Array, n_parameters: int) -> Array:
    """Return (2,): what of residuals (m, rows) the measurement's standard deviations (m, 2) do not explain.

    By the median, lifted by the parameters that the fit has taken.
    """
    m, rows = residual.shape
    lift = m * rows / max(m * rows - n_parameters, 1)
    out = np.zeros(2)
    for k in range(rows // 3):
        squares = (residual[:, 3 * k : 3 * k + 3] ** 2).sum(axis=1)
        total = float(np.median(squares)) / MEDIAN_3 * lift
        out[k] = np.sqrt(max(total - float(np.median(measurement[:, k] ** 2)), 0.0))
    return out


def fit_model(model: Model, guess: Array, free: Collection[str], settled: float = 1e-10) -> ModelFit:
    """Return the free parameters by maximum likelihood, gross errors held down, the unexplained noise estimated.

    settled: share of the cost by which the last step lowers it; more for what is only to be ranked. Parameters that the
    data leave open stay where they are and are named in the fit. Raises NotConverged.
    """
    rows = model.rows
    loss = Loss(kind=LossKind.HUBER, scale=float(np.sqrt(chi2_ppf(0.99, rows))), block=rows)
    measurement = measurement_std(model.measured)
    residual, _ = model.linearised(guess)
    noise = Noise.of(model.measured, extra_noise(residual, measurement, 0))
    settings = Settings(allow_undetermined=True, max_iterations=200, cost_tolerance=settled)
    p = guess
    for _ in range(NOISE_ROUNDS):
        fit = solve(_problem(model, p, free, noise, loss), settings)
        p = fit.shared
        residual, _ = model.linearised(p)
        before, after = noise, Noise.of(model.measured, extra_noise(residual, measurement, len(free)))
        if np.abs(np.log(after.sigma / before.sigma)).max() < SETTLED:
            break
        noise = after
    return ModelFit(p=p, fit=fit, noise=noise, residual=residual)


def _problem(model: Model, p: Array, free: Collection[str], noise: Noise, loss: Loss) -> Problem:
    def evaluate(q: Array, _: Array) -> Evaluation:
        residual, J = model.linearised(q)
        return Evaluation.of_one(noise.whiten(residual), -noise.whiten(J))

    return Problem(
        names=model.names,
        guess=p,
        evaluate=evaluate,
        n_residuals=model.rows * len(model.measured),
        fixed=frozenset(model.names) - set(free),
        loss=loss,
        retract=model.retract,
    )


STILL_RAD = 0.05
"""A joint that moved less (rad, or of the mean link) cannot be told from the geometry beside it."""
MOVING = 0.02
"""Share of a joint's greatest speed below which its direction is not told."""
LEAST_BOTH_WAYS = 0.15
"""Share of the rows that must come from either side for backlash to be judged."""
LEAST_LOAD = 0.05
"""Spread of a joint's gravity torque, as a share of the greatest of any joint, for elasticity to be judged."""


class Kind(StrEnum):
    """What a joint has wrong."""

    ZERO = "zero offset"
    BACKLASH = "backlash"
    ECCENTRICITY = "gear eccentricity"
    SCALE = "scale of the slide"
    LOAD = "elasticity under load"
    ACCELERATION = "elasticity under acceleration"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Effect:
    """An error of one joint (from 0): what is added to its reading is basis (m, k) times k unknown parameters.

    names: of the parameters, with their unit.
    """

    joint: int
    kind: Kind
    names: tuple[str, ...]
    basis: Array


def effects(arm: Arm, q: Array, speed: Array | None, acceleration: Array | None) -> tuple[Effect, ...]:
    """Return everything that the rows can show of single joints.

    q (m, n): joint values. speed, acceleration (m, n): None where rows are single poses; the way a joint came then is
    the sign of its step from the row before.
    """
    way = _direction(arm, q, speed)
    load = gravity_load(arm, q)
    found: list[Effect] = []
    for i in range(arm.n):
        one = np.ones((len(q), 1))
        unit = "rad" if arm.revolute[i] else "m"
        found.append(Effect(joint=i, kind=Kind.ZERO, names=(f"zero_{unit}",), basis=one))
        if np.ptp(q[:, i]) < still(arm)[i]:
            continue
        both = min((way[:, i] > 0).mean(), (way[:, i] < 0).mean())
        if both > LEAST_BOTH_WAYS:
            found.append(Effect(joint=i, kind=Kind.BACKLASH, names=(f"backlash_{unit}",), basis=0.5 * way[:, [i]]))
        if arm.revolute[i]:
            turn = np.stack([np.sin(q[:, i]), np.cos(q[:, i]) - np.cos(q[:, i]).mean()], axis=1)
            names = ("sin_rad", "cos_rad")
            found.append(Effect(joint=i, kind=Kind.ECCENTRICITY, names=names, basis=turn))
        else:  # a screw's pitch, a belt's wheel, a warm scale
            along = q[:, [i]] - q[:, i].mean()
            found.append(Effect(joint=i, kind=Kind.SCALE, names=("scale_m_per_m",), basis=along))
        if np.ptp(load[:, i]) > LEAST_LOAD * max(float(np.ptp(load, axis=0).max()), 1e-12):
            found.append(Effect(joint=i, kind=Kind.LOAD, names=(f"load_{unit}_per_m",), basis=load[:, [i]]))
        if acceleration is not None and np.ptp(acceleration[:, i]) > 0.0:
            name = f"acceleration_{unit}_s2_per_{unit}"
            found.append(Effect(joint=i, kind=Kind.ACCELERATION, names=(name,), basis=acceleration[:, [i]]))
    return tuple(found)


def still(arm: Arm) -> Array:
    """Return (n,) the range that a joint must have moved over to be judged."""
    return np.where(arm.revolute, STILL_RAD, STILL_RAD * arm.length_m)


def _direction(arm: Arm, q: Array, speed: Array | None) -> Array:
    """Return (m, n) from which side each joint came: 1 rising, -1 falling, 0 where it stood."""
    if speed is None:
        step = np.diff(q, axis=0, prepend=q[:1])
        return np.asarray(np.sign(np.where(np.abs(step) > 1e-3 * still(arm), step, 0.0)))
    return np.asarray(np.sign(np.where(np.abs(speed) > MOVING * np.abs(speed).max(axis=0), speed, 0.0)))


def gravity_load(arm: Arm, q: Array) -> Array:
    """Return (m, n) the lever in m by which equal weights at the ends of the links turn each joint.

    An assumption, as nobody says the masses: as much weight at each link's end and at the tool, the world's z up. Of a
    slide the share of the weight along it.
    """
    out = np.empty(q.shape)
    for k, row in enumerate(q):
        T = link_frames(arm, row)
        for i in range(arm.n):
            beyond = T[i + 1 :, :3, 3] - T[i, :3, 3]
            force = np.array([0.0, 0.0, -1.0])
            turned = np.cross(beyond, force).mean(axis=0)
            out[k, i] = T[i, :3, 2] @ (turned if arm.revolute[i] else force)
    return out


LAST_DIGIT_DEG = 1e-4
"""Angles are told to this, and so no surer than this."""


def shown(name: str, value: float, std: float) -> str:
    """Return a parameter in words, angles in degrees."""
    if name.endswith("_rad"):
        width = max(np.rad2deg(std), LAST_DIGIT_DEG)
        return f"{name.removesuffix('_rad')} {np.rad2deg(value):.4f} +- {width:.2g} deg"
    return f"{name} {value:.4g} +- {std:.2g}"


@dataclass(frozen=True, slots=True, kw_only=True)
class JointVerdict:
    """What is known of one joint: judged or why not; its zero (rad or m) with standard deviation where estimated; the
    share that its best effect takes off left-out squares, and which effect that is, None where it takes nothing off.
    backlash: (rad or m, standard deviation), None where it did not come from both sides."""

    judged: bool
    why: str = ""
    offset: float | None = None
    std: float | None = None
    gain_heldout: float | None = None
    kind: Kind | None = None
    backlash: tuple[float, float] | None = None
