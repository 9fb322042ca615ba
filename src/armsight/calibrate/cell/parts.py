"""From the parameters of a cell to what files hold: rig with timing, its place, target and arm, with covariance."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.calibrate.cell.fit import CellFit
from armsight.calibrate.cell.knowledge import pair_slopes, rigid_moves
from armsight.calibrate.cell.model import CLOCK_AT, POSE_AT, CellModel
from armsight.columns import POSE6, POSITION
from armsight.geometry import align_points
from armsight.kinematics import Arm, ToolPoint
from armsight.optics import Rig, RigKind
from armsight.records import CameraTiming, NamedCovariance, Target
from armsight.records.camera import PPM


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CellParts:
    """A calibrated cell. rig: its axes are the left camera's, its time the left camera's stamps.

    T_base_rig with base_covariance (6, 6) named POSE6; T_flange_target; target: with its lights as measured; arm: with
    the target as its tool, and the lights as tool points.
    """

    rig: Rig
    T_base_rig: RigidTransform
    base_covariance: NamedCovariance
    target: Target
    T_flange_target: RigidTransform
    arm: Arm


def parts_of(model: CellModel, found: CellFit, covariance: Array, target: Target) -> CellParts:
    """Return the cell of a fit with the covariance (P, P) of its parameters."""
    x = found.x
    lights = model.lights_m(x)
    # the target's axes are those of its file, laid onto the lights that were found
    order = [model.lights.index(name) for name in target.names]
    T_flange_target = align_points(lights[order], target.xyz_m).T_a_b
    left = model.camera_slice(0).start + POSE_AT
    place = slice(left, left + 6)
    return CellParts(
        rig=_rig(model, found, covariance),
        T_base_rig=model.T_base_camera(x, 0),
        base_covariance=NamedCovariance(names=POSE6, matrix=covariance[place, place]),
        target=_target(model, x, covariance, target, T_flange_target),
        T_flange_target=T_flange_target,
        arm=_arm(model, found, covariance, T_flange_target),
    )


def _rig(model: CellModel, found: CellFit, covariance: Array) -> Rig:
    x = found.x
    T_left, T_right = model.T_base_camera(x, 0), model.T_base_camera(x, 1)
    a, b = (model.camera_slice(side).start for side in (0, 1))
    J = np.zeros((26, len(x)))
    J[:10, a : a + POSE_AT] = J[10:20, b : b + POSE_AT] = np.eye(10)
    J[20:, np.r_[a + POSE_AT : a + CLOCK_AT, b + POSE_AT : b + CLOCK_AT]] = pair_slopes(T_left, T_right)
    rig = Rig(
        kind=RigKind.STEREO,
        left=model.camera(x, 0),
        right=model.camera(x, 1),
        T_rig_left=RigidTransform.identity(),
        T_rig_right=T_left.inv() * T_right,
        rms_px=float(np.sqrt(np.mean((found.normals.residuals * found.spread_px[:, None]) ** 2))),
        timing=_timing(model, x, covariance),
    )
    C = J @ covariance @ J.T
    free = np.flatnonzero(np.diag(C) > 0.0)
    named = NamedCovariance(names=tuple(rig.parameters[k] for k in free), matrix=C[np.ix_(free, free)])
    return replace(rig, covariance=named)


def _timing(model: CellModel, x: Array, covariance: Array) -> tuple[CameraTiming, CameraTiming]:
    """Return the timing of both cameras by the left one's stamps.

    Left stamp l and right stamp r are of one moment of the robot's clock where l + d_l + p_l (l - m_l) is r + d_r + p_r
    (r - m_r): l = r (1 + p_r) / (1 + p_l) + (d_r - d_l - p_r m_r + p_l m_l) / (1 + p_l).
    """
    left, right = model.recording.clocks
    (dl, ppm_l, _), (dr, ppm_r, _) = (x[model.camera_slice(side)][CLOCK_AT:] for side in (0, 1))
    ml, mr = model.recording.middle_s
    pl, pr = PPM * ppm_l, PPM * ppm_r
    delay, drift = (dr - dl - pr * mr + pl * ml) / (1.0 + pl), (pr - pl) / (1.0 + pl)
    at = [model.camera_slice(side).start + CLOCK_AT for side in (0, 1)]
    J = np.zeros((4, len(x)))  # delay_s, drift_ppm, left and right read-out
    J[0, at[0] : at[0] + 2], J[0, at[1] : at[1] + 2] = (-1.0, PPM * (ml - delay)), (1.0, -PPM * mr)
    J[1, at[0] + 1], J[1, at[1] + 1] = -1.0, 1.0
    J[2, at[0] + 2] = J[3, at[1] + 2] = 1.0
    C = J @ covariance @ J.T
    sides = []
    for side, clock in enumerate((left, right)):
        names = ("delay_s", "drift_ppm", "readout_s", "jitter_s") if side else ("readout_s", "jitter_s")
        keep = [0, 1, 3] if side else [2]
        matrix = np.zeros((len(names), len(names)))
        matrix[:-1, :-1], matrix[-1, -1] = C[np.ix_(keep, keep)], clock.jitter_std_s**2
        sides.append(
            CameraTiming(
                readout_s=float(x[at[side] + 2]),
                jitter_s=clock.jitter_s,
                delay_s=float(delay) if side else 0.0,
                drift_ppm=float(drift / PPM) if side else 0.0,
                covariance=NamedCovariance(names=names, matrix=matrix),
            )
        )
    return sides[0], sides[1]


def _target(model: CellModel, x: Array, covariance: Array, target: Target, T_flange_target: RigidTransform) -> Target:
    """Return the target with its lights where they were found; how it sits on the flange is no part of its shape."""
    order = [model.lights.index(name) for name in target.names]
    at = np.concatenate([model.lights_at + 3 * k + np.arange(3) for k in order])
    back = np.kron(np.eye(len(order)), T_flange_target.rotation.as_matrix().T)
    xyz = T_flange_target.inv().apply(model.lights_m(x)[order])
    moves = rigid_moves(xyz, xyz.mean(axis=0))
    shape = np.eye(len(moves)) - moves @ np.linalg.pinv(moves)
    J = shape @ back
    return replace(target, xyz_m=xyz, covariance=J @ covariance[np.ix_(at, at)] @ J.T, model_known=True)


def _arm(model: CellModel, found: CellFit, covariance: Array, T_flange_target: RigidTransform) -> Arm:
    p = model.arm_vector(found.x)
    fitted = model.arm.arm_at(p, None)
    free = [k for k in found.places if model.arm_at <= k < model.lights_at]
    # an arm's file has places for its links' covariance, none for that of its joints' giving way
    links = [k for k in free if not model.names[k].endswith(".sag")]
    std = np.sqrt(np.diag(covariance))
    points = tuple(
        ToolPoint(
            name=name,
            xyz_m=model.lights_m(found.x)[k],
            std_m=np.array([std[model.names.index(f"light:{name}.{key}")] for key in POSITION]),
        )
        for k, name in enumerate(model.lights)
    )
    return replace(
        fitted,
        name=model.recording.arm.name,
        T_flange_tool=T_flange_target,
        tool_points=points,
        source=f"calibrated in its cell; before: {model.recording.arm.source}"
        if model.recording.arm.source
        else "calibrated in its cell",
        covariance=NamedCovariance(names=tuple(model.names[k] for k in links), matrix=covariance[np.ix_(links, links)])
        if links
        else None,
    )
