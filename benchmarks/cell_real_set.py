"""A real wrist camera as a cell: 15 pictures of a board of dots with the robot's poses, in one bundle, and as a chain.

The camera is fixed in the wrist and the dots in the robot's base: the cell's problem with base and flange exchanged.
"Base" is the wrist, "flange" the robot's base with its origin moved to the board, and the arm between them a virtual
one that takes any pose exactly: three turns about the wrist's origin, three slides along the base's axes, and three
turns about the board's middle, which stand at zero. Its straying is what robot and pictures are off by against each
other, another one for every picture: the robot's turns and places, and how the board seems tilted (a curved sheet, a
lens that is no polynomial). Each of the three sizes is learned; the hand-eye calibration learns the same three.
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
from armsight.calibrate.cell.fit import CellData, CellFit, fit_cell
from armsight.calibrate.cell.knowledge import ArmTolerance, default_knowledge, shape_information
from armsight.calibrate.cell.model import PER_CAMERA, CellModel, start_vector
from armsight.calibrate.cell.observations import CellRecording, JointLog, Spots
from armsight.calibrate.cell.result import Learned
from armsight.calibrate.cell.wander import JointDrift, restricted_cost
from armsight.calibrate.handeye import Setup, calibrate_from_views
from armsight.calibrate.timing.stamps import SteadyStamps
from armsight.geometry import align_points
from armsight.geometry.poses import skew
from armsight.kinematics import Arm, Joint, JointType, fk
from armsight.measure.boards import find_board
from armsight.optics import Camera
from armsight.records import BoardView, Motion, Target, TargetKind, board_target

Array = NDArray[np.float64]

FOLDER = Path(__file__).resolve().parents[2] / "shared" / "data" / "dots_10x10_handeye"
CONFIG_M, ROBOT_M, ROBOT_STD_M = 0.0254, 0.02482, 9e-5
"""The dots' pitch by the set's configuration, and by the robot's motion as others have worked it out."""
APART_S, HELD_S, READING_S, PERIOD_S = 5.0, 0.4, 0.02, 1.0 / 30.0
"""Pictures are so far apart, and the log stands still about each: a spline through it has no speed there."""
SCALE, PRINT_M = 0.25, 2e-5
"""How well a print's size is known beforehand, and each dot's place in it: standard deviations. The chain takes the
grid as exact; so does the bundle, to hundredths of a millimetre."""
SPOT_PX = 0.2
STRAYS = ("turns about the wrist, rad", "places, m", "turns about the board, rad")
FIRST_STRAY, LEAST_STRAY = (1e-3, 3e-3, 3e-3), 1e-5
"""Until they are learned, and never below."""
STRAY_S = 0.01
"""The robot's errors of two pictures have nothing in common."""
ROUNDS = 2
STATIC = ("delay_s",)
"""Of the camera's parameters what nothing is known of beforehand, and standing pictures cannot tell."""
DRIVES = tuple(f"j{k}.{'d_m' if k in (4, 5, 6) else 'theta_rad'}" for k in range(1, 10))


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
    """Return an arm that takes any pose: turns about z, y, x through its base's origin, three slides, three turns."""
    quarter = 0.5 * np.pi
    links = [(-quarter, 0.0), (quarter, quarter), (0.0, 0.0), (quarter, 0.0), (quarter, quarter), (0.0, 0.0)]
    kinds = ["revolute"] * 3 + ["prismatic"] * 3 + ["revolute"] * 3
    return Arm(
        name="any pose",
        joints=tuple(
            Joint(name=f"j{k}", type=JointType(kind), alpha_rad=alpha, theta_rad=theta)
            for k, (kind, (alpha, theta)) in enumerate(zip(kinds, links + links[:3], strict=True), start=1)
        ),
    )


def joints_of(arm: Arm, T_base_wrist: Sequence[RigidTransform], middle_m: Array) -> tuple[Array, Rotation]:
    """Return the virtual arm's joints (n, 9), its flange at a place in the base; what turns base axes to flange's."""
    at_zero = fk(arm, np.zeros(9))
    slides = fk(arm, np.eye(9)[3:6])[:, :3, 3].T
    q = np.zeros((len(T_base_wrist), 9))
    for row, T in zip(q, T_base_wrist, strict=True):
        row[:3] = T.inv().rotation.as_euler("ZYX")
        row[3:6] = np.linalg.solve(slides, middle_m - np.asarray(T.translation))  # T_wrist_base x = R' (x - t)
    return q, Rotation.from_matrix(at_zero[:3, :3]).inv()


@dataclass(frozen=True, kw_only=True)
class Bundle:
    """A cell of all pictures of a set, of which a fit uses some; x (P,): to begin with, by the chain of these, told the
    configuration's pitch."""

    pictures: tuple[int, ...]
    chain: Chain
    model: CellModel
    target: Target
    x: Array

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


def bundle_of(given: RealSet, pictures: Sequence[int], *, scale: float = SCALE, print_m: float = PRINT_M) -> Bundle:
    """Return the cell: the board's size is known to a share of scale, each dot's place in it to print_m.

    It begins with the chain's answer, from these pictures, with the pitch of the configuration.
    """
    chain = chain_of(given.take(pictures), CONFIG_M)
    board = board_of(CONFIG_M)
    dots = np.asarray(chain.T_base_board.apply(board.xyz_m))
    arm, at_s = virtual_arm(), APART_S * np.arange(len(given.views))
    q, turn = joints_of(arm, given.robot, dots.mean(axis=0))
    clock = SteadyStamps(
        t_s=at_s, number=np.arange(len(at_s)), period_s=PERIOD_S, jitter_s=0.0, jitter_std_s=0.0, mid_s=0.0,
        covariance=np.zeros((2, 2)),
    )  # fmt: skip
    size = (given.views[0].width, given.views[0].height)
    recording = CellRecording(
        arm=arm, log=standing_log(at_s, q), spots=spots_of(given.views), clocks=(clock, clock), sizes=(size, size)
    )
    grid = (board.xyz_m - board.xyz_m.mean(axis=0)).ravel()
    covariance = scale**2 * np.outer(grid, grid) + print_m**2 * np.eye(len(grid))
    target = replace(board, covariance=covariance)
    model = CellModel(recording=recording, lights=target.names)
    T = chain.T_wrist_camera
    camera = np.concatenate([chain.camera.intrinsics, T.translation, T.rotation.as_rotvec(), np.zeros(3)])
    x = start_vector(model, [camera, camera], turn.apply(dots - dots.mean(axis=0)))
    return Bundle(pictures=tuple(pictures), chain=chain, model=model, target=target, x=x)


def standing_log(at_s: Array, q: Array) -> JointLog:
    """Return the log of an arm that stands at q (n, 9) about times (n,)."""
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


def fit_bundle(bundle: Bundle) -> CellFit:
    """Return the fit to the bundle's pictures: parameters, and the noise of dots, robot and tilts, by turns."""
    model, every = bundle.model, bundle.model.recording.spots
    known = default_knowledge(model, bundle.x, ArmTolerance(), bundle.target)
    spots = every.take(np.isin(every.frame, bundle.pictures))
    t_s, block = np.unique(spots.stamp_s, return_inverse=True)
    columns = np.array([model.names.index(name) for name in DRIVES], dtype=np.intp)
    wander = JointDrift(std=np.repeat(FIRST_STRAY, 3), time_s=STRAY_S, columns=columns, t_s=t_s)
    data = CellData(spots=spots, block=block.astype(np.intp), scale=(1.0, 1.0), wander=wander)
    found = fit_cell(model, bundle.x, data, free_names(model), known)
    for _ in range(ROUNDS):
        found = fit_cell(model, found.x, learned_noise(model, found), free_names(model), known)
    return found


def learned_noise(model: CellModel, found: CellFit) -> CellData:
    """Return the data with the noise that is likeliest by a fit: of the dots in px, and of each straying."""
    wander, free, normals = found.wander, found.places, found.normals
    if wander is None:
        raise ValueError("the fit knows no straying")
    known = (found.known.information + shape_information(model, found.x, found.known.shape))[np.ix_(free, free)]

    def noisier(p: Array) -> tuple[JointDrift, float]:
        std = np.maximum(wander.std * np.repeat(np.exp(p[1:]), 3), LEAST_STRAY)
        return replace(wander, std=std), float(np.exp(p[0]))

    def cost(p: Array) -> float:
        strays, px = noisier(p)
        scaled = replace(normals, A=normals.A / px**2, g=normals.g / px**2, chi2=normals.chi2 / px**2)
        return restricted_cost(strays, scaled, free, known) + float(normals.count.sum()) * float(np.log(px))

    simplex = np.vstack([np.zeros(4), 0.5 * np.eye(4)])
    options = {"xatol": 0.05, "fatol": 0.05, "maxfev": 150, "initial_simplex": simplex}
    best = minimize(cost, np.zeros(4), method="Nelder-Mead", options=options)
    strays, px = noisier(best.x)
    return replace(found, wander=strays, scale=(found.scale[0] * px, found.scale[1]))


def told(bundle: Bundle, found: CellFit) -> list[Learned]:
    """Return of the camera and of the board what was known before and is known now, in bits where anything was.

    Of the board: its scale, and the dots' places in it; where it is and how it is turned nothing was known of.
    """
    model, C = bundle.model, found.covariance(bundle.model)
    known = found.known.information
    before = np.linalg.pinv(known, rcond=1e-15, hermitian=True)
    # fx and fy are alike, and of neither alone anything is known: what has no bound beforehand is not in the range
    bound = np.abs(known @ before - np.eye(len(known))).max(axis=0) < 1e-6
    out = []
    for k in found.places[found.places < model.lights_at]:
        prior = float(np.sqrt(before[k, k])) if bound[k] else None
        out.append(_learned(model.names[k], float(found.x[k]), float(np.sqrt(C[k, k])), prior))
    pitch_m, slope = bundle.pitch_m(found.x)
    out.append(_learned("pitch_m", pitch_m, float(np.sqrt(slope @ C @ slope)), SCALE * CONFIG_M))
    lights = model.lights_m(found.x)
    T = align_points(lights, bundle.target.xyz_m * (pitch_m / CONFIG_M)).T_a_b
    off = T.inv().apply(lights) - bundle.target.xyz_m * (pitch_m / CONFIG_M)
    # places in the print: what no rigid motion and no scale does
    grid = lights - lights.mean(axis=0)
    moves = np.hstack([np.tile(np.eye(3), (len(grid), 1)), skew(grid).reshape(-1, 3), grid.reshape(-1, 1)])
    P = np.eye(grid.size) - moves @ np.linalg.pinv(moves)
    inner = P @ C[model.lights_at :, model.lights_at :] @ P
    R = T.rotation.as_matrix()
    print_m = float(np.sqrt(bundle.target.covariance[2, 2]))  # its z has no part in the scale
    for light, name in enumerate(model.lights):
        block = R.T @ inner[3 * light : 3 * light + 3, 3 * light : 3 * light + 3] @ R
        for axis, key in enumerate(("x_m", "y_m", "z_m")):
            std = float(np.sqrt(max(block[axis, axis], 0.0)))
            out.append(_learned(f"print:{name}.{key}", float(off[light, axis]), std, print_m))
    return out


def _learned(name: str, value: float, std: float, prior: float | None) -> Learned:
    return Learned(name, value, std, prior, None if prior is None else float(np.log2(prior / std)))
