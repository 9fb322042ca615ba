"""One fit of a whole cell to its recording, with what is known beforehand, and what cannot be told held fixed."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from armsight.calibrate.cell.model import PER_CAMERA, BlockNormals, CellModel
from armsight.calibrate.cell.observations import BLOCK_S, Spots
from armsight.calibrate.cell.wander import Wander, learned_wander
from armsight.fitting import Evaluation, Fit, Problem, Settings, solve
from armsight.fitting.normal import NormalEquations
from armsight.geometry import align_points
from armsight.geometry.poses import skew
from armsight.records import Progress, Target

Array = NDArray[np.float64]

APART = 1e-4
"""Share of an arm's parameter's effect that must be its own; of one that base, target and others take up wholly,
rounding leaves 1e-7."""
CENTRE = 0.05
"""Of the image's width: the principal point is about so far from the middle, where nothing else is known."""
LENS = {"k1": 0.5, "k2": 0.5, "k3": 0.5, "p1": 0.01, "p2": 0.01}
"""Standard deviations of a lens's coefficients, where nothing else is known."""
ASPECT = 0.02
"""Of fy over fx."""
DRIFT_PPM = 300.0
EM_ROUNDS = 50
LEAST = {"length_m": 5e-5, "zero_rad": 1e-4, "angle_rad": 1e-4}
"""No arm is built better."""
SHAPE_M = 5e-4
"""Places of a target's lights, where its file does not say how well they are known: what a drawing and a drill give."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmTolerance:
    """What a nominal arm is believed to: standard deviations of its lengths, joint zeros, directions of axes, and sag.

    Zeros are set by hand at mastering, axes are bored on machines: the two are learned apart.
    """

    length_m: float = 2e-3
    zero_rad: float = 0.03
    angle_rad: float = 0.03
    sag: float = 0.05

    def kind(self, name: str) -> str:
        """Return which of its fields a parameter goes by."""
        if name.endswith(".sag"):
            return "sag"
        if name.endswith(".theta_rad"):
            return "zero_rad"
        return "length_m" if name.endswith("_m") else "angle_rad"

    def of(self, name: str) -> float:
        """Return the standard deviation of a parameter by its name."""
        return float(getattr(self, self.kind(name)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TargetShape:
    """How a target's lights (n, 3) m lie to each other, and the covariance (3 n, 3 n) of that."""

    xyz_m: Array
    covariance: Array

    @classmethod
    def of(cls, target: Target) -> TargetShape:
        """Return a target's; without a covariance each place is good to SHAPE_M."""
        n = 3 * len(target.names)
        given = target.covariance
        return cls(xyz_m=target.xyz_m, covariance=np.eye(n) * SHAPE_M**2 if given is None else given + np.eye(n) * 1e-12)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Knowledge:
    """What is known before: a vector x (P,) and the information (P, P) about steps from it; zero where nothing is.

    shape: of the target, which is known but for its place on the flange.
    """

    x: Array
    information: Array
    shape: TargetShape

    def pull(self, model: CellModel, x: Array) -> Array:
        """Return the step (P,) from what is known to x."""
        return model.difference(x, self.x)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CellFit:
    """Parameters x (P,) with the spots they explain, their normal equations by stretches, and the spots' noise.

    scale: by how much the spots' deviations of each camera are larger than they say. free: names that were fitted.
    wander: how the arm strays, where that was taken into account.
    """

    x: Array
    spots: Spots
    block: NDArray[np.intp]
    normals: BlockNormals
    scale: tuple[float, float]
    free: tuple[str, ...]
    known: Knowledge
    fit: Fit
    wander: Wander | None = None

    @property
    def places(self) -> NDArray[np.intp]:
        """Where the fitted parameters (F,) are among all (P,)."""
        return np.array([self.fit.names.index(name) for name in self.free], dtype=np.intp)

    def information(self, model: CellModel) -> Array:
        """Return the information (P, P) of spots and of what was known before, about all parameters."""
        data = self.normals.A.sum(axis=0) if self.wander is None else self.wander.reduced(self.normals).A
        return np.asarray(data + self.known.information + shape_information(model, self.x, self.known.shape))

    def covariance(self, model: CellModel) -> Array:
        """Return the covariance (P, P) of all parameters; zero for those that are held."""
        free = self.places
        H = self.information(model)[np.ix_(free, free)]
        size = 1.0 / np.sqrt(np.diag(H))
        out = np.zeros((len(self.x), len(self.x)))
        out[np.ix_(free, free)] = np.linalg.inv(H * np.outer(size, size)) * np.outer(size, size)
        return out


def default_knowledge(model: CellModel, x: Array, tolerance: ArmTolerance, target: Target) -> Knowledge:
    """Return what is known of any cell with webcams: weak deviations of lenses and clocks, the nominal arm, the target.

    x (P,): a cell to begin with.
    """
    sigma = np.full(len(x), np.inf)
    mean = x.copy()
    for side in (0, 1):
        width, height = model.recording.sizes[side]
        first = side * len(PER_CAMERA)
        period = model.recording.clocks[side].period_s
        at = {name: first + k for k, name in enumerate(PER_CAMERA)}
        mean[at["cx"]], mean[at["cy"]] = (width - 1) / 2.0, (height - 1) / 2.0
        sigma[at["cx"]] = sigma[at["cy"]] = CENTRE * width
        for name, std in LENS.items():
            mean[at[name]], sigma[at[name]] = 0.0, std
        mean[at["drift_ppm"]], sigma[at["drift_ppm"]] = 0.0, DRIFT_PPM
        mean[at["readout_s"]], sigma[at["readout_s"]] = 0.5 * period, 0.5 * period
    for k, name in enumerate(model.names[model.arm_at : model.lights_at]):
        mean[model.arm_at + k], sigma[model.arm_at + k] = 0.0, tolerance.of(name)
    information = np.diag(1.0 / sigma**2)
    for side in (0, 1):
        a = side * len(PER_CAMERA)
        # square pixels: fy - fx is small
        w = 1.0 / (ASPECT * x[a]) ** 2
        information[np.ix_([a, a + 1], [a, a + 1])] += w * np.array([[1.0, -1.0], [-1.0, 1.0]])
        mean[a + 1] = mean[a] = x[a]
    return Knowledge(x=mean, information=information, shape=TargetShape.of(target))


def blocks_of(model: CellModel, x: Array, spots: Spots) -> tuple[Spots, NDArray[np.intp]]:
    """Return the spots in the order of time that the log covers, and which stretch each is of, from 0."""
    t = model.times_s(x, spots)
    rows = np.flatnonzero(model.recording.log.covers(t))
    rows = rows[np.argsort(t[rows], kind="stable")]
    number = np.floor((t[rows] - t[rows[0]]) / BLOCK_S).astype(np.intp)
    return spots.take(rows), np.unique(number, return_inverse=True)[1].astype(np.intp)


def shape_information(model: CellModel, x: Array, shape: TargetShape) -> Array:
    """Return the information (P, P) that the target's shape is about the lights, wherever it is on the flange."""
    out = np.zeros((len(x), len(x)))
    out[model.lights_at :, model.lights_at :] = _shape_terms(model, x, shape)[0]
    return out


def _shape_terms(model: CellModel, x: Array, shape: TargetShape) -> tuple[Array, Array]:
    """Return information (3 n, 3 n) about the lights, and how far (3 n,) they are from the shape laid onto them."""
    lights = model.lights_m(x)
    T = align_points(lights, shape.xyz_m).T_a_b
    turned = np.kron(np.eye(len(lights)), T.rotation.as_matrix())
    W = np.linalg.inv(turned @ shape.covariance @ turned.T)
    # a rigid motion of all lights costs nothing: what it does is taken out of the information
    moves = np.concatenate([np.tile(np.eye(3), (len(lights), 1)), -skew(lights - lights.mean(axis=0)).reshape(-1, 3)], axis=1)
    inner = moves.T @ W @ moves
    return W - W @ moves @ np.linalg.solve(inner, moves.T @ W), (lights - T.apply(shape.xyz_m)).ravel()


def gauge(model: CellModel, information: Array, candidates: Collection[str], tolerance: ArmTolerance) -> list[str]:
    """Return which of the arm's parameters can be told from cameras, lights and each other, by pivoting."""
    A = information
    index = np.array([model.names.index(name) for name in candidates], dtype=np.intp)
    mounts = [k for k in range(len(A)) if not model.arm_at <= k < model.lights_at and A[k, k] > 0.0]
    size = np.sqrt(np.maximum(np.diag(A), 1e-300))
    scaled = A / np.outer(size, size)
    M = scaled[np.ix_(mounts, mounts)] + 1e-12 * np.eye(len(mounts))
    C = scaled[np.ix_(mounts, index)]
    S = scaled[np.ix_(index, index)] - C.T @ np.linalg.solve(M, C)
    weight = size[index] * np.array([tolerance.of(name) for name in candidates])
    names, free, open_ = list(candidates), [], list(range(len(index)))
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
    spots: Spots,
    block: NDArray[np.intp],
    free: Collection[str],
    known: Knowledge,
    scale: tuple[float, float],
    *,
    wander: Wander | None = None,
    settings: Settings | None = None,
    progress: Progress | None = None,
) -> CellFit:
    """Return the fit of the parameters named in free. Raises NotConverged, Undetermined."""
    W = spots.whitening(scale)
    held = [k for k, name in enumerate(model.names) if name not in free]
    information = known.information.copy()
    information[held] = information[:, held] = 0.0
    root = _root(information)
    P = len(x)
    a = model.lights_at
    none = np.empty((1, 2 * len(spots) + P, 0))

    def evaluate(at: Array, local: Array) -> Evaluation:
        normals = model.normals(at, spots, W, block)
        pull = known.pull(model, at)
        shape, off = _shape_terms(model, at, known.shape)
        if wander is None:
            r, A, b = normals.residuals.ravel(), normals.A.sum(axis=0), normals.g.sum(axis=0)
        else:
            reduced = wander.reduced(normals)
            r, A, b = np.sqrt([max(reduced.square, 0.0)]), reduced.A, reduced.g
        r = np.concatenate([r, root @ pull, _root(shape) @ off])
        A, b = A + information, b + information @ pull
        A[a:, a:] += shape
        b[a:] += shape @ off
        condensed = NormalEquations(
            A=A,
            b=b,
            C=np.zeros((1, 0, 0)),
            c=np.zeros((1, 0)),
            W=np.zeros((1, P, 0)),
        )
        return Evaluation(residuals=r[None], shared=none[:, :, :0], local=none, condensed=condensed)

    problem = Problem(
        names=model.names,
        guess=x,
        evaluate=evaluate,
        n_residuals=2 * len(spots),
        fixed=frozenset(model.names) - frozenset(free),
        retract=model.retract,
    )
    fit = solve(problem, settings or Settings(cost_tolerance=1e-9), progress)
    normals = model.normals(fit.shared, spots, W, block)
    return CellFit(
        x=fit.shared,
        spots=spots,
        block=block,
        normals=normals,
        scale=scale,
        free=tuple(name for name in model.names if name in free),
        known=known,
        fit=fit,
        wander=wander,
    )


def _root(information: Array) -> Array:
    """Return R with R' R = information, of which directions may be zero."""
    values, axes = np.linalg.eigh(information)
    return np.asarray(np.sqrt(np.maximum(values, 0.0))[:, None] * axes.T)


def straying(model: CellModel, found: CellFit) -> Wander:
    """Return how the arm strays by the residuals of a fit."""
    t = model.times_s(found.x, found.spots)
    count = np.bincount(found.block)
    arm = model.arm.arm
    drives = [f"{joint.name}.{'theta_rad' if turns else 'd_m'}" for joint, turns in zip(arm.joints, arm.revolute, strict=True)]
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


def side_scales(found: CellFit, *, robust: bool) -> tuple[float, float]:
    """Return by how much each camera's spots scatter more than the fit's deviations say, times its scale so far."""
    dof = 1.0 - len(found.free) / max(2.0 * len(found.spots), 1.0)
    out = []
    for side in (0, 1):
        r = found.normals.residuals[found.spots.side == side]
        if not len(r):
            out.append(found.scale[side])
            continue
        # sqrt(2 log 2) = 1.177 is the median length of two unit normals
        size = np.median(np.linalg.norm(r, axis=1)) / 1.177 if robust else np.sqrt(np.mean(r**2))
        out.append(found.scale[side] * float(size) / np.sqrt(dof))
    return out[0], out[1]


def learned_tolerance(model: CellModel, found: CellFit, tolerance: ArmTolerance) -> ArmTolerance:
    """Return how far this arm is from its model, by class of parameter, as its own corrections show.

    Expectation maximisation of the variance of each class's corrections (Dempster, Laird, Rubin 1977, example 4.7):
    lengths; zeros and directions of axes. Never beyond what was given, never below what any arm is built to.
    """
    free = found.places
    H = found.information(model)[np.ix_(free, free)]
    arm = [k for k, at in enumerate(free) if model.arm_at <= at < model.lights_at]
    names = [model.names[free[k]] for k in arm]
    classes: dict[str, list[int]] = {key: [] for key in LEAST}
    for k, name in zip(arm, names, strict=True):
        key = tolerance.kind(name)
        if key in classes:
            classes[key].append(k)
    before = np.diag(found.known.information)[free]
    off = (found.x - found.known.x)[free]
    sigma = {name: getattr(tolerance, name) for name in classes}
    for _ in range(EM_ROUNDS):
        change = np.zeros(len(free))
        for name, rows in classes.items():
            change[rows] = sigma[name] ** -2 - before[rows]
        C = np.linalg.inv(H + np.diag(change))
        moved = off - C @ (change * off)
        for name, rows in classes.items():
            if len(rows) > 2:
                square = float(np.mean(moved[rows] ** 2 + np.diag(C)[rows])) * len(rows) / (len(rows) - 2)
                sigma[name] = min(max(np.sqrt(square), LEAST[name]), getattr(tolerance, name))
    return replace(tolerance, **sigma)
