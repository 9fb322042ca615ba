"""What is known of a cell before it is recorded: of webcams, the arm's model, the target, and from other files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.calibrate.cell.model import CLOCK_AT, PER_CAMERA, POSE_AT, CellModel
from armsight.defaults import ANGLE_RAD, CELL_LENGTH_M, SAG
from armsight.geometry import align_points
from armsight.geometry.poses import skew
from armsight.optics import PLACE, Rig
from armsight.records import NamedCovariance, Target

CENTRE = 0.05
"""Of the image's width: the principal point is about so far from the middle, where nothing else is known."""
LENS = {"k1": 0.5, "k2": 0.5, "k3": 0.5, "p1": 0.01, "p2": 0.01}
"""Standard deviations of a lens's coefficients, where nothing else is known."""
ASPECT = 0.02
"""Of fy over fx."""
DRIFT_PPM = 300.0
SHAPE_M = 5e-4
"""Places of a target's lights, where its file does not say how well they are known: what a drawing and a drill give."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmTolerance:
    """What a nominal arm is believed to: standard deviations of its lengths, joint zeros, directions of axes, and sag.

    Zeros are set by hand at mastering, axes are bored on machines: the two are learned apart. links: names of lengths
    that are not nominally zero, believed to link_m: they set the scale, of which the others tell nothing.
    """

    length_m: float = CELL_LENGTH_M
    zero_rad: float = ANGLE_RAD
    angle_rad: float = ANGLE_RAD
    sag: float = SAG
    link_m: float = 1e-3
    links: frozenset[str] = frozenset()

    def kind(self, name: str) -> str:
        """Return which of its fields a parameter goes by."""
        if name.endswith(".sag"):
            return "sag"
        if name in self.links:
            return "link_m"
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
        return cls(
            xyz_m=target.xyz_m, covariance=np.eye(n) * SHAPE_M**2 if given is None else given + np.eye(n) * 1e-12
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Knowledge:
    """What is known before: a vector x (P,) and the information (P, P) about steps from it; zero where nothing is.

    shape: of the target, which is known but for its place on the flange.
    """

    x: Array
    information: Array
    shape: TargetShape


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CellPriors:
    """What earlier calibrations say of this cell, each with its covariance; None for what is not known.

    rig: of some of the cameras or all, whose lenses and places to each other count by its covariance. base_pose:
    T_base_camera of the first camera, with the covariance of a pose (dt, dw) in base axes. An arm that was calibrated
    is the model itself, a measured target the target: their own covariances count.
    """

    rig: Rig | None = None
    base_pose: tuple[RigidTransform, NamedCovariance] | None = None


def default_knowledge(model: CellModel, x: Array, tolerance: ArmTolerance, target: Target) -> Knowledge:
    """Return what is known of any cell with webcams: weak deviations of lenses and clocks, the nominal arm, the target.

    x (P,): a cell to begin with.
    """
    sigma = np.full(len(x), np.inf)  # of places and lights on the flange nothing is known
    mean = x.copy()
    for side in model.sides:
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
    # a calibrated arm tells its own deviations, and how they hang together
    measured = model.recording.arm.covariance
    if measured is not None:
        names = [name for name in measured.names if name in model.names]
        _tell(information, [model.names.index(name) for name in names], measured.block(tuple(names)))
    for side in model.sides:
        a = side * len(PER_CAMERA)
        # square pixels: fy - fx is small
        w = 1.0 / (ASPECT * x[a]) ** 2
        information[a : a + 2, a : a + 2] += w * np.array([[1.0, -1.0], [-1.0, 1.0]])
        mean[a + 1] = mean[a] = x[a]
    return Knowledge(x=mean, information=information, shape=TargetShape.of(target))


def with_priors(model: CellModel, known: Knowledge, priors: CellPriors, x: Array) -> Knowledge:
    """Return what is known with what other files say; x (P,): a cell near the truth."""
    mean, information = known.x.copy(), known.information.copy()
    T_first = model.T_base_camera(x, 0)
    if priors.base_pose is not None:
        T_first, covariance = priors.base_pose
        _tell(information, list(range(POSE_AT, CLOCK_AT)), covariance.matrix)
    mean[POSE_AT:CLOCK_AT] = _vector(T_first)
    if priors.rig is not None:
        _tell_rig(model, mean, information, priors.rig, T_first, x)
    return replace(known, x=mean, information=information)


def _tell_rig(model: CellModel, mean: Array, information: Array, rig: Rig, T_first: RigidTransform, x: Array) -> None:
    """Put in what a rig says of its lenses, and of where its cameras stand to its first one, wherever that is."""
    known = NamedCovariance(names=(), matrix=np.empty((0, 0))) if rig.covariance is None else rig.covariance
    at: list[int] = []
    places: list[str] = []
    J = np.zeros((0, 6))
    T_base = T_first  # of the rig's first camera
    for k, one in enumerate(rig.cameras):
        side = model.recording.names.index(one.name)
        begin, place = model.camera_slice(side).start, tuple(f"{one.name}.{name}" for name in PLACE)
        own = [f"{one.name}.{name}" for name in one.camera.names]
        lens = tuple(name for name in known.names if name in own)
        if lens:
            mean[begin : begin + POSE_AT] = one.camera.intrinsics
            _tell(information, [begin + own.index(name) for name in lens], known.block(lens))
        if k == 0:
            T_base = T = T_first if side == 0 else model.T_base_camera(x, side)
        elif set(place) <= set(known.names):
            T = T_base * (rig.cameras[0].T_rig_camera.inv() * one.T_rig_camera)
            # the covariance of places is in the rig's axes
            slopes = np.kron(np.eye(2), rig.cameras[0].T_rig_camera.rotation.as_matrix()) @ pair_slopes(T_base, T)
            J = np.block([[J, np.zeros((len(J), 6))], [slopes[:, :6], np.zeros((6, len(J))), slopes[:, 6:]]])
            places += place
        else:
            continue
        mean[begin + POSE_AT : begin + CLOCK_AT] = _vector(T)
        at += range(begin + POSE_AT, begin + CLOCK_AT)
    if places:
        # where cameras stand to each other is a matter of all, so what is known of it is about all
        W = np.linalg.inv(known.block(tuple(places)))
        information[np.ix_(at, at)] += J.T @ W @ J


def pair_slopes(T_base_left: RigidTransform, T_base_right: RigidTransform) -> Array:
    """Return how T_left_right moves (6, 12), (dt, dw) in the left camera's axes, with both poses in base axes."""
    R = T_base_left.rotation.as_matrix().T
    J = np.zeros((6, 12))
    J[:3, 6:9], J[:3, :3] = R, -R
    J[:3, 3:6] = R @ skew(np.asarray(T_base_right.translation - T_base_left.translation))
    J[3:, 9:], J[3:, 3:6] = R, -R
    return J


def _vector(T: RigidTransform) -> Array:
    return np.concatenate([T.translation, T.rotation.as_rotvec()])


def _tell(information: Array, at: Sequence[int], covariance: Array) -> None:
    """Put in place of what is known of some parameters what a covariance says of them."""
    information[at] = 0.0
    information[:, at] = 0.0
    size = np.sqrt(np.diag(covariance))
    scaled = covariance / np.outer(size, size) + 1e-9 * np.eye(len(size))
    information[np.ix_(at, at)] = np.linalg.inv(scaled) / np.outer(size, size)


def shape_information(model: CellModel, x: Array, shape: TargetShape) -> Array:
    """Return the information (P, P) that the target's shape is about the lights, wherever it is on the flange."""
    out = np.zeros((len(x), len(x)))
    out[model.lights_at :, model.lights_at :] = shape_terms(model, x, shape)[0]
    return out


def shape_terms(model: CellModel, x: Array, shape: TargetShape) -> tuple[Array, Array]:
    """Return information (3 n, 3 n) about the lights, and how far (3 n,) they are from the shape laid onto them."""
    lights = model.lights_m(x)
    T = align_points(lights, shape.xyz_m).T_a_b
    turned = np.kron(np.eye(len(lights)), T.rotation.as_matrix())
    W = np.linalg.inv(turned @ shape.covariance @ turned.T)
    # a rigid motion of all lights costs nothing: what it does is taken out of the information
    moves = rigid_moves(lights, lights.mean(axis=0))
    inner = moves.T @ W @ moves
    return W - W @ moves @ np.linalg.solve(inner, moves.T @ W), (lights - T.apply(shape.xyz_m)).ravel()


def rigid_moves(lights: Array, about: Array) -> Array:
    """Return (3 n, 6): what a rigid motion (dt, dw) about a point (3,) does to lights (n, 3)."""
    return np.concatenate([np.tile(np.eye(3), (len(lights), 1)), -skew(lights - about).reshape(-1, 3)], axis=1)
