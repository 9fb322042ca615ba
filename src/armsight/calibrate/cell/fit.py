"""One fit of a whole cell to its recording, with what is known beforehand, and what cannot be told held fixed."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from armsight.arrays import Array
from armsight.calibrate.cell.knowledge import ArmTolerance, Knowledge, shape_information, shape_terms
from armsight.calibrate.cell.model import BlockNormals, CellModel
from armsight.calibrate.cell.observations import BLOCK_S, Spots
from armsight.calibrate.cell.wander import JointDrift, learned_wander
from armsight.fitting import Evaluation, Fit, Problem, Settings, solve
from armsight.fitting.problem import NormalEquations

APART = 1e-4
"""Share of an arm's parameter's effect that must be its own; of one that base, target and others take up wholly,
rounding leaves 1e-7."""
SAG_RAD_M = 1e-3
"""How far a joint gives way per metre of lever that the arm's weight has about it, where nobody says: gears, harmonic
drives and links of industrial arms give way by 0.1 to 3 mrad."""
WAVES = np.geomspace(4.0, 64.0, 9)
"""rad a rad: waves of gears' errors over a joint's turn, from eccentric wheels to single teeth; shorter ones average
out, longer ones are zeros and lengths."""
EM_ROUNDS = 50
FEWEST_TOLD = 4.0
"""Corrections by which a class's deviation is told, at least: of fewer nobody could say."""
LEAST = {"length_m": 5e-5, "zero_rad": 1e-4, "angle_rad": 1e-4}
"""No arm is built better."""
NEAR_DAMPING = 1e-8
"""Near a minimum each tenfold more costs a step: what cameras, base and arm have in common is seen by 1e-6 of each."""
LEAST_LINK_M = 1e-3
"""A shorter length is an axis that should meet another, and does not."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CellData:
    """Spots of lights in the order of time, the stretch (m,) that each is of, and their noise.

    scale: by how much the spots' deviations of each camera are larger than they say. wander: how the arm strays, where
    that is taken into account.
    """

    spots: Spots
    block: NDArray[np.intp]
    scale: tuple[float, ...]
    wander: JointDrift | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CellFit(CellData):
    """Parameters x (P,), the data they explain and its normal equations by stretches. free: names that were fitted."""

    x: Array
    normals: BlockNormals
    free: tuple[str, ...]
    known: Knowledge
    fit: Fit

    @property
    def spread_px(self) -> Array:
        """The standard deviation (m,) of each spot's coordinate."""
        return np.asarray(self.spots.spread_px * np.asarray(self.scale)[self.spots.side])

    @property
    def places(self) -> NDArray[np.intp]:
        """Where the fitted parameters (F,) are among all (P,)."""
        return np.array([self.fit.names.index(name) for name in self.free], dtype=np.intp)

    def information(self, model: CellModel) -> Array:
        """Return the information (P, P) of spots and of what was known before, about all parameters."""
        data = self.normals.A.sum(axis=0) if self.wander is None else self.wander.reduced(self.normals).A
        return np.asarray(data + self.known.information + shape_information(model, self.x, self.known.shape))

    def covariance(self, model: CellModel, *, stiff: bool = True) -> Array:
        """Return the covariance (P, P) of all parameters; zero for those that are held.

        The arm may stray by time or by place, and both count. stiff: whether joints that are held do not give way at
        all. Else they may, by SAG_RAD_M before anything is seen; where the fit with them free lies d away, d d' is
        added, the square of the bias that holding them makes.
        """
        free = self.places
        H = self.information(model)
        out = np.zeros_like(H)
        inverse = _inverse(H[np.ix_(free, free)])
        out[np.ix_(free, free)] = inverse
        if self.wander is not None:
            # each wave is a bias of the fit, of unit deviation
            steps = inverse @ self._by_place(model, self.wander)[free]
            out[np.ix_(free, free)] += steps @ steps.T
        if stiff:
            return out
        held = [model.names.index(name) for name in model.arm.sags if name not in self.free]
        every = np.concatenate([free, np.array(held, dtype=np.intp)])
        H[held, held] += SAG_RAD_M**-2
        # at the minimum of what is fitted the gradient is that of what is held
        data = self.normals.g.sum(axis=0) if self.wander is None else self.wander.reduced(self.normals).g
        step = np.zeros(len(self.x))
        step[every] = _inverse(H[np.ix_(every, every)])[:, len(free) :] @ data[held]
        return np.asarray(out + np.outer(step, step))

    def _by_place(self, model: CellModel, wander: JointDrift) -> Array:
        """Return gradients (P, k): what the arm does to all parameters if it strays by its joints' places, not by time.

        What a gear does it does again wherever its joint comes by, and visits are then no new evidence: a wave of each
        joint with the straying's deviation, of which neither length nor phase is known.
        """
        arm = model.arm.arm
        k = WAVES / np.where(arm.revolute, 1.0, arm.length_m)[:, None]  # (n, w)
        g = np.zeros((len(wander.t_s), len(self.x), 2 * k.size))
        # spot by spot: within a stretch a joint may go through a whole wave
        t_s, whitening = model.times_s(self.x, self.spots), self.spots.whitening(self.scale)
        for block, (rows, _, J) in enumerate(model.stretches(self.x, self.spots, whitening, self.block)):
            turns = model.recording.log.at(t_s[rows])[0][:, :, None] * k
            waves = np.concatenate([np.sin(turns), np.cos(turns)], axis=2)
            waves *= wander.std[:, None] / np.sqrt(len(WAVES))
            moved = J[:, :, wander.columns, None] * waves[:, None]
            g[block] = J.reshape(-1, len(self.x)).T @ moved.reshape(len(J) * 2, -1)
        return wander.left_of(self.normals, g)


def _inverse(information: Array) -> Array:
    """Return the inverse, scaled on the way: metres and radians would lose each other in rounding."""
    size = 1.0 / np.sqrt(np.diag(information))
    return np.asarray(np.linalg.inv(information * np.outer(size, size)) * np.outer(size, size))


def blocks_of(model: CellModel, x: Array, spots: Spots) -> tuple[Spots, NDArray[np.intp]]:
    """Return the spots in the order of time that the log covers, and which stretch each is of, from 0."""
    t = model.times_s(x, spots)
    rows = np.flatnonzero(model.recording.log.covers(t))
    rows = rows[np.argsort(t[rows], kind="stable")]
    number = np.floor((t[rows] - t[rows[0]]) / BLOCK_S).astype(np.intp)
    return spots.take(rows), np.unique(number, return_inverse=True)[1].astype(np.intp)


def gauge(model: CellModel, information: Array, candidates: Collection[str], tolerance: ArmTolerance) -> list[str]:
    """Return which of the arm's parameters can be told from cameras, lights and each other, by pivoting."""
    A = information
    index = np.array([model.names.index(name) for name in candidates], dtype=np.intp)
    mounts = np.array([k for k in range(len(A)) if not model.arm_at <= k < model.lights_at and A[k, k] > 0.0])
    size = np.sqrt(np.maximum(np.diag(A), 1e-300))
    scaled = A / np.outer(size, size)
    M = scaled[np.ix_(mounts, mounts)] + 1e-12 * np.eye(len(mounts))
    C = scaled[np.ix_(mounts, index)]
    S = scaled[np.ix_(index, index)] - C.T @ np.linalg.solve(M, C)
    weight = size[index] * np.array([tolerance.of(name) for name in candidates])
    names, free, open_ = list(candidates), [], list(range(len(index)))
    # of each what is its own beside cameras, lights and the parameters freed before, as in `calibrate.arm`
    while open_:
        left = np.array([S[k, k] for k in open_])
        fit = left > APART**2
        if not fit.any():
            break
        best = open_[int(np.argmax(np.where(fit, left * weight[open_] ** 2, -1.0)))]
        free.append(names[best])
        open_.remove(best)
        S = S - np.outer(S[:, best], S[best]) / S[best, best]
    return free


def fit_cell(
    model: CellModel,
    x: Array,
    data: CellData,
    free: Collection[str],
    known: Knowledge,
    damping: float = NEAR_DAMPING,
) -> CellFit:
    """Return the fit of the parameters named in free, from x (P,) on. Raises NotConverged, Undetermined.

    damping: Marquardt's at first; the default is for an x that an earlier fit has left.
    """
    bundle = _Bundle.of(model, data, known, free)
    problem = Problem(
        names=model.names,
        guess=x,
        evaluate=bundle.evaluate,
        n_residuals=2 * len(data.spots),
        fixed=frozenset(model.names) - frozenset(free),
        retract=model.retract,
    )
    fit = solve(problem, Settings(cost_tolerance=1e-9, initial_damping=damping))
    return CellFit(
        x=fit.shared,
        spots=data.spots,
        block=data.block,
        scale=data.scale,
        wander=data.wander,
        normals=bundle.normals(fit.shared),
        free=tuple(name for name in model.names if name in free),
        known=known,
        fit=fit,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Bundle:
    """The problem of one fit: W whitens the spots; information (P, P) known before about what is fitted, root' root."""

    model: CellModel
    data: CellData
    known: Knowledge
    W: Array
    information: Array
    root: Array
    last: list[tuple[Array, BlockNormals]] = field(default_factory=list)

    @classmethod
    def of(cls, model: CellModel, data: CellData, known: Knowledge, free: Collection[str]) -> _Bundle:
        held = [k for k, name in enumerate(model.names) if name not in free]
        information = known.information.copy()
        information[held] = information[:, held] = 0.0
        W = data.spots.whitening(data.scale)
        return cls(model=model, data=data, known=known, W=W, information=information, root=_root(information))

    def normals(self, x: Array) -> BlockNormals:
        """Return those of the stretches at x (P,); the last are kept, as a fit mostly ends where it looked last."""
        if not self.last or self.last[0][0] is not x:
            self.last[:] = [(x, self.model.normals(x, self.data.spots, self.W, self.data.block))]
        return self.last[0][1]

    def evaluate(self, x: Array, local: Array) -> Evaluation:
        """Return the normal equations at x (P,), and residuals whose squares are the cost."""
        del local
        model, wander, normals = self.model, self.data.wander, self.normals(x)
        pull = model.difference(x, self.known.x)
        shape, off = shape_terms(model, x, self.known.shape)
        if wander is None:
            r, A, b = normals.residuals.ravel(), normals.A.sum(axis=0), normals.g.sum(axis=0)
        else:
            # with the straying eliminated single residuals have no meaning; the solver needs their squares' sum
            reduced = wander.reduced(normals)
            r, A, b = np.sqrt([max(reduced.square, 0.0)]), reduced.A, reduced.g
        r = np.concatenate([r, self.root @ pull, _root(shape) @ off])
        A, b = A + self.information, b + self.information @ pull
        a, P = model.lights_at, len(x)
        A[a:, a:] += shape
        b[a:] += shape @ off
        condensed = NormalEquations(A=A, b=b, C=np.zeros((1, 0, 0)), c=np.zeros((1, 0)), W=np.zeros((1, P, 0)))
        none = np.empty((1, len(r), 0))
        return Evaluation(residuals=r[None], shared=none, local=none, condensed=condensed)


def _root(information: Array) -> Array:
    """Return R with R' R = information, of which directions may be zero."""
    values, axes = np.linalg.eigh(information)
    return np.asarray(np.sqrt(np.maximum(values, 0.0))[:, None] * axes.T)


def straying(model: CellModel, found: CellFit) -> JointDrift:
    """Return how the arm strays by the residuals of a fit."""
    t = model.times_s(found.x, found.spots)
    count = np.bincount(found.block)
    arm = model.arm.arm
    drives = [
        f"{joint.name}.{'theta_rad' if turns else 'd_m'}" for joint, turns in zip(arm.joints, arm.revolute, strict=True)
    ]
    free = found.places
    known = found.known.information + shape_information(model, found.x, found.known.shape)
    return learned_wander(
        found.normals,
        np.bincount(found.block, weights=t) / count,
        np.array([model.names.index(name) for name in drives], dtype=np.intp),
        np.where(arm.revolute, 1.0, arm.length_m),
        free,
        known[np.ix_(free, free)],
    )


def side_scales(found: CellFit) -> tuple[float, ...]:
    """Return by how much each camera's spots scatter more than the fit's deviations say, times its scale so far."""
    dof = 1.0 - len(found.free) / max(2.0 * len(found.spots), 1.0)
    out = []
    for side in range(len(found.scale)):
        r = found.normals.residuals[found.spots.side == side]
        if not len(r):
            out.append(found.scale[side])
            continue
        # sqrt(2 log 2) = 1.177 is the median length of two unit normals
        size = np.median(np.linalg.norm(r, axis=1)) / 1.177
        out.append(found.scale[side] * float(size) / np.sqrt(dof))
    return tuple(out)


def learned_tolerance(model: CellModel, found: CellFit, tolerance: ArmTolerance) -> ArmTolerance:
    """Return how far this arm is from its model, by class of parameter, as its own corrections show.

    Expectation maximisation of the variance of each class's corrections (Dempster, Laird, Rubin 1977, example 4.7):
    lengths; zeros and directions of axes. Never beyond what was given, never below what any arm is built to. Lengths of
    links stay as given: what lengths have in common, the scale, no recording shows, and a wrist tells nothing of it.
    """
    # joints' own lengths that are nominally none cannot tell whether all others are too long
    links = {
        f"{joint.name}.{key}"
        for joint in model.recording.arm.joints
        for key in ("a_m", "d_m")
        if abs(getattr(joint, key)) > LEAST_LINK_M
    }
    tolerance = replace(tolerance, links=frozenset(links), link_m=tolerance.length_m)
    free = found.places
    H = found.information(model)[np.ix_(free, free)]
    arm = [k for k, at in enumerate(free) if model.arm_at <= at < model.lights_at]
    names = [model.names[free[k]] for k in arm]
    classes: dict[str, list[int]] = {key: [] for key in LEAST}
    measured = model.recording.arm.covariance
    told_before = () if measured is None else measured.names  # by an earlier calibration, not by a class's tolerance
    for k, name in zip(arm, names, strict=True):
        key = tolerance.kind(name)
        if key in classes and name not in told_before:
            classes[key].append(k)
    before = np.diag(found.known.information)[free]
    off = (found.x - found.known.x)[free]
    sigma = {name: getattr(tolerance, name) for name in classes}
    for _ in range(EM_ROUNDS):
        # only the prior's diagonal changes with the deviations: a fit anew is one solution of the normal equations
        change = np.zeros(len(free))
        for name, rows in classes.items():
            change[rows] = sigma[name] ** -2 - before[rows]
        C = np.linalg.inv(H + np.diag(change))
        moved = off - C @ (change * off)
        for name, rows in classes.items():
            if rows:
                square = float(np.mean(moved[rows] ** 2 + np.diag(C)[rows]))
                sigma[name] = min(max(np.sqrt(square), LEAST[name]), getattr(tolerance, name))
    for name, rows in classes.items():
        # how many of them the recording tells; of a variance estimated from so few Student's t has wider tails
        told = max(float(np.sum(1.0 - np.diag(C)[rows] / sigma[name] ** 2)), FEWEST_TOLD)
        sigma[name] = min(sigma[name] * float(np.sqrt(told / (told - 2.0))), getattr(tolerance, name))
    return replace(tolerance, **sigma)
