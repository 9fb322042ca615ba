"""Touches as a function of an arm's parameters, its tips, and where the features are: what each row leaves.

A spike holds the tip in three coordinates, a flat, a ball or a gauge in one: the residual is what the tip misses it by.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.calibrate.arm.model import THETA, ArmModel, D
from armsight.calibrate.arm.touch.touches import Kind, Touches
from armsight.errors import Degenerate, Inconsistent
from armsight.fitting import Evaluation
from armsight.kinematics import fk

PARAMETERS = {
    Kind.POINT: ("x_m", "y_m", "z_m"),
    Kind.PLANE: ("offset_m", "tilt_u_rad", "tilt_v_rad"),
    Kind.SPHERE: ("x_m", "y_m", "z_m", "radius_m"),
    Kind.GAUGE: ("offset_m", "tilt_u_rad", "tilt_v_rad"),
}
"""Of a feature; a flat's and a gauge's are changes to the ones that the first guess has."""
TRIMS, TRIMMED = 4, 5.0
"""Rounds in which touches further off than so many times the middle one are left out of the first guess."""
LEAST_SPREAD = 1e-3
"""Share of their farthest spread by which touches of a flat, a ball or a gauge must spread across it."""


STEEPEST = 30.0
"""A gauge whose readings change by more of the tip's way is not read in m: of 1 in theory, of 1000 in mm."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TouchModel:
    """An arm, what it touched, and axes (3, 3) of each feature as rows (normal, u, v) with a place on it (3,), m.

    Parameters: those of the arm's model, base and tool included (the base stays), then those of each feature,
    'touch:NAME.x_m' ..; of the tool only where its tip is counts.
    """

    arm_model: ArmModel
    touches: Touches
    axes: Mapping[str, Array]
    place: Mapping[str, Array]

    @property
    def n_arm(self) -> int:
        """How many parameters are the arm's, with base and tool."""
        return len(self.arm_model.names)

    @property
    def features(self) -> tuple[str, ...]:
        """Names of the features' parameters."""
        kinds = self.touches.kinds.items()
        return tuple(f"touch:{name}.{key}" for name, kind in kinds for key in PARAMETERS[kind])

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all parameters."""
        return (*self.arm_model.names, *self.features)

    @property
    def mounts(self) -> tuple[str, ...]:
        """Names of what is always fitted: the tips and the features."""
        tips = (name for name in self.arm_model.mounts if name.startswith("tool") and name.endswith("_m"))
        return (*tips, *self.features)

    def at(self, name: str, key: str) -> int:
        """Return the index of a feature's parameter."""
        return self.n_arm + self.features.index(f"touch:{name}.{key}")

    def first(self, name: str) -> slice:
        """Return the indices of a feature's first three parameters: of a place, or offset and tilts."""
        k = self.at(name, PARAMETERS[self.touches.kinds[name]][0])
        return slice(k, k + 3)

    def normal(self, p: Array, name: str) -> tuple[Array, Array]:
        """Return the direction (3,) of a flat or gauge, and its derivative (3, 2) by the two tilts."""
        n, u, v = self.axes[name]
        tilt = p[self.first(name)][1:]
        # two tilts from the first guess: no singular direction near it
        raw = n + tilt[0] * u + tilt[1] * v
        size = float(np.linalg.norm(raw))
        by = np.stack([u, v], axis=1) / size
        return raw / size, by - np.outer(raw / size, raw @ by) / size

    def misses(self, p: Array, touches: Touches, lever_m: Array | None = None) -> tuple[Array, Array, Array]:
        """Return what rows (m, 3) miss their feature by in m, of flats, balls and gauges in the first number alone;
        its derivative (m, 3, P); and that of the joint values (m, 3, n)."""
        n = self.arm_model.arm.n
        T, J = self.arm_model.predict(p[: self.n_arm], touches.as_points(), lever_m)
        tip, by_arm = T[:, :3, 3], J[:, :3]
        drive = 5 * np.arange(n) + np.where(self.arm_model.arm.revolute, THETA, D)
        m = len(touches)
        e, by = np.zeros((m, 3)), np.zeros((m, 3, len(p)))
        by_q, which = np.zeros((m, 3, n)), np.array(touches.feature)
        for name, kind in self.touches.kinds.items():
            rows = np.flatnonzero(which == name)
            at = self.first(name)
            if kind is Kind.POINT:
                e[rows], by[rows, :, : self.n_arm] = tip[rows] - p[at], by_arm[rows]
                by[rows, :, at] = -np.eye(3)
                by_q[rows] = by_arm[rows][:, :, drive]
                continue
            if kind is Kind.SPHERE:
                # along the line from the ball's centre alone
                from_centre = tip[rows] - p[at]
                away = np.linalg.norm(from_centre, axis=1)
                along = from_centre / away[:, None]
                e[rows, 0] = away - p[at.stop]
                by[rows, 0, at], by[rows, 0, at.stop] = -along, -1.0
            else:
                # a flat is a gauge that always reads zero
                direction, by_tilt = self.normal(p, name)
                off = tip[rows] - self.place[name]
                along = np.tile(direction, (len(rows), 1))
                e[rows, 0] = off @ direction - p[at.start] - touches.reading_m[rows]
                by[rows, 0, at] = np.column_stack([np.full(len(rows), -1.0), off @ by_tilt])
            by[rows, 0, : self.n_arm] = np.einsum("mi,mij->mj", along, by_arm[rows])
            by_q[rows, 0] = np.einsum("mi,mij->mj", along, by_arm[rows][:, :, drive])
        return e, by, by_q

    def lengths(self, p: Array) -> tuple[Array, Array]:
        """Return by how many standard deviations the lengths (k,) are off those measured, and the derivative (k, P)."""
        known = self.touches.lengths
        r, by = np.zeros(len(known)), np.zeros((len(known), len(p)))
        for k, one in enumerate(known):
            a = self.first(one.a)
            if one.b:
                b = self.first(one.b)
                apart = p[a] - p[b]
                size = max(float(np.linalg.norm(apart)), 1e-9)
                by[k, a], by[k, b] = apart / size, -apart / size
            else:
                size, by[k, a.stop] = float(p[a.stop]), 1.0
            r[k] = (size - one.length_m) / one.sigma_m
            by[k] /= one.sigma_m
        return r, by

    def evaluate(self, p: Array, whiten: Array, lever_m: Array | None = None) -> Evaluation:
        """Return whitened residuals and derivatives, three of each row and of each known length.

        whiten: (m, 3, 3) of the rows.
        """
        e, by, _ = self.misses(p, self.touches, lever_m)
        r, J = np.einsum("mij,mj->mi", whiten, e), whiten @ by
        off, by_off = self.lengths(p)
        r = np.concatenate([r, np.column_stack([off, np.zeros((len(off), 2))])])
        J = np.concatenate([J, np.stack([by_off, 0.0 * by_off, 0.0 * by_off], axis=1)])
        return Evaluation.of_one(r, J)

    @property
    def n_residuals(self) -> int:
        """How many numbers the rows and lengths say."""
        scalar = int(self.touches.scalar.sum())
        return 3 * (len(self.touches) - scalar) + scalar + len(self.touches.lengths)


def start(arm_model: ArmModel, touches: Touches) -> tuple[TouchModel, Array]:
    """Return the model and a first guess of the nominal arm's tips and of the features.

    Of a tip that touched spikes it comes from them (linear), else from the nominal arm's tool. Raises Degenerate.
    """
    arm = arm_model.arm
    base = arm.T_world_base
    flange = fk(arm, arm.sagged(touches.q)) @ np.linalg.inv(arm.T_flange_tool.as_matrix())
    tips = _tips(flange, touches, np.asarray(arm.T_flange_tool.translation))
    there = np.einsum("mij,mj->mi", flange[:, :3, :3], tips[touches.of_tip]) + flange[:, :3, 3]
    axes, place, guess = {}, {}, []
    which = np.array(touches.feature)
    for name, kind in touches.kinds.items():
        rows = which == name
        at, read = there[rows], touches.reading_m[rows]
        middle = np.median(at, axis=0)
        place[name] = middle
        if kind is Kind.POINT:
            axes[name], values = np.eye(3), [*middle]
        elif kind is Kind.SPHERE:
            given = next((one.length_m for one in touches.lengths if one.a == name and not one.b), None)
            axes[name], values = np.eye(3), _ball(name, at, given)
        else:
            axes[name] = _flat(name, at) if kind is Kind.PLANE else _gauge(name, at, read)
            values = [float(np.median((at - middle) @ axes[name][0] - read)), 0.0, 0.0]
        guess += values
    model = TouchModel(arm_model=arm_model, touches=touches, axes=axes, place=place)
    turn = arm.T_flange_tool.rotation
    tools = [RigidTransform.from_components(tip, turn) for tip in tips]
    return model, np.concatenate([arm_model.vector(base, tools), guess])


def _tips(flange: Array, touches: Touches, nominal: Array) -> Array:
    """Return the tips (t, 3) in flange axes that scatter least about the spikes (k, 3), those being free too."""
    tips = np.tile(nominal, (len(touches.tips), 1))
    rows = np.flatnonzero(~touches.scalar)
    if not len(rows):
        return tips
    mine = np.eye(len(tips))[touches.of_tip]  # (m, t)
    turn = np.einsum("mij,mt->mitj", flange[:, :3, :3], mine).reshape(len(touches), 3, -1)
    placed = np.concatenate([turn, flange[:, :3, 3:]], axis=2)  # where the tip is: linear in all tips, and one
    # touches of a wrong spike would shift the first guess by centimetres
    guess = tips.ravel()
    for _ in range(TRIMS):
        number = np.unique(touches.which[rows], return_inverse=True)[1]
        share = np.equal.outer(number, np.arange(number.max() + 1)) / np.bincount(number)
        middle = np.einsum("mk,mij->kij", share, placed[rows])
        off = placed[rows] - middle[number]  # about its spike's mean
        A, b = off[:, :, :-1].reshape(-1, tips.size), -off[:, :, -1].ravel()
        guess = tips.ravel() + np.linalg.lstsq(A, b - A @ tips.ravel(), rcond=1e-2)[0]
        miss = np.linalg.norm((A @ guess - b).reshape(-1, 3), axis=1)
        kept = miss <= TRIMMED * float(np.median(miss))
        if kept.all() or len(np.unique(touches.which[rows[kept]])) <= number.max():
            break
        rows = rows[kept]
    return np.asarray(guess.reshape(-1, 3))


def _ball(name: str, at: Array, radius_m: float | None) -> list[float]:
    """Return centre and radius of the ball (Coope 1993: linear in the centre and in r^2 - c^2)."""
    middle = at.mean(axis=0)
    off = at - middle
    A = np.column_stack([2.0 * off, np.ones(len(off))])
    if np.linalg.svd(off, compute_uv=False)[-1] < LEAST_SPREAD * np.linalg.norm(off):
        raise _unspread(name, "a ball", "from the side and from above")
    x = np.linalg.lstsq(A, (off**2).sum(axis=1), rcond=None)[0]
    found = float(np.sqrt(max(x[3] + x[:3] @ x[:3], 1e-12)))
    return [*(middle + x[:3]), radius_m or found]


def _flat(name: str, at: Array) -> Array:
    _, s, Vt = np.linalg.svd(at - at.mean(axis=0))
    if s[1] < LEAST_SPREAD * s[0]:
        raise _unspread(name, "a flat", "far apart, not along a line")
    return np.asarray(Vt[::-1])


def _gauge(name: str, at: Array, reading_m: Array) -> Array:
    """Return axes whose first is the gauge's: the direction in which readings grow as the tip moves."""
    off, read = at - at.mean(axis=0), reading_m - reading_m.mean()
    s = np.linalg.svd(off, compute_uv=False)
    if s[-1] < LEAST_SPREAD * s[0] or not np.ptp(read) > 0.0:
        raise _unspread(name, "a gauge", "over its anvil's breadth and over its travel")
    along = np.linalg.lstsq(off, read, rcond=None)[0]
    slope = float(np.linalg.norm(along))
    if slope > STEEPEST:
        raise Inconsistent(
            f"the readings of {name} change by {slope:.3g} m for each m that the tip moves",
            consequence="Nothing is computed from them",
            cure="Give reading_m in m: a dial's 2.14 mm is 0.00214",
        )
    n = along / max(slope, 1e-12)
    return np.stack([n, *np.linalg.svd(n[None])[2][1:]])


def _unspread(name: str, what: str, how: str) -> Degenerate:
    return Degenerate(
        f"the touches of {name} do not spread as those of {what}",
        consequence="Where it lies cannot be told",
        cure=f"Touch {name} {how}",
    )
