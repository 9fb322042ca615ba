"""One more camera beside a rig, or one of it again: the others stay as they are, and their doubt counts in the new one.

The others' numbers are held, and what they are not known to is carried over: x follows o by -Hxx^-1 Hxo, so that its
covariance is that of its own images and Hxx^-1 Hxo cov(o) Hox Hxx^-1 (a consider covariance, Schmidt 1966).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import chdtri

from armsight.arrays import Array
from armsight.calibrate.cameras.bundle_adjustment import Bundle, bundle_of, names_of, problem_of
from armsight.calibrate.cameras.outlier_rejection import RobustFit
from armsight.calibrate.cameras.pairing import in_frame
from armsight.errors import Inconsistent
from armsight.optics import Rig
from armsight.optics.mounted import MountedCamera
from armsight.records import NamedCovariance

MOVED = 1e-6
"""The rig's cameras have moved where chance puts the board so far from them this often."""
FELT = 1e-9
"""Share of the largest by which boards must tell something of the rig's cameras to be asked about it."""


def held_beside(rig: Rig) -> frozenset[str]:
    """Return the names of the numbers that a fit beside a rig holds: all of it."""
    return frozenset(rig.parameters)


def with_standing(names: Sequence[str], start: Bundle, rig: Rig) -> Bundle:
    """Return the start of cameras of these names where the rig, in axes of the first of them, has them."""
    k, sides = start.k.copy(), start.sides.copy()
    for c, name in enumerate(names):
        if name in rig.names:
            own, T = rig.camera(name).intrinsics, rig.T_rig_camera(name)
            k[c, : len(own)] = own
            if c:
                sides[c - 1] = np.concatenate([T.translation, T.rotation.as_rotvec()])
    return replace(start, k=k, sides=sides)


def placed_beside(rig: Rig, standing: Rig, new: MountedCamera, covariance: NamedCovariance) -> Rig:
    """Return the rig with one more camera as its last, or one of its own anew; its axes and the others stay.

    standing: the rig's others in axes of the first of them; new and covariance: in these axes too.
    """
    beside = Rig(cameras=(*standing.cameras, new), covariance=covariance)
    order = rig.names if new.name in rig.names else (*rig.names, new.name)
    back = in_frame(beside, rig.T_rig_camera(standing.names[0])).only(*order)
    own = {one.name: one for one in rig.cameras if one.name != new.name}
    return replace(back, cameras=tuple(own.get(one.name, one) for one in back.cameras))


def considered(robust: RobustFit, rig: Rig) -> NamedCovariance:
    """Return the covariance of the rig's numbers and of the new camera's together.

    Raises Inconsistent where the rig's cameras do not see the board where the rig has it.
    """
    seen, fit = robust.observations, robust.fit
    (own,) = [one for one in (fit.covariance,) if one is not None]
    if rig.covariance is None:
        return own
    every_known = rig.covariance.names
    known = tuple(name for name in every_known if name in fit.names)
    fixed = frozenset(names_of(seen)) - {*own.names, *known}
    problem = problem_of(seen, bundle_of(fit, seen.n_cameras), fixed)
    free = np.array([i for i, name in enumerate(problem.names) if name not in problem.fixed], np.intp)
    evaluation = problem.evaluate(problem.guess, problem.local_guess)
    normal = problem.normal_equations(evaluation, problem.guess, free)
    H = normal.reduced_system() / fit.scale**2
    score = normal.b - np.einsum("gfl,gl->f", normal.W, np.linalg.solve(normal.C, normal.c[..., None])[..., 0])
    x = [problem.free.index(name) for name in own.names]
    o = [problem.free.index(name) for name in known]
    # the new numbers are where they fit best whatever the rig's are: how they follow these
    follow = -np.linalg.solve(H[np.ix_(x, x)], H[np.ix_(x, o)])
    sigma = rig.covariance.block(known)
    _require_standing(H[np.ix_(o, o)] + H[np.ix_(o, x)] @ follow, score[o] / fit.scale**2, sigma, known)
    at = [every_known.index(name) for name in known]
    mixed = follow @ rig.covariance.matrix[at]
    matrix = np.block([[rig.covariance.matrix, mixed.T], [mixed, own.matrix + follow @ sigma @ follow.T]])
    return NamedCovariance(names=(*every_known, *own.names), matrix=0.5 * (matrix + matrix.T))


def _require_standing(H: Array, score: Array, sigma: Array, names: tuple[str, ...]) -> None:
    """Raise Inconsistent where the boards pull the rig's numbers further than their doubt and the noise allow.

    H, score: of the rig's numbers with all others eliminated. The pull has covariance H + H sigma H.
    """
    # in units of the rig's doubt, along directions that are independent in it
    values, vectors = np.linalg.eigh(sigma)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    felt, axes = np.linalg.eigh(root.T @ H @ root)
    pulled = axes.T @ (root.T @ score)
    clear = felt > FELT * max(float(felt[-1]), 1.0)
    chi2 = float((pulled[clear] ** 2 / (felt[clear] * (1.0 + felt[clear]))).sum())
    if not chi2 > chdtri(int(clear.sum()), MOVED):
        return
    step = root @ axes[:, clear] @ (-pulled[clear] / (1.0 + felt[clear]))
    off = np.abs(step) / np.sqrt(np.maximum(np.diag(sigma), 1e-300))
    worst = names[int(np.argmax(off))].split(".")[0]
    raise Inconsistent(
        f"the cameras of the rig do not see the board where the rig puts it: {worst} is off most "
        f"({off.max():.0f} of its standard deviations)",
        consequence="A camera beside them would be placed by a rig that is no longer so, and nothing was calibrated",
        cure=f"If {worst} was knocked, calibrate it again with --again {worst}; else calibrate all cameras together",
    )


# What points that are not where they are said to be make of a bundle: lights known to a covariance, a back of another
# size. One Gauss-Newton step from the solution tells: with the points moved, it is how the fit would follow them.

STEP_M = 1e-6
"""Step of the differences by the lights' places: a thousandth of a pixel."""
STEP_SHARE = 1e-3
"""Share of its size by which a back is made larger and smaller."""
BY_CHANCE = 1e-6
"""A back is of another size where noise looks as much so this often,"""
OTHER_SIZE = 0.005
"""... and where it is off by this share: printers scale by less."""


def with_doubt_of(points: Array | None, robust: RobustFit, covariance: NamedCovariance) -> NamedCovariance:
    """Return a covariance with what the points (3 n, 3 n), m squared, are not known to; as it is of exact ones."""
    if points is None:
        return covariance
    n = len(robust.observations.X)
    start = _after(robust, np.zeros((n, 3)))[0]
    T = np.array([(_after(robust, STEP_M * step.reshape(n, 3))[0] - start) / STEP_M for step in np.eye(3 * n)]).T
    (own,) = [one for one in (robust.fit.covariance,) if one is not None]
    at = [covariance.names.index(name) for name in own.names]
    matrix = covariance.matrix.copy()
    matrix[np.ix_(at, at)] += T @ points @ T.T
    return NamedCovariance(names=covariance.names, matrix=0.5 * (matrix + matrix.T))


def require_size_of_back(robust: RobustFit) -> None:
    """Raise Inconsistent where the prints on the two sides of a board cannot both be of the size that is said."""
    seen = robust.observations
    if seen.n_front is None:
        return
    larger = np.where(np.arange(len(seen.X))[:, None] < seen.n_front, 0.0, STEP_SHARE * seen.X)
    low, here, high = (_after(robust, step)[1] for step in (-larger, 0.0 * larger, larger))
    bend = high - 2.0 * here + low
    off = STEP_SHARE * 0.5 * (low - high) / bend
    gain = 0.25 * (low - high) ** 2 / bend / robust.fit.scale**2
    if gain > chdtri(1, BY_CHANCE) and abs(off) > OTHER_SIZE:
        much = f"{100 * abs(off):.1f} % {'larger' if off > 0 else 'smaller'}"
        raise Inconsistent(
            f"beside the front the back is {much} than it is said to be",
            consequence="The size of one of the prints is wrong, places would be as well, and nothing was calibrated",
            cure="Measure the squares of both prints with a calliper, and give these sizes",
        )


def _after(robust: RobustFit, moved: Array) -> tuple[Array, float]:
    """Return the step (F,) of the free numbers once the points have moved (n, 3), m, and the cost after it."""
    fit, seen = robust.fit, replace(robust.observations, X=robust.observations.X + moved)
    (own,) = [one for one in (fit.covariance,) if one is not None]
    problem = problem_of(seen, bundle_of(fit, seen.n_cameras), frozenset(fit.names) - frozenset(own.names))
    here = problem.evaluate(problem.guess, problem.local_guess)
    normal = problem.normal_equations(here, problem.guess, np.array([fit.names.index(name) for name in own.names]))
    step = normal.step(0.0)
    return step[0], 0.5 * float((here.residuals**2).sum()) - float(normal.predicted_decrease(*step))
