"""What a motion tells of a cell, and how well the tip is known by it over a volume.

A-optimal for the tip (I-optimal): what is made small is the mean variance of the tip over the volume, in base axes, as
the cameras measure it and as the arm says it, V = mean of L' L of both by the parameters, which is trace(V C) of their
covariance C. Both hang on the same parameters, and a calibration gives both; a motion that told one alone would leave
the arm's own joints, or the lenses, to their makers' word.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.calibrate.cell.fit import gauge
from armsight.calibrate.cell.knowledge import ArmTolerance, Knowledge, default_knowledge, shape_information
from armsight.calibrate.cell.model import CAMERA_POSE, PER_CAMERA, CellModel
from armsight.calibrate.cell.observations import CellRecording, JointLog, Spots
from armsight.calibrate.cell.result import tip_slopes
from armsight.calibrate.timing.stamps import SteadyStamps
from armsight.kinematics import Arm
from armsight.optics import INTRINSICS, SIDES
from armsight.records import Motion, Target
from armsight.units import DEG
from armsight_lab.cell_plan.scene import Scene

LOOKS_HZ = 4.0
"""Frames a second that are looked at in place of all; each counts for those between."""
MOST_SAMPLES = 60
"""Places of the volume over which the tip's variance is averaged."""
OPEN_M, OPEN_RAD, OPEN_FOCAL, OPEN_S = 0.05, 5.0 * DEG, 0.1, 0.3
"""Standard deviations of what a calibration begins with and asks nobody: places of cameras and lights, directions,
focal length's share, delays. They give the deviation before a motion; after it they weigh nothing."""
STRAYS_S = 1.0
"""For how long an arm strays alike."""
KINDS = ("lenses", "places of the cameras", "arm", "lights")
"""Of what the tip at rest hangs on; clocks are asked with them, and do nothing to it."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Known:
    """What is known before a motion: free (F,), places in the model of what is fitted; information (F, F) of these.

    goal (2, F, F): V of the tip as measured, and as the arm says, m^2 per square of each.
    """

    free: NDArray[np.intp]
    information: Array
    goal: Array

    def tip_m(self, information: Array) -> tuple[float, float]:
        """Return the RMS deviation of the tip over the volume, as the cameras measure it and as the arm says it."""
        C = inverse(information)
        measured, commanded = (float(np.sqrt(max(np.vdot(V, C), 0.0))) for V in self.goal)
        return measured, commanded

    def worth(self, information: Array) -> float:
        """Return what is to be made small: the mean variance of the tip in m^2, both ways of telling it together."""
        return float(np.vdot(self.goal.sum(axis=0), inverse(information)))


def inverse(A: Array) -> Array:
    """Return the inverse of a positive definite matrix whose rows are of many sizes."""
    size = 1.0 / np.sqrt(np.diag(A))
    return np.asarray(np.linalg.inv(A * np.outer(size, size)) * np.outer(size, size))


def blank_recording(arm: Arm, sizes: tuple[tuple[int, int], tuple[int, int]], rate_hz: float) -> CellRecording:
    """Return a recording of nothing yet: an arm that rests, cameras of such sizes and rate."""
    still = Motion(t_s=np.arange(5.0), q=np.tile(np.zeros(arm.n), (5, 1)))
    period = 1.0 / rate_hz
    clock = SteadyStamps(
        t_s=np.array([0.0, period]),
        number=np.arange(2),
        period_s=period,
        jitter_s=0.0,
        jitter_std_s=0.0,
        mid_s=0.0,
        covariance=np.zeros((2, 2)),
    )
    empty = Spots(
        side=np.empty(0, np.intp),
        light=np.empty(0, np.intp),
        frame=np.empty(0, np.intp),
        stamp_s=np.empty(0),
        line=np.empty(0),
        uv_px=np.empty((0, 2)),
        covariance_px2=np.empty((0, 2, 2)),
    )
    return CellRecording(arm=arm.based(), log=JointLog.of(still), spots=empty, clocks=(clock, clock), sizes=sizes)


def known_before(
    scene: Scene,
    target: Target,
    T_flange_target: RigidTransform,
    q: Array,
    tolerance: ArmTolerance,
    spot_px: float,
    learned: Array | None = None,
) -> Known:
    """Return what is known before a motion, of which the places q (k, n) may be part.

    learned (P, P): information of an earlier recording. What cannot be told from all of q but by another's name is
    held, as the calibration holds it.
    """
    model, x = scene.model, scene.x
    knowledge = default_knowledge(model, x, tolerance, target)
    J = model.standing(x, q)[1].reshape(-1, len(x)) / spot_px
    free = _free(model, x, J.T @ J, knowledge, tolerance)
    information = knowledge.information + shape_information(model, x, knowledge.shape) + np.diag(_open(model, x))
    if learned is not None:
        information = information + learned
    at = np.array([model.names.index(name) for name in free], dtype=np.intp)
    inside = q[scene.inside(q) & scene.seen(q)][:MOST_SAMPLES]
    tip = np.asarray(T_flange_target.inv().apply(scene.tip_m))
    slopes = tip_slopes(model, x, inside, T_flange_target, tip, (spot_px, spot_px))
    good = slopes.seen  # three lights or more in both images
    goal = [
        np.einsum("kia,kib->ab", part[good][:, :, at], part[good][:, :, at]) / good.sum()
        for part in (slopes.measured, slopes.commanded)
    ]
    return Known(free=at, information=information[np.ix_(at, at)], goal=np.array(goal))


def _free(model: CellModel, x: Array, spots: Array, knowledge: Knowledge, tolerance: ArmTolerance) -> tuple[str, ...]:
    """Return the names of what the calibration will fit."""
    information = spots + shape_information(model, x, knowledge.shape)
    arm = gauge(model, information, model.arm.geometry, tolerance)
    lens = [f"{side}.{name}" for side in SIDES for name in PER_CAMERA if name != "skew"]
    return (*lens, *arm, *model.names[model.lights_at :])


def _open(model: CellModel, x: Array) -> Array:
    """Return the information (P,) about what nobody knows well before."""
    sigma = np.full(len(x), np.inf)
    for side in (0, 1):
        first = side * len(PER_CAMERA)
        for k, name in enumerate(PER_CAMERA):
            if name in ("fx", "fy"):
                sigma[first + k] = OPEN_FOCAL * x[first + k]
            elif name in CAMERA_POSE:
                sigma[first + k] = OPEN_M if name.startswith("t") else OPEN_RAD
            elif name == "delay_s":
                sigma[first + k] = OPEN_S
    sigma[model.lights_at :] = OPEN_M
    return np.asarray(sigma**-2)


def rests(scene: Scene, known: Known, q: Array, spot_px: float) -> Array:
    """Return how what is seen at rest at q (k, n) depends on what is fitted, (k, rows, F), in its deviations."""
    _, J = scene.model.standing(scene.x, q)
    return np.asarray(J[..., known.free].reshape(len(q), -1, len(known.free)) / spot_px)


def noise_px(scene: Scene, spot_px: float, stray_m: float, frames_hz: float) -> float:
    """Return the deviation of a spot as if all were independent: the arm strays by stray_m alike for STRAYS_S."""
    far = [
        float(
            np.linalg.norm(scene.volume.mean(axis=1) - np.asarray(scene.model.T_base_camera(scene.x, side).translation))
        )
        for side in (0, 1)
    ]
    stray_px = np.mean([scene.model.camera(scene.x, side).intrinsics[0] * stray_m / far[side] for side in (0, 1)])
    alike = frames_hz * STRAYS_S * len(scene.model.lights)
    return float(np.hypot(spot_px, np.sqrt(alike) * stray_px))


def motion_information(scene: Scene, known: Known, motion: Motion, spot_px: float, rate_hz: float) -> Array:
    """Return the information (F, F) of all that both cameras see of a motion, frame by frame while it moves.

    spot_px: as noise_px has it, of the frames' own errors and of how the arm strays.
    """
    model = CellModel(recording=replace(scene.model.recording, log=JointLog.of(motion)), lights=scene.model.lights)
    spots = seen_spots(scene, model, motion, spot_px)
    if not len(spots):
        return np.zeros((len(known.free), len(known.free)))
    J = model.columns(scene.x, spots)[1][:, :, known.free].reshape(-1, len(known.free)) / spot_px
    return np.asarray(rate_hz / LOOKS_HZ * (J.T @ J))


def seen_spots(scene: Scene, model: CellModel, motion: Motion, spot_px: float) -> Spots:
    """Return the spots of some frames of a motion at which the lights are seen; x has the clocks' delays."""
    n, parts = len(model.lights), []
    for side, (_, height) in enumerate(model.recording.sizes):
        # free-running: the second camera exposes between the first one's frames
        t = np.arange(0.25 + 0.37 * side, motion.t_s[-1] * LOOKS_HZ - 0.25) / LOOKS_HZ
        t = t[scene.seen(model.recording.log.at(t)[0])]
        m = n * len(t)
        delay = scene.x[model.camera_slice(side)][len(INTRINSICS) + len(CAMERA_POSE)]
        spots = Spots(
            side=np.full(m, side),
            light=np.tile(np.arange(n), len(t)),
            frame=np.repeat(np.arange(len(t)), n),
            stamp_s=np.repeat(t, n) - delay,
            line=np.zeros(m),
            uv_px=np.zeros((m, 2)),
            covariance_px2=np.tile(np.eye(2) * spot_px**2, (m, 1, 1)),
        )
        if m:
            line = model.pixels(scene.x, spots)[:, 1] / (height - 1) - 0.5
            spots = replace(spots, line=np.nan_to_num(line))
        parts.append(spots)
    return Spots(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in Spots.__slots__})


def kind_of(model: CellModel, index: int) -> str:
    """Return of which of KINDS a parameter is, or clocks."""
    if index >= model.lights_at:
        return "lights"
    if index >= model.arm_at:
        return "arm"
    at = index % len(PER_CAMERA)
    return "lenses" if at < len(INTRINSICS) else "places of the cameras" if at < len(PER_CAMERA) - 3 else "clocks"


def by_kind(model: CellModel, known: Known, information: Array) -> dict[str, float]:
    """Return the tip's RMS deviation that each kind of parameter makes, m; they hang together, and do not add up."""
    C, V = inverse(information), known.goal.sum(axis=0)
    kinds = np.array([kind_of(model, i) for i in known.free.tolist()])
    out = {}
    for kind in KINDS:
        rows = np.flatnonzero(kinds == kind)
        out[kind] = float(np.sqrt(max(np.vdot(V[np.ix_(rows, rows)], C[np.ix_(rows, rows)]), 0.0)))
    return out
