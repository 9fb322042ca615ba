"""A real wrist camera as a cell: 15 pictures of a board of dots with the robot's poses, in one bundle, and as a chain.

The camera is fixed in the wrist and the dots in the robot's base: the cell's problem with base and flange exchanged.
"Base" is the wrist, "flange" the robot's base, and the arm between them a virtual one of three turns about the wrist's
origin and three slides along the base's axes, which takes any pose exactly. Its straying is the robot's error, in
rotations and in positions, another one for every picture.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares, minimize
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.calibrate.cameras import calibrate_camera
from armsight.calibrate.cell.fit import CellData, CellFit
from armsight.calibrate.cell.knowledge import ArmTolerance, Knowledge, default_knowledge, shape_information, shape_terms
from armsight.calibrate.cell.model import PER_CAMERA, CellModel, start_vector
from armsight.calibrate.cell.observations import CellRecording, JointLog, Spots
from armsight.calibrate.cell.wander import Wander, restricted_cost
from armsight.calibrate.handeye import Setup, calibrate_from_views
from armsight.calibrate.timing.stamps import SteadyStamps
from armsight.fitting import Evaluation, Problem, Settings, solve
from armsight.fitting.normal import NormalEquations
from armsight.geometry import align_points
from armsight.kinematics import Arm, Joint, fk
from armsight.measure.boards import find_board
from armsight.optics import Camera
from armsight.records import BoardView, Motion, Target, TargetKind, board_target

Array = NDArray[np.float64]

FOLDER = Path(__file__).resolve().parents[3] / "shared" / "data" / "dots_10x10_handeye"
CONFIG_M, ROBOT_M, ROBOT_STD_M = 0.0254, 0.02482, 9e-5
"""The dots' pitch by the set's configuration, and by the robot's motion as others have worked it out."""
APART_S, HELD_S, READING_S, PERIOD_S = 5.0, 0.4, 0.02, 1.0 / 30.0
"""Pictures are so far apart, and the log stands still about each: a spline through it has no speed there."""
SCALE, PRINT_M = 0.25, 2e-4
"""How well a print's size is known beforehand, and each dot's place in it: standard deviations."""
SPOT_PX = 0.2
FIRST_STRAY = (3e-3, 3e-3)
"""rad and m, until they are learned."""
STRAY_S = 0.01
"""The robot's errors of two pictures have nothing in common."""
ROUNDS = 4
STATIC = ("delay_s",)
"""Of the camera's parameters what nothing is known of beforehand, and standing pictures cannot tell."""
HALF = 0.5 * np.pi
DRIVES = ("j1.theta_rad", "j2.theta_rad", "j3.theta_rad", "j4.d_m", "j5.d_m", "j6.d_m")


@dataclass(frozen=True, kw_only=True)
class RealSet:
    """Views (n) of the dots and the robot's pose at each."""

    views: list[BoardView]
    robot: list[RigidTransform]

    def take(self, rows: Sequence[int]) -> RealSet:
        """Return some of the pictures."""
        return RealSet(views=[self.views[k] for k in rows], robot=[self.robot[k] for k in rows])


def board_of(pitch_m: float) -> Target:
    """Return the board of 10 x 10 dots."""
    return board_target(TargetKind.CIRCLES, 10, 10, pitch_m)


def read_set() -> RealSet:
    """Return the pictures and poses."""
    views, robot = [], []
    with (FOLDER / "robot_poses.csv").open() as file:
        for row in csv.DictReader(file):
            image = cv2.imread(str(FOLDER / "images" / row["file"]), cv2.IMREAD_GRAYSCALE)
            views.append(find_board(image, board_of(CONFIG_M), source=row["file"]))
            t, q = ([float(row[k]) for k in keys.split()] for keys in ("x_m y_m z_m", "qx qy qz qw"))
            robot.append(RigidTransform.from_components(t, Rotation.from_quat(q)))
    return RealSet(views=views, robot=robot)


# What both methods are judged by: dots that a calibration predicts in a picture it has not seen.


@dataclass(frozen=True, kw_only=True)
class Predicted:
    """Dots in the axes of a calibration's own camera, by the robot's pose (n, 3), and that camera."""

    camera: Camera
    xyz_m: Array


def missed(predicted: Predicted, view: BoardView) -> tuple[float, float, float]:
    """Return how far the dots are from where they are seen, RMS in px and at the target in mm, and the board's place.

    At the target: from the board as this camera sees it, which is the rigid motion that reprojects best.
    """
    camera, xyz = predicted.camera, predicted.xyz_m[view.index]
    px = camera.project(xyz) - view.uv_px
    middle = xyz.mean(axis=0)

    def moved(p: Array) -> Array:
        return np.asarray(Rotation.from_rotvec(p[3:]).apply(xyz - middle) + middle + p[:3])

    seen = least_squares(lambda p: (camera.project(moved(p)) - view.uv_px).ravel(), np.zeros(6), x_scale=1e-3)
    apart = moved(seen.x) - xyz
    return _rms(px), 1e3 * _rms(apart), 1e3 * float(np.linalg.norm(apart[0]))


def _rms(vectors: Array) -> float:
    return float(np.sqrt((vectors**2).sum(axis=1).mean()))


# The chain: the lens from the boards, then hand-eye from the same pictures.


@dataclass(frozen=True, kw_only=True)
class Chain:
    """What `calibrate camera` and `calibrate handeye --images` make of pictures, and the pitch they believe."""

    camera: Camera
    T_wrist_camera: RigidTransform
    T_base_board: RigidTransform
    pitch_m: float
    pitch_found_m: float
    pitch_std_m: float

    def predict(self, T_base_wrist: RigidTransform) -> Predicted:
        """Return the dots as the camera should see them."""
        T = self.T_wrist_camera.inv() * T_base_wrist.inv() * self.T_base_board
        return Predicted(camera=self.camera, xyz_m=np.asarray(T.apply(board_of(self.pitch_m).xyz_m)))


def chain_of(given: RealSet, pitch_m: float, *, free_camera: bool = False) -> Chain:
    """Return the chain's calibration with a pitch that it is told."""
    board = board_of(pitch_m)
    lens = calibrate_camera(given.views, board).camera
    done = calibrate_from_views(given.views, given.robot, lens, board, Setup.EYE_IN_HAND, free_camera=free_camera)
    scale = done.result.scale
    factor, std = (1.0, np.inf) if scale is None else (scale.factor, scale.std)
    return Chain(
        camera=done.camera,
        T_wrist_camera=done.result.T_parent_camera,
        T_base_board=done.result.T_parent_target,
        pitch_m=pitch_m,
        pitch_found_m=pitch_m * factor,
        pitch_std_m=pitch_m * std,
    )


def advised_chain(given: RealSet, *, free_camera: bool = False) -> Chain:
    """Return the chain run again with the pitch that it found itself, as its advice says."""
    return chain_of(given, chain_of(given, CONFIG_M).pitch_found_m, free_camera=free_camera)


# The bundle: the same pictures as a cell.


def virtual_arm() -> Arm:
    """Return an arm that takes any pose: turns about z, y, x through its base's origin, then three slides."""
    turns = [("j1", -HALF, 0.0), ("j2", HALF, HALF), ("j3", 0.0, 0.0)]
    slides = [("j4", HALF, 0.0), ("j5", HALF, HALF), ("j6", 0.0, 0.0)]
    return Arm(
        name="any pose",
        joints=(
            *(Joint(name=name, alpha_rad=alpha, theta_rad=theta) for name, alpha, theta in turns),
            *(Joint(name=name, type="prismatic", alpha_rad=alpha, theta_rad=theta) for name, alpha, theta in slides),
        ),
    )


def joints_of(arm: Arm, T_base_wrist: Sequence[RigidTransform]) -> tuple[Array, Rotation]:
    """Return the virtual arm's joints (n, 6) at poses, and the robot's base in the axes of the arm's flange."""
    at_zero = fk(arm, np.zeros(6))
    slides = fk(arm, np.eye(6)[3:])[:, :3, 3].T
    q = np.empty((len(T_base_wrist), 6))
    for row, T in zip(q, T_base_wrist, strict=True):
        row[:3] = T.inv().rotation.as_euler("ZYX")
        row[3:] = np.linalg.solve(slides, -np.asarray(T.translation))  # T_wrist_base = R' (x - t)
    return q, Rotation.from_matrix(at_zero[:3, :3]).inv()


@dataclass(frozen=True, kw_only=True)
class Bundle:
    """A cell of all pictures of a set, of which a fit uses some. base: turns robot's base axes into the flange's."""

    given: RealSet
    model: CellModel
    base: Rotation
    target: Target
    spots: Spots

    def rows(self, pictures: Sequence[int]) -> NDArray[np.bool_]:
        """Return which spots are of some pictures."""
        return np.isin(self.spots.frame, np.asarray(pictures))

    def strayed(self, strays: Array, t_s: Array) -> CellModel:
        """Return the model with the robot's errors (k, 6) at times (k,) put into its log."""
        q = self.model.recording.log.at(t_s)[0] + strays
        return replace(self.model, recording=replace(self.model.recording, log=standing_log(t_s, q)))

    def predict(self, x: Array, picture: int) -> Predicted:
        """Return the dots in a picture by the robot's pose and parameters x."""
        t_s = np.array([APART_S * picture])
        T = self.model.flange(x, self.model.recording.log.at(t_s)[0])[0]
        at_wrist = self.model.lights_m(x) @ T[:3, :3].T + T[:3, 3]
        return Predicted(camera=self.model.camera(x, 0), xyz_m=self.model.T_base_camera(x, 0).inv().apply(at_wrist))

    def pitch_m(self, x: Array) -> tuple[float, Array]:
        """Return the dots' pitch by parameters x, and its derivative (P,)."""
        lights, board = self.model.lights_m(x), self.target.xyz_m - self.target.xyz_m.mean(axis=0)
        turned = board @ align_points(lights, self.target.xyz_m).T_a_b.rotation.as_matrix().T
        weight = turned * self.target.pitch_m / np.vdot(turned, turned)
        slope = np.zeros(len(x))
        slope[self.model.lights_at :] = weight.ravel()
        return float(np.vdot(weight, lights - lights.mean(axis=0))), slope


def bundle_of(given: RealSet, *, scale: float = SCALE, print_m: float = PRINT_M) -> Bundle:
    """Return the cell: the board's size is known to a share of scale, each dot's place in it to print_m."""
    arm = virtual_arm()
    q, base = joints_of(arm, given.robot)
    n = len(given.views)
    at_s = APART_S * np.arange(n)
    clock = SteadyStamps(
        t_s=at_s, number=np.arange(n), period_s=PERIOD_S, jitter_s=0.0, jitter_std_s=0.0, mid_s=0.0,
        covariance=np.zeros((2, 2)),
    )  # fmt: skip
    size = (given.views[0].width, given.views[0].height)
    spots = spots_of(given.views)
    recording = CellRecording(arm=arm, log=standing_log(at_s, q), spots=spots, clocks=(clock, clock), sizes=(size, size))
    board = board_of(CONFIG_M)
    grid = (board.xyz_m - board.xyz_m.mean(axis=0)).ravel()
    covariance = scale**2 * np.outer(grid, grid) + print_m**2 * np.eye(len(grid))
    target = replace(board, covariance=covariance)
    return Bundle(
        given=given,
        model=CellModel(recording=recording, lights=target.names),
        base=base,
        target=target,
        spots=spots,
    )


def standing_log(at_s: Array, q: Array) -> JointLog:
    """Return the log of an arm that stands at q (n, 6) about times (n,)."""
    around = np.arange(-HELD_S, HELD_S + 0.5 * READING_S, READING_S)
    return JointLog.of(Motion(t_s=(at_s[:, None] + around).ravel(), q=np.repeat(q, len(around), axis=0)))


def spots_of(views: Sequence[BoardView]) -> Spots:
    """Return the dots of views as spots of the left camera, one frame each."""
    count = [len(view) for view in views]
    frame = np.repeat(np.arange(len(views)), count)
    m = len(frame)
    return Spots(
        side=np.zeros(m, np.intp),
        light=np.concatenate([view.index for view in views]).astype(np.intp),
        frame=frame,
        stamp_s=APART_S * frame,
        line=np.concatenate([view.uv_px[:, 1] / (view.height - 1) - 0.5 for view in views]),
        uv_px=np.concatenate([view.uv_px for view in views]),
        covariance_px2=np.tile(np.eye(2) * SPOT_PX**2, (m, 1, 1)),
    )


def free_names(model: CellModel) -> tuple[str, ...]:
    """Return what is fitted: the one camera without its delay, and the dots; the virtual arm is exact."""
    camera = [f"left.{name}" for name in PER_CAMERA if name not in ("skew", *STATIC)]
    return (*camera, *model.names[model.lights_at :])


def start_of(bundle: Bundle, pictures: Sequence[int]) -> Array:
    """Return the chain's answer with the pitch that it was told, as parameters."""
    chain = chain_of(bundle.given.take(pictures), CONFIG_M)
    T = chain.T_wrist_camera
    camera = [chain.camera.intrinsics, T.translation, T.rotation.as_rotvec(), np.zeros(3)]
    dots = bundle.base.apply(chain.T_base_board.apply(board_of(CONFIG_M).xyz_m))
    return start_vector(bundle.model, [np.concatenate(camera)] * 2, dots)


@dataclass(frozen=True, kw_only=True)
class BundleFit:
    """A fit, the bundle with the robot's poses moved by the errors it found, and those errors (n, 6), rad and m."""

    found: CellFit
    strayed: CellModel
    strays: Array


def fit_bundle(bundle: Bundle, pictures: Sequence[int]) -> BundleFit:
    """Return the fit to some pictures: parameters, the dots' noise and the robot's errors, by turns."""
    model = bundle.model
    x = start_of(bundle, pictures)
    known = default_knowledge(model, x, ArmTolerance(), bundle.target)
    spots = bundle.spots.take(bundle.rows(pictures))
    t_s, block = np.unique(spots.stamp_s, return_inverse=True)
    wander = Wander(
        std=np.repeat(FIRST_STRAY, 3),
        time_s=STRAY_S,
        columns=np.array([model.names.index(name) for name in DRIVES], dtype=np.intp),
        t_s=t_s,
    )
    data = CellData(spots=spots, block=block.astype(np.intp), scale=(1.0, 1.0), wander=wander)
    strays = np.zeros((len(t_s), 6))
    for _ in range(ROUNDS):
        fit = _fit_straying(bundle, x, strays, data, known)
        x, strays, data = fit.found.x, fit.strays, learned_noise(fit)
    return fit


def _fit_straying(bundle: Bundle, x: Array, strays: Array, data: CellData, known: Knowledge) -> BundleFit:
    """Return the fit of parameters and of the robot's error in every picture, which is too large to be linear in."""
    model, wander = bundle.model, data.wander
    assert wander is not None
    free, at, W = free_names(model), wander.columns, data.spots.whitening(data.scale)
    held = [k for k, name in enumerate(model.names) if name not in free]
    information = known.information.copy()
    information[held] = information[:, held] = 0.0
    precision, first = np.diag(wander.std**-2.0), model.lights_at

    def evaluate(x: Array, local: Array) -> Evaluation:
        n = bundle.strayed(local, wander.t_s).normals(x, data.spots, W, data.block)
        pull, (shape, off) = known.pull(model, x), shape_terms(model, x, known.shape)
        A, b = n.A.sum(axis=0) + information, n.g.sum(axis=0) + information @ pull
        A[first:, first:] += shape
        b[first:] += shape @ off
        condensed = NormalEquations(
            A=A,
            b=b,
            C=n.A[:, at][:, :, at] + precision,
            c=n.g[:, at] + local @ precision,
            W=n.A[:, :, at],
        )
        cost = np.array([pull @ information @ pull + off @ shape @ off])
        r = np.concatenate([n.residuals.ravel(), (local / wander.std).ravel(), np.sqrt(np.maximum(cost, 0.0))])
        none = np.empty((1, len(r), 0))
        return Evaluation(residuals=r[None], shared=none, local=none, condensed=condensed)

    problem = Problem(
        names=model.names,
        guess=x,
        evaluate=evaluate,
        n_residuals=2 * len(data.spots) + strays.size,
        local_names=DRIVES,
        local_guess=strays,
        fixed=frozenset(model.names) - frozenset(free),
        retract=model.retract,
    )
    fit = solve(problem, Settings(cost_tolerance=1e-9))
    strays, strayed = np.asarray(fit.local), bundle.strayed(fit.local, wander.t_s)
    normals = strayed.normals(fit.shared, data.spots, W, data.block)
    found = CellFit(x=fit.shared, data=data, normals=normals, free=free, known=known, fit=fit)
    return BundleFit(found=found, strayed=strayed, strays=strays)


def learned_noise(fit: BundleFit) -> CellData:
    """Return the data with the noise of dots and robot that is likeliest by a fit: px, rad and m, restricted."""
    found, model, s = fit.found, fit.strayed, fit.strays
    wander, free, n = found.wander, found.places, found.normals
    assert wander is not None
    at = wander.columns
    # as the residuals would be without the robot's errors, by the derivatives at these
    back = np.einsum("bpk,bk->bp", n.A[:, :, at], s)
    chi2 = n.chi2 - 2.0 * np.einsum("bk,bk->b", n.g[:, at], s) + np.einsum("bk,bk->b", back[:, at], s)
    normals = replace(n, g=n.g - back, chi2=chi2)
    known = (found.known.information + shape_information(model, found.x, found.known.shape))[np.ix_(free, free)]

    def noisier(p: Array) -> tuple[Wander, float]:
        return replace(wander, std=wander.std * np.repeat(np.exp(p[1:]), 3)), float(np.exp(p[0]))

    def cost(p: Array) -> float:
        strays, px = noisier(p)
        scaled = replace(normals, A=normals.A / px**2, g=normals.g / px**2, chi2=normals.chi2 / px**2)
        return restricted_cost(strays, scaled, free, known) + float(normals.count.sum()) * float(np.log(px))

    best = minimize(cost, np.zeros(3), method="Nelder-Mead", options={"xatol": 0.02, "fatol": 0.02, "maxfev": 120})
    strays, px = noisier(best.x)
    return replace(found.data, wander=strays, scale=(found.scale[0] * px, found.scale[1]))
