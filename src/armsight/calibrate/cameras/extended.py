"""One more camera beside a rig, or one of it again: the others stay as they are, and their doubt counts in the new one.

The others' numbers are held, and what they are not known to is carried over: x follows o by -Hxx^-1 Hxo, so that its
covariance is that of its own images and Hxx^-1 Hxo cov(o) Hox Hxx^-1 (a consider covariance, Schmidt 1966).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import RigidTransform
from scipy.special import chdtri

from armsight.arrays import Array
from armsight.calibrate.cameras.bundle_adjustment import POSE, Bundle, bundle_of, names_of, problem_of
from armsight.calibrate.cameras.outlier_rejection import RobustFit
from armsight.errors import Inconsistent
from armsight.geometry.poses import skew
from armsight.optics import Camera
from armsight.records import NamedCovariance

MOVED = 1e-6
"""The rig's cameras have moved where chance puts the board so far from them this often."""
FELT = 1e-9
"""Share of the largest by which boards must tell something of the rig's cameras to be asked about it."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StandingRig:
    """Cameras that stay: by name, with T_first_camera and the covariance of what of the 16 C - 6 numbers is known, in
    axes of the first; zero of the others."""

    cameras: dict[str, Camera]
    T_first_camera: Sequence[RigidTransform]
    covariance: NamedCovariance

    @property
    def held(self) -> frozenset[str]:
        """Names of the numbers that a fit beside it holds."""
        first = next(iter(self.cameras))
        lenses = {f"{name}.{one}" for name, camera in self.cameras.items() for one in camera.names}
        return frozenset(lenses | {f"{name}.{one}" for name in self.cameras if name != first for one in POSE})

    def regauged(self, first: str) -> StandingRig:
        """Return it in axes of another of its cameras, which comes first."""
        names = list(self.cameras)
        b = names.index(first)
        if b == 0:
            return self
        T, order = self.T_first_camera, [b, *(c for c in range(len(names)) if c != b)]
        R = T[b].rotation.as_matrix().T
        old = [one for one in self.covariance.names if one.split(".")[1] in POSE]
        lens = [one for one in self.covariance.names if one not in old]
        new = [f"{names[c]}.{one}" for c in order[1:] for one in POSE]
        J = np.zeros((len(lens) + len(new), len(lens) + len(old)))
        J[: len(lens), : len(lens)] = np.eye(len(lens))

        def put(c: int, of: int, block: Array) -> None:
            """Set how the pose of c moves with that of another, where that is known."""
            at = [old.index(f"{names[of]}.{one}") if f"{names[of]}.{one}" in old else -1 for one in POSE]
            row = len(lens) + new.index(f"{names[c]}.tx")
            for k, column in enumerate(at):
                if column >= 0:
                    J[row : row + 6, len(lens) + column] += block[:, k]

        for c in order[1:]:
            # T_b_c = T_b^-1 T_c: R_b' (t_c - t_b) and R_b' R_c, each moved as t + dt, Exp(dw) R
            own = np.zeros((6, 6))
            own[:3, :3] = own[3:, 3:] = R
            by_b = -own.copy()
            by_b[:3, 3:] = R @ skew(T[c].translation - T[b].translation)
            put(c, b, by_b)
            put(c, c, own)
        matrix = J @ self.covariance.block((*lens, *old)) @ J.T
        return StandingRig(
            cameras={names[c]: self.cameras[names[c]] for c in order},
            T_first_camera=[T[b].inv() * T[c] for c in order],
            covariance=NamedCovariance(names=(*lens, *new), matrix=0.5 * (matrix + matrix.T)),
        )


def with_standing(names: Sequence[str], start: Bundle, rig: StandingRig) -> Bundle:
    """Return the start of cameras of these names, the rig's own first, where the rig has them."""
    k, sides, own = start.k.copy(), start.sides.copy(), list(rig.cameras)
    for c, name in enumerate(names):
        if name in own:
            T = rig.T_first_camera[own.index(name)]
            k[c] = rig.cameras[name].intrinsics
            sides[c - 1] = sides[c - 1] if c == 0 else np.concatenate([T.translation, T.rotation.as_rotvec()])
    return replace(start, k=k, sides=sides)


def considered(robust: RobustFit, rig: StandingRig) -> NamedCovariance:
    """Return the covariance of the rig's numbers and of the new camera's together.

    Raises Inconsistent where the rig's cameras do not see the board where the rig has it.
    """
    seen, fit = robust.observations, robust.fit
    (own,) = [one for one in (fit.covariance,) if one is not None]
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
