"""Calibrate a whole cell: lenses, rig, clocks, base, target and arm from one recording of the moving arm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from armsight.arrays import Array
from armsight.calibrate.cell.checks import Cause, alarming, refusal
from armsight.calibrate.cell.fit import CellFit
from armsight.calibrate.cell.knowledge import ArmTolerance, CellPriors, shape_terms
from armsight.calibrate.cell.model import CLOCK_AT, CellModel
from armsight.calibrate.cell.observations import BLOCK_S, recording_of
from armsight.calibrate.cell.parts import CellParts, parts_of
from armsight.calibrate.cell.result import (
    NOTED_SCALE,
    UNLEARNED_BITS,
    CellResult,
    Learned,
    ScaleCheck,
    StrayingArm,
    TipDeviation,
    TipSlopes,
    tip_slopes,
)
from armsight.calibrate.cell.rounds import Solved, require_lit, solve_cell
from armsight.errors import Degenerate, Inconsistent, NotEnoughData
from armsight.fitting.groups import without
from armsight.geometry import align_points
from armsight.kinematics import Arm
from armsight.optics import SIDES
from armsight.records import Motion, Progress, Silent, SpotTrack, Target

SAMPLES = 60
"""Joint positions of the recording at which the tip's deviation is told."""
FOLD_S = 10.0
"""Stretches that are left out by turns."""
ODD_SCALE = 4.0
"""Standard deviations by which arm and target may differ in scale."""
LEAST_BASELINE = 0.02
"""Of the distance to the arm: by less a pair measures depth fifty times worse than across."""
AT_ONCE_S = 0.1
"""Within which a camera saw a light, where it is said to see it."""
LEAST_MOVE = 0.1
"""rad, or of the mean link: a joint that moves less tells nothing of its axis."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CellOptions:
    """What may be said of a cell beforehand.

    tip_m (3,): of the tool in target axes, for telling how well it is known; the target's origin where not given.
    compliance: whether joints may give way under the arm's weight; None where the recording shows it. priors: of
    earlier calibrations.
    """

    tip_m: Array | None = None
    tolerance: ArmTolerance = field(default_factory=ArmTolerance)
    priors: CellPriors | None = None
    compliance: bool | None = None


def calibrate_cell(
    arm: Arm,
    joints: Motion,
    tracks: Sequence[SpotTrack],
    target: Target,
    *,
    sizes: Sequence[tuple[int, int]],
    names: Sequence[str] = SIDES,
    options: CellOptions | None = None,
    progress: Progress | None = None,
) -> CellResult:
    """Return the cell's calibration from the arm's log and the spots of one to eight cameras by their own clocks.

    arm: its nominal model. tracks: spots without names, of the cameras of these names; the first one's axes and stamps
    are the rig's. sizes: of the images (w, h) px. Cameras other than left and right alone need not see the lights all
    the time, nor together: what each saw is tied by the arm. Raises NotEnoughData, Inconsistent (another arm, log or
    target, something changed on the way), Ambiguous, Degenerate (a joint that did not move), NotConverged.
    """
    options = options or CellOptions()
    compliance = options.compliance
    tip = np.zeros(3) if options.tip_m is None else np.asarray(options.tip_m, float)
    recording = recording_of(arm, joints, tracks, sizes, names)
    _require_motion(arm, joints)
    solved = solve_cell(
        recording,
        target,
        options.tolerance,
        priors=options.priors,
        compliance=compliance,
        progress=progress or Silent(),
    )
    first = solved.doubts[0]
    if alarming(first) and not (first.cause is Cause.ELASTIC and compliance is False):
        raise refusal(solved.doubts)
    _require_lit(solved, tracks)
    return _result(arm, solved, target, tip, sum(map(len, tracks)), stiff=compliance is False)


def _result(nominal: Arm, solved: Solved, target: Target, tip: Array, n_frames: int, *, stiff: bool) -> CellResult:
    model, found = solved.model, solved.fit
    arm = model.recording.arm
    covariance = _with_stamps(solved, found.covariance(model, stiff=stiff))
    parts = parts_of(model, found, covariance, target)
    scale = _scale(solved, target)
    _require_baseline(solved, parts)
    q, slopes, places = _tips(solved, parts, tip)
    measured, commanded = slopes.spread_m(slopes.measured, covariance), slopes.spread_m(slopes.commanded, covariance)
    if found.wander is not None:  # what the joints say is off by as much as the arm strays from them
        commanded = commanded + slopes.strayed_m(found.wander.columns, found.wander.std)
    residual, learned = _rms(model, found), _learned(solved, covariance)
    return CellResult(
        nominal=nominal,
        parts=parts,
        solved=solved,
        covariance=covariance,
        doubts=solved.doubts,
        samples=q,
        tip_places_m=places,
        tip_measured=measured,
        tip_commanded=commanded,
        n_frames=n_frames,
        n_spots=len(found.spots),
        n_left_out=len(model.recording.spots) - len(found.spots),
        duration_s=BLOCK_S * len(found.normals.chi2),
        residual_px=residual,
        left_out_px=_left_out(solved, residual),
        delay_s=_by_name(model, [float(found.x[model.camera_slice(side)][CLOCK_AT]) for side in model.sides]),
        learned=learned,
        gauges=_gauges(arm, scale),
        fixed=tuple(name for name in model.arm.geometry if name not in found.free),
        straying=_straying(found, arm),
        scale=scale,
        tip=TipDeviation(**_deviations(measured, commanded, slopes)),
        notes=_notes(solved, scale),
        advice=_advice(learned),
    )


def _require_baseline(solved: Solved, parts: CellParts) -> None:
    """Raise Inconsistent where all cameras are in one place: nothing is measured by one camera twice."""
    if len(parts.rig.cameras) == 1:
        return
    T = solved.model.flange(solved.fit.x, solved.model.recording.log.q[:: len(solved.model.recording.log.q) // 20])
    far = float(np.median(np.linalg.norm(T[:, :3, 3] - parts.T_base_rig.translation, axis=1)))
    at = np.array([one.T_rig_camera.translation for one in parts.rig.cameras])
    apart = float(np.linalg.norm(at[:, None] - at, axis=2).max())
    if apart < LEAST_BASELINE * far:
        raise Inconsistent(
            f"the {'two ' if len(at) == 2 else ''}cameras stand {1e3 * apart:.1f} mm apart, {1e3 * far:.0f} mm from "
            "the arm",
            consequence="They see alike, and depths are not told",
            cure="Give the frames as recorded by cameras of their own, which stand apart by a tenth of their distance "
            "and more",
        )


def _with_stamps(solved: Solved, covariance: Array) -> Array:
    """Return the covariance with what the stamps' jitter leaves open of each camera's own clock."""
    model = solved.model
    out = covariance.copy()
    for side, (clock, middle) in enumerate(zip(model.recording.clocks, model.recording.middle_s, strict=True)):
        at = model.camera_slice(side).start + CLOCK_AT
        out[at : at + 2, at : at + 2] += clock.clock_covariance(middle)
    return out


def _straying(found: CellFit, arm: Arm) -> StrayingArm:
    wander = found.wander
    if wander is None or not arm.revolute.any():
        return StrayingArm(std_rad=0.0, time_s=0.0)
    return StrayingArm(std_rad=float(np.median(wander.std[arm.revolute])), time_s=wander.time_s)


def _require_motion(arm: Arm, joints: Motion) -> None:
    """Raise Degenerate where a joint hardly moved: nothing is known of it then but its model."""
    moved = np.ptp(joints.q, axis=0) / np.where(arm.revolute, 1.0, arm.length_m)
    resting = [joint.name for joint, much in zip(arm.joints, moved, strict=True) if much < LEAST_MOVE]
    if resting:
        raise Degenerate(
            f"joint {', '.join(resting)} did not move",
            consequence="Its axis and zero cannot be told, and no cell is calibrated",
            cure="Record a motion in which every joint turns by 20 degrees and more",
        )


def _require_lit(solved: Solved, tracks: Sequence[SpotTrack]) -> None:
    spots, recording = solved.fit.spots, solved.model.recording
    if not recording.is_pair:
        delay = [solved.fit.x[solved.model.camera_slice(side)][CLOCK_AT] for side in solved.model.sides]
        ends = np.array([clock.t_s[[0, -1]] + by for clock, by in zip(recording.clocks, delay, strict=True)])
        watched = np.ptp(np.clip(ends, *recording.log.t_s[[0, -1]]))
        lit = len(solved.fit.normals.chi2) / max(watched / BLOCK_S, 1.0)
        require_lit(min(lit, 1.0), "all cameras together", "the half seconds")
        return
    for side, track in enumerate(tracks):
        lit = len(np.unique(spots.frame[spots.side == side])) / max(len(track), 1)
        require_lit(lit, f"the {recording.names[side]} camera", "its frames")


def _tips(solved: Solved, parts: CellParts, tip: Array) -> tuple[Array, TipSlopes, Array]:
    """Return joint positions (k, n) of the recording, how the tip hangs on the parameters there, and where it is."""
    model, found = solved.model, solved.fit
    t = model.times_s(found.x, found.spots)
    at = np.linspace(t.min(), t.max(), 4 * SAMPLES)
    q = model.recording.log.at(at)[0]
    own = [float(np.median(found.spread_px[found.spots.side == side])) for side in model.sides]
    looked = None if model.recording.is_pair else _looked(solved, t, at)
    slopes = tip_slopes(model, found.x, q, parts.T_flange_target, tip, own, looked)
    rows = np.flatnonzero(slopes.seen)
    if not len(rows) and not model.recording.is_pair:
        raise NotEnoughData(
            "the cameras never saw the lights four times at one moment, all together",
            consequence="Nothing could be measured with them, and no cell is calibrated",
            cure="Turn the arm so that lights are seen by more cameras, or take a target of four lights and more",
        )
    if not len(rows):
        raise NotEnoughData("both cameras never saw three lights together", consequence="No cell is calibrated")
    rows = rows[np.unique(np.linspace(0, len(rows) - 1, SAMPLES).astype(np.intp))]
    T = model.flange(found.x, q[rows])
    places = T[:, :3, :3] @ np.array(parts.T_flange_target.apply(tip)) + T[:, :3, 3]
    return q[rows], slopes.take(rows), places


def _deviations(measured: Array, commanded: Array, slopes: TipSlopes) -> dict[str, float]:
    def size(C: Array) -> Array:
        return np.asarray(np.sqrt(np.trace(C, axis1=1, axis2=2)))

    return {
        "measured_m": float(np.median(size(measured))),
        "measured_worst_m": float(size(measured).max()),
        "commanded_m": float(np.median(size(commanded))),
        "commanded_worst_m": float(size(commanded).max()),
        "noise_m": float(np.median(size(slopes.noise))),
    }


def _looked(solved: Solved, t: Array, at_s: Array) -> Array:
    """Return which lights each camera saw (k, V, n) about times at_s (k,) of the robot, t (m,) being the spots'."""
    model, spots = solved.model, solved.fit.spots
    out = np.zeros((len(at_s), len(model.sides), len(model.lights)), bool)
    for side, light in np.ndindex(out.shape[1:]):
        own = np.sort(t[(spots.side == side) & (spots.light == light)])
        if len(own):
            k = np.clip(np.searchsorted(own, at_s), 1, max(len(own) - 1, 1))
            out[:, side, light] = np.minimum(np.abs(own[k - 1] - at_s), np.abs(own[k % len(own)] - at_s)) < AT_ONCE_S
    return out


def _by_name(model: CellModel, values: Sequence[float]) -> dict[str, float]:
    return dict(zip(model.recording.names, values, strict=True))


def _rms(model: CellModel, found: CellFit) -> dict[str, float]:
    """Return the RMS residual of each camera's spots in px."""
    r = found.normals.residuals * found.spread_px[:, None]
    return _by_name(model, [float(np.sqrt(np.mean(r[found.spots.side == side] ** 2))) for side in model.sides])


def _left_out(solved: Solved, residual: dict[str, float]) -> dict[str, float]:
    """Return the RMS residuals in stretches that are left out of the fit by turns, to first order."""
    model, found = solved.model, solved.fit
    free = found.places
    H = found.information(model)[np.ix_(free, free)]
    normals, wander = found.normals, found.wander
    if wander is None:
        return residual
    fold = np.floor(np.arange(len(normals.chi2)) * BLOCK_S / FOLD_S).astype(np.intp)
    before = after = 0.0
    for number in range(int(fold[-1]) + 1):
        rows = np.flatnonzero(fold == number)
        part = normals.take(rows)
        own = wander.take(rows).reduced(part)
        step = without(H, own.A[np.ix_(free, free)], own.g[free])
        A, g = part.A.sum(axis=0)[np.ix_(free, free)], part.g.sum(axis=0)[free]
        before += float(part.chi2.sum())
        after += float(part.chi2.sum() + 2.0 * g @ step + step @ A @ step)
    factor = float(np.sqrt(max(after, 0.0) / before))
    return {name: factor * px for name, px in residual.items()}


def _learned(solved: Solved, covariance: Array) -> tuple[Learned, ...]:
    found, model = solved.fit, solved.model
    std, prior = np.sqrt(np.diag(covariance)), np.diag(found.known.information)
    out = []
    for k in found.places:
        before = float(prior[k] ** -0.5) if prior[k] > 0.0 else None
        bits = None if before is None else float(np.log2(before / std[k]))
        out.append(Learned(model.names[k], float(found.x[k]), float(std[k]), before, bits))
    return tuple(out)


def _scale(solved: Solved, target: Target) -> ScaleCheck:
    """Return the target's size by the arm's lengths over that of its file. Raises Inconsistent where they differ."""
    model, found = solved.model, solved.fit
    free = found.places
    shape, off = shape_terms(model, found.x, found.known.shape)
    at = model.lights_at
    S, pull = np.zeros((len(found.x),) * 2), np.zeros(len(found.x))
    S[at:, at:], pull[at:] = shape, shape @ off
    # the fit as it would be without the target's size: what its file says is taken out of information and gradient
    rest = found.information(model)[np.ix_(free, free)] - S[np.ix_(free, free)]
    C = np.linalg.inv(rest + 1e-12 * np.diag(np.diag(rest)))
    x = found.x.copy()
    x[free] += C @ pull[free]  # where the lights would be by the arm alone
    order = [model.lights.index(name) for name in target.names]
    lights, centred = model.lights_m(x)[order], target.xyz_m - target.xyz_m.mean(axis=0)
    turned = centred @ align_points(lights, target.xyz_m).T_a_b.rotation.as_matrix().T
    weight = turned / np.vdot(turned, turned)
    row = np.zeros(len(found.x))
    for k, name in enumerate(order):
        row[at + 3 * name : at + 3 * name + 3] = weight[k]
    ratio = float(np.vdot(weight, lights - lights.mean(axis=0)))
    by_arm = float(row[free] @ C @ row[free])
    w = (centred / np.vdot(centred, centred)).ravel()
    by_target = float(w @ found.known.shape.covariance @ w)
    std = float(np.sqrt(by_arm + by_target))
    if abs(ratio - 1.0) > ODD_SCALE * std:
        raise Inconsistent(
            f"by the arm's lengths the target is {ratio:.4f} times as large as its file says, +- {std:.4f}",
            consequence="One of the two is wrong, and no cell is calibrated",
            cure="Check that --model is this arm (a larger or smaller one of the same series?) and that the target's "
            "places are in metres and as built",
        )
    return ScaleCheck(set_by="arm" if by_arm < by_target else "target", ratio=ratio, std=std)


def _gauges(arm: Arm, scale: ScaleCheck) -> tuple[str, ...]:
    first, last = arm.joints[0].name, arm.joints[-1].name
    return (
        f"Base: its z axis is that of joint {first}, whose zero and height are as in the model.",
        f"Flange: as in the model behind joint {last}, whose zero is that of the model; the lights are placed in it.",
        f"Scale: from the lengths of the {scale.set_by}, which are known better than the other's.",
    )


def _notes(solved: Solved, scale: ScaleCheck) -> tuple[str, ...]:
    soft = [name for name in solved.fit.free if name.endswith(".sag")]
    out = [f"{name} never saw a light when another camera did: {ALONE}" for name in _alone(solved)]
    if soft:
        out.append(f"The joints give way under the arm's weight; taken in: {', '.join(soft)}")
    if abs(scale.ratio - 1.0) > NOTED_SCALE * scale.std:
        out.append(
            f"By the arm's lengths the target is {scale.ratio:.4f} times as large as its file says, "
            f"+- {scale.std:.4f}: measure the target, and compare the arm's file with its data sheet, before distances "
            "are trusted"
        )
    return tuple(out)


ALONE = (
    "it stands to the others by the arm's joints alone; record a motion that shows the target to it and to another one "
    "at once"
)


def _alone(solved: Solved) -> list[str]:
    """Return the cameras, of several, that saw lights only when no other one did."""
    model, found = solved.model, solved.fit
    t, side = model.times_s(found.x, found.spots), found.spots.side
    out = []
    for k, name in enumerate(model.recording.names):
        own, others = t[side == k], np.sort(t[side != k])
        if len(others):
            at = np.clip(np.searchsorted(others, own), 1, max(len(others) - 1, 1))
            near = np.minimum(np.abs(others[at - 1] - own), np.abs(others[at % len(others)] - own))
            if not (near < AT_ONCE_S).any():
                out.append(name)
    return out


def _advice(learned: Sequence[Learned]) -> tuple[str, ...]:
    weak = [one.name for one in learned if one.bits is not None and one.bits < UNLEARNED_BITS and ".theta" in one.name]
    out = []
    if weak:
        joints = sorted({name.partition(".")[0] for name in weak})
        out.append(
            f"the zero of joint {', '.join(joints)} is hardly told: move the joints behind and before it further, with "
            "the target in view"
        )
    return tuple(out)
