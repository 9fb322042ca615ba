"""Bundle adjustment of boards seen by some cameras, on the one least-squares engine."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation
from scipy.special import chdtri

from armsight.arrays import Array
from armsight.calibrate.cameras.kernels import move_poses, view_normal_equations
from armsight.calibrate.cameras.moving_board import motion_of
from armsight.calibrate.cameras.observations import Known, Observations
from armsight.fitting import Evaluation, Fit, NormalEquations, Prior, Problem, Settings, solve
from armsight.optics import INTRINSICS, LensKind
from armsight.optics.camera import EMPTY_PLACE, INTRINSICS_OF, PACKED, names_beside
from armsight.optics.kernels.wide import FISHEYE, RATIONAL
from armsight.records import Progress

EMPTY = np.empty((0, 0, 0))
EMPTY.setflags(write=False)
POSE = ("tx", "ty", "tz", "rx", "ry", "rz")
DELAY = "delay"
READOUT = "readout"
BACK = "board:back"
"""Before the names of where a board's back is behind its front; no camera is called so."""
RADIAL = ("k1", "k2", "k3", "k4", "k5", "k6")
"""Of a rational lens: many sets of them say nearly the same, as k1 and k4 do of a lens that bends little."""
DENOMINATOR = RADIAL[3:]
BENDS = Prior(mean=0.0, sigma=30.0)
"""What is known of k4, k5, k6 beforehand: makers' files hold 0.3 to 10, seldom 90. Where the images do not tell them
it keeps a pole that a zero hides out of the picture."""
WIDEST_FIT = float(np.tan(np.radians(89.9)))
"""Tangent of the angle up to which a wide lens's points may come to lie on the way of a fit."""
PACKED_AS = {
    LensKind.PINHOLE: (0.0, 1.0),
    LensKind.FISHEYE: (FISHEYE, WIDEST_FIT),
    LensKind.RATIONAL: (RATIONAL, WIDEST_FIT),
}
BY_CHANCE = 1e-3
"""Further distortion coefficients are freed where chi-square would fall by more than noise does this often."""
VALLEY, VALLEY_SETTLED = 8, 1e-10
"""A fisheye's four terms, and a rational lens's eight, lead through a narrow, bent valley: damped steps in it lower the
cost by little each, and so many times the iterations are needed."""
COST_SETTLED = 1e-6
"""Relative fall of the cost that ends the fit. The step that brings it is a hundredth of the doubt, and convergence is
quadratic: the next one would not be seen."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Bundle:
    """A state of the adjustment: intrinsics k (C, n), of any rational lens n is 13, else 10;
    T_first_camera of the others (C - 1, 6) and T_first_board (G, 6)
    as (t, rotvec); by how much the others' clocks are late, delays_s (C - 1,), none where they are not asked for; of a
    board with two sides T_front_back, back (6,), between their middles; how long each camera takes to read a picture,
    readouts_s (C,), none where that is not asked."""

    k: Array
    poses: Array
    sides: Array = field(default_factory=lambda: np.zeros((0, 6)))
    delays_s: Array = field(default_factory=lambda: np.zeros(0))
    back: Array = field(default_factory=lambda: np.zeros(0))
    readouts_s: Array = field(default_factory=lambda: np.zeros(0))


def side_by_side(lenses: Sequence[Array]) -> Array:
    """Return the intrinsics of cameras (C, n), zero in the places that some have not."""
    n = max(map(len, lenses))
    return np.array([np.pad(k, (0, n - len(k))) for k in lenses])


def names_of(observations: Observations) -> tuple[str, ...]:
    """Return the names of the shared parameters: plain for one camera, else by camera, with the others' poses."""
    lenses, cameras = observations.lenses, observations.cameras
    if len(lenses) == 1:
        return INTRINSICS_OF[lenses[0]]
    own = zip(cameras, names_beside(lenses), strict=True)
    each = [f"{camera}.{name}" for camera, names in own for name in names]
    each += [f"{camera}.{name}" for camera in cameras[1:] for name in POSE]
    each += [] if observations.n_front is None else [f"{BACK}.{name}" for name in POSE]
    each += [] if observations.t_s is None else delays_of(cameras)
    return tuple(each) + (() if observations.line is None else readouts_of(cameras))


def delays_of(cameras: tuple[str, ...]) -> tuple[str, ...]:
    """Return the names of the cameras' delays behind the first one."""
    return tuple(f"{camera}.{DELAY}" for camera in cameras[1:])


def readouts_of(cameras: tuple[str, ...]) -> tuple[str, ...]:
    """Return the names of how long the cameras take to read a picture."""
    return tuple(f"{camera}.{READOUT}" for camera in cameras)


RIGHT = frozenset(f"right.{name}" for name in INTRINSICS)


def problem_of(observations: Observations, start: Bundle, fixed: frozenset[str]) -> Problem:
    """Return the least-squares problem; fixed: names of names_of that are held.

    Views of one lens share the left one's intrinsics, and the right ones' are held at them. Where times are known, the
    boards' poses are held together by the board's motion; of a board with two sides the back follows the front.
    """
    equations = BoardEquations(observations)
    k0 = np.tile(start.k.mean(axis=0), (2, 1)) if equations.tied else start.k
    names = names_of(observations)
    if equations.tied:
        fixed = fixed | RIGHT
    if observations.has_wide:
        fixed = fixed | {name for name in names if name.split(".")[-1] == EMPTY_PLACE}
    guess = np.concatenate([k0.ravel(), start.sides.ravel()])
    evaluate, retract, local, rows = equations.evaluate, equations.retract, start.poses, 2 * observations.n_points
    if observations.chained:
        motion = motion_of(observations, start.delays_s, start.readouts_s)
        views = BoardEquations(motion.views)
        evaluate, retract = partial(motion.evaluate, views.evaluate), partial(motion.retract, views.retract)
        delays, readouts = motion.own[1:]
        guess = np.concatenate([guess, start.back, start.delays_s[:delays], start.readouts_s[:readouts]])
        local, rows = motion.nodes_of(start.poses), rows + motion.n_empty
    if observations.known is not None:
        at = np.array([names.index(name) for name in observations.known.names], np.intp)
        evaluate, rows = partial(_with_known, evaluate, observations.known, at), rows + len(at)
    return Problem(
        names=names,
        guess=guess,
        evaluate=evaluate,
        n_residuals=rows,
        local_names=POSE * (local.shape[1] // len(POSE)),
        local_guess=local,
        fixed=fixed,
        priors=dict.fromkeys(_of_rational(observations, DENOMINATOR), BENDS),
        retract=retract,
    )


def _of_rational(observations: Observations, coefficients: Iterable[str]) -> list[str]:
    """Return the names of some coefficients of the rational lenses among the shared parameters."""
    own = zip(observations.cameras, observations.lenses, strict=True)
    before = [f"{camera}." * (observations.n_cameras > 1) for camera, lens in own if lens is LensKind.RATIONAL]
    return [f"{camera}{name}" for camera in before for name in coefficients]


def _with_known(
    evaluate: Callable[[Array, Array], Evaluation], known: Known, at: NDArray[np.intp], shared: Array, local: Array
) -> Evaluation:
    """Return an evaluation with what is known beforehand: as further observations of the shared parameters `at`."""
    here = evaluate(shared, local)
    if here.condensed is None:
        return here
    off = shared[at] - known.mean
    A, b = here.condensed.A.copy(), here.condensed.b.copy()
    A[np.ix_(at, at)] += known.information
    b[at] += known.information @ off
    # L' x is white where the information is L L'
    rows = np.linalg.cholesky(known.information).T @ off
    return replace(
        here,
        residuals=np.concatenate([here.residuals.ravel(), rows])[None],
        condensed=replace(here.condensed, A=A, b=b),
    )


@dataclass(frozen=True, slots=True, eq=False)
class BoardEquations:
    """Residuals and normal equations of boards seen by some cameras, and how its parameters move."""

    observations: Observations

    @property
    def tied(self) -> bool:
        """Whether two views share the left one's intrinsics."""
        return self.observations.one_lens and self.observations.n_cameras == 2

    def evaluate(self, shared: Array, local: Array) -> Evaluation:
        """Return the normal equations at intrinsics and cameras' poses (shared), and the boards' poses (local)."""
        seen, n_cameras, G = self.observations, self.observations.n_cameras, self.observations.n_views
        S, L, split = len(shared), len(POSE), seen.n_intrinsics * n_cameras
        r, A, b = np.empty((G, 2 * len(seen.X) * n_cameras)), np.empty((S, S)), np.empty(S)
        C, c, W = np.empty((G, L, L)), np.empty((G, L)), np.empty((G, S, L))
        k = shared[:split].reshape(n_cameras, -1)
        if self.tied:
            k = np.ascontiguousarray(k[[0, 0]])
        packed = np.zeros((n_cameras, PACKED))
        packed[:, :10], packed[:, 10:12] = k[:, :10], [PACKED_AS[lens] for lens in seen.lenses]
        packed[:, 12 : 2 + k.shape[1]] = k[:, 10:]
        sides, poses = np.array(shared[split:].reshape(-1, L)), np.array(local)  # writable: one compilation serves all
        board, views = (seen.X, seen.radius_m), (seen.uv, seen.weight)
        fine = view_normal_equations((packed, sides, poses), board, views, r, (A, b, C, c, W))
        if self.tied:
            _tie(A, b, W)
        return Evaluation(
            residuals=r if fine else np.full_like(r, np.nan),
            shared=EMPTY,
            local=EMPTY,
            condensed=NormalEquations(A=A, b=b, C=C, c=c, W=W),
        )

    def retract(self, shared: Array, local: Array, step_shared: Array, step_local: Array) -> tuple[Array, Array]:
        """Return both after a step; poses are turned, and a shared lens moves in both views."""
        split = self.observations.n_intrinsics * self.observations.n_cameras
        moved, poses = shared + step_shared, np.empty_like(local)
        move_poses(np.array(local), np.array(step_local), poses)
        if self.tied:
            moved[split // 2 : split] = moved[: split // 2]
        sides, steps = (np.array(part[split:].reshape(-1, len(POSE))) for part in (shared, step_shared))
        if len(sides):
            move_poses(sides, steps, moved[split:].reshape(-1, len(POSE)))
        return moved, poses


def _tie(A: Array, b: Array, W: Array) -> None:
    """Move the right view's share of the normal equations to the left one's intrinsics, in place."""
    n = len(INTRINSICS)
    # both views follow one lens: by the chain rule the right view's columns are added to the left one's
    for M in (A, A.T):
        M[:n] += M[n : 2 * n]
        M[n : 2 * n] = 0.0
    b[:n] += b[n : 2 * n]
    b[n : 2 * n] = 0.0
    W[:, :n] += W[:, n : 2 * n]
    W[:, n : 2 * n] = 0.0


def adjust(
    observations: Observations,
    start: Bundle,
    fixed: frozenset[str],
    *,
    max_iterations: int,
    progress: Progress | None = None,
) -> Fit:
    """Return the fit; covariances are scaled by the noise that the residuals show.

    Raises NotConverged, Undetermined, Cancelled as the engine does.
    """
    settings = Settings(estimate_noise=True, max_iterations=max_iterations, cost_tolerance=COST_SETTLED)
    later = frozenset(_of_rational(observations, DENOMINATOR)) - fixed
    if later and not start.k[:, len(INTRINSICS) :].any():
        # of no distortion k1 and k4 say the same: first without the denominator
        start = bundle_of(adjust(observations, start, fixed | later, max_iterations=max_iterations), len(start.k))
    if observations.has_wide:
        many, loose = VALLEY * max_iterations, frozenset(_of_rational(observations, RADIAL))
        settings = replace(settings, max_iterations=many, cost_tolerance=VALLEY_SETTLED, loose=loose)
    fit = solve(problem_of(observations, start, fixed), settings, progress)
    if observations.chained:
        fit = motion_of(observations, start.delays_s, start.readouts_s).of_moments(fit)
    if observations.known is not None:
        own = fit.residuals.ravel()[: 2 * observations.weight.size].reshape(observations.n_views, -1)
        fit = replace(fit, residuals=own, weights=np.ones_like(own))
    return fit


def bundle_of(fit: Fit, n_cameras: int) -> Bundle:
    """Return the state that a fit has reached."""
    split = _n_intrinsics(fit.names, n_cameras) * n_cameras
    end = split + len(POSE) * (n_cameras - 1)
    late = end + sum(name.startswith(BACK) for name in fit.names)
    rolled = len(fit.names) - sum(name.endswith(f".{READOUT}") for name in fit.names)
    return Bundle(
        k=fit.shared[:split].reshape(n_cameras, -1),
        sides=fit.shared[split:end].reshape(-1, len(POSE)),
        poses=fit.local,
        delays_s=fit.shared[late:rolled],
        back=fit.shared[end:late],
        readouts_s=fit.shared[rolled:],
    )


def _n_intrinsics(names: tuple[str, ...], n_cameras: int) -> int:
    """Return how many intrinsics of each camera a fit of names_of has."""
    first = names[0].removesuffix("fx")
    return len(names) if n_cameras == 1 else next(i for i, name in enumerate(names) if not name.startswith(first))


def asks_to_be_freed(observations: Observations, fit: Fit, fixed: frozenset[str], names: frozenset[str]) -> bool:
    """Tell whether freeing some fixed parameters would lower chi-square by more than chance does (a score test)."""
    wider = fixed - names
    problem = problem_of(observations, bundle_of(fit, observations.n_cameras), wider)
    evaluation = problem.evaluate(problem.guess, problem.local_guess)
    free = np.array([i for i, n in enumerate(problem.names) if n not in problem.fixed], dtype=np.intp)
    normal = problem.normal_equations(evaluation, problem.guess, free)
    # the score test (Rao 1948): g' H^-1 g is the fall of chi-square to first order, with no second fit
    fall = 2.0 * normal.predicted_decrease(*normal.step(0.0))
    return bool(fall > chdtri(len(names), BY_CHANCE) * fit.scale**2)


def residuals_px(observations: Observations, fit: Fit) -> Array:
    """Return the residuals (G, C, n, 2) in px, zero where not seen."""
    G, C, n = observations.weight.shape
    whitened = fit.residuals.reshape(G, C, n, 2)
    sigma = np.divide(1.0, observations.weight, out=np.zeros_like(observations.weight), where=observations.weight > 0.0)
    return np.asarray(whitened * sigma[..., None])


def poses_of_boards(observations: Observations, fit: Fit) -> Array:
    """Return T_camera_board (G, 4, 4) of each view, of the first camera of some, in the board's own axes."""
    local = bundle_of(fit, observations.n_cameras).poses
    T_camera_middle = RigidTransform.from_components(local[:, :3], Rotation.from_rotvec(local[:, 3:]))
    return np.asarray((T_camera_middle * RigidTransform.from_translation(-observations.middle)).as_matrix())


def without(observations: Observations, bad: NDArray[np.bool_]) -> Observations:
    """Return the observations without the points marked in bad (G, C, n)."""
    return replace(observations, weight=np.where(bad, 0.0, observations.weight))


def start_at(bundle: Bundle, views: NDArray[np.intp]) -> Bundle:
    """Return the state of some of the views."""
    return replace(bundle, poses=bundle.poses[views])
