"""The calibration of a cell from its one recording, with what it claims beside the truth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from armsight.calibrate.cell import ArmTolerance, CellOptions, CellPriors, calibrate_cell
from armsight.calibrate.cell.result import tip_slopes
from armsight.calibrate.cell.rounds import Solved
from armsight.kinematics import fk
from armsight.optics import Rig
from armsight.records import Motion
from cell_records import Calibrated, arm_of, nominal_axes, target_of, track_of

Array = NDArray[np.float64]
DRAWS = 200
MAKERS_M = 3e-4
"""To how much the arms' lengths are built, as their makers say and the command is told (--tolerance-mm 0.3)."""
LENS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
POSE = ("tx", "ty", "tz", "rx", "ry", "rz")


@dataclass(frozen=True, kw_only=True)
class Ours:
    """What our calibration says: with what to measure; covariance (k, 3, 3) of the tip at the samples; each parameter's
    error and claimed deviation by its kind; whether it raised an alarm, and its words.

    bounds: the parameters again, with the deviation that no estimator beats whose joints are known to be stiff.
    efficient_m (DRAWS,): RMS errors of the tip that an estimator at this bound makes in this cell.
    """

    measured_with: Calibrated
    covariance: Array
    parameters: dict[str, list[tuple[float, float]]]
    bounds: dict[str, list[tuple[float, float]]]
    efficient_m: Array
    alarm: bool
    words: str


def true_parameters(world: Any, middle_s: tuple[float, float]) -> dict[str, float]:
    """Return what is true of lenses, clocks and lights by name; delays at these stamps of the two cameras."""
    out: dict[str, float] = {}
    for name, camera, at_s in zip(("left", "right"), (world.truth.left, world.truth.right), middle_s, strict=True):
        out |= {f"{name}.{key}": float(value) for key, value in zip(LENS, camera.intrinsics, strict=True)}
        out[f"{name}.delay_s"] = camera.delay_s + 1e-6 * camera.drift_ppm * at_s
        out |= {f"{name}.drift_ppm": camera.drift_ppm, f"{name}.readout_s": camera.readout_s}
    for light, xyz in zip(world.target, world.truth.lights.tolist(), strict=True):
        out |= {f"light:{light}.{axis}_m": value for axis, value in zip("xyz", xyz, strict=True)}
    nominal = made_tables(world)
    for i, (own, table) in enumerate(zip(world.truth.arm.rows.tolist(), nominal.tolist(), strict=True), 1):
        out[f"j{i}.theta_rad"] = own[0] - table[0]
    return out


def made_tables(world: Any) -> Array:
    """Return the nominal table (6, 5) of the arm that was recorded."""
    keys = ("theta_rad", "d_m", "a_m", "alpha_rad")
    return np.array([[*(joint[key] for key in keys), 0.0] for joint in world.nominal["joints"]])


def camera_off(world: Any, side: str, T_base_camera: Array) -> Array:
    """Return the error (6,) of a camera's place (4, 4): m, and a rotation vector in base axes."""
    true = getattr(world.truth, side).T_base_camera
    turn = Rotation.from_matrix(T_base_camera[:3, :3]) * Rotation.from_matrix(true[:3, :3]).inv()
    return np.concatenate([T_base_camera[:3, 3] - true[:3, 3], turn.as_rotvec()])


def parameters(world: Any, solved: Solved, covariance: Array) -> dict[str, list[tuple[float, float]]]:
    """Return errors and claimed deviations by kind of parameter; of what cannot be told apart, nothing.

    The delay of a camera whose stamps only come late is known but for how late they are in the mean, and left out.
    """
    model, x = solved.model, solved.fit.x
    std = dict(zip(model.names, np.sqrt(np.diag(covariance)), strict=True))
    value = dict(zip(model.names, x, strict=True))
    out: dict[str, list[tuple[float, float]]] = {}
    for name, true in true_parameters(world, model.recording.middle_s).items():
        kind = name.rpartition(".")[2]
        late = kind == "delay_s" and getattr(world.truth, name.partition(".")[0]).late
        if std[name] > 0.0 and not late:
            out.setdefault("light_m" if name.startswith("light") else kind, []).append((value[name] - true, std[name]))
    for side, name in enumerate(("left", "right")):
        off = camera_off(world, name, model.T_base_camera(x, side).as_matrix())
        for key, error in zip(POSE, off, strict=True):
            out.setdefault("camera_" + ("m" if key[0] == "t" else "rad"), []).append((error, std[f"{name}.{key}"]))
    return out


def efficient(slopes: Array, covariance: Array) -> Array:
    """Return RMS errors (DRAWS,) of the tip whose slopes (k, 3, P) are given, parameters being off by a covariance."""
    values, axes = np.linalg.eigh(covariance)
    rng = np.random.default_rng(0)
    steps = (axes * np.sqrt(np.maximum(values, 0.0))) @ rng.normal(size=(len(values), DRAWS))
    return np.asarray(np.sqrt(((slopes @ steps) ** 2).sum(axis=1).mean(axis=0)))


def ours(world: Any, board: Rig | None = None) -> Ours:
    """Calibrate the cell from its one recording, and from a board's calibration of its rig. Raises DataRefused."""
    done = calibrate_cell(
        arm_of(world),
        Motion(t_s=world.log_t_s, q=world.log_q),
        [track_of(track) for track in (world.left, world.right)],
        target_of(world),
        sizes=[track.size for track in (world.left, world.right)],
        options=CellOptions(
            priors=None if board is None else CellPriors(rig=board), tolerance=ArmTolerance(length_m=MAKERS_M)
        ),
    )
    parts, model, truth = done.parts, done.solved.model, world.truth
    arm = parts.arm.based()
    sigma = (truth.left.noise_px, truth.right.noise_px)
    slopes = tip_slopes(model, done.solved.fit.x, truth.samples, parts.T_flange_target, truth.tip_target_m, sigma)
    # the Cramer-Rao bound, with what the stamps' jitter adds: what arms may do beyond the model is no part of it
    fit, free = done.solved.fit, done.solved.fit.places
    H = fit.information(model)[np.ix_(free, free)]
    size = 1.0 / np.sqrt(np.diag(H))
    bound = done.covariance - fit.covariance(model, stiff=False)
    bound[np.ix_(free, free)] += np.linalg.inv(H * np.outer(size, size)) * np.outer(size, size)
    return Ours(
        measured_with=Calibrated(
            rig=parts.rig,
            target=parts.target,
            T_base_rig=parts.T_base_rig,
            T_nominal=nominal_axes(parts.target, world),
            commanded=lambda q: fk(arm, arm.values(q)),  # its joints may give way
        ),
        covariance=slopes.spread_m(slopes.measured, done.covariance),
        parameters=parameters(world, done.solved, done.covariance),
        bounds=parameters(world, done.solved, bound),
        efficient_m=efficient(slopes.measured[slopes.seen], bound),
        alarm=not done.verdict.startswith("good"),
        words="; ".join([done.verdict, *done.notes, *done.advice]),
    )
