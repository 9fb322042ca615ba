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
from armsight.optics import INTRINSICS, MountedCamera, Rig
from armsight.records import CameraTiming, NamedCovariance, Target
from armsight.records.camera import PPM


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CellParts:
    """A calibrated cell. rig: its axes are the first camera's, its time the first camera's stamps.

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
    place = slice(POSE_AT, CLOCK_AT)
    return CellParts(
        rig=_rig(model, found, covariance),
        T_base_rig=model.T_base_camera(x, 0),
        base_covariance=NamedCovariance(names=POSE6, matrix=covariance[place, place]),
        target=_target(model, x, covariance, target, T_flange_target),
        T_flange_target=T_flange_target,
        arm=_arm(model, found, covariance, T_flange_target),
    )


def _rig(model: CellModel, found: CellFit, covariance: Array) -> Rig:
    x, names, L = found.x, model.recording.names, len(INTRINSICS)
    T = [model.T_base_camera(x, side) for side in model.sides]
    at = [model.camera_slice(side).start for side in model.sides]
    rig = Rig(
        cameras=[
            MountedCamera(
                name=name,
                camera=model.camera(x, side),
                T_rig_camera=T[0].inv() * T[side] if side else RigidTransform.identity(),
                timing=timing,
            )
            for side, (name, timing) in enumerate(zip(names, _timing(model, x, covariance), strict=True))
        ],
        rms_px=float(np.sqrt(np.mean((found.normals.residuals * found.spread_px[:, None]) ** 2))),
    )
    J = np.zeros((len(rig.parameters), len(x)))
    for side in model.sides:
        J[L * side : L * (side + 1), at[side] : at[side] + POSE_AT] = np.eye(L)
    for side in model.sides[1:]:
        row = L * len(names) + 6 * (side - 1)
        places = np.r_[at[0] + POSE_AT : at[0] + CLOCK_AT, at[side] + POSE_AT : at[side] + CLOCK_AT]
        J[row : row + 6, places] = pair_slopes(T[0], T[side])
    C = J @ covariance @ J.T
    free = np.flatnonzero(np.diag(C) > 0.0)
    named = NamedCovariance(names=tuple(rig.parameters[k] for k in free), matrix=C[np.ix_(free, free)])
    return replace(rig, covariance=named)


def _timing(model: CellModel, x: Array, covariance: Array) -> tuple[CameraTiming, ...]:
    """Return the timing of all cameras by the first one's stamps.

    Its stamp l and another one's r are of one moment of the robot's clock where l + d_l + p_l (l - m_l) is r + d_r +
    p_r (r - m_r): l = r (1 + p_r) / (1 + p_l) + (d_r - d_l - p_r m_r + p_l m_l) / (1 + p_l).
    """
    clocks, V = model.recording.clocks, len(model.sides)
    at = [model.camera_slice(side).start + CLOCK_AT for side in model.sides]
    (dl, ppm_l, _), ml = x[at[0] : at[0] + 3], model.recording.middle_s[0]
    pl = PPM * ppm_l
    by_first = [(0.0, 0.0)]
    J = np.zeros((2 * (V - 1) + V, len(x)))  # delay_s, drift_ppm of all but the first, and the read-outs
    for side in model.sides[1:]:
        (dr, ppm_r, _), mr = x[at[side] : at[side] + 3], model.recording.middle_s[side]
        pr, row = PPM * ppm_r, 2 * (side - 1)
        delay, drift = (dr - dl - pr * mr + pl * ml) / (1.0 + pl), (pr - pl) / (1.0 + pl)
        J[row, at[0] : at[0] + 2], J[row, at[side] : at[side] + 2] = (-1.0, PPM * (ml - delay)), (1.0, -PPM * mr)
        J[row + 1, at[0] + 1], J[row + 1, at[side] + 1] = -1.0, 1.0
        by_first.append((float(delay), float(drift / PPM)))
    J[2 * (V - 1) + np.arange(V), np.array(at) + 2] = 1.0
    C = J @ covariance @ J.T
    out = []
    for side, (clock, (delay_s, drift_ppm)) in enumerate(zip(clocks, by_first, strict=True)):
        names = (*(("delay_s", "drift_ppm") if side else ()), "readout_s", "jitter_s")
        keep = [*((2 * side - 2, 2 * side - 1) if side else ()), 2 * (V - 1) + side]
        matrix = np.zeros((len(names), len(names)))
        matrix[:-1, :-1], matrix[-1, -1] = C[np.ix_(keep, keep)], clock.jitter_std_s**2
        out.append(
            CameraTiming(
                readout_s=float(x[at[side] + 2]),
                jitter_s=clock.jitter_s,
                delay_s=delay_s,
                drift_ppm=drift_ppm,
                covariance=NamedCovariance(names=names, matrix=matrix),
            )
        )
    return tuple(out)


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
