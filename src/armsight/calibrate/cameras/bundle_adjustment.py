"""Bundle adjustment of boards seen by some cameras, on the one least-squares engine."""

from __future__ import annotations

from collections.abc import Callable
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
from armsight.fitting import Evaluation, Fit, NormalEquations, Problem, Settings, solve
from armsight.optics import INTRINSICS, LensKind
from armsight.optics.camera import INTRINSICS_OF
from armsight.optics.kernels.camera import FISHEYE
from armsight.records import Progress

EMPTY = np.empty((0, 0, 0))
EMPTY.setflags(write=False)
POSE = ("tx", "ty", "tz", "rx", "ry", "rz")
DELAY = "delay"
READOUT = "readout"
BACK = "board:back"
"""Before the names of where a board's back is behind its front; no camera is called so."""
EMPTY_PLACE = "none"
"""The name of a fisheye's tenth intrinsic, which stands for nothing."""
WIDEST_FIT = float(np.tan(np.radians(89.9)))
"""Tangent of the angle up to which a fisheye's points may come to lie on the way of a fit."""
BY_CHANCE = 1e-3
"""Further distortion coefficients are freed where chi-square would fall by more than noise does this often."""
VALLEY, VALLEY_SETTLED = 8, 1e-10
"""A fisheye's four terms lead through a narrow, bent valley: damped steps in it lower the cost by little each, and so
many times the iterations are needed."""
COST_SETTLED = 1e-6
"""Relative fall of the cost that ends the fit. The step that brings it is a hundredth of the doubt, and convergence is
quadratic: the next one would not be seen."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Bundle:
    """A state of the adjustment: intrinsics k (C, 10); T_first_camera of the others (C - 1, 6) and T_first_board (G, 6)
    as (t, rotvec); by how much the others' clocks are late, delays_s (C - 1,), none where they are not asked for; of a
    board with two sides T_front_back, back (6,), between their middles; how long each camera takes to read a picture,
    readouts_s (C,), none where that is not asked."""

    k: Array
    poses: Array
    sides: Array = field(default_factory=lambda: np.zeros((0, 6)))
    delays_s: Array = field(default_factory=lambda: np.zeros(0))
    back: Array = field(default_factory=lambda: np.zeros(0))
    readouts_s: Array = field(default_factory=lambda: np.zeros(0))


def names_of(observations: Observations) -> tuple[str, ...]:
    """Return the names of the shared parameters: plain for one camera, else by camera, with the others' poses."""
    lenses, cameras = observations.lenses, observations.cameras
    if len(lenses) == 1:
        return INTRINSICS_OF[lenses[0]]
    each = [f"{camera}.{name}" for camera, lens in zip(cameras, lenses, strict=True) for name in INTRINSICS_OF[lens]]
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
    if LensKind.FISHEYE in observations.lenses:
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
        retract=retract,
    )


def _with_known(
    evaluate: Callable[[Array, Array], Evaluation],
    known: Known,
    at: NDArray[np.intp],
    shared: Array,
    local: Array,
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
        S, L, split = len(shared), len(POSE), len(INTRINSICS) * n_cameras
        r, A, b = np.empty((G, 2 * len(seen.X) * n_cameras)), np.empty((S, S)), np.empty(S)
        C, c, W = np.empty((G, L, L)), np.empty((G, L)), np.empty((G, S, L))
        k = shared[:split].reshape(n_cameras, -1)
        if self.tied:
            k = np.ascontiguousarray(k[[0, 0]])
        kinds = [[FISHEYE, WIDEST_FIT] if lens is LensKind.FISHEYE else [0.0, 1.0] for lens in seen.lenses]
        packed = np.ascontiguousarray(np.column_stack([k, kinds]))
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
        split = len(INTRINSICS) * self.observations.n_cameras
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
    if LensKind.FISHEYE in observations.lenses:
        settings = replace(settings, max_iterations=VALLEY * max_iterations, cost_tolerance=VALLEY_SETTLED)
    fit = solve(problem_of(observations, start, fixed), settings, progress)
    if observations.chained:
        fit = motion_of(observations, start.delays_s, start.readouts_s).of_moments(fit)
    if observations.known is not None:
        own = fit.residuals.ravel()[: 2 * observations.weight.size].reshape(observations.n_views, -1)
        fit = replace(fit, residuals=own, weights=np.ones_like(own))
    return fit


def bundle_of(fit: Fit, n_cameras: int) -> Bundle:
    """Return the state that a fit has reached."""
    split = len(INTRINSICS) * n_cameras
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
