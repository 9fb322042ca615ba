"""Sweeps in, an arm out: types, axes, table with standard deviations (Kapucu and Baysec 2005; MATH 4.3, 4.5)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from armsight.arrays import Array
from armsight.calibrate.identify import chain
from armsight.calibrate.identify.chain import Axis
from armsight.calibrate.identify.global_fit import (
    GlobalFit,
    all_covariance,
    beacon_at_zero,
    check_slopes,
    fit_globally,
    possible_axes,
)
from armsight.calibrate.identify.joint_paths import JointPath, find_paths, measured, pair_line, triple_circle
from armsight.calibrate.identify.path_fit import PathFit, basis, tilted
from armsight.calibrate.identify.result import Identification, JointFound, ParameterUncertainty
from armsight.calibrate.identify.sweeps import (
    SweepResiduals,
    Sweeps,
    check_sweeps,
    leaning,
    of_rig,
    one_home,
    placed,
    position_residuals,
)
from armsight.errors import Inconsistent, UsageError
from armsight.kinematics import Arm
from armsight.optics import PackedRig, Rig
from armsight.records.checks import check_spread

METHODS = ("ml", "paper")
INCREMENTS = ("known", "order")
AT_ODDS = 9.0
"""Variance of the whole arm's misfit over that of single paths from which it is worth a note."""
ANOTHER = 5.0
"""Standard deviations by which an entry of another solution must differ for it to be another arm."""
FAR_M = 10.0
"""A beacon on an arm hardly moves further; one on a gantry does, and is told, not refused."""
MEETING_STEPS = 20
"""Steps to where all paths meet; each squares the miss where their tangents differ."""
FIRST_PX = 0.2
"""Noise of a beacon's centre assumed before it is found from the residuals."""


def identify(
    sweeps: Sweeps,
    *,
    rig: Rig | None = None,
    sigma: float | None = None,
    method: str = "ml",
    increments: str = "known",
    base: Array | None = None,
    name: str = "identified",
) -> Identification:
    """Return the arm whose beacon made these paths.

    rig: the fit is of pixels; without one, of positions. sigma: noise of a pixel coordinate (px) or of a position (m),
    if known; else it is found. increments: 'known', the commanded values are exact, and the whole arm is fitted at
    once; 'order', only their order is used, joint by joint. base (4, 4): the frame in rig axes whose foot on axis 1 is
    the first frame's origin. method 'paper': triples, Chauvenet, means. Raises NotEnoughData, Inconsistent, UsageError.
    """
    if method not in METHODS or increments not in INCREMENTS:
        known = f"method is one of {', '.join(METHODS)}, increments one of {', '.join(INCREMENTS)}"
        raise UsageError(known, consequence="Nothing is identified")
    if method == "paper" and increments == "order":
        raise UsageError("the paper's method takes the increments as known", cure="Use method ml with increments order")
    sweeps = sweeps if rig is None else of_rig(sweeps, rig)
    check_sweeps(given := sweeps)
    if rig is not None:
        sweeps = placed(sweeps, rig, sigma or FIRST_PX)
        seen = SweepResiduals(sweeps=sweeps, rig=PackedRig.of(rig), sigma=sigma or FIRST_PX, unit=sigma or FIRST_PX)
    else:
        seen = position_residuals(sweeps, sigma or 1.0)
    check_spread(sweeps.xyz_m, "the beacon's positions")
    found, seen = find_paths(seen, sigma)
    notes = _far(sweeps)
    frame = np.eye(4) if base is None else np.asarray(base, float)
    if method == "paper":
        done = _from_paper(seen, found, frame, notes, name)
    elif increments == "order":
        done = _joint_by_joint(seen, found, frame, notes, name)
    else:
        done = _at_once(seen, found, frame, notes, name, sigma, rig)
    return replace(done, sweeps=given, rig=rig, lean=None if rig is None else leaning(rig, sweeps))


def _far(sweeps: Sweeps) -> list[str]:
    """Return a note where the beacon moved further than arms reach."""
    reach = float(np.linalg.norm(np.ptp(sweeps.xyz_m, axis=0)))
    return [f"the beacon moved over {reach:.0f} m: give metres, if these are not"] if reach > FAR_M else []


def _notes(found: Sequence[JointPath], turns: Sequence[bool]) -> list[str]:
    """Return what is doubtful about the paths of joints that were taken as turning or sliding."""
    notes = []
    for j, (item, turning) in enumerate(zip(found, turns, strict=True), 1):
        if not item.decided:
            notes.append(
                f"joint {j}: its path is straight as far as the noise tells, but an arc would look the same; taken as "
                f"{'turning' if turning else 'sliding'}, move it further to be sure"
            )
        if item.path.kind == "circle":
            std = item.path.covariance.std()["radius_m"] if item.path.covariance is not None else np.inf
            arc = float(np.ptp(item.path.phase))
            if std > 0.3 * item.path.radius_m:
                notes.append(
                    f"joint {j}: an arc of {np.rad2deg(arc):.0f} deg is too short for this noise: its centre is open"
                )
        notes += [f"reading {row + 1} (joint {j}) discarded: {why}" for row, why in item.discarded]
    return notes


def _at_once(
    seen: SweepResiduals,
    found: list[JointPath],
    base: Array,
    notes: list[str],
    name: str,
    sigma: float | None,
    rig: Rig | None,
) -> Identification:
    """Place the frames on the axes of the whole arm's fit."""
    arm_fit = fit_globally(seen, found)
    widen, misfit = _widening(seen, arm_fit, sigma)
    notes += misfit + chain.suggest_coupling(seen.take(arm_fit.rows), arm_fit.model, arm_fit.fit.shared, rig)
    notes += [f"reading {row + 1} discarded: {why}" for row, why in arm_fit.dropped]
    p, model = arm_fit.fit.shared, arm_fit.model
    notes += _notes(found, [axis.revolute for axis in model.axes])
    covariance = all_covariance(arm_fit.fit.names, arm_fit.fit.covariance, widen) + arm_fit.systematic(seen, rig)
    axes, beacon = model.axes_at(p)
    table, first, tool = chain.assign_frames(axes, beacon, base)

    def entries(x: Array) -> Array:
        return chain.assign_frames(*model.axes_at(x), base)[0].ravel()

    covariance = chain.propagate_covariance(entries, p, covariance)
    covariance, notes[len(notes) :] = _with_rivals(arm_fit.rivals(widen), table, covariance, base)
    placed_frames = _PlacedFrames(
        axes=axes,
        beacon=beacon,
        table=table,
        first=first,
        tool=tool,
        covariance=covariance,
        predicted=model.predict(p, seen.sweeps.q)[0],
        dropped=arm_fit.dropped,
    )
    seen = seen.at(seen.sigma * float(np.sqrt(widen)))
    result = _finish(seen, found, placed_frames, notes, name)
    kept = seen.take(arm_fit.rows)
    _, slopes = kept.residuals(*model.predict(p, kept.sweeps.q))
    A = slopes.reshape(-1, len(p))
    return replace(result, uncertainty=ParameterUncertainty(model=model, p=p, information=A.T @ A))


def _widening(seen: SweepResiduals, arm_fit: GlobalFit, sigma: float | None) -> tuple[float, list[str]]:
    """Return by how much the variances are larger than the noise about single paths says, and a note where by much."""
    notes = []
    if arm_fit.scale2 > AT_ODDS:
        notes.append(
            f"the readings miss the arm by {np.sqrt(arm_fit.scale2):.1f} times their noise about single paths: the "
            "commanded values are not exact, or a joint gave way; standard deviations are widened accordingly, which "
            "may not be enough: with values that are not exact use only their order (--increments order)"
        )
    return arm_fit.scale2 if sigma is None else max(arm_fit.scale2, 1.0), notes


def _with_rivals(rivals: Sequence[GlobalFit], table: Array, covariance: Array, base: Array) -> tuple[Array, list[str]]:
    """Return a covariance that covers every arm the readings do not tell from this one, and a note of it."""
    std = chain.deviations(covariance)
    wide, count = std.copy(), 0
    for rival in rivals:
        off = chain.assign_frames(*rival.model.axes_at(rival.fit.shared), base)[0] - table
        off[:, [0, 3, 4]] = np.mod(off[:, [0, 3, 4]] + np.pi, 2.0 * np.pi) - np.pi
        if (np.abs(off) > ANOTHER * std)[np.isfinite(std) & (std > 0.0)].any():
            wide, count = np.maximum(wide, np.hypot(std, off)), count + 1
    if not count:
        return covariance, []
    # entry by entry, so that the correlations stay
    stretch = np.divide(wide, std, out=np.ones_like(std), where=std > 0.0).ravel()
    return covariance * np.outer(stretch, stretch), [
        "another arm explains the readings as well; the standard deviations cover both. Longer arcs, or a sweep seen "
        "from elsewhere, would tell"
    ]


def _joint_by_joint(
    seen: SweepResiduals, found: list[JointPath], base: Array, notes: list[str], name: str
) -> Identification:
    """Place the frames on the axes of the single paths; joint values count from the pose in which joints rest."""
    sweeps = seen.sweeps
    home = _home(sweeps)
    axes = [measured(item, sweeps) for item in found]
    beacon = _where_paths_meet([item.path for item in found], sweeps, home)
    notes = notes + _notes(found, [axis.revolute for axis in axes])
    table, first, tool = chain.assign_frames(axes, beacon, base)
    sizes = [len(item.path.names) for item in found]
    p = np.concatenate([np.zeros(size) for size in sizes])
    covariance = np.zeros((len(p), len(p)))
    for item, k in zip(found, np.cumsum([0, *sizes[:-1]]), strict=True):
        own = all_covariance(item.path.names, item.path.covariance, 1.0)
        covariance[k : k + len(own), k : k + len(own)] = own
    shifted = _shifter(found, axes, sizes)

    def entries(x: Array) -> Array:
        return chain.assign_frames(shifted(x), beacon, base)[0].ravel()

    covariance = chain.propagate_covariance(entries, p, covariance)
    notes = [*notes, "only the order of the commanded values was used: joint values count from the pose at rest"]
    predicted = sweeps.xyz_m.copy()
    for item in found:
        predicted[item.main] = item.path.nearest(sweeps.xyz_m[item.main])
    placed_frames = _PlacedFrames(
        axes=axes, beacon=beacon, table=table, first=first, tool=tool, covariance=covariance, predicted=predicted
    )
    result = _finish(seen, found, placed_frames, notes, name)
    joints = tuple(
        replace(joint, lower=joint.lower - rest, upper=joint.upper - rest)
        for joint, rest in zip(result.arm.joints, home.tolist(), strict=True)
    )
    return replace(result, arm=replace(result.arm, joints=joints))


def _where_paths_meet(paths: Sequence[PathFit], sweeps: Sweeps, home: Array) -> Array:
    """Return the beacon (3,) with all joints at rest: all paths go through it, whatever the values are worth."""
    position = sweeps.xyz_m[int(np.argmin(np.abs(sweeps.q - home).sum(axis=1)))]
    for _ in range(MEETING_STEPS):
        near = np.array([path.nearest(position[None])[0] for path in paths])
        tangents = np.array([path.tangent(at) for path, at in zip(paths, near, strict=True)])
        # nearest to all tangents: the sum of (1 - t t') (near - x) vanishes, and near moves on with x
        across = np.eye(3) - tangents[:, :, None] * tangents[:, None, :]
        # paths of one tangent leave it open how far along them; there the start is kept
        step = np.linalg.pinv(across.sum(axis=0), rcond=1e-3) @ np.einsum("kij,kj->i", across, near - position)
        position = position + step
    return np.asarray(position)


def _shifter(found: Sequence[JointPath], axes: Sequence[Axis], sizes: Sequence[int]) -> Callable[[Array], list[Axis]]:
    """Return a function from changes of the paths' parameters to axes."""

    def shifted(x: Array) -> list[Axis]:
        out, k = [], 0
        for item, axis, size in zip(found, axes, sizes, strict=True):
            own = x[k : k + size]
            circle = item.path.kind == "circle"
            B = basis(axis.direction)
            tilt = own[3:5] if circle else own[2:4]
            direction, _ = tilted(B, tilt)
            point = axis.point_m + own[:3] if circle else axis.point_m
            out.append(Axis(point_m=point, direction=direction, revolute=axis.revolute))
            k += size
        return out

    return shifted


def _home(sweeps: Sweeps) -> Array:
    """Return the pose in which joints rest while others move; Inconsistent where it is not one."""
    home = np.empty(sweeps.n)
    for j in range(sweeps.n):
        if not one_home(sweeps, j):
            raise Inconsistent(
                f"joint {j + 1} rests at different values in the other joints' sweeps",
                consequence="Without exact values the axes cannot be brought together",
                cure="Begin every sweep from one pose, or give exact values (--increments known)",
            )
        home[j] = sweeps.q[np.flatnonzero(sweeps.joint != j)[0] if sweeps.n > 1 else 0, j]
    return home


def _from_paper(
    seen: SweepResiduals, found: list[JointPath], base: Array, notes: list[str], name: str
) -> Identification:
    """Place the frames on the axes of the paper's means, the joints' rests undone by the commanded values."""
    sweeps = seen.sweeps
    seen_axes = []
    for j, item in enumerate(found):
        rows = item.main
        if item.path.kind == "circle":
            centre, direction, _ = triple_circle(sweeps.xyz_m[rows], sweeps.q[rows, j])
            sense = 1.0 if direction @ item.path.direction >= 0.0 else -1.0
            seen_axes.append(Axis(point_m=centre, direction=sense * direction, revolute=True))
        else:
            point, direction = pair_line(sweeps.xyz_m[rows], sweeps.q[rows, j])
            seen_axes.append(Axis(point_m=point, direction=direction, revolute=False))
    check_slopes(found, seen, [possible_axes(seen, item, j) for j, item in enumerate(found)])
    notes = notes + _notes(found, [axis.revolute for axis in seen_axes])
    axes = chain.at_home(seen_axes, [sweeps.q[item.main[0], :j] for j, item in enumerate(found)])
    beacon = beacon_at_zero(axes, sweeps, np.arange(len(sweeps)))
    table, first, tool = chain.assign_frames(axes, beacon, base)
    X = np.tile(beacon, (len(sweeps), 1))
    for axis, q in zip(axes[::-1], sweeps.q.T[::-1], strict=True):
        X = chain.moved_by(axis, q, X)
    placed_frames = _PlacedFrames(axes=axes, beacon=beacon, table=table, first=first, tool=tool, predicted=X)
    return _finish(seen, found, placed_frames, notes, name, "paper")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _PlacedFrames:
    """The frames placed on the axes: table (n, 5), first (4, 4) in rig axes, tool (4, 4), the beacon (3,) at zero.

    covariance (5 n, 5 n): of the table's entries, None where the method gives none. predicted (m, 3): the beacon at
    each reading. dropped: readings that the whole arm's fit left out, with why.
    """

    axes: Sequence[Axis]
    beacon: Array
    table: Array
    first: Array
    tool: Array
    predicted: Array
    covariance: Array | None = None
    dropped: Sequence[tuple[int, str]] = ()


def _finish(
    seen: SweepResiduals,
    found: Sequence[JointPath],
    frames: _PlacedFrames,
    notes: list[str],
    name: str,
    method: str = "ml",
) -> Identification:
    """Return the arm with its standard deviations, and what each joint's readings say of it."""
    sweeps, covariance = seen.sweeps, frames.covariance
    travel = np.array([[sweeps.q[sweeps.rows(j), j].min(), sweeps.q[sweeps.rows(j), j].max()] for j in range(sweeps.n)])
    arm = chain.arm_of(name, frames.axes, frames.table, frames.first, frames.tool, travel)
    cases: list[str] = []
    std = np.full(frames.table.shape, np.nan)
    if covariance is not None:
        cases, std = chain.degeneracy_notes(frames.axes, frames.table, chain.deviations(covariance))
        arm = replace(arm, covariance=chain.measured_entries(covariance, std))
    return Identification(
        arm=arm,
        joints=_joints_found(seen, found, frames, arm, std, travel),
        method=method,
        notes=(*notes, *cases),
        sigma=seen.sigma,
        predicted_m=frames.predicted,
        beacon_m=frames.beacon,
        misfit=_misfit(seen, found, frames),
        sweeps=sweeps,
    )


def _misfit(seen: SweepResiduals, found: Sequence[JointPath], frames: _PlacedFrames) -> float:
    """Return the RMS of the kept readings' whitened residuals."""
    r, _ = seen.residuals(frames.predicted, np.zeros((len(seen.sweeps), 3, 1)))
    rows = np.setdiff1d(np.concatenate([item.rows for item in found]), [row for row, _ in frames.dropped])
    return seen.rms(r, rows)


def _joints_found(
    seen: SweepResiduals, found: Sequence[JointPath], frames: _PlacedFrames, arm: Arm, std: Array, travel: Array
) -> tuple[JointFound, ...]:
    """Return what each joint's readings say of it; std (n, 5) of its entries, travel (n, 2) in its sweep."""
    sweeps = seen.sweeps
    pixels = None
    if seen.rig is not None:
        r, _ = seen.residuals(frames.predicted, np.zeros((len(sweeps), 3, 1)))
        pixels = r * seen.sigma
    joints = []
    for j, item in enumerate(found):
        more = tuple((row, why) for row, why in frames.dropped if row in item.rows)
        rows = np.setdiff1d(item.rows, [row for row, _ in more])
        off = np.linalg.norm(frames.predicted[rows] - sweeps.xyz_m[rows], axis=1)
        joints.append(
            JointFound(
                index=j + 1,
                type=str(arm.joints[j].type),
                **{name: getattr(arm.joints[j], name) for name in chain.KEYS},
                sign=arm.joints[j].sign,
                axis=frames.axes[j],
                measured=measured(item, sweeps),
                radius_m=item.path.radius_m,
                p_line=item.p_line,
                decided=item.decided,
                std=dict(zip(chain.KEYS, std[j].tolist(), strict=True)),
                travel=(float(travel[j, 0]), float(travel[j, 1])),
                rows=rows,
                discarded=(*item.discarded, *more),
                residual_rms_m=float(np.sqrt(np.mean(off**2))),
                residual_rms_px=None if pixels is None else seen.rms(pixels, rows),
            )
        )
    return tuple(joints)
